"""Which file of a directory plays which part. Looks at names, and at the head of a file that a person named."""

import contextlib
import re
import shlex
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from smoother.errors import SessionError
from smoother.session.readers.layout import Layout, about_table, is_of_another_program, layout_in
from smoother.session.tables import read_header
from smoother.session.text import in_utf8

Foreign = Literal["xrk", "vbo", "gopro", "track", "ubx", "table", "fit"]
Role = Literal["log", "out", "fixes", "imu", "sentences", "archive"] | Foreign
FOREIGN: tuple[Foreign, ...] = ("xrk", "vbo", "gopro", "track", "ubx", "table", "fit")  # what holds most stands first
OF_SUFFIX: dict[str, Foreign] = {  # of files that are what they are called
    **dict.fromkeys((".xrk", ".xrz", ".drk"), "xrk"),
    **dict.fromkeys((".gpx", ".tcx", ".kml"), "track"),
    **{".vbo": "vbo", ".fit": "fit"},
}
OUT_NAME, LOG_SUFFIX = "out.txt", ".klg"
IMU_NAMES = ("imu.csv", "imu.csv.gz")
OF_A_SESSION = (
    "mag.csv",
    "mag.csv.gz",
    "wheel_speed.csv",
    "wheel_speed.csv.gz",
    "channels.csv",
    "channels.csv.gz",
    "official.csv",
)  # tables that stand for the session they lie beside
OWN_NAMES = (*IMU_NAMES, "gps.csv", "gps.csv.gz", OUT_NAME)  # of files that are their folder's session
RESULTS = frozenset({"trajectory.csv", "summary.json"})  # both of these make a folder one of results
UNNAMED_SUFFIXES = (".txt", ".log", ".ubx", ".gps", ".dat")  # of what receivers and terminals write
HEAD_BYTES = 4096
TABLE_BYTES = 65536  # of a table, in which its names stand
SENTENCE_BYTES = 1 << 20  # GnssLogger of Android describes its columns first, and writes other lines between sentences
SENTENCE = re.compile(rb"\$\0?G\0?(?:[A-Z]\0?){4},")  # in one byte a character or in two
WANTED: dict[Role, str] = {  # every kind of recording there is a reader for, as it is called for people
    "log": "*.klg",
    "out": "out.txt",
    "fixes": "gps.csv",
    "imu": "imu.csv with fixes",
    "sentences": "*.nmea",
    "xrk": "*.xrk",
    "vbo": "*.vbo",
    "gopro": "a GoPro's *.mp4",
    "track": "*.gpx, *.tcx, *.kml",
    "ubx": "*.ubx",
    "fit": "*.fit",
    "archive": "a .zip of these",
    "table": "a .csv with latitude, longitude and time",
}
SENTENCE_LINE = re.compile(rb"\s*(?:[-+0-9.eE]+[ \t]*,[ \t]*)?\$[GP][A-Z]{3,5},")  # maybe with the time it came
UBX_SYNC = b"\xb5\x62"
TABLE_SUFFIXES = (".csv", ".txt", ".tsv", ".log")
VIDEO_SUFFIX, OF_CAMERA = ".mp4", b"GoPro"
CAMERA_BYTES = 8 << 20  # at either end of a video, in which the maker of its streams stands
LARGE = 1 << 30  # bytes of a file, of which at least
STORED_SHARE = 0.02  # is on the disk: no text packs so well
LARGEST = 64 << 30  # bytes; a month of samples in a table has less
RECORDING_SUFFIXES = (".csv", ".csv.gz", ".tsv", ".nmea", LOG_SUFFIX, ".ubx", *OF_SUFFIX, OUT_NAME)
ARCHIVE_SUFFIX = ".zip"
PACKED_SUFFIXES = (".7z", ".rar", ".tar", ".tgz", ".gz", ".bz2", ".xz")


