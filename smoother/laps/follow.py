"""Map matching to the reference line: the unwrapped track distance of every row.

The kart is followed from point to point, so that a parallel straight nearby is not matched; after it left the line it
is matched again only where it then stays on the line in the right direction for a while.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces
from smoother.fit.plan_path import PlanPath
from smoother.laps.reference import Curve

EVERY = 0.15  # s between the followed points
LOST_BEYOND = 15.0  # m from the line: half a track's width, the wander of the GPS, and some run-off
FOUND_WITHIN = 12.0  # m
AHEAD = (10.0, 20.0, 35.0)  # m of path that must also be on the line before the kart counts as found
BACK, ON = 6.0, 10.0  # m that are searched behind and, beyond the driven distance, ahead
SAME_DIRECTION = 0.4  # least cosine between path and line where the kart moves
MOVING = 2.0  # m/s


@dataclass(frozen=True, eq=False)
class Followed:
    """Per row of the path: distance (N,) m along the line, counting on from lap to lap; lateral (N,) m to the left;
    is_on (N,) whether the kart is on the line; distance in between is filled in, lateral is NaN there."""

    distance: Array
    lateral: Array
    is_on: BoolArray

    @cached_property
    def spread(self) -> float:
        """Standard deviation (m) of the lateral offset."""
        return float(np.sqrt(np.nanvar(self.lateral)))


def follow(path: PlanPath, curve: Curve) -> Followed:
    """Return the path matched to the line."""
    rows = _rows(path)
    distance = _Pursuit(path, curve, rows).run()
    return _refined(path, curve, path.t[rows], distance)


def refollow(path: PlanPath, before: Curve, followed: Followed, curve: Curve) -> Followed:
    """Return the path matched to a line within metres of the previous one."""
    at = before.line.distance
    there, _ = curve.project(before.line.position_n, at * curve.length / before.length)
    ends = np.append(at, before.length), np.append(there, there[0] + curve.length)
    moved = np.empty(len(path.t))
    for part in pieces(len(moved)):
        distance = followed.distance[part]
        if before.line.is_closed:
            laps = np.floor(distance / before.length)
            distance = laps * curve.length + np.interp(distance - laps * before.length, *ends)
        else:
            distance = np.interp(distance, at, there)
        moved[part] = np.where(followed.is_on[part], distance, np.nan)
    return _refined(path, curve, path.t, moved)


def _rows(path: PlanPath) -> IntArray:
    wanted = np.arange(path.t[0], path.t[-1] + EVERY, EVERY)
    return np.unique(np.clip(np.searchsorted(path.t, wanted), 0, len(path.t) - 1)).astype(np.int64)


class _Pursuit:
    """Follows the path along the line, point by point."""

    def __init__(self, path: PlanPath, curve: Curve, rows: IntArray) -> None:
        self.path, self.curve, self.rows = path, curve, rows
        self.points, self.tangents = curve.line.position_n, curve.line.tangent_n
        self.spacing = curve.length / len(self.points)

    def run(self) -> Array:
        """Unwrapped distance (K,) at the rows, NaN where the kart is not on the line."""
        found = np.full(len(self.rows), np.nan)
        rows, driven = self.rows.tolist(), self.path.driven[self.rows].tolist()
        t, speed = self.path.t[self.rows].tolist(), self.path.speed[self.rows].tolist()
        last, on_the_way, turned = np.nan, 0.0, 0.0
        is_on = False
        for k, row in enumerate(rows):
            here: float | None = None
            if is_on:
                here, is_along = self._next(row, last, driven[k] - on_the_way)
                if here is not None and speed[k] >= MOVING:
                    turned = 0.0 if is_along else turned + t[k] - t[k - 1]
                if turned > 1.0:  # s against the direction of the line, after which the kart is not on a lap
                    here = None
            if here is None:
                turned = 0.0
                here = self._anywhere(row, last + driven[k] - on_the_way)
            is_on = here is not None
            if here is not None:
                found[k], last, on_the_way = here, here, driven[k]
        return found

    def _next(self, row: int, last: float, driven: float) -> tuple[float | None, bool]:
        """Distance of a row, `driven` m after one at `last` m, None where it left the line; whether it goes along."""
        steps = np.arange(int((last - BACK) / self.spacing), int((last + driven + ON) / self.spacing) + 2)
        away = self.points.take(self._index(steps), axis=0) - self.path.position_n[row]
        squared = np.einsum("ij,ij->i", away, away)
        best = int(np.argmin(squared))
        is_near = bool(squared[best] < LOST_BEYOND**2)
        return (float(steps[best] * self.spacing) if is_near else None), self._along(row, int(steps[best])) > 0.0

    def _along(self, row: int, index: int) -> float:
        """Cosine between path and line."""
        tangent = self.tangents[self._index(np.array([index]))[0]]
        return float(self.path.velocity_n[row] @ tangent / max(self.path.speed[row], 1e-6))

    def _anywhere(self, row: int, expected: float) -> float | None:
        """Distance of a kart that left the line: the point of the line that the path follows best for a while."""
        if self.path.speed[row] < MOVING:
            return None
        away = self.points - self.path.position_n[row]
        near = np.flatnonzero(np.einsum("ij,ij->i", away, away) <= FOUND_WITHIN**2)
        if near.size == 0:
            return None
        candidates = self._closest_of_runs(near, row)
        scores = [self._score(row, int(c)) for c in candidates]
        best = int(np.argmin(scores))
        if not np.isfinite(scores[best]):
            return None
        return self._unwrapped(float(candidates[best] * self.spacing), expected)

    def _closest_of_runs(self, near: np.ndarray, row: int) -> np.ndarray:
        """Of each stretch of neighbouring points the one that is closest to the path."""
        away = np.linalg.norm(self.points[near] - self.path.position_n[row], axis=1)
        run = np.cumsum(np.diff(near, prepend=near[0]) > 3)
        order = np.lexsort((away, run))
        _, first = np.unique(run[order], return_index=True)
        return np.asarray(near[order][first])

    def _score(self, row: int, index: int) -> float:
        """Mean distance (m) of path and line here and ahead, infinite where they separate or differ in direction."""
        path = self.path
        if self._along(row, index) < SAME_DIRECTION:
            return np.inf
        away = [float(np.linalg.norm(self.points[index] - path.position_n[row]))]
        for ahead in AHEAD:
            later = int(np.searchsorted(path.driven, path.driven[row] + ahead))
            if later >= len(path.t):
                break
            steps = index + np.arange(round(0.6 * ahead / self.spacing), round(1.4 * ahead / self.spacing) + 1)
            there = self._index(steps)
            gap = np.linalg.norm(self.points[there] - path.position_n[later], axis=1)
            k = int(np.argmin(gap))
            if gap[k] > FOUND_WITHIN or self._along(later, int(there[k])) < SAME_DIRECTION:
                return np.inf
            away.append(float(gap[k]))
        return float(np.mean(away))

    def _unwrapped(self, distance: float, expected: float) -> float:
        if not np.isfinite(expected) or not self.curve.line.is_closed:
            return distance
        return float(distance + round((expected - distance) / self.curve.length) * self.curve.length)

    def _index(self, steps: np.ndarray) -> np.ndarray:
        n = len(self.points)
        return np.asarray(steps % n if self.curve.line.is_closed else np.clip(steps, 0, n - 1))


def _refined(path: PlanPath, curve: Curve, t: Array, coarse: Array) -> Followed:
    """Every row projected onto the line, from coarse distances at times t, NaN where off the line."""
    on = np.isfinite(coarse)
    n = len(path.t)
    if not on.any():
        return Followed(np.full(n, np.nan), np.full(n, np.nan), np.zeros(n, dtype=np.bool_))
    t_on, coarse_on = (t, coarse) if on.all() else (t[on], coarse[on])
    distance, lateral, is_on = np.empty(n), np.full(n, np.nan), np.empty(n, dtype=np.bool_)
    for part in pieces(n, 1 << 16):  # of the path that are projected onto the line together
        here = _between_times(path.t[part], t, on) > 0.999
        guess = _between_times(path.t[part], t_on, coarse_on)
        place, beside = guess.copy(), np.full(len(guess), np.nan)
        place[here], beside[here] = curve.project(path.position_n[part][here], guess[here])
        distance[part], lateral[part], is_on[part] = place, beside, here & ~(np.abs(beside) > LOST_BEYOND + 2.0)
    distance, is_on = _filled(path, distance, is_on)
    return Followed(distance, np.where(is_on, lateral, np.nan), is_on)


def _between_times(at: Array, t: Array, values: Array | BoolArray) -> Array:
    """Values (N,) over t (N,) at times `at` (K,), ascending, linearly; only that part of a long recording is read."""
    around = slice(max(int(np.searchsorted(t, at[0])) - 1, 0), int(np.searchsorted(t, at[-1])) + 1)
    return np.interp(at, t[around], values[around])


def _filled(path: PlanPath, distance: Array, is_on: BoolArray) -> tuple[Array, BoolArray]:
    """Distance between stretches on the line, interpolated by driven distance; held before and after them."""
    known = np.flatnonzero(is_on)
    if known.size == 0:
        return np.full(len(distance), np.nan), is_on
    filled = distance.copy()
    filled[: known[0]], filled[known[-1] + 1 :] = distance[known[0]], distance[known[-1]]
    holes = np.flatnonzero(np.diff(known) > 1)
    for a, b in zip(known[holes], known[holes + 1], strict=True):
        way = path.driven[a : b + 1] - path.driven[a]
        share = way / way[-1] if way[-1] > 0.0 else np.linspace(0.0, 1.0, b - a + 1)
        filled[a : b + 1] = distance[a] + share * (distance[b] - distance[a])
    return filled, is_on
