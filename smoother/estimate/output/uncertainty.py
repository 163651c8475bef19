"""What is known of the errors of keyframes: of the antenna, of the biases, and of the line among the fixes."""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.disc import pieces
from smoother.estimate.graph.arm import arm_axes, turning_arm
from smoother.estimate.graph.batch import Solved
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.inputs import Noise
from smoother.estimate.graph.slip import tells_nose
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    GYRO_BIAS,
    KEYFRAME_SIZE,
    LEVER_ARM,
    OFFSET,
    ROTATION,
    SLIP,
    TRANSLATION,
    VELOCITY,
    ChainState,
)
from smoother.samples import Session

PIECE = 256  # keyframes whose covariances stay in the processor's cache
_MOTION = slice(ROTATION.start, VELOCITY.stop)


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """What is known of the errors of K keyframes.

    antenna (K, 9, 9): covariance of the errors in n of the sensor's attitude, the antenna's velocity and its position;
    biases (K, 6): sigmas of force and rate; track (K, 2) m^2: see :func:`track_variance`; bend (K, 3, 3) m^2/s^2:
    see :func:`bend_covariance`.
    """

    antenna: Array
    biases: Array
    track: Array
    bend: Array


def nose_variance(session: Session, noise: Noise) -> float | None:
    """Variance, rad^2, of where slip has the nose, beyond the graph's own; None where it is stated, or not by slip."""
    return None if noise.slip is None or session.config.mounting.R_bs is not None else noise.slip.nose_variance


def uncertainty_of(solved: Solved, nose: float | None) -> Uncertainty:
    """Return sigmas and covariances of the antenna at the keyframes of a solved graph.

    nose: variance, rad^2, of where slip has the nose beyond that in `solved`; None where the nose is not by slip.
    """
    state, P = solved.linearised_at, solved.solution.covariance
    R, R_arm, R_turning = state.R_ns, arm_axes(state), turning_arm(state)
    K, turn_n, arm_n = len(state.t), _turning(state), R_arm @ state.constants.lever_arm_s
    swing_n = np.cross(turn_n, arm_n)
    # errors in n of (attitude, velocity, position) by rotation, translation and velocity of the keyframe and by the arm
    J, C = np.zeros((K, 9, 9)), np.zeros((K, 9, 3))
    J[:, 0:3, ROTATION] = R
    J[:, 3:6, ROTATION], J[:, 3:6, VELOCITY] = -so3.skew(swing_n) @ R_turning, np.eye(3)
    J[:, 6:9, ROTATION], J[:, 6:9, TRANSLATION] = -so3.skew(arm_n) @ R_turning, R
    C[:, 3:6], C[:, 6:9] = so3.skew(turn_n) @ R_arm, R_arm
    columns, S = np.arange(LEVER_ARM.start, LEVER_ARM.stop), solved.solution.constants_covariance
    beyond = nose if tells_nose(S[SLIP.start, SLIP.start]) else None
    if beyond is not None:  # where slip has the nose, its error is one of the kart's attitude
        columns, C = np.append(columns, SLIP.start), np.concatenate([C, np.zeros((K, 9, 1))], axis=2)
        C[:, 2, 3] = 1.0
    S, with_constants = S[np.ix_(columns, columns)], solved.solution.constants_cross
    antenna = np.empty((K, 9, 9))
    for part in pieces(K, PIECE):
        J_t, C_t = J[part].transpose(0, 2, 1), C[part].transpose(0, 2, 1)
        cross = J[part] @ with_constants[part, _MOTION][:, :, columns] @ C_t
        antenna[part] = J[part] @ P[part, _MOTION, _MOTION] @ J_t + C[part] @ S @ C_t
        antenna[part] += cross + cross.transpose(0, 2, 1)
    if beyond is not None:
        antenna[:, 2, 2] += beyond
    sigma = np.sqrt(np.einsum("kii->ki", P)[:, ACCEL_BIAS.start : GYRO_BIAS.stop])
    return Uncertainty(antenna, sigma, track_variance(state, solved.solution), bend_covariance(state, solved.solution))


def _turning(state: ChainState) -> Array:
    """Mean angular rate (K, 3) rad/s in n, of what the arm keeps to, from each keyframe to the next."""
    R = arm_axes(state)
    turn = so3.log(R[:-1].transpose(0, 2, 1) @ R[1:]) / state.interval
    return np.asarray(np.einsum("kij,kj->ki", R, np.concatenate([turn, turn[-1:]])))


def bend_covariance(state: ChainState, solution: ChainSolution) -> Array:
    """Covariance (K, 3, 3) m^2/s^2 of the cubic's velocity halfway to the next keyframe, less the mean of both ends'.

    Where Doppler holds the keyframes more tightly than the samples hold the way from one to the next, the velocity is
    better known at them than between: with what the samples' noise adds there (`_between_samples` of output.py). Where
    the samples are good both cancel out. What the antenna's swing is unsure by changes slowly and is left out.
    """
    moved, T = slice(TRANSLATION.start, VELOCITY.stop), state.interval
    halfway = np.zeros((len(state.t), 3, 6))
    halfway[:, :, :3], halfway[:, :, 3:] = 1.5 / T * state.R_ns, -0.25 * np.eye(3)
    before = halfway[:-1] * np.repeat([-1.0, 1.0], 3)
    own, cross = solution.covariance[:, moved, moved], solution.cross[:, moved, moved]
    after_t = halfway[1:].transpose(0, 2, 1)
    with_next = before @ cross @ after_t
    bend = before @ own[:-1] @ before.transpose(0, 2, 1) + halfway[1:] @ own[1:] @ after_t
    bend += with_next + with_next.transpose(0, 2, 1) - 0.5 * (own[:-1, 3:, 3:] + own[1:, 3:, 3:])
    return np.concatenate([bend, bend[-1:]])


def track_variance(state: ChainState, solution: ChainSolution) -> Array:
    """Variance of the antenna's position plus offset, the line in the frame of the fixes, (K, 2) m^2 per level axis.

    Of each keyframe, and together with the next one: the offset is rough, and between two keyframes it is their mean.
    The antenna is where the arm has it: arm and latency err together, by what the sensor itself is not off.
    """
    K, R_arm = len(state.t), arm_axes(state)
    by_state, by_arm = np.zeros((K, 2, KEYFRAME_SIZE)), R_arm[:, :2]
    by_state[:, :, ROTATION] = (-so3.skew(R_arm @ state.constants.lever_arm_s) @ turning_arm(state))[:, :2]
    by_state[:, :, TRANSLATION], by_state[:, :, OFFSET] = state.R_ns[:, :2], np.eye(3)[:2]
    arm, with_arm = solution.constants_covariance[LEVER_ARM, LEVER_ARM], solution.constants_cross[:, :, LEVER_ARM]
    by_both = by_state @ with_arm  # (K, 2, 3), covariance of what the keyframe does to the line with the arm

    def together(one: slice, other: slice, covariance: Array) -> Array:
        own = np.sum((by_state[one] @ covariance) * by_state[other], axis=(1, 2))
        own += np.sum((by_arm[one] @ arm) * by_arm[other], axis=(1, 2))
        own += np.sum(by_both[one] * by_arm[other] + by_both[other] * by_arm[one], axis=(1, 2))
        return np.asarray(0.5 * own)

    everything = slice(None)
    own = together(everything, everything, solution.covariance)
    with_next = together(slice(0, -1), slice(1, None), solution.cross)
    return np.stack([own, np.append(with_next, own[-1])], axis=1)
