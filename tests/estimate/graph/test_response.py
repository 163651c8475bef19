"""What the filter of a receiver leaves of the noise in its velocities."""

import numpy as np
import pytest

from smoother.estimate.graph.response import evened, passed_noise
from smoother.estimate.graph.state import Constants

EVERY = 0.2  # s from one velocity to the next
SURE = 0.0, 0.0  # sigmas of response and evenness


def receiver(response: float, evenness: float = 0.0, *, is_steered: bool = False) -> Constants:
    """Constants of a session with that response, s^2."""
    return Constants(0.0, 0.0, np.zeros(3), velocity_response=response, evenness=evenness, is_steered=is_steered)


@pytest.mark.parametrize("a", [0.3, 0.6])
def test_a_filter_of_velocities_leaves_what_its_formula_says(a: float) -> None:
    passed = passed_noise(receiver(0.5 * (1.0 - a) / a**2 * EVERY**2), SURE, EVERY)
    assert passed is not None
    np.testing.assert_allclose(passed.power, np.abs(a / (1.0 - (1.0 - a) * np.exp(-1j * passed.angle))) ** 2)
    assert np.mean(passed.power) == pytest.approx(a / (2.0 - a), rel=1e-6)  # sum of the squares of a (1 - a)^i


@pytest.mark.parametrize("n", [3, 5, 7])
def test_a_mean_leaves_what_means_of_as_many_leave(n: int) -> None:
    passed = passed_noise(receiver((n**2 - 1) / 24.0 * EVERY**2, evenness=1.0), SURE, EVERY)
    assert passed is not None
    assert passed.several == n
    weights = np.exp(1j * np.outer(passed.angle, np.arange(n))) / n
    np.testing.assert_allclose(passed.of_means(), np.abs(weights.sum(axis=1)) ** 2, atol=1e-12)
    np.testing.assert_allclose(passed.power, passed.of_means(), atol=1e-12)


@pytest.mark.parametrize("length", [0.11, 0.98])
def test_an_even_filter_is_a_mean_over_a_time(length: float) -> None:
    """With the response of a low-pass: a twelfth of its square is the square of the time constant."""
    dt, pace = 0.02, 3.0
    t = dt * np.arange(500)
    found = evened(np.column_stack([np.sin(pace * t), 2.0 * t]), dt, length / np.sqrt(12.0))
    mean = np.sin(0.5 * pace * length) / (0.5 * pace * length) * np.sin(pace * t)
    inside = slice(50, -50)
    np.testing.assert_allclose(found[inside], np.column_stack([mean, 2.0 * t])[inside], atol=1e-3)
    assert found.shape == (500, 2)
    assert np.all(np.abs(found[:, 0]) < 1.0)


def test_noise_is_white_but_where_a_filter_is_beyond_doubt() -> None:
    """Of a box on the wheel the response is not the receiver's alone."""
    of_three = 8.0 / 24.0 * EVERY**2
    assert passed_noise(receiver(of_three), SURE, EVERY) is not None
    assert passed_noise(receiver(of_three), (0.7 * of_three, 0.0), EVERY) is None
    assert passed_noise(receiver(0.9 * 3.0 / 24.0 * EVERY**2), SURE, EVERY) is None  # nearly a mean of two
    assert passed_noise(receiver(-of_three), SURE, EVERY) is None
    assert passed_noise(receiver(of_three, is_steered=True), SURE, EVERY) is None


@pytest.mark.parametrize(("evenness", "unsure", "is_one"), [(-0.6, 0.4, False), (-0.3, 0.4, True), (1.5, 0.4, False)])
def test_no_filter_has_a_shape_beyond_those_of_low_pass_and_mean(evenness: float, unsure: float, is_one: bool) -> None:
    assert (passed_noise(receiver(0.1, evenness), (0.0, unsure), EVERY) is not None) == is_one
