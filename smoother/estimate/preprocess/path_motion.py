"""Motion of the kart as the fixes tell it: velocities, and forces and rate along the axes of the path."""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, are_near
from smoother.estimate.preprocess.averages import WINDOW, in_gap
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
