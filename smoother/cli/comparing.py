"""`smooth compare A B [C..]`: laps of several sessions, drivers or karts on one reference line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from smoother.cli.arguments import ABOUT_EXIT, EXIT_DONE, EXIT_QUALITY, json_option, require_sessions, sessions_argument
from smoother.cli.directories import require_no_recording
from smoother.cli.lap_tables import SIGMA_SOURCES, SPEED_UNITS
from smoother.cli.lapping import documents_of, line_option, stated_for, units_option
from smoother.cli.output import (
    number,
    open_page,
    plain,
    print_json,
    print_line,
    print_table,
    progress_on_terminal,
    warn,
)
from smoother.cli.results import results_of
from smoother.cli.session_names import session_names
from smoother.errors import UsageError
from smoother.laps.clock import lap_clock, local_time, local_zone
from smoother.laps.stage import Stated, analyse_rows, options_on, tracks_from

if TYPE_CHECKING:
    from smoother.laps.results import Lap, LapAnalysis, ReferenceLap
    from smoother.laps.stored import Stored
    from smoother.report.compare_page import Compared

PAGE = "comparison.html"


@click.command(short_help="Laps of several sessions on one reference line.", epilog=ABOUT_EXIT)
@sessions_argument
@line_option
@click.option("--against", metavar="NUMBER", type=int, help="Compare with lap NUMBER of the first session [the best].")
@click.option(
    "-o",
    "--out",
    metavar="FILE",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Where the page goes [smoothed/comparison.html of the first session].",
)
@click.option("--open", "open_it", is_flag=True, help="Show the page when done.")
@units_option
@json_option
def compare(
    sessions: tuple[Path, ...],
    line: str | None,
    against: int | None,
    out: Path | None,
    open_it: bool,
    units: str,
    as_json: bool,
) -> int:
    """Compare sessions, drivers or karts on one track: best laps, and the time lost to the best of all in each corner.

    Writes a page with map, traces and corners of all; it needs no network. Reference line and start/finish line are
    those of the first session, unless --line gives another start/finish line. Every difference has one sigma; `*` marks
    differences that are larger than their uncertainty explains.
    """
    require_sessions(sessions, "smooth compare")
    if len(sessions) < 2:
        raise UsageError("one session given; `smooth compare A B` needs two sessions or more")
    if out is not None:
        require_no_recording(out, sessions)
    wanted = None if line is None else tracks_from(line)
    with progress_on_terminal() as progress:
        found = [results_of(path, progress) for path in sessions]
        progress("comparing", 0.0)
        stated = stated_for(sessions[0], wanted, None)
        compared = compare_results(sessions, [directory for directory, _ in found], stated, against)
        page = written(out or found[0][0] / PAGE, compared)
    if as_json:
        from smoother.report.files import to_json

        print_json(to_json(document(compared)))
    else:
        show(compared, units)
        print_line("")
        print_line(str(page))
    if open_it:
        open_page(page)
    return EXIT_DONE if all(passed for _, passed in found) else EXIT_QUALITY


def written(path: Path, compared: list[Compared]) -> Path:
    """Write the page and return its path. Raises UsageError where that cannot be done."""
    from smoother.report.compare_page import write_comparison

    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_comparison(path, compared)
    except OSError as error:
        reason = error.strerror or error
        raise UsageError(f"{path}: cannot be written ({reason}); name another place with --out FILE") from error
    return path


def compare_results(
    sessions: Sequence[Path], directories: Sequence[Path], stated: Stated, against: int | None
) -> list[Compared]:
    """Return all sessions on the reference line of the first, deltas against the best lap of all (or `against`).

    directories: where the results of each session are. Raises UsageError when the first has no laps, or another was
    recorded elsewhere.
    """
    from smoother.laps.stored import read_stored
    from smoother.report.compare_page import Compared

    first = read_stored(directories[0])
    stored = [first, *(read_stored(directory, first.origin) for directory in directories[1:])]
    names = session_names(sessions, [one.document["session"] for one in stored])
    own = analyse_rows(first.trajectory, first.fixes, options_on(first.trajectory, first.origin, stated, first.drift))
    if own.reference is None or own.statistics is None:
        raise UsageError(f"{names[0]}: holds no whole lap, so there is no reference line; name another session first")
    for name, other in zip(names[1:], stored[1:], strict=True):
        _require_same_place(name, names[0], other, own)
    alone = [own, *(_on_line_of(own, other, None) for other in stored[1:])]
    chosen = _chosen(alone, against)
    if chosen is None:
        raise UsageError(f"{names[0]}: has no lap {against} that was timed from line to line")
    k, index = chosen
    lap = _reference_lap(names[k], stored[k], alone[k], index)
    made = [_on_line_of(own, one, lap) for one in stored]
    references = [_same_lap(made[i], alone[i].laps[index]) if i == k else None for i in range(len(made))]
    return [Compared(*one) for one in zip(names, stored, made, references, strict=True)]


def _require_same_place(name: str, first_name: str, other: Stored, own: LapAnalysis) -> None:
    """Raise UsageError where a session never came near the track."""
    import numpy as np

    assert own.reference is not None
    track = np.mean(own.reference.position_n, axis=0)
    distance = float(np.min(np.linalg.norm(other.trajectory.position_n[:, :2] - track, axis=1)))
    if distance > 5000.0:  # m between two sessions: not the same track
        raise UsageError(f"{name}: was driven {distance / 1000.0:.0f} km away from {first_name}; compare one track")


def _on_line_of(own: LapAnalysis, stored: Stored, lap: ReferenceLap | None) -> LapAnalysis:
    """Return the laps of a session on another's reference line, start/finish and sectors."""
    import numpy as np

    from smoother.laps.analysis import LapOptions
    from smoother.laps.results import GivenLines

    assert own.start_line is not None
    ends = [np.stack([line.left_n, line.right_n]) for line in (own.start_line, *own.sector_lines)]
    lines = GivenLines(ends[0], tuple(ends[1:]), name=own.track, source=own.start_line.source)
    options = LapOptions(lines=lines, reference=own.reference, reference_lap=lap, drift=stored.drift)
    return analyse_rows(stored.trajectory, stored.fixes, options)


