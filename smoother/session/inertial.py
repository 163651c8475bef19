"""Columns of inertial samples, from whatever file, to RawImu: choose the usable rows, count the rest."""

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces, release
from smoother.samples import SENSOR_AXES, Problem, RawImu
from smoother.session.rows import in_time_order, taken
from smoother.words import counted

FEWEST_IMU_SAMPLES = 100  # fewer tell nothing


def screen_imu(file: str, t: Array, accel: Array, gyro: Array) -> tuple[RawImu, list[Problem]]:
    """Return the usable samples in time order (maybe none) and what was wrong with the others.

    t (N,) s; accel (N, 3) m/s^2 and gyro (N, 3) rad/s, axes s, which the caller gives away.
    """
    unreadable = np.empty(t.size, dtype=np.bool_)
    for part in pieces(t.size):
        unreadable[part] = ~np.isfinite(t[part])
        for axis in range(SENSOR_AXES):
            unreadable[part] |= ~np.isfinite(accel[part, axis]) | ~np.isfinite(gyro[part, axis])
        release(t, accel, gyro)
    problems = []
    if count := int(np.count_nonzero(unreadable)):
        t, accel, gyro = t[~unreadable], accel[~unreadable], gyro[~unreadable]
        text = f"{file}: {counted(count, 'row')} with an empty or unreadable value; dropped"
        problems.append(Problem("imu_invalid", text, count))
    ordered = in_time_order(t, accel, gyro, file=file, prefix="imu")
    imu = RawImu(ordered.t, taken(accel, ordered.index), taken(gyro, ordered.index))
    return imu, [*problems, *ordered.problems]


def dead_axes(imu: RawImu) -> list[tuple[str, str]]:
    """Sensor and letter of each axis that reads one and the same value throughout, which noise keeps live ones from."""
    return [
        (sensor, "xyz"[axis])
        for sensor, values in (("accelerometer", imu.accel), ("gyroscope", imu.gyro))
        for axis in _constant(values)
    ]


def _constant(values: Array) -> list[int]:
    """Columns of (N, 3) samples that never change; of live ones no more than the first part is looked at."""
    same = list(range(values.shape[1])) if len(values) > 1 else []
    for part in pieces(len(values)):
        same = [axis for axis in same if np.all(values[part, axis] == values[0, axis])]
        release(values)
        if not same:
            break
    return same
