"""Tables beside imu.csv and gps.csv: mag.csv and wheel_speed.csv to their types, with what was unusable counted."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Channel, Problem, RawMag, WheelSpeed
from smoother.session.csv_form import problems_of_table, require_clock
from smoother.session.readers.channels import channel_of, distinct
from smoother.session.restarts import Restarts, over_restarts
from smoother.session.rows import RowFilter, put_in_time_order
from smoother.session.set_back import joined_where_set_back
from smoother.session.tables import read_header, read_table
from smoother.session.text_order import in_order_of_numbers
from smoother.session.time_unit import UNITS, in_seconds, lasts_like, unit_by_rate

FIELD_COLUMNS = ("mx", "my", "mz")
ABSURD_FIELD = 1e9  # in any unit; no sensor counts as far, and sums of squares of more overflow
ABSURD_SPEED = 150.0  # m/s; nothing with wheels that is logged here is as fast


@dataclass(frozen=True, eq=False)
class SessionClock:
    """What is known of the clock that all tables of a session share.

    fixes_t (M,) s : times of the fixes, which show whether a sensor is slow or its times are in another unit. Where it
    has_imu, times are in the unit of that, imu_unit, or in seconds; a table alone may be of any rate. restarts : of the
    clock.
    is_set_back : the clock was set back.
    """

    fixes_t: Array | None = None
    has_imu: bool = False
    imu_unit: str | None = None
    restarts: Restarts | None = None
    is_set_back: bool = False


ANY_CLOCK = SessionClock()


def read_mag(path: Path, clock: SessionClock = ANY_CLOCK) -> tuple[RawMag, list[Problem]]:
    """Read mag.csv: t_s, mx my mz in any unit, axes s. Rows may all be dropped: length 0.

    Raises SessionError if its clock has parts that are none of the session's.
    """
    t, field, said = _read(path, FIELD_COLUMNS, "mag", clock)
    rows = RowFilter(path.name, "mag", np.ones(t.size, dtype=np.bool_))
    rows.drop(~(np.isfinite(t) & np.all(np.isfinite(field), axis=1)), "invalid", "with an empty or unreadable value")
    rows.drop(np.all(field == 0.0, axis=1), "zero", "of exactly zero on all axes")
    with np.errstate(invalid="ignore"):
        rows.drop(np.any(np.abs(field) > ABSURD_FIELD, axis=1), "absurd", "with a field no sensor can read")
    time, index = put_in_time_order(rows, t, field)
    return RawMag(time, field[index]), [*said, *rows.problems]


def read_wheel_speed(path: Path, clock: SessionClock = ANY_CLOCK) -> tuple[WheelSpeed, list[Problem]]:
    """Read wheel_speed.csv: t_s, speed_mps. Rows may all be dropped: length 0.

    A wheel that turns backwards is not told from a broken value. Raises SessionError as :func:`read_mag`.
    """
    t, columns, said = _read(path, ("speed_mps",), "wheel_speed", clock)
    speed = columns[:, 0]
    rows = RowFilter(path.name, "wheel_speed", np.ones(t.size, dtype=np.bool_))
    rows.drop(~(np.isfinite(t) & np.isfinite(speed)), "invalid", "with an empty or unreadable value")
    with np.errstate(invalid="ignore"):
        rows.drop((speed < 0.0) | (speed > ABSURD_SPEED), "absurd", "with a speed no wheel has")
    time, index = put_in_time_order(rows, t, speed)
    return WheelSpeed(time, speed[index]), [*said, *rows.problems]


def read_channels(path: Path, clock: SessionClock = ANY_CLOCK) -> tuple[tuple[Channel, ...], list[Problem]]:
    """Read channels.csv: t_s and any columns of numbers, called with their unit, as water_temp_c.

    A cell may be empty where a channel has no new value. Raises SessionError as :func:`read_mag`.
    """
    names = [name for name in read_header(path) if name != "t_s" and name[:1].isalpha()]
    t, values, said = _read(path, names, "channels", clock)
    found = [channel_of(name, "", t, values[:, i]) for i, name in enumerate(names)]
    return distinct(channel for channel in found if channel is not None), said


def _read(path: Path, names: Sequence[str], prefix: str, clock: SessionClock) -> tuple[Array, Array, list[Problem]]:
    """Times (N,) s on the session's clock and columns (N, n) of a table as they stand, and what is to be said of it."""
    table = in_order_of_numbers(read_table(path, ("t_s", *names)))
    values, t = table.stack(*names), table.column("t_s")
    require_clock(path, t)
    unit = _unless_seconds(t, clock.imu_unit if clock.has_imu else unit_by_rate(t), clock.fixes_t)
    t, said = in_seconds(t, unit, prefix, path.name)
    if clock.restarts is not None and np.isfinite(t).any():
        shifts = clock.restarts.of_compass(t)
        if shifts is None:
            raise SessionError(f"{path.name}: its clock did not start again when that of the samples did")
        t, used = over_restarts(t, shifts)
        t, values = t[used], values[used]
    t, joined = joined_where_set_back(t, prefix, path.name) if clock.is_set_back else (t, [])
    return t, values, [*problems_of_table(table, prefix), *said, *joined]


def _unless_seconds(t: Array, unit: str | None, fixes_t: Array | None) -> str | None:
    """The unit of the times t (N,) of a table, None where they last as long as the fixes (M,) s in seconds."""
    if unit is None or fixes_t is None or lasts_like(t[np.isfinite(t)] / UNITS[unit], fixes_t, unit):
        return unit
    return None
