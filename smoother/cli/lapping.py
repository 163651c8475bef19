"""`smooth laps SESSION...`: the table of laps and sectors, also on another line than the session's own."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from smoother.cli.arguments import (
    ABOUT_EXIT,
    EXIT_DONE,
    EXIT_QUALITY,
    json_option,
    recording_option,
    require_sessions,
    sessions_argument,
)
from smoother.cli.card import each
from smoother.cli.directories import SUMMARY, session_directory
from smoother.cli.lap_tables import SPEED_UNITS, show_corners, show_laps, show_losses
from smoother.cli.output import Progress, print_json, progress_on_terminal
from smoother.cli.pipeline import Options, Stopwatch, calibrated, estimate, naming, read
from smoother.cli.results import results_of
from smoother.laps.stage import LEAST_RATE, Stated, analyse_rows, read_stated, tracks_from

if TYPE_CHECKING:
    from smoother.frames import Origin
    from smoother.laps.results import LapAnalysis
    from smoother.laps.stored import Stored
    from smoother.utc_clock import UtcClock

Document = dict[str, Any]

line_option = click.option(
    "--line",
    metavar="LINE",
    help='Start/finish: "lat,lon;lat,lon", a track file (file.json#NAME picks one of several), or a known track.',
)
units_option = click.option(
    "--units", type=click.Choice(list(SPEED_UNITS)), default="km/h", help="Unit of speeds in tables [km/h]."
)


@click.command(short_help="Laps and sectors, with an error bar on each.", epilog=ABOUT_EXIT)
@sessions_argument
@recording_option
@line_option
@click.option(
    "--official",
    metavar="FILE",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="Transponder times, one lap a row, to show beside these [SESSION/official.csv].",
)
@click.option("--corners", is_flag=True, help="Also show the time that each lap lost in each corner.")
@units_option
@json_option
def laps(
    sessions: tuple[Path, ...],
    recording: int | None,
    line: str | None,
    official: Path | None,
    corners: bool,
    units: str,
    as_json: bool,
) -> int:
    """Show laps and sectors of a session, each time with one sigma; the session is smoothed first if necessary.

    Without --line the line is that of the track in session.toml, else one is found where timing is most accurate.
    Times of day are in this computer's time zone, which the title names. --json has the laps as in summary.json.
    """
    require_sessions(sessions, "smooth laps")
    documents, passed = [], True
    for path in each(sessions, recording):
        with progress_on_terminal() as progress:
            document, unix, good = laps_of(path, line, official, progress)
        passed &= good
        documents.append({"session": str(path), **document})
        if as_json:
            continue
        show_laps(document["laps"], document["lap_analysis"], unix, units, title=str(path))
        if corners:
            show_corners(document["laps"], document["lap_analysis"], units)
            show_losses(document["lap_analysis"], units)
    if as_json:
        from smoother.report.files import to_json

        print_json(to_json(documents[0] if len(documents) == 1 else documents))
    return EXIT_DONE if passed else EXIT_QUALITY


def laps_of(
    path: Path, line: str | None, official: Path | None, progress: Progress
) -> tuple[Document, UtcClock | None, bool]:
    """Return laps and analysis as summary.json would hold them, the time of day, and whether the session passed."""
    wanted = None if line is None else tracks_from(line)  # an unusable line is an error before minutes of work
    with naming(path):
        return _laps_on(path, wanted, official, progress)


def _laps_on(
    path: Path, wanted: tuple[Any, ...] | None, official: Path | None, progress: Progress
) -> tuple[Document, UtcClock | None, bool]:
    from smoother.laps.stored import read_stored
    from smoother.utc_clock import UtcClock

    directory, passed = results_of(path, progress)
    progress("laps", 0.0)
    document = json.loads((directory / SUMMARY).read_text(encoding="utf-8"))
    if wanted is None and official is None and "lap_analysis" in document and not _is_older(path, directory):
        return (
            {key: document[key] for key in ("laps", "lap_analysis")},
            UtcClock.of_summary(document["session"]),
            passed,
        )
    stored = read_stored(directory)
    stated = stated_for(path, wanted, official)
    documents = documents_of(analysed(path, stored, stated), stored.origin)
    is_newer = official is not None or _is_older(path, directory)
    if not is_newer and _are_on_same_lines(documents, document):  # the line that was given was not passed
        document["lap_analysis"]["problems"] = documents["lap_analysis"]["problems"]
        documents = {key: document[key] for key in ("laps", "lap_analysis")}
    return documents, stored.clock, passed


def stated_for(path: Path, tracks: tuple[Any, ...] | None, official: Path | None) -> Stated:
    """Return lines and official times of a session: those of the command line, else those beside its files."""
    from smoother.config import SessionConfig
    from smoother.laps.official import load_official
    from smoother.session.settings import load_settings

    directory = session_directory(path)
    settings = directory / "session.toml"
    beside = read_stated(load_settings(settings) if settings.is_file() else SessionConfig(), directory, path)
    return Stated(
        beside.tracks if tracks is None else tracks,
        beside.official if official is None else load_official(official),
        beside.own if tracks is None else (),
        beside.problems if tracks is None else (),
    )


def analysed(path: Path, stored: Stored, stated: Stated) -> LapAnalysis:
    """Return the laps of stored results; rows of too low a rate are estimated again."""
    from smoother.laps.stage import analyse_session, options_on

    if stored.rate < LEAST_RATE - 1.0:
        session = calibrated(read(path), session_directory(path))
        estimates = estimate(session, Options(baseline=False, figures=False), Stopwatch())
        return analyse_session(estimates.session, estimates.smoothed, stated)  # corrects clocks that step
    return analyse_rows(
        stored.trajectory, stored.fixes, options_on(stored.trajectory, stored.origin, stated, stored.drift)
    )


def documents_of(analysis: LapAnalysis, origin: Origin) -> Document:
    """Return `laps` and `lap_analysis`."""
    from smoother.laps.document import analysis_document, lap_rows

    return {"laps": lap_rows(analysis), "lap_analysis": analysis_document(analysis, origin)}


def _are_on_same_lines(found: Document, stored: Document) -> bool:
    """Whether laps were timed on lines that were found, those of `summary.json`."""
    one, other = (_found_line(document.get("lap_analysis")) for document in (found, stored))
    # deg; a metre, by which a line found on stored rows may differ
    return one is not None and other is not None and all(abs(a - b) < 1e-5 for a, b in zip(one, other, strict=True))


def _found_line(analysis: Document | None) -> list[float] | None:
    """Latitudes and longitudes of a start line that was found where timing is most accurate; None of any other."""
    line = None if analysis is None else analysis["start_line"]
    if line is None or line["source"] != "found":
        return None
    return [line[end][name] for end in ("left", "right") for name in ("lat_deg", "lon_deg")]


def _is_older(path: Path, directory: Path) -> bool:
    """Whether a track file or official times beside the session changed since its results were written."""
    from smoother.laps.tracks import ENDINGS

    written = (directory / "summary.json").stat().st_mtime
    beside = session_directory(path)
    stating = [*(p for p in beside.iterdir() if p.suffix.lower() in ENDINGS), beside / "official.csv"]
    return any(p.is_file() and p.stat().st_mtime > written for p in stating)
