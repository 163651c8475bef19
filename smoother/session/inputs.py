"""Which files a session is read from, and whether a file holds a recording: what nothing may be written over.

A file that `smooth export` wrote is none, though it can be read as one: it can be made again.
"""

from pathlib import Path

from smoother.errors import SessionError
from smoother.session.files import (
    HEAD_BYTES,
    LOG_SUFFIX,
    OF_A_SESSION,
    OUT_NAME,
    OWN_NAMES,
    TABLE_BYTES,
    SessionFiles,
    foreign_kind,
    list_files,
    shows_sentences,
)
from smoother.session.formats import FORMATS
from smoother.session.tables import read_header

PRODUCT = b"kart-smoother"  # as every export says it near its beginning
SETTINGS = ("session.toml", "calibration.toml")
TRUTHS = ("truth.csv", "truth.csv.gz")
BESIDE = (*SETTINGS, *OF_A_SESSION, *TRUTHS, "magcalib.txt", "mag_calib.txt", "truth_laps.csv")


def inputs_of(path: Path) -> list[Path]:
    """Return the files that the session at `path` is read from, and those that stand for it beside them.

    None where there is no session; errors are raised when it is read.
    """
    try:
        files = list_files(path)
        beside = [files.directory / name for name in files.names if name.lower() in BESIDE]
        return [*_recording_of(files), *beside]
    except (SessionError, OSError):
        return []


def _recording_of(files: SessionFiles) -> list[Path]:
    """The files of the form in which a session is read, of other programs' files the first that none of ours made."""
    form = next((form for form in FORMATS if form.recognises(files)), None)
    if form is None:
        return []
    if form.name == "foreign":
        found = [path for _, path in files.foreign_files()]
        return [next((path for path in found if not is_export(path)), found[0])]
    out_file = files.out_file() if form.name == "thesis" else None
    return [*form.own(files), *([] if out_file is None else [out_file])]


def is_recording(path: Path) -> bool:
    """Whether a file holds what a logger or another program recorded, or the truth of a simulation."""
    try:
        return path.is_file() and not is_export(path) and _is_read(path)
    except (SessionError, OSError):  # it is unreadable
        return False


def is_export(path: Path) -> bool:
    """Whether a file was written by `smooth export`, as it says near its beginning."""
    try:
        with path.open("rb") as file:
            return PRODUCT in file.read(TABLE_BYTES)
    except OSError:  # a folder, or not ours to read
        return False


def _is_read(path: Path) -> bool:
    """Whether a reader would take a file by its name and its beginning."""
    from smoother.session.log_format import MAGIC  # the types beside it are for those who read a log

    name = path.name.lower()
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    if not head.strip(b"\0"):
        return False
    if name.endswith(LOG_SUFFIX):
        return MAGIC in head
    if name == OUT_NAME and head.startswith(b"Y"):
        return True
    if name in (*OWN_NAMES, *OF_A_SESSION, *TRUTHS) and "t_s" in read_header(path):
        return True
    return foreign_kind(path) is not None or (name.endswith((".nmea", ".csv")) and shows_sentences(head))
