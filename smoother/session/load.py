"""From a directory, or one file of it, to a RawSession: which recording lies there, or in one line why there is none.

The format that recognises it reads it, formats.py; what is left of it is put on one time base by recording.py.
"""

from __future__ import annotations

import itertools
import os
import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from smoother.errors import SessionError
from smoother.samples import Problem, RawSession
from smoother.session.files import OF_A_SESSION, OWN_NAMES, RESULTS, SessionFiles, is_packed, list_files, wanted
from smoother.session.formats import FORMATS, Format, preferred
from smoother.session.readers.layout import about_table
from smoother.session.recording import Recording, finish

if TYPE_CHECKING:
    from smoother.session.log import LogFiles

BESIDE = ("session.toml", "calibration.toml", "gps.csv", "gps.csv.gz", *OF_A_SESSION)  # whatever format it has
MOST_FOLDERS = 1000  # looked through for a session; a home folder has many more


def load_raw(path: Path) -> RawSession:
    """Read the session at `path`, a directory or one file of it.

    Problems of a usable session are in `problems`. Raises SessionError, one line with file and remedy, where
    nothing usable is left: no known file, no fix, files on clocks that do not overlap; ConfigError for settings.
    """
    files = list_files(path)
    if (form := _format_of(files)) is not None:
        recording = form.read(files)
        problems = (*recording.problems, *_left_out(files, form, recording), *_no_files(files))
        return finish(files, replace(recording, problems=problems))
    if files.imu_table() is not None:
        broken = "".join(f" ({name} is {kind})" for name, kind in files.no_files("gps.csv", "gps.csv.gz").items())
        raise SessionError(
            f"{path}: an IMU table, but neither gps.csv nor *.nmea{broken}; without fixes there is no track"
        )
    if (log := files.unnamed_sentences()) is not None:
        raise SessionError(
            f"{path}: {log.name} holds NMEA sentences; name the file, smooth {shlex.quote(str(log))}, or call it *.nmea"
        )
    if packed := [name for name in files.names if is_packed(Path(name))]:
        raise SessionError(f"{path}: no recording found, but {packed[0]}, which is packed; unpack it first")
    if (below := _session_below(path)) is not None:
        raise SessionError(
            f"{path}: no recording found in it, but in folders of it ({below.relative_to(path)}); "
            f"for all of them: smooth batch {shlex.quote(str(path))}"
        )
    if (own := files.unnamed_fixes()) is not None:
        raise SessionError(
            f"{path}: no recording found, but {own.name}, which has columns of gps.csv; "
            f"name the file, smooth {shlex.quote(str(own))}, or call it gps.csv"
        )
    if (table := files.unknown_table()) is not None:
        raise SessionError(f"{path}: no recording found, but {table.name}; {about_table(table)}")
    broken = "".join(f" ({name} is {kind})" for name, kind in files.broken_recordings().items())
    raise SessionError(f"{path}: no recording found{broken}; wanted {wanted()}")


def _session_below(path: Path) -> Path | None:
    """The first folder in a folder that holds a recording, if one is among the first that are looked at."""
    if not path.is_dir():
        return None
    for here, below, names in itertools.islice(os.walk(path), MOST_FOLDERS):
        below[:] = sorted(name for name in below if not name.startswith("."))
        if RESULTS.issubset(names):
            below.clear()
        elif Path(here) != path and _holds_recording(Path(here)):
            return Path(here)
    return None


def _holds_recording(folder: Path) -> bool:
    try:
        return bool(list_files(folder).recordings())
    except SessionError:  # it is closed to us
        return False


def _format_of(files: SessionFiles) -> Format | None:
    return next((form for form in FORMATS if form.recognises(files)), None)


def _left_out(files: SessionFiles, form: Format, recording: Recording) -> Iterator[Problem]:
    """What to say of recordings in a folder that are of another kind than the one that is read."""
    if files.chosen is not None:
        return
    own = {path.name for path in form.own(files)} | set(recording.inputs)
    if others := [path for path in files.recordings() if path.name not in own]:
        yield Problem("recordings_unused", preferred(recording.gnss_file, others))


def _no_files(files: SessionFiles) -> Iterator[Problem]:
    """What to say of things called as a file that belongs to the session, which cannot be read as one."""
    for name, kind in files.no_files(*BESIDE).items():
        yield Problem("not_a_file", f"{name}: {kind}, where a file is wanted; nothing in it is used")


def recordings(path: Path) -> list[LogFiles]:
    """Return the drives on a card, in order of their files' names; what calibrates the magnetometer is none.

    Empty where `path` is anything but a directory with the logger's files. Raises SessionError if none of them holds a
    recording.
    """
    files = list_files(path)
    if files.chosen is not None or not files.logs():
        return []
    from smoother.session.log import list_recordings

    return [recording for recording in list_recordings(files.logs()) if not recording.is_calibration]


def recording_on_card(file: Path) -> LogFiles | None:
    """Return the one of several drives on a card that a file belongs to; None where there are not several."""
    try:
        found = recordings(file.parent) if file.is_file() else []
    except SessionError:  # reported when the session is read
        found = []
    mine = (recording for recording in found if file.name in [path.name for path in recording.paths])
    return next(mine, None) if len(found) > 1 else None


def own_results_name(path: Path) -> str:
    """Return what the folder for the results of a file is called if it is one of several recordings, else ""."""
    if (on_card := recording_on_card(path)) is not None:
        return on_card.name
    if not path.is_file() or path.name.lower() in OWN_NAMES:
        return ""
    return path.stem if list_files(path).others_beside() else ""
