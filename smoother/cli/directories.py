"""Directories of results. Files that this program did not write are neither overwritten nor removed."""

from __future__ import annotations

import filecmp
import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from smoother.cli.output import warn
from smoother.errors import SessionError, SmootherError, UsageError
from smoother.laps.stage import LAPS
from smoother.words import counted

if TYPE_CHECKING:
    from smoother.samples import RawSession

OUTPUT_DIRECTORY = "smoothed"
TRAJECTORY, BASELINE, FIXES, SUMMARY, FIGURES = "trajectory.csv", "baseline.csv", "gps.csv", "summary.json", "figures"
RESULT_FILES = (TRAJECTORY, FIXES, SUMMARY)
PAGE = "report.html"
FIGURE_NAMES = ("overview", "track", "speed", "attitude", "accelerations", "biases", "residuals", "sigma")
STALE = (BASELINE, LAPS, PAGE, *(f"{FIGURES}/{name}.png" for name in FIGURE_NAMES))
"""What an earlier run with other options may have left, and this one then removes."""
_HOLDS_RECORDING = "--out {}: holds a recording, its files would be overwritten; name another place"


def holds_results(directory: Path) -> bool:
    """Whether a directory holds the results of a session."""
    return all((directory / name).is_file() for name in RESULT_FILES)


def session_directory(path: Path) -> Path:
    """Return the directory of a session that may have been named by one of its files."""
    return path if path.is_dir() else path.parent


def usual_output(path: Path) -> Path:
    """Return where results of a session go: SESSION/smoothed, of one of several recordings a folder in it."""
    from smoother.session.load import own_results_name

    return session_directory(path) / OUTPUT_DIRECTORY / own_results_name(path)


def read_summary(directory: Path) -> dict[str, object] | None:
    """Return the summary of a directory of results, None where it is none."""
    try:
        document = json.loads((directory / SUMMARY).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None
    return document if isinstance(document, dict) else None


def output_directory(path: Path, out: Path | None, name: str) -> Path:
    """Create and return the directory of the results.

    A session on a locked card cannot take them: without `out` they then go to ./smoothed/NAME. Raises UsageError when
    `out` holds a recording, which could not be read beside results, or other files of the same names, or cannot be
    created.
    """
    source = session_directory(path)
    if out is not None:
        if out.resolve() == source.resolve():
            raise UsageError(_HOLDS_RECORDING.format(out))
        _require_no_foreign_files(out)
        return _created(out)
    try:
        return _created(usual_output(path))
    except UsageError as error:
        instead = Path(OUTPUT_DIRECTORY) / (name or "session")
        is_taken = _in_the_way(usual_output(path)) is not None
        warn(f"{error if is_taken else f'{source} cannot be written to'}; the results go to {instead}")
        return _created(instead)


def _require_no_foreign_files(out: Path) -> None:
    """Raise UsageError where a folder holds a recording, or foreign files with the names of results."""
    from smoother.session.inputs import is_recording

    if not out.is_dir():
        return
    ours = (*RESULT_FILES, *STALE) if _is_partial_result(out) else ()
    if any(is_recording(file) for file in sorted(out.iterdir()) if file.name not in ours):
        raise UsageError(_HOLDS_RECORDING.format(out))
    other = next((name for name in (*RESULT_FILES, *STALE) if name not in ours and os.path.lexists(out / name)), None)
    if other is not None:
        raise UsageError(f"--out {out}: holds {other}, which is not of this program; name another place")


def _is_partial_result(directory: Path) -> bool:
    """Whether results were written into a folder, perhaps incompletely: the rows are written first."""
    from smoother.session.tables import read_header

    try:
        return {"t_s", "sigma_track_m"} <= set(read_header(directory / TRAJECTORY))
    except (SmootherError, OSError):
        return False


def another_recording(directory: Path, raw: RawSession, is_renamed: bool) -> str | None:
    """Name of the recording whose results are in a directory, None if there are none or it is the same.

    is_renamed : the results are beside their recording, in a folder that was renamed.
    """
    document = read_summary(directory)
    about = None if document is None else document.get("session")
    if document is None or not isinstance(about, dict) or about.get("name") == raw.name:
        return None
    is_same = is_renamed and document.get("inputs") == list(raw.inputs)
    return None if is_same else str(about.get("name"))


def exports_in(directory: Path) -> list[str]:
    """Names of the files that `smooth export` made of results in the same folder."""
    from smoother.session.inputs import is_export

    return sorted(
        file.name for file in directory.iterdir() if file.name not in (*RESULT_FILES, *STALE) and is_export(file)
    )


def differ(one: Path, other: Path) -> bool:
    """Whether two folders hold other rows or other laps."""
    return any(
        (one / name).is_file() != (other / name).is_file()
        or ((one / name).is_file() and not filecmp.cmp(one / name, other / name, shallow=False))
        for name in (TRAJECTORY, LAPS)
    )


def warn_removed(directory: Path, names: list[str]) -> None:
    """Report in one line which outdated results of an earlier run were removed."""
    pictures = sum(name.startswith(f"{FIGURES}/") for name in names)
    parts = [name for name in names if not name.startswith(f"{FIGURES}/")]
    parts += [counted(pictures, "figure")] if pictures else []
    if parts:
        listed = " and ".join(filter(None, [", ".join(parts[:-1]), parts[-1]]))
        warn(f"{directory}: removed {listed} of an earlier run, which this one did not make anew")


def unwritable(directory: Path, error: OSError) -> SmootherError:
    """Return the error about results that could not be written, with a remedy."""
    if isinstance(error, FileExistsError | NotADirectoryError) and (file := _in_the_way(directory)) is not None:
        return SessionError(
            f"{file}: a file, where a folder for the results is wanted; move it, or name another place with --out DIR"
        )
    if isinstance(error, IsADirectoryError) and error.filename is not None:
        return SessionError(
            f"{error.filename}: a folder, where a file of the results is wanted; move it, or name another place with "
            "--out DIR"
        )
    return SessionError(
        f"{directory}: cannot be written ({error.strerror or error}); name another place with --out DIR"
    )


def _in_the_way(directory: Path) -> Path | None:
    """A file with the name of the directory or of one above it."""
    places = (directory, *directory.parents)
    return next((place for place in places if os.path.lexists(place) and not place.is_dir()), None)


def _created(directory: Path) -> Path:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        probe = directory / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise UsageError(str(unwritable(directory, error))) from error
    return directory


def require_no_recording(out: Path, sessions: Sequence[Path]) -> None:
    """Raise UsageError where the file `out` belongs to a session, or holds a recording, or results.

    An earlier export may be overwritten.
    """
    if not out.is_file():
        return
    remedy = "name another file with --out"
    from smoother.session.inputs import inputs_of, is_recording

    for session in sessions:
        if any(file.samefile(out) for file in inputs_of(session) if file.exists()):
            raise UsageError(f"{out}: belongs to the session {session} and would be lost; {remedy}")
    if out.name in (*RESULT_FILES, BASELINE, LAPS) and holds_results(out.parent):
        raise UsageError(f"{out}: is one of the results and would be lost; {remedy}")
    if is_recording(out):
        raise UsageError(f"{out}: holds a recording that would be lost; {remedy}")
