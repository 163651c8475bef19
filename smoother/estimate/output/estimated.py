"""The result of a solved session, in one piece or in windows: state, covariances of its keyframes, and what holds for
all of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.config import SessionConfig
from smoother.disc import pieces
from smoother.estimate.factors.gnss import arm_axes
from smoother.estimate.factors.graph import Priors
from smoother.estimate.factors.rows import Between, Rows, after_step
from smoother.estimate.initial.guess import Start
from smoother.estimate.model.imu import BinnedImu, are_observed
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import (
    ACCEL_BIAS,
    COLUMNS,
    CONSTANTS_SIZE,
    GYRO_BIAS,
    KEYFRAME_SIZE,
    OFFSET,
    ROTATION,
    TRANSLATION,
    VELOCITY,
    State,
)
from smoother.estimate.output.joint import ChainPositions
from smoother.estimate.output.mounting import MIN_KEYFRAMES, are_at_speed
from smoother.estimate.output.residuals import NoiseUncertainty, inertial_statistics, noise_uncertainty
from smoother.estimate.solvers.covariance import Covariances
from smoother.estimate.solvers.identify import Solution
from smoother.trajectory import JointPosition, ResidualStatistics

PIECE = 256  # keyframes whose covariances stay in the processor's cache
_MOTION = slice(ROTATION.start, VELOCITY.stop)
ARM = COLUMNS["lever_arm"]


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances of the errors of K keyframes.

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
    """Mean angular rate (K, 3) rad/s in n of the arm, from each keyframe to the next."""
    turn = so3.log(R_arm[:-1].transpose(0, 2, 1) @ R_arm[1:]) / state.interval
    return np.asarray(np.einsum("kij,kj->ki", R_arm, np.concatenate([turn, turn[-1:]])))


def bend_covariance(state: State, known: Covariances) -> Array:
    """Covariance (K, 3, 3) m^2/s^2 of the cubic's velocity halfway to the next keyframe, less the mean of both ends'.

    With the noise of the samples between keyframes (`_between_samples` of dense_rows.py) it is the variance of velocity
    there beyond that of the keyframes, as in intervals without samples.
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

    Column 0: of each keyframe; column 1: covariance with the next one.
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


SAMPLES = 100  # keyframes whose errors are averaged; errors last for seconds or for the session
UNUSUAL = 4.0  # times the usual variance of an attitude


@dataclass(frozen=True, eq=False)
class Known:
    """Results that hold for all of a session, also where it is solved in windows.

    priors: before anything is held. constants_covariance (C, C). common_attitude (3, 3) rad^2: covariance in s of the
    mean error of all attitudes; zero where unknown. wheels_heading: variance, rad^2, of the heading of the kart by its
    sideslip, beyond that in the solution; None where the heading is not known from sideslip. offset_tau_spread: sigma
    of the logarithm of offset_tau, infinite where it is the population's. has_height: some fix has a height. drives:
    the kart went at a speed that shows the constants.
    """

    noise: Noise
    noise_uncertainty: NoiseUncertainty
    priors: Priors
    constants_covariance: Array
    common_attitude: Array
    wheels_heading: float | None
    offset_tau_spread: float
    has_height: bool
    drives: bool

    def prior_sigma(self, name: str) -> Array:
        """Prior sigma (size,) of a constant."""
        return np.asarray(np.minimum(self.priors.constants[name][1], self.noise.constants.get(name, np.inf)))


@dataclass(frozen=True, eq=False)
class Estimated:
    """state; rows by name, after the last step; joint: of positions, but for what no session can show; inertial: of the
    residuals of the IMU factors, by name.
    """

    state: State
    known: Known
    uncertainty: Uncertainty
    rows: Mapping[str, Rows]
    joint: JointPosition
    inertial: Mapping[str, ResidualStatistics] = field(default_factory=dict)


