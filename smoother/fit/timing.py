"""When samples came, and which of them hit the end of the range: rate, jitter, gaps, clipping, delay of a compass.

The time base itself (what is jitter and what a gap) is that of :mod:`smoother.session.clock`, as for every session.
"""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.fit.ellipsoid import FitError
from smoother.session.clock import find_gaps, regularize

FEWEST_STAMPS = 32
AT_THE_END = 0.995  # of the full scale
RUN = 3  # equal readings at an axis' extreme that noise does not make, for a sensor whose range is not known
LARGEST_DELAY = 0.25  # s, that is looked for between gyroscope and magnetometer
FEWEST_TURNING = 200  # readings while turning, for a delay
TURNING = 0.5  # rad/s


@dataclass(frozen=True)
class Timing:
    """rate Hz and its sigma; jitter: rms of the stamps about even ones, s; gaps: how many; longest, lost: s; steady."""

    rate: float
    rate_sigma: float
    jitter: float
    gaps: int
    longest_gap: float
    lost: float
    is_steady: bool


@dataclass(frozen=True)
class Delay:
    """By how many seconds one sensor's stamps are late against another's, one sigma, and over how many readings."""

    value: float
    sigma: float
    count: int


def sample_timing(t: Array) -> Timing:
    """Rate, jitter and gaps of stamps t (N,) s, strictly increasing. Raises FitError for fewer than 32."""
    if len(t) < FEWEST_STAMPS:
        raise FitError(f"{len(t)} samples are too few to tell their rate")
    base = regularize(t)
    steps = np.diff(base.t)
    holes = find_gaps(base)
    lost = float(np.sum(steps[holes]) - np.count_nonzero(holes) * base.period)
    period = (base.t[-1] - base.t[0] - lost) / (len(t) - 1)
    # A straight line through N jittered stamps; its slope is this well known (least squares).
    sigma = np.sqrt(12.0 / len(t) ** 3) * base.jitter / period**2
    longest = float(np.max(steps[holes], initial=0.0))
    return Timing(1.0 / period, sigma, base.jitter, int(np.count_nonzero(holes)), longest, lost, base.is_steady)


def clipped_share(values: Array, full_scale: float | None = None) -> Array:
    """Share (D,) of the readings (N, D) of each axis at the end of its range.

    Without the full scale (in the unit of the values), of the readings in runs that repeat the axis' own extreme.
    """
    if full_scale is not None:
        return np.asarray(np.mean(np.abs(values) >= AT_THE_END * full_scale, axis=0))
    if len(values) < RUN:
        return np.zeros(values.shape[1])
    at_end = (values == values.max(axis=0)) | (values == values.min(axis=0))
    same = at_end[1:] & (values[1:] == values[:-1])
    runs = same[1:] & same[:-1]
    moves = np.ptp(values, axis=0) > 0.0
    return np.asarray(np.where(moves, np.mean(runs, axis=0), 0.0))


def magnetometer_delay(t: Array, angular_rate: Array, field_t: Array, field: Array) -> Delay:
    """Delay of calibrated field (M, 3) at field_t (M,) s against angular_rate (N, 3) rad/s at t (N,), axes s of both.

    The field stands still in space, so between two readings it turns back by what the gyroscope turned. Its change is
    compared with that turn for shifted stamps, and the least sum of squares is the delay.
    Raises FitError when the sensor was hardly turned, or the two disagree whatever the delay.
    """
    near = np.diff(field_t) < 3.0 * np.median(np.diff(field_t))
    start, end, change, mean = _field_changes(field_t, field, near)
    turned = np.concatenate([np.zeros((1, 3)), np.cumsum(angular_rate[1:] * np.diff(t)[:, None], axis=0)])

    def turns(delay: float) -> Array:
        """Angle turned (K, 3) while the field changed; a sample is the mean over the interval that ends at its time."""
        both = [np.stack([np.interp(x - delay, t, turned[:, i]) for i in range(3)], axis=1) for x in (start, end)]
        return np.asarray(both[1] - both[0])

    inside = (start > t[0] + LARGEST_DELAY) & (end < t[-1] - LARGEST_DELAY)
    chosen = inside & (np.linalg.norm(turns(0.0), axis=1) > TURNING * (end - start))
    if np.count_nonzero(chosen) < FEWEST_TURNING:
        raise FitError("the box was hardly turned, so no delay between gyroscope and magnetometer can be seen")
    start, end, change, mean = start[chosen], end[chosen], change[chosen], mean[chosen]

    def residual(delay: float) -> Array:
        return np.asarray(change + np.cross(turns(delay), mean))

    shifts = np.linspace(-LARGEST_DELAY, LARGEST_DELAY, 101)
    best = float(shifts[np.argmin([np.sum(residual(shift) ** 2) for shift in shifts])])
    for _ in range(10):
        slope = so3.numerical_jacobian(lambda x: residual(float(x[0])).ravel(), np.array([best]), 1e-3)[:, 0]
        best -= float(slope @ residual(best).ravel()) / float(slope @ slope)
    rest = residual(best)
    if abs(best) > LARGEST_DELAY or np.sum(rest**2) > 0.5 * np.sum(change**2):
        raise FitError("the field does not turn as the gyroscope says; are both in the same axes?")
    sigma = _delay_sigma(slope.reshape(rest.shape), rest, turns(best), np.flatnonzero(near)[chosen])
    return Delay(best, sigma, len(rest))


def _delay_sigma(slope: Array, residual: Array, turn: Array, first: IntArray) -> float:
    """Sigma of the delay when readings have white noise; slope, residual, turn (K, 3), `first` (K,) of two readings.

    Neighbouring changes share a reading, whose noise enters the one with plus and the other with minus.
    """
    across = 0.5 * np.cross(slope, turn)
    weight = np.zeros((int(first[-1]) + 2, 3))
    np.add.at(weight, first, across - slope)
    np.add.at(weight, first + 1, across + slope)
    noise = float(np.mean(residual**2)) / 2.0
    return float(np.sqrt(noise * np.sum(weight**2)) / np.sum(slope**2))


def _field_changes(t: Array, field: Array, near: BoolArray) -> tuple[Array, Array, Array, Array]:
    """Start and end (K,) s of near neighbours among the readings, change (K, 3) and mean (K, 3) between them."""
    mean = 0.5 * (field[1:] + field[:-1])
    return t[:-1][near], t[1:][near], np.diff(field, axis=0)[near], mean[near]
