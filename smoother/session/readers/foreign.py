"""What recordings of other programs have in common: columns of fixes and samples to the types, sanity of rates."""

from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Channel, GnssFixes, Problem, RawImu
from smoother.session.fix_columns import fix_columns
from smoother.session.fixes import screen_fixes
from smoother.session.readers.names import SPEED_UNITS
from smoother.session.rows import LATEST
from smoother.words import counted

FASTEST_FIXES = 1000.0  # Hz; nothing writes more, and no receiver makes more than 100
SLOWEST_FIXES = 30.0  # s between fixes; a kart is somewhere else by then


@dataclass(frozen=True, eq=False)
class ForeignReading:
    """What a file of another program holds. `imu` only where it has all six inertial channels.

    unix_at_zero : UTC at t = 0 where the file has it, but not with each fix.
    """

    gnss: GnssFixes
    problems: list[Problem] = field(default_factory=list)
    imu: RawImu | None = None
    unix_at_zero: float | None = None
    channels: tuple[Channel, ...] = ()


def fixes_from(
    file: str,
    t: Array,
    lat_deg: Array,
    lon_deg: Array,
    *,
    has_rows_between: bool = False,
    **known: Array,
) -> tuple[GnssFixes, list[Problem]]:
    """Screen columns (N,) of fixes, `known` by their names in FixColumns. Raises SessionError if t is absurd.

    has_rows_between : rows that the exporter interpolated between fixes were left out.
    """
    columns = fix_columns(t, lat_deg, lon_deg, **known)
    gnss, problems = screen_fixes(columns, file, has_rows_between=has_rows_between)
    if any(problem.code == "gps_repeated_time" for problem in problems):
        _require_times_apart(file, np.column_stack([t, lat_deg, lon_deg]), len(gnss))
    _require_sane_times(file, t)
    return gnss, problems


def _require_times_apart(file: str, rows: Array, fixes: int) -> None:
    """Raise SessionError where most rows (N, 3) of time and place share their time with another place.

    Rows that were written twice, as blocks of a card may be, are one row.
    """
    rows = rows[np.isfinite(rows).all(axis=1)]
    times = np.unique(rows[:, 0]).size
    repeated = (len(rows) if times == 1 else len(np.unique(rows, axis=0))) - times
    if repeated > fixes:
        raise SessionError(f"{file}: {repeated} rows repeat the time of another; its times cannot be used")


def _require_sane_times(file: str, t: Array) -> None:
    steps = np.diff(t[np.isfinite(t)])
    steps = steps[steps > 0.0]
    if steps.size == 0:
        return
    step = float(np.median(steps))
    if step * FASTEST_FIXES < 1.0 - 1e-6:
        raise SessionError(f"{file}: {1.0 / step:.3g} fixes a second, which no receiver makes; its times are wrong")
    if step > SLOWEST_FIXES:
        raise SessionError(f"{file}: a fix every {step:.3g} s only; a kart's motion between them is not known")


def speed_unit_note(file: str, unit: str, otherwise: str) -> list[Problem]:
    """Report that the unit of speeds is not in a file, and which one is assumed."""
    if unit.strip().lower() in SPEED_UNITS:
        return []
    said = (
        f"the unit of its speeds, {unit}, is not known" if unit.strip() else "it does not say in which unit speeds are"
    )
    return [Problem("gps_speed_unit_assumed", f"{file}: {said}; taken as {otherwise}")]


def seconds_since_first(unix: Array) -> Array:
    """Times (N,) s from the first that is known, to the microsecond: UTC in seconds has no more as a float."""
    unix = np.where(np.abs(unix) < LATEST, unix, np.nan)
    known = unix[np.isfinite(unix)]
    return np.round(unix - known[0], 6) if known.size else unix


def date_note(file: str, reason: str) -> Problem:
    """Say that the date of a recording is not certain."""
    return Problem("gps_date_assumed", f"{file}: {reason}")


def unread_note(file: str, name: str, count: int) -> Problem | None:
    """Say that cells of a column hold something else than numbers, where any do."""
    text = f"{file}: {name} of {counted(count, 'row')} is no number; not used"
    return Problem("gps_unread", text, count) if count else None
