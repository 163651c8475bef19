"""Inertial samples that are left out: what no sensor reads, and what stands for no reading at all."""

import numpy as np

from smoother.samples import GnssFixes, RawImu
from smoother.session.checks.imu import IMU_CHECKS

from .checked import checked, of_code

FIXES = GnssFixes(np.arange(2.0), *(np.array([45.0, 45.1]) for _ in range(3)), np.zeros((2, 3)))


def test_what_no_sensor_reads_is_left_out_whatever_the_counts_are_worth() -> None:
    t = np.arange(1000) / 200.0
    accel, gyro = np.tile([0.0, 0.0, 9.8], (1000, 1)), np.zeros((1000, 3))
    accel[50], gyro[60] = 9e9, -1000.0
    imu = RawImu(t, 100.0 * accel, 100.0 * gyro, 0.01, 0.01)
    recording, (problem,) = checked(of_code(IMU_CHECKS, "imu_absurd"), FIXES, imu)
    assert problem.count == 2 and problem.text.endswith("; dropped")
    np.testing.assert_array_equal(recording.samples.t, np.delete(t, [50, 60]))