@dataclass(frozen=True)
class SessionFiles:
    """The files of one session. `chosen` is the one a person named and the part it plays, None for a directory."""

    directory: Path
    names: tuple[str, ...]
    chosen: tuple[Path, Role] | None = None

    def find(self, *wanted: str) -> Path | None:
        """The first of the wanted names that is there, in any case of letters (cards often write capitals)."""
        for want in wanted:
            for name in self.names:
                if name.lower() == want:
                    return self.directory / name
        return None

    def no_files(self, *wanted: str) -> dict[str, str]:
        """Return what is called as a wanted file and is none, by name: a folder, a link that leads nowhere, a pipe."""
        return {name: kind for name, kind in self.broken_recordings(*wanted).items() if name.lower() in wanted}

    def broken_recordings(self, *others: str) -> dict[str, str]:
        """The same of all that are called as recordings may be, and as others."""
        called = sorted(self.directory.iterdir())
        called = [entry for entry in called if entry.name.lower().endswith((*RECORDING_SUFFIXES, *others))]
        return {entry.name: _kind(entry) for entry in called if not entry.is_file()}

    def _chosen_as(self, role: Role) -> Path | None:
        return self.chosen[0] if self.chosen is not None and self.chosen[1] == role else None

    def logs(self) -> list[Path]:
        """The logger's files, the one that was named first; none if a person pointed at another recording there."""
        if self.chosen is not None and self.chosen[1] != "log":
            return []
        named = self._chosen_as("log")
        others = [self.directory / name for name in self.names if name.lower().endswith(LOG_SUFFIX)]
        return others if named is None else [named, *(path for path in others if path.name != named.name)]

    def out_file(self) -> Path | None:
        """The thesis' out.txt, unless a person pointed at another recording in the same place."""
        if self.chosen is not None:
            return self._chosen_as("out")
        return self.find(OUT_NAME)

    @property
    def _is_foreign(self) -> bool:
        """Whether a person named another program's recording, which stands alone."""
        return self.chosen is not None and self.chosen[1] in FOREIGN

    def imu_table(self) -> Path | None:
        """imu.csv, or the IMU table that was named."""
        if self._is_foreign:
            return None
        return self._chosen_as("imu") or self.find(*IMU_NAMES)

    def fix_table(self) -> Path | None:
        """gps.csv, or the table of fixes that was named; none if a log of sentences was."""
        if self._chosen_as("sentences") or self._is_foreign:
            return None
        own = self.find("gps.csv", "gps.csv.gz")
        if self._chosen_as("fixes") is None and own is not None and self._is_of_another(own):
            return None
        if self._chosen_as("fixes") is None and own is not None and is_of_sentences(own):
            return None
        return self._chosen_as("fixes") or own

    def _is_of_another(self, table: Path) -> bool:
        """Whether a table is called as this project's, and has the columns of another program; alone it is read so."""
        return self.find(*IMU_NAMES) is None and foreign_kind(table) is not None

    def sentence_logs(self) -> list[Path]:
        """The logs of NMEA sentences, largest first, a gps.csv of them too; only the one that was named, if any."""
        if (log := self._chosen_as("sentences")) is not None:
            return [log]
        if self._is_foreign:
            return []
        logs = [self.directory / name for name in self.names if name.lower().endswith(".nmea")]
        if (own := self.find("gps.csv")) is not None and is_of_sentences(own):
            logs.append(own)
        return sorted(logs, key=lambda log: (-log.stat().st_size, log.name))

    def foreign_files(self) -> list[tuple[Foreign, Path]]:
        """Recordings of other programs with their kinds, best kind and largest first; only the one that was named."""
        if self.chosen is not None:
            return [(kind, self.chosen[0]) for kind in FOREIGN if self.chosen[1] == kind]
        paths = [self.directory / name for name in self.names]
        found = [(kind, path) for path in paths if (kind := foreign_kind(path)) is not None]
        return sorted(found, key=lambda file: (FOREIGN.index(file[0]), -file[1].stat().st_size, file[1].name))

    def of_kind(self, kind: Foreign) -> list[Path]:
        """All recordings of a kind in the folder, whichever was named."""
        return [path for path in (self.directory / name for name in self.names) if foreign_kind(path) == kind]

    def sensor_tables(self) -> list[Path]:
        """The tables of another program in the folder that hold a motion sensor's values and no places."""
        paths = [self.directory / name for name in self.names if name.lower() not in OWN_NAMES]
        return [path for path in paths if (found := table_layout(path)) is not None and not found.has_places]

    def archives(self) -> list[Path]:
        """The archive that was named, or those in a folder."""
        if self.chosen is not None:
            return [self.chosen[0]] if self.chosen[1] == "archive" else []
        return [self.directory / name for name in self.names if name.lower().endswith(ARCHIVE_SUFFIX)]

    def unnamed_sentences(self) -> Path | None:
        """A file with NMEA sentences that is not called so, and is read only if a person names it."""
        paths = (self.directory / name for name in self.names if name.lower().endswith(UNNAMED_SUFFIXES))
        return next((path for path in paths if shows_sentences(_beginning(path, SENTENCE_BYTES))), None)

    def unnamed_fixes(self) -> Path | None:
        """A table with columns of gps.csv that is not called so, and is read only if a person names it."""
        return next((path for path in self._fix_tables() if not RESULTS.issubset(self.names)), None)

    def unknown_table(self) -> Path | None:
        """Another program's table that no reader knows."""
        paths = (self.directory / name for name in self.names if name.lower() not in (*OWN_NAMES, *OF_A_SESSION))
        return next((path for path in paths if is_of_another_program(path)), None)

    def recordings(self) -> list[Path]:
        """Every file that a recording is read from, or would be if a person named it; what all others lie beside."""
        tables = [self.directory / name for name in self.names if name.lower() in OWN_NAMES]
        others = [*self.logs(), *self.sentence_logs(), *(path for _, path in self.foreign_files())]
        unnamed = self.unnamed_sentences()
        return list(dict.fromkeys([*tables, *others, *([] if unnamed is None else [unnamed])]))

    def others_beside(self) -> list[Path]:
        """Recordings in the folder of a file that was named, other than it: by their names of another drive.

        A motion sensor's table belongs to whatever fixes are named; of two formats of one name, one drive was exported.
        """
        if self.chosen is None or self.chosen[1] == "log":
            return []
        chosen, role = self.chosen
        beside = [*replace(self, chosen=None).recordings(), *(self._fix_tables() if role != "imu" else [])]
        of_imu = [path for path in beside if path.name.lower() in IMU_NAMES]
        found = of_imu if role == "imu" else [path for path in beside if path not in of_imu]
        return [path for path in dict.fromkeys(found) if path.stem != chosen.stem]

    def _fix_tables(self) -> list[Path]:
        """Every table with fixes, whatever it is called."""
        return [self.directory / name for name in self.names if _holds_fixes(self.directory / name)]

    def session_name(self) -> str:
        """Name of the directory, or of the file where one of several recordings in it was named."""
        if self.chosen is not None and self.chosen[0].name.lower() not in OWN_NAMES:
            return self.chosen[0].name.partition(".")[0] or "session"
        return self.directory.resolve().name or "session"


