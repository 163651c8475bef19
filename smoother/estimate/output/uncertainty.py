"""Covariances of the errors of keyframes: of the antenna, of the biases, and of the line among the fixes."""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.disc import pieces
from smoother.estimate.factors.position import arm_axes
from smoother.estimate.factors.rows import Between
from smoother.estimate.model.state import (
    ACCEL_BIAS,
    COLUMNS,
    GYRO_BIAS,
    KEYFRAME_SIZE,
    OFFSET,
    ROTATION,
    TRANSLATION,
    VELOCITY,
    State,
)
from smoother.estimate.solvers.covariance import Covariances
from smoother.estimate.solvers.identify import Solution

PIECE = 256  # keyframes whose covariances stay in the processor's cache
_MOTION = slice(ROTATION.start, VELOCITY.stop)
ARM = COLUMNS["lever_arm"]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What is known of the errors of K keyframes.

    antenna (K, 9, 9): see :func:`antenna_covariance`; biases (K, 6): sigmas of force and rate; track (K, 2) m^2: see
    :func:`track_variance`; bend (K, 3, 3) m^2/s^2: see :func:`bend_covariance`.
    """

    antenna: Array
    biases: Array
    track: Array
    bend: Array


def uncertainty_of(solution: Solution, wheels_heading: float | None) -> Uncertainty:
    """Return sigmas and covariances of the antenna at the keyframes of a solved graph.

    wheels_heading: as for :func:`antenna_covariance`.
    """
    state, known = solution.step.state, solution.covariances
    return Uncertainty(
        antenna_covariance(state, known, wheels_heading),
        np.sqrt(np.einsum("kii->ki", known.keyframes)[:, ACCEL_BIAS.start : GYRO_BIAS.stop]),
        track_variance(state, known),
        bend_covariance(state, known),
    )


def antenna_covariance(state: State, known: Covariances, wheels_heading: float | None) -> Array:
    """Covariance (K, 9, 9) of the errors in n of the sensor's attitude, the antenna's velocity and its position.

    wheels_heading: variance, rad^2, of the heading by sideslip beyond that in the solution; None where it is not by it.
    """
    R, R_arm, P = state.R_ns, arm_axes(Between.at(state, state.t)), known.keyframes
    R_turning = np.zeros_like(R) if state.geometry.is_steered else R  # what errors of attitude turn the arm by
    K, turn_n, arm_n = len(state.t), _turning(state, R_arm), R_arm @ state.constants["lever_arm"]
    swing_n = np.cross(turn_n, arm_n)
    # by rotation, translation and velocity of the keyframe and by the arm
    J, C = np.zeros((K, 9, 9)), np.zeros((K, 9, 3))
    J[:, 0:3, ROTATION] = R
    J[:, 3:6, ROTATION], J[:, 3:6, VELOCITY] = -so3.skew(swing_n) @ R_turning, np.eye(3)
    J[:, 6:9, ROTATION], J[:, 6:9, TRANSLATION] = -so3.skew(arm_n) @ R_turning, R
    C[:, 3:6], C[:, 6:9] = so3.skew(turn_n) @ R_arm, R_arm
    columns = np.arange(ARM.start, ARM.stop)
    if wheels_heading is not None:  # then the error of the sideslip is one of the kart's attitude
        columns, C = np.append(columns, COLUMNS["slip"].start), np.concatenate([C, np.zeros((K, 9, 1))], axis=2)
        C[:, 2, 3] = 1.0
    S, with_constants = known.constants[np.ix_(columns, columns)], known.with_constants
    antenna = np.empty((K, 9, 9))
    for part in pieces(K, PIECE):
        J_t, C_t = J[part].transpose(0, 2, 1), C[part].transpose(0, 2, 1)
        cross = J[part] @ with_constants[part, _MOTION][:, :, columns] @ C_t
        antenna[part] = J[part] @ P[part, _MOTION, _MOTION] @ J_t + C[part] @ S @ C_t
        antenna[part] += cross + cross.transpose(0, 2, 1)
    antenna[:, 2, 2] += wheels_heading or 0.0
    return antenna


def _turning(state: State, R_arm: Array) -> Array:
    """Mean angular rate (K, 3) rad/s in n, of what the arm keeps to, from each keyframe to the next."""
    turn = so3.log(R_arm[:-1].transpose(0, 2, 1) @ R_arm[1:]) / state.interval
    return np.asarray(np.einsum("kij,kj->ki", R_arm, np.concatenate([turn, turn[-1:]])))


def bend_covariance(state: State, known: Covariances) -> Array:
    """Covariance (K, 3, 3) m^2/s^2 of the cubic's velocity halfway to the next keyframe, less the mean of both ends'.

    Where Doppler holds the keyframes more tightly than the samples hold the way from one to the next, the velocity is
    better known at them than between: with what the samples' noise adds there (`_between_samples` of dense_rows.py).
    Where the samples are good both cancel out. What the antenna's swing is unsure by changes slowly and is left out.
    """
    moved, T = slice(TRANSLATION.start, VELOCITY.stop), state.interval
    halfway = np.zeros((len(state.t), 3, 6))
    halfway[:, :, :3], halfway[:, :, 3:] = 1.5 / T * state.R_ns, -0.25 * np.eye(3)
    before = halfway[:-1] * np.repeat([-1.0, 1.0], 3)
    own, cross = known.keyframes[:, moved, moved], known.neighbours[:, moved, moved]
    after_t = halfway[1:].transpose(0, 2, 1)
    with_next = before @ cross @ after_t
    bend = before @ own[:-1] @ before.transpose(0, 2, 1) + halfway[1:] @ own[1:] @ after_t
    bend += with_next + with_next.transpose(0, 2, 1) - 0.5 * (own[:-1, 3:, 3:] + own[1:, 3:, 3:])
    return np.concatenate([bend, bend[-1:]])


def track_variance(state: State, known: Covariances) -> Array:
    """Variance of the antenna's position plus offset, the line in the frame of the fixes, (K, 2) m^2 per level axis.

    Of each keyframe, and together with the next one: the offset is rough, and between two keyframes it is their mean.
    The antenna is where the arm has it: arm and latency err together, by what the sensor itself is not off.
    """
    K, R_arm = len(state.t), arm_axes(Between.at(state, state.t))
    by_state, by_arm = np.zeros((K, 2, KEYFRAME_SIZE)), R_arm[:, :2]
    if not state.geometry.is_steered:
        by_state[:, :, ROTATION] = (-so3.skew(R_arm @ state.constants["lever_arm"]) @ state.R_ns)[:, :2]
    by_state[:, :, TRANSLATION], by_state[:, :, OFFSET] = state.R_ns[:, :2], np.eye(3)[:2]
    arm, with_arm = known.constants[ARM, ARM], known.with_constants[:, :, ARM]
    by_both = by_state @ with_arm  # (K, 2, 3), covariance of what the keyframe does to the line with the arm

    def together(one: slice, other: slice, covariance: Array) -> Array:
        own = np.sum((by_state[one] @ covariance) * by_state[other], axis=(1, 2))
        own += np.sum((by_arm[one] @ arm) * by_arm[other], axis=(1, 2))
        own += np.sum(by_both[one] * by_arm[other] + by_both[other] * by_arm[one], axis=(1, 2))
        return np.asarray(0.5 * own)

    everything = slice(None)
    own = together(everything, everything, known.keyframes)
    with_next = together(slice(0, -1), slice(1, None), known.neighbours)
    return np.stack([own, np.append(with_next, own[-1])], axis=1)
