"""The numbers that the charts of report.html are drawn from: at most 20 rows a second, float32 in base64.

Maps are in metres east (x) and north (y) of the middle of the path; accelerations m/s^2, speeds m/s, times s. Every
trace is (L, M): L laps over a common grid of track distance, or the whole session as one lap over time.
"""

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import to_hex

from smoother.arrays import Array, IntArray
from smoother.laps.path import level_acceleration
from smoother.laps.results import Lap, LapAnalysis, Line, ReferenceLine, Traces
from smoother.laps.top_speed import reliable_rows, speed_sigma
from smoother.report.summary import fastest_row
from smoother.samples import Channel, Session
from smoother.trajectory import Trajectory
from smoother.units import DEG, STANDARD_GRAVITY

MOST_RATE = 20.0  # Hz of any trace
FIX_RATE = 4.0  # Hz of what is shown of fixes, the worst of each bin
WITHOUT_LAPS = 60.0  # s around the top speed, compared with the baseline where there is no lap
MOST_DRAWN = 300  # laps, five hours of them; a page with a day's would take a browser minutes to open
MOST_SLOW = 60_000  # of what is drawn of quality over time, likewise
SHADES = 16
MOST_CHANNELS = 12  # of the logger that are drawn below one another
FIRST_CHANNELS = ("rpm", "throttle", "brake", "steering", "gear", "water", "temp", "lambda", "pressure", "heart")
OF_LINE = ("offset", "offset_sigma", "is_off")
Document = dict[str, object]


@dataclass(frozen=True, eq=False)
class Numbers:
    """Sources of the numbers. smoothed: any rate; baseline, laps: None where there are none."""

    session: Session
    smoothed: Trajectory
    baseline: Trajectory | None
    laps: LapAnalysis | None

    @property
    def traces(self) -> Traces | None:
        """The traces of the laps, None without laps."""
        return None if self.laps is None else self.laps.traces

    @property
    def middle(self) -> Array:
        """Origin of maps, (2,) m north and west."""
        return np.asarray(np.median(self.smoothed.position_n[:, :2], axis=0))


def packed(values: Array) -> str:
    """Return an array as little-endian float32 in base64."""
    return base64.b64encode(np.ascontiguousarray(values, dtype="<f4").tobytes()).decode("ascii")


def page_data(numbers: Numbers) -> Document:
    """Return everything that the script needs."""
    shown = _whole_session(numbers) if numbers.traces is None else _laps(numbers, numbers.traces)
    return {
        **shown,
        "channels": described(shown_channels(numbers)),
        "palette": palette(),
        "gates": gates(numbers.laps, numbers.middle),
        "cloud": cloud(numbers.smoothed),
        "compared": _compared(numbers),
        "quality": _quality(numbers),
    }


def palette() -> list[str]:
    """Return the colours of speed, slow to fast."""
    return [to_hex(colour) for colour in colormaps["viridis"](np.linspace(0.05, 1.0, SHADES))]


def drawn_laps(laps: LapAnalysis) -> list[int]:
    """Return the indices of the laps that have any trace; of more than MOST_DRAWN the quickest that count."""
    if laps.traces is None:
        return []
    drawn = [i for i in range(len(laps.laps)) if np.isfinite(laps.traces.speed[i]).sum() > 1]
    if len(drawn) <= MOST_DRAWN:
        return drawn

    def slowness(i: int) -> tuple[bool, float]:
        lap = laps.laps[i]
        return not lap.is_valid, lap.time if lap.is_timed else np.inf

    return sorted(sorted(drawn, key=slowness)[:MOST_DRAWN])


def lap_name(lap: Lap) -> str:
    """Return the name of a lap: its number, and why it does not count."""
    return f"lap {lap.number}" + (f" ({', '.join(lap.reasons)})" if lap.reasons else "")


def main_lap(laps: LapAnalysis) -> int:
    """Return the index of the lap that is shown first: the best, else the one compared with, else the first drawn."""
    best = None if laps.statistics is None else laps.statistics.best_lap
    if best is None:
        best = laps.reference_lap
    return drawn_laps(laps)[0] if best is None else best


def _laps(numbers: Numbers, traces: Traces) -> Document:
    laps = numbers.laps
    assert laps is not None
    drawn = drawn_laps(laps)
    columns = grid_columns(numbers.smoothed, traces)
    named = lap_traces(traces, numbers.smoothed, numbers.middle, drawn, columns)
    named |= channel_traces(shown_channels(numbers), traces.t[np.ix_(np.array(drawn), columns)])
    if sum(lap.is_valid for lap in laps.laps) < 2:  # a single lap is its own mean
        named = {name: values for name, values in named.items() if name not in OF_LINE}
    main = drawn.index(main_lap(laps))
    against = laps.reference_lap
    return {
        "axis": "distance",
        "grid": packed(traces.distance[columns]),
        "points": len(columns) - 1,
        "traces": {name: packed(values) for name, values in named.items()},
        "laps": [{"name": lap_name(laps.laps[i]), "is_against": i == against} for i in drawn],
        "best": main,
        "first": _first(laps, drawn, main),
        "against_name": laps.reference_name if against is None else f"lap {laps.laps[against].number}",
        "corners": corner_marks(laps, numbers.middle),
        "stretches": [list(part) for _, part in stretches(laps)],
        "mean_line": None if laps.reference is None else mean_line(laps.reference, numbers.middle),
    }


