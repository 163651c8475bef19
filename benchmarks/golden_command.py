"""The command line under test: run it, with its exit code, output, processor time and peak memory; read its files."""

import json
import os
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from numpy.typing import NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
Table = Mapping[str, Array]

ENVIRONMENT = {
    "OMP_NUM_THREADS": "1",  # rows run side by side, one process per core; and sums keep their order
    "OPENBLAS_NUM_THREADS": "1",
    "NO_COLOR": "1",
    "COLUMNS": "1000",
    "TZ": "UTC",
    "LC_ALL": "C.UTF-8",
}


@dataclass(frozen=True)
class Outcome:
    """What one command ended in."""

    code: int
    stdout: str
    stderr: str

    @property
    def document(self) -> dict[str, Any]:
        """The JSON document on stdout; empty if there is none."""
        try:
            document = json.loads(self.stdout)
        except json.JSONDecodeError:
            return {}
        return document if isinstance(document, dict) else {}


@dataclass
class Cost:
    """Processor time, s, and peak memory, MB, of the commands of one job."""

    seconds: float = 0.0
    wall: float = 0.0
    megabytes: float = 0.0


@dataclass
class Command:
    """One `smooth` executable, and what its runs cost."""

    smooth: Path
    cost: Cost = field(default_factory=Cost)

    def __call__(self, *arguments: str | Path, folder: Path | None = None) -> Outcome:
        """Run `smooth ARGUMENTS` in a folder."""
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            since = time.perf_counter()
            words = [str(self.smooth), *(str(a) for a in arguments)]
            process = subprocess.Popen(words, stdout=out, stderr=err, cwd=folder, env={**os.environ, **ENVIRONMENT})
            _, status, usage = os.wait4(process.pid, 0)  # the usage of this child alone
            process.returncode = os.waitstatus_to_exitcode(status)
            self.cost.wall += time.perf_counter() - since
            self.cost.seconds += usage.ru_utime + usage.ru_stime
            self.cost.megabytes = max(self.cost.megabytes, usage.ru_maxrss / 1024)
            out.seek(0)
            err.seek(0)
            return Outcome(
                process.returncode, out.read().decode("utf-8", "replace"), err.read().decode("utf-8", "replace")
            )


@dataclass(frozen=True)
class Bench:
    """What every job is given: the command under test, the one that simulates, the cache and the recordings."""

    command: Command
    simulator: Path
    cache: Path
    recordings: Path | None


def read_table(path: Path) -> Table:
    """Return the columns (N,) of a CSV file; cells that are no numbers are NaN."""
    frame = pl.read_csv(path, infer_schema_length=0, truncate_ragged_lines=True)
    return {name: frame[name].cast(pl.Float64, strict=False).to_numpy().astype(np.float64) for name in frame.columns}


def columns(table: Table, *names: str) -> Array:
    """Return the named columns side by side (N, K)."""
    return np.stack([table[name] for name in names], axis=1)


def link_files(source: Path, target: Path, names: Sequence[str] | None = None) -> None:
    """Make links to the files of a folder (all, or the named ones) in another, so that results stay out of the first.

    Only files of the folder itself; a folder of results is not taken along.
    """
    target.mkdir(parents=True, exist_ok=True)
    for path in sorted(source.iterdir()):
        if path.is_file() and (names is None or path.name in names):
            (target / path.name).symlink_to(path.resolve())
