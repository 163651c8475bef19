"""The slow error of the fixes: a Gauss-Markov process of first order."""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.state import OFFSET, State


def offset_rows(state: State, sigma: Array, tau: float, renewed: BoolArray | None = None) -> Rows:
    """Residual o(k + 1) - phi o(k), m, with variance sigma^2 (1 - phi^2) and phi = exp(-T / tau), in every interval.

    sigma (3,) or (K-1, 3) m; tau s. renewed (K-1,): intervals after which the error is another one (phi = 0).
    Source: Gelb 1974, 3.8.
    """
    n = len(state.t) - 1
    phi = np.full((n, 1), np.exp(-state.interval / tau))
    if renewed is not None:
        phi[renewed] = 0.0
    left, right = no_jacobian(n, 3)
    left[:, :, OFFSET], right[:, :, OFFSET] = -phi[:, :, None] * np.eye(3), np.eye(3)
    residual = state.offset_n[1:] - phi * state.offset_n[:-1]
    return rows_of("gps_offset", np.arange(n), residual, sigma * np.sqrt(1.0 - phi**2), left, right)


def offset_start_rows(state: State, sigma: Array) -> Rows:
    """Residual o(0), m: stationary at the start. sigma (3,) m."""
    left, right = no_jacobian(1, 3)
    left[:, :, OFFSET] = np.eye(3)
    return rows_of("gps_offset_start", np.zeros(1, np.int64), state.offset_n[:1], sigma, left, right)
