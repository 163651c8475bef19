"""Columns of inertial samples, from whatever file, to RawImu: choose the usable rows, count the rest."""

import numpy as np

from smoother.arrays import Array
from smoother.samples import Problem, RawImu
from smoother.session.rows import RowFilter, put_in_time_order, spread_coarse_times, taken

ABSURD_SPECIFIC_FORCE = 1000.0  # m/s^2; beyond 100 g, no sensor of a kart reads it
ABSURD_RATE = 100.0  # rad/s, 5700 deg/s; likewise


def screen_imu(file: str, t: Array, accel: Array, gyro: Array) -> tuple[RawImu, list[Problem]]:
    """Return the usable samples in time order (maybe none) and what was wrong with the others.

    t (N,) s; accel (N, 3) m/s^2 and gyro (N, 3) rad/s, axes s, which the caller gives away.
    """
    rows = RowFilter(file, "imu", np.ones(t.size, dtype=np.bool_))
    unreadable = ~(np.isfinite(t) & np.all(np.isfinite(accel), axis=1) & np.all(np.isfinite(gyro), axis=1))
    rows.drop(unreadable, "invalid", "with an empty or unreadable value")
    with np.errstate(invalid="ignore"):
        too_large = np.any(np.abs(accel) > ABSURD_SPECIFIC_FORCE, axis=1) | np.any(np.abs(gyro) > ABSURD_RATE, axis=1)
    rows.drop(too_large, "absurd", "with accelerations or rates no sensor can read")
    t = spread_coarse_times(rows, t, accel, gyro)
    time, index = put_in_time_order(rows, t)
    return RawImu(time, taken(accel, index), taken(gyro, index)), rows.problems
