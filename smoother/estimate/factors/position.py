"""GPS position: the antenna, delayed by a latency, plus a slow error."""

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.estimate.factors.rows import Between, Rows, no_jacobian, rows_of
from smoother.estimate.model.motion import LowPassedMotion, course_of
from smoother.estimate.model.state import OFFSET, State
from smoother.frames import UP_N


def position_rows(
    state: State, motion: LowPassedMotion, t: Array, measured_n: Array, sigma: Array, usual_latency: float
) -> Rows:
    """Residual p(t - latency) + R l + o - z, m in n.

    t (N,) s: stamps; measured_n (N, 3) m, NaN unknown; sigma (N, 3) m. The slow error o is interpolated
    at t - usual_latency within the same interval, independent of the estimated latency.
    """
    latency = state.constant("position_latency")
    between = Between.at(state, t - latency)
    weights, axes, along = between.of_position(), arm_axes(between), motion.at(t - latency)
    arm_n = axes @ state.constants["lever_arm"]
    k = between.interval
    s = np.clip((t - usual_latency - state.t[k]) / state.interval, 0.0, 1.0)[:, None]
    offset_n = (1.0 - s) * state.offset_n[k] + s * state.offset_n[k + 1]
    left, right = no_jacobian(len(t), 3)
    between.put_value(left, right, weights)
    if not state.geometry.is_steered:
        between.put_turn(left, right, -so3.skew(arm_n))
    left[:, :, OFFSET], right[:, :, OFFSET] = (1.0 - s)[:, :, None] * np.eye(3), s[:, :, None] * np.eye(3)
    swing_n = np.cross(along.turn_rate[:, None] * UP_N, arm_n)
    constants = {"position_latency": -(along.velocity_n + swing_n)[:, :, None], "lever_arm": axes}
    residual = between.value(weights) + arm_n + offset_n - measured_n
    return rows_of("gps_position", k, residual, sigma, left, right, constants)


# The lever arm from the IMU to the antenna in n, for a logger on the frame or on the steering wheel.


def arm_axes(between: Between) -> Array:
    """Rotations (N, 3, 3) that take the lever arm from s to n.

    For a logger on the steering wheel it rotates with the course of the path: rotating with the wheel it would move the
    antenna by decimetres.
    """
    geometry = between.state.geometry
    if not geometry.is_steered:
        return between.R_ns
    course = between.linear(course_of(between.state)[:, None])[:, 0]
    R_nb = np.zeros((len(course), 3, 3))
    R_nb[:, 0, 0] = R_nb[:, 1, 1] = np.cos(course)
    R_nb[:, 1, 0] = np.sin(course)
    R_nb[:, 0, 1] = -R_nb[:, 1, 0]
    R_nb[:, 2, 2] = 1.0
    return np.asarray(R_nb @ geometry.level_axes_s)


# The slow error of the fixes: a Gauss-Markov process of first order.


def offset_rows(state: State, sigma: Array, tau: float, renewed: BoolArray | None = None) -> Rows:
    """Residual o(k + 1) - phi o(k), m, with variance sigma^2 (1 - phi^2) and phi = exp(-T / tau), in every interval.

    sigma (3,) or (K-1, 3) m; tau s. renewed (K-1,): intervals after which the error is independent (phi = 0).
    Source: Gelb 1974, 3.8.
    """
    n = len(state.t) - 1
    phi = np.full((n, 1), np.exp(-state.interval / tau))
    if renewed is not None:
        phi[renewed] = 0.0
    left, right = no_jacobian(n, 3)
    left[:, :, OFFSET], right[:, :, OFFSET] = -phi[:, :, None] * np.eye(3), np.eye(3)
    residual = state.offset_n[1:] - phi * state.offset_n[:-1]
    return rows_of("gps_offset", np.arange(n), residual, sigma * np.sqrt(1.0 - phi**2), left, right)


def offset_start_rows(state: State, sigma: Array) -> Rows:
    """Residual o(0), m: stationary at the start. sigma (3,) m."""
    left, right = no_jacobian(1, 3)
    left[:, :, OFFSET] = np.eye(3)
    return rows_of("gps_offset_start", np.zeros(1, np.int64), state.offset_n[:1], sigma, left, right)
