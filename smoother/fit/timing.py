"""Rate, jitter, gaps, clipping and vibration of samples, and the latency of a magnetometer.

The time base itself (what is jitter and what a gap) is that of :mod:`smoother.session.clock`, as for every session.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import welch

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.fit.ellipsoid import FitError
from smoother.session.clock import find_gaps, regularize

LEAST_OF_SPECTRUM = 256  # samples
LARGEST_DELAY = 0.25  # s, that is looked for between gyroscope and magnetometer
SPACING = 0.06  # s between two readings that are compared: a change beyond noise and rounding, still a small turn
OUTLIER = 6.0  # times the median size


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


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided power density (F, D), unit^2/Hz, of D columns at frequency (F,) Hz."""

    frequency: Array
    density: Array

    def rms(self, low: float = 0.0, high: float = np.inf) -> Array:
        """Root mean square (D,) of what lies between two frequencies, Hz."""
        inside = (self.frequency >= low) & (self.frequency <= high)
        step = float(self.frequency[1] - self.frequency[0])
        return np.asarray(np.sqrt(np.sum(self.density[inside], axis=0) * step))


@dataclass(frozen=True, eq=False)
class Against:
    """A magnetometer against a gyroscope: delay s of its stamps; turn (3,) rad, such that `exp(turn) @ field` is in the
    gyroscope's axes; one sigma of each, and over how many readings.
    """

    delay: float
    delay_sigma: float
    turn: Array
    turn_sigma: Array
    count: int


def sample_timing(t: Array) -> Timing:
    """Rate, jitter and gaps of stamps t (N,) s, strictly increasing. Raises FitError for fewer than 32."""
    if len(t) < 32:
        raise FitError(f"{len(t)} samples are too few to tell their rate")
    base = regularize(t)
    steps = np.diff(base.t)
    holes = find_gaps(base)
    lost = float(np.sum(steps[holes]) - np.count_nonzero(holes) * base.period)
    period, lever = _common_slope(np.split(t, np.flatnonzero(holes) + 1))
    sigma = base.jitter / np.sqrt(lever) / period**2
    longest = float(np.max(steps[holes], initial=0.0))
    return Timing(1.0 / period, sigma, base.jitter, int(np.count_nonzero(holes)), longest, lost, base.is_steady)


def _common_slope(stretches: list[Array]) -> tuple[float, float]:
    """Least-squares slope per row of parallel lines through stretches (N,) of values, and the sum of squared rows."""
    rows = [np.arange(len(values)) - 0.5 * (len(values) - 1) for values in stretches]
    lever = float(sum(row @ row for row in rows))
    return sum(float(row @ (values - values[0])) for row, values in zip(rows, stretches, strict=True)) / lever, lever


def vibration_spectrum(values: Array, rate: float) -> Spectrum:
    """Welch's estimate of values (N, D), evenly sampled at `rate` Hz, by parts of a second.

    An engine at 6,000 to 16,000 rpm vibrates at 100 to 270 Hz and multiples of it; frequencies above half the rate are
    aliased. Raises FitError for too few values, or some that are not finite.
    """
    values = np.asarray(values, dtype=np.float64)
    if len(values) < LEAST_OF_SPECTRUM:
        raise FitError(f"{len(values)} samples are too few for a spectrum; record for some seconds")
    if not np.all(np.isfinite(values)):
        raise FitError("some readings are not finite numbers; drop those rows first")
    size = min(len(values), max(LEAST_OF_SPECTRUM, round(rate)))
    frequency, density = welch(values, rate, nperseg=size, axis=0)
    return Spectrum(np.asarray(frequency), np.asarray(density))


def clipped_share(values: Array, full_scale: float | None = None) -> Array:
    """Share (D,) of the readings (N, D) of each axis at the end of its range.

    Without the full scale (in the unit of the values), of the readings in runs that repeat the axis' own extreme.
    """
    if full_scale is not None:
        return np.asarray(np.mean(np.abs(values) >= 0.995 * full_scale, axis=0))  # of the full scale
    # equal readings at an axis' extreme that noise does not make, for a sensor whose range is not known
    if len(values) < 3:
        return np.zeros(values.shape[1])
    at_end = (values == values.max(axis=0)) | (values == values.min(axis=0))
    same = at_end[1:] & (values[1:] == values[:-1])
    runs = same[1:] & same[:-1]
    moves = np.ptp(values, axis=0) > 0.0
    return np.asarray(np.where(moves, np.mean(runs, axis=0), 0.0))


