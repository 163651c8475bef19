"""GPS Doppler velocity: that of the antenna, delayed by a latency and the receiver's low-pass, plus a bias."""

import math
from functools import partial

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.factors.position import arm_axes
from smoother.estimate.factors.rows import Between, Rows, along_direction, no_jacobian, rows_of, speeds_alone
from smoother.estimate.model.motion import LowPassedMotion, Spectrum
from smoother.estimate.model.state import State
from smoother.frames import UP_N

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
