"""Running filters over evenly spaced rows: local polynomials, Gaussian means, extremes.

SciPy has them too, in packages that take longer to import than all laps of a session take to be analysed.
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


def gaussian_mean(values: Array, sigma: float, *, is_closed: bool = False) -> Array:
    """Mean around each row of values (N,) or (N, c), weighted by a Gaussian of `sigma` rows, cut at four of them.

    Beyond the ends the rows of the other end count where `is_closed`, else the end row repeated.
    """
    reach = int(4.0 * sigma + 0.5)
    weight = np.exp(-0.5 * (np.arange(-reach, reach + 1) / max(sigma, 1e-9)) ** 2)
    weight /= weight.sum()
    columns = _extended(values.reshape(len(values), -1), reach, is_closed)
    means = [np.convolve(columns[:, i], weight, mode="valid") for i in range(columns.shape[1])]
    return np.stack(means, axis=1).reshape(values.shape)


def running_maximum(values: Array, window: int, *, is_closed: bool = False) -> Array:
    """Largest of the `window` (odd) rows around each of values (N,); ends as in :func:`gaussian_mean`."""
    extended = _extended(values[:, None], window // 2, is_closed)[:, 0]
    return np.asarray(np.lib.stride_tricks.sliding_window_view(extended, window).max(axis=1))


def _extended(columns: Array, reach: int, is_closed: bool) -> Array:
    return np.pad(columns, ((reach, reach), (0, 0)), mode="wrap" if is_closed else "edge")


def running_mean(values: Array, window: int) -> Array:
    """Mean of the `window` rows around each of values (N, D); the first and the last one go on at both ends."""
    padded = np.pad(values, ((window // 2 + 1, (window - 1) // 2), (0, 0)), mode="edge")
    total = np.cumsum(padded, axis=0)
    return np.asarray((total[window:] - total[:-window]) / window)
