"""Files that a command must not overwrite: recordings, and results that other results depend on."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from smoother.cli.directories import BASELINE, RESULT_FILES, holds_results
from smoother.errors import UsageError
from smoother.laps.stage import LAPS

REMEDY = "name another file with --out"


def require_no_recording(out: Path, sessions: Sequence[Path]) -> None:
    """Raise UsageError where the file `out` belongs to a session, or holds a recording, or results.

    An earlier export may be overwritten.
    """
    if not out.is_file():
        return
    from smoother.session.inputs import inputs_of, is_recording

    for session in sessions:
        if any(file.samefile(out) for file in inputs_of(session) if file.exists()):
            raise UsageError(f"{out}: belongs to the session {session} and would be lost; {REMEDY}")
    if out.name in (*RESULT_FILES, BASELINE, LAPS) and holds_results(out.parent):
        raise UsageError(f"{out}: is one of the results and would be lost; {REMEDY}")
    if is_recording(out):
        raise UsageError(f"{out}: holds a recording that would be lost; {REMEDY}")
