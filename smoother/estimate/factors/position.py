"""GPS position: the antenna, late by a latency, beside a slow error."""

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.factors.antenna import arm_axes
from smoother.estimate.factors.rows import Between, Rows, no_jacobian, rows_of
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.state import OFFSET, State
from smoother.frames import UP_N


def position_rows(
    state: State, motion: LowPassedMotion, t: Array, measured_n: Array, sigma: Array, usual_latency: float
) -> Rows:
    """Residual p(t - latency) + R l + o - z, m in n.

    t (N,) s: stamps; measured_n (N, 3) m, NaN unknown; sigma (N, 3) m. The slow error o belongs to the receiver: it is
    read at t - usual_latency, whatever the estimated latency, within the same interval.
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
