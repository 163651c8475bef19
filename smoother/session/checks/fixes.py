"""Checks of fixes: rows that are none, positions that jump, stand or were made up, values that nothing measures."""

from functools import partial

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, is_increasing
from smoother.session.checks.columns import FixRows
from smoother.session.checks.table import Check, Finding, dropped
from smoother.session.checks.velocity import VELOCITY_CHECKS
from smoother.session.fix_columns import ESTIMATED, FixColumns, metres, sent_speed, way_from_before
from smoother.session.interpolated import measured_rows, on_drawn_lines, rows_at_knots
from smoother.words import counted

ABSURD_SPEED = 150.0  # m/s, 540 km/h
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
MADE_UP = "positions between fixes were made up along straight lines, by exporter or receiver"
NEAR_NULL = 1.0  # deg; of a track at the equator or Greenwich


def accuracy_unit(column: str, called: str, unit: str, most: float, f: FixRows) -> Finding | None:
    """Accuracies that were stated in millimetres, as u-blox receivers send them."""
    c, values = f.columns, getattr(f.columns, column)
    with np.errstate(invalid="ignore"):
        has_fix = ~((c.fix < 1.0) | c.is_blank) & (np.abs(c.lat_deg) <= 90.0) & (np.abs(c.lon_deg) <= 360.0)
    known = values[has_fix & np.isfinite(values)]
    middle = float(np.median(known)) if known.size else 0.0
    if not most < middle < 1000.0 * most or middle <= EVEN * _bends(c.take(np.flatnonzero(has_fix))):
        return None
    text = f"{called} is {middle:.0f} in the middle, as if in m{unit}; taken as such"
    return Finding(text, int(known.size), scale={column: 1e-3})


def _bends(c: FixColumns) -> float:
    """By how much, m, the way from place to place typically differs from the one before; 0 where there are too few."""
    moved = np.flatnonzero((np.diff(c.lat_deg) != 0.0) | (np.diff(c.lon_deg) != 0.0)) + 1
    ways = metres(c.take(moved))
    return float(np.median(np.hypot(*np.diff(ways, 2)))) if moved.size > MANY_PLACES else 0.0


def _searching(c: FixColumns) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(((c.fix < 1.0) & ~_estimated(c)) | c.is_blank)


def _estimated(c: FixColumns) -> BoolArray:
    return np.asarray((c.fix == ESTIMATED) & ~c.is_blank)


def _unsure(c: FixColumns) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(c.sigma_horizontal > UNUSABLE_SIGMA)


def absurd_sigma(f: FixRows) -> Finding | None:
    """An accuracy that leaves no fix: then it is the column that is wrong."""
    unsure, searching = _unsure(f.columns), _searching(f.columns)
    all_are = np.any(unsure & ~searching) and np.all(unsure | searching)
    reason = f"sure to more than {UNUSABLE_SIGMA:.0f} m (is hacc_m in m?)"
    return dropped(unsure & ~searching, reason) if all_are else None


def no_fix(f: FixRows) -> Finding | None:
    """Rows of a receiver that has no fix yet, or lost it."""
    return dropped((_searching(f.columns) | _unsure(f.columns)) & np.isfinite(f.columns.t), "without a fix")


def estimated(f: FixRows) -> Finding | None:
    """Rows that a receiver made up without satellites, where it has others."""
    made_up = _estimated(f.columns)
    return None if np.all(made_up) else dropped(made_up, "that the receiver estimated without satellites")


def only_estimated(f: FixRows) -> Finding | None:
    """The same where it has no others."""
    count = int(np.count_nonzero(_estimated(f.columns)))
    text = f"{counted(count, 'row')}, all that are fixes, estimated by the receiver without satellites; used"
    return Finding(text, count) if count else None


def unreadable(f: FixRows) -> Finding | None:
    """Rows without time or position."""
    c = f.columns
    known = np.isfinite(c.t) & np.isfinite(c.lat_deg) & np.isfinite(c.lon_deg)
    return dropped(~known, "with an empty or unreadable time or position")


