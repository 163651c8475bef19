"""What of an angle comes back with the place."""

import numpy as np
import pytest

from smoother.estimate.output.ground import Visits
from smoother.units import DEG

INTERVAL, LAP = 0.2, 40.0  # s


def laps(count: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and velocity on a circle of 100 m, driven `count` times."""
    t = INTERVAL * np.arange(round(count * LAP / INTERVAL))
    phase = 2.0 * np.pi * t / LAP
    position_n = 100.0 * np.stack([np.cos(phase), np.sin(phase), 0.0 * t], axis=1)
    velocity_n = 200.0 * np.pi / LAP * np.stack([-np.sin(phase), np.cos(phase), 0.0 * t], axis=1)
    return t, position_n, velocity_n


@pytest.mark.parametrize("noise", [0.0, 1.0 * DEG])
def test_the_variance_of_what_comes_back_is_found_under_noise_that_does_not(noise: float) -> None:
    t, position_n, velocity_n = laps(6.0)
    rng = np.random.default_rng(1)
    bank = np.sqrt(2.0) * DEG * np.sin(6.0 * np.pi * t / LAP)
    visits = Visits.of(t, position_n, velocity_n)
    found = visits.variance(bank + noise * rng.standard_normal(len(t)))
    assert visits.rows == len(t)
    assert visits.each == pytest.approx(6.0, rel=0.02)  # seven times where it begins and ends within a place
    assert np.sqrt(found) == pytest.approx(1.0 * DEG, rel=0.08)  # less where a bank changes within a place


def test_what_differs_from_lap_to_lap_is_not_the_ground() -> None:
    t, position_n, velocity_n = laps(8.0)
    drift = 1.0 * DEG * np.sin(2.0 * np.pi * t / 57.0)  # as long as a lap or two, as errors of biases are
    assert abs(Visits.of(t, position_n, velocity_n).variance(drift)) < 0.25 * np.var(drift)


def test_places_seen_once_tell_nothing() -> None:
    t, position_n, velocity_n = laps(0.9)
    visits = Visits.of(t, position_n, velocity_n)
    assert (visits.variance(np.ones(len(t))), visits.rows, visits.each) == (0.0, 0, 1.0)
    t, position_n, velocity_n = laps(1.5)
    # the half lap that was driven twice, and cut places at its ends
    assert Visits.of(t, position_n, velocity_n).rows == pytest.approx(len(t) / 1.5, abs=60)


def test_the_way_back_is_another_place() -> None:
    t, position_n, velocity_n = laps(2.0)
    back = np.where(t < LAP, 1.0, -1.0)[:, None]
    position_n = position_n * np.where(back < 0.0, [1.0, -1.0, 1.0], 1.0)
    velocity_n = velocity_n * np.where(back < 0.0, [1.0, -1.0, 1.0], 1.0)
    assert Visits.of(t, position_n, velocity_n).rows < 0.03 * len(t)  # where it turned round


def test_slow_driving_through_a_place_is_one_visit() -> None:
    t, position_n, velocity_n = laps(1.0)
    assert Visits.of(20.0 * t, position_n, velocity_n / 20.0).rows == 0
