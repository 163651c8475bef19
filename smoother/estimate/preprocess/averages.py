"""What the box felt on average around some times, and where samples are missing."""

from weakref import WeakKeyDictionary

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces, release, roomy
from smoother.samples import ImuSamples

WINDOW = 0.5  # s over which both sides of the fit are averaged; longer than a lag's error, shorter than a corner
SHARED = 1 << 21  # samples, of which the sums are kept for the next who asks; those of a day fill the disc
FEW = 500  # times that are looked up together: each brings 100 kB of its surroundings into memory


class Averages:
    """Mean force and rate of samples over windows, from cumulative sums."""

    def __init__(self, imu: ImuSamples) -> None:
        self._t, self._sum, before = imu.t, roomy((len(imu.t), 6)), np.zeros(6)
        for part in pieces(len(imu.t)):
            total, lasts = self._sum[part], steps(imu.t, part)[:, None]  # in place: copies of all would cost as much
            np.multiply(imu.specific_force_s[part], lasts, out=total[:, :3])
            np.multiply(imu.angular_rate_s[part], lasts, out=total[:, 3:])
            total[0] += before
            np.cumsum(total, axis=0, out=total)
            before = total[-1].copy()
            release(imu, self._sum)

    def around(self, t: Array, width: float) -> tuple[Array, Array]:
        """Mean force and rate, each (..., 3), over `width` seconds around t (...)."""
        force, rate = self.between(t - 0.5 * width, t + 0.5 * width)
        return force / width, rate / width

    def between(self, since: Array, until: Array) -> tuple[Array, Array]:
        """Integrals of force and rate, each (..., 3), from since (...) to until (...) s."""
        total = np.empty((*since.shape, 6))
        for some in pieces(since.shape[-1], FEW):
            total[..., some, :] = self._until(until[..., some]) - self._until(since[..., some])
            release(self._t, self._sum)
        return total[..., :3], total[..., 3:]

    def _until(self, t: Array) -> Array:
        """The sums (..., 6) until t (...), linear between samples."""
        t = np.clip(t, self._t[0], self._t[-1])
        k = np.clip(np.searchsorted(self._t, t, side="right") - 1, 0, self._t.size - 2)
        fraction = ((t - self._t[k]) / (self._t[k + 1] - self._t[k]))[..., None]
        before, after = np.take(self._sum, k, axis=0), np.take(self._sum, k + 1, axis=0)  # faster than indexing
        return np.asarray((1.0 - fraction) * before + fraction * after)


_KNOWN: WeakKeyDictionary[ImuSamples, Averages] = WeakKeyDictionary()


def averages_of(imu: ImuSamples) -> Averages:
    """Return the averages of samples, those that were made before while the samples are there."""
    if len(imu.t) > SHARED:
        return Averages(imu)
    known = _KNOWN.get(imu)
    if known is None:
        known = _KNOWN[imu] = Averages(imu)
    return known


def in_gap(sampled: Array, t: Array) -> BoolArray:
    """Mask (N,) of times t s in a stretch without samples, or a second from it, where averages are interpolated.

    sampled (M,) s: times of the samples.
    """
    before = before_holes(sampled)
    if not len(before):
        return np.zeros(len(t), dtype=np.bool_)
    latest = np.searchsorted(sampled[before] - 1.0, t) - 1
    return np.asarray((latest >= 0) & (t < sampled[before + 1][np.maximum(latest, 0)] + 1.0))


def before_holes(sampled: Array) -> IntArray:
    """Return the rows (H,) of times sampled (M,) s after which samples are missing, for longer than WINDOW."""
    parts = pieces(len(sampled) - 1)  # all differences of a day would be 140 MB
    holes = [part.start + np.flatnonzero(np.diff(sampled[part.start : part.stop + 1]) > WINDOW) for part in parts]
    return np.concatenate([np.empty(0, dtype=np.int64), *holes])


def steps(t: Array, part: slice) -> Array:
    """Return the time (K,) s since the sample before of each sample of a part of t (N,); 0 for the very first."""
    return np.diff(t[part], prepend=t[max(part.start - 1, 0)])
