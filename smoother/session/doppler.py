"""What the velocity a receiver sends is worth, held against the positions it sends with it.

A speed in another unit, a column that stands still while the kart drives, a course that points elsewhere: the positions
are right without them, and the column is not used. A velocity that agrees is left as it is.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.session.fix_columns import FixColumns, metres
from smoother.session.rows import RowFilter
from smoother.units import KMH, KNOT, MPH
from smoother.words import counted

UNITS = {"km/h": KMH, "mph": MPH, "knots": KNOT, "m/s divided by 3.6": 1.0 / KMH}  # m/s
SAME_UNIT = 0.05  # share; the nearest two of them are 13 % apart
BASELINE = 1.0  # s; over less, noise of the positions counts
FASTER = 5.0  # m/s; and in slower motion
FEWEST_STEPS, ENOUGH_STEPS = 20, 2000
MOVING = 1.0  # m/s; slower, receivers leave the course empty
STUCK_ROWS, STUCK_TIME = 20, 10.0  # s; a value that stands longer, against the positions, is not measured
STUCK_SHARE = 0.25  # of the positions against it: a stuck course is right once a lap, a jump of positions is short
SPEED_OFF = (2.0, 0.15)  # m/s and share of what the positions say, which over BASELINE are noisy by less
COURSE_OFF = 45.0  # deg; a bend within the delay between velocity and position makes less
COURSE_ALIKE = 20.0  # deg; a course as close to one that is written in another way is written so


def without_wrong_velocity(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """Return the columns without the velocity that their positions contradict, and say so in `rows`.

    t (N,) s, in order. Taken for measured, it would pull the path away from fixes that are right.
    """
    _say_missing_course(rows, c)
    c = _without_wrong_unit(rows, t, c)
    return _without_wrong_course(rows, t, _without_stuck(rows, t, c))


def _say_missing_course(rows: RowFilter, c: FixColumns) -> None:
    moving = (c.speed > MOVING) & ~np.isfinite(c.velocity_north)
    lost = int(np.count_nonzero(moving & ~np.isfinite(c.course_deg)))
    if lost > 0.5 * np.count_nonzero(c.speed > MOVING):
        rows.say("no_course", f"{counted(lost, 'moving fix')} with a speed but no course; smoothed without both", lost)


def _without_wrong_unit(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns without velocity where it contradicts the positions as another unit does, and say so.

    Speeds that are 3.6 times too large would pass for fixes that are noisy and late.
    """
    share = _share_of_speed(t, c)
    unit = next((name for name, size in UNITS.items() if abs(share * size - 1.0) < SAME_UNIT), None)
    if unit is None:
        return c
    text = f"its speeds are {share:.2f} times those of its positions, as if in {unit}; not used. Is speed_mps in m/s?"
    rows.say("speed_unit", text, 1)
    unknown = np.full(t.size, np.nan)
    return replace(c, speed=unknown, velocity_north=unknown, velocity_east=unknown, velocity_up=unknown)


