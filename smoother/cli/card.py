"""A card may hold several recordings of the logger: each is a session of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from smoother.cli.directories import output_directory
from smoother.cli.output import warn
from smoother.errors import SessionError, UsageError

if TYPE_CHECKING:
    from smoother.session.log import LogFiles

Task = tuple[Path, Path | None]
"""What to smooth, and where its results go (None: beside it)."""


def tasks(path: Path, out: Path | None, number: int | None) -> list[Task]:
    """Return a session as it is, or each recording of a card (or the one with this number, from 1).

    The results of each of several go into a folder of its name. Raises UsageError for a number that does not exist.
    """
    found = _recordings(path, number)
    if len(found) < 2:
        return [(path, out)]
    base = out if out is not None else output_directory(path, None, path.resolve().name)
    if number is not None:
        chosen = found[number - 1]
        return [(chosen.paths[0], base / chosen.name)]
    warn(f"{path}: {_listed(found)}; each goes into {base}/<name>. For one: --recording N")
    return [(recording.paths[0], base / recording.name) for recording in found]


def each(sessions: tuple[Path, ...], number: int | None) -> list[Path]:
    """Return the sessions with each recording of a card (or the one with this number) in place of the card."""
    return [file for path in sessions for file in _files(path, number)]


def one(path: Path, number: int | None) -> Path:
    """Return a session, or of a card the recording with this number. Raises UsageError where the number is missing."""
    files = _files(path, number)
    if len(files) > 1:
        raise UsageError(f"{path}: {_listed(_recordings(path, None))}; select one with --recording N")
    return files[0]


def _files(path: Path, number: int | None) -> list[Path]:
    found = _recordings(path, number)
    if len(found) < 2:
        return [path]
    return [recording.paths[0] for recording in (found if number is None else [found[number - 1]])]


def _recordings(path: Path, number: int | None) -> list[LogFiles]:
    """The recordings of a card, empty for any other session. Raises UsageError for a number that does not exist."""
    from smoother.session.load import recordings

    try:
        found = recordings(path)
    except SessionError:
        found = []  # errors are raised when the session is read
    if number is not None and not 1 <= number <= len(found):
        there = {0: "no recording", 1: "one recording"}.get(len(found), f"{len(found)} recordings")
        raise UsageError(f"{path}: holds {there} of the logger, so there is no --recording {number}")
    return found


def _listed(found: list[LogFiles]) -> str:
    names = ", ".join(f"{i} {recording.paths[0].name}" for i, recording in enumerate(found, 1))
    return f"{len(found)} recordings ({names})"