def _chosen(alone: Sequence[LapAnalysis], against: int | None) -> tuple[int, int] | None:
    """The best lap of all, or lap `against` of the first session: index of the session, and of the lap in it."""
    if against is not None:
        timed = (i for i, lap in enumerate(alone[0].laps) if lap.number == against and lap.is_timed)
        return next(((0, i) for i in timed), None)
    best = [a.statistics.best if a.statistics is not None else float("nan") for a in alone]
    k = min((i for i, b in enumerate(best) if b == b), key=lambda i: best[i], default=0)
    index = alone[k].reference_lap
    return None if index is None else (k, index)


def _reference_lap(name: str, stored: Stored, analysis: LapAnalysis, index: int) -> ReferenceLap | None:
    """Lap `index` of a session, as the reference of all."""
    from dataclasses import replace

    from smoother.laps.analysis import reference_lap_of
    from smoother.laps.stage import analysed_rows

    named, rows = f"{name} lap {analysis.laps[index].number}", analysed_rows(stored.trajectory)
    return reference_lap_of(replace(analysis, reference_lap=index), rows, stored.fixes, named, stored.drift)


def _same_lap(analysis: LapAnalysis, lap: Lap) -> int:
    """Index of a lap in another analysis of the same drive: it begins when the lap began."""
    return min(range(len(analysis.laps)), key=lambda i: abs(analysis.laps[i].start - lap.start))


def document(compared: list[Compared]) -> dict[str, Any]:
    """Return the comparison for --json: `reference`, and the laps of each session against it."""
    return {
        "reference": compared[0].analysis.reference_name,
        "sessions": [
            {
                "session": one.name,
                "about": one.stored.document["session"],
                **documents_of(one.analysis, one.stored.origin),
            }
            for one in compared
        ],
    }


