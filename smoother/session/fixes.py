"""Columns of fixes, from whatever file, to GnssFixes: choose the usable rows, normalise the values, count the rest."""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, is_increasing
from smoother.frames import velocity_n_from_course
from smoother.samples import GnssFixes, Problem
from smoother.session.doppler import without_wrong_velocity
from smoother.session.fix_columns import ESTIMATED, FixColumns, metres, sent_speed, way_from_before
from smoother.session.heights import without_height_jumps, without_impossible_heights
from smoother.session.interpolated import measured_rows, on_drawn_lines, rows_at_knots
from smoother.session.rows import RowFilter, put_in_time_order
from smoother.words import counted

ABSURD_SPEED = 150.0  # m/s, 540 km/h
ABSURD_CLIMB = 50.0  # m/s
ABSURD_SATELLITES = 100
ABSURD_HEIGHT = (-1000.0, 20000.0)  # m
UNUSABLE_SIGMA = 1000.0  # m; a receiver that says this of itself has no fix
# What no receiver is unsure by in most of its fixes, by the columns of gps.csv; a thousandth is usual.
MOST_USUAL = (
    ("sigma_horizontal", "hacc_m", "m", 200.0),
    ("sigma_up", "vacc_m", "m", 300.0),
    ("sigma_velocity", "sacc_mps", "m/s", 20.0),
)
EVEN = 20.0  # times; places by the masts of a network are as unsure as they say, and leap from one to the next
FEW_BAD_VALUES = 0.1  # above this share it is the column that is wrong, not the rows
NEARLY_STILL = 0.15  # m/s; noise of a receiver's speed at rest: its direction means nothing
MOVING = 1.0  # m/s; faster than this a position does not repeat exactly
HELD_SHARE = 0.5  # of the rows in motion that repeat the whole row before
HELD_ROUND = 0.01  # of a fix a second
STALE_DISTANCE = 0.3  # m; a repeated position that is wrong by less does no harm
STALE_STEPS = 1.5  # times the resolution of the file: with few decimals a slow position does repeat
FEWEST_HELD = 5  # rows at one place
HELD_FROM = 0.8  # m/s at the first of them; receivers that hold what they show at rest do so from 0.5 and less
LEAST_LINE = 100.0  # m; a shorter way may be along a parallel or a meridian, to the last decimal of a coarse file
MANY_PLACES = 50  # of which two would differ by a digit if they were measured
CLEARLY_ACROSS, SHARE_ACROSS = 1.0, 0.1  # m/s up and down a coordinate that stands, and in how many rows each
# m, and times the way from row to row and the resolution, of a leap from there
LEAP, LEAP_TIMES = 2.5, 1.5
ROUNDING = 1e-4  # m; steps below come from the conversion
JUMP_DISTANCE = 1000.0  # m; a fix this far off its neighbours, beyond what speed explains, is a damaged row


def screen_fixes(
    columns: FixColumns, file: str, *, has_rows_between: bool = False, is_alone: bool = False
) -> tuple[GnssFixes, list[Problem]]:
    """Return the usable fixes of a file in time order (maybe none) and what was wrong with the others.

    has_rows_between : whoever read the file left out rows that its exporter interpolated between fixes.
    is_alone : there are no samples on the clock of the fixes.
    """
    rows = RowFilter(file, "gps", np.ones(columns.t.size, dtype=np.bool_), is_alone=is_alone)
    columns = _accuracies_in_metres(rows, columns)
    _drop_without_fix(rows, columns)
    _drop_impossible(rows, columns)
    time, index = put_in_time_order(rows, columns.t, columns.lat_deg, columns.lon_deg)
    _drop_without_coordinate(rows, columns)
    time, index = time[rows.keep[index]], index[rows.keep[index]]
    ordered = without_wrong_velocity(rows, time, columns.take(index))
    fresh = _fresh_rows(time, ordered)
    if fresh.size < time.size:
        rows.problems.append(_held_note(file, time[fresh], time.size - fresh.size))
        time, index, ordered = time[fresh], index[fresh], ordered.take(fresh)
    for find, code, reason in (
        (_is_jump, "jump", "farther from the others than any vehicle moves"),
        (_is_stale, "repeated", "repeating the position before while moving"),
        (_is_held, "held", "at a place that the receiver held, and leapt from when it let go: it had moved meanwhile"),
    ):
        bad = find(time, ordered)
        mask = np.zeros_like(rows.keep)
        mask[index[bad]] = True
        rows.drop(mask, code, reason)
        time, index, ordered = time[~bad], index[~bad], ordered.take(np.flatnonzero(~bad))
    measured = _measured(time, ordered)
    if measured is not None:
        rows.problems += interpolated_note(file, time.size - measured.size)
        time, ordered = time[measured], ordered.take(measured)
    if measured is not None or has_rows_between:
        drawn = _on_drawn_lines(time, ordered)
        rows.problems += _drawn_note(file, int(np.count_nonzero(drawn)))
        time, ordered = time[~drawn], ordered.take(np.flatnonzero(~drawn))
    return _to_fixes(rows, time, ordered), rows.problems


