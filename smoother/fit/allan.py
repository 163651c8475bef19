"""Allan deviation, and the noise of a sensor at rest: white, flicker (bias instability) and random walk.

The curve is the overlapping Allan deviation, what people expect to see. The figures are not read off it, because its
points are correlated and the long ones are few: they are fitted to the spectrum by maximum likelihood, which uses all
the data and says how sure each figure is. Both descriptions are of the same noise, two-sided densities:

    part                    spectrum          Allan variance      unit of the figure
    white, density N        N^2               N^2 / tau           u / sqrt(Hz)
    flicker, instability B  B^2 / (2 pi f)    B^2 2 ln(2) / pi    u
    random walk K           (K / (2 pi f))^2  K^2 tau / 3         u / sqrt(s)

Sources: IEEE Std 952-1997, annex C; Riedel and Sidorenko 1995 (sine tapers); Whittle 1953 (the likelihood).
"""

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.optimize import nnls
from scipy.stats import chi2

from smoother.arrays import Array, BoolArray, freeze
from smoother.fit.ellipsoid import FitError

PARTS = ("noise density", "bias instability", "random walk")
TAPERS = 4  # a spectral estimate has twice as many degrees of freedom
BANDS_PER_DECADE = 30


@dataclass(frozen=True, eq=False)
class AllanDeviation:
    """Overlapping Allan deviation of D columns: tau (M,) s; deviation (M, D) in the unit of the values; sigma (M, D).

    The sigma is that of white noise (Howe et al. 1981), the usual error bar of such a plot.
    """

    tau: Array
    deviation: Array
    sigma: Array


@dataclass(frozen=True, eq=False)
class NoiseFigures:
    """Noise density, bias instability and random walk of each column (D, 3), their sigmas, and which were seen.

    covariance (D, 3, 3) is that of the figures' squares, in which the fit is linear. `upper` (D, 3): what a figure is
    below with 97 % confidence; for a part that was not seen it is all that is known.
    """

    value: Array
    sigma: Array
    upper: Array
    is_seen: BoolArray
    covariance: Array

    def __post_init__(self) -> None:
        freeze(self, value=(None, 3), sigma=(None, 3), upper=(None, 3))

    def allan_deviation(self, tau: Array, *, of_seen: bool = False) -> Array:
        """Allan deviation (M, D) that these figures mean at tau (M,) s; of_seen: without the parts that were not."""
        basis = np.stack([1.0 / tau, np.full_like(tau, 2.0 * np.log(2.0) / np.pi), tau / 3.0], axis=1)
        value = np.where(self.is_seen, self.value, 0.0) if of_seen else self.value
        return np.asarray(np.sqrt(basis @ np.square(value).T))


def allan_deviation(values: Array, rate: float, tau: Array | None = None) -> AllanDeviation:
    """Return the overlapping Allan deviation of values (N, D), sampled at `rate` Hz.

    tau (M,) s, rounded to whole samples; None: about ten a decade, up to a fifth of the recording.
    Raises FitError for too few samples, or some that are not finite.
    """
    values = _checked(values)
    count = len(values)
    longest = count // 5
    wanted = np.logspace(0.0, np.log10(longest), int(10 * np.log10(longest)) + 1) if tau is None else tau * rate
    m = np.unique(np.clip(np.round(wanted), 1, (count - 1) // 2).astype(np.int64))
    angle = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values - values.mean(axis=0), axis=0)]) / rate
    deviation = np.empty((len(m), values.shape[1]))
    for row, size in enumerate(m):
        second = angle[2 * size :] - 2.0 * angle[size:-size] + angle[: -2 * size]
        deviation[row] = np.sqrt(0.5 * np.mean(second**2, axis=0)) * rate / size
    freedom = (1.5 * (count - 1) / m - 2.0 * (count - 2) / count) * 4.0 * m**2 / (4.0 * m**2 + 5.0)
    return AllanDeviation(m / rate, deviation, deviation / np.sqrt(2.0 * np.maximum(freedom, 1.0))[:, None])


def fit_noise(values: Array, rate: float) -> NoiseFigures:
    """Fit noise density, bias instability and random walk to values (N, D) of a sensor at rest, sampled at `rate` Hz.

    Raises FitError for too few samples, some that are not finite, or a column that never changes.
    """
    values = _checked(values)
    if np.any(np.ptp(values, axis=0) == 0.0):
        raise FitError("the readings never change, so they have no noise to measure; is the sensor connected?")
    bands = _Bands.of(values, rate)
    fits = [_fit_column(bands.density[:, i], bands) for i in range(values.shape[1])]
    square = np.stack([fit[0] for fit in fits])
    covariance = np.stack([fit[1] for fit in fits])
    square_sigma = np.sqrt(np.einsum("dii->di", covariance))
    value, upper = np.sqrt(square), np.sqrt(square + 2.0 * square_sigma)
    seen = square > 2.0 * square_sigma  # a part that is smaller than this many of its sigmas was not seen
    sigma = np.where(seen, 0.5 * square_sigma / np.maximum(value, 1e-300), upper - value)
    return NoiseFigures(value, sigma, upper, seen, covariance)


