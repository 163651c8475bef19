"""Several series of values and their transforms, and the filter that takes their noise off.

Source: Wiener 1949, for several channels; the edge of eigenvalues that noise alone reaches: Marchenko & Pastur 1967.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, ComplexArray, IntArray

SPECTRUM_WIDTH = 0.05  # Hz to either side over which a spectrum is averaged, and
# of the frequency, where that is more: a kart's laps are lines, its noise is not, which a filter made from few
# frequencies would follow
SPECTRUM_SHARE = 0.4
FACTOR = 32  # lengths of up to so many times a power of two are transformed quickly


@dataclass(frozen=True, eq=False)
class Transform:
    """Real values of C channels, (N, C), dt s apart, by their frequencies: mean (C,) and coefficients (F, C).

    Means fill up to a length that is quick to transform: prime ones take twenty times as long. (A line from the last to
    the first would make an event of the noise of these two, the mirrored values would turn what leads to what lags.)
    White noise of standard deviation s has a mean power |coefficient|^2 of `count` s^2.
    """

    coefficients: ComplexArray
    mean: Array
    count: int
    dt: float

    @classmethod
    def of(cls, values: Array, dt: float) -> "Transform":
        """Transform values (N, C), dt s apart, N at least 1."""
        count, mean = len(values), values.mean(axis=0)
        filled = np.zeros((quick_length(count), values.shape[1]))
        np.subtract(values, mean, out=filled[:count])
        return cls(np.fft.rfft(filled, axis=0), mean, count, dt)

    @property
    def length(self) -> int:
        """Number of values that were transformed, those that fill up among them."""
        return 2 * (len(self.coefficients) - 1)

    @property
    def frequency(self) -> Array:
        """Frequencies (F,) Hz."""
        return np.arange(len(self.coefficients)) / (self.length * self.dt)

    def channels(self, wanted: slice) -> "Transform":
        """Return some of the channels."""
        return replace(self, coefficients=self.coefficients[:, wanted], mean=self.mean[wanted])

    def values(self) -> Array:
        """Return the values (N, C)."""
        return np.asarray(np.fft.irfft(self.coefficients, axis=0)[: self.count] + self.mean)

    def later(self, by: Array) -> "Transform":
        """Return the values as they were `by` (C,) s before."""
        turned = np.exp(-2j * np.pi * self.frequency[:, None] * by)
        return replace(self, coefficients=self.coefficients * turned)

    def slower_than(self, limit: float) -> "Transform":
        """Return the values without what is as quick as `limit` Hz or quicker."""
        return replace(self, coefficients=np.where(self.frequency[:, None] < limit, self.coefficients, 0.0))


def quick_length(count: int) -> int:
    """Least even number from `count` on that is FACTOR times a power of two at most."""
    unit = max(2, 1 << max(0, (count - 1).bit_length() - FACTOR.bit_length() + 1))
    return -(-count // unit) * unit


@dataclass(frozen=True, eq=False)
class MostProbable:
    """Most probable signals in W channels, and the mean variance (W,) of their errors."""

    signal: Transform
    variance: Array


def most_probable(transform: Transform, sigma: Array, wanted: slice) -> MostProbable:
    """Multichannel Wiener filter: most probable signals in the channels `wanted` of noisy ones.

    sigma (C,) or, of each frequency, (F, C): standard deviation of the noise of the channels, independent of one
    another. What of the spectral matrix noise alone may reach is taken off. Only what the channels share in phase
    passes from one to another. Errors are the noise that passes and the signal that does not.
    """
    spectrum = transform.coefficients / sigma
    n, c = spectrum.shape
    band, first, last = _bands(n, transform.length * transform.dt)
    power = (spectrum[:, :, None] * spectrum[:, None, :].conj()).real / transform.count
    power = np.concatenate([np.zeros((1, c, c)), np.cumsum(power, axis=0)])
    count = last - first
    eigenvalues, axes = np.linalg.eigh((power[last] - power[first]) / count[:, None, None])
    of_noise = (1.0 + np.sqrt(c / count)) ** 2
    share = np.clip(1.0 - of_noise[:, None] / np.maximum(eigenvalues, 1e-300), 0.0, 1.0)
    gain = ((axes[:, wanted] * share[:, None, :]) @ axes.transpose(0, 2, 1)).reshape(len(band), -1)
    k = np.arange(n)
    fine = np.stack([np.interp(k, band, gain[:, i]) for i in range(gain.shape[1])], axis=1).reshape(n, -1, c)
    found = (fine @ spectrum[:, :, None])[:, :, 0] * sigma[..., wanted]
    # noise alone has eigenvalues above and below one: what is withheld is a signal only where they are above on average
    passed, withheld = (
        _mean_variance(axes[:, wanted] ** 2 @ error[:, :, None], band, sigma[..., wanted], n)
        for error in (share**2, (1.0 - share) ** 2 * (eigenvalues - 1.0))
    )
    variance = passed + np.maximum(withheld, 0.0)
    return MostProbable(replace(transform, coefficients=found, mean=transform.mean[wanted]), variance)


def _mean_variance(whitened: Array, band: IntArray, sigma: Array, n_frequencies: int) -> Array:
    """Mean (W,) over all frequencies of variances (B, W, 1) in units of sigma (W,) or (F, W), given in bands (B,)."""
    k = np.arange(n_frequencies)
    by_frequency = np.stack([np.interp(k, band, whitened[:, i, 0]) for i in range(whitened.shape[1])], axis=1)
    return np.asarray(np.mean(by_frequency * sigma**2, axis=0))


def _bands(n_frequencies: int, duration: float) -> tuple[IntArray, IntArray, IntArray]:
    """Bands that overlap by half and more: their middles (B,), first and last frequencies (B,), the last exclusive."""
    k, middles = 0.0, []
    while k < n_frequencies - 1:
        middles.append(int(k))
        k += max(1.0, 0.5 * SPECTRUM_WIDTH * duration, 0.5 * SPECTRUM_SHARE * k)
    band = np.array([*middles, n_frequencies - 1], dtype=np.int64)
    width = np.maximum(SPECTRUM_WIDTH * duration, SPECTRUM_SHARE * band)
    first = np.maximum(band - width, 0).astype(np.int64)
    return band, first, np.minimum(band + width + 1, n_frequencies).astype(np.int64)