def known_from(solution: Solution, priors: Priors, start: Start, config: SessionConfig) -> Known:
    """Return the results of a start that hold for all of its session. priors: before any constant was held."""
    covariance, slip, first = solution.covariances.constants, priors.constants["slip"][1], COLUMNS["slip"].start
    uncertainty = noise_uncertainty(solution, slip)
    is_known = config.mounting.R_bs is None and covariance[first, first] < (0.5 * slip[0]) ** 2
    return Known(
        solution.noise,
        uncertainty,
        priors,
        covariance,
        common_attitude(solution, without_samples(start.binned)),
        uncertainty.wheels_heading if is_known else None,
        start.noise.offset_tau_spread,
        start.priors.has_height,
        start.priors.drives,
    )


def estimated(solution: Solution, known: Known) -> Estimated:
    """Return the result of a graph that was solved in one piece."""
    rows = rows_after(solution)
    return Estimated(
        solution.state,
        known,
        uncertainty_of(solution, known.wheels_heading),
        rows,
        ChainPositions(solution.step.state, solution.chain),
        inertial_statistics(rows.pop("imu"), slice(None)),
    )


def rows_after(solution: Solution) -> dict[str, Rows]:
    """Return the rows of all factors with the residuals after the last step."""
    step = solution.step
    return {name: after_step(rows, step.keyframes, step.constants) for name, rows in step.rows.items()}


def _fitted(state: State, unsampled: BoolArray | None) -> IntArray:
    """Keyframes that the mounting is fitted to, all where they are few."""
    sampled = np.ones(len(state.t), dtype=np.bool_) if unsampled is None else ~unsampled
    driven = are_at_speed(state) & sampled
    return np.flatnonzero(driven if np.count_nonzero(driven) >= MIN_KEYFRAMES else sampled)


def common_attitude(solution: Solution, unsampled: BoolArray | None) -> Array:
    """Covariance (3, 3) rad^2 in s of the mean error of attitude, from SAMPLES keyframes.

    unsampled (K,): keyframes without samples.
    """
    attitude = solution.covariances.keyframes[:, ROTATION, ROTATION]
    fitted = _fitted(solution.state, unsampled)
    fitted = fitted[fitted < len(attitude) - 1]
    usual = fitted[_usually_known(attitude[fitted])]
    at = np.repeat(usual[np.linspace(0, len(usual) - 1, SAMPLES).astype(np.int64)], 3)
    left = np.zeros((len(at), KEYFRAME_SIZE))
    left[:, ROTATION] = np.tile(np.eye(3), (SAMPLES, 1))
    joint = solution.chain.joint(at, left, np.zeros_like(left), np.zeros((len(at), CONSTANTS_SIZE)))
    return np.asarray(joint.reshape(SAMPLES, 3, SAMPLES, 3).mean(axis=(0, 2)))


def _usually_known(attitude: Array) -> IntArray:
    """Keyframes whose attitude, of covariance (K, 3, 3), has about the usual variance, as outside of gaps."""
    variance = np.einsum("kii->k", attitude)
    return np.flatnonzero(variance <= UNUSUAL * np.median(variance))


def attitude_variance(found: Estimated, R_bs: Array, unsampled: BoolArray | None) -> tuple[Array, Array]:
    """Mean variance (3,) rad^2, about the axes of b, of the attitudes that the mounting is fitted to, and its common
    part (3,). unsampled (K,): keyframes without samples.
    """
    fitted = _fitted(found.state, unsampled)
    some = fitted[:: max(1, len(fitted) // (10 * SAMPLES))]
    R_nb = found.state.R_ns[some] @ R_bs.T
    attitude = R_nb.transpose(0, 2, 1) @ found.uncertainty.antenna[some, 0:3, 0:3] @ R_nb
    attitude = attitude[_usually_known(attitude)]
    return np.einsum("kii->i", attitude) / len(attitude), np.diag(R_bs @ found.known.common_attitude @ R_bs.T)


def without_samples(binned: BinnedImu) -> BoolArray | None:
    """Mask (K,) of the keyframes whose attitude no samples measure, None without any."""
    sampled = are_observed(binned.missing)
    return None if np.all(sampled) else ~sampled