def _measured(t: Array, c: FixColumns) -> IntArray | None:
    """Rows (K,) of the fixes that are not on the line between others, by their stamps t (N,) s or by UTC; None if all.

    Stamps are those of the arrival, now sooner, now later: what is a straight line by UTC is none by them. Nor is the
    size of velocities north and east that are.
    """
    times = [t, c.unix_s - c.unix_s[:1]] if is_increasing(c.unix_s) else [t]
    for channels in ([c.lat_deg, c.lon_deg, c.alt_m, c.speed], [c.lat_deg, c.lon_deg, c.alt_m]):
        for moments in times:
            if (rows := measured_rows(moments, channels)) is not None:
                return rows
    return None


def _on_drawn_lines(t: Array, c: FixColumns) -> BoolArray:
    """Mask (N,) of the fixes that are on the line which an exporter drew over an outage."""
    return on_drawn_lines(t, [c.lat_deg, c.lon_deg, c.speed], way_from_before(c))


def _drawn_note(file: str, count: int) -> list[Problem]:
    text = f"{file}: {counted(count, 'fix')} on straight lines that the exporter drew over outages; left out"
    return [Problem("gps_drawn", text, count)] if count else []


def interpolated_note(file: str, count: int) -> list[Problem]:
    """Say that a file has rows between its fixes."""
    made_up = "positions between fixes were made up along straight lines, by exporter or receiver"
    text = f"{file}: {made_up}; {counted(count, 'row')} left out"
    return [Problem("gps_interpolated", text, count)] if count else []


def _accuracies_in_metres(rows: RowFilter, c: FixColumns) -> FixColumns:
    """The columns with accuracies in metres that were stated in millimetres, as u-blox receivers send them."""
    with np.errstate(invalid="ignore"):
        has_fix = ~((c.fix < 1.0) | c.is_blank) & (np.abs(c.lat_deg) <= 90.0) & (np.abs(c.lon_deg) <= 360.0)
    changed = {}
    for name, called, unit, most in MOST_USUAL:
        values = getattr(c, name)
        known = values[has_fix & np.isfinite(values)]
        middle = float(np.median(known)) if known.size else 0.0
        if most < middle < 1000.0 * most and middle > EVEN * _bends(c.take(np.flatnonzero(has_fix))):
            changed[name] = 1e-3 * values
            text = f"{called} is {middle:.0f} in the middle, as if in m{unit}; taken as such"
            rows.say("accuracy_unit", text, int(known.size))
    return replace(c, **changed)


def _bends(c: FixColumns) -> float:
    """By how much, m, the way from place to place typically differs from the one before; 0 where there are too few."""
    moved = np.flatnonzero((np.diff(c.lat_deg) != 0.0) | (np.diff(c.lon_deg) != 0.0)) + 1
    ways = metres(c.take(moved))
    return float(np.median(np.hypot(*np.diff(ways, 2)))) if moved.size > MANY_PLACES else 0.0


def _drop_without_fix(rows: RowFilter, c: FixColumns) -> None:
    with np.errstate(invalid="ignore"):
        estimated = (c.fix == ESTIMATED) & ~c.is_blank
        searching, unsure = ((c.fix < 1.0) & ~estimated) | c.is_blank, c.sigma_horizontal > UNUSABLE_SIGMA
    if np.any(unsure & ~searching) and np.all(unsure | searching):  # then it is the column that is wrong
        rows.drop(unsure & ~searching, "sigma_absurd", f"sure to more than {UNUSABLE_SIGMA:.0f} m (is hacc_m in m?)")
    rows.drop((searching | unsure) & np.isfinite(c.t), "no_fix", "without a fix")
    if np.any(rows.keep & ~estimated):
        rows.drop(estimated, "estimated", "that the receiver estimated without satellites")
    elif count := int(np.count_nonzero(rows.keep)):
        text = f"{counted(count, 'row')}, all that are fixes, estimated by the receiver without satellites; used"
        rows.say("estimated_used", text, count)
    rows.drop(~(np.isfinite(c.t) & np.isfinite(c.lat_deg) & np.isfinite(c.lon_deg)), "invalid", _UNREADABLE)


