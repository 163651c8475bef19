"""Clocks that show times far apart, or run at rates far apart: by how much, where the stamps overlap.

A second device, GPS time in place of UTC (18 s), a file that counts from its own start: what the sensor measured is
then what the fixes show seconds before or after. Forward and left force and yaw rate of the path in some stretches are
correlated with all that was measured, at all times (by Fourier transforms: Oppenheim & Schafer 2010, 8.7); a line
through these times, an offset and a drift, is what explains most. Laps are alike: an offset is believed where it
explains clearly more than smaller ones do, by whole laps among them.
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from smoother.arrays import Array, median
from smoother.estimate.averages import WINDOW, averages_of
from smoother.estimate.path_motion import PathMotion, path_axes
from smoother.estimate.preprocess.streams import SLOWEST
from smoother.samples import ImuSamples

STEP = 0.1  # s between offsets; what is measured is averaged over WINDOW
PART, MOST_PARTS = 20.0, 24  # s of driving, within which clocks hardly part
SHORTEST, LEAST_SHARED = 60.0, 1.0 / 3.0  # s, and part, of the driving in these that must be in both
MOST_DRIFT, COARSEST = 0.016, 4e-3  # s per s
CLOSE = 0.15  # s, to which drifts tried bring the farthest part
LONGEST_DRIFT = 3600.0  # s of a session; of longer ones the offset alone is sought
LONGEST = 6 * 3600.0  # s; correlations of a day would take a gigabyte
APART, PEAKS = 3.0, 4  # s between offsets that are told apart; those that are compared
EXPLAINED = 0.25  # share of the driving, from which on clocks may be right
BLOCK, CLEARLY = 5.0, 5.0  # s, in which errors are the same; of the log-likelihood, beyond any smaller offset
OF_RECEIVERS = (-0.7, 0.3)  # s, of offsets, that are latencies of receivers
DELAY = 0.1  # s by which fixes are left late, as receivers are; which part of the offset is theirs nobody can tell


def search_clock(imu: ImuSamples, path: PathMotion) -> tuple[float, float] | None:
    """Return offset s, at the first fix, and drift of the samples' clock against that of the fixes; None if not clear.

    The offset is but for the delay of a receiver.
    """
    lasts, parts = max(float(np.ptp(path.t)), float(np.ptp(imu.t))), _parts(path)
    if lasts > LONGEST or not parts:
        return None
    found = _correlated(imu, path, parts)
    spacing = min(2.0 * CLOSE / max(found.since[-1] - found.since[0], 1.0), COARSEST)
    shows_drift = lasts < LONGEST_DRIFT and median(np.diff(path.t)) < SLOWEST
    count = math.ceil(MOST_DRIFT / spacing) if shows_drift else 0
    drifts = spacing * np.arange(-count, count + 1)
    shares = np.array([found.shares(drift) for drift in drifts.tolist()])
    best = np.max(shares, axis=0)
    if not (peaks := _peaks(found.lags, best)):
        return None
    at = peaks[0]
    smaller = max((float(best[k]) for k in peaks if abs(found.lags[k]) < abs(found.lags[at])), default=0.0)
    likelier = 0.5 * len(parts) * PART / BLOCK * math.log((1.0 - smaller) / (1.0 - float(best[at])))
    if not (best[at] > EXPLAINED and likelier > CLEARLY):
        return None
    drift = float(drifts[int(np.argmax(shares[:, at]))])
    offset = DELAY - float(found.lags[at]) + drift * float(found.since[0] - path.t[0])
    return (0.0 if OF_RECEIVERS[0] < offset < OF_RECEIVERS[1] else offset), -drift


def _parts(path: PathMotion) -> list[slice]:
    """Rows of the path in some stretches of driving, PART s each."""
    edges = np.append(np.searchsorted(path.t, np.arange(path.t[0], path.t[-1], PART)), len(path.t))
    parts = [slice(*pair) for pair in pairwise(edges.tolist())]
    driven = [part for part in parts if part.stop - part.start > 2 and np.mean(path.moves[part]) > 0.5]
    return driven[:: -(-len(driven) // MOST_PARTS)] if driven else []


@dataclass(frozen=True, eq=False)
class _Correlated:
    """Parts (P,) of the path, `since` (P,) s, with what was measured `lags` (L,) s before.

    sums (P, 11, L): covariances of forward and left with each axis of force and of yaw with each of the rate, then
    squares of force and rate about their means; path (P, 3): squares of the path's axes; count (P, L): rows in both.
    """

    since: Array
    lags: Array
    sums: np.ndarray
    path: Array
    count: np.ndarray

    def shares(self, drift: float) -> Array:
        """Share (L,) of the driving that is explained, by the lag at the first part; lags grow by `drift` s per s.

        Driving without samples is not. Fits are least squares, the path's axes taken to be independent of one another.
        """
        sums, path = np.zeros(self.sums.shape[1:]), np.zeros((3, len(self.lags)))
        count = np.zeros(len(self.lags))
        for part, since in enumerate(self.since.tolist()):
            by = round(drift * (since - float(self.since[0])) / STEP)
            to, own = (slice(max(-by, 0), len(count) - max(by, 0)), slice(max(by, 0), len(count) - max(-by, 0)))
            sums[:, to] += self.sums[part, :, own]
            shared = self.count[part, own]
            count[to] += shared
            path[:, to] += self.path[part, :, None] * (shared > 0.9 * shared.max(initial=1.0))
        square = np.maximum(path, 1e-9)
        force = np.sum(sums[:3] ** 2, axis=0) / square[0] + np.sum(sums[3:6] ** 2, axis=0) / square[1]
        rate = np.sum(sums[6:9] ** 2, axis=0) / square[2]
        share = 0.5 * (force / np.maximum(sums[9], 1e-9) + rate / np.maximum(sums[10], 1e-9))
        driven = PART / STEP * len(self.since)
        is_enough = count >= max(SHORTEST / STEP, LEAST_SHARED * driven)
        return np.asarray(np.where(is_enough, np.clip(share, 0.0, 1.0 - 1e-9) * np.minimum(count / driven, 1.0), 0.0))


def _correlated(imu: ImuSamples, path: PathMotion, parts: list[slice]) -> _Correlated:
    """Correlate parts of the path with all that was measured."""
    t = np.arange(imu.t[0], imu.t[-1], STEP)
    measured = np.concatenate(averages_of(imu).around(t, WINDOW), axis=1).T
    measured = measured - np.median(measured, axis=1, keepdims=True)
    rows = round(PART / STEP)
    size = 1 << (len(t) + rows).bit_length()
    spectra, squares, ones = (
        np.fft.rfft(measured, size),
        np.fft.rfft(measured**2, size),
        np.fft.rfft(np.ones(len(t)), size),
    )
    axes = path_axes(path)
    lags = np.arange(path.t[0] - t[-1], path.t[-1] - t[0], STEP)
    since, sums, own, counts = [], [], [], []
    for part in parts:
        at = path.t[part.start] + STEP * np.arange(int((path.t[part.stop - 1] - path.t[part.start]) / STEP) + 1)
        axis = np.stack([np.interp(at, path.t[part], axes[part, i]) for i in range(3)])
        axis = axis - axis.mean(axis=1, keepdims=True)
        of_axis, of_mask = np.conj(np.fft.rfft(axis, size)), np.conj(np.fft.rfft(np.ones(len(at)), size))
        pairs = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2), (2, 3), (2, 4), (2, 5)]
        covariance = np.stack([np.fft.irfft(spectra[j] * of_axis[i], size) for i, j in pairs])
        count = np.maximum(np.fft.irfft(ones * of_mask, size), 0.0)
        total = np.fft.irfft(spectra * of_mask, size)
        square = np.fft.irfft(squares * of_mask, size) - total**2 / np.maximum(count, 1.0)
        values = np.concatenate([covariance, [square[:3].sum(axis=0), square[3:].sum(axis=0)], [count]])
        # by the lag of the fixes: t[k] = at[0] - lag
        k = np.round((at[0] - lags - t[0]) / STEP).astype(np.int64)
        inside = (k >= 0) & (k <= len(t) - len(at))
        some = np.where(inside, values[:, np.clip(k, 0, size - 1)], 0.0).astype(np.float32)
        since.append(float(at[0]))
        sums.append(some[:11])
        own.append(np.sum(axis**2, axis=1))
        counts.append(some[11])
    return _Correlated(np.array(since), lags, np.array(sums), np.array(own), np.array(counts))


def _peaks(lags: Array, share: Array) -> list[int]:
    """Where share (L,) over lags (L,) s has its highest peaks, APART from one another; the highest first."""
    rest = share.copy()
    found: list[int] = []
    while len(found) < PEAKS and np.max(rest) > 0.0:
        at = int(np.argmax(rest))
        found.append(at)
        rest[np.abs(lags - lags[at]) < APART] = 0.0
    return found
