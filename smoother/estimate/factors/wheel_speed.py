"""Wheel speed: the speed along the path at a wheel, with its scale, its slip, and where it is.

A sensor counts turns of a wheel, and whoever set it up entered a circumference: a scale. A tyre that pushes or brakes
slips by a share that goes with the force, so with forward acceleration; one that slides turns by the cosine of its
sideslip, which goes with lateral acceleration, so less by the square of that. In a bend a wheel on the left is slower
than one on the right, by the turn rate times the distance between them.
"""

import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.rows import Between, Rows, no_jacobian, rows_of
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.state import State
from smoother.samples import WheelSpeed

USUAL = 0.1  # m/s, sigma of a reading before the recording decides it
# s: errors of a tyre last (a real car's are correlated by 0.3 after 1 s, 0.16 after 2 s): more readings would only seem
# to tell more
EVERY = 2.0
AVERAGED = 0.1  # s of samples in a reading; the motion in it is nearly even
SLOWEST = 2.0  # m/s, below which teeth pass too rarely, or the wheel is locked


def readings_of(wheel: WheelSpeed) -> WheelSpeed:
    """Return a reading every EVERY s: the mean of the samples of AVERAGED s, none where one of these is too slow."""
    t = wheel.t
    first = np.flatnonzero(np.diff(np.floor((t - t[0]) / EVERY), prepend=-1.0))
    end = np.searchsorted(t, t[first] + AVERAGED)
    sums = np.cumsum(np.vstack([np.zeros(3), np.column_stack([t, wheel.speed, wheel.speed < SLOWEST])]), axis=0)
    mean = (sums[end] - sums[first]) / (end - first)[:, None]
    turns = mean[:, 2] == 0.0
    return WheelSpeed(mean[turns, 0], mean[turns, 1])


def wheel_speed_rows(state: State, motion: LowPassedMotion, t: Array, measured: Array, sigma: float) -> Rows:
    """Residual (1 + scale + slip . (a, l^2)) (|v(t)| - side w) - z, m/s; a forward and l lateral acceleration, w turn
    rate about up.

    t (N,) s: stamps; measured (N,) m/s; sigma m/s.
    """
    scale, slip, side = state.constant("wheel_scale"), state.constants["wheel_slip"], state.constant("wheel_side")
    between, along = Between.at(state, t), motion.at(t)
    weights = between.of_velocity()
    speed, forward_n = _speed_and_direction(between.value(weights))
    path_n = _speed_and_direction(along.velocity_n)[1]
    by_slip = np.column_stack(
        [np.sum(path_n * along.acceleration_n, axis=1), np.cross(path_n, along.acceleration_n)[:, 2] ** 2]
    )
    of_wheel, turned = speed - side * along.turn_rate, 1.0 + scale + by_slip @ slip
    left, right = no_jacobian(len(t), 3)
    between.put_value(left, right, weights)
    by_velocity = (turned[:, None] * forward_n)[:, None, :]
    constants = {
        "wheel_scale": of_wheel[:, None, None],
        "wheel_slip": (by_slip * of_wheel[:, None])[:, None, :],
        "wheel_side": (-turned * along.turn_rate)[:, None, None],
    }
    residual = (turned * of_wheel - measured)[:, None]
    left, right = by_velocity @ left, by_velocity @ right
    return rows_of("wheel_speed", between.interval, residual, sigma, left, right, constants)


def _speed_and_direction(velocity_n: Array) -> tuple[Array, Array]:
    """Speed (N,) m/s and direction (N, 3) in n; at rest the direction is nothing."""
    speed = np.linalg.norm(velocity_n, axis=1)
    return speed, velocity_n / np.maximum(speed, SLOWEST)[:, None]
