"""Gyroscope bias and its covariance from samples at rest (thesis, eq. 2.1-2.4), and how it changes with temperature.

Errata: eq. 2.3 and 2.4 print sums of products of the readings themselves over N - 1; that is a second moment with the
bias still in it. Variances and covariances are about the mean, as here.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, freeze
from smoother.fit.correlation import correlation_growth
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
        freeze(self, bias=(3,), noise_covariance=(3, 3))

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
        raise FitError(f"{len(chosen)} gyro readings at rest are too few for a bias; let the logger stand still")
    return GyroBias(np.mean(chosen, axis=0), np.cov(chosen, rowvar=False), len(chosen))


def fit_gyro_bias_of_first(angular_rate: Array, count: int = THESIS_SAMPLES) -> GyroBias:
    """Bias from the first `count` readings, taken to be at rest: the thesis' form, for its files. Raises FitError."""
    return fit_gyro_bias(np.asarray(angular_rate)[:count])


@dataclass(frozen=True, eq=False)
class TemperatureFit:
    """bias(T) = bias + slope (T - temperature): bias (3,) rad/s, slope (3,) rad/s/K; temperature deg C; their sigmas.

    At `temperature`, the mean of the recording, bias and slope are uncorrelated. span: (lowest, highest) deg C seen.
    """

    temperature: float
    bias: Array
    slope: Array
    bias_sigma: Array
    slope_sigma: Array
    span: tuple[float, float]

    def at(self, temperature: Array) -> Array:
        """Bias (N, 3) rad/s at temperature (N,) deg C, held at the ends of what was seen."""
        inside = np.clip(temperature, *self.span)
        return np.asarray(self.bias + (inside - self.temperature)[:, None] * self.slope)


def fit_temperature(temperature: Array, angular_rate: Array) -> TemperatureFit:
    """Fit a straight line through means at rest: temperature (B,) deg C, angular_rate (B, 3) rad/s, B batches.

    Batches, in time order, count as independent unless their residuals show otherwise.
    Raises FitError when the temperature hardly changed or batches are few.
    """
    known = np.isfinite(temperature) & np.all(np.isfinite(angular_rate), axis=1)
    T, rate = temperature[known], angular_rate[known]
    if len(T) < 10:
        raise FitError(f"{len(T)} means at rest with a temperature are too few for the gyro's dependence on it")
    if np.ptp(T) < 3.0:  # K; less is the sensor's own self-heating noise
        raise FitError(f"the temperature changed by only {np.ptp(T):.1f} K; let the cold logger warm up for 20 min")
    middle = float(np.mean(T))
    centred = T - middle
    spread = float(centred @ centred)
    bias, slope = rate.mean(axis=0), centred @ rate / spread
    residual = rate - bias - centred[:, None] * slope
    variance = np.sum(residual**2, axis=0) / (len(T) - 2)
    variance = variance * np.square([correlation_growth(residual[:, i]) for i in range(3)])
    ends = (float(np.min(T)), float(np.max(T)))
    return TemperatureFit(middle, bias, slope, np.sqrt(variance / len(T)), np.sqrt(variance / spread), ends)
