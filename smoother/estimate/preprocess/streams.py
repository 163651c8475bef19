"""Samples compared with the path through the fixes, stretch by stretch: lag and gain of force and rate.

A sensor of known mounting measures forward force, left force and yaw rate of the path, `lag` seconds before the path
has them. In each stretch of driving each of the three is fitted by itself,

    measured(t - lag) = gain * path(t) + offset.

Vibration is in the measurement and not in the path: it makes a lag uncertain, but biases neither lag nor gain. Slip,
lean and wheels shift single axes; a shift that all three share is one of clocks."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, IntArray, are_near, median
from smoother.disc import pieces, release, roomy
from smoother.frames import wrap_angle
from smoother.samples import ImuSamples

MIN_SPEED = 3.0  # m/s below which a course says little about the nose
REPORTED_NEAR = 1.0  # s; some receivers tell their velocity less often than their position
LAGS = np.arange(-0.2, 0.81, 0.1)  # s tried for the delay of the fixes; what they explain bends once within WINDOW


@dataclass(frozen=True, eq=False)
class PathMotion:
    """Motion of the kart from the fixes. t (N,) s; velocity_n (N, 3) m/s, Up may be NaN.

    is_measured: whether these are velocities of the receiver, not of a line through its positions. is_reported (N,):
    near a fix that reports one, and no bridge across those that were left out; None where all are.
    """

    t: Array
    velocity_n: Array
    is_measured: bool = True
    is_reported: BoolArray | None = None

    @property
    def speed(self) -> Array:
        """Horizontal speed, (N,) m/s."""
        return np.asarray(np.hypot(self.velocity_n[:, 0], self.velocity_n[:, 1]))

    @property
    def moves(self) -> BoolArray:
        """Mask (N,) of the fixes at which the kart has a course."""
        return np.asarray((self.speed > MIN_SPEED) & (True if self.is_reported is None else self.is_reported))

    @property
    def yaw(self) -> Array:
        """Direction of travel, anticlockwise from north, (N,) rad."""
        return np.arctan2(self.velocity_n[:, 1], self.velocity_n[:, 0])


def near_reported(t: Array, reported: BoolArray) -> BoolArray:
    """Mask (N,) of times t (N,) s near one with a reported value, mask (N,)."""
    return are_near(t, t[reported], REPORTED_NEAR)


def path_axes(path: PathMotion) -> Array:
    """Forward and left acceleration m/s^2 and yaw rate rad/s of the path, (N, 3), averaged over WINDOW."""
    t, dt = path.t, WINDOW / 2.0
    before = np.stack([np.interp(t - dt, t, path.velocity_n[:, i]) for i in range(2)], axis=1)
    after = np.stack([np.interp(t + dt, t, path.velocity_n[:, i]) for i in range(2)], axis=1)
    acceleration = (after - before) / WINDOW
    yaw = path.yaw
    forward = acceleration[:, 0] * np.cos(yaw) + acceleration[:, 1] * np.sin(yaw)
    left = -acceleration[:, 0] * np.sin(yaw) + acceleration[:, 1] * np.cos(yaw)
    turn = np.arctan2(after[:, 1], after[:, 0]) - np.arctan2(before[:, 1], before[:, 0])
    return np.stack([forward, left, wrap_angle(turn) / WINDOW], axis=1)


def sampled_at_speed(imu: ImuSamples, path: PathMotion) -> IntArray:
    """Return which fixes of a moving kart have samples around them."""
    inside = (path.t > imu.t[0] + 1.0) & (path.t < imu.t[-1] - 1.0)
    return np.flatnonzero(path.moves & inside & ~in_gap(imu.t, path.t))


def thinned(rows: IntArray, count: int) -> IntArray:
    """At most `count` of the rows, evenly taken."""
    return rows[:: max(1, -(-rows.size // count))]


def peak(x: Array, y: Array) -> float:
    """Where y (N,) over evenly spaced x (N,) is largest, by the parabola through the three points around it."""
    i = int(np.clip(np.argmax(y), 1, y.size - 2))
    before, at, after = y[i - 1 : i + 2]
    bend = before - 2.0 * at + after
    if bend >= 0.0:
        return float(x[np.argmax(y)])
    return float(x[i] + np.clip(0.5 * (before - after) / bend, -1.0, 1.0) * (x[1] - x[0]))


# Mean specific force and angular rate of the IMU around some times, and where samples are missing.

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
    """Return the averages of samples, cached while the samples exist."""
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


STRETCH, MOST_STRETCHES = 10.0, 400  # s of driving: a bend or two
FEWEST_STRETCHES, FEWEST = 5, 8  # of a session; fixes of a stretch
ENOUGH_ROUGHLY, ENOUGH = 40, 100  # fixes of a stretch
SLOWEST = 1.5  # s between fixes; in more a kart goes round a bend
FARTHEST, STEP = 2.2, 0.1  # s about the usual lag that are searched, and their spacing
INDEPENDENT = 2.0  # s, correlation time of the difference of path and measurement
JUMP_COSTS, CREEP_COSTS = 6.0, 0.5  # log-likelihood of another lag than in the stretch before, and of the next one
REWEIGHTED, ITERATIONS = 4, 4
FARTHEST_MOVE, SETTLED = 0.15, 0.002  # s, of one iteration
BESIDE_ROUGH = 0.3  # s, by which a lag may be off the one found roughly
BLOCK = 2.0  # s; residuals of different blocks are independent
FLOOR = 0.05  # least sigma in parts of the spacing of the fixes
UNKNOWN = 10.0  # scatter of too few lags, in sigmas
LIVELY = 0.4  # least motion of an axis, in parts of its usual one
LEAST_GAIN = 0.3  # of 1
TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Measured:
    """Measurements along the axes of the kart; R_bs (3, 3), gyro_bias_s (3,) rad/s."""

    averages: Averages
    R_bs: Array
    gyro_bias_s: Array

    def at(self, t: Array) -> Array:
        """Forward and left force m/s^2 and rate about up rad/s, (3, ...), averaged around t (...) s."""
        force, rate = self.averages.around(t, WINDOW)
        return np.stack([force @ self.R_bs[0], force @ self.R_bs[1], (rate - self.gyro_bias_s) @ self.R_bs[2]])


@dataclass(frozen=True, eq=False)
class Streams:
    """Stretches from first (B,) to last (B,) s by the clock of the fixes, `spacing` s apart.

    By forward force, left force and yaw rate: lag (B, 3) s of the path behind the samples and its sigma, infinite where
    nothing shows it; gain (B, 3).
    """

    first: Array
    last: Array
    lag: Array
    sigma: Array
    gain: Array
    spacing: float

    @property
    def t(self) -> Array:
        """Middle of each stretch, (B,) s."""
        return np.asarray(0.5 * (self.first + self.last))

    @property
    def is_known(self) -> BoolArray:
        """Mask (B, 3) of the lags that show."""
        return np.isfinite(self.sigma)


def compare_streams(measured: Measured, path: PathMotion, use: IntArray, about: float) -> Streams | None:
    """Compare samples and path at the fixes `use`, at speed and with samples around them; `about` s: the usual lag.

    None where fixes are too few or too rare to tell one stretch from others.
    """
    if use.size < FEWEST * FEWEST_STRETCHES or median(np.diff(path.t)) > SLOWEST:
        return None
    parts = _stretches(path.t, use)
    if len(parts) < FEWEST_STRETCHES:
        return None
    axes = path_axes(path)
    some = _Rows.of([part[:: -(-len(part) // ENOUGH_ROUGHLY)] for part in parts], path, axes)
    return _fitted(measured, _Rows.of(parts, path, axes), _rough_lags(measured, some, about), median(np.diff(path.t)))


def _stretches(t: Array, use: IntArray) -> list[IntArray]:
    """Rows `use` of fixes at t (N,) s by stretch of driving, without those of too few fixes."""
    since = np.diff(t[use], prepend=t[use[0]])
    driven = np.cumsum(np.minimum(since, SLOWEST))
    length = max(STRETCH, float(driven[-1]) / MOST_STRETCHES)
    parts = np.split(use, np.flatnonzero((np.diff(driven // length) > 0.0) | (since[1:] > STRETCH)) + 1)
    return [part[:: -(-len(part) // ENOUGH)] for part in parts if len(part) >= FEWEST]


@dataclass(frozen=True, eq=False)
class _Rows:
    """Fixes at t (N,) s of stretches numbered from 0, in order; path (3, N): its axes, and their change (3, N)."""

    t: Array
    stretch: IntArray
    path: Array
    change: Array

    @classmethod
    def of(cls, parts: list[IntArray], path: PathMotion, axes: Array) -> "_Rows":
        """The fixes of some parts; axes (N, 3) of the path."""
        rows, number = np.concatenate(parts), np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        return cls(path.t[rows], number, axes[rows].T, np.gradient(axes, path.t, axis=0)[rows].T)

    @property
    def first(self) -> IntArray:
        """First row (B,) of each stretch."""
        return np.flatnonzero(np.diff(self.stretch, prepend=-1))

    def sums(self, values: Array) -> Array:
        """Sums (..., B) of values (..., N)."""
        return np.asarray(np.add.reduceat(values, self.first, axis=-1))

    def medians(self, values: Array) -> Array:
        """Medians (3, B) of values (3, N)."""
        return np.stack([np.median(part, axis=1) for part in np.split(values, self.first[1:], axis=1)], axis=1)

    def centred(self, values: Array, weight: Array) -> Array:
        """Values (3, N) less their weighted mean in each stretch."""
        return np.asarray(values - (self.sums(weight * values) / self.sums(weight))[:, self.stretch])


def _rough_lags(measured: Measured, rows: _Rows, about: float) -> Array:
    """The lag (B,) s of each stretch, to STEP, of the likeliest course of lags, which seldom jump.

    Source: Viterbi 1967.
    """
    tried, one = about + np.arange(-FARTHEST, FARTHEST + 1e-9, STEP), np.ones_like(rows.path)
    path = rows.centred(rows.path, one)
    lasts = rows.t[np.append(rows.first[1:], len(rows.t)) - 1] - rows.t[rows.first]
    likelihood = np.empty((len(lasts), len(tried)))
    for k, lag in enumerate(tried):
        here = rows.centred(measured.at(rows.t - lag), one)
        shared = np.maximum(rows.sums(here * path), 0.0)
        rest = 1.0 - shared**2 / np.maximum(rows.sums(here**2) * rows.sums(path**2), TINY)
        likelihood[:, k] = -0.5 * lasts / INDEPENDENT * np.sum(np.log(np.maximum(rest, 1e-3)), axis=0)
    away = np.abs(np.subtract.outer(np.arange(len(tried)), np.arange(len(tried))))
    costs = np.where(away <= 1, CREEP_COSTS * away, JUMP_COSTS)
    best, came_from = likelihood[0], []
    for own in likelihood[1:]:
        total = best - costs
        came_from.append(np.argmax(total, axis=1))
        best = np.max(total, axis=1) + own
    course = [int(np.argmax(best))]
    for before in reversed(came_from):
        course.append(int(before[course[-1]]))
    return np.asarray(tried[course[::-1]])


def _fitted(measured: Measured, rows: _Rows, rough: Array, spacing: float) -> Streams:
    """Fit each axis of each stretch from the `rough` lag (B,) s on."""
    lag = np.tile(rough, (3, 1))
    for _ in range(ITERATIONS):
        here = np.stack([measured.at(rows.t - lag[i, rows.stretch])[i] for i in range(3)])
        fit = _Fit.of(rows, here)
        lag = lag + np.clip(fit.move, -FARTHEST_MOVE, FARTHEST_MOVE)
        if np.max(np.abs(fit.move)) < SETTLED:
            break
    variance = rows.sums(rows.centred(rows.path, np.ones_like(rows.path)) ** 2) / np.bincount(rows.stretch)
    is_lively = variance > LIVELY**2 * np.mean(variance, axis=1, keepdims=True)
    is_known = is_lively & (fit.gain > LEAST_GAIN) & (np.abs(lag - rough) < BESIDE_ROUGH)
    sigma = np.where(is_known, np.hypot(fit.sigma, FLOOR * spacing), np.inf)
    return Streams(
        rows.t[rows.first],
        rows.t[np.append(rows.first[1:], len(rows.t)) - 1],
        lag.T,
        (sigma * _scatter(lag, sigma)[:, None]).T,
        fit.gain.T,
        spacing,
    )


def _scatter(lag: Array, sigma: Array) -> Array:
    """Scatter (3,) of lags (3, B), in their sigmas, from one stretch to the next; at least 1."""
    out = np.full(3, UNKNOWN)
    for i, known in enumerate(np.isfinite(sigma)):
        both = known[1:] & known[:-1]
        if np.count_nonzero(both) > 3:
            change = np.diff(lag[i])[both] / np.hypot(sigma[i, 1:], sigma[i, :-1])[both]
            out[i] = max(1.0, MAD_TO_SIGMA * median(np.abs(change)))
    return out


@dataclass(frozen=True, eq=False)
class _Fit:
    """By axis and stretch, (3, B): correction of the lag, s, its sigma, and gain."""

    move: Array
    sigma: Array
    gain: Array

    @classmethod
    def of(cls, rows: _Rows, here: Array) -> "_Fit":
        """Fit measurements, here (3, N), by path, its change and an offset, with Cauchy weights.

        Sigmas are from the scatter of the scores between blocks of all stretches (the sandwich of White 1980).
        """
        weight, all_of = np.ones_like(here), rows.stretch
        for _ in range(REWEIGHTED):
            y, x, d = (rows.centred(values, weight) for values in (here, rows.path, rows.change))
            xx, xd, dd, xy, dy = (rows.sums(weight * a * b) for a, b in ((x, x), (x, d), (d, d), (x, y), (d, y)))
            determinant = np.maximum(xx * dd - xd**2, TINY)
            gain, slope = (dd * xy - xd * dy) / determinant, (xx * dy - xd * xy) / determinant
            rest = y - gain[:, all_of] * x - slope[:, all_of] * d
            usual = rows.medians(np.abs(rest))[:, all_of] + 1e-9
            weight = 1.0 / (1.0 + (rest / (3.0 * usual)) ** 2)
        own = (d - (xd / np.maximum(xx, TINY))[:, all_of] * x) * gain[:, all_of]
        information = rows.sums(weight * own**2)
        blocks = (rows.t - rows.t[0]) // BLOCK + 1e6 * all_of
        scores = np.add.reduceat(weight * own * rest, np.flatnonzero(np.diff(blocks, prepend=-1.0)), axis=1)
        noise = np.sum(scores**2, axis=1) / np.maximum(np.sum(information, axis=1), TINY)
        sigma = np.sqrt(noise[:, None] / np.maximum(information, TINY))
        move = np.where(np.abs(gain) > LEAST_GAIN, slope / np.where(gain == 0.0, 1.0, gain), 0.0)
        return cls(move, sigma, gain)
