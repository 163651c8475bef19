"""What the velocity a receiver sends is worth, held against the positions it sends with it.

A speed in another unit, a column that stands still while the kart drives, zeros that only say slow, a course that
points elsewhere: the positions are right without them, and the column is not used. A velocity that agrees is left as it
is. Heights in feet are told by the velocities upwards.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, runs_of
from smoother.session.fix_columns import FixColumns, metres, sent_speed
from smoother.session.rows import RowFilter
from smoother.session.speed_parts import parts_in_other_units
from smoother.units import FOOT, KMH, KNOT, MPH
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
BASELINE = 1.0  # s; over less, noise of the positions counts
FASTER = 5.0  # m/s; and in slower motion
FEWEST_STEPS, ENOUGH_STEPS = 20, 2000
MOVING = 1.0  # m/s; slower, receivers leave the course empty
FEWEST_RENEWED, RENEWED_ALIKE = 30, 0.8  # velocities, and share of them that are repeated as often as most
STUCK_ROWS, STUCK_TIME = 20, 10.0  # s; a value that stands longer, against the positions, is not measured
STUCK_SHARE = 0.25  # of the positions against it: a stuck course is right once a lap, a jump of positions is short
SPEED_OFF = (2.0, 0.15)  # m/s and share of what the positions say, which over BASELINE are noisy by less
COURSE_OFF = 45.0  # deg; a bend within the delay between velocity and position mostly makes less
# deg off the way, s and rows for which a course points backwards; within a delay of a second a hairpin makes 90
BACKWARDS, BACKWARDS_TIME, BACKWARDS_ROWS = 135.0, 3.0, 5
DELAYS = (0.0, 0.25, 0.5, 0.75, 1.0, -0.25, -0.5)  # s by which velocities come behind their positions, or before them
CALM = 25.0  # per cent of the rows in which noise shows alone
# m/s over BASELINE for that percentile of roughness, m: a Rayleigh deviate of 0.759 sigmas, of which a weighted sum of
# four positions has sqrt(20) / 3, and the difference of two sqrt(2)
NOISE_OF_CALM = math.sqrt(2.0) / (0.759 * math.sqrt(20.0) / 3.0) / BASELINE
NOISE_TIMES = 2.5  # noise of a step: slower or closer to the column than that, it tells nothing
LEAST_THRESHOLD = 0.5  # m/s; a receiver that writes lower speeds than this, 0 apart, has measured its zeros
SLOW_TIME = 5.0  # s over which the positions tell whether a kart stands; half of it at the ends of a stretch of zeros
LEAST_SLOW, LEAST_SLOW_WAY = 0.5, 5.0  # m/s and m; at rest positions wander as fast for a moment, or as far in minutes
# m/s; a receiver that often passes from 0 to more than this, or back, and never shows less, has measured none of its 0s
SURE_THRESHOLD = 0.8
ENOUGH_MISSED, MOST_MISSED = 6.0, 2.0  # fixes that should have shown less, in all and of one pass
BESIDE_MOTION = 1.0  # s in which a kart comes to rest from such a speed, or back to it
SETTLED = 120.0  # s after the first fix, or a hole of SLOW_TIME, from which on positions do not come in from elsewhere
SAME_WAY = 0.5  # cosine of the angle between how a kart was pushed and how it drives on
CLIMB_TIME = 5.0  # s over which velocities upwards are compared with heights, whose noise then counts less
CLEARLY_ALIKE, CLEARLY = 0.5, 3.0  # correlation of the two; sigmas
LEAST_RISE = 0.6  # m of height for one by the velocities; real receivers have 0.7 to 1.3, and km/h make 0.28
SAME_FOOT = 0.1  # share; of 98 sessions that tell it to a tenth, heights in metres are as near to theirs in 89
LEAST_RISE_IN_FEET = 2.0  # likewise for one by the velocities, by CLEARLY; metres come nowhere near
AXES_ALIKE = 1.1  # times one another; latitude and longitude exchanged make 1.4 at 45 degrees, 1.1 at 17 of both
COURSE_ALIKE = 20.0  # deg; a course as close to one that is written in another way is written so


def without_wrong_velocity(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """Return the columns without the velocity that their positions contradict, and say so in `rows`.

    t (N,) s, in order. Taken for measured, it would pull the path away from fixes that are right.
    """
    _say_missing_course(rows, c)
    converted = _without_wrong_unit(rows, t, c)
    # speeds below those of the positions may be the positions' noise, where nothing says that any are in another unit
    units = UNIT_RATIOS if converted is not c else {name: ratio for name, ratio in UNIT_RATIOS.items() if ratio > 1.0}
    c = _without_wrong_unit_in_parts(rows, t, converted, units)
    c = _without_repeats(rows, _without_zeros_of_slow(rows, t, _without_stuck(rows, t, c)))
    c = _backwards_in_parts(rows, t, _without_wrong_course(rows, t, c))
    return _without_wrong_climb(rows, t, c)


def _say_missing_course(rows: RowFilter, c: FixColumns) -> None:
    moving = (c.speed > MOVING) & ~np.isfinite(c.velocity_north)
    lost = int(np.count_nonzero(moving & ~np.isfinite(c.course_deg)))
    if lost > 0.5 * np.count_nonzero(c.speed > MOVING):
        rows.say("no_course", f"{counted(lost, 'moving fix')} with a speed but no course; smoothed without both", lost)


def _without_wrong_unit(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns with speeds in m/s where they are in another unit, and without where nothing explains them; says so.

    Speeds that are 3.6 times too large would pass for fixes that are noisy and late.
    """
    share, highest = _share_of_speed(t, c)
    if not (share < SAME_SPEED[0] or highest < share < ABSURD_SHARE):
        return c
    unit = next((name for name, ratio in UNIT_RATIOS.items() if abs(share / ratio - 1.0) < SAME_UNIT), None)
    text = f"its speeds are {share:.2f} times those of its positions"
    unknown = np.full(t.size, np.nan)
    if unit is None:
        rows.say("speed_unit", f"{text}; not used. What is their unit?", 1)
        return replace(c, speed=unknown, velocity_north=unknown, velocity_east=unknown, velocity_up=unknown)
    rows.say("speed_unit", f"{text}, as if in {unit}; taken as such", 1)
    names = ("speed", "velocity_north", "velocity_east")  # upwards it may be in a unit of its own
    return replace(c, **{name: getattr(c, name) / UNIT_RATIOS[unit] for name in names}, velocity_up=unknown)


