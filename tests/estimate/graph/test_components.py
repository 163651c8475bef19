"""Variance components by themselves: what residuals say of the noise that they come from."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.graph.components import (
    LOCAL,
    LOCAL_BOUNDS,
    USUAL_SPREAD,
    _of_means,
    _shape,
    _share,
    bounded_mean,
    local_ratio,
    scored,
)
from smoother.estimate.graph.inertial import VarianceComponent
from smoother.estimate.graph.inertial_noise import ROUND
from smoother.estimate.graph.response import passed_noise
from smoother.estimate.graph.row_components import RowComponent
from smoother.estimate.graph.rows import prior_row
from smoother.estimate.graph.state import Constants


def component_of(squares: np.ndarray, redundancy: np.ndarray) -> VarianceComponent:
    """Component of intervals (N,), the same in all directions."""
    return VarianceComponent(squares, redundancy, np.eye(3) * squares.sum() / 3.0, np.eye(3) * redundancy.sum() / 3.0)


@pytest.mark.parametrize("n", [1, 2])
@pytest.mark.parametrize("largest", [0.5, 1.0, 4.0])
def test_what_bounding_takes_from_noise_is_known(n: int, largest: float) -> None:
    squares = np.mean(np.random.default_rng(0).normal(size=(200_000, n)) ** 2, axis=1)
    assert bounded_mean(n, largest) == pytest.approx(np.mean(np.minimum(squares, largest)), rel=0.01)


def test_few_residuals_leave_the_noise_round() -> None:
    little = 1e-3 * np.diag([5.0, 1.0, 1.0])
    found = _shape(VarianceComponent(np.zeros(1), np.zeros(1), little, 1e-3 * np.eye(3)), ROUND)
    np.testing.assert_allclose(found, np.eye(3), atol=1e-3)


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_how_much_of_it_goes_with_vibration_is_found_from_where_the_residuals_are_large(share: float) -> None:
    rng = np.random.default_rng(0)
    rough = rng.gamma(0.7, size=2000)
    rough /= rough.mean()
    found = 0.0
    for _ in range(10):
        level = 1.0 + found * (rough - 1.0)
        variance = 2.0 * (1.0 + share * (rough - 1.0)) / level  # density unknown as well
        residual = rng.normal(size=(3, len(rough))) * np.sqrt(variance)
        component = component_of(np.sum(residual**2, axis=0), np.full(len(rough), 3.0))
        found = _share(component, rough, found)
    assert found == pytest.approx(share, abs=0.05)  # of 6000 residuals


def test_few_residuals_do_not_make_the_noise_follow_the_vibration() -> None:
    rough = np.array([0.2, 0.5, 1.0, 2.3])
    nothing = component_of(3e-3 * rough, np.full(4, 1e-3))  # of fixes that can not judge the samples
    assert _share(nothing, rough, 0.0) < 0.01


def test_noise_that_is_the_same_everywhere_is_found_to_be() -> None:
    squares = np.sum(np.random.default_rng(0).normal(size=(3000, 6)) ** 2, axis=1)
    found = local_ratio(squares, np.full(3000, 6.0), 0.2)
    assert np.mean(found) == pytest.approx(1.0, abs=0.03)
    assert np.std(found) < 0.2  # of sixty residuals 0.18


def test_force_that_is_noisier_for_some_seconds_is_found_to_be_there() -> None:
    t = 0.2 * np.arange(3000)
    true = np.where(t % 60.0 < 15.0, 3.0, 0.5)
    squares = true * np.sum(np.random.default_rng(0).normal(size=(3000, 6)) ** 2, axis=1)
    found = local_ratio(squares, np.full(3000, 6.0), 0.2)
    inside = np.abs((t % 60.0) - 7.5) < 7.5 - LOCAL
    outside = (t % 60.0 > 15.0 + LOCAL) & (t % 60.0 < 60.0 - LOCAL)
    assert np.mean(found[inside]) == pytest.approx(3.0, rel=0.12)  # of a tenth the residuals that say one
    assert np.mean(found[outside]) == pytest.approx(0.5, rel=0.2)


def test_residuals_that_tell_little_leave_the_noise_as_it_is() -> None:
    squares = np.random.default_rng(0).gamma(1.0, 0.02, size=500)
    assert local_ratio(squares, np.full(500, 0.02), 0.2) == pytest.approx(1.0, abs=0.1)
    assert len(local_ratio(squares[:3], np.full(3, 0.02), 0.2)) == 3  # fewer than are looked at together


def test_wild_residuals_have_bounds() -> None:
    assert np.max(local_ratio(np.full(50, 1e6), np.full(50, 6.0), 0.2)) == LOCAL_BOUNDS[1]


class Walk:
    """Velocities of sigma r that measure a random walk of steps q, and another such walk that nothing measures.

    Residuals of both after the smoother of a filter that was given r and q as they are not: by its spectrum.
    weights: of the last velocities, the newest first, in each that is shown; that it is late and round is known.
    """

    def __init__(self, r: float, q: float, n: int = 20_000, seed: int = 0, weights: Sequence[float] = (1.0,)) -> None:
        rng = np.random.default_rng(seed)
        steps, white = q * rng.normal(size=n), r * rng.normal(size=n)
        noise = np.sum([w * np.roll(white, i) for i, w in enumerate(weights)], axis=0)
        change = steps + noise - np.roll(noise, 1)  # of what is measured, on a circle
        self._power, self._theta, self._n = np.abs(np.fft.fft(change)) ** 2 / n, 2.0 * np.pi * np.arange(n) / n, n
        self._aside = float(np.mean((q * rng.normal(size=n)) ** 2))

    def ratios(self, r: float, q: float, several: int = 1) -> np.ndarray:
        """Ratio of the sigmas that the residuals show to r and q, with which they were found; of means of several."""
        of_noise = 4.0 * r**2 * np.sin(0.5 * self._theta) ** 2
        whole = of_noise + q**2
        share = of_noise / whole
        means = np.abs(np.fft.fft(np.ones(several) / several, self._n)) ** 2
        squares = np.mean(share * means * self._power / whole), np.mean((1.0 - share) * self._power / whole)
        expected = np.mean(share), np.mean(1.0 - share)
        force = (2.0 * squares[1] + self._aside / q**2) / (2.0 * expected[1] + 1.0)
        return np.sqrt([squares[0] / expected[0], force])


@pytest.mark.parametrize("r", [0.05, 0.2, 1.0])
@pytest.mark.parametrize("wrong", [(3.0, 1.0), (1.0 / 3.0, 1.0), (2.0, 0.7)])
def test_noise_of_velocity_and_force_is_found_in_a_few_turns(r: float, wrong: tuple[float, float]) -> None:
    """From three times too much or too little; ratio by ratio, a sigma a fifth of the steps takes more than thirty."""
    walk, q = Walk(r, 0.22), 0.22
    found = np.array([wrong[0] * r, wrong[1] * q])
    for _ in range(8):
        share = float((found[0] / found[1]) ** 2)
        found *= scored(walk.ratios(*found), share, 20_000.0, r / found[0])
    # 20,000 velocities of a quarter of the steps tell their sigma to 5 %
    assert found[0] == pytest.approx(r, rel=0.1 if r < 0.1 else 0.04)
    assert found[1] == pytest.approx(q, rel=0.03)


@pytest.mark.parametrize("wrong", [(3.0, 1.0), (1.0 / 3.0, 1.5), (0.5, 0.7)])
@pytest.mark.parametrize(
    ("weights", "evenness"), [([1.0 / 3.0] * 3, 0.5), ([0.2] * 5, 1.0), ([0.4 * 0.6**i for i in range(40)], 0.0)]
)
def test_noise_that_a_receiver_filtered_is_as_much_as_it_is_worth(
    weights: list[float], evenness: float, wrong: tuple[float, float]
) -> None:
    """Taken for white it would be a fifth of it behind a mean of five, and the steps half as large again."""
    r, q, every, lasts = 0.15, 0.063, 0.2, np.arange(len(weights))
    response = 0.5 * every**2 * float(np.array(weights) @ (lasts - np.array(weights) @ lasts) ** 2)
    session = Constants(0.0, 0.0, np.zeros(3), velocity_response=response, evenness=evenness)
    passed = passed_noise(session, (0.0, 0.0), every)
    assert passed is not None
    walk, found = Walk(r, q, weights=weights), np.array([wrong[0] * r, wrong[1] * q])
    for _ in range(20):
        share, ratios = float((found[0] / found[1]) ** 2), walk.ratios(*found, passed.several)
        found *= scored(ratios, share, 20_000.0, r / found[0], passed)
    assert found[0] == pytest.approx(r, rel=0.15)  # filters of one response differ by so much in means
    assert found[1] == pytest.approx(q, rel=0.1)


def test_means_of_residuals_keep_their_sign() -> None:
    rng = np.random.default_rng(0)
    residual = rng.normal(size=(1000, 3))
    rows = replace(prior_row("gps_velocity", residual[0], np.full(3, 0.5), slice(0, 3)), residual=residual)
    component = RowComponent(residual**2 / 0.25, np.ones((1000, 3)))
    found = _of_means(component, rows, 3)
    mean = (residual[:-2] + residual[1:-1] + residual[2:]) / 3.0
    np.testing.assert_allclose(found.squares[1:-1, :2], mean[:, :2] ** 2 / 0.25)
    np.testing.assert_array_equal(found.squares[:, 2], component.squares[:, 2])  # upwards nothing is taken for filtered
    np.testing.assert_array_equal(found.expected, component.expected)


def test_few_velocities_are_as_noisy_as_those_of_receivers_are() -> None:
    """Sixty of them, five seconds apart: the samples' noise hides theirs, whatever the residuals seem to say."""
    sigma = 0.6
    for _ in range(10):
        of_velocity, _ = scored(np.array([1.5, 1.0]), 0.005 * sigma**2, 60.0, 0.15 / sigma)
        sigma *= of_velocity
    assert sigma == pytest.approx(0.15, rel=0.05)


def test_many_velocities_speak_for_themselves() -> None:
    """A thousand that are as sure as the samples: their information on the logarithm of the variance is 332.

    By hand, share 1: 500 (0.748 - 0.358^2 / 1.537), the force unknown. What is usual moves that by its part of both.
    """
    of_velocity, _ = scored(np.array([1.0, 1.0]), 1.0, 1000.0, 3.0)
    assert np.log(of_velocity) == pytest.approx(np.log(3.0) / (332.0 * USUAL_SPREAD**2 + 1.0), rel=0.01)


def test_velocities_do_not_count_on_a_force_that_stays() -> None:
    ratio = np.array([1.03, 1.0])
    alone, force = scored(ratio, 0.2, 1000.0, 1.0, together=False)
    assert force == 1.0
    assert 1.03 < alone < scored(ratio, 0.2, 1000.0, 1.0)[0]
