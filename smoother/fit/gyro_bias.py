"""Gyroscope bias and its covariance from samples at rest (thesis, eq. 2.1-2.4).

Errata: eq. 2.3 and 2.4 print sums of products of the readings themselves over N - 1; that is a second moment with the
bias still in it. Variances and covariances are about the mean, as here.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, frozen
from smoother.fit.ellipsoid import FitError

THESIS_SAMPLES = 1000  # 20 s at its 50 Hz, taken to be at rest


@dataclass(frozen=True, eq=False)
class GyroBias:
    """bias (3,) rad/s; noise_covariance (3, 3) rad^2/s^2 of one reading; count of readings.

    `covariance` (3, 3) is that of the bias, `noise_covariance / count`: readings count as independent.
    """

    bias: Array
    noise_covariance: Array
    count: int

    def __post_init__(self) -> None:
        object.__setattr__(self, "bias", frozen(self.bias, (3,), "GyroBias.bias"))
        covariance = frozen(self.noise_covariance, (3, 3), "GyroBias.noise_covariance")
        object.__setattr__(self, "noise_covariance", covariance)

    @property
    def covariance(self) -> Array:
        """Covariance of the bias, (3, 3) rad^2/s^2."""
        return np.asarray(self.noise_covariance / self.count)

    @property
    def sigma(self) -> Array:
        """One standard deviation of the bias, (3,) rad/s."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))


def fit_gyro_bias(angular_rate: Array, is_at_rest: BoolArray | None = None) -> GyroBias:
    """Mean and covariance about it of the readings (N, 3) rad/s at rest; `is_at_rest` (N,), None: all of them.

    Raises FitError with fewer than two finite readings at rest.
    """
    rate = np.asarray(angular_rate, dtype=np.float64)
    chosen = rate if is_at_rest is None else rate[is_at_rest]
    chosen = chosen[np.all(np.isfinite(chosen), axis=1)]
    if len(chosen) < 2:
        raise FitError(f"{len(chosen)} gyro readings at rest are too few for a bias; let the box stand still")
    return GyroBias(np.mean(chosen, axis=0), np.cov(chosen, rowvar=False), len(chosen))


def fit_gyro_bias_of_first(angular_rate: Array, count: int = THESIS_SAMPLES) -> GyroBias:
    """Bias from the first `count` readings, taken to be at rest: the thesis' form, for its files. Raises FitError."""
    return fit_gyro_bias(np.asarray(angular_rate)[:count])