def magnetometer_against_gyro(t: Array, angular_rate: Array, field_t: Array, field: Array) -> Against:
    """Delay and turned axes of calibrated field (M, 3) at field_t (M,) s, against angular_rate (N, 3) rad/s at t (N,).

    The field stands still in space, so between near readings it turns back by what the gyroscope turned; the shift of
    the stamps and the turn of the axes with the least sum of squares are sought. Readings whose length is odd, and
    changes that fit nothing, are left out.
    Raises FitError when the sensor was hardly turned, or the two disagree whatever the delay.
    """
    good = _of_usual_length(field)
    changes = _Changes.of(t, angular_rate, field_t[good], field[good])
    shifts = np.linspace(-LARGEST_DELAY, LARGEST_DELAY, 101)
    cost = [float(np.median(np.sum(changes.residual(np.array([s, 0.0, 0.0, 0.0])) ** 2, axis=1))) for s in shifts]
    x = np.array([shifts[int(np.argmin(cost))], 0.0, 0.0, 0.0])
    for _ in range(10):
        residual = changes.residual(x)
        size = np.linalg.norm(residual, axis=1)
        used = size < OUTLIER * np.median(size)
        J = so3.numerical_jacobian(lambda y: changes.residual(y).ravel(), x, 1e-4).reshape(*residual.shape, 4)
        normal = np.einsum("kia,kib->ab", J[used], J[used])
        step = np.linalg.solve(normal, -np.einsum("kia,ki->a", J[used], residual[used]))
        x = x + step
        if np.max(np.abs(step)) < 1e-9:
            break
    still = float(np.sum(changes.change[used] ** 2))
    if (
        abs(x[0]) > LARGEST_DELAY
        or np.linalg.norm(x[1:]) > 0.3  # rad; beyond, the axes are not those of the gyroscope at all
        # of the squared change; axes that do not belong together leave more than all of it
        or np.sum(residual[used] ** 2) > 0.7 * still
    ):
        raise FitError("the field does not turn as the gyroscope says; are both in the same axes?")
    sigma = changes.sigma(J[used], residual[used], used, x, normal)
    return Against(float(x[0]), float(sigma[0]), x[1:], sigma[1:], int(used.sum()))


def _of_usual_length(field: Array) -> BoolArray:
    length = np.linalg.norm(field, axis=1)
    off = np.abs(length - np.median(length))
    return np.asarray(off <= OUTLIER * max(float(np.median(off)), 1e-9))


@dataclass(frozen=True, eq=False)
class _Changes:
    """Pairs of readings of a field while it turned: start, end (K,) s, change and mean (K, 3); first, first + stride.

    turned (N, 3): the integral of the angular rate until t (N,), exact there, because a sample is the mean over the
    interval that ends at its time.
    """

    start: Array
    end: Array
    change: Array
    mean: Array
    first: IntArray
    stride: int
    t: Array
    turned: Array

    @staticmethod
    def of(t: Array, rate: Array, field_t: Array, field: Array) -> "_Changes":
        turned = np.concatenate([np.zeros((1, 3)), np.cumsum(rate[1:] * np.diff(t)[:, None], axis=0)])
        stride = max(1, round(SPACING / float(np.median(np.diff(field_t)))))
        start, end = field_t[:-stride], field_t[stride:]
        step = end - start
        inside = (start > t[0] + LARGEST_DELAY) & (end < t[-1] - LARGEST_DELAY) & (step < 1.5 * np.median(step))
        speed = np.linalg.norm(_between(start, end, t, turned), axis=1) / step
        chosen = np.flatnonzero(inside & (speed > 0.5))  # rad/s
        if len(chosen) < 200:  # readings while turning, for a delay
            raise FitError("the logger was hardly turned, so no delay between gyroscope and magnetometer can be seen")
        change, mean = field[stride:] - field[:-stride], 0.5 * (field[stride:] + field[:-stride])
        return _Changes(start[chosen], end[chosen], change[chosen], mean[chosen], chosen, stride, t, turned)

    def turns(self, x: Array) -> Array:
        """Angle turned (K, 3) in the magnetometer's axes, by delay x[0] and turn x[1:]."""
        return np.asarray(_between(self.start - x[0], self.end - x[0], self.t, self.turned) @ so3.exp(x[1:]))

    def residual(self, x: Array) -> Array:
        """What the field changed more than it was turned, (K, 3)."""
        return np.asarray(self.change + np.cross(self.turns(x), self.mean))

    def sigma(self, J: Array, residual: Array, used: BoolArray, x: Array, normal: Array) -> Array:
        """Sigmas (4,) when readings have white noise, which enters one change with plus and the next with minus."""
        turn, first = self.turns(x)[used], self.first[used]
        weight = np.zeros((int(self.first[-1]) + self.stride + 1, 3, 4))
        for a in range(4):
            across = 0.5 * np.cross(J[:, :, a], turn)
            np.add.at(weight[:, :, a], first, across - J[:, :, a])
            np.add.at(weight[:, :, a], first + self.stride, across + J[:, :, a])
        noise = float(np.mean(residual**2)) / 2.0
        inverse = np.linalg.inv(normal)
        covariance = noise * inverse @ np.einsum("kia,kib->ab", weight, weight) @ inverse
        return np.asarray(np.sqrt(np.diagonal(covariance)))


def _between(start: Array, end: Array, t: Array, turned: Array) -> Array:
    both = [np.stack([np.interp(at, t, turned[:, i]) for i in range(3)], axis=1) for at in (start, end)]
    return np.asarray(both[1] - both[0])
