"""Samples and fixes whose clocks show different times: by how much.

A second device, GPS time in place of UTC (18 s), a file that counts from its own start: then, as long as the stamps
overlap, what the box felt is what the fixes tell of seconds before or after. Forward and left acceleration and yaw rate
of the path are correlated with all that the box felt, for all offsets at once (by Fourier transforms: Oppenheim &
Schafer 2010, 8.7). Laps are alike: an offset is believed where it explains clearly more than smaller ones do, by whole
laps among them.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.estimate.averages import WINDOW, averages_of
from smoother.estimate.initial.align import align
from smoother.estimate.path_motion import MIN_SPEED, PathMotion, path_axes
from smoother.estimate.retimed import with_samples_at
from smoother.samples import ImuSamples, Problem, Session

CLOCK_OFFSET = "clock_offset"  # code of the problem that says so
STEP = 0.1  # s between offsets that are compared; what is felt is averaged over WINDOW
SHORTEST = 60.0  # s of driving that must be in both
LEAST_SHARED = 1.0 / 3.0  # of the driving, likewise
APART = 3.0  # s between offsets that are told apart; a delay within one corner explains much too
PEAKS = 4  # that are looked at closely
EXPLAINED = 0.8  # share of rate and force by fixes of one clock: most have more; less is another time, or motion
BLOCK = 5.0  # s, in which slip and noise of fixes are the same
CLEARLY = 5.0  # by which the log-likelihood must be above that of any offset that is smaller
DELAY = 0.1  # s by which fixes are left late, as receivers are; which part of the offset is theirs nobody can tell
LONGEST = 6 * 3600.0  # s of a session; correlations of a day would take a gigabyte


@dataclass(frozen=True)
class ClockOffset:
    """offset: seconds that the samples' clock shows more than that of the fixes, but for the delay of a receiver.

    is_found: whether it is to be taken out.
    """

    offset: float
    is_found: bool


NO_OFFSET = ClockOffset(0.0, False)


def clock_offset(imu: ImuSamples, path: PathMotion) -> ClockOffset:
    """Return by how much the clocks differ; of the best offsets the alignment says what they explain."""
    if max(np.ptp(path.t), np.ptp(imu.t)) > LONGEST:
        return NO_OFFSET
    lags = _peaks(*_shares(imu, path))
    if not lags:
        return NO_OFFSET
    tried = [_looked_at(imu, path, lag) for lag in lags]
    best = min(tried, key=lambda each: each.unexplained)
    smaller = [each.unexplained for each in tried if abs(each.lag) < abs(best.lag)]
    at = path.t - best.lag
    together = (at > imu.t[0]) & (at < imu.t[-1]) & (path.speed > MIN_SPEED)
    blocks = float(np.mean(together) * np.ptp(path.t)) / BLOCK
    likelier = 0.5 * blocks * math.log(min(smaller, default=1.0) / max(best.unexplained, 1e-9))
    return ClockOffset(DELAY - best.lag, best.unexplained < 1.0 - EXPLAINED and likelier > CLEARLY)


def without_offset(session: Session, found: ClockOffset) -> Session:
    """Return the session with the times of its samples on the clock of the fixes."""
    return with_samples_at(session, lambda t: np.asarray(t - found.offset))


def offset_problems(found: ClockOffset) -> tuple[Problem, ...]:
    """Say so where an offset was taken out."""
    if not found.is_found:
        return ()
    text = (
        f"the samples' clock is {abs(found.offset):.1f} s {'ahead of' if found.offset > 0.0 else 'behind'} that of the "
        "fixes; taken out, so that times are those of the fixes and delays are what is left"
    )
    return (Problem(CLOCK_OFFSET, text),)


@dataclass(frozen=True)
class _LookedAt:
    """Fixes come `lag` s after the samples; the share of rate and force that stays unexplained."""

    lag: float
    unexplained: float


def _looked_at(imu: ImuSamples, path: PathMotion, lag: float) -> _LookedAt:
    """Look at the delays closest to `lag` s as a session of one clock is."""
    shift = lag - DELAY
    found = align(replace(imu, t=imu.t + shift), path)
    return _LookedAt(found.lag + shift, 1.0 if found.is_level_only else 1.0 - found.share_explained)


def _shares(imu: ImuSamples, path: PathMotion) -> tuple[Array, Array]:
    """Delays (L,) s of the fixes behind the samples, and the share (L,) of what was felt that the path then explains.

    Delays at which too little is in both have a share of 0. Fits are least squares, the path's axes taken to be
    independent of one another.
    """
    t_path, t_felt = (np.arange(t[0], t[-1], STEP) for t in (path.t, imu.t))
    axes = path_axes(path)
    driven = np.interp(t_path, path.t, (path.speed > MIN_SPEED).astype(np.float64)) > 0.99
    told = np.stack([np.interp(t_path, path.t, axes[:, i]) for i in range(3)])
    told = (told - told[:, driven].mean(axis=1, keepdims=True)) * driven if driven.any() else told
    felt = np.concatenate(averages_of(imu).around(t_felt, WINDOW), axis=1).T
    felt = felt - np.median(felt, axis=1, keepdims=True)
    size = 1 << (len(t_path) + len(t_felt) - 1).bit_length()

    def spectrum(values: Array) -> Array:
        return np.asarray(np.fft.rfft(values, size))

    def correlated(left: Array, right: Array) -> Array:
        return np.asarray(np.fft.irfft(left * np.conj(right), size))

    of_mask, of_felt = spectrum(driven.astype(np.float64)), spectrum(felt)
    of_one, of_told, of_power = spectrum(np.ones(len(t_felt))), spectrum(told), spectrum(felt**2)
    count = correlated(of_mask, of_one)
    mean = correlated(of_mask, of_felt) / np.maximum(count, 1.0)
    spread = np.maximum(correlated(of_mask, of_power) - count * mean**2, 1e-9)
    power = correlated(spectrum(told**2), of_one)
    about = correlated(of_told, of_one)
    scatter = power - about**2 / np.maximum(count, 1.0)
    share = np.zeros(size)
    for sensor, axis_rows in ((slice(3, 6), (2,)), (slice(0, 3), (0, 1))):
        explained = np.zeros(size)
        for axis in axis_rows:
            covariance = correlated(of_told[axis], of_felt[sensor]) - about[axis] * mean[sensor]
            explained += np.sum(covariance**2, axis=0) / np.maximum(scatter[axis], 1e-9)
        share += 0.5 * explained / np.sum(spread[sensor], axis=0)
    k = np.arange(size)
    k = np.where(k < len(t_path), k, k - size)
    needed = max(SHORTEST, LEAST_SHARED * STEP * np.count_nonzero(driven))
    share = np.where(count * STEP >= needed, share, 0.0)
    order = np.argsort(k)
    return t_path[0] - t_felt[0] + STEP * k[order], share[order]


def _peaks(lags: Array, share: Array) -> list[float]:
    """Where share (L,) over lags (L,) s has its highest peaks, APART from one another; the highest first."""
    rest = share.copy()
    found: list[float] = []
    while len(found) < PEAKS and np.max(rest) > 0.0:
        at = int(np.argmax(rest))
        found.append(float(lags[at]))
        rest[np.abs(lags - lags[at]) < APART] = 0.0
    return found
