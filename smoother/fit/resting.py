"""Resting positions in a recording: where the logger lay still, and the mean readings there with their covariances.

Readings at rest are not independent (a low-pass filter, a bias that drifts), and coarse counts do not average out. So
the covariance of a mean comes from the scatter of means over batches of `BATCH` seconds, pooled over all positions,
and what rounding can hide is added.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.ellipsoid import FitError
from smoother.fit.standstill import standstill_intervals

EDGE = 0.4  # s left out at either end: the hand is still there, or again
BATCH = 0.5  # s; longer than the correlation of any low-pass filter in such sensors
SHORTEST = 2.0  # s, of a position without its edges
SAME_DIRECTION = np.radians(20.0)
HARMONICS = 30  # of the error of rounding: those beyond are a fiftieth of it, where there is no noise at all


@dataclass(frozen=True, eq=False)
class RestingPosition:
    """One stretch at rest: start, end s; mean force (3,) m/s^2 and rate (3,) rad/s; count of readings.

    force_covariance, rate_covariance (3, 3) are those of the means; temperature deg C, NaN unknown.
    """

    start: float
    end: float
    force: Array
    rate: Array
    force_covariance: Array
    rate_covariance: Array
    count: int
    temperature: float = float("nan")


def resting_positions(
    t: Array, force: Array, rate: Array, is_at_rest: BoolArray, temperature: Array | None = None
) -> tuple[RestingPosition, ...]:
    """Means of force (N, 3) m/s^2 and rate (N, 3) rad/s over each stretch of is_at_rest (N,); temperature (N,) deg C.

    Stretches shorter than SHORTEST without their edges are passed over.
    """
    stretches = []
    for start, end in standstill_intervals(t, is_at_rest):
        i, j = np.searchsorted(t, [start + EDGE, end - EDGE])
        if j > i and t[j - 1] - t[i] >= SHORTEST:
            stretches.append((int(i), int(j)))
    if not stretches:
        return ()
    force_noise = _covariance_of_means(t, force, stretches)
    rate_noise = _covariance_of_means(t, rate, stretches)
    force_step, rate_step = rounding_step(force), rounding_step(rate)
    found = []
    for i, j in stretches:
        length = float(t[j - 1] - t[i])
        warmth = float("nan") if temperature is None else float(np.mean(temperature[i:j]))
        found.append(
            RestingPosition(
                start=float(t[i]),
                end=float(t[j - 1]),
                force=force[i:j].mean(axis=0),
                rate=rate[i:j].mean(axis=0),
                force_covariance=force_noise / length + np.diag(rounding_variance(force[i:j], force_step)),
                rate_covariance=rate_noise / length + np.diag(rounding_variance(rate[i:j], rate_step)),
                count=j - i,
                temperature=warmth,
            )
        )
    return tuple(found)


def batch_means(t: Array, values: Array, length: float = BATCH) -> tuple[Array, Array]:
    """Middle times (B,) and means (B, D) of values (N, D) over whole batches of `length` seconds."""
    batch = np.floor((t - t[0]) / length).astype(np.int64)
    batch = np.cumsum(np.concatenate([[0], np.diff(batch) > 0]))
    count = np.bincount(batch).astype(np.float64)
    whole = count >= 0.7 * np.max(count)
    sums = np.stack([np.bincount(batch, values[:, i]) for i in range(values.shape[1])], axis=1)
    times = np.bincount(batch, t - t[0]) / count
    return (t[0] + times)[whole], (sums / count[:, None])[whole]


def _covariance_of_means(t: Array, values: Array, stretches: list[tuple[int, int]]) -> Array:
    """Covariance (3, 3) times seconds: divided by a length it is that of a mean over it. Pooled over the stretches."""
    scatter, freedom = np.zeros((3, 3)), 0
    for i, j in stretches:
        _, means = batch_means(t[i:j], values[i:j])
        centred = means - means.mean(axis=0)
        scatter += centred.T @ centred
        freedom += len(means) - 1
    if freedom < 4:
        raise FitError("the logger lay still too briefly; let it lie for ten seconds in each position")
    return scatter / freedom * BATCH


def rounding_step(values: Array) -> Array:
    """Size (D,) of a count in values (N, D): the least difference between different readings; 0 if all are alike."""
    some = values[:: max(1, len(values) // 20_000)]  # readings by which the size of a count is judged
    levels = [np.unique(column) for column in some.T]
    return np.array([float(np.min(np.diff(level))) if len(level) > 1 else 0.0 for level in levels])


def rounding_variance(values: Array, step: Array) -> Array:
    """Variance (D,) that rounding to `step` (D,) leaves in the mean of values (N, D), however many they are.

    Noise smaller than a count hides what lies between two counts. Source: Widrow and Kollar, Quantization Noise: the
    harmonics of the error of a rounded Gaussian; without noise they add up to a twelfth.
    """
    spread = np.maximum(np.var(values, axis=0) - step**2 / 12.0, 0.0)
    k = np.arange(1.0, HARMONICS + 1.0)[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        hidden = np.sum(np.exp(-4.0 * (np.pi * k) ** 2 * spread / step**2) / (2.0 * (np.pi * k) ** 2), axis=0)
    return np.asarray(np.where(step > 0.0, step**2 * hidden, 0.0))


def distinct_directions(force: Array) -> Array:
    """Directions (D, 3) of the mean forces (K, 3) that lie more than SAME_DIRECTION apart, first come first kept."""
    kept: list[Array] = []
    known = force[np.any(force != 0.0, axis=1)]  # a sensor that reads zeros points nowhere
    for unit in known / np.linalg.norm(known, axis=1, keepdims=True):
        if all(unit @ other < np.cos(SAME_DIRECTION) for other in kept):
            kept.append(unit)
    return np.array(kept)