def not_on_earth(f: FixRows) -> Finding | None:
    """Positions that are none."""
    c = f.columns
    outside = (np.abs(c.lat_deg) > 90.0) | (c.lon_deg < -180.0) | (c.lon_deg > 360.0)
    return dropped(outside, "at a position that is not on Earth")


def null_island(f: FixRows) -> Finding | None:
    """The position of a receiver that has none."""
    return dropped((f.columns.lat_deg == 0.0) & (f.columns.lon_deg == 0.0), "at the position 0, 0 (no fix yet)")


def null_half(name: str, f: FixRows) -> Finding | None:
    """A coordinate of 0 where the others are far from it."""
    values = getattr(f.columns, name)
    if not np.any(np.abs(values) > NEAR_NULL):  # else they may be those that are right
        return None
    called = {"lat_deg": "latitude", "lon_deg": "longitude"}[name]
    return dropped(values == 0.0, f"whose {called} is 0, far from that of others; mend that column")


def too_fast(f: FixRows) -> Finding | None:
    """Single speeds of no vehicle; where they are many it is the column that is wrong, not the rows."""
    c = f.columns
    with np.errstate(invalid="ignore"):
        bad = (c.speed > ABSURD_SPEED) | (np.hypot(c.velocity_north, c.velocity_east) > ABSURD_SPEED)
    few = np.count_nonzero(bad) <= FEW_BAD_VALUES * bad.size
    return dropped(bad, f"with a speed above {ABSURD_SPEED:.0f} m/s") if few else None


def coordinate_stands(f: FixRows) -> Finding | None:
    """One coordinate at one number in every row, while the velocities sent go on across it: its decimals were lost.

    What is left of the track is a line there and back, on which laps are found all the same.
    """
    c = f.columns
    if c.t.size < MANY_PLACES:
        return None
    course = np.radians(c.course_deg)
    velocity = [np.where(np.isfinite(c.velocity_north), c.velocity_north, c.speed * np.cos(course))]
    velocity += [np.where(np.isfinite(c.velocity_east), c.velocity_east, c.speed * np.sin(course))]
    north, east = (np.ptp(way) for way in metres(c))
    pairs = (("latitude", c.lat_deg, east, velocity[0]), ("longitude", c.lon_deg, north, velocity[1]))
    for name, values, way, across in pairs:
        to_both_sides = min(np.mean(across > CLEARLY_ACROSS), np.mean(across < -CLEARLY_ACROSS))
        if np.ptp(values) == 0.0 and way > LEAST_LINE and to_both_sides > SHARE_ACROSS:
            reason = f"whose {name} is {values[0]:.10g} in all, while the kart drives across (save all its decimals)"
            return dropped(np.ones(c.t.size, dtype=np.bool_), reason)
    return None


def jumps(f: FixRows) -> Finding | None:
    """Rows that cannot be reached at any speed from the longest run of rows that follow one another."""
    bad = _is_jump(f.columns.t, f.columns)
    return dropped(bad, "farther from the others than any vehicle moves")


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


def written_again(f: FixRows) -> Finding | None:
    """Fixes each of which is written again until the next one comes, as at a sensor's rate."""
    t, fresh = f.columns.t, _fresh_rows(f.columns.t, f.columns)
    if fresh.size == t.size:
        return None
    rate, count = 1.0 / float(np.median(np.diff(t[fresh]))), t.size - fresh.size
    often = "once a second" if abs(rate - 1.0) < HELD_ROUND else f"{rate:.3g} times a second"
    lost = np.ones(t.size, dtype=np.bool_)
    lost[fresh] = False
    return Finding(f"fixes come {often} and are repeated; {counted(count, 'row')} left out", count, drop=lost)


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


def stale(f: FixRows) -> Finding | None:
    """Old fixes written again while the kart moves."""
    return dropped(_is_stale(f.columns.t, f.columns), "repeating the position before while moving")


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


