"""Where on the reference line the kart was at every row: unwrapped track distance, held through neighbours and gaps.

The kart is followed from place to place, so that a parallel straight nearby never takes over; where it leaves the line
it is looked for again, and found only where it also stays on the line in the right direction for a while.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.laps.path import PlanPath
from smoother.laps.reference import Curve

EVERY = 0.15  # s between the places that are followed one by one
LOST_BEYOND = 15.0  # m from the line: half a track's width, the wander of the GPS, and some run-off
FOUND_WITHIN = 12.0  # m
AHEAD = (10.0, 20.0, 35.0)  # m of path that must also be on the line before the kart counts as found
BACK, ON = 6.0, 10.0  # m that are searched behind and, beyond what was driven, ahead
SAME_DIRECTION = 0.4  # least cosine between path and line where the kart moves
MOVING = 2.0  # m/s
TURNED_FOR = 1.0  # s against the direction of the line, after which the kart is not on a lap
SAME_WAY = 0.15  # of the distance driven away from the line that the line may be longer or shorter


@dataclass(frozen=True, eq=False)
class Followed:
    """Per row of the path: distance (N,) m along the line, counting on from lap to lap; lateral (N,) m to the left;
    is_on (N,) whether the kart is on the line; distance in between is filled in, lateral is NaN there."""

    distance: Array
    lateral: Array
    is_on: BoolArray


def follow(path: PlanPath, curve: Curve) -> Followed:
    """Return where the path is on the line."""
    rows = _rows(path)
    distance = _Pursuit(path, curve).run(rows)
    return _refined(path, curve, path.t[rows], distance)


def refollow(path: PlanPath, before: Curve, followed: Followed, curve: Curve) -> Followed:
    """Return where the path is on a line that lies within metres of the one it was followed on."""
    at = before.line.distance
    there, _ = curve.project(before.line.position_n, at * curve.length / before.length)
    if not before.line.is_closed:
        moved = np.interp(followed.distance, at, there)
    else:
        laps = np.floor(followed.distance / before.length)
        within = followed.distance - laps * before.length
        ends = np.append(at, before.length), np.append(there, there[0] + curve.length)
        moved = laps * curve.length + np.interp(within, *ends)
    return _refined(path, curve, path.t, np.where(followed.is_on, moved, np.nan))


def _rows(path: PlanPath) -> np.ndarray:
    wanted = np.arange(path.t[0], path.t[-1] + EVERY, EVERY)
    return np.unique(np.clip(np.searchsorted(path.t, wanted), 0, len(path.t) - 1))


class _Pursuit:
    """Follows the path along the line, one place after the other."""

    def __init__(self, path: PlanPath, curve: Curve) -> None:
        self.path, self.curve = path, curve
        self.points, self.tangents = curve.line.position_n, curve.line.tangent_n
        self.spacing = curve.length / len(self.points)

    def run(self, rows: np.ndarray) -> Array:
        """Unwrapped distance (len(rows),), NaN where the kart is not on the line."""
        path = self.path
        found = np.full(len(rows), np.nan)
        last, last_row, turned = np.nan, -1, 0.0
        is_on = False
        for k, row in enumerate(rows):
            driven = 0.0 if last_row < 0 else path.driven[row] - path.driven[last_row]
            here: float | None = None
            if is_on:
                here = self._near(row, last - BACK, last + driven + ON)
                turned = self._turned(row, turned, k, rows, here)
                if turned > TURNED_FOR:
                    here = None
            if here is None:
                turned = 0.0
                here = self._anywhere(row, last + driven)
            is_on = here is not None
            if here is not None:
                found[k], last, last_row = here, here, int(row)
        return found

    def _turned(self, row: int, turned: float, k: int, rows: np.ndarray, here: float | None) -> float:
        """Seconds for which the kart has been moving against the line."""
        if here is None or k == 0 or self.path.speed[row] < MOVING:
            return turned
        if self._along(row, round(here / self.spacing)) > 0.0:
            return 0.0
        return turned + float(self.path.t[row] - self.path.t[rows[k - 1]])

    def _along(self, row: int, index: int) -> float:
        """Cosine between path and line."""
        tangent = self.tangents[self._index(np.array([index]))[0]]
        return float(self.path.velocity_n[row] @ tangent / max(self.path.speed[row], 1e-6))

    def _near(self, row: int, low: float, high: float) -> float | None:
        """Distance of the nearest point of the line between two distances, None if it is too far away."""
        steps = np.arange(int(low / self.spacing), int(high / self.spacing) + 2)
        away = self.points[self._index(steps)] - self.path.position_n[row]
        squared = np.einsum("ij,ij->i", away, away)
        best = int(np.argmin(squared))
        return float(steps[best] * self.spacing) if squared[best] < LOST_BEYOND**2 else None

    def _anywhere(self, row: int, expected: float) -> float | None:
        """Distance of a kart that was lost: the place on the line that the path follows best for a while."""
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
        """Mean distance (m) of path and line here and ahead, infinite where they part or point another way."""
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
            apart = np.linalg.norm(self.points[there] - path.position_n[later], axis=1)
            k = int(np.argmin(apart))
            if apart[k] > FOUND_WITHIN or self._along(later, int(there[k])) < SAME_DIRECTION:
                return np.inf
            away.append(float(apart[k]))
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
    is_on = np.interp(path.t, t, on.astype(np.float64)) > 0.999
    guess = np.interp(path.t, t[on], coarse[on])
    distance, lateral = guess.copy(), np.full(n, np.nan)
    distance[is_on], lateral[is_on] = curve.project(path.position_n[is_on], guess[is_on])
    is_on &= ~(np.abs(lateral) > LOST_BEYOND + 2.0)
    distance, is_on = _filled(path, distance, is_on)
    return Followed(distance, np.where(is_on, lateral, np.nan), is_on)


def _filled(path: PlanPath, distance: Array, is_on: BoolArray) -> tuple[Array, BoolArray]:
    """Distance between stretches on the line, spread over the distance driven; before and after them it is held."""
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