def wanted() -> str:
    """Every kind of recording, for a sentence about one that is none of them."""
    *most, last = WANTED.values()
    return f"{', '.join(most)} or {last}"


def is_packed(path: Path) -> bool:
    """Whether a file has others packed into it; a table that is compressed is read as it is."""
    name = path.name.lower()
    return name.endswith(PACKED_SUFFIXES) and not name.endswith(".csv.gz")


def list_files(path: Path) -> SessionFiles:
    """List the session at `path`, a directory or one file of it. Raises SessionError if there is none."""
    if not path.exists():
        raise SessionError(f"{path}: no such file or directory")
    if not path.is_dir() and not path.is_file():
        raise SessionError(f"{path}: neither a file nor a directory; a pipe or a device holds no recording")
    directory = path if path.is_dir() else path.parent
    try:
        names = tuple(sorted(entry.name for entry in directory.iterdir() if entry.is_file()))
        for file in _of_session(path, directory, names):
            _require_stored(file)
        role = None if path.is_dir() else _role(path)
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror or error})") from error
    return SessionFiles(directory, names, None if role is None else (path, role))


def _of_session(path: Path, directory: Path, names: tuple[str, ...]) -> list[Path]:
    """What may be read as part of the session at `path`, by name."""
    own = (*OWN_NAMES, *OF_A_SESSION)
    if not path.is_dir():
        return [path, *(directory / name for name in names if name.lower() in own)]
    return [directory / name for name in names if name.lower().endswith(RECORDING_SUFFIXES)]


def _require_stored(file: Path) -> None:
    """Raise SessionError for a file too large for any recording, or of which hardly anything was ever stored.

    Read to its end, zeros of a hole would keep the computer busy for minutes, or fill its memory.
    """
    stat = file.stat()
    stored = getattr(stat, "st_blocks", None)  # of 512 bytes; not every system has it
    if stat.st_size > LARGE and stored is not None and 512 * stored < STORED_SHARE * stat.st_size:
        size = f"{stat.st_size / 1e9:.3g} GB long, of which {512 * stored / 1e6:.3g} MB were ever written"
        raise SessionError(f"{file.name}: {size}; copy it from the card again")
    if stat.st_size > LARGEST:
        raise SessionError(f"{file.name}: {stat.st_size / 1e9:.3g} GB long, more than any recording; is it one?")


def _kind(entry: Path) -> str:
    """What something is that is no file."""
    if entry.is_dir():
        return "a folder"
    return "a link that leads nowhere" if entry.is_symlink() else "no file"