def _without_wrong_unit_in_parts(rows: RowFilter, t: Array, c: FixColumns, units: dict[str, float]) -> FixColumns:
    """The same of stretches whose speeds are in another unit than the others; where it changes they are left out."""
    if t.size < FEWEST_STEPS:
        return c
    steps, speed = _steps_of(t, c), sent_speed(c)
    known = np.isfinite(speed)
    if np.count_nonzero(known) < FEWEST_STEPS:
        return c
    sent = np.interp(steps.t, t[known], speed[known])
    told = steps.told(steps.noise(slice(None))) & known
    ratios = sent / np.maximum(steps.speed, FASTER)
    for unit, surely, maybe in parts_in_other_units(steps.t, ratios, told, units):
        ratio, begin, end = units[unit], t[maybe][0], t[maybe][-1]
        text = f"its speeds from about {begin:.0f} to {end:.0f} s are {ratio:.2f} times those of its positions"
        rows.say("speed_unit", f"{text}, as if in {unit}; taken as such", maybe.stop - maybe.start)
        for name in ("speed", "velocity_north", "velocity_east", "velocity_up"):
            values = getattr(c, name).copy()
            values[maybe] = np.nan
            if name != "velocity_up":  # upwards it may be in a unit of its own
                values[surely] = getattr(c, name)[surely] / ratio
            c = replace(c, **{name: values})
    return c


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
    travelled = _distance(north, east, first, middle) + _distance(north, east, middle, last)
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


def _distance(north: Array, east: Array, first: IntArray, last: IntArray) -> Array:
    return np.asarray(np.hypot(north[last] - north[first], east[last] - east[first]))


@dataclass(frozen=True, eq=False)
class _Steps:
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
    return _Steps(t + 0.5 * run, v_north, v_east, sum(halves) / size, whole, _roughness(t, north, east))


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


