"""The sigma of a mean of correlated residuals."""

import numpy as np

from smoother.arrays import Array


def correlation_growth(residual: Array) -> float:
    """Factor by which sigmas grow because neighbouring residuals (N,), in time order, are alike; 1 for white noise.

    From the sum of autocorrelations up to the first that is not significant. Source: Geyer 1992, initial sequence.
    """
    n = len(residual)
    centred = residual - residual.mean()
    power = float(centred @ centred)
    if n < 20 or power == 0.0:
        return 1.0
    total, limit = 0.0, 4.0 / np.sqrt(n)  # sigmas of the autocorrelation of white noise
    for lag in range(1, min(200, n // 4)):  # residuals
        correlation = float(centred[lag:] @ centred[:-lag]) / power
        if correlation < limit:
            break
        total += correlation
    return float(np.sqrt(1.0 + 2.0 * total))
