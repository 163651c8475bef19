"""The CSV form of a session: imu.csv and gps.csv to their types, with what was unusable counted."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.checks.imu import screen_imu
from smoother.session.degrees import require_degrees
from smoother.session.fix_columns import fix_columns
from smoother.session.fixes import screen_fixes
from smoother.session.readers.cells import NOTHING
from smoother.session.tables import Table, cells_of, head_lines, read_table
from smoother.session.time_unit import in_seconds, unit_by_rate, unit_of_fixes
from smoother.words import counted, listed

ACCEL_COLUMNS = ("ax", "ay", "az")
GYRO_COLUMNS = ("gx", "gy", "gz")
EARLIEST_UTC, LATEST_UTC = 315532800.0, 4102444800.0  # s since 1970: 1980, when GPS time began, and 2100
FIX_COLUMNS = ("t_s", "lat_deg", "lon_deg")
UTC_COLUMNS = ("unix_s", "utc_ms")  # beside utc, which is text
COLUMN_OF = {  # columns of fixes and how the contract calls them
    **{"alt_m": "alt_m", "speed": "speed_mps", "course_deg": "course_deg", "sigma_up": "vacc_m"},
    **{"velocity_north": "vel_n_mps", "velocity_east": "vel_e_mps", "velocity_up": "vel_u_mps"},
    **{"hdop": "hdop", "num_sv": "num_sv", "fix": "fix"},
}
OF_AXES = ("hacc_m", "hacc_n_m", "hacc_e_m", "sacc_mps", "sacc_n_mps", "sacc_e_mps")


def read_imu(path: Path) -> tuple[RawImu, list[Problem]]:
    """Read imu.csv: t_s, ax ay az (m/s^2), gx gy gz (rad/s), axes s. Rows may all be dropped: length 0."""
    imu, problems, _ = read_imu_and_unit(path)
    return imu, problems


def read_imu_and_unit(path: Path, *, is_slow: bool = False) -> tuple[RawImu, list[Problem], str | None]:
    """The same, and the unit that its times are in where it is not seconds; if `is_slow`, they are."""
    table = read_table(path, ("t_s", *ACCEL_COLUMNS, *GYRO_COLUMNS), prefix="imu")
    accel, gyro, t = table.stack(*ACCEL_COLUMNS), table.stack(*GYRO_COLUMNS), table.column("t_s")
    problems = list(table.problems)
    _require_numbers(path, "t_s", t)
    require_clock(path, t)
    del table  # its columns have been copied; a long recording fills the memory once, not twice
    unit = None if is_slow else unit_by_rate(t)
    t, said = in_seconds(t, unit, "imu", path.name)
    imu, of_rows = screen_imu(path.name, t, accel, gyro)
    return imu, [*problems, *said, *of_rows], unit


def read_fixes(path: Path, imu_unit: str | None = None) -> tuple[GnssFixes, list[Problem]]:
    """Read gps.csv, columns as in the contract; maybe without a single usable fix.

    imu_unit : unit of the times in imu.csv, which gps.csv shares, where it is not seconds.
    """
    table = read_table(path, FIX_COLUMNS, (*COLUMN_OF.values(), *OF_AXES, *UTC_COLUMNS), iso_times=("utc",))
    t, (unix_s, said_of_utc) = table.column("t_s"), _unix_seconds(table)
    for name in FIX_COLUMNS:
        _require_numbers(path, name, table.column(name))
    require_clock(path, t)
    t, said = in_seconds(t, unit_of_fixes(t, unix_s, imu_unit), "gps", path.name)
    columns = fix_columns(
        t,
        table.column("lat_deg"),
        table.column("lon_deg"),
        **{quantity: table.column(name) for quantity, name in COLUMN_OF.items()},
        sigma_horizontal=_per_axis(table, "hacc_m", ("hacc_n_m", "hacc_e_m")),
        sigma_velocity=_per_axis(table, "sacc_mps", ("sacc_n_mps", "sacc_e_mps")),
        unix_s=unix_s,
    )
    require_degrees(path.name, columns)
    fixes, problems = screen_fixes(columns, path.name)
    of_columns = [*said, *said_of_utc]
    return fixes, [*table.problems, *of_columns, *problems, *_unread_cells(table)]


def _require_numbers(path: Path, column: str, values: Array) -> None:
    """Raise SessionError with the first cell of a column (N,) in which none is a number: a time of day, or 52.1N."""
    if np.isfinite(values[:1]).any() or np.isfinite(values).any():
        return
    names, *rows = (cells_of(line) for line in head_lines(path, 2))
    place = [name.lower() for name in names].index(column)
    cell = rows[0][place] if rows and len(rows[0]) > place else ""
    if cell and not NOTHING.match(cell):
        unit = "seconds" if column == "t_s" else "degrees"
        raise SessionError(
            f"{path.name}: {column} is {listed([cell], longest=40)}; it has to be in {unit}, as a number"
        )


def require_clock(path: Path, t: Array) -> None:
    """Raise SessionError where all rows have one and the same time, t (N,) as written: of the start, or of no clock."""
    if t.size and abs(t[-1] - t[0]) > 0.0:  # a long recording is not copied to see it
        return
    known = t[np.isfinite(t)]
    if known.size > 1 and not np.any(known != known[0]):
        raise SessionError(
            f"{path.name}: t_s is {known[0]:.10g} in all {known.size} rows; write when each was taken, in seconds"
        )


def _unread_cells(table: Table) -> Iterator[Problem]:
    """What to say of columns that were written in a way that is not understood: a unit in each cell, or words."""
    for name, count in table.unread.items():
        is_time = name == "utc"
        what = "ISO 8601 time since 1990 (2026-05-16T10:00:00.2Z)" if is_time else "number"
        text = f"{table.file}: {name} of {counted(count, 'row')} is no {what}; not used"
        if count:
            yield Problem("gps_utc_unread" if is_time else "gps_unread", text, count)


def _per_axis(table: Table, name: str, parts: tuple[str, str]) -> Array:
    """Sigma per axis: the column `name`, else the root mean square of its two parts."""
    one = table.column(name)
    mean = np.sqrt(np.mean(np.square(table.stack(*parts)), axis=1))
    return np.where(np.isfinite(one), one, mean)


def _unix_seconds(table: Table) -> tuple[Array, list[Problem]]:
    """The receiver's UTC in seconds since 1970, from whichever column has it, and what was wrong with it."""
    time = table.column("unix_s")
    for other in (table.column("utc"), table.column("utc_ms") / 1000.0):
        time = np.where(np.isfinite(time), time, other)
    problems = []
    with np.errstate(invalid="ignore"):
        absurd = (time < EARLIEST_UTC) | (time > LATEST_UTC)
    if count := int(np.count_nonzero(absurd)):
        text = f"{table.file}: UTC of {counted(count, 'row')} is before 1980 or after 2100; not used"
        problems.append(Problem("gps_utc_absurd", text, count))
    return np.where(absurd, np.nan, time), problems
