"""What is read of a wheel. Its Jacobians: test_jacobians.py; what it is worth: tests/estimate/test_wheel_speed.py."""

import numpy as np
import pytest

from smoother.estimate.factors.wheels import AVERAGED, EVERY, SLOWEST, readings_of
from smoother.samples import WheelSpeed


@pytest.mark.parametrize("rate", [100.0, 10.0, 4.0])
def test_a_reading_is_the_mean_of_samples_far_from_the_next_reading(rate: float) -> None:
    t = 5e4 + np.arange(int(20.0 * rate)) / rate
    readings = readings_of(WheelSpeed(t, 10.0 + 0.3 * (t - t[0])))
    np.testing.assert_allclose(readings.speed, 10.0 + 0.3 * (readings.t - t[0]), atol=1e-6)
    np.testing.assert_allclose(np.diff(readings.t), EVERY, atol=1e-6)
    averaged = max(1, round(AVERAGED * rate))
    assert readings.t[0] - t[0] == pytest.approx(0.5 * (averaged - 1) / rate, abs=1e-6)


def test_a_slow_or_locked_wheel_has_no_reading() -> None:
    t = np.arange(0.0, 20.0, 0.02)
    speed = np.full(len(t), 12.0)
    speed[(t > 5.99) & (t < 6.05)] = 0.0
    speed[(t > 9.99) & (t < 12.5)] = 0.9 * SLOWEST
    readings = readings_of(WheelSpeed(t, speed))
    assert np.all(readings.speed == 12.0)
    np.testing.assert_allclose(readings.t - readings.t[0], [0.0, 2.0, 4.0, 8.0, 14.0, 16.0, 18.0])
