"""Checks of fixes: rows without a fix, positions that jump, repeat or were interpolated, and impossible values."""

from functools import partial

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.session.checks.table import Check, Finding, dropped
from smoother.session.checks.velocity import VELOCITY_CHECKS
from smoother.session.fix_columns import ABSURD_SPEED, FixColumns, FixRows, metres, sent_speed, way_from_before
from smoother.session.interpolated import on_drawn_lines
from smoother.words import counted

ABSURD_SATELLITES = 100
ABSURD_HEIGHT = (-1000.0, 20000.0)  # m
UNUSABLE_SIGMA = 1000.0  # m; a receiver that says this of itself has no fix
FEW_BAD_VALUES = 0.1  # above this share it is the column that is wrong, not the rows
MOVING = 1.0  # m/s; faster than this a position does not repeat exactly
STALE_DISTANCE = 0.3  # m; a repeated position that is wrong by less does no harm
STALE_STEPS = 1.5  # times the resolution of the file: with few decimals a slow position does repeat
ROUNDING = 1e-4  # m; steps below come from the conversion
JUMP_DISTANCE = 1000.0  # m; a fix this far off its neighbours, beyond what speed explains, is a damaged row
INTERPOLATED = "positions between fixes were interpolated along straight lines by exporter or receiver"


def _searching(c: FixColumns) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray((c.fix < 1.0) | c.is_blank)


def _unsure(c: FixColumns) -> BoolArray:
    with np.errstate(invalid="ignore"):
        return np.asarray(c.sigma_horizontal > UNUSABLE_SIGMA)


def no_fix(f: FixRows) -> Finding | None:
    """Rows of a receiver that has no fix yet, or lost it."""
    return dropped((_searching(f.columns) | _unsure(f.columns)) & np.isfinite(f.columns.t), "without a fix")


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


def too_fast(f: FixRows) -> Finding | None:
    """Single speeds of no vehicle; where they are many it is the column that is wrong, not the rows."""
    c = f.columns
    with np.errstate(invalid="ignore"):
        bad = (c.speed > ABSURD_SPEED) | (np.hypot(c.velocity_north, c.velocity_east) > ABSURD_SPEED)
    few = np.count_nonzero(bad) <= FEW_BAD_VALUES * bad.size
    return dropped(bad, f"with a speed above {ABSURD_SPEED:.0f} m/s") if few else None


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
    """Smallest step (m) the positions make; moved (N,) m : way of each interval by the speed.

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


def drawn(f: FixRows) -> Finding | None:
    """Fixes on the lines that an exporter drew over outages, where its other rows were left out by the reader."""
    if not f.has_rows_between:
        return None
    bad = _on_drawn_lines(f.columns)
    count = int(np.count_nonzero(bad))
    text = f"{counted(count, 'fix')} on straight lines that the exporter drew over outages; left out"
    return Finding(text, count, drop=bad) if count else None


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
    Check("gps_no_fix", "fixes", (), no_fix),
    Check("gps_invalid", "fixes", (), unreadable),
    Check("gps_absurd", "fixes", (), not_on_earth),
    Check("gps_null_island", "fixes", (), null_island),
    Check("gps_too_fast", "fixes", (), too_fast),
)
PATH_CHECKS = (
    *VELOCITY_CHECKS,
    Check("gps_jump", "fixes", (), jumps),
    Check("gps_repeated", "fixes", (), stale),
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