def _without_stuck(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """Empty the cells of columns that repeat one value while the positions say something else."""
    steps = _steps_of(t, c)
    for names in (("speed",), ("course_deg",), ("velocity_north", "velocity_east")):
        values = np.column_stack([getattr(c, name) for name in names])
        stuck = _stuck(t, steps, values, _off(steps, c, names[0]))
        if count := int(np.count_nonzero(stuck)):
            what, shown = names[0].partition("_")[0], ", ".join(f"{value:g}" for value in values[np.argmax(stuck)])
            where = f"{what} stands at {shown} in {counted(count, 'row')}"
            rows.say(f"{what}_stuck", f"{where} while the positions move otherwise; not used there", count)
            c = replace(c, **{name: np.where(stuck, np.nan, getattr(c, name)) for name in names})
    return c


def _off(steps: _Steps, c: FixColumns, name: str) -> Callable[[float], BoolArray]:
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


def _stuck(t: Array, steps: _Steps, values: Array, off: Callable[[float], BoolArray]) -> BoolArray:
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


def _without_zeros_of_slow(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns without the zeros of a receiver that writes 0 for any low speed, where the positions move on.

    Taken for measured, the positions of a kart that is pushed would pass for those of a receiver that has not settled.
    Those of one that has not are left to the zeros: they come to rest, where a kart is pushed to drive. Of a receiver
    that surely writes them a kart that creeps up to its stop, or on from it, is one too, and nothing is measured
    while it comes to rest.
    """
    speed = sent_speed(c)
    lowest = float(np.min(speed[speed > 0.0], initial=np.inf))
    if not LEAST_THRESHOLD <= lowest < np.inf:
        return c
    least = NOISE_TIMES * _steps_of(t, c).noise(slice(None)) * BASELINE  # m
    is_sure, wrong = _is_threshold(t, speed, lowest), np.zeros(t.size, dtype=np.bool_)
    for first, end in _stretches(speed == 0.0, 0):
        if not is_sure and end - first < STUCK_ROWS:
            continue
        moves = _move(t, c, first, end, least)
        for begin, behind in _stretches(_or_beside(t[first:end], moves) if is_sure else moves, first):
            is_way = _drives_on(t, c, behind, end)
            is_far = _way(c, begin, behind - 1) > LEAST_SLOW_WAY and (is_way or _is_settled(t, begin))
            wrong[begin:behind] = is_far or (is_sure and (is_way or _comes_from_driving(t, c, begin, first)))
        if is_sure:
            wrong[first:end] |= _beside_motion(t, first, end)
    if count := int(np.count_nonzero(wrong)):
        where = f"while the positions move on{f' or within {BESIDE_MOTION:g} s of motion' if is_sure else ''}"
        text = f"speed is 0 in {counted(count, 'row')} {where}, and never between 0 and {lowest:.2g} m/s"
        rows.say("speed_threshold", f"{text}; not used there", count)
        names = ("speed", "velocity_north", "velocity_east", "velocity_up")
        c = replace(c, **{name: np.where(wrong, np.nan, getattr(c, name)) for name in names})
    return c


def _is_threshold(t: Array, speed: Array, lowest: float) -> bool:
    """Whether speeds (N,) pass so often, and so slowly, from 0 to `lowest` m/s or back that some between were due."""
    if lowest < SURE_THRESHOLD or t.size < 3:
        return False
    usual = float(np.median(np.diff(t)))
    missed = 0.0
    for one, two, three in ((0, 1, 2), (2, 1, 0)):  # at rest, moving, and what comes after, or came before
        still, slow, quick = (speed[k : speed.size - 2 + k] for k in (one, two, three))
        whole = np.isfinite(quick) & (t[2:] - t[:-2] < 3.0 * usual)
        change = np.abs(quick - slow)[(still == 0.0) & (slow > 0.0) & whole]
        missed += float(np.sum(np.clip(lowest / np.maximum(change, 1e-3) - 1.0, 0.0, MOST_MISSED)))
    return missed >= ENOUGH_MISSED


def _beside_motion(t: Array, first: int, end: int) -> BoolArray:
    """Mask of the rows first to end of zeros that come soon after motion, or before: the kart has yet to stop."""
    at = t[first:end]
    beside = np.zeros(at.size, dtype=np.bool_)
    if first > 0:
        beside |= at - t[first - 1] < BESIDE_MOTION
    if end < t.size:
        beside |= t[end] - at < BESIDE_MOTION
    return beside


def _move(t: Array, c: FixColumns, first: int, end: int, least: float) -> BoolArray:
    """Mask of the rows first to end about which positions move on.

    least : m that they have to, in SLOW_TIME, to be told from noise.
    """
    north, east = metres(c)
    at = t[first:end]
    before, after = first + np.searchsorted(at, [at - 0.5 * SLOW_TIME, at + 0.5 * SLOW_TIME])
    after = np.minimum(after, end - 1)
    return np.asarray(_distance(north, east, before, after) > np.maximum(LEAST_SLOW * (t[after] - t[before]), least))


def _or_beside(t: Array, mask: BoolArray) -> BoolArray:
    """The mask (N,) of rows at t (N,) s, and of those within BESIDE_MOTION of them."""
    count = np.concatenate([[0], np.cumsum(mask)])
    before, after = np.searchsorted(t, t - BESIDE_MOTION), np.searchsorted(t, t + BESIDE_MOTION, side="right")
    return np.asarray(count[after] > count[before])


def _stretches(mask: BoolArray, first: int) -> Iterator[tuple[int, int]]:
    """First row and the one behind the last of each run of the mask, which begins at row `first`."""
    yield from zip(*((first + index).tolist() for index in runs_of(mask)), strict=True)


def _way(c: FixColumns, first: int, last: int) -> float:
    """How far, m, from one row to another."""
    north, east = metres(c)
    return float(np.hypot(north[last] - north[first], east[last] - east[first]))


def _is_settled(t: Array, row: int) -> bool:
    """Whether a receiver has had its satellites for long: positions of one that stands drift in before."""
    holes = np.flatnonzero(np.diff(t[: row + 1]) > SLOW_TIME)
    return bool(t[row] - t[holes[-1] + 1 if holes.size else 0] > SETTLED)


def _drives_on(t: Array, c: FixColumns, behind: int, end: int) -> bool:
    """Whether positions that moved up to row `behind` go on the same way from row `end` on, where speeds are sent."""
    if end == t.size or t[end] - t[behind - 1] > 0.5 * SLOW_TIME:
        return False
    before = int(np.searchsorted(t, t[end] - SLOW_TIME))
    after = min(int(np.searchsorted(t, t[end] + 0.5 * SLOW_TIME)), t.size - 1)
    return _is_same_way(c, before, end, after)


def _comes_from_driving(t: Array, c: FixColumns, begin: int, first: int) -> bool:
    """Whether positions that move from row `begin` on came the same way up to row `first`, the first without speed."""
    if first == 0 or t[begin] - t[first - 1] > 0.5 * SLOW_TIME:
        return False
    before = int(np.searchsorted(t, t[first - 1] - 0.5 * SLOW_TIME))
    after = min(int(np.searchsorted(t, t[first - 1] + SLOW_TIME)), t.size - 1)
    return _is_same_way(c, before, first - 1, after)


def _is_same_way(c: FixColumns, before: int, at: int, after: int) -> bool:
    """Whether positions go on from row `at` as they came to it."""
    north, east = metres(c)
    came, goes = (np.array([north[k] - north[i], east[k] - east[i]]) for i, k in ((before, at), (at, after)))
    return bool(came @ goes > SAME_WAY * np.linalg.norm(came) * np.linalg.norm(goes))


def _without_repeats(rows: RowFilter, c: FixColumns) -> FixColumns:
    """The columns without the velocities of a receiver that renews them less often than its positions.

    Each is then repeated as often, until the next one comes; what is merely coarse, or steady, is repeated now more
    often and now less. The positions have to change from row to row. What stands for longer was measured anew each
    time one was due: of a kart that stands, the zeros hold positions that have not settled.
    """
    velocity = np.column_stack([c.speed, c.course_deg, c.velocity_north, c.velocity_east])
    same = (velocity[1:] == velocity[:-1]) | (np.isnan(velocity[1:]) & np.isnan(velocity[:-1]))
    same = np.append(False, np.all(same, axis=1))
    moves = np.append(True, (np.diff(c.lat_deg) != 0.0) | (np.diff(c.lon_deg) != 0.0))
    begins = np.flatnonzero(~same)
    if begins.size < FEWEST_RENEWED:
        return c
    lengths, is_moving = np.diff(begins), np.logical_and.reduceat(moves, begins)[:-1]
    usual = float(np.median(lengths[is_moving])) if np.count_nonzero(is_moving) >= FEWEST_RENEWED else 1.0
    if usual < 2.0 or np.mean(lengths[is_moving] == usual) < RENEWED_ALIKE:
        return c
    repeats = same & moves & np.any(np.isfinite(velocity), axis=1) & ~_are_due(begins, same.size, usual)
    count = int(np.count_nonzero(repeats))
    text = f"speed and course are new in one of {usual:.0f} rows only, and repeated in {counted(count, 'row')}"
    rows.say("velocity_repeated", f"{text}; not used there", count)
    names = ("speed", "course_deg", "velocity_north", "velocity_east", "velocity_up")
    return replace(c, **{name: np.where(repeats, np.nan, getattr(c, name)) for name in names})


def _are_due(begins: IntArray, n: int, usual: float) -> BoolArray:
    """Mask (n,) of the rows in which a new value is due every `usual` rows, in runs that begin at rows `begins`.

    A rest that is no more than half as long is of a value that came late, not of another.
    """
    length = np.diff(np.append(begins, n))
    run = np.repeat(np.arange(begins.size), length)
    place = np.arange(n) - begins[run]
    return np.asarray((place % usual == 0.0) & (length[run] - place > 0.5 * usual))


def _without_wrong_course(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns without direction where it mostly points elsewhere than the positions go.

    Components that agree once north and east are exchanged are exchanged, and said.
    """
    has_parts = np.isfinite(c.velocity_north) & np.isfinite(c.velocity_east)
    course = np.where(has_parts, np.degrees(np.arctan2(c.velocity_east, c.velocity_north)), c.course_deg)
    steps = _steps_of(t, c)
    known = steps.whole & np.isfinite(course) & ~_says_slow(c)
    told = known & steps.told(steps.noise(known)) if np.any(known) else known
    if np.count_nonzero(told) < FEWEST_STEPS or np.ptp(t[told]) < STUCK_TIME:
        return c
    off = _mostly_off(t, steps, course, told)
    if off <= COURSE_OFF:
        return c
    if _are_exchanged(t, steps, c, told & has_parts):
        rows.say("velocity_exchanged", "by its positions its velocities north and east are exchanged; taken as such", 1)
        return replace(c, velocity_north=c.velocity_east, velocity_east=c.velocity_north)
    others = ((how, _mostly_off(t, steps, other(course), told)) for how, other in _OTHER_COURSES.items())
    hint = next((f", as if {how}" for how, rest in others if rest < COURSE_ALIKE), "")
    rows.say("course_wrong", f"course is mostly {off:.0f} deg off the way of the positions{hint}; not used", 1)
    unknown = np.full(t.size, np.nan)
    return replace(c, course_deg=unknown, velocity_north=unknown, velocity_east=unknown, velocity_up=unknown)


def _backwards_in_parts(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns without direction where for some seconds it points against the way of the positions.

    With the rows beside that are too slow to tell. However late it is, in no bend does a course do that for so long.
    """
    has_parts = np.isfinite(c.velocity_north) & np.isfinite(c.velocity_east)
    course = np.where(has_parts, np.degrees(np.arctan2(c.velocity_east, c.velocity_north)), c.course_deg)
    steps = _steps_of(t, c)
    known = steps.whole & np.isfinite(course) & ~_says_slow(c)
    told = np.flatnonzero(known & steps.told(steps.noise(known))) if np.any(known) else np.empty(0, dtype=np.intp)
    wrong, ends = np.zeros(t.size, dtype=np.bool_), np.concatenate([[-1], told, [t.size]])
    for first, end in _stretches(steps.angle_from(course)[told] > BACKWARDS, 0):
        if end - first >= BACKWARDS_ROWS and t[told[end - 1]] - t[told[first]] > BACKWARDS_TIME:
            wrong[ends[first] + 1 : ends[end + 1]] = True
    wrong &= np.isfinite(course)
    if not (count := int(np.count_nonzero(wrong))):
        return c
    where = f"course points against the way of the positions in {counted(count, 'row')}"
    rows.say("course_backwards", f"{where}, from {t[np.argmax(wrong)]:.0f} s on; not used there", count)
    names = ("course_deg", "velocity_north", "velocity_east", "velocity_up")
    return replace(c, **{name: np.where(wrong, np.nan, getattr(c, name)) for name in names})


def _are_exchanged(t: Array, steps: _Steps, c: FixColumns, told: BoolArray) -> bool:
    """Whether components of velocity agree with the positions once north and east are exchanged; by the steps `told`.

    Of latitude and longitude exchanged the directions agree as well; but what was taken for a degree of one is not as
    long as one of the other, and the two components differ from their positions by different factors.
    """
    if np.count_nonzero(told) < FEWEST_STEPS:
        return False
    if _mostly_off(t, steps, np.degrees(np.arctan2(c.velocity_north, c.velocity_east)), told) > COURSE_ALIKE:
        return False
    pairs = ((steps.north, c.velocity_east), (steps.east, c.velocity_north))
    with np.errstate(divide="ignore"):  # of a column that is 0 throughout
        factors = [float(np.sqrt(np.mean(step[told] ** 2) / np.mean(sent[told] ** 2))) for step, sent in pairs]
    return max(factors) < AXES_ALIKE * min(factors)


def _without_wrong_climb(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns without velocities upwards that clearly contradict the heights: in km/h, or positive downwards.

    Heights that are in feet by these velocities are turned into metres.
    """
    share, sigma = _rise_by_climb(t, c)
    if share + CLEARLY * sigma <= LEAST_RISE:
        what = "fall where its heights rise" if share < 0.0 else f"are {1.0 / share:.1f} times what its heights rise"
        rows.say("climb_wrong", f"its velocities upwards {what}; not used. Are they in m/s, and positive upwards?", 1)
        return replace(c, velocity_up=np.full(t.size, np.nan))
    if abs(share * FOOT - 1.0) < SAME_FOOT and share - CLEARLY * sigma > LEAST_RISE_IN_FEET:
        text = f"its heights rise {share:.1f} times as fast as its velocities upwards say, as if in feet; taken as such"
        rows.say("height_unit", text, 1)
        return replace(c, alt_m=c.alt_m * FOOT)
    return c


def _rise_by_climb(t: Array, c: FixColumns) -> tuple[float, float]:
    """Metres of height for one that the velocities upwards tell, and its sigma; NaN where the two are not alike."""
    unknown = float("nan"), float("nan")
    known = np.flatnonzero(np.isfinite(c.velocity_up) & np.isfinite(c.alt_m))
    if known.size < FEWEST_STEPS:
        return unknown
    at, up, height = t[known], c.velocity_up[known], c.alt_m[known]
    way = np.concatenate([[0.0], np.cumsum(0.5 * (up[1:] + up[:-1]) * np.diff(at))])
    bounds = np.append(0, np.flatnonzero(np.diff(np.floor((at - at[0]) / CLIMB_TIME))) + 1)
    whole = np.diff(at[bounds]) < 1.5 * CLIMB_TIME
    told, risen = np.diff(way[bounds])[whole], np.diff(height[bounds])[whole]
    if told.size < FEWEST_STEPS or not (np.any(told) and np.any(risen)):
        return unknown
    alike = float(np.sum(told * risen) / np.sqrt(np.sum(told**2) * np.sum(risen**2)))
    if abs(alike) < CLEARLY_ALIKE:
        return unknown
    share = float(np.sum(told * risen) / np.sum(told**2))
    return share, abs(share / alike) * math.sqrt(max(0.0, 1.0 - alike**2) / told.size)


def _mostly_off(t: Array, steps: _Steps, course_deg: Array, told: BoolArray) -> float:
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
