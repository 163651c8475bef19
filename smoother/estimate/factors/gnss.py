"""GPS position and Doppler velocity: those of the antenna, each with its latency; the position has a slow error, the
velocity a bias and the receiver's low-pass."""

import math
from functools import partial

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.factors.rows import Between, Rows, along_direction, no_jacobian, rows_of, speeds_alone
from smoother.estimate.model.motion import LowPassedMotion, Spectrum, course_of
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


def offset_rows(state: State, sigma: Array, tau: float) -> Rows:
    """Residual o(k + 1) - phi o(k), m, with variance sigma^2 (1 - phi^2) and phi = exp(-T / tau), in every interval.

    sigma (3,) m; tau s. Source: Gelb 1974, 3.8.
    """
    n = len(state.t) - 1
    phi = np.full((n, 1), np.exp(-state.interval / tau))
    left, right = no_jacobian(n, 3)
    left[:, :, OFFSET], right[:, :, OFFSET] = -phi[:, :, None] * np.eye(3), np.eye(3)
    residual = state.offset_n[1:] - phi * state.offset_n[:-1]
    return rows_of("gps_offset", np.arange(n), residual, sigma * np.sqrt(1.0 - phi**2), left, right)


def offset_start_rows(state: State, sigma: Array) -> Rows:
    """Residual o(0), m: stationary at the start. sigma (3,) m."""
    left, right = no_jacobian(1, 3)
    left[:, :, OFFSET] = np.eye(3)
    return rows_of("gps_offset_start", np.zeros(1, np.int64), state.offset_n[:1], sigma, left, right)


LEVEL = np.array([1.0, 1.0, 0.0])


def velocity_rows(
    state: State, motion: LowPassedMotion, t: Array, measured_n: Array, sigma: Array, speed: Array | None = None
) -> Rows:
    """Residual v(t - latency) + w x R l + response + bias - z, m/s in n; w is the turn rate about up.

    t (N,) s: stamps; measured_n (N, 3) m/s, NaN unknown; sigma (N, 3) m/s. Where no course is known only
    the speed (N,) m/s is measured: the horizontal magnitude. The vertical component has no Jacobian by latency and no
    response, because a kart bounces on its tyres.
    """
    latency = state.constant("velocity_latency")
    between = Between.at(state, t - latency)
    weights, axes, along = between.of_velocity(), arm_axes(between), motion.at(t - latency)
    arm_n, turning = axes @ state.constants["lever_arm"], so3.skew(along.turn_rate[:, None] * UP_N)
    swing_n = np.einsum("nij,nj->ni", turning, arm_n)
    left, right = no_jacobian(len(t), 3)
    between.put_value(left, right, weights)
    if not state.geometry.is_steered:
        between.put_turn(left, right, -turning @ so3.skew(arm_n))
    transfers = partial(response, constant=state.constant("velocity_response"))
    shown_n, rate_n, by_response_n = motion.filtered(transfers, t - latency)
    acceleration_n = along.acceleration_n + np.einsum("nij,nj->ni", turning, swing_n) + rate_n
    constants = {
        "velocity_latency": -(acceleration_n * LEVEL)[:, :, None],
        "lever_arm": turning @ axes,
        "doppler_bias": np.broadcast_to(np.eye(3), (len(t), 3, 3)),
        "velocity_response": (by_response_n * LEVEL)[:, :, None],
    }
    beyond_n = state.constants["doppler_bias"] + shown_n * LEVEL
    only = speeds_alone(measured_n, speed)
    measured_n = np.where(only[:, None], 0.0, measured_n)
    residual = between.value(weights) + swing_n + beyond_n - measured_n
    rows = rows_of("gps_velocity", between.interval, residual, sigma, left, right, constants)
    return rows if speed is None else along_direction(rows, only, speed)


def response(s: Spectrum, constant: float) -> tuple[Spectrum, Spectrum, Spectrum]:
    """Transfer functions of the receiver's response beyond its latency: itself, its derivative, its slope by the
    constant.

    s: 2 pi i Hz. constant s^2: tau^2 / 2 of a first-order low-pass with time constant tau, whose delay is part of the
    latency; in slow motion the rest is the constant times the jerk. A negative constant, as of a leaning antenna, is
    only that.
    """
    tau = math.sqrt(2.0 * max(constant, 0.0))
    passed = np.exp(s * tau) / (1.0 + s * tau)
    added = passed - 1.0 if tau > 0.0 else constant * s**2
    return added, added * s, s**2 * passed / (1.0 + s * tau)