def show(compared: list[Compared], units: str) -> None:
    """Print best laps, and sectors and corners of each session's best lap relative to the best of all."""
    for one in compared:
        if one.why_not:
            warn(f"{one.name}: {one.why_not}")
    starts = [start for one in compared if (start := one.start) is not None]
    zone = f", times of day in {local_zone(starts)}" if starts else ""
    print_table(f"best laps{zone}", *_best_table(compared, units), left=-1)
    for source in _sources(compared):
        print_line(source)
    print_line("")
    print_table(f"lost against {plain(compared[0].analysis.reference_name)}, s", *_corner_table(compared), left=-1)
    print_line("")
    print_table(f"slowest in the corner, {units}", *_speed_table(compared, units), left=-1)


def _sources(compared: list[Compared]) -> list[str]:
    """The sources of the ± of laps, one line each, with their sessions where they differ."""
    by_source: dict[str, list[str]] = {}
    for one in compared:
        if one.statistics is not None:
            by_source.setdefault(SIGMA_SOURCES[one.analysis.sigma_source], []).append(plain(one.name))
    known = [(source, names) for source, names in by_source.items() if source]
    return [source if len(by_source) == 1 else f"{', '.join(names)}: {source}" for source, names in known]


def _best_table(compared: list[Compared], units: str) -> tuple[list[str], list[list[str]]]:
    sectors = max(one.analysis.sectors for one in compared)
    header = [
        "started",
        "laps",
        "best",
        "±",
        *(f"S{i + 1}" for i in range(sectors)),
        "theoretical",
        "spread",
        f"best lap's top {units}",
        "",
    ]
    rows = []
    for one in compared:
        statistics, laps = one.analysis.statistics, one.analysis.laps
        lap = None if statistics is None or statistics.best_lap is None else laps[statistics.best_lap]
        cells = ["-"] * (2 + sectors + 3)
        if statistics is not None and lap is not None:
            cells = [
                lap_clock(statistics.best),
                number(statistics.best_sigma, 3),
                *(lap_clock(float(t)) for t in lap.sector_time),
                *["-"] * (sectors - len(lap.sector_time)),
                lap_clock(statistics.theoretical),
                "in noise" if statistics.spread == 0.0 else number(statistics.spread, 3),
                number(lap.top_speed / SPEED_UNITS[units], 1),
            ]
        start = one.start
        started = "-" if start is None else local_time(start)
        rows.append([started, str(0 if statistics is None else statistics.counted), *cells, one.name])
    return header, rows


def _corner_table(compared: list[Compared]) -> tuple[list[str], list[list[str]]]:
    from smoother.report.compare_page import losses

    corners = compared[0].analysis.corners
    header = [*(f"{c.number}{'L' if c.turns_left else 'R'}" for c in corners), "lap", ""]
    rows = []
    for one, whole in zip(compared, losses(compared), strict=True):
        best = None if one.analysis.statistics is None else one.analysis.statistics.best_lap
        if best is None or len(one.analysis.corners) != len(corners):
            rows.append(["- "] * (len(corners) + 1) + [one.name])
            continue
        is_itself = best == one.reference
        cells = ["- " if is_itself else _lost(c.time_lost[best], c.is_real[best]) for c in one.analysis.corners]
        rows.append([*cells, "- " if is_itself else _lost(whole.lost, whole.is_real), one.name])
    return header, rows


def _lost(lost: float, is_real: bool) -> str:
    return "- " if lost != lost else f"{round(float(lost), 2) + 0.0:+.2f}{'*' if is_real else ' '}"


def _speed_table(compared: list[Compared], units: str) -> tuple[list[str], list[list[str]]]:
    corners = compared[0].analysis.corners
    rows = []
    for one in compared:
        best = None if one.analysis.statistics is None else one.analysis.statistics.best_lap
        if best is None or len(one.analysis.corners) != len(corners):
            rows.append(["-"] * len(corners) + [one.name])
            continue
        speeds = [number(float(c.min_speed[best]) / SPEED_UNITS[units], 1) for c in one.analysis.corners]
        rows.append([*speeds, one.name])
    return [*(f"{c.number}{'L' if c.turns_left else 'R'}" for c in corners), ""], rows