NEAR_NULL = 1.0  # deg; of a track at the equator or Greenwich
_UNREADABLE = "with an empty or unreadable time or position"


def _drop_impossible(rows: RowFilter, c: FixColumns) -> None:
    with np.errstate(invalid="ignore"):
        outside = (np.abs(c.lat_deg) > 90.0) | (c.lon_deg < -180.0) | (c.lon_deg > 360.0)
        rows.drop(outside, "absurd", "at a position that is not on Earth")
        rows.drop((c.lat_deg == 0.0) & (c.lon_deg == 0.0), "null_island", "at the position 0, 0 (no fix yet)")
        for name, values in (("latitude", c.lat_deg), ("longitude", c.lon_deg)):
            if np.any(np.abs(values[rows.keep]) > NEAR_NULL):  # else they may be those that are right
                rows.drop(values == 0.0, "null_half", f"whose {name} is 0, far from that of others; mend that column")
        too_fast = _too_fast(c)
    if np.count_nonzero(too_fast & rows.keep) <= FEW_BAD_VALUES * np.count_nonzero(rows.keep):
        rows.drop(too_fast, "too_fast", f"with a speed above {ABSURD_SPEED:.0f} m/s")


def _drop_without_coordinate(rows: RowFilter, c: FixColumns) -> None:
    """Drop all where one coordinate stands at one number in every row, and the velocities sent go on across it.

    Its decimals were lost. What is left of the track is a line there and back, on which laps are found all the same.
    """
    kept = np.flatnonzero(rows.keep)
    if kept.size < MANY_PLACES:
        return
    velocity_n = _velocity_n(c, c.speed, c.course_deg)[kept]
    north, east = (np.ptp(way) for way in metres(c.take(kept)))
    for axis, name, values, way in ((0, "latitude", c.lat_deg[kept], east), (1, "longitude", c.lon_deg[kept], north)):
        across = velocity_n[:, axis]
        to_both_sides = min(np.mean(across > CLEARLY_ACROSS), np.mean(across < -CLEARLY_ACROSS))
        if np.ptp(values) == 0.0 and way > LEAST_LINE and to_both_sides > SHARE_ACROSS:
            reason = f"whose {name} is {values[0]:.10g} in all, while the kart drives across (save all its decimals)"
            rows.drop(rows.keep, "coordinate_stands", reason)


def _too_fast(c: FixColumns) -> BoolArray:
    return np.asarray((c.speed > ABSURD_SPEED) | (np.hypot(c.velocity_north, c.velocity_east) > ABSURD_SPEED))


def _is_jump(t: Array, c: FixColumns) -> BoolArray:
    """Mask of rows that cannot be reached at any speed from the longest run of rows that follow one another."""
    bad = np.zeros(t.size, dtype=np.bool_)
    if t.size < 3:
        return bad
    north, east = metres(c)
    cuts = np.flatnonzero(np.hypot(np.diff(north), np.diff(east)) > JUMP_DISTANCE + ABSURD_SPEED * np.diff(t)) + 1
    bounds = np.concatenate([[0], cuts, [t.size]])
    main = int(np.argmax(np.diff(bounds)))

    def sweep(pieces: range, near: int) -> None:
        """Walk away from the main run; `near` is its row that faces the pieces."""
        for piece in pieces:
            first, last = int(bounds[piece]), int(bounds[piece + 1]) - 1
            facing, far = (first, last) if first > near else (last, first)
            distance = np.hypot(north[facing] - north[near], east[facing] - east[near])
            if distance > JUMP_DISTANCE + ABSURD_SPEED * abs(t[facing] - t[near]):
                bad[first : last + 1] = True
            else:
                near = far

    sweep(range(main + 1, bounds.size - 1), int(bounds[main + 1]) - 1)
    sweep(range(main - 1, -1, -1), int(bounds[main]))
    return bad


