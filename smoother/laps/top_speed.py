"""Top speed: the highest of many peaks that are each a little wrong lies above the true one.

The highest row of a noisy speed is the luckiest of a straight's, and the highest straight the luckiest of a session's.
Speed is therefore steadied over a moment, and peaks that may be equally high are drawn to their mean as far as their
scatter is no more than their noise: those of an even driver nearly all the way, one that is high for a reason hardly.
Source: the hierarchical normal model with a half-Cauchy prior of the spread, Gelman, 2006.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.fit.running import local_polynomial
from smoother.laps.results import LapAnalysis
from smoother.trajectory import Trajectory

STEADIED_OVER = 0.6  # s; beyond, the tip before the brakes is blunted
APART = 10.0  # s; of so long only the highest peak counts: there is hardly more than one straight in it
ALIKE = 3.0  # sigmas below the surest of the highest up to which a peak may be as high
SPREADS = 64  # of tops between laps or straights that are tried
SURE_SPEED = 0.1  # of a speed: one that is less sure than that and than others is an error of the fixes


@dataclass(frozen=True)
class TopSpeed:
    """Highest speed m/s of a session, and its sigma m/s, NaN where the estimator gives none."""

    speed: float
    sigma: float


def top_speed(estimate: Trajectory, laps: LapAnalysis | None = None) -> TopSpeed:
    """Return the top speed of a session, of the rows as sure as most of it or to a tenth of themselves.

    Where the top of a lap may be the same, that is it: two figures for one straight tell nobody anything.
    """
    fastest = _top_speed(estimate)
    highest = (
        max((lap.top_speed for lap in laps.laps if np.isfinite(lap.top_speed)), default=np.inf) if laps else np.inf
    )
    return replace(fastest, speed=highest) if abs(highest - fastest.speed) < fastest.sigma else fastest


def _top_speed(estimate: Trajectory) -> TopSpeed:
    speed, sigma = steadied(estimate.speed, estimate.t), speed_sigma(estimate)
    sure = sure_rows(speed, sigma)
    if not sure.any():
        return TopSpeed(float(speed.max()), np.nan)
    peaks = _peaks(np.where(sure, speed, -np.inf), estimate.t)
    if not np.isfinite(sigma).any():
        return TopSpeed(float(speed[peaks].max()), np.nan)
    likely = likely_tops(speed[peaks], sigma[peaks])
    alike = _alike(speed[peaks], sigma[peaks])
    return TopSpeed(float(likely.max()), float(np.sqrt(1.0 / np.mean(1.0 / sigma[peaks][alike] ** 2))))


def speed_sigma(estimate: Trajectory) -> Array:
    """Return the sigma (N,) m/s of the speed, NaN where the estimator gives none."""
    return np.full(len(estimate), np.nan) if estimate.sigmas is None else estimate.sigmas.speed


def sure_rows(speed: Array, sigma: Array) -> BoolArray:
    """Mask (N,) of speeds as sure as most, or to a tenth of themselves; all where nothing is known of that."""
    if not np.isfinite(sigma).any():
        return np.ones(len(speed), dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        return np.asarray(sigma <= np.maximum(SURE_SPEED * speed, 2.0 * float(np.nanmedian(sigma))))


def steadied(speed: Array, t: Array) -> Array:
    """Return speed (N,) by the parabola through the rows around each."""
    window = 2 * int(0.5 * STEADIED_OVER / median(np.diff(t))) + 1 if len(t) > 1 else 1
    return local_polynomial(speed, window, 2) if 3 < window <= len(speed) else speed


def likely_tops(speed: Array, sigma: Array) -> Array:
    """Return top speeds (K,) m/s, those that may be the highest drawn to their mean as far as noise explains their
    scatter; the others, and all without a sigma, stay."""
    alike = _alike(speed, sigma)
    if np.count_nonzero(alike) < 2:
        return speed
    out = speed.copy()
    out[alike] = _shrunk(speed[alike], sigma[alike])
    return out


def _shrunk(seen: Array, sigma: Array) -> Array:
    """Return the posterior mean (K,) of normal means seen with noise sigma (K,), of one mean and unknown spread.

    The most likely spread is often 0, which would make all tops of an even driver one and the same figure: the doubt
    of it counts too. Spreads are quantiles of its prior, a half-Cauchy distribution of the noise's own size.
    """
    spread = median(sigma) * np.tan(0.5 * np.pi * (np.arange(SPREADS) + 0.5) / SPREADS)
    variance = spread[:, None] ** 2 + sigma**2  # (S, K)
    weight = 1.0 / variance
    mean = (weight @ seen) / weight.sum(axis=1)
    apart = seen - mean[:, None]
    log_likely = -0.5 * (np.log(variance).sum(axis=1) + np.log(weight.sum(axis=1)) + (weight * apart**2).sum(axis=1))
    likely = np.exp(log_likely - log_likely.max())
    drawn = mean[:, None] + spread[:, None] ** 2 * weight * apart
    return np.asarray(likely @ drawn / likely.sum())


def _alike(speed: Array, sigma: Array) -> BoolArray:
    """Mask of peaks that may be as high as the highest: as that which is surely high."""
    known = np.isfinite(speed) & np.isfinite(sigma) & (sigma > 0.0)
    if not known.any():
        return known
    surest = int(np.argmax(np.where(known, speed - sigma, -np.inf)))
    with np.errstate(invalid="ignore"):
        return np.asarray(known & (speed > speed[surest] - ALIKE * sigma[surest]))


def _peaks(speed: Array, t: Array) -> IntArray:
    """Rows of the highest speed of every APART s that is a peak, not the slope to a higher one; -inf is none."""
    beside = np.concatenate([[-np.inf], speed, [-np.inf]])
    is_peak = (speed >= beside[:-2]) & (speed >= beside[2:]) & np.isfinite(speed)
    block = ((t - t[0]) // APART).astype(np.int64)
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    ends = np.append(starts[1:], len(t))
    highest = np.array([a + int(np.argmax(speed[a:b])) for a, b in zip(starts, ends, strict=True)])
    return np.asarray(highest[is_peak[highest]], dtype=np.int64)
