"""How much alike residuals take away from a mean."""

import numpy as np
import pytest

from smoother.fit.correlation import correlation_growth


def test_white_residuals_cost_nothing():
    assert correlation_growth(np.random.default_rng(1).standard_normal(5000)) == 1.0


def test_correlation_grows_the_sigma_as_in_theory():
    rng, memory = np.random.default_rng(2), 0.8
    residual = rng.standard_normal(50_000)
    for k in range(1, len(residual)):
        residual[k] += memory * residual[k - 1]
    assert correlation_growth(residual) == pytest.approx(np.sqrt((1.0 + memory) / (1.0 - memory)), rel=0.1)


def test_too_few_or_constant_residuals_say_nothing():
    assert correlation_growth(np.arange(5.0)) == 1.0
    assert correlation_growth(np.ones(100)) == 1.0
