"""`smooth check SESSION...`: judge a recording at the track."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from smoother.cli.arguments import (
    EXIT_DONE,
    EXIT_QUALITY,
    EXIT_UNUSABLE,
    json_option,
    recording_option,
    require_sessions,
    sessions_argument,
)
from smoother.cli.card import each
from smoother.cli.output import print_json, print_line, print_pairs, progress_on_terminal, warn
from smoother.cli.pipeline import naming, read, require_usable_beside
from smoother.errors import SmootherError

if TYPE_CHECKING:
    from smoother.estimate.judge.check import Check

_MARKS = {"ok": "ok", "warning": "note", "stop": "STOP"}


@click.command(short_help="Is the recording good? Seconds, at the track.")
@sessions_argument
@recording_option
@json_option
def check(sessions: tuple[Path, ...], recording: int | None, as_json: bool) -> int:
    """Judge in seconds whether a recording is good to drive with, and why.

    Make a test recording of a minute with the engine running, check it, then drive. Rates, gaps, fixes, clipping,
    vibration and axes are judged; without a motion sensor, or with one that is too slow, the fixes alone.

    Exit code 0: good to drive with. 3: correct the faults shown first.
    """
    require_sessions(sessions, "smooth check")
    paths = each(sessions, recording)
    outcomes = [_attempt(path, is_only=len(paths) == 1) for path in paths]
    if as_json:
        documents = [_document(outcome, path) for outcome, path in zip(outcomes, paths, strict=True)]
        _print_documents(documents)
    for outcome, heading in zip(outcomes, _headings(outcomes, paths), strict=True):
        if isinstance(outcome, SmootherError):
            warn(str(outcome))
        elif not as_json:
            _show(outcome, heading)
    if any(isinstance(outcome, SmootherError) for outcome in outcomes):
        return EXIT_UNUSABLE
    good = all(outcome.is_good for outcome in outcomes if not isinstance(outcome, SmootherError))
    return EXIT_DONE if good else EXIT_QUALITY


def _attempt(path: Path, is_only: bool) -> Check | SmootherError:
    from smoother.estimate.judge.check import check as check_recording

    with progress_on_terminal() as progress:
        progress("reading", 0.0)
        try:
            with naming(path):
                raw = read(path)
                require_usable_beside(raw, path)
                return check_recording(raw)
        except SmootherError as error:
            if is_only:
                raise
            return error


def _headings(outcomes: Sequence[Check | SmootherError], paths: Sequence[Path]) -> list[str]:
    """The heading of each block: the name of the session, its path where names repeat."""
    names = [
        str(path) if isinstance(one, SmootherError) else one.name for one, path in zip(outcomes, paths, strict=True)
    ]
    return names if len(set(names)) == len(names) else [str(path) for path in paths]


def _show(result: Check, heading: str) -> None:
    print_pairs(heading, [(f"{_MARKS[f.level]:<4}  {f.topic}", f.text) for f in result.findings])
    if result.is_good:
        print_line("GOOD TO DRIVE, GPS only: no roll, pitch, sideslip" if result.is_gps_only else "GOOD TO DRIVE")
    else:
        print_line("NOT GOOD TO DRIVE: " + "; ".join(result.reasons))


def _document(outcome: Check | SmootherError, path: Path) -> dict[str, object]:
    if isinstance(outcome, SmootherError):
        return {"session": str(path), "path": str(path), "error": str(outcome)}
    return {
        "session": outcome.name,
        "path": str(path),
        "good": outcome.is_good,
        "gps_only": outcome.is_gps_only,
        "reasons": outcome.reasons,
        "findings": outcome.findings,
        "measures": outcome.measures,
    }


def _print_documents(documents: list[dict[str, object]]) -> None:
    from smoother.report.files import to_json

    print_json(to_json(documents[0] if len(documents) == 1 else documents))
