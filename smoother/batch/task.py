"""One session of a batch: what to smooth, where its results go, and what may be spent on it."""

from dataclasses import dataclass
from pathlib import Path

SUMMARY, TRAJECTORY, REPORT = "summary.json", "trajectory.csv", "report.html"
ERROR_LOG = "batch-error.txt"
"""The standard error of a run that broke, beside its results."""


@dataclass(frozen=True)
class Limits:
    """What one session may take: seconds on the clock, and memory in MB (enforced on Linux)."""

    seconds: float = 3600.0  # an hour of recording takes about a minute
    megabytes: int = 4096  # an hour of recording takes 1000


@dataclass(frozen=True)
class Task:
    """A session, ready to be sent to another machine that sees the same files.

    session : its folder, or the file that names it; out : where its results go; inputs : the files that may decide
    them; all absolute. name : for people, from the folder that was searched on. kart : what the folder above it is
    called, empty if that is not below the folder that was searched. arguments : of `smooth`, all but the paths.
    """

    session: Path
    out: Path
    inputs: tuple[Path, ...]
    name: str
    kart: str = ""
    arguments: tuple[str, ...] = ()
    limits: Limits = Limits()

    @property
    def folder(self) -> Path:
        """The folder of the recording."""
        return self.session if self.session.is_dir() else self.session.parent

    @property
    def size(self) -> int:
        """Bytes of the inputs: what takes longest is started first, so that no core waits for it at the end."""
        return sum(size_of(path) for path in self.inputs)


def is_there(path: Path) -> bool:
    """Whether this is a file, as far as it can be seen."""
    try:
        return path.is_file()
    except OSError:
        return False


def size_of(path: Path) -> int:
    """Return the bytes of a file, none where it has gone."""
    try:
        return path.stat().st_size
    except OSError:
        return 0
