"""Local polynomials against an independent implementation."""

import numpy as np
import pytest
from scipy.signal import savgol_filter

from smoother.fit.running import local_polynomial


@pytest.mark.parametrize(("window", "degree", "derivative"), [(5, 1, 0), (21, 3, 1), (9, 2, 2), (3, 1, 0), (51, 3, 0)])
@pytest.mark.parametrize("columns", [(), (3,)])
def test_local_polynomials_are_those_of_savitzky_and_golay(
    window: int, degree: int, derivative: int, columns: tuple[int, ...]
) -> None:
    values = np.cumsum(np.random.default_rng(window).normal(size=(200, *columns)), axis=0)
    found = local_polynomial(values, window, degree, derivative, step=0.02)
    expected = savgol_filter(values, window, degree, deriv=derivative, delta=0.02, axis=0)
    # rounding, which the steps of the derivative magnify
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-10 * 0.02**-derivative)


def test_a_polynomial_is_reproduced_up_to_both_ends() -> None:
    t = 0.1 * np.arange(40)
    found = local_polynomial(t**3 - t, 11, 3, derivative=1, step=0.1)
    np.testing.assert_allclose(found, 3.0 * t**2 - 1.0, atol=1e-9)


@pytest.mark.parametrize("window", [4, 41, 3])
def test_a_window_that_does_not_fit_is_refused(window: int) -> None:
    with pytest.raises(ValueError, match="window"):
        local_polynomial(np.zeros(40), window, 3)
