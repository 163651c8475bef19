"""Columns of inertial samples, from whatever file, to RawImu: choose the usable rows, count the rest."""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release
from smoother.samples import Problem, RawImu
from smoother.session.rows import RowFilter, put_in_time_order, spread_coarse_times, taken

ABSURD_SPECIFIC_FORCE = 1000.0  # m/s^2; beyond 100 g, no sensor of a kart reads it
HOLE = 1.0  # s without samples
FEWEST_IMU_SAMPLES = 100  # fewer tell nothing
ABSURD_RATE = 100.0  # rad/s, 5700 deg/s; likewise
FEW_SILENT = 0.2  # share of samples that may be nothing but zeros, for a sensor that at times does not answer


def screen_imu(file: str, t: Array, accel: Array, gyro: Array) -> tuple[RawImu, list[Problem]]:
    """Return the usable samples in time order (maybe none) and what was wrong with the others.

    t (N,) s; accel (N, 3) m/s^2 and gyro (N, 3) rad/s, axes s, which the caller gives away.
    """
    rows = RowFilter(file, "imu", np.ones(t.size, dtype=np.bool_))
    too_large, unreadable, silent = (np.empty(t.size, dtype=np.bool_) for _ in range(3))
    for part in pieces(t.size):
        a, w = accel[part], gyro[part]
        with np.errstate(invalid="ignore"):
            too_large[part] = _any_of_row(np.abs(a) > ABSURD_SPECIFIC_FORCE) | _any_of_row(np.abs(w) > ABSURD_RATE)
        unreadable[part] = _any_of_row(~np.isfinite(a)) | _any_of_row(~np.isfinite(w)) | ~np.isfinite(t[part])
        silent[part] = ~(_any_of_row(a != 0.0) | _any_of_row(w != 0.0))
        release(t, accel, gyro)
    if np.count_nonzero(silent) <= FEW_SILENT * t.size:
        rows.drop(silent, "silent", "in which all six values are zero: the sensor did not answer")
    rows.drop(unreadable, "invalid", "with an empty or unreadable value")
    rows.drop(too_large, "absurd", "with accelerations or rates no sensor can read")
    t = spread_coarse_times(rows, t, accel, gyro)
    time, index = put_in_time_order(rows, t, accel, gyro)
    return RawImu(time, taken(accel, index), taken(gyro, index), stamp_sigma=rows.stamp_sigma), rows.problems


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


def longest_constant(t: Array, values: Array, axis: int) -> tuple[int, int]:
    """First and last row of the longest stretch of (N, 3) samples, N > 0, in which one axis does not change.

    A stretch ends at a hole in their times t (N,) s: a box at rest before a pause and after it did not stand still.
    """
    begin, longest = 0, (0, 0)
    for part in pieces(len(values) - 1):
        before, now = values[part.start : part.stop, axis], values[part.start + 1 : part.stop + 1, axis]
        ends = (now != before) | (np.diff(t[part.start : part.stop + 1]) > HOLE)
        edges = np.append(begin, np.flatnonzero(ends) + part.start + 1)
        release(values)
        begin = int(edges[-1])
        if edges.size > 1:
            k = int(np.argmax(np.diff(edges)))
            longest = max(longest, (int(edges[k]), int(edges[k + 1]) - 1), key=lambda run: run[1] - run[0])
    return max(longest, (begin, len(values) - 1), key=lambda run: run[1] - run[0])


def _any_of_row(bad: BoolArray) -> BoolArray:
    """Whether any of the three is; ten times faster than numpy's any along such a short axis."""
    return np.asarray(bad[:, 0] | bad[:, 1] | bad[:, 2])
