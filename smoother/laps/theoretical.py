"""The theoretical best: the sum over sectors of the least true time, from noisy times.

The least of several noisy times is below the least of the true ones, so the sum of the best sectors is biased. Sectors
cannot be corrected one by one, because the error of a crossing enters two of them with opposite signs; so all
crossings of all laps are treated jointly. The error common to all passages of a line only moves that line: it cancels
in every difference and around the lap.

True times of a sector are assumed normal about their mean with an unknown spread. Given the measured times and the
covariance of their errors, true times are sampled; each sample has its own least times and their sum. Source: Gelman et
al., Bayesian Data Analysis, 5.4, with known and correlated errors; samples by Matheron's rule.
"""

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.fit.plan_path import PlanPath
from smoother.laps.results import Lap, Line
from smoother.laps.sigma import Crossed, time_covariance
from smoother.laps.timing import forward_normal
from smoother.trajectory import JointPosition

LEAST_SPREAD, MOST_SPREAD = 0.03, 30.0  # times that: range of the spread
SPREADS, SAMPLES = (
    24,
    32,
)  # values of the spreads, and samples for each: enough for a thirtieth of sigma
SLOW, SLOW_SIGMAS = (
    2.0,
    3.0,
)  # times best to median, and sigmas of noise, above the median: a slowed lap
GRID = 60  # spreads at which their likelihood is taken
SAME = 1e-6  # s; sums of the same times may differ by rounding
SEED = 1  # for reproducible results


def theoretical_best(
    laps: list[Lap], gates: tuple[Line, ...], path: PlanPath, errors: JointPosition | None
) -> tuple[float, float, float]:
    """Return the theoretical best of laps that count, its sigma, and the plain sum of the best sectors, s; NaN unknown.

    gates (S + 1,): start, ends of the sectors, finish. Never above the best lap nor below the plain sum. Where all best
    sectors belong to one lap, the result is that lap with its sigma. One lap alone has none.
    """
    whole = [lap for lap in laps if len(lap.sector_time) == len(gates) - 1 and np.isfinite(lap.sector_time).all()]
    if len(whole) < 2:
        return np.nan, np.nan, np.nan
    times = np.stack([lap.sector_time for lap in whole])
    best = min(whole, key=lambda lap: lap.time)
    raw = float(times.min(axis=0).sum())
    if errors is None or raw >= best.time - SAME:
        return raw, best.sigma if raw >= best.time - SAME else np.nan, raw
    chosen = candidates(times)
    ends = np.array([np.append(whole[i].start, whole[i].start + np.cumsum(times[i])) for i in chosen]).ravel()
    crossed = Crossed(ends, np.tile([forward_normal(gate) for gate in gates], (len(chosen), 1)), path.at(ends)[1])
    covariance = time_covariance(errors, crossed)
    least, sigma = least_sum(times, chosen, covariance, crossed.closing, is_closed=gates[0] is gates[-1])
    value = min(max(least, raw), best.time)
    return value, float(np.hypot(sigma, least - value)), raw


def candidates(sector_time: Array) -> IntArray:
    """Return the laps of `sector_time` (L, S) s, all known, that may contain a best sector: all, of many the
    quickest."""
    rank = np.argsort(np.argsort(sector_time, axis=0, kind="stable"), axis=0).min(axis=1)
    # laps that may contain a best sector; slower ones only contribute to the spread
    quickest = np.lexsort((sector_time.sum(axis=1), rank))[:12]
    return np.sort(quickest)


def least_sum(
    sector_time: Array, chosen: IntArray, covariance: Array, closing: Array, *, is_closed: bool
) -> tuple[float, float]:
    """Return the sum over sectors of the least true time, s, and its sigma, s, without limits.

    sector_time (L, S) s of all laps; covariance (m, m) s^2 of the crossing times of the `chosen` (C,) of them and the
    speeds closing (m,) m/s at which the lines were passed, lap by lap, each from start to finish: m = C * (S + 1).
    is_closed: the finish is the start line.
    """
    noise, shared = _parts(covariance, closing, len(chosen), sector_time.shape[1], is_closed)
    least = _true_times(sector_time, chosen, noise).min(axis=1).sum(axis=1)
    return float(least.mean()), float(np.hypot(least.std(), np.sqrt(shared)))


