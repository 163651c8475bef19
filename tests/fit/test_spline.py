"""Cubic splines against an independent implementation."""

import numpy as np
import pytest
from scipy import interpolate

from smoother.fit.spline import CubicSpline

SPACINGS = {"even": lambda rng: np.ones(60), "uneven": lambda rng: np.exp(rng.normal(size=60))}


@pytest.mark.parametrize("spacing", sorted(SPACINGS))
@pytest.mark.parametrize("is_closed", [True, False])
def test_a_spline_is_the_one_the_library_finds(spacing: str, is_closed: bool) -> None:
    rng = np.random.default_rng(3)
    x = np.concatenate([[0.0], np.cumsum(SPACINGS[spacing](rng))])
    values = np.cumsum(rng.normal(size=(61, 2)), axis=0)
    if is_closed:
        values[-1] = values[0]
    found = CubicSpline(x, values, is_closed=is_closed)
    expected = interpolate.CubicSpline(x, values, bc_type="periodic" if is_closed else "not-a-knot")
    at = np.linspace(0.0, x[-1], 1001)
    np.testing.assert_allclose(found(at), expected(at), atol=1e-9)
    value, slope = found.with_slope(at)
    np.testing.assert_array_equal(value, found(at))
    np.testing.assert_allclose(slope, expected(at, nu=1), atol=1e-8)
    np.testing.assert_allclose(found.integral(), expected.antiderivative()(x), atol=1e-7)


def test_a_cubic_is_reproduced_up_to_both_ends() -> None:
    x = np.array([0.0, 0.5, 2.0, 3.0, 3.2, 5.0])
    at = np.linspace(0.0, 5.0, 101)
    found = CubicSpline(x, (x**3 - 4.0 * x)[:, None])
    np.testing.assert_allclose(found(at)[:, 0], at**3 - 4.0 * at, atol=1e-9)
