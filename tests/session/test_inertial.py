"""Inertial samples that are left out: what no sensor reads, and what stands for no reading at all."""

import numpy as np
import pytest

from smoother.session.inertial import screen_imu


@pytest.mark.parametrize(("silent", "are_dropped"), [(0, False), (7, True), (180, True), (600, False)])
def test_samples_of_nothing_but_zeros_are_left_out_where_they_are_few(silent: int, are_dropped: bool) -> None:
    """A sensor that does not answer on its bus is read as zeros; a file of zeros has a cause of its own."""
    rng = np.random.default_rng(4)
    t = np.arange(1000) / 200.0
    accel, gyro = rng.normal([0.0, 0.0, 9.8], 1.0, (1000, 3)), rng.standard_normal((1000, 3))
    rows = rng.choice(1000, silent, replace=False)
    accel[rows], gyro[rows] = 0.0, 0.0
    imu, problems = screen_imu("imu.csv", t, accel, gyro)
    said = {problem.code: problem.count for problem in problems}
    assert said == ({"imu_silent": silent} if are_dropped else {})
    np.testing.assert_array_equal(imu.t, np.delete(t, rows) if are_dropped else t)


def test_one_axis_that_reads_zero_is_a_reading() -> None:
    t = np.arange(1000) / 200.0
    accel, gyro = np.tile([0.0, 0.0, 9.8], (1000, 1)), np.zeros((1000, 3))
    imu, problems = screen_imu("imu.csv", t, accel, gyro)
    assert imu.t.size == 1000 and not problems
