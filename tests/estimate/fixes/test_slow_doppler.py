"""The slow error of Doppler velocities, and the way that it adds up to."""

import math

import numpy as np
import pytest
from scipy.integrate import dblquad

from smoother.estimate.fixes.slow_errors import DOPPLER, SlowVelocity


@pytest.mark.parametrize("h", [1e-3, 0.1, 2.0, 40.0, 500.0])
def test_what_comes_anew_is_the_integral_of_its_noise(h: float) -> None:
    """Of noise at u, exp(-(h - u) / tau) is left of the velocity, and tau (1 - exp(..)) of the way has come of it."""
    s, tau = DOPPLER.sigma, DOPPLER.tau
    u = np.linspace(0.0, h, 20001)
    density, velocity = 2.0 * s**2 / tau, np.exp(-(h - u) / tau)
    way = tau * -np.expm1(-(h - u) / tau)
    wanted = [float(np.trapezoid(density * p, u)) for p in (way * way, way * velocity, velocity * velocity)]
    assert DOPPLER.noise(h) == pytest.approx(wanted, rel=1e-6)


def test_a_long_way_of_a_stationary_velocity_is_the_integral_of_its_correlation() -> None:
    h = 70.0
    wanted, _ = dblquad(lambda a, b: DOPPLER.sigma**2 * math.exp(-abs(a - b) / DOPPLER.tau), 0.0, h, 0.0, h)
    anew, _, _ = DOPPLER.noise(h)
    assert anew + DOPPLER.sigma**2 * DOPPLER.gone(h) ** 2 == pytest.approx(wanted, rel=1e-4)


def test_a_bias_stays_and_adds_up_to_a_straight_line() -> None:
    bias = SlowVelocity(0.05)
    assert (bias.kept(30.0), bias.gone(30.0), bias.noise(30.0)) == (1.0, 30.0, (0.0, 0.0, 0.0))


def test_a_velocity_has_the_same_sigma_after_a_step_as_before() -> None:
    _, _, new = DOPPLER.noise(13.0)
    assert new + DOPPLER.kept(13.0) ** 2 * DOPPLER.sigma**2 == pytest.approx(DOPPLER.sigma**2)
