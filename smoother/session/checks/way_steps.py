"""The way along the positions, step by step, as velocities are held against it.

Over a second, noise of the positions is less than what a kart does; how much there is of it, the calmest steps tell.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, runs_of
from smoother.session.fix_columns import FixColumns, metres

FEWEST_STEPS = 20  # by which velocities are judged
BASELINE = 1.0  # s; over less, noise of the positions counts
FASTER = 5.0  # m/s; and in slower motion
STUCK_ROWS, STUCK_TIME = 20, 10.0  # s; a value that stands longer, against the positions, is not measured
CALM = 25.0  # per cent of the rows in which noise shows alone
# m/s over BASELINE for that percentile of roughness, m: a Rayleigh deviate of 0.759 sigmas, of which a weighted sum of
# four positions has sqrt(20) / 3, and the difference of two sqrt(2)
NOISE_OF_CALM = math.sqrt(2.0) / (0.759 * math.sqrt(20.0) / 3.0) / BASELINE
NOISE_TIMES = 2.5  # noise of a step: slower or closer to the column than that, it tells nothing


@dataclass(frozen=True, eq=False)
class Steps:
    """Displacement over about BASELINE from each row (N,): m/s north and east; `whole` where there is one.

    speed (N,) m/s: of the way by the row in the middle; round a tight bend that is longer than straight across.
    roughness (N,) m: how far positions are off a parabola through their neighbours.
    """

    t: Array  # s, half way
    north: Array
    east: Array
    speed: Array
    whole: BoolArray
    roughness: Array

    def noise(self, rows: BoolArray | slice) -> float:
        """Noise, m/s per axis, of a step in these rows, by the calmest of them: bends are no parabolas either."""
        return float(np.percentile(self.roughness[rows], CALM, method="nearest")) * NOISE_OF_CALM

    def told(self, noise: float) -> BoolArray:
        """Mask (N,) of the steps that say where the kart goes, and how fast."""
        return self.whole & (np.hypot(self.north, self.east) > max(FASTER, NOISE_TIMES * noise))

    def angle_from(self, course_deg: Array | float) -> Array:
        """How far (N,) deg, 0 to 180, the displacement points from the course (N,) half way."""
        return np.asarray(np.abs(np.mod(self._course_deg - course_deg + 180.0, 360.0) - 180.0))

    @property
    def _course_deg(self) -> Array:
        return np.degrees(np.arctan2(self.east, self.north))


def steps_of(t: Array, c: FixColumns) -> Steps:
    """Return the steps of the positions of fixes at t (N,) s, in order."""
    north, east = metres(c)
    row = np.arange(t.size)
    last = np.minimum(np.searchsorted(t, t + BASELINE), t.size - 1)
    run = t[last] - t
    whole = (run > 0.5 * BASELINE) & (run < 2.0 * BASELINE)
    size = np.where(whole, run, 1.0)
    v_north, v_east = (north[last] - north) / size, (east[last] - east) / size
    middle = (row + last) // 2
    halves = (np.hypot(north[two] - north[one], east[two] - east[one]) for one, two in ((row, middle), (middle, last)))
    return Steps(t + 0.5 * run, v_north, v_east, sum(halves) / size, whole, _roughness(t, north, east))


def _roughness(t: Array, north: Array, east: Array) -> Array:
    """How far (N,) m the position half a BASELINE on is off the parabola through three others; 0 at the end."""
    stride = max(1, round(0.5 * BASELINE / float(np.median(np.diff(t))))) if t.size > 1 else 1
    count = max(0, t.size - 3 * stride)
    one, *others = (slice(k * stride, k * stride + count) for k in (1, 0, 2, 3))
    off = np.zeros((2, t.size))
    off[:, :count] = north[one], east[one]
    for at in others:  # Lagrange's form of the parabola
        weight = np.ones(count)
        for root in others:
            if root != at:
                weight *= (t[one] - t[root]) / (t[at] - t[root])
        off[:, :count] -= weight * np.stack([north[at], east[at]])
    return np.asarray(np.hypot(*off))


def distance(north: Array, east: Array, first: IntArray, last: IntArray) -> Array:
    """Straight from rows first to rows last (M,) of positions (N,) m."""
    return np.asarray(np.hypot(north[last] - north[first], east[last] - east[first]))


def stretches(mask: BoolArray, first: int) -> Iterator[tuple[int, int]]:
    """First row and the one behind the last of each run of the mask, which begins at row `first`."""
    yield from zip(*((first + index).tolist() for index in runs_of(mask)), strict=True)