def _checked(values: Array) -> Array:
    values = np.asarray(values, dtype=np.float64)
    if len(values) < 1000:
        raise FitError(
            f"{len(values)} samples at rest are too few for an Allan deviation; let the logger lie for minutes"
        )
    if not np.all(np.isfinite(values)):
        raise FitError("some readings are not finite numbers; drop those rows first")
    return values


@dataclass(frozen=True, eq=False)
class _Bands:
    """Mean spectral density in bands: density (M, D), of `freedom` (M,) degrees; basis (M, 3), that of unit parts."""

    density: Array
    basis: Array
    freedom: Array

    @staticmethod
    def of(values: Array, rate: float) -> "_Bands":
        """Sine multitaper estimates, one per bandwidth so that they are independent, averaged over even bands."""
        frequency, density, half_width = _multitaper(values, rate)
        # of the sampling rate; above, the sensor's own low-pass filter bends the spectrum
        inside = frequency < 0.125 * rate
        frequency, density = frequency[inside], density[inside]
        low, high = frequency - half_width, frequency + half_width
        # means over the width of an estimate, which at the low end is as wide as the frequency itself
        flicker = np.log(high / low) / (2.0 * half_width) / (2.0 * np.pi)
        walk = 1.0 / (low * high) / (2.0 * np.pi) ** 2
        basis = np.stack([np.ones_like(frequency), flicker, walk], axis=1)
        band = np.floor(BANDS_PER_DECADE * np.log10(frequency)).astype(np.int64)
        _, start, count = np.unique(band, return_index=True, return_counts=True)
        size = count[:, None]
        return _Bands(
            np.add.reduceat(density, start) / size,
            np.add.reduceat(basis, start) / size,
            2.0 * TAPERS * count.astype(np.float64),
        )


def _multitaper(values: Array, rate: float) -> tuple[Array, Array, float]:
    """Frequencies (F,), two-sided densities (F, D), half their bandwidth, without the two lowest frequencies."""
    count = len(values)
    centred = values - values.mean(axis=0)
    n = np.arange(1, count + 1)
    step = TAPERS + 1  # bins of 1 / (count dt) hold one bandwidth; neighbours so far apart are independent
    bins = np.arange(2 * step, count // 2, step)
    density = np.zeros((len(bins), values.shape[1]))
    for k in range(1, TAPERS + 1):
        taper = np.sqrt(2.0 / (count + 1)) * np.sin(np.pi * k * n / (count + 1))
        density += np.abs(np.fft.rfft(centred * taper[:, None], axis=0)[bins]) ** 2
    return bins * rate / count, density / (TAPERS * rate), 0.5 * step * rate / count


def _fit_column(density: Array, bands: _Bands) -> tuple[Array, Array]:
    """Squares (3,) of the parts and their covariance (3, 3), of one column; spectral lines are left out."""
    scale = 1.0 / np.maximum(np.median(bands.basis, axis=0), 1e-300) * np.median(density)
    basis, used = bands.basis * scale, ~_is_line(density, bands.freedom)
    square = _whittle(density[used], basis[used], bands.freedom[used])
    weighted = basis[used] / (basis[used] @ square)[:, None] * np.sqrt(0.5 * bands.freedom[used])[:, None]
    covariance = np.linalg.pinv(weighted.T @ weighted)
    return square * scale, covariance * scale[:, None] * scale


def _is_line(density: Array, freedom: Array) -> BoolArray:
    """Mask (M,) of bands that stand out of their neighbours on both sides, which slow drift at the low end does not."""
    padded = np.concatenate([np.full(3, np.inf), density, np.full(3, np.inf)])
    before = np.median(sliding_window_view(padded[:-4], 3)[: len(density)], axis=1)
    after = np.median(sliding_window_view(padded[4:], 3)[: len(density)], axis=1)
    around = np.maximum(before, after)
    # that noise alone lifts a band this far: mains hum and the like are left out
    return np.asarray(chi2.sf(freedom * density / around, freedom) < 1e-6 / len(density))


def _whittle(density: Array, basis: Array, freedom: Array) -> Array:
    """Non-negative squares (3,) of greatest likelihood: Fisher scoring, each step a weighted least squares."""
    square = np.full(3, 1.0 / 3.0)
    for _ in range(50):
        weight = np.sqrt(0.5 * freedom) / np.maximum(basis @ square, 1e-12 * np.median(density))
        before = square
        square, _ = nnls(basis * weight[:, None], density * weight)
        if np.max(np.abs(square - before)) < 1e-9 * np.max(square):
            break
    return np.asarray(square)
