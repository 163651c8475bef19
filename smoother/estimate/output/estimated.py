"""All that the output is made of, of a session that was solved in one piece or in windows."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.config import SessionConfig
from smoother.estimate.factors.graph import Priors
from smoother.estimate.factors.rows import Rows, after_step
from smoother.estimate.initial.guess import Start
from smoother.estimate.model.imu import BinnedImu, are_observed
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, KEYFRAME_SIZE, ROTATION, State
from smoother.estimate.output.joint import ChainPositions
from smoother.estimate.output.mounting import MIN_KEYFRAMES, are_at_speed
from smoother.estimate.output.noise_uncertainty import NoiseUncertainty, noise_uncertainty
from smoother.estimate.output.residual_statistics import inertial_statistics
from smoother.estimate.output.uncertainty import Uncertainty, uncertainty_of
from smoother.estimate.solvers.identify import Solution
from smoother.trajectory import JointPosition, ResidualStatistics

SAMPLES = 100  # keyframes whose errors are averaged; they last for seconds or for the session, so that these will do
UNUSUAL = 4.0  # times the usual variance of an attitude; standing and driving differ by less


@dataclass(frozen=True, eq=False)
class Known:
    """What holds for all of a session, also where it is solved in windows.

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
        """Sigma (size,) of a constant beforehand."""
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
    """Return what the solution of a start shows of all of its session. priors: those before any constant was held."""
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
    """Return what a graph that was solved in one piece says."""
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

    unsampled (K,): keyframes without samples, whose errors have nothing in common with those of others.
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
    """Keyframes whose attitude, of covariance (K, 3, 3), is known about as well as most are.

    Before the first sample or in a gap nothing measures it: one such keyframe would outweigh all others in a mean.
    """
    variance = np.einsum("kii->k", attitude)
    return np.flatnonzero(variance <= UNUSUAL * np.median(variance))


def attitude_variance(found: Estimated, R_bs: Array, unsampled: BoolArray | None) -> tuple[Array, Array]:
    """Mean variance (3,) rad^2, about the axes of b, of attitudes, and the part (3,) of it that all have in common.

    Of those that the mounting is fitted to. unsampled (K,): keyframes without samples.
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
