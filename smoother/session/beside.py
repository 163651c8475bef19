"""Tables beside imu.csv and gps.csv: mag.csv and wheel_speed.csv to their types, with what was unusable counted."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Channel, Problem, RawMag, WheelSpeed
from smoother.session.checks.table import Check, Finding, OneStream, dropped, run
from smoother.session.csv_form import require_clock
from smoother.session.fix_columns import ABSURD_SPEED
from smoother.session.readers.channels import channel_of, distinct
from smoother.session.rows import in_time_order
from smoother.session.tables import read_header, read_table
from smoother.session.time_unit import UNITS, in_seconds, lasts_like, unit_by_rate

FIELD_COLUMNS = ("mx", "my", "mz")
ABSURD_FIELD = 1e9  # in any unit; no sensor counts as far, and sums of squares of more overflow


@dataclass(frozen=True, eq=False)
class SessionClock:
    """What is known of the clock that all tables of a session share.

    fixes_t (M,) s : times of the fixes, which show whether a sensor is slow or its times are in another unit. Where it
    has_imu, times are in the unit of that, imu_unit, or in seconds; a table alone may be of any rate.
    """

    fixes_t: Array | None = None
    has_imu: bool = False
    imu_unit: str | None = None


ANY_CLOCK = SessionClock()


def read_mag(path: Path, clock: SessionClock = ANY_CLOCK) -> tuple[RawMag, list[Problem]]:
    """Read mag.csv: t_s, mx my mz in any unit, axes s. Rows may all be dropped: length 0.

    Raises SessionError if its clock has parts that are none of the session's.
    """
    rows, said = _read(path, FIELD_COLUMNS, "mag", clock, MAG_CHECKS)
    return RawMag(rows.t, rows.values), said


def read_wheel_speed(path: Path, clock: SessionClock = ANY_CLOCK) -> tuple[WheelSpeed, list[Problem]]:
    """Read wheel_speed.csv: t_s, speed_mps. Rows may all be dropped: length 0.

    A negative speed counts as a broken value. Raises SessionError as :func:`read_mag`.
    """
    rows, said = _read(path, ("speed_mps",), "wheel_speed", clock, WHEEL_CHECKS)
    return WheelSpeed(rows.t, rows.values[:, 0]), said


def read_channels(path: Path, clock: SessionClock = ANY_CLOCK) -> tuple[tuple[Channel, ...], list[Problem]]:
    """Read channels.csv: t_s and any columns of numbers, called with their unit, as water_temp_c.

    A cell may be empty where a channel has no new value. Raises SessionError as :func:`read_mag`.
    """
    names = [name for name in read_header(path) if name != "t_s" and name[:1].isalpha()]
    rows, said = _read(path, names, "channels", clock, CHANNEL_CHECKS)
    found = [channel_of(name, "", rows.t, rows.values[:, i]) for i, name in enumerate(names)]
    return distinct(channel for channel in found if channel is not None), said


def _read(
    path: Path, names: Sequence[str], prefix: str, clock: SessionClock, checks: Sequence[Check[OneStream]]
) -> tuple["_Rows", list[Problem]]:
    """Rows of a table that pass its checks, in order of time on the session's clock, and what is to be said of it."""
    table = read_table(path, ("t_s", *names), prefix=prefix)
    values, t = table.stack(*names), table.column("t_s")
    require_clock(path, t)
    unit = _unless_seconds(t, clock.imu_unit if clock.has_imu else unit_by_rate(t), clock.fixes_t)
    t, said = in_seconds(t, unit, prefix, path.name)
    checked, of_rows = run(checks, OneStream(prefix, path.name, _Rows(t, values)))
    rows = checked.rows
    ordered = in_time_order(rows.t, rows.values, file=path.name, prefix=prefix)
    if any(problem.code.endswith("_clock_restart") for problem in ordered.problems):
        raise SessionError(
            f"{path.name}: its clock started again, and its rows cannot be assigned to samples; split it there"
        )
    problems = [*table.problems, *said, *of_rows, *ordered.problems]
    return _Rows(ordered.t, rows.values[ordered.index]), problems


@dataclass(frozen=True, eq=False)
class _Rows:
    """Rows of a table: t (N,) s, values (N, M)."""

    t: Array
    values: Array


def _unreadable(s: OneStream) -> Finding | None:
    return dropped(
        ~(np.isfinite(s.rows.t) & np.isfinite(s.rows.values).all(axis=1)), "with an empty or unreadable value"
    )


def _untimed(s: OneStream) -> Finding | None:
    return dropped(~np.isfinite(s.rows.t), "without a time")


def _of_zero(s: OneStream) -> Finding | None:
    return dropped(np.all(s.rows.values == 0.0, axis=1), "of exactly zero on all axes")


def _absurd(low: float, high: float, reason: str, s: OneStream) -> Finding | None:
    return dropped(np.any((s.rows.values < low) | (s.rows.values > high), axis=1), reason)


MAG_CHECKS = (
    Check("mag_invalid", "mag", (), _unreadable),
    Check("mag_zero", "mag", (), _of_zero),
    Check("mag_absurd", "mag", (), partial(_absurd, -ABSURD_FIELD, ABSURD_FIELD, "with a field no sensor can read")),
)
CHANNEL_CHECKS = (Check("channels_invalid", "channels", (), _untimed),)
WHEEL_CHECKS = (
    Check("wheel_speed_invalid", "wheel_speed", (), _unreadable),
    Check("wheel_speed_absurd", "wheel_speed", (), partial(_absurd, 0.0, ABSURD_SPEED, "with a speed no wheel has")),
)


def _unless_seconds(t: Array, unit: str | None, fixes_t: Array | None) -> str | None:
    """The unit of the times t (N,) of a table, None where they last as long as the fixes (M,) s in seconds."""
    if unit is None or fixes_t is None or lasts_like(t[np.isfinite(t)] / UNITS[unit], fixes_t, unit):
        return unit
    return None
