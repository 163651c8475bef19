"""comparison.html: several sessions on one reference line, in the look of report.html and as safe and self-contained.

Which laps: of every session its best few that count. Differences carry their sigma and are called real only beyond so
many of it that luck hardly ever is; places of different days share no GPS offset, so most differences of the line are
within noise, and drawn so.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np

from smoother.arrays import Array
from smoother.laps.clock import local_day, local_zone
from smoother.laps.results import Corner, LapAnalysis, Statistics
from smoother.laps.sigma import are_real, significance_threshold
from smoother.laps.stored import Stored
from smoother.report.files import replacing
from smoother.report.page_charts import grip, linked, picker, styled
from smoother.report.page_corners import corner_name, lost_cell, usual_cell
from smoother.report.page_data import (
    Document,
    channel_traces,
    chosen_channels,
    cloud,
    corner_marks,
    described,
    gates,
    grid_columns,
    lap_traces,
    mean_line,
    packed,
    palette,
    stretches,
)
from smoother.report.page_html import (
    DASH,
    Child,
    element,
    lap_clock,
    number,
    parted,
    row,
    settings,
    speed_cell,
    table,
    time_cell,
)
from smoother.words import counted

MOST_LAPS = 6  # drawn of a session
GRIP = (
    "Each dot is the acceleration at one time. Grey: the first session; in colour: the laps and the part of the track "
    "shown above."
)
TITLE = "Comparison on one reference line"


@dataclass(frozen=True, eq=False)
class Compared:
    """One session: its name for people, its results, its laps on the common line.

    reference: index in the laps of the one that all are compared with, None where that is another session's. Names
    could not tell it: two sessions may be called alike.
    """

    name: str
    stored: Stored
    analysis: LapAnalysis
    reference: int | None = None

    @property
    def statistics(self) -> Statistics | None:
        """Figures of the laps that count, None where none does."""
        statistics = self.analysis.statistics
        return statistics if statistics is not None and statistics.best_lap is not None else None

    @property
    def why_not(self) -> str:
        """Why the session has no best lap; empty where it has one."""
        if self.statistics is not None:
            return ""
        if any(lap.is_timed for lap in self.analysis.laps):
            return "none of its laps counts"
        if any(problem.code == "driven_against" for problem in self.analysis.problems):
            return "was driven in the other direction; compare sessions of one direction"
        return "no whole lap on the reference line"

    @property
    def start(self) -> float | None:
        """UTC of the first row, s since 1970; None where unknown."""
        clock = self.stored.clock
        return None if clock is None else clock.at(float(self.stored.trajectory.t[0]))


def write_comparison(path: Path, compared: Sequence[Compared]) -> None:
    """Write the page of sessions that were analysed on the reference line of the first."""
    with replacing(path) as temporary:
        temporary.write_text(comparison(compared), encoding="utf-8", errors="replace")


def comparison(compared: Sequence[Compared]) -> str:
    """Return the page as text."""
    drawn = [(one, _drawn(one)) for one in compared]
    numbers = _numbers([pair for pair in drawn if pair[1]])
    names = [_lap_name(one, i) for one, laps in drawn for i in laps]
    about = "; ".join(one.name for one in compared)
    against = f"Everything is compared with {compared[0].analysis.reference_name}. ± is one sigma."
    head = element("div", element("h1", TITLE), element("p", about), element("p", against, class_="soft"))
    charts = [element("h2", "Map and traces", id="driving"), picker(names, stretches(compared[0].analysis))]
    note = (
        "Lines are relative to the mean line of the first session. The GPS error differs by metres from day to day; "
        "the band contains it, and what is grey is within that noise."
    )
    body = [
        element("header", head, settings()),
        element(
            "main",
            *_best_laps(compared),
            *charts,
            linked(numbers),
            element("p", note, class_="soft"),
            *_corners(compared),
            element("h2", "Grip: accelerations forward and sideways", id="circle-title"),
            grip(GRIP),
        ),
    ]
    return styled(f"{TITLE}: {about}", body, numbers)


def _drawn(one: Compared) -> list[int]:
    """Indices of the best laps with traces that count, or where none does that are timed; best first."""
    traces, laps = one.analysis.traces, one.analysis.laps
    if traces is None:
        return []
    timed = [i for i, lap in enumerate(laps) if lap.is_timed and np.isfinite(traces.speed[i]).sum() > 1]
    counting = [i for i in timed if laps[i].is_valid]
    return sorted(counting or timed, key=lambda i: laps[i].time)[:MOST_LAPS]


def _lap_name(one: Compared, i: int) -> str:
    return f"{one.name} lap {one.analysis.laps[i].number}"


def _named(one: Compared, more: str) -> Element:
    """The name of a session, which a narrow column parts at its signs, and what follows it."""
    return element("span", *parted(one.name), more)


def _numbers(drawn: list[tuple[Compared, list[int]]]) -> Document:
    """What the script draws; `drawn` holds the sessions that have laps, the first of all among them."""
    first = drawn[0][0]
    assert first.analysis.traces is not None and first.analysis.reference is not None
    middle = np.asarray(np.median(first.stored.trajectory.position_n[:, :2], axis=0))
    columns = grid_columns(first.stored.trajectory, first.analysis.traces)
    parts = []
    shared = {channel.name: channel for one, _ in drawn for channel in chosen_channels(one.stored.channels)}
    for one, laps in drawn:
        assert one.analysis.traces is not None
        part = lap_traces(one.analysis.traces, one.stored.trajectory, middle, laps, columns)
        is_reference = [i == one.reference for i in laps]
        cut = np.ix_(np.array(laps), columns)
        part |= channel_traces([c for c in one.stored.channels if c.name in shared], one.analysis.traces.t[cut])
        part["delta_sigma"] = np.where(np.array(is_reference)[:, None], 0.0, part["delta_sigma"])
        parts.append(part)
    shape = {name: [len(part["x"]) for part in parts] for name in {name for part in parts for name in part}}
    named = {name: np.concatenate([_or_nothing(part, name, part["x"]) for part in parts]) for name in shape}
    starts = np.cumsum([0, *(len(laps) for _, laps in drawn[:-1])]).tolist()
    best = min(range(len(drawn)), key=lambda k: drawn[k][0].analysis.laps[drawn[k][1][0]].time)
    return {
        "axis": "distance",
        "channels": described(list(shared.values())),
        "grid": packed(first.analysis.traces.distance[columns]),
        "points": len(columns) - 1,
        "traces": {name: packed(values) for name, values in named.items()},
        "laps": [{"name": _lap_name(one, i), "is_against": i == one.reference} for one, laps in drawn for i in laps],
        "best": starts[best],
        "first": [starts[best], *(start for start in starts if start != starts[best])],
        "against_name": first.analysis.reference_name,
        "corners": corner_marks(first.analysis, middle),
        "stretches": [list(part) for _, part in stretches(first.analysis)],
        "mean_line": mean_line(first.analysis.reference, middle),
        "palette": palette(),
        "gates": gates(first.analysis, middle),
        "cloud": cloud(first.stored.trajectory),
        "compared": None,
        "quality": None,
    }


def _or_nothing(part: dict[str, Array], name: str, like: Array) -> Array:
    return part[name] if name in part else np.full(like.shape, np.nan)


def _best_laps(compared: Sequence[Compared]) -> list[Element]:
    """The best lap of each session, what it lost, and how even the laps were."""
    sectors = max(one.analysis.sectors for one in compared)
    top = element("span", "top ", element("span", "km/h", class_="speed-unit"))
    starts = [start for one in compared if (start := one.start) is not None]
    heads: list[Child] = [
        "session",
        f"started ({local_zone(starts)})" if starts else "started",
        "laps",
        "best ± (s)",
        "lost (s)",
    ]
    heads += [*(f"S{i + 1} ±" for i in range(sectors)), "theoretical", "spread (s)", top]
    least = min((one.statistics.best for one in compared if one.statistics is not None), default=np.nan)
    lost = losses(compared)
    rows = [_best_row(one, sectors, least, lost[k]) for k, one in enumerate(compared)]
    threshold = f"at least {number(lost[0].threshold, 1)} times its ±"
    note = "Laps: number of laps that count. Lost: time lost to the best of all, with a star where it is real, that is "
    note += f"{threshold}. Top speed: that of the best lap."
    if any(one.statistics is not None and one.analysis.sigma_source == "stored" for one in compared):
        note += " The line was given after smoothing, so each ± is typical of its session and not of the single lap."
    best_laps = table(heads, rows, class_="tight")
    without = [element("p", f"{one.name}: {one.why_not}", class_="soft") for one in compared if one.why_not]
    return [element("h2", "Best laps", id="laps"), element("p", note, class_="soft"), best_laps, *without]


@dataclass(frozen=True)
class Loss:
    """Time lost by the best lap of a session over the whole lap, s, with its sigma; NaN unknown, or the lap itself.
    is_real: beyond `threshold` sigmas."""

    lost: float
    sigma: float
    is_real: bool
    threshold: float


def losses(compared: Sequence[Compared]) -> list[Loss]:
    """Return the time that the best lap of each session lost to the reference lap."""
    lost, sigma = np.array([_whole_lap(one) for one in compared]).T
    threshold = significance_threshold(lost, sigma)
    real = are_real(lost, sigma, threshold)
    return [Loss(float(a), float(b), bool(c), threshold) for a, b, c in zip(lost, sigma, real, strict=True)]


def _whole_lap(one: Compared) -> tuple[float, float]:
    statistics, traces = one.statistics, one.analysis.traces
    if statistics is None or traces is None or statistics.best_lap is None or statistics.best_lap == one.reference:
        return np.nan, np.nan
    return float(traces.delta[statistics.best_lap, -1]), float(traces.delta_sigma[statistics.best_lap, -1])


def _best_row(one: Compared, sectors: int, least: float, lost: Loss) -> Element:
    statistics, start = one.statistics, one.start
    name = element("span", *parted(one.name))
    started = DASH if start is None else local_day(start, with_zone=False)
    if statistics is None or statistics.best_lap is None:
        return row(name, started, "0", *[DASH] * (sectors + 5), class_="out")
    lap = one.analysis.laps[statistics.best_lap]
    times: list[Child] = [time_cell(float(t), float(s)) for t, s in zip(lap.sector_time, lap.sector_sigma, strict=True)]
    times += [DASH] * (sectors - len(times))
    known: list[Child] = [
        lap_clock(statistics.theoretical),
        "in noise" if statistics.spread == 0.0 else number(statistics.spread, 3),
        speed_cell(lap.top_speed),
    ]
    first: list[Child] = [
        name,
        started,
        str(statistics.counted),
        time_cell(statistics.best, statistics.best_sigma),
        _lost(lost),
    ]
    return row(*first, *times, *known, class_="best" if statistics.best == least else "")


def _lost(loss: Loss) -> Element:
    """A cell with the time that a whole lap lost to the reference lap."""
    if not np.isfinite(loss.lost):
        return element("td", DASH)
    small = element("small", f" ± {number(loss.sigma, 3)}" if np.isfinite(loss.sigma) else "")
    kind = ("slower" if loss.lost > 0.0 else "faster") if loss.is_real else "noise"
    return element("td", f"{number(loss.lost, 3, signed=True)}{'*' if loss.is_real else ''}", small, class_=kind)


def _corners(compared: Sequence[Compared]) -> list[Element]:
    """Time lost and slowest speed of the best laps in every corner, and how often a loss was real."""
    corners = compared[0].analysis.corners
    with_laps = [one for one in compared if one.statistics is not None and len(one.analysis.corners) == len(corners)]
    if not corners or not with_laps:
        return []
    note = (
        f"Seconds lost to {compared[0].analysis.reference_name} between the fastest places before and after each "
        "corner. Bold with a star: real, that is several times its ±, since some of so many losses are large by "
        "chance. The rest may be chance: ignore it."
    )
    heads = ["", *(corner_name(corner) for corner in corners)]
    lost, usual, slowest = [], [], []
    for one in with_laps:
        statistics, mine = one.statistics, one.analysis.corners
        assert statistics is not None and statistics.best_lap is not None
        best = statistics.best_lap
        lap = f" lap {one.analysis.laps[best].number}"
        lost.append(row(_named(one, lap), *(_lost_in(one, corner, best) for corner in mine)))
        counting = [i for i, lap in enumerate(one.analysis.laps) if lap.is_valid and i != one.reference]
        usual.append(row(_named(one, f", {counted(len(counting), 'lap')}"), *(_usual(c, counting) for c in mine)))
        slowest.append(row(_named(one, lap), *(speed_cell(float(corner.min_speed[best])) for corner in mine)))
    unit = element("span", "km/h", class_="speed-unit")
    return [
        element("h2", "Corners", id="corners"),
        element("p", note, class_="soft"),
        table(heads, lost, "Best laps: time lost (s)", class_="dense"),
        table(
            heads,
            usual,
            "All laps that count: median of the time lost (s), and the number of laps in which it is real",
            "dense",
        ),
        element("h3", "Slowest in the corner, ", unit),
        table(heads, slowest, class_="dense"),
    ]


def _lost_in(one: Compared, corner: Corner, lap: int) -> Element:
    return element("td", DASH) if lap == one.reference else lost_cell(corner, lap)


def _usual(corner: Corner, laps: list[int]) -> Element:
    real = int(np.count_nonzero(corner.is_real[laps]))
    return usual_cell(corner, element("small", f"real in {real}") if real else None)