def _parts(covariance: Array, closing: Array, laps: int, sectors: int, is_closed: bool) -> tuple[Array, float]:
    """Covariance (laps * sectors, same) s^2 of sector times between lines moved by the common error of their passages,
    and the variance s^2 that this common part leaves in the time from start to finish."""
    line = np.tile(np.arange(sectors + 1), laps)
    if is_closed:
        line[line == sectors] = 0
    of_line = line[:, None] == line[None, :]
    common = (of_line / of_line.sum(axis=1)) * (closing[None, :] / closing[:, None])  # in metres, then in time
    sector = np.kron(np.eye(laps), np.diff(np.eye(sectors + 1), axis=0))
    weights = sector @ (np.eye(len(line)) - common)
    whole = np.zeros(len(line)) if is_closed else sector.sum(axis=0) @ common / laps
    return weights @ covariance @ weights.T, float(max(whole @ covariance @ whole, 0.0))


def _true_times(sector_time: Array, chosen: IntArray, noise: Array) -> Array:
    """Samples (K, C, S) s of the true times of the chosen laps."""
    rng = np.random.default_rng(SEED)
    laps, sectors = len(chosen), sector_time.shape[1]
    variance = np.diag(noise).reshape(laps, sectors).sum(axis=0) / max(laps - 1, 1)
    is_slow = slowed(sector_time, np.sqrt(variance))
    spread = np.stack(
        [rng.permutation(spreads(t[~slow], v)) for t, slow, v in zip(sector_time.T, is_slow.T, variance, strict=True)],
        axis=1,
    )
    usual = np.where(is_slow, np.nan, sector_time)
    mean, count = np.nanmean(usual, axis=0), np.count_nonzero(~is_slow, axis=0)
    seen, held_up = sector_time[chosen], is_slow[chosen]
    expected = mean + rng.standard_normal((SPREADS, SAMPLES, sectors)) * (spread / np.sqrt(count))[:, None, :]
    # a slowed lap is no sample of the usual times, and these must not shrink it and its other sectors
    prior = np.where(held_up, (seen - mean) ** 2, spread[:, None, :] ** 2)
    drawn = rng.standard_normal((2, SPREADS, SAMPLES, laps, sectors))
    wanted = expected[:, :, None, :] + np.sqrt(prior)[:, None] * drawn[0]
    values, vectors = np.linalg.eigh(noise)
    error = (drawn[1].reshape(SPREADS, SAMPLES, -1) * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    prior = prior.reshape(SPREADS, -1)
    total = (vectors * np.maximum(values, 0.0)) @ vectors.T + prior[:, :, None] * np.eye(laps * sectors)
    missed = seen.ravel() - wanted.reshape(SPREADS, SAMPLES, -1) - error
    moved = prior[:, :, None] * np.linalg.solve(total, np.swapaxes(missed, 1, 2))
    return np.asarray((wanted + np.swapaxes(moved, 1, 2).reshape(wanted.shape)).reshape(-1, laps, sectors))


def slowed(sector_time: Array, noise: Array) -> BoolArray:
    """Mask (L, S) of times (L, S) far above the others, slowed by a mistake or traffic; noise (S,) s of timing."""
    median = np.median(sector_time, axis=0)
    usual = SLOW * (median - sector_time.min(axis=0)) + SLOW_SIGMAS * noise
    return np.asarray(sector_time > median + usual)


def spreads(seen: Array, noise: float) -> Array:
    """Values (SPREADS,) s, quantiles of the posterior of the spread of true times given the `seen` (K,) s, whose
    errors have the variance `noise` s^2."""
    scale = 0.01 * float(seen.mean())  # of a sector's time: scale of the half-Cauchy prior of the spread
    spread = scale * np.geomspace(LEAST_SPREAD, MOST_SPREAD, GRID)
    total = spread**2 + noise
    squares = float(np.sum((seen - seen.mean()) ** 2))
    log = -0.5 * (len(seen) - 1) * np.log(total) - 0.5 * squares / total
    weight = np.exp(log - log.max()) / (1.0 + (spread / scale) ** 2) * spread  # in steps of the logarithm
    share = np.cumsum(weight) - 0.5 * weight
    return np.asarray(np.interp((np.arange(SPREADS) + 0.5) / SPREADS, share / weight.sum(), spread))
