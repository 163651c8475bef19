"""Motion of the path through the fixes, and means of force and rate of the samples around the same times."""

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, are_near
from smoother.disc import pieces, release, roomy
from smoother.frames import wrap_angle
from smoother.samples import ImuSamples

MIN_SPEED = 3.0  # m/s below which a course says little about the nose
TOLD_NEAR = 1.0  # s; some receivers tell their velocity less often than their position
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


def near_reported(t: Array, told: BoolArray) -> BoolArray:
    """Mask (N,) of times t (N,) s near one with a reported value, mask (N,)."""
    return are_near(t, t[told], TOLD_NEAR)


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
