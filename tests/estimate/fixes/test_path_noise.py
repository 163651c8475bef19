"""Residuals judged as if left out, weights that end at zero, and variance components against known noise."""

import numpy as np
import pytest

from smoother.estimate.fixes import path_noise as noise
from smoother.estimate.fixes.path_graph import KINDS

POSITION, HEIGHT = KINDS.index("position"), KINDS.index("height")


def mean_of_heights(values: np.ndarray, weight: np.ndarray) -> list[noise.Judged]:
    """Heights of one constant, solved by their weighted mean; sigma 2 m."""
    n = len(values)
    mean, left = np.average(values, weights=weight), 4.0 / weight.sum()
    nothing = noise.Judged(np.zeros((n, 2)), np.full((n, 2), np.inf), np.zeros((n, 2)), np.ones(n))
    heights = noise.Judged((mean - values)[:, None], np.full((n, 1), 4.0), np.full((n, 1), left), weight)
    return [heights if kind == HEIGHT else nothing for kind in range(len(KINDS))]


@pytest.mark.parametrize("own_weight", [1.0, 0.4, 0.0])
def test_a_residual_is_judged_by_what_the_others_say(own_weight: float) -> None:
    values = np.array([0.1, -0.1, 0.2, -0.2, 0.3, -0.3, 0.4, -0.4, 8.0])
    weight = np.append(np.ones(8), own_weight)
    size = noise.normalised_sizes(mean_of_heights(values, weight))
    slack = noise.UNREMARKABLE[HEIGHT]
    # the others have their mean at 0 with a variance of 4 / 8
    assert size[8, HEIGHT] == pytest.approx(8.0 / np.sqrt(4.0 + slack**2 + 4.0 / 8.0))
    assert np.isnan(size[:, POSITION]).all()


def test_a_kind_that_the_model_cannot_meet_is_scaled_and_not_rejected() -> None:
    values = 30.0 * np.array([1.0, -1.0, 1.2, -1.2])
    size = noise.normalised_sizes(mean_of_heights(values, np.ones(4)))[:, HEIGHT]
    assert np.quantile(size, noise.BULK) == pytest.approx(noise.BULK_SIZE[HEIGHT])


def test_weights_are_one_then_fall_to_zero() -> None:
    size = np.full((5, len(KINDS)), 0.1)
    size[:, POSITION] = [0.0, noise.KEEP, 4.0, noise.DROP, 50.0]
    weight = noise.robust_weights(size, np.ones_like(size), 1.0)[:, POSITION]
    assert weight[:2].tolist() == [1.0, 1.0]
    assert 0.2 < weight[2] < 0.7
    assert weight[3:].tolist() == [0.0, 0.0]
    wide = noise.robust_weights(size, np.ones_like(size), 20.0)
    assert (wide == 1.0).all()


def test_without_doppler_a_fix_the_screen_let_pass_keeps_some_weight() -> None:
    size = np.full((3, len(KINDS)), np.nan)
    size[:, POSITION] = 20.0
    before = np.ones_like(size)
    before[0] = 0.0  # the screen did not
    weight = noise.robust_weights(size, before, 1.0)[:, POSITION]
    np.testing.assert_allclose(weight, [0.0, noise.KEEP / 20.0, noise.KEEP / 20.0])


def test_a_rejected_run_comes_back_from_its_ends_only() -> None:
    size, before = np.zeros((7, len(KINDS))), np.ones((7, len(KINDS)))
    before[2:6] = 0.0
    weight = noise.robust_weights(size, before, 1.0)[:, POSITION]
    assert weight.tolist() == [1.0, 1.0, 1.0, 0.0, 0.0, 1.0, 1.0]
    early = noise.robust_weights(size, before, 2.0)[:, POSITION]  # limits still wide: nothing returns
    assert early.tolist() == [1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]


def test_wild_reported_accuracies_overflow_nowhere() -> None:
    assert np.max(noise._relative(np.array([1e-300, 1e-300, 1e-300, 1e300]))) < 1e7
