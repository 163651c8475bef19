"""Checks of the velocity that a receiver sends, held against the positions it sends with it.

A speed in another unit, a column that stands still while the kart drives, a course that points elsewhere: the positions
are right without them, and the column is not used. A velocity that agrees is left as it is.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, runs_of
from smoother.session.checks.columns import FixRows
from smoother.session.checks.deadband import zeros_of_slow
from smoother.session.checks.heights import heights_in_feet, wrong_climb
from smoother.session.checks.table import Check, Finding
from smoother.session.checks.way_steps import (
    BASELINE,
    FASTER,
    FEWEST_STEPS,
    NOISE_TIMES,
    STUCK_ROWS,
    STUCK_TIME,
    Steps,
    distance,
    steps_of,
)
from smoother.session.fix_columns import FixColumns, metres, sent_speed
from smoother.units import KMH, KNOT, MPH
from smoother.words import counted

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
FEWEST_RENEWED, RENEWED_ALIKE = 30, 0.8  # velocities, and share of them that are repeated as often as most
STUCK_SHARE = 0.25  # of the positions against it: a stuck course is right once a lap, a jump of positions is short
SPEED_OFF = (2.0, 0.15)  # m/s and share of what the positions say, which over BASELINE are noisy by less
COURSE_OFF = 45.0  # deg; a bend within the delay between velocity and position mostly makes less
DELAYS = (0.0, 0.25, 0.5, 0.75, 1.0, -0.25, -0.5)  # s by which velocities come behind their positions, or before them
AXES_ALIKE = 1.1  # times one another; latitude and longitude exchanged make 1.4 at 45 degrees, 1.1 at 17 of both
COURSE_ALIKE = 20.0  # deg; a course as close to one that is written in another way is written so


LEVEL = ("speed", "course_deg", "velocity_north", "velocity_east")
DIRECTION = ("course_deg", "velocity_north", "velocity_east", "velocity_up")


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
    return Finding(f"{text}, as if in {unit}; taken as such", scale=scale, blank={"velocity_up": every})


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


def stuck(names: tuple[str, ...], f: FixRows) -> Finding | None:
    """Columns that repeat one value while the positions say something else."""
    c = f.columns
    steps, values = steps_of(c.t, c), np.column_stack([getattr(c, name) for name in names])
    stands = _stuck(c.t, steps, values, _off(steps, c, names[0]))
    count = int(np.count_nonzero(stands))
    if not count:
        return None
    what, shown = names[0].partition("_")[0], ", ".join(f"{value:g}" for value in values[np.argmax(stands)])
    text = f"{what} stands at {shown} in {counted(count, 'row')} while the positions move otherwise; not used there"
    return Finding(text, count, blank=dict.fromkeys(names, stands))


def _off(steps: Steps, c: FixColumns, name: str) -> Callable[[float], BoolArray]:
    """By the noise of the steps, m/s: which of them (N,) are farther off the column than bends and noise make them."""
    if name == "course_deg":
        off = (steps.angle_from(c.course_deg) > COURSE_OFF) & ~_says_slow(c)
        return lambda _: off
    if name == "speed":
        by = np.abs(steps.speed - c.speed)
    else:
        by = np.hypot(steps.north - c.velocity_north, steps.east - c.velocity_east)
    least = np.maximum(SPEED_OFF[0], SPEED_OFF[1] * steps.speed)
    return lambda noise: np.asarray(by > np.maximum(least, NOISE_TIMES * noise))


def _says_slow(c: FixColumns) -> BoolArray:
    """Mask (N,) of the rows by whose speed the kart hardly moves: their course means nothing and may be an old one."""
    speed = sent_speed(c)
    return np.asarray(speed < 0.5 * FASTER)


def _stuck(t: Array, steps: Steps, values: Array, off: Callable[[float], BoolArray]) -> BoolArray:
    """Mask (N,) of the rows of `values` (N, M) in a long run of one value that the positions contradict."""
    stuck = np.zeros(t.size, dtype=np.bool_)
    for first, end in _runs(values):
        if t[end - 1] - t[first] <= STUCK_TIME:
            continue
        noise = steps.noise(slice(first, end))
        against = np.count_nonzero((steps.told(noise) & off(noise))[first:end])
        stuck[first:end] = against > max(0.5 * STUCK_ROWS, STUCK_SHARE * (end - first))
    return stuck


def _runs(values: Array) -> Iterator[tuple[int, int]]:
    """First row and the one behind the last of each run of at least STUCK_ROWS equal rows of `values` (N, M)."""
    same = np.all(values[1:] == values[:-1], axis=1)  # never where they are NaN
    for first, last in zip(*(index.tolist() for index in runs_of(same)), strict=True):
        if last + 1 - first >= STUCK_ROWS:
            yield first, last + 1


def repeated(f: FixRows) -> Finding | None:
    """Velocities that a receiver renews less often than its positions.

    Each is then repeated as often, until the next one comes; what is merely coarse, or steady, is repeated now more
    often and now less. The positions have to change from row to row. What stands for longer was measured anew each
    time one was due: of a kart that stands, the zeros hold positions that have not settled.
    """
    c = f.columns
    velocity = np.column_stack([getattr(c, name) for name in LEVEL])
    same = (velocity[1:] == velocity[:-1]) | (np.isnan(velocity[1:]) & np.isnan(velocity[:-1]))
    same = np.append(False, np.all(same, axis=1))
    moves = np.append(True, (np.diff(c.lat_deg) != 0.0) | (np.diff(c.lon_deg) != 0.0))
    begins = np.flatnonzero(~same)
    if begins.size < FEWEST_RENEWED:
        return None
    lengths, is_moving = np.diff(begins), np.logical_and.reduceat(moves, begins)[:-1]
    usual = float(np.median(lengths[is_moving])) if np.count_nonzero(is_moving) >= FEWEST_RENEWED else 1.0
    if usual < 2.0 or np.mean(lengths[is_moving] == usual) < RENEWED_ALIKE:
        return None
    repeats = same & moves & np.any(np.isfinite(velocity), axis=1) & ~_are_due(begins, same.size, usual)
    count = int(np.count_nonzero(repeats))
    text = f"speed and course are new in one of {usual:.0f} rows only, and repeated in {counted(count, 'row')}"
    return Finding(f"{text}; not used there", count, blank=dict.fromkeys((*LEVEL, "velocity_up"), repeats))


def _are_due(begins: IntArray, n: int, usual: float) -> BoolArray:
    """Mask (n,) of the rows in which a new value is due every `usual` rows, in runs that begin at rows `begins`.

    A rest that is no more than half as long is of a value that came late, not of another.
    """
    length = np.diff(np.append(begins, n))
    run = np.repeat(np.arange(begins.size), length)
    place = np.arange(n) - begins[run]
    return np.asarray((place % usual == 0.0) & (length[run] - place > 0.5 * usual))


def exchanged(f: FixRows) -> Finding | None:
    """Components that agree with the positions once north and east are exchanged."""
    steps, _, said, off = _course_off(f.columns)
    if not off > COURSE_OFF or not _are_exchanged(steps, f.columns, said & np.isfinite(f.columns.velocity_north)):
        return None
    text = "by its positions its velocities north and east are exchanged; taken as such"
    return Finding(text, swap=("velocity_north", "velocity_east"))


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


def _course_off(c: FixColumns) -> tuple[Steps, Array, BoolArray, float]:
    """Steps of the way, course (N,) deg that is sent, which steps say where the kart goes, and how far off it is, deg;
    NaN where too few say so."""
    has_parts = np.isfinite(c.velocity_north) & np.isfinite(c.velocity_east)
    course = np.where(has_parts, np.degrees(np.arctan2(c.velocity_east, c.velocity_north)), c.course_deg)
    steps = steps_of(c.t, c)
    known = steps.whole & np.isfinite(course) & ~_says_slow(c)
    said = known & steps.told(steps.noise(known)) if np.any(known) else known
    if np.count_nonzero(said) < FEWEST_STEPS or np.ptp(c.t[said]) < STUCK_TIME:
        return steps, course, said, np.nan
    return steps, course, said, _mostly_off(c.t, steps, course, said)


def _are_exchanged(steps: Steps, c: FixColumns, told: BoolArray) -> bool:
    """Whether components of velocity agree with the positions once north and east are exchanged; by the steps `told`.

    Of latitude and longitude exchanged the directions agree as well; but what was taken for a degree of one is not as
    long as one of the other, and the two components differ from their positions by different factors.
    """
    if np.count_nonzero(told) < FEWEST_STEPS:
        return False
    if _mostly_off(c.t, steps, np.degrees(np.arctan2(c.velocity_north, c.velocity_east)), told) > COURSE_ALIKE:
        return False
    pairs = ((steps.north, c.velocity_east), (steps.east, c.velocity_north))
    with np.errstate(divide="ignore"):  # of a column that is 0 throughout
        factors = [float(np.sqrt(np.mean(step[told] ** 2) / np.mean(sent[told] ** 2))) for step, sent in pairs]
    return max(factors) < AXES_ALIKE * min(factors)


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
    Check("gps_speed_stuck", "fixes", ("speed",), partial(stuck, ("speed",))),
    Check("gps_course_stuck", "fixes", ("course_deg",), partial(stuck, ("course_deg",))),
    Check("gps_velocity_stuck", "fixes", ("velocity_north",), partial(stuck, ("velocity_north", "velocity_east"))),
    Check("gps_speed_threshold", "fixes", (), zeros_of_slow),
    Check("gps_velocity_repeated", "fixes", (), repeated),
    Check("gps_velocity_exchanged", "fixes", ("velocity_north", "velocity_east"), exchanged),
    Check("gps_course_wrong", "fixes", (), wrong_course),
    Check("gps_climb_wrong", "fixes", ("velocity_up", "alt_m"), wrong_climb),
    Check("gps_height_unit", "fixes", ("velocity_up", "alt_m"), heights_in_feet),
)