def _fresh_rows(t: Array, c: FixColumns) -> IntArray:
    """Rows (K,) of the fixes where each is written again until the next one comes, as at a sensor's rate; else all.

    At rest a receiver may repeat itself, while moving it does not. Rows at rest stay as often as fixes come.
    """
    if t.size < 3:
        return np.arange(t.size)
    values = [c.lat_deg, c.lon_deg, c.speed, c.course_deg, c.alt_m]
    same = np.append(False, np.all([(v[1:] == v[:-1]) | np.isnan(v[1:] + v[:-1]) for v in values], axis=0))
    moving = _speed_at_rows(t, c, ~same) > MOVING
    if np.count_nonzero(same & _is_stale(t, c)) <= HELD_SHARE * np.count_nonzero(moving):
        return np.arange(t.size)
    fresh = np.flatnonzero(~same)
    knots = rows_at_knots(t, t[fresh])
    return fresh if knots is None else knots


def _held_note(file: str, t: Array, count: int) -> Problem:
    """Say that fixes at t (K,) s were written again."""
    rate = 1.0 / float(np.median(np.diff(t)))
    often = "once a second" if abs(rate - 1.0) < HELD_ROUND else f"{rate:.3g} times a second"
    return Problem(
        "gps_repeated", f"{file}: fixes come {often} and are repeated; {counted(count, 'row')} left out", count
    )


def _is_stale(t: Array, c: FixColumns) -> BoolArray:
    """Mask of rows that repeat the position before although the vehicle moved: old fixes written again."""
    repeats = np.zeros(t.size, dtype=np.bool_)
    repeats[1:] = (np.diff(c.lat_deg) == 0.0) & (np.diff(c.lon_deg) == 0.0)
    if not np.any(repeats):
        return repeats
    north, east = metres(c)
    run = np.cumsum(~repeats) - 1  # which fresh row each row repeats
    speed = _speed_at_rows(t, c, ~repeats)
    moving = repeats & (speed > MOVING)
    advance = speed * np.diff(t, prepend=t[0])
    moved = np.bincount(run, np.where(moving, advance, 0.0))
    return np.asarray(moving & (moved[run] > max(STALE_DISTANCE, STALE_STEPS * _resolution(north, east, advance))))


def _is_held(t: Array, c: FixColumns) -> BoolArray:
    """Mask of rows at a place that was held from when the kart still drove, and leapt from farther than it drives.

    A receiver with static navigation takes a slow kart to stand, and a lost one may repeat its last place. The place is
    wrong, for how long nobody can tell; its first row was right. One that came to rest first, and holds what it shows
    there, leaps by what it wandered meanwhile: it was where it stood.
    """
    held = np.zeros(t.size, dtype=np.bool_)
    if t.size < FEWEST_HELD + 1:
        return held
    north, east = metres(c)
    step, speed = np.hypot(np.diff(north), np.diff(east)), sent_speed(c)
    driven = np.fmax(speed[1:], MOVING) * np.diff(t)
    last = np.flatnonzero(step > 0.0)  # rows that are left
    first = np.concatenate([[0], last[:-1] + 1])
    least = max(LEAP, LEAP_TIMES * _resolution(north, east, np.append(0.0, driven)))
    leaps = step > least + LEAP_TIMES * driven
    wrong = leaps[last] & (speed[first] > HELD_FROM) & (last + 1 - first >= FEWEST_HELD)
    for begin, end in zip(first[wrong], last[wrong], strict=True):
        held[begin + 1 : end + 1] = True
    return held


def _speed_at_rows(t: Array, c: FixColumns, fresh: BoolArray) -> Array:
    """Speed (N,) m/s as sent, else by the positions of the `fresh` rows (N,); each of the others repeats one."""
    north, east = metres(c)
    rows = np.flatnonzero(fresh)
    by_position = _speed_from_positions(t[rows], north[rows], east[rows])[np.cumsum(fresh) - 1]
    speed = sent_speed(c)
    return np.where(np.isfinite(speed), speed, by_position)


def _speed_from_positions(t: Array, north: Array, east: Array) -> Array:
    """Speed at each row, the lesser of the step before and the step after; zero at the ends."""
    if t.size < 3:
        return np.zeros(t.size)
    step = np.hypot(np.diff(north), np.diff(east)) / np.diff(t)
    return np.concatenate([[0.0], np.minimum(step[1:], step[:-1]), [0.0]])