def _share_of_speed(t: Array, c: FixColumns) -> float:
    """Speed as sent divided by speed from the positions, NaN where too few tell or they do not agree about it."""
    speed = np.where(np.isfinite(c.speed), c.speed, np.hypot(c.velocity_north, c.velocity_east))
    north, east = metres(c)
    later = np.searchsorted(t, t + BASELINE)
    first = np.flatnonzero((later < t.size) & np.isfinite(speed))
    first = first[:: max(1, first.size // ENOUGH_STEPS)]
    last = later[first]
    run = t[last] - t[first]
    travelled = np.hypot(north[last] - north[first], east[last] - east[first]) / run
    within = np.stack([first, last + 1], axis=1).ravel()  # a window, what lies up to the next one, a window ..
    sent = np.add.reduceat(np.append(speed, 0.0), within)[::2] / (last + 1 - first)
    told = (travelled > FASTER) & (run < 2.0 * BASELINE) & np.isfinite(sent)
    if np.count_nonzero(told) < FEWEST_STEPS:
        return float("nan")
    low, share, high = np.percentile(sent[told] / travelled[told], (25.0, 50.0, 75.0))
    return float(share) if high < 1.25 * low else float("nan")


@dataclass(frozen=True, eq=False)
class _Steps:
    """Displacement over about BASELINE from each row (N,): m/s north and east; `told` where it says something.

    speed (N,) m/s: of the way by the row in the middle; round a tight bend that is longer than straight across.
    """

    north: Array
    east: Array
    speed: Array
    told: BoolArray
    middle: IntArray  # the row in the middle of each

    def angle_from(self, course_deg: Array) -> Array:
        """How far (N,) deg, 0 to 180, the displacement points from the course (N,) half way."""
        return _apart(np.degrees(np.arctan2(self.east, self.north)), course_deg[self.middle])


def _apart(a_deg: Array, b_deg: Array) -> Array:
    return np.asarray(np.abs(np.mod(a_deg - b_deg + 180.0, 360.0) - 180.0))


def _steps_of(t: Array, c: FixColumns) -> _Steps:
    north, east = metres(c)
    row = np.arange(t.size)
    last = np.minimum(np.searchsorted(t, t + BASELINE), t.size - 1)
    run = t[last] - t
    whole = (run > 0.5 * BASELINE) & (run < 2.0 * BASELINE)
    size = np.where(whole, run, 1.0)
    v_north, v_east = (north[last] - north) / size, (east[last] - east) / size
    middle = (row + last) // 2
    halves = (np.hypot(north[two] - north[one], east[two] - east[one]) for one, two in ((row, middle), (middle, last)))
    return _Steps(v_north, v_east, sum(halves) / size, whole & (np.hypot(v_north, v_east) > FASTER), middle)


def _without_stuck(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """Empty the cells of columns that repeat one value while the positions say something else."""
    steps = _steps_of(t, c)
    with np.errstate(invalid="ignore"):
        off = np.maximum(SPEED_OFF[0], SPEED_OFF[1] * steps.speed)
        slip = np.hypot(steps.north - c.velocity_north, steps.east - c.velocity_east)
        against = {
            ("speed",): np.abs(steps.speed - c.speed) > off,
            ("course_deg",): steps.angle_from(c.course_deg) > COURSE_OFF,
            ("velocity_north", "velocity_east"): slip > off,
        }
    for names, contradicted in against.items():
        values = np.column_stack([getattr(c, name) for name in names])
        stuck = _stuck(t, values, steps.told, contradicted)
        if count := int(np.count_nonzero(stuck)):
            what, shown = names[0].partition("_")[0], ", ".join(f"{value:g}" for value in values[np.argmax(stuck)])
            where = f"{what} stands at {shown} in {counted(count, 'row')}"
            rows.say(f"{what}_stuck", f"{where} while the positions move otherwise; not used there", count)
            c = replace(c, **{name: np.where(stuck, np.nan, getattr(c, name)) for name in names})
    return c


def _stuck(t: Array, values: Array, told: BoolArray, contradicted: BoolArray) -> BoolArray:
    """Mask (N,) of the rows of `values` (N, M) in a long run of one value that the positions contradict."""
    stuck = np.zeros(t.size, dtype=np.bool_)
    for first, end in _runs(values):
        seen = told[first:end]
        against = np.count_nonzero(seen & contradicted[first:end])
        if t[end - 1] - t[first] > STUCK_TIME and against > max(0.5 * STUCK_ROWS, STUCK_SHARE * seen.size):
            stuck[first:end] = True
    return stuck


def _runs(values: Array) -> Iterator[tuple[int, int]]:
    """First row and the one behind the last of each run of at least STUCK_ROWS equal rows of `values` (N, M)."""
    same = np.all(values[1:] == values[:-1], axis=1)  # never where they are NaN
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    for first, last in zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True):
        if last + 1 - first >= STUCK_ROWS:
            yield first, last + 1


def _without_wrong_course(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns without direction where it mostly points elsewhere than the positions go."""
    has_parts = np.isfinite(c.velocity_north) & np.isfinite(c.velocity_east)
    course = np.where(has_parts, np.degrees(np.arctan2(c.velocity_east, c.velocity_north)), c.course_deg)
    steps = _steps_of(t, c)
    told = steps.told & np.isfinite(course[steps.middle])
    if np.count_nonzero(told) < FEWEST_STEPS or np.ptp(t[told]) < STUCK_TIME:
        return c
    off = float(np.median(steps.angle_from(course)[told]))
    if off <= COURSE_OFF:
        return c
    hint = next((f", as if {how}" for how, other in _OTHER_COURSES.items() if _fits(steps, other(course), told)), "")
    rows.say("course_wrong", f"course is mostly {off:.0f} deg off the way of the positions{hint}; not used", 1)
    unknown = np.full(t.size, np.nan)
    return replace(c, course_deg=unknown, velocity_north=unknown, velocity_east=unknown, velocity_up=unknown)


def _fits(steps: _Steps, course_deg: Array, told: BoolArray) -> bool:
    return float(np.median(steps.angle_from(course_deg)[told])) < COURSE_ALIKE


_OTHER_COURSES: dict[str, Callable[[Array], Array]] = {
    "in radians": np.degrees,
    "it pointed backwards": lambda course: course + 180.0,
    "anticlockwise from north": np.negative,
    "anticlockwise from east, or latitude and longitude exchanged": lambda course: 90.0 - course,
}
