"""Top speed without selection bias: the highest of many noisy peaks is above the true one.

The speed is smoothed over SMOOTHED_OVER, and peaks that may be equally high are shrunk to their mean as far as noise
explains their scatter: those of an even driver nearly completely, a clearly higher one hardly.
Source: the hierarchical normal model with a half-Cauchy prior of the spread, Gelman, 2006.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.fit.running import local_polynomial
from smoother.laps.results import LapAnalysis
from smoother.trajectory import Trajectory

SMOOTHED_OVER = 0.6  # s; a longer window flattens the peak before braking
SPREADS = 64  # values of the spread between peaks


@dataclass(frozen=True)
class TopSpeed:
    """Highest speed m/s of a session, and its sigma m/s, NaN where the estimator gives none."""

    speed: float
    sigma: float


def top_speed(estimate: Trajectory, laps: LapAnalysis | None = None) -> TopSpeed:
    """Return the top speed of a session, of its reliable rows.

    Where it equals that of a lap within its sigma, it is that of the lap, so that one straight has one value.
    """
    fastest = _top_speed(estimate)
    highest = (
        max((lap.top_speed for lap in laps.laps if np.isfinite(lap.top_speed)), default=np.inf) if laps else np.inf
    )
    return replace(fastest, speed=highest) if abs(highest - fastest.speed) < fastest.sigma else fastest


def _top_speed(estimate: Trajectory) -> TopSpeed:
    speed, sigma = smoothed_speed(estimate.speed, estimate.t), speed_sigma(estimate)
    reliable = reliable_rows(speed, sigma)
    if not reliable.any():
        return TopSpeed(float(speed.max()), np.nan)
    peaks = _peaks(np.where(reliable, speed, -np.inf), estimate.t)
    if not np.isfinite(sigma).any():
        return TopSpeed(float(speed[peaks].max()), np.nan)
    likely = shrunk_tops(speed[peaks], sigma[peaks])
    candidates = _may_be_highest(speed[peaks], sigma[peaks])
    return TopSpeed(float(likely.max()), float(np.sqrt(1.0 / np.mean(1.0 / sigma[peaks][candidates] ** 2))))


def speed_sigma(estimate: Trajectory) -> Array:
    """Return the sigma (N,) m/s of the speed, NaN where the estimator gives none."""
    return np.full(len(estimate), np.nan) if estimate.sigmas is None else estimate.sigmas.speed


def reliable_rows(speed: Array, sigma: Array) -> BoolArray:
    """Mask (N,) of speeds with a sigma below twice the median or a tenth of the speed; all without sigmas."""
    if not np.isfinite(sigma).any():
        return np.ones(len(speed), dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        # of a speed: a larger sigma, also larger than most, is an error of the fixes
        return np.asarray(sigma <= np.maximum(0.1 * speed, 2.0 * float(np.nanmedian(sigma))))


def smoothed_speed(speed: Array, t: Array) -> Array:
    """Return speed (N,) by a local parabola."""
    window = 2 * int(0.5 * SMOOTHED_OVER / median(np.diff(t))) + 1 if len(t) > 1 else 1
    return local_polynomial(speed, window, 2) if 3 < window <= len(speed) else speed


def shrunk_tops(speed: Array, sigma: Array) -> Array:
    """Return top speeds (K,) m/s; those that may be the highest are shrunk to their mean as far as noise explains their
    scatter."""
    candidates = _may_be_highest(speed, sigma)
    if np.count_nonzero(candidates) < 2:
        return speed
    out = speed.copy()
    out[candidates] = _shrunk(speed[candidates], sigma[candidates])
    return out


def _shrunk(seen: Array, sigma: Array) -> Array:
    """Return the posterior mean (K,) of normal means measured with noise sigma (K,), of one mean and unknown spread.

    The most likely spread is often 0, which would make all peaks equal, so the posterior is averaged over the spread.
    Spreads are quantiles of its prior, a half-Cauchy distribution with the scale of the noise.
    """
    spread = median(sigma) * np.tan(0.5 * np.pi * (np.arange(SPREADS) + 0.5) / SPREADS)
    variance = spread[:, None] ** 2 + sigma**2  # (S, K)
    weight = 1.0 / variance
    mean = (weight @ seen) / weight.sum(axis=1)
    deviation = seen - mean[:, None]
    log_likely = -0.5 * (
        np.log(variance).sum(axis=1) + np.log(weight.sum(axis=1)) + (weight * deviation**2).sum(axis=1)
    )
    likely = np.exp(log_likely - log_likely.max())
    drawn = mean[:, None] + spread[:, None] ** 2 * weight * deviation
    return np.asarray(likely @ drawn / likely.sum())


def _may_be_highest(speed: Array, sigma: Array) -> BoolArray:
    """Mask of peaks that may be as high as the reference, the one with the largest speed minus sigma."""
    known = np.isfinite(speed) & np.isfinite(sigma) & (sigma > 0.0)
    if not known.any():
        return known
    reference = int(np.argmax(np.where(known, speed - sigma, -np.inf)))
    with np.errstate(invalid="ignore"):
        # below the reference peak, within which a peak may be as high
        return np.asarray(known & (speed > speed[reference] - 3.0 * sigma[reference]))


def _peaks(speed: Array, t: Array) -> IntArray:
    """Rows of the highest speed of every APART s that is a local maximum; -inf is none."""
    beside = np.concatenate([[-np.inf], speed, [-np.inf]])
    is_peak = (speed >= beside[:-2]) & (speed >= beside[2:]) & np.isfinite(speed)
    block = ((t - t[0]) // 10.0).astype(np.int64)  # s with one peak: there is hardly more than one straight in it
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    ends = np.append(starts[1:], len(t))
    highest = np.array([a + int(np.argmax(speed[a:b])) for a, b in zip(starts, ends, strict=True)])
    return np.asarray(highest[is_peak[highest]], dtype=np.int64)
