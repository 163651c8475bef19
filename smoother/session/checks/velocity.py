"""Checks of the velocity that a receiver sends, held against the positions it sends with it.

A speed in another unit, a course that points elsewhere: the positions are right without them, and the column is not
used. A velocity that agrees is left as it is. Over a second, noise of the positions is less than what a kart does; how
much there is of it, the calmest steps show.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.session.checks.table import Check, Finding
from smoother.session.fix_columns import FixColumns, FixRows, metres, sent_speed
from smoother.units import KMH, KNOT, MPH
from smoother.words import counted

FEWEST_STEPS = 20  # by which velocities are judged
BASELINE = 1.0  # s; over less, noise of the positions counts
FASTER = 5.0  # m/s; and in slower motion
LEAST_TIME = 10.0  # s of steps that tell a direction
CALM = 25.0  # per cent of the rows in which noise shows alone
# m/s over BASELINE for that percentile of roughness, m: a Rayleigh deviate of 0.759 sigmas, of which a weighted sum of
# four positions has sqrt(20) / 3, and the difference of two sqrt(2)
NOISE_OF_CALM = math.sqrt(2.0) / (0.759 * math.sqrt(20.0) / 3.0) / BASELINE
NOISE_TIMES = 2.5  # noise of a step: slower or closer to the column than that, it tells nothing
UNIT_RATIOS = {  # what speeds in one unit are, read as another, in true ones
    "km/h": 1.0 / KMH,
    "mph": 1.0 / MPH,
    "knots": 1.0 / KNOT,
    **{f"m/s, read as {name}": size for name, size in (("km/h", KMH), ("mph", MPH), ("knots", KNOT))},
    **{f"{name}, read as km/h": KMH / size for name, size in (("mph", MPH), ("knots", KNOT))},
    **{f"km/h, read as {name}": size / KMH for name, size in (("mph", MPH), ("knots", KNOT))},
}
SAME_UNIT = 0.02  # share; real receivers are within 0.015 of their positions, and the nearest two of them 5 % apart
SAME_SPEED = (0.85, 1.18)  # speed by that of the positions; beyond, it is wrong whatever explains it
ABSURD_SHARE = 10.0  # and more are speeds that are said to be impossible
SAME_SPEED_OF_CHORDS = 1.5  # likewise where positions come no faster than BASELINE: a chord is shorter than its bend
ENOUGH_STEPS = 2000  # evenly taken from a long session
MOVING = 1.0  # m/s; slower, receivers leave the course empty
COURSE_OFF = 45.0  # deg; a bend within the delay between velocity and position mostly makes less
DELAYS = (0.0, 0.25, 0.5, 0.75, 1.0, -0.25, -0.5)  # s by which velocities come behind their positions, or before them
COURSE_ALIKE = 20.0  # deg; a course as close to one that is written in another way is written so


DIRECTION = ("course_deg", "velocity_north", "velocity_east", "velocity_up")


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


def no_course(f: FixRows) -> Finding | None:
    """Speeds without a direction."""
    c = f.columns
    moving = (c.speed > MOVING) & ~np.isfinite(c.velocity_north)
    lost = int(np.count_nonzero(moving & ~np.isfinite(c.course_deg)))
    if lost <= 0.5 * np.count_nonzero(c.speed > MOVING):
        return None
    return Finding(f"{counted(lost, 'moving fix')} with a speed but no course; the speed is used alone", lost)


def speed_unit(f: FixRows) -> Finding | None:
    """Speeds in another unit, turned into m/s; not used where no unit explains them.

    Speeds that are 3.6 times too large would pass for fixes that are noisy and late.
    """
    c, every = f.columns, np.ones(f.columns.t.size, dtype=np.bool_)
    share, highest = _share_of_speed(c.t, c)
    if not (share < SAME_SPEED[0] or highest < share < ABSURD_SHARE):
        return None
    unit = next((name for name, ratio in UNIT_RATIOS.items() if abs(share / ratio - 1.0) < SAME_UNIT), None)
    text = f"its speeds are {share:.2f} times those of its positions"
    if unit is None:
        blank = dict.fromkeys(("speed", "velocity_north", "velocity_east", "velocity_up"), every)
        return Finding(f"{text}; not used. What is their unit?", blank=blank)
    scale = dict.fromkeys(("speed", "velocity_north", "velocity_east"), 1.0 / UNIT_RATIOS[unit])
    return Finding(f"{text}, as if in {unit}; converted", scale=scale, blank={"velocity_up": every})


def _share_of_speed(t: Array, c: FixColumns) -> tuple[float, float]:
    """Speed as sent divided by speed from the positions, NaN where too few tell or they do not agree about it; and the
    largest share that is no contradiction.

    Which steps tell is chosen by what was sent: chosen by the positions, noise would make a slow kart seem a fast one.
    """
    speed = sent_speed(c)
    north, east = metres(c)
    later = np.searchsorted(t, t + BASELINE)
    first = np.flatnonzero((later < t.size) & np.isfinite(speed))
    first = first[:: max(1, first.size // ENOUGH_STEPS)]
    last = later[first]
    run = t[last] - t[first]
    middle = (first + last) // 2
    travelled = distance(north, east, first, middle) + distance(north, east, middle, last)
    travelled /= run
    within = np.stack([first, last + 1], axis=1).ravel()  # a window, what lies up to the next one, a window ..
    sent = np.add.reduceat(np.append(speed, 0.0), within)[::2] / (last + 1 - first)
    told = (run < 2.0 * BASELINE) & np.isfinite(sent)
    told &= sent > 0.5 * np.percentile(sent[told], 95.0) if np.any(told) else False
    if np.count_nonzero(told) < FEWEST_STEPS or not np.median(travelled[told]) > FASTER:
        return float("nan"), np.inf
    with np.errstate(divide="ignore"):
        low, share, high = np.percentile(sent[told] / travelled[told], (25.0, 50.0, 75.0), method="nearest")
    highest = SAME_SPEED[1] if np.median((last - first)[told]) >= 2 else SAME_SPEED_OF_CHORDS
    return (float(share) if high < 1.25 * low else float("nan")), highest


def wrong_course(f: FixRows) -> Finding | None:
    """A direction that mostly is another than that in which the positions go."""
    c = f.columns
    steps, course, said, off = _course_off(c)
    if not off > COURSE_OFF:
        return None
    others = ((how, _mostly_off(c.t, steps, other(course), said)) for how, other in _OTHER_COURSES.items())
    hint = next((f", as if {how}" for how, rest in others if rest < COURSE_ALIKE), "")
    every = np.ones(c.t.size, dtype=np.bool_)
    text = f"course is mostly {off:.0f} deg off the way of the positions{hint}; not used"
    return Finding(text, blank=dict.fromkeys(DIRECTION, every))


def _says_slow(c: FixColumns) -> BoolArray:
    """Mask (N,) of the rows by whose speed the kart hardly moves: their course means nothing and may be an old one."""
    speed = sent_speed(c)
    return np.asarray(speed < 0.5 * FASTER)


def _course_off(c: FixColumns) -> tuple[Steps, Array, BoolArray, float]:
    """Steps of the way, course (N,) deg that is sent, which steps say where the kart goes, and how far off it is, deg;
    NaN where too few say so."""
    has_parts = np.isfinite(c.velocity_north) & np.isfinite(c.velocity_east)
    course = np.where(has_parts, np.degrees(np.arctan2(c.velocity_east, c.velocity_north)), c.course_deg)
    steps = steps_of(c.t, c)
    known = steps.whole & np.isfinite(course) & ~_says_slow(c)
    said = known & steps.told(steps.noise(known)) if np.any(known) else known
    if np.count_nonzero(said) < FEWEST_STEPS or np.ptp(c.t[said]) < LEAST_TIME:
        return steps, course, said, np.nan
    return steps, course, said, _mostly_off(c.t, steps, course, said)


def _mostly_off(t: Array, steps: Steps, course_deg: Array, told: BoolArray) -> float:
    """How far, deg, the course (N,) mostly is off the way of the positions, early or late as it may be."""
    angle = np.radians(course_deg)
    known = np.isfinite(angle)
    north, east = np.cos(angle[known]), np.sin(angle[known])
    off = np.inf
    for delay in DELAYS:
        at = [np.interp(steps.t + delay, t[known], part) for part in (north, east)]
        off = min(off, float(np.median(steps.angle_from(np.degrees(np.arctan2(at[1], at[0])))[told])))
    return off


_OTHER_COURSES: dict[str, Callable[[Array], Array]] = {
    "in radians": np.degrees,
    "it pointed backwards": lambda course: course + 180.0,
    "anticlockwise from north": np.negative,
    "anticlockwise from east, or latitude and longitude exchanged": lambda course: 90.0 - course,
}


VELOCITY_CHECKS = (
    Check("gps_no_course", "fixes", ("speed",), no_course),
    Check("gps_speed_unit", "fixes", (), speed_unit),
    Check("gps_course_wrong", "fixes", (), wrong_course),
)
