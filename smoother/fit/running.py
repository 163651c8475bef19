"""Running filters over evenly spaced rows: local polynomials.

SciPy has them too, in a package that takes longer to import than all laps of a session take to be analysed.
"""

import math

import numpy as np

from smoother.arrays import Array


def local_polynomial(values: Array, window: int, degree: int, derivative: int = 0, step: float = 1.0) -> Array:
    """Value or derivative at each row of the polynomial fitted to the `window` (odd) rows around it.

    values (N,) or (N, c), N >= window, rows `step` apart. Returns the shape of `values`; at either end the polynomial
    of the first or last whole window counts. Raises ValueError where the window does not fit.
    Source: Savitzky & Golay 1964.
    """
    if window % 2 == 0 or not degree < window <= len(values):
        raise ValueError(f"a window of {window} rows for degree {degree} and {len(values)} rows")
    columns = values.reshape(len(values), -1)
    half = window // 2
    x = np.arange(-half, half + 1) / max(half, 1)  # within 1, which keeps the fit well conditioned
    fit = np.linalg.pinv(np.vander(x, degree + 1, increasing=True))
    unit = (max(half, 1) * step) ** -derivative
    middle = math.factorial(derivative) * unit * fit[derivative] if derivative <= degree else np.zeros(window)
    out = np.empty_like(columns)
    for i in range(columns.shape[1]):
        out[half : len(columns) - half, i] = np.convolve(columns[:, i], middle[::-1], mode="valid")
    at = unit * _derivative_of_powers(x, degree, derivative) @ fit
    out[:half] = (at @ columns[:window])[:half]
    out[len(columns) - half :] = (at @ columns[-window:])[window - half :]
    return out.reshape(values.shape)


def _derivative_of_powers(x: Array, degree: int, derivative: int) -> Array:
    """Derivative of 1, x, x^2 .. at x (N,). Returns (N, degree + 1)."""
    rows = np.zeros((x.size, degree + 1))
    for power in range(derivative, degree + 1):
        rows[:, power] = math.perm(power, derivative) * x ** (power - derivative)
    return rows
