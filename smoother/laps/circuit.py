"""The track of a session: reference line, track distance of every row, and start/finish line.

Found from the path alone; a given line only moves the zero. A closed track comes from the loop
that the path repeats, or from two passages of a given line; an open one from a passage of a given start and finish.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.loop import find_loop
from smoother.fit.plan_path import PlanPath
from smoother.laps.follow import Followed, follow, refollow
from smoother.laps.line import BESIDE, best_place, both_ways, line_across, meeting_places, oriented
from smoother.laps.reference import Curve, first_line, mean_line, open_line, shifted
from smoother.laps.results import GivenLines, Line, ReferenceLine
from smoother.laps.timing import gate_crossings
from smoother.laps.wrong_direction import driven_against
from smoother.samples import Problem

USUAL = 1.2  # of the quickest lap's time per metre: slower laps do not shape the reference line


@dataclass(frozen=True, eq=False)
class Circuit:
    """The track and the kart on it. curve, with its zero at the start line; followed; start_line; sector_lines as
    given; finish_line and open curve for point-to-point. problems of the lines."""

    curve: Curve
    followed: Followed
    start_line: Line
    sector_lines: tuple[Line, ...] = ()
    finish_line: Line | None = None
    problems: tuple[Problem, ...] = ()


def find_circuit(
    path: PlanPath,
    lines: GivenLines | None,
    reference: ReferenceLine | None,
    shortest: float,
    blind: BoolArray | None = None,
) -> Circuit | Problem:
    """Return the track, or the problem with the reason.

    shortest m: no lap is shorter. blind (N,): rows in gaps of the fixes, which are not used for the line.
    """
    blind = np.zeros(len(path.t), dtype=np.bool_) if blind is None else blind
    if lines is not None and lines.finish is not None:
        return _point_to_point(path, lines, lines.finish, shortest)
    if reference is not None:
        curve = Curve(reference)
        followed = follow(path, curve)
    else:
        first = _first_curve(path, lines, shortest, blind)
        if first is None:
            return _no_loop(lines)
        curve, followed = _mean(path, first, blind)
    if not followed.is_on.any():
        never = Problem("no_loop", "the path never follows the reference line; no laps")
        return next(driven_against(path, curve, followed), never)
    return _with_lines(path, curve, followed, lines, keep_zero=reference is not None)


def _no_loop(lines: GivenLines | None) -> Problem:
    text = "the path does not come back to the same place in the same direction; no laps"
    if lines is not None:
        text = "the line was not passed twice in the same direction; no whole lap"
    return Problem("no_laps", text)


def _first_curve(path: PlanPath, lines: GivenLines | None, shortest: float, blind: BoolArray) -> Curve | None:
    loop = find_loop(path, shortest, blind)
    if loop is not None:
        return Curve(first_line(path, loop.start, loop.end))
    if lines is None:
        return None
    passages = _between_gates(path, lines.start, lines.start, shortest)
    return None if passages is None else Curve(first_line(path, *passages))


def _between_gates(path: PlanPath, start: Array, end: Array, shortest: float) -> tuple[float, float] | None:
    """The quickest passage (start, end) s from one gate to another, in either direction."""
    best: tuple[float, float] | None = None
    for forward in both_ways(start):
        t0 = gate_crossings(path, oriented("", start, forward, ""), BESIDE)
        ways = [forward] if end is start else both_ways(end)
        t1 = np.sort(np.concatenate([gate_crossings(path, oriented("", end, way, ""), BESIDE) for way in ways]))
        for t in t0:
            driven = np.interp(t1, path.t, path.driven) - np.interp(t, path.t, path.driven)
            later = t1[(t1 > t) & (driven > shortest)]
            if later.size and (best is None or later[0] - t < best[1] - best[0]):
                best = (float(t), float(later[0]))
    return best


def _mean(path: PlanPath, curve: Curve, blind: BoolArray) -> tuple[Curve, Followed]:
    """Move the line to the mean of the laps."""
    followed = follow(path, curve)
    for _ in range(2):  # times that the line is moved to the mean of the laps; the second time by centimetres
        lateral, up = laps_on_line(path, curve, followed, blind)
        if len(lateral) < 2:
            break
        moved = Curve(mean_line(curve.line, lateral, up))
        curve, followed = moved, refollow(path, curve, followed, moved)
    return curve, followed


def laps_on_line(path: PlanPath, curve: Curve, followed: Followed, blind: BoolArray) -> tuple[Array, Array]:
    """Offset to the left and height (L, P) m, at the line's points, of whole laps at the usual pace.

    NaN in gaps of the fixes, rows `blind` (N,), where the path is uncertain.
    """
    numbers, pace, rows = [], [], []
    lap = np.floor(followed.distance / curve.length)
    seen = np.unique(lap[followed.is_on])
    order = np.argsort(lap, kind="stable")
    lap = lap[order]
    starts, ends = np.searchsorted(lap, seen), np.searchsorted(lap, seen, side="right")
    for number, start, end in zip(seen, starts, ends, strict=True):
        r = order[start:end]
        covered = np.ptp(followed.distance[r])
        if len(r) < 8 or covered < 0.5 * curve.length or np.mean(followed.is_on[r]) < 0.8:
            continue
        numbers.append(number)
        pace.append((path.t[r[-1]] - path.t[r[0]]) / covered)
        rows.append(r)
    at = curve.line.distance
    lateral, up = np.full((len(rows), len(at)), np.nan), np.full((len(rows), len(at)), np.nan)
    for i, (number, r) in enumerate(zip(numbers, rows, strict=True)):
        if pace[i] > USUAL * min(pace):
            continue
        on = r[followed.is_on[r]]
        within = np.maximum.accumulate(followed.distance[on] - number * curve.length)
        inside = (at >= within[0]) & (at <= within[-1])
        lateral[i, inside] = np.interp(at[inside], within, followed.lateral[on])
        up[i, inside] = np.interp(at[inside], within, path.up[on])
        lateral[i, np.interp(at, within, blind[on].astype(np.float64)) > 0.0] = np.nan
    kept = np.isfinite(lateral).any(axis=1)
    lateral, up = lateral[kept], up[kept]
    if len(lateral) > 2:
        # m from the median of the laps, beyond which one does not shape the line there
        odd = np.abs(lateral - _median(lateral)) > 6.0
        lateral[odd] = np.nan
    return lateral, up


def _median(values: Array) -> Array:
    """Median (P,) of the known values of each column; 0 where there are none."""
    known = np.isfinite(values)
    filled = np.where(known.any(axis=0), values, 0.0)
    return np.asarray(np.nanmedian(filled, axis=0))


def _with_lines(
    path: PlanPath, curve: Curve, followed: Followed, lines: GivenLines | None, *, keep_zero: bool
) -> Circuit:
    """Move the zero of the track to the start line."""
    problems: list[Problem] = []
    zero: float | None = 0.0 if keep_zero else None
    given = None
    if lines is not None:
        places = meeting_places(curve, lines.start)
        if places.size == 0:
            problems.append(
                Problem("line_missed", f"the track does not pass the given line{_named(lines)}; one was found instead")
            )
        else:
            if places.size > 1:
                text = f"the given line is passed {places.size} times a lap; the passage nearest its middle counts"
                problems.append(Problem("line_passed_often", text))
            zero, given = float(places[0]), lines.start
    if zero is None:
        zero = best_place(curve, usual_speed(path, curve, followed), _laps_at(curve, followed))
    if zero != 0.0:
        curve = Curve(shifted(curve.line, zero))
        followed = replace(followed, distance=followed.distance - zero)
    if given is not None and lines is not None:
        forward = curve.tangent(np.zeros(1))[0]
        start = oriented("start/finish", given, forward, lines.source, 0.0)
    else:
        start = line_across(curve, 0.0, "start/finish", _spread(curve, followed))
    sectors = () if lines is None or given is None else _given_sectors(curve, lines, problems)
    problems += driven_against(path, curve, followed)
    return Circuit(curve, followed, start, sectors, None, tuple(problems))


def _named(lines: GivenLines) -> str:
    return f" of {lines.name}" if lines.name else ""


def _given_sectors(curve: Curve, lines: GivenLines, problems: list[Problem]) -> tuple[Line, ...]:
    """Sector lines where they meet the track, in driving order."""
    found: list[Line] = []
    for number, ends in enumerate(lines.sectors, start=1):
        places = meeting_places(curve, ends)
        places = places[(places > 1.0) & (places < curve.length - 1.0)]
        if places.size == 0:
            problems.append(Problem("sector_missed", f"the track does not pass the line at the end of sector {number}"))
            continue
        at = float(places[0])
        found.append(oriented(f"sector {number}", ends, curve.tangent(np.array([at]))[0], lines.source, at))
    return tuple(sorted(found, key=lambda line: line.distance))


def _spread(curve: Curve, followed: Followed) -> float:
    """Largest usual offset of laps from the reference line near its zero, m."""
    near = followed.is_on & (np.abs(np.mod(followed.distance + 20.0, curve.length) - 20.0) < 20.0)
    return float(np.quantile(np.abs(followed.lateral[near]), 0.95)) if near.any() else 0.0


def usual_speed(path: PlanPath, curve: Curve, followed: Followed) -> Array:
    """Median speed (P,) m/s at the points of the line."""
    on = followed.is_on
    index = np.floor(curve.wrapped(followed.distance[on]) / curve.length * len(curve.line.distance)).astype(np.int64)
    index = np.clip(index, 0, len(curve.line.distance) - 1)
    by_speed = np.argsort(path.speed[on])
    small = index[by_speed].astype(np.min_scalar_type(len(curve.line.distance)))  # 16 bits are sorted many times faster
    order = by_speed[np.argsort(small, kind="stable")]
    index, speed = index[order], path.speed[on][order]
    places, first, count = np.unique(index, return_index=True, return_counts=True)
    medians = 0.5 * (speed[first + (count - 1) // 2] + speed[first + count // 2])
    period = len(curve.line.distance) if curve.line.is_closed else None
    return np.asarray(np.interp(np.arange(len(curve.line.distance)), places, medians, period=period))


def _laps_at(curve: Curve, followed: Followed) -> Array:
    """How many whole laps (P,) a line at each point would give."""
    on = followed.distance[followed.is_on]
    first, last = float(on[0]), float(np.max(on))
    at = curve.line.distance
    return np.asarray(np.floor((last - at) / curve.length) - np.ceil((first - at) / curve.length))


def _point_to_point(path: PlanPath, lines: GivenLines, finish: Array, shortest: float) -> Circuit | Problem:
    passage = _between_gates(path, lines.start, finish, shortest)
    if passage is None:
        return Problem("no_laps", "the finish line was not passed after the start line; no whole run")
    curve = Curve(open_line(path, *passage))
    followed = follow(path, curve)
    problems: list[Problem] = []
    ends = curve.tangent(np.array([0.0, curve.length]))
    start = oriented("start", lines.start, ends[0], lines.source, 0.0)
    end = oriented("finish", finish, ends[1], lines.source, curve.length)
    return Circuit(curve, followed, start, _given_sectors(curve, lines, problems), end, tuple(problems))
