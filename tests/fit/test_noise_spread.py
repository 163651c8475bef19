"""How well a noise is known: against the scatter of what is found in data that was drawn again and again."""

import math
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.fit.noise_spread import (
    ANY_NOISE,
    OF_FIXES,
    OF_FORCE,
    OF_FORCE_ALONE,
    OF_RATE,
    Residuals,
    of_force,
    of_positions,
    of_rate,
    of_velocities,
    redundancy_as_walk,
    redundancy_as_white,
)


def white(n: int, seed: int = 0, left: float = 1.0) -> Residuals:
    """N residuals of which the share `left` is left."""
    rng = np.random.default_rng(seed)
    return Residuals(left * rng.standard_normal(n) ** 2, np.full(n, left), float(n))


def without(floor: float, spread: float) -> float:
    """What of a spread is not the model's."""
    return math.sqrt(spread**2 - floor**2)


def test_white_noise_is_known_as_well_as_estimates_of_it_scatter() -> None:
    n, drawn = 600, 400
    found = [0.5 * math.log(float(np.mean(white(n, seed).squares))) for seed in range(drawn)]
    said = [without(OF_FIXES, of_positions(white(n, seed))) for seed in range(drawn)]
    assert np.mean(said) == pytest.approx(np.std(found), rel=0.15)


def test_noise_that_comes_and_goes_is_known_less_well() -> None:
    """Of a session in two halves, of which one is four times as noisy, the mean says little of another session."""
    n = 2400
    even, uneven = white(n), white(n)
    uneven.squares[: n // 2] *= 16.0
    assert without(OF_RATE, of_rate(uneven)) > 4.0 * without(OF_RATE, of_rate(even))


@pytest.mark.parametrize("share", [0.1, 0.4, 0.9])
def test_what_a_change_shows_is_the_mean_square_over_the_mean_of_what_is_left(share: float) -> None:
    """Over the frequencies of a random walk that is measured with white noise."""
    theta = (np.arange(200_000) + 0.5) * math.pi / 200_000
    walk = 1.0 - share  # w = 1 / sqrt(1 + 4 a)
    a = 0.25 * (1.0 / walk**2 - 1.0)
    of_walk = 1.0 / (1.0 + 4.0 * a * np.sin(0.5 * theta) ** 2)
    left = 1.0 - of_walk
    assert np.mean(left) == pytest.approx(share, rel=1e-3)
    assert redundancy_as_white(share) == pytest.approx(float(np.mean(left**2) / np.mean(left)), rel=1e-3)
    assert redundancy_as_walk(walk) == pytest.approx(float(np.mean(of_walk**2) / np.mean(of_walk)), rel=1e-3)


def test_a_walk_is_known_as_well_as_estimates_of_it_scatter() -> None:
    """Of a walk in white noise, by the most likely ratio of both on a grid; the white noise is known."""
    n, drawn, ratio = 400, 150, 0.5
    grid = np.linspace(-0.8, 0.8, 161)
    theta = np.arange(1, n) * math.pi / n
    of_walk = ratio * np.exp(2.0 * grid)[:, None]
    spectrum = of_walk + 4.0 * np.sin(0.5 * theta) ** 2
    drawn_of = _seen(ratio, theta, drawn)
    found = [float(grid[np.argmin(np.sum(np.log(spectrum) + seen / spectrum, axis=1))]) for seen in drawn_of]
    part = ratio / (ratio + 4.0 * np.sin(0.5 * theta) ** 2)
    # frequencies are no times: all of them are in every block
    mixed = np.random.default_rng(1).permutation(len(part))
    normalised = (seen / (ratio + 4.0 * np.sin(0.5 * theta) ** 2) for seen in _seen(ratio, theta, drawn, seed=9))
    residuals = (Residuals((seen * part)[mixed], part[mixed], float(len(part))) for seen in normalised)
    said = [without(OF_RATE, of_rate(each)) for each in residuals]
    assert np.mean(said) == pytest.approx(np.std(found), rel=0.2)


def _seen(ratio: float, theta: Array, drawn: int, seed: int = 0) -> Iterator[Array]:
    """Periodograms of steps that walk by sqrt(ratio) beside white noise of one, by the cosine transform's variances."""
    rng = np.random.default_rng(seed)
    for _ in range(drawn):
        yield (ratio + 4.0 * np.sin(0.5 * theta) ** 2) * rng.standard_normal(len(theta)) ** 2


@pytest.mark.parametrize("spread", [of_positions, of_velocities, of_rate])
def test_a_noise_that_is_not_observable_has_its_prior_sigma(spread: Callable[[Residuals], float]) -> None:
    assert spread(Residuals(np.zeros(100), np.zeros(100), 0.0)) == ANY_NOISE
    assert spread(Residuals(np.ones(100), np.full(100, 1e-4), 100.0)) == ANY_NOISE
    assert spread(Residuals(np.zeros(0), np.zeros(0), 0.0)) == ANY_NOISE


def test_much_of_what_is_not_left_may_be_the_wanders() -> None:
    """The less of the noise of fixes is in their residuals, the more hangs on how their wander was modelled."""
    by_share = [of_positions(white(5000, left=share)) for share in (0.99, 0.7, 0.5)]
    assert by_share[0] < 0.04 < by_share[1] < 0.2 < by_share[2]
    assert of_velocities(white(5000, left=0.5)) == pytest.approx(0.2, rel=0.1)


def test_force_without_doppler_is_known_less_well() -> None:
    many = white(100_000)
    assert of_force(many, has_doppler=True) == pytest.approx(OF_FORCE, rel=0.01)
    assert of_force(many, has_doppler=False) == pytest.approx(OF_FORCE_ALONE, rel=0.01)