def _beginning(path: Path, size: int) -> bytes:
    """The first bytes of a file, none of one that cannot be read: whoever needs it will say so."""
    try:
        with path.open("rb") as file:
            return file.read(size)
    except OSError:
        return b""


def shows_sentences(start: bytes) -> bool:
    """Whether the start of a file has that of a sentence, further on a whole one: in much data two bytes say little."""
    head = start[:HEAD_BYTES]
    return b"$G" in head or b"$\0G\0" in head or b"\0$\0G" in head or SENTENCE.search(start) is not None


def _holds_fixes(path: Path) -> bool:
    try:
        return path.name.lower().endswith((".csv", ".csv.gz")) and _table_role(path) == "fixes"
    except SessionError:  # the truth, or nothing that can be read
        return False


def foreign_kind(path: Path) -> Foreign | None:
    """Which other program's recording a file is; tables are distinguished by their first lines."""
    name = path.name.lower()
    if (kind := OF_SUFFIX.get(path.suffix.lower())) is not None:
        return kind
    if name.endswith(VIDEO_SUFFIX):
        return "gopro" if _is_of_camera(path) else None
    if name.endswith(".ubx"):
        return "ubx" if _shows_messages(path) else None
    layout = table_layout(path)
    return "table" if layout is not None and layout.has_places else None


def table_layout(path: Path) -> Layout | None:
    """The layout of a file that is a table of motion by its first lines; None of any other."""
    return layout_in(path) if path.name.lower().endswith(TABLE_SUFFIXES) else None


def _is_of_camera(path: Path) -> bool:
    """Whether a video is of a camera that writes telemetry."""
    if OF_CAMERA in _beginning(path, CAMERA_BYTES):
        return True
    with contextlib.suppress(OSError), path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - CAMERA_BYTES))
        return OF_CAMERA in file.read(CAMERA_BYTES)
    return False


def is_of_sentences(path: Path) -> bool:
    """Whether a file that is called a table has NMEA sentences for lines, below one that is cut or names no columns."""
    lines = [line for line in in_utf8(_beginning(path, HEAD_BYTES)).splitlines() if line.strip()][:2]
    return any(SENTENCE_LINE.match(line) for line in lines) and b"lat" not in lines[0].lower()


def _shows_messages(path: Path) -> bool:
    """Whether a file of a u-blox receiver has its own messages, and no sentences beside them, which are read."""
    head = _beginning(path, SENTENCE_BYTES)
    return UBX_SYNC in head and SENTENCE.search(head) is None


def _role(path: Path) -> Role | None:
    """The part a named file plays; None for one that only belongs to its session, as session.toml or mag.csv."""
    name = path.name.lower()
    if (kind := foreign_kind(path)) is not None:
        return kind
    if name.endswith((".csv", ".csv.gz")):
        return _table_role(path)
    if name.endswith(".nmea"):
        return "sentences"
    if name.endswith(LOG_SUFFIX):
        return "log"
    if name.endswith(ARCHIVE_SUFFIX):
        return "archive"
    if name.endswith(".toml") or name in ("magcalib.txt", "mag_calib.txt"):
        return None
    from smoother.session.log_format import MAGIC  # the types beside it are for those who read a log

    with path.open("rb") as file:
        head = file.read(SENTENCE_BYTES)
    if head.startswith(MAGIC):
        return "log"
    if name == OUT_NAME or head.startswith(b"YY"):
        return "out"
    if shows_sentences(head):
        return "sentences"
    if is_packed(path):
        raise SessionError(f"{path}: packed; unpack it first, then name what was in it")
    raise SessionError(f"{path}: no known kind of recording; wanted a folder, or {wanted()}")


def _table_role(path: Path) -> Role | None:
    """The part of a table. Raises SessionError for the truth, which has the columns of fixes, and for one that
    no reader knows: another recording beside it is not what was asked for.
    """
    if path.name.lower().startswith("truth.csv"):
        folder = shlex.quote(str(path.parent))
        raise SessionError(f"{path}: the truth is no recording; name its folder: smooth evaluate {folder}")
    if is_of_sentences(path):
        return "sentences"
    header = read_header(path)
    if "lat_deg" in header or path.name.lower().startswith("gps.csv"):
        return "fixes"
    if {"ax", "gx"} <= set(header) or path.name.lower().startswith("imu.csv"):
        return "imu"
    if path.name.lower() in OF_A_SESSION:
        return None
    raise SessionError(f"{path}: no known kind of recording; {about_table(path)}")
