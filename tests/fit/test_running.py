"""Running filters against an independent implementation."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.signal import savgol_filter

from smoother.fit.running import gaussian_mean, local_polynomial, running_maximum

MODES = {False: "nearest", True: "wrap"}


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


@pytest.mark.parametrize("is_closed", [False, True])
@pytest.mark.parametrize("sigma", [0.2, 1.5, 30.0])
@pytest.mark.parametrize("columns", [(), (2,)])
def test_gaussian_means_are_those_of_the_library(is_closed: bool, sigma: float, columns: tuple[int, ...]) -> None:
    values = np.random.default_rng(1).normal(size=(90, *columns))  # the widest reaches beyond both ends
    found = gaussian_mean(values, sigma, is_closed=is_closed)
    np.testing.assert_allclose(found, gaussian_filter1d(values, sigma, axis=0, mode=MODES[is_closed]), atol=1e-12)


@pytest.mark.parametrize("is_closed", [False, True])
@pytest.mark.parametrize("window", [1, 3, 51])
def test_running_maxima_are_those_of_the_library(is_closed: bool, window: int) -> None:
    values = np.random.default_rng(2).normal(size=60)
    found = running_maximum(values, window, is_closed=is_closed)
    np.testing.assert_array_equal(found, maximum_filter1d(values, window, mode=MODES[is_closed]))