def shown_channels(numbers: Numbers) -> list[Channel]:
    """Return the channels of the logger that are drawn: at most MOST_CHANNELS, FIRST_CHANNELS first."""
    return chosen_channels(numbers.session.channels)


def chosen_channels(channels: Sequence[Channel]) -> list[Channel]:
    """Return at most MOST_CHANNELS of the channels, FIRST_CHANNELS first."""

    def place(channel: Channel) -> int:
        return next((i for i, word in enumerate(FIRST_CHANNELS) if word in channel.name), len(FIRST_CHANNELS))

    return sorted(channels, key=place)[:MOST_CHANNELS]


def described(channels: Sequence[Channel]) -> list[Document]:
    """Return the names of the traces of channels, and their titles."""
    return [{"name": trace_of(channel.name), "title": channel.name.replace("_", " ")} for channel in channels]


def trace_of(name: str) -> str:
    """Return the unique name of the trace of a channel."""
    return f"logged {name}"


def channel_traces(channels: Sequence[Channel], t: Array) -> dict[str, Array]:
    """Return the channels at times t of any shape, NaN in their gaps, by name."""
    return {trace_of(channel.name): channel.at(np.nan_to_num(t, nan=-np.inf)) for channel in channels}


def grid_columns(smoothed: Trajectory, traces: Traces) -> IntArray:
    """Return the points of the grid that are drawn: no more than the rate allows where the kart is fastest."""
    return np.arange(0, len(traces.distance), _grid_step(smoothed, traces))


def _grid_step(smoothed: Trajectory, traces: Traces) -> int:
    fastest = smoothed.speed[fastest_row(smoothed)]
    return max(1, int(np.ceil(fastest / (MOST_RATE * _spacing(traces.distance)))))


def lap_traces(
    traces: Traces, smoothed: Trajectory, middle: Array, drawn: list[int], columns: IntArray
) -> dict[str, Array]:
    """Return the traces of laps `drawn` at the points `columns` of the grid, each (L, M)."""
    cut = np.ix_(np.array(drawn), columns)
    x, y = places(smoothed, middle, traces.t[cut])
    return {
        "x": x,
        "y": y,
        "speed": traces.speed[cut],
        "delta": traces.delta[cut],
        "delta_sigma": traces.delta_sigma[cut],
        "longitudinal": traces.longitudinal[cut],
        "sideways": traces.lateral_acceleration[cut],
        "offset": traces.lateral[cut],
        "offset_sigma": traces.lateral_sigma[cut],
        "is_off": np.where(traces.is_off_line[cut], 1.0, 0.0),
        **_slides(traces.sideslip[cut] / DEG, traces.sideslip_sigma[cut] / DEG),
        **_reliability(smoothed, traces.t[cut]),
    }


def _slides(sideslip: Array, sigma: Array) -> dict[str, Array]:
    return {"sideslip": sideslip, "sideslip_sigma": sigma} if np.isfinite(sideslip).any() else {}


def _reliability(smoothed: Trajectory, t: Array) -> dict[str, Array]:
    """1 where the speed at times t of any shape is reliable, else 0; empty unless the highest one is not."""
    speed, reliable = smoothed.speed, reliable_rows(smoothed.speed, speed_sigma(smoothed))
    if not reliable.any() or not (speed[~reliable] > speed[reliable].max()).any():
        return {}
    return {"is_sure": np.where(np.interp(t, smoothed.t, reliable.astype(np.float64)) == 1.0, 1.0, 0.0)}


def _spacing(distance: Array) -> float:
    return float(np.median(np.diff(distance))) if len(distance) > 1 else 2.0


def places(smoothed: Trajectory, middle: Array, t: Array) -> tuple[Array, Array]:
    """Return metres east and north of the middle at times t of any shape, NaN where t is."""
    y = np.interp(t, smoothed.t, smoothed.position_n[:, 0] - middle[0])
    x = np.interp(t, smoothed.t, middle[1] - smoothed.position_n[:, 1])
    return x, y


