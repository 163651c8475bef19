"""GPS Doppler velocity: that of the antenna, late by a latency and behind the receiver's low-pass, beside a bias."""

import math
from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.factors.antenna import arm_axes
from smoother.estimate.factors.rows import Between, Rows, no_jacobian, rows_of
from smoother.estimate.model.motion import LowPassed, LowPassedMotion, Spectrum
from smoother.estimate.model.state import State
from smoother.frames import UP_N

LEVEL = np.array([1.0, 1.0, 0.0])


def velocity_rows(state: State, motion: LowPassedMotion, t: Array, measured_n: Array, sigma: Array) -> Rows:
    """Residual v(t - latency) + w x R l + response + bias - z, m/s in n; w is the turn rate about up.

    t (N,) s: stamps; measured_n (N, 3) m/s, NaN unknown; sigma (N, 3) m/s. A kart bounces on its tyres: upwards there
    is no slope by the latency, and no response.
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
    shown = _shown(state, motion, t - latency)
    acceleration_n = along.acceleration_n + np.einsum("nij,nj->ni", turning, swing_n) + shown.rate_n
    constants = {
        "velocity_latency": -(acceleration_n * LEVEL)[:, :, None],
        "lever_arm": turning @ axes + LEVEL[:, None] * shown.by_arm,
        "doppler_bias": np.broadcast_to(np.eye(3), (len(t), 3, 3)),
        "velocity_response": (shown.by_response_n * LEVEL)[:, :, None],
    }
    beyond_n = state.constants["doppler_bias"] + shown.velocity_n * LEVEL
    residual = between.value(weights) + swing_n + beyond_n - measured_n
    return rows_of("gps_velocity", between.interval, residual, sigma, left, right, constants)


@dataclass(frozen=True, eq=False)
class _Shown:
    """What the receiver's response adds to the velocity of the antenna: velocity_n and its derivative rate_n (N, 3), m
    and s in n; slopes by_response_n (N, 3) and by_arm (N, 3, 3).
    """

    velocity_n: Array
    rate_n: Array
    by_response_n: Array
    by_arm: Array


def _shown(state: State, motion: LowPassedMotion, t: Array) -> _Shown:
    """At t (N,) s, of the low-passed motion of the antenna."""
    at = motion.state
    by_arm = so3.skew(motion.at(at.t).turn_rate[:, None] * UP_N) @ arm_axes(Between.at(at, at.t))
    antenna_n = at.velocity_n + by_arm @ state.constants["lever_arm"]
    of = LowPassed(at, np.column_stack([antenna_n, by_arm.reshape(-1, 9)]), motion.cutoff)
    added, by_constant = response(of.s, state.constant("velocity_response"))
    shown = of.at(of.passed(added), t)
    rate, slope = (of.at(of.passed(transfer, 3), t) for transfer in (added * of.s, by_constant))
    return _Shown(shown[:, :3], rate, slope, shown[:, 3:].reshape(-1, 3, 3))


def response(s: Spectrum, constant: float) -> tuple[Spectrum, Spectrum]:
    """What a receiver's response adds to velocities, over them, and its slope by the constant, at s = 2 pi i Hz.

    constant s^2: a low-pass of first order that is late by its time constant tau has tau^2 / 2; in slow motion it adds,
    beyond that delay, the constant times the jerk. Where it is negative, as of an antenna that leans, that is all.
    """
    tau = math.sqrt(2.0 * max(constant, 0.0))
    passed = np.exp(s * tau) / (1.0 + s * tau)
    return passed - 1.0 if tau > 0.0 else constant * s**2, s**2 * passed / (1.0 + s * tau)