def _resolution(north: Array, east: Array, moved: Array) -> float:
    """Smallest step (m) the positions make; moved (N,) m is what the speed says of each interval.

    Steps that are mostly alike and as long as the speed says come from a steady motion and not from a coarse grid.
    """

    def smallest(values: Array) -> float:
        steps = np.abs(np.diff(values))
        return float(np.min(steps[steps > ROUNDING], initial=np.inf))

    step = np.hypot(np.diff(north), np.diff(east))
    step, moved = step[step > ROUNDING], moved[1:][step > ROUNDING]
    if step.size == 0 or (np.median(step) < 1.1 * np.percentile(step, 10) <= 1.2 * np.median(moved)):
        return 0.0
    return max((size for size in (smallest(north), smallest(east)) if np.isfinite(size)), default=0.0)


def _to_fixes(rows: RowFilter, t: Array, c: FixColumns) -> GnssFixes:
    with np.errstate(invalid="ignore"):
        speed = _cleaned(rows, c.speed, (c.speed < 0.0) | (c.speed > ABSURD_SPEED), "speed", "speed")
        course = np.mod(_cleaned(rows, c.course_deg, np.abs(c.course_deg) > 720.0, "course", "course"), 360.0)
        alt = _cleaned(rows, c.alt_m, (c.alt_m < ABSURD_HEIGHT[0]) | (c.alt_m > ABSURD_HEIGHT[1]), "height", "height")
        satellites = _cleaned(
            rows, c.num_sv, (c.num_sv < 0.0) | (c.num_sv >= ABSURD_SATELLITES), "satellites", "number of satellites"
        )
        alt = without_impossible_heights(rows, t, np.cumsum(way_from_before(c)), alt)
        hdop = np.where((c.hdop > 0.0) & (c.hdop < 99.0), c.hdop, np.nan)  # 99.99 stands for unknown
    return GnssFixes(
        t=t,
        lat_deg=c.lat_deg,
        lon_deg=np.where(c.lon_deg > 180.0, c.lon_deg - 360.0, c.lon_deg),
        alt_m=without_height_jumps(rows, t, alt),
        velocity_n=_velocity_n(c, speed, course),
        speed=speed,
        course_deg=course,
        sigma_horizontal=_positive(c.sigma_horizontal),
        sigma_up=_positive(c.sigma_up),
        sigma_velocity=_positive(c.sigma_velocity),
        hdop=hdop,
        unix_s=c.unix_s,
        num_sv=np.where(np.isfinite(satellites), satellites, -1.0).astype(np.int64),
        fix=np.where(np.isfinite(c.fix), np.minimum(np.ceil(c.fix), 99.0), 1.0).astype(np.int64),
    )


def _cleaned(rows: RowFilter, values: Array, bad: BoolArray, code: str, what: str) -> Array:
    count = int(np.count_nonzero(bad))
    if count:
        rows.say(f"{code}_absurd", f"{count} x an impossible {what}; that value ignored", count)
    return np.where(bad, np.nan, values)


def _positive(sigma: Array) -> Array:
    with np.errstate(invalid="ignore"):
        return np.where(sigma > 0.0, sigma, np.nan)


def _velocity_n(c: FixColumns, speed: Array, course_deg: Array) -> Array:
    """Velocity in n (N, 3): components where sent, else from speed and course, NaN where neither is.

    A climb that comes alone is left out: how late a receiver is shows in level motion.
    """
    with np.errstate(invalid="ignore"):
        sent = np.stack([c.velocity_north, -c.velocity_east, c.velocity_up], axis=-1)
        plausible = np.hypot(sent[:, 0], sent[:, 1]) <= ABSURD_SPEED
        sent[~plausible, :2] = np.nan
        sent[np.abs(sent[:, 2]) > ABSURD_CLIMB, 2] = np.nan
        course = np.where(~np.isfinite(course_deg) & (speed <= NEARLY_STILL), 0.0, course_deg)
        stands = speed <= NEARLY_STILL
    still_speed = np.where(stands & ~np.isfinite(course_deg), 0.0, speed)
    computed = velocity_n_from_course(still_speed, course)
    computed[:, 2] = np.where(np.isfinite(computed[:, 0]), sent[:, 2], np.nan)
    return np.where(plausible[:, None], sent, computed)