def _first(laps: LapAnalysis, drawn: list[int], main: int) -> list[int]:
    """The laps shown at first: the best, and the next best that counts."""
    others = [i for i, lap in enumerate(drawn) if i != main and laps.laps[lap].is_valid]
    return [main, *sorted(others, key=lambda i: laps.laps[drawn[i]].time)[:1]]


def stretches(laps: LapAnalysis) -> list[tuple[str, tuple[float, float]]]:
    """Return names and ends (m) of the selectable parts of the track: every corner, every sector."""
    parts = [(f"corner {c.number} ({'left' if c.turns_left else 'right'})", c.segment) for c in laps.corners]
    if laps.traces is None:
        return parts
    ends = [0.0, *(line.distance for line in laps.sector_lines), float(laps.traces.distance[-1])]
    if len(ends) > 2 and np.isfinite(ends).all():
        parts += [(f"sector {i + 1}", (ends[i], ends[i + 1])) for i in range(len(ends) - 1)]
    return parts


def corner_marks(laps: LapAnalysis, middle: Array) -> list[Document]:
    """Return the positions of the corner numbers on map and traces."""
    if laps.reference is None:
        return []
    line, (north, west) = laps.reference, middle
    out: list[Document] = []
    for corner in laps.corners:
        k = int(np.argmin(np.abs(line.distance - corner.apex)))
        outward = np.array([line.tangent_n[k, 0], line.tangent_n[k, 1]]) * (1.0 if corner.turns_left else -1.0)
        place = {"x": west - line.position_n[k, 1], "y": line.position_n[k, 0] - north}
        where = {"start": corner.start, "apex": corner.apex, "end": corner.end}
        direction = {"out_x": outward[0], "out_y": outward[1]}
        rounded = {name: round(float(value), 2) for name, value in {**place, **where, **direction}.items()}
        out.append({"number": str(corner.number), **rounded})
    return out


def mean_line(line: ReferenceLine, middle: Array) -> Document:
    """Return the reference line on the map."""
    points = line.position_n[::2]
    if line.is_closed:
        points = np.concatenate([points, line.position_n[:1]])
    return {"x": packed(middle[1] - points[:, 1]), "y": packed(points[:, 0] - middle[0])}


def gates(laps: LapAnalysis | None, middle: Array) -> list[Document]:
    """Return the lines of start, finish and sectors on the map."""
    if laps is None or laps.start_line is None:
        return []
    ends = [laps.start_line, *([] if laps.finish_line is None else [laps.finish_line])]
    return [_gate(line, middle, True) for line in ends] + [_gate(line, middle, False) for line in laps.sector_lines]


def _gate(line: Line, middle: Array, is_start: bool) -> Document:
    points = np.stack([line.left_n, line.right_n])
    x, y = middle[1] - points[:, 1], points[:, 0] - middle[0]
    return {"x": np.round(x, 2).tolist(), "y": np.round(y, 2).tolist(), "is_start": is_start}


