"""A card may hold several recordings of the logger: each is a session of its own."""

from __future__ import annotations

from pathlib import Path

from smoother.cli.output import warn
from smoother.cli.pipeline import output_directory
from smoother.errors import SessionError, UsageError

Task = tuple[Path, Path | None]
"""What to smooth, and where its results go (None: beside it)."""


def tasks(path: Path, out: Path | None, number: int | None) -> list[Task]:
    """Return a session as it is, or each recording of a card (or the one with this number, from 1).

    The results of each of several go into a folder of its name. Raises UsageError for a number there is not.
    """
    from smoother.session.load import recordings

    try:
        found = recordings(path)
    except SessionError:
        found = []  # what is wrong is said when the session is read
    if number is not None and not 1 <= number <= len(found):
        there = {0: "no recording", 1: "one recording"}.get(len(found), f"{len(found)} recordings")
        raise UsageError(f"{path}: holds {there} of the logger, so there is no --recording {number}")
    if len(found) < 2:
        return [(path, out)]
    base = out if out is not None else output_directory(path, None, path.resolve().name)
    if number is not None:
        chosen = found[number - 1]
        return [(chosen.paths[0], base / chosen.name)]
    names = ", ".join(f"{i} {recording.paths[0].name}" for i, recording in enumerate(found, 1))
    warn(f"{path}: {len(found)} recordings ({names}); each goes into {base}/<name>. For one: --recording N")
    return [(recording.paths[0], base / recording.name) for recording in found]
