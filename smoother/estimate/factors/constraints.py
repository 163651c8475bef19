"""Factors of single keyframes and intervals: standstill, heading of the magnetic field, level ground."""

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.state import OFFSET, ROTATION, TRANSLATION, VELOCITY, State
from smoother.frames import wrap_angle

SPEED = 0.02  # m/s; a chassis on its tyres with the engine idling
TURN = 3e-4  # rad between keyframes, likewise


def standstill_rows(state: State, interval: IntArray) -> Rows:
    """Residual: velocity of the left keyframe, m/s, and turn to the right one, rad, of the intervals (N,) at rest."""
    turn = state.R_ns[interval].transpose(0, 2, 1) @ state.R_ns[interval + 1]
    left, right = no_jacobian(len(interval), 6)
    left[:, 0:3, VELOCITY] = np.eye(3)
    left[:, 3:6, ROTATION], right[:, 3:6, ROTATION] = -turn.transpose(0, 2, 1), np.eye(3)
    residual = np.concatenate([state.velocity_n[interval], so3.log(turn)], axis=1)
    return rows_of("standstill", interval, residual, np.repeat([SPEED, TURN], 3), left, right)


# Heading of the magnetic field. Its Jacobian is a rotation about up: a disturbed field never affects roll and pitch.


def heading_rows(
    state: State, interval: IntArray, field_s: Array, field_yaw: float, sigma: float | Array, has_offset: bool
) -> Rows:
    """Residual: yaw of the field R field_s minus field_yaw and the heading offset, rad.

    At the left keyframes of the intervals (N,): corrected field_s (N, 3), any unit; field_yaw rad in n; sigma rad, one
    or (N,). has_offset: the readings have an unknown heading offset.
    """
    field_n = np.einsum("nij,nj->ni", state.R_ns[interval], field_s)
    offset = state.constant("heading_offset") if has_offset else 0.0
    residual = wrap_angle(np.arctan2(field_n[:, 1], field_n[:, 0]) - field_yaw - offset)[:, None]
    left, right = no_jacobian(len(interval), 1)
    left[:, 0, ROTATION] = state.R_ns[interval][:, 2, :]
    constants = {"heading_offset": np.full((len(interval), 1, 1), -1.0)} if has_offset else {}
    return rows_of("heading", interval, residual, np.reshape(sigma, (-1, 1)), left, right, constants)


# Level ground, where no fix has a height.

FAR_FROM_HEIGHT = 20.0  # s; for so long the samples alone predict a height
HEIGHTS_AROUND = np.arange(-2, 3)  # whose median is the nearest height: robust against one outlier
LEVEL_GROUND = 2.0  # m/sqrt(Hz); much less than tracks are level to, since heights are near one another for seconds


def ground_rows(state: State, at: IntArray, height: Array) -> Rows:
    """Residual: height of the keyframes `at` (N,) plus the slow error upwards minus `height` (N,), m in n.

    With the samples alone the height would drift by kilometres. The slow error absorbs hills.
    """
    left, right = no_jacobian(len(at), 1)
    left[:, 0, TRANSLATION], left[:, 0, OFFSET.start + 2] = state.R_ns[at, 2, :], 1.0
    residual = (state.position_n[at, 2] + state.offset_n[at, 2] - height)[:, None]
    return rows_of("ground", at, residual, LEVEL_GROUND / np.sqrt(state.interval), left, right)


def far_from_heights(heights: Array, t: Array) -> tuple[IntArray, Array]:
    """Keyframes of t (K,) s, but the last, that are far from any of the heights (H, 2), and the nearest one (n,) m.

    That of the origin where there is none at all.
    """
    if not len(heights):
        return np.arange(len(t) - 1), np.zeros(len(t) - 1)
    times = heights[:, 0]
    after = np.clip(np.searchsorted(times, t[:-1]), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(times[after] - t[:-1]) < np.abs(times[before] - t[:-1]), after, before)
    far = np.flatnonzero(np.abs(times[near] - t[:-1]) > FAR_FROM_HEIGHT)
    around = np.clip(near[far, None] + HEIGHTS_AROUND, 0, len(times) - 1)
    return far, np.median(heights[around, 1], axis=1)
