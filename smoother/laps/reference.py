"""The reference line: the mean of the laps, smooth, and places on it: track distance and lateral offset.

A closed line is a periodic cubic spline through points a metre apart; an open one (point-to-point) an ordinary one.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from smoother.arrays import Array
from smoother.fit.plan_path import PlanPath
from smoother.fit.running import gaussian_mean
from smoother.fit.spline import CubicSpline
from smoother.frames import to_left
from smoother.laps.results import ReferenceLine

SPACING = 1.0  # m between points of the line
SMOOTHED_OVER = 2.0  # m, one sigma: steps where lap ends were joined, not corners, which are longer
BENT = 0.9  # of the radius: farther inside a corner the projection is not unique


@dataclass(frozen=True, eq=False)
class Curve:
    """A reference line that can be evaluated anywhere; distances wrap around where it is closed."""

    line: ReferenceLine

    @property
    def length(self) -> float:
        """Length of the lap, m."""
        return self.line.length

    def position(self, distance: Array) -> Array:
        """Position (K, 2) m in n."""
        return self._spline(self.wrapped(distance))

    def tangent(self, distance: Array) -> Array:
        """Unit tangent (K, 2)."""
        return self.place(distance)[1]

    def place(self, distance: Array) -> tuple[Array, Array]:
        """Position (K, 2) m in n, and unit tangent (K, 2)."""
        return self._place_within(self.wrapped(distance))

    def curvature(self, distance: Array) -> Array:
        """Curvature (K,) 1/m, positive to the left."""
        return np.interp(self.wrapped(distance), *self._bends)

    def up(self, distance: Array) -> Array:
        """Mean height (K,) m."""
        period = self.length if self.line.is_closed else None
        return np.asarray(np.interp(self.wrapped(distance), self.line.distance, self.line.up, period=period))

    def wrapped(self, distance: Array) -> Array:
        """Distance within the lap, 0 <= d < length; on an open line held at its ends."""
        if self.line.is_closed:
            return np.asarray(np.mod(distance, self.length))
        return np.asarray(np.clip(distance, 0.0, self.length))

    def project(self, position_n: Array, guess: Array, rounds: int = 3) -> tuple[Array, Array]:
        """Track distance (K,), unwrapped beside `guess` (K,), and offset to the left (K,) of positions (K, 2).

        Newton's method on the foot of the perpendicular; `guess` must be right to some metres.
        """
        distance = np.asarray(guess, dtype=np.float64)
        for _ in range(rounds):
            within = self.wrapped(distance)
            there, tangent = self._place_within(within)
            away = position_n - there
            stretch = 1.0 - np.clip(to_left(tangent, away) * np.interp(within, *self._bends), -BENT, BENT)
            along = tangent[:, 0] * away[:, 0] + tangent[:, 1] * away[:, 1]
            distance = distance + np.clip(along / stretch, -5.0, 5.0)
        there, tangent = self.place(distance)
        return distance, to_left(tangent, position_n - there)

    def _place_within(self, within: Array) -> tuple[Array, Array]:
        """Position and unit tangent at distances within the lap."""
        position, slope = self._spline.with_slope(within)
        return position, slope / np.hypot(slope[:, 0], slope[:, 1])[:, None]

    @cached_property
    def _bends(self) -> tuple[Array, Array]:
        """Distances from 0 to the length, and the curvature there."""
        line = self.line
        if not line.is_closed:
            return line.distance, line.curvature
        return np.append(line.distance, line.length), np.append(line.curvature, line.curvature[0])

    @cached_property
    def _spline(self) -> CubicSpline:
        line = self.line
        if not line.is_closed:
            return CubicSpline(line.distance, line.position_n)
        ends = np.append(line.distance, line.length)
        return CubicSpline(ends, np.concatenate([line.position_n, line.position_n[:1]]), is_closed=True)


def line_through(points: Array, up: Array, is_closed: bool = True) -> ReferenceLine:
    """Return the smooth line through `points` (K, 2) with heights `up` (K,), about a metre apart, by arc length."""
    for _ in range(2):  # resampling changes the length a little; twice is enough
        points, up = _evenly(points, up, is_closed)
    smooth = gaussian_mean(points, SMOOTHED_OVER / SPACING, is_closed=is_closed)
    if not is_closed:
        smooth[[0, -1]] = points[[0, -1]]
    points, up = _evenly(smooth, up, is_closed)
    tangent = _difference(points, is_closed)
    step = np.linalg.norm(tangent, axis=1)
    tangent = tangent / step[:, None]
    turn = _difference(np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0]))[:, None], is_closed, is_angle=True)[:, 0]
    distance, length = _arc_length(points, is_closed)
    # m, one sigma; the shortest corner of a kart track is 10 m long
    curvature = gaussian_mean(turn / step, 4.0 / SPACING, is_closed=is_closed)
    return ReferenceLine(distance, points, tangent, curvature, up, length, is_closed)


def shifted(line: ReferenceLine, distance: float) -> ReferenceLine:
    """Return the same closed line with its zero at `distance` m."""
    curve = Curve(line)
    at = distance + line.distance
    return ReferenceLine(
        line.distance,
        curve.position(at),
        curve.tangent(at),
        curve.curvature(at),
        curve.up(at),
        line.length,
        line.is_closed,
    )


def first_line(path: PlanPath, start: float, end: float) -> ReferenceLine:
    """Return the closed line along one passage; the gap between its ends, from the wander of the GPS, is distributed
    over the line."""
    t = np.linspace(start, end, max(16, round((end - start) * 20.0)))
    points, _ = path.at(t)
    driven = np.interp(t, path.t, path.driven)
    share = ((driven - driven[0]) / max(driven[-1] - driven[0], 1e-9))[:, None]
    points = points + (points[0] - points[-1]) * (share - 0.5)
    up = np.interp(t, path.t, path.up)
    up = up + (up[0] - up[-1]) * (share[:, 0] - 0.5)
    return line_through(points[:-1], up[:-1])


def open_line(path: PlanPath, start: float, end: float) -> ReferenceLine:
    """Return the open line along one passage from `start` to `end` s."""
    t = np.linspace(start, end, max(16, round((end - start) * 20.0)))
    return line_through(path.at(t)[0], np.interp(t, path.t, path.up), is_closed=False)


def mean_line(line: ReferenceLine, lateral: Array, up: Array) -> ReferenceLine:
    """Return the line moved to the mean of the laps: lateral, up (L, P) at its points, NaN where a lap has no value."""
    known = np.isfinite(lateral)
    count = known.sum(axis=0)
    offset = np.where(count > 0, np.where(known, lateral, 0.0).sum(axis=0) / np.maximum(count, 1), 0.0)
    high = np.where(known & np.isfinite(up), up, 0.0).sum(axis=0) / np.maximum(count, 1)
    left = np.stack([-line.tangent_n[:, 1], line.tangent_n[:, 0]], axis=1)
    up_mean = np.where(count > 0, high, line.up)
    return line_through(line.position_n + offset[:, None] * left, up_mean, line.is_closed)


def _evenly(points: Array, up: Array, is_closed: bool) -> tuple[Array, Array]:
    distance, length = _arc_length(points, is_closed)
    values = np.concatenate([points, up[:, None]], axis=1)
    if is_closed:
        distance, values = np.append(distance, length), np.concatenate([values, values[:1]])
    keep = np.concatenate([[True], np.diff(distance) > 1e-6])
    distance, values = distance[keep], values[keep]
    count = max(16, round(length / SPACING))
    at = np.arange(count) * length / count if is_closed else np.linspace(0.0, distance[-1], count + 1)
    if is_closed:
        values[-1] = values[0]
    even = CubicSpline(distance, values, is_closed=is_closed)(at)
    return even[:, :2], even[:, 2]


def _arc_length(points: Array, is_closed: bool) -> tuple[Array, float]:
    """Distance (K,) of each point along the polygon, and the whole length."""
    ends = np.concatenate([points, points[:1]]) if is_closed else points
    step = np.linalg.norm(np.diff(ends, axis=0), axis=1)
    total = np.concatenate([[0.0], np.cumsum(step)])
    return (total[:-1], float(total[-1])) if is_closed else (total, float(total[-1]))


def _difference(values: Array, is_closed: bool, is_angle: bool = False) -> Array:
    """Central differences (K, n) over two steps, halved; angles stay within a turn."""
    if is_closed:
        change = 0.5 * (np.roll(values, -1, axis=0) - np.roll(values, 1, axis=0))
        if is_angle:
            change = np.mod(change + 0.5 * np.pi, np.pi) - 0.5 * np.pi
        return np.asarray(change)
    return np.asarray(np.gradient(values, axis=0))
