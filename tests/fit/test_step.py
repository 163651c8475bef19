"""A step is found where there is one, and not where values merely scatter or drift to and fro."""

import numpy as np
import pytest

from smoother.fit.step import largest_step


def scattered(n: int = 4000, seed: int = 0) -> np.ndarray:
    """Values that hang together for some tens of rows."""
    noise = np.random.default_rng(seed).normal(size=n + 100)
    return np.convolve(noise, np.full(40, 0.16), mode="valid")[:n]


def test_a_step_is_found_with_its_size() -> None:
    values = scattered() + np.where(np.arange(4000) < 1700, 0.0, 5.0)
    assert largest_step(values, 600, 200, 8.0) == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize("seed", range(5))
def test_scatter_is_no_step(seed: int) -> None:
    assert largest_step(scattered(seed=seed), 600, 200, 8.0) == 0.0


def test_too_few_rows_tell_nothing() -> None:
    assert largest_step(np.repeat([0.0, 9.0], 500), 600, 200, 8.0) == 0.0