def held(f: FixRows) -> Finding | None:
    """Positions that a receiver held while the kart still drove."""
    reason = "at a place that the receiver held, and leapt from when it let go: it had moved meanwhile"
    return dropped(_is_held(f.columns.t, f.columns), reason)


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


def interpolated(f: FixRows) -> Finding | None:
    """Rows that an exporter put between fixes, and on the lines that it drew over outages."""
    c, t = f.columns, f.columns.t
    measured = _measured(t, c)
    if measured is None:
        return None
    lost = np.ones(t.size, dtype=np.bool_)
    lost[measured] = False
    of_measured = c.take(measured)
    lost[measured[_on_drawn_lines(of_measured)]] = True
    count = int(np.count_nonzero(lost))
    return Finding(f"{MADE_UP}; {counted(count, 'row')} left out", count, drop=lost)


def drawn(f: FixRows) -> Finding | None:
    """Fixes on the lines that an exporter drew over outages, where its other rows were left out by the reader."""
    if not f.has_rows_between:
        return None
    bad = _on_drawn_lines(f.columns)
    count = int(np.count_nonzero(bad))
    text = f"{counted(count, 'fix')} on straight lines that the exporter drew over outages; left out"
    return Finding(text, count, drop=bad) if count else None


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


def _on_drawn_lines(c: FixColumns) -> BoolArray:
    return on_drawn_lines(c.t, [c.lat_deg, c.lon_deg, c.speed], way_from_before(c))


def impossible(column: str, what: str, low: float, high: float, f: FixRows) -> Finding | None:
    """Values of a column that nothing measures; the row is as good as ever."""
    values = getattr(f.columns, column)
    with np.errstate(invalid="ignore"):
        bad = (values < low) | (values > high)
    count = int(np.count_nonzero(bad))
    return Finding(f"{count} x an impossible {what}; that value ignored", count, blank={column: bad}) if count else None


ROW_CHECKS = (
    *(Check("gps_accuracy_unit", "fixes", one[:1], partial(accuracy_unit, *one)) for one in MOST_USUAL),
    Check("gps_sigma_absurd", "fixes", ("sigma_horizontal",), absurd_sigma),
    Check("gps_no_fix", "fixes", (), no_fix),
    Check("gps_estimated", "fixes", ("fix",), estimated),
    Check("gps_estimated_used", "fixes", ("fix",), only_estimated),
    Check("gps_invalid", "fixes", (), unreadable),
    Check("gps_absurd", "fixes", (), not_on_earth),
    Check("gps_null_island", "fixes", (), null_island),
    Check("gps_null_half", "fixes", (), partial(null_half, "lat_deg")),
    Check("gps_null_half", "fixes", (), partial(null_half, "lon_deg")),
    Check("gps_too_fast", "fixes", (), too_fast),
)
PATH_CHECKS = (
    Check("gps_coordinate_stands", "fixes", (), coordinate_stands),
    *VELOCITY_CHECKS,
    Check("gps_repeated", "fixes", (), written_again),
    Check("gps_jump", "fixes", (), jumps),
    Check("gps_repeated", "fixes", (), stale),
    Check("gps_held", "fixes", (), held),
    Check("gps_interpolated", "fixes", (), interpolated),
    Check("gps_drawn", "fixes", (), drawn),
    Check("gps_speed_absurd", "fixes", ("speed",), partial(impossible, "speed", "speed", 0.0, ABSURD_SPEED)),
    Check("gps_course_absurd", "fixes", ("course_deg",), partial(impossible, "course_deg", "course", -720.0, 720.0)),
    Check("gps_height_absurd", "fixes", ("alt_m",), partial(impossible, "alt_m", "height", *ABSURD_HEIGHT)),
    Check(
        "gps_satellites_absurd",
        "fixes",
        ("num_sv",),
        partial(impossible, "num_sv", "number of satellites", 0.0, ABSURD_SATELLITES - 1.0),
    ),
)