def _thin_rows(t: Array, rate: float, most: int) -> np.ndarray:
    """Indices of rows that are at most `rate` a second, and not more than `most` in all."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 1.0
    return np.arange(0, len(t), max(1, int(np.ceil(1.0 / (rate * step) - 1e-6)), -(-len(t) // most)))


def _whole_session(numbers: Numbers) -> Document:
    smoothed = numbers.smoothed
    # of the whole session where it has no laps, four hours at their usual rate
    rows = _thin_rows(smoothed.t, 0.5 * MOST_RATE, 150_000)
    acceleration = level_acceleration(smoothed)[rows]
    x, y = places(smoothed, numbers.middle, smoothed.t[rows])
    named = {
        "x": x,
        "y": y,
        "speed": smoothed.speed[rows],
        "longitudinal": acceleration[:, 0],
        "sideways": acceleration[:, 1],
        **_reliability(smoothed, smoothed.t[rows]),
        **channel_traces(shown_channels(numbers), smoothed.t[rows]),
    }
    return {
        "axis": "time",
        "grid": packed(smoothed.t[rows] - smoothed.t[0]),
        "points": len(rows) - 1,
        "traces": {name: packed(values) for name, values in named.items()},
        "laps": [{"name": "whole session"}],
        "best": 0,
        "first": [0],
        "against_name": "",
        "corners": [],
        "stretches": [],
        "mean_line": None,
    }


def cloud(smoothed: Trajectory) -> Document:
    """Return accelerations in g where the speed is reliable, and the radius that contains nearly all."""
    reliable = reliable_rows(smoothed.speed, speed_sigma(smoothed))
    moving = np.flatnonzero((smoothed.speed > 2.0) & reliable)
    rows = moving[:: max(1, -(-len(moving) // 4000))]  # points of the g-g diagram
    g = level_acceleration(smoothed)[rows] / STANDARD_GRAVITY
    size = np.hypot(g[:, 0], g[:, 1])
    size = size[np.isfinite(size)]
    reach = float(np.percentile(size, 99.5)) if size.size else 1.0
    g = g[np.hypot(g[:, 0], g[:, 1]) <= 1.15 * reach]
    return {"right": packed(-g[:, 1]), "forward": packed(g[:, 0]), "reach": round(1.12 * reach, 3)}


def compared_times(numbers: Numbers) -> tuple[float, float]:
    """Return the times (s) between which baseline and smoother are drawn: the main lap, else around the top speed."""
    t = numbers.smoothed.t
    if numbers.laps is not None and numbers.traces is not None:
        lap = numbers.laps.laps[main_lap(numbers.laps)]
        return max(lap.start, float(t[0])), min(lap.end, float(t[-1]))
    middle = float(t[fastest_row(numbers.smoothed)])
    return max(float(t[0]), middle - 0.5 * WITHOUT_LAPS), min(float(t[-1]), middle + 0.5 * WITHOUT_LAPS)


def _compared(numbers: Numbers) -> Document:
    start, end = compared_times(numbers)
    t = np.linspace(start, end, max(2, int(0.5 * MOST_RATE * (end - start))))
    north, west = numbers.middle
    x, y = places(numbers.smoothed, numbers.middle, t)
    smoothed, baseline, gnss = numbers.smoothed, numbers.baseline, numbers.session.gnss
    out: Document = {"t": packed(t - start), "x": packed(x), "y": packed(y)}
    out["speed"] = packed(np.interp(t, smoothed.t, smoothed.speed))
    out |= {name: packed(values) for name, values in _reliability(smoothed, t).items()}
    if baseline is not None:
        out["baseline_x"] = packed(np.interp(t, baseline.t, west - baseline.position_n[:, 1]))
        out["baseline_y"] = packed(np.interp(t, baseline.t, baseline.position_n[:, 0] - north))
        out["baseline_speed"] = packed(np.interp(t, baseline.t, baseline.speed))
    inside = (gnss.t >= start) & (gnss.t <= end)
    fixes = numbers.session.fix_position_n[inside]
    out["fix_t"] = packed(gnss.t[inside] - start)
    out["fix_x"], out["fix_y"] = packed(west - fixes[:, 1]), packed(fixes[:, 0] - north)
    if numbers.laps is not None and numbers.traces is not None:
        step = _grid_step(smoothed, numbers.traces)
        out["grid_t"] = packed(_filled(numbers.traces.t[main_lap(numbers.laps)][::step] - start))
    return out


def _filled(values: Array) -> Array:
    known = np.isfinite(values)
    return np.asarray(np.interp(np.arange(len(values)), np.flatnonzero(known), values[known]))


def _quality(numbers: Numbers) -> Document:
    smoothed, gnss = numbers.smoothed, numbers.session.gnss
    start, sigmas, fixes = smoothed.t[0], smoothed.sigmas, smoothed.report.fixes
    rows = _thin_rows(smoothed.t, 2.0, MOST_SLOW)  # Hz of what changes slowly: sigmas
    out: Document = {"t": packed(smoothed.t[rows] - start)}
    if sigmas is not None:
        out["sigma"] = packed(np.hypot(sigmas.position_n[rows, 0], sigmas.position_n[rows, 1]))
        out["sigma_track"] = packed(sigmas.track[rows])
    if fixes is not None and len(fixes.index):
        left = np.hypot(fixes.residual_n[:, 0], fixes.residual_n[:, 1])
        t, doubted = gnss.t[fixes.index] - start, fixes.weight < 0.5
        worst = _worst_rows(t, np.where(np.isfinite(left), left, -1.0) + np.where(doubted, 1e6, 0.0))
        left, doubted = left[worst], doubted[worst]
        out["fix_t"] = packed(t[worst])
        out["residual"] = packed(np.where(doubted, np.nan, left))
        out["doubted"] = packed(np.where(doubted, left, np.nan))
        known = left[np.isfinite(left) & ~doubted]
        out["cap"] = round(1.5 * float(np.percentile(known, 99)), 3) if known.size else 1.0
    if len(gnss) > 2:
        between = np.diff(gnss.t)
        worst = _worst_rows(gnss.t[1:], between)
        out["fix_all_t"], out["interval"] = packed(gnss.t[1:][worst] - start), packed(between[worst])
    return out


def _worst_rows(t: Array, badness: Array) -> np.ndarray:
    """Indices of the worst row of each 1/FIX_RATE seconds, of more where that would be more than MOST_SLOW."""
    rate = min(FIX_RATE, MOST_SLOW / max(float(t[-1] - t[0]), 1e-9))
    cell = np.floor((t - t[0]) * rate).astype(np.int64)
    order = np.lexsort((-badness, cell))
    first = np.concatenate([[True], np.diff(cell[order]) > 0])
    return np.asarray(order[first])
