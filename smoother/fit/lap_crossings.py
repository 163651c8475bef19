"""Where the laps of a session cross the stations of one common line: a lap beside a lap, at equal places.

Stations are even along one passage of the loop that the path repeats. Each is crossed once a lap, in the direction of
travel and about as far into the lap as it is along the line, so that a parallel straight is no crossing. A lap is what
lies between two crossings of the first station as far apart as the loop is long: a short cut, another layout, an
excursion and the other direction make none, and a slow lap is left out.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.loop import find_loop
from smoother.fit.plan_path import PlanPath
from smoother.fit.running import gaussian_mean

HOLE = 1.0  # s between fixes, over which nothing is crossed
STEP = 0.05  # s between the places at which crossings are looked for
REACH = 12.0  # m to either side of the line
BESIDE = 5.0  # m along the line, from a crossing to the places around it
OF_LENGTH, OF_PLACE = 0.04, 0.05  # of the loop: by how much laps differ in length, and places in a lap
LEAST_SHARE = 0.6  # of the stations that a lap has to cross, and of the laps that have to cross a station
SMOOTHED = 3.0  # m, one sigma, over which the passage is smoothed that the stations are on


@dataclass(frozen=True, eq=False)
class LapCrossings:
    """n laps at J stations: offset (n, J) m to the left of the line and time (n, J) s, NaN where a lap does not cross.

    normal_n (J, 2): unit vectors to the left; distance (J,) m along the line, which is `length` m long; time_of_lap s:
    median time of a lap.
    """

    offset: Array
    time: Array
    normal_n: Array
    distance: Array
    length: float
    time_of_lap: float


def cross_stations(t: Array, position_n: Array, spacing: float = 10.0) -> LapCrossings | None:
    """Return the crossings of stations `spacing` m apart by the path through fixes at t (N,) s, position_n (N, 2) m.

    None where there is no loop, or fixes are too rare.
    """
    known = np.flatnonzero(np.isfinite(position_n).all(axis=1))
    t, position_n = t[known], position_n[known]
    t, first = np.unique(t, return_index=True)
    position_n = position_n[first]
    # s between fixes at the most: a curve through rarer ones misses a corner by decimetres
    if len(t) < 8 or float(np.median(np.diff(t))) > 0.35:
        return None
    path = _path(t, position_n)
    after = np.clip(np.searchsorted(t, path.t), 1, len(t) - 1)
    is_hole: BoolArray = t[after] - t[after - 1] > HOLE
    loop = find_loop(path, 150.0, is_hole)  # m: the shortest lap
    if loop is None or loop.length < 4.0 * spacing:
        return None
    return _crossings(path, is_hole, loop.start, loop.end, spacing)


def _path(t: Array, position_n: Array) -> PlanPath:
    """The path through fixes every STEP, by parabolas through three of them; slow where there are none."""
    slope = np.gradient(position_n, t, axis=0)
    exact = PlanPath(t, position_n, slope, np.zeros(len(t)))
    at = np.arange(t[0], t[-1], STEP)
    place, _ = exact.at(at)
    reach = max(0.4, 1.01 * float(np.median(np.diff(t))))  # directions of travel need no detail
    ahead, behind = (exact.at(np.clip(at + way, t[0], t[-1]))[0] for way in (reach, -reach))
    return PlanPath(at, place, (ahead - behind) / (2.0 * reach), np.zeros(len(at)))


def _crossings(path: PlanPath, is_hole: BoolArray, start: float, end: float, spacing: float) -> LapCrossings | None:
    """Crossings of stations along the passage from `start` to `end`, s, by `path`, not in its holes, rows (N,)."""
    centre_n, tangent_n, distance, length = _stations(path, start, end, spacing)
    normal_n = np.stack([-tangent_n[:, 1], tangent_n[:, 0]], axis=1)
    lines = [_passages(path, is_hole, *line) for line in zip(centre_n, tangent_n, normal_n, strict=True)]
    laps = _laps(path, lines[0][0], length)
    if not len(laps):
        return None
    offset, time = np.full((2, len(laps), len(distance)), np.nan)
    starts = np.interp(laps, path.t, path.driven)
    for j, (at, beside) in enumerate(lines):
        driven = np.interp(at, path.t, path.driven)
        expected = starts[:, 0] + distance[j] / length * (starts[:, 1] - starts[:, 0])
        if len(at):
            nearest = np.argmin(np.abs(driven - expected[:, None]), axis=1)
            good = np.abs(driven[nearest] - expected) < max(20.0, OF_PLACE * length)  # m
            offset[good, j], time[good, j] = beside[nearest[good]], at[nearest[good]]
    usable = np.mean(np.isfinite(offset), axis=0) > LEAST_SHARE
    if np.count_nonzero(usable) < LEAST_SHARE * len(usable):
        return None
    whole = np.mean(np.isfinite(offset[:, usable]), axis=1) > LEAST_SHARE
    time_of_lap = float(np.median(laps[:, 1] - laps[:, 0]))
    return LapCrossings(
        offset[whole][:, usable], time[whole][:, usable], normal_n[usable], distance[usable], length, time_of_lap
    )


def _stations(path: PlanPath, start: float, end: float, spacing: float) -> tuple[Array, Array, Array, float]:
    """Centres and tangents (J, 2), distances (J,) m, and the length of the passage, m."""
    position_n, _ = path.at(np.linspace(start, end, max(16, round((end - start) / STEP))))
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(position_n, axis=0).T))])
    even = np.arange(0.0, along[-1])
    points = np.column_stack([np.interp(even, along, column) for column in position_n.T])
    points = gaussian_mean(points, SMOOTHED, is_closed=False)
    slope = np.gradient(points, axis=0)
    slope /= np.hypot(slope[:, 0], slope[:, 1])[:, None]
    distance = np.arange(0.0, even[-1] - 0.5 * spacing, spacing)
    centre, tangent = (np.column_stack([np.interp(distance, even, x) for x in of.T]) for of in (points, slope))
    return centre, tangent, distance, float(along[-1])


def _passages(
    path: PlanPath, is_hole: BoolArray, centre_n: Array, tangent_n: Array, normal_n: Array
) -> tuple[Array, Array]:
    """Times (M,) s at which the path crosses a station forwards, and offsets (M,) m to the left there."""
    away = path.position_n - centre_n
    along, beside = away @ tangent_n, away @ normal_n
    over = (along[:-1] <= 0.0) & (along[1:] > 0.0) & (along[:-1] > -BESIDE) & (np.abs(beside[:-1]) < REACH)
    k = np.flatnonzero(over & ~is_hole[:-1])
    share = along[k] / (along[k] - along[k + 1])
    return path.t[k] + share * (path.t[k + 1] - path.t[k]), beside[k] + share * (beside[k + 1] - beside[k])


def _laps(path: PlanPath, at: Array, length: float) -> Array:
    """Start and end (n, 2) s of the laps between crossings at times `at` (M,) s of the first station."""
    driven = np.interp(at, path.t, path.driven)
    is_lap = np.abs(np.diff(driven) - length) < OF_LENGTH * length
    laps = np.stack([at[:-1], at[1:]], axis=1)[is_lap]
    if not len(laps):
        return laps
    took = laps[:, 1] - laps[:, 0]
    return np.asarray(laps[took < 1.3 * took.min()])  # times the quickest lap's time
