"""What a solved graph says, of one piece or of windows, and how errors of attitude hang together over a session."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.graph.batch import Solved
from smoother.estimate.graph.imu import BinnedImu, are_told
from smoother.estimate.graph.joint import ChainJoint
from smoother.estimate.graph.leftovers import left_of_inertial
from smoother.estimate.graph.mounting import (
    MIN_KEYFRAMES,
    are_driven,
)
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.state import (
    CONSTANTS_SIZE,
    KEYFRAME_SIZE,
    ROTATION,
    ChainState,
)
from smoother.estimate.graph.uncertainty import Uncertainty, uncertainty_of
from smoother.trajectory import (
    JointPosition,
    ResidualStatistics,
)

SAMPLES = 100  # keyframes whose errors are averaged; they last for seconds or for the session, so that these will do
UNUSUAL = 4.0  # times the usual variance of an attitude; standing and driving differ by less


@dataclass(frozen=True, eq=False)
class Estimated:
    """What a solved graph says, of one piece or of windows: all that the output is made of.

    joint: how errors hang together, given the variance (3,) m^2 that the session cannot show; None where unknown.
    common_attitude (3, 3) rad^2: covariance in s of the mean error of all attitudes; zero where unknown.
    inertial: what is left of the inertial factors, by name.
    """

    state: ChainState
    constants_covariance: Array
    uncertainty: Uncertainty
    rows: dict[str, Rows]
    joint: Callable[[Array], JointPosition] | None
    common_attitude: Array = field(default_factory=lambda: np.zeros((3, 3)))
    inertial: Mapping[str, ResidualStatistics] = field(default_factory=dict)


def estimated(solved: Solved, nose: float | None, made_up: BoolArray | None) -> Estimated:
    """Return what a graph that was solved in one piece says; nose, rad^2, as for :func:`uncertainty_of`.

    made_up (K,): as for :func:`common_attitude`.
    """
    at, factor = solved.linearised_at, solved.solution.factor
    return Estimated(
        solved.state,
        solved.solution.constants_covariance,
        uncertainty_of(solved, nose),
        solved.rows,
        None if factor is None else lambda unseen: ChainJoint(at, factor, unseen),
        common_attitude(solved, made_up),
        left_of_inertial(solved, slice(None)),
    )


def _told(state: ChainState, made_up: BoolArray | None) -> IntArray:
    """Keyframes that the mounting is fitted to, all where they are few: what it takes out of others' errors is less.

    made_up (K,): keyframes without samples, which tell nothing.
    """
    sampled = np.ones(len(state.t), dtype=np.bool_) if made_up is None else ~made_up
    driven = are_driven(state) & sampled
    return np.flatnonzero(driven if np.count_nonzero(driven) >= MIN_KEYFRAMES else sampled)


def common_attitude(solved: Solved, made_up: BoolArray | None) -> Array:
    """Covariance (3, 3) rad^2 in s of the mean error of attitude, from SAMPLES keyframes; zero where it is not known.

    made_up (K,): keyframes without samples, whose errors have nothing in common with those of others.
    """
    factor, attitude = solved.solution.factor, solved.solution.covariance[:, ROTATION, ROTATION]
    if factor is None:
        return np.zeros((3, 3))
    told = _told(solved.state, made_up)
    told = told[told < len(attitude) - 1]
    known = told[_usually_known(attitude[told])]
    at = np.repeat(known[np.linspace(0, len(known) - 1, SAMPLES).astype(np.int64)], 3)
    left = np.zeros((len(at), KEYFRAME_SIZE))
    left[:, ROTATION] = np.tile(np.eye(3), (SAMPLES, 1))
    joint = factor.covariance(at, left, np.zeros_like(left), np.zeros((len(at), CONSTANTS_SIZE)))
    return np.asarray(joint.reshape(SAMPLES, 3, SAMPLES, 3).mean(axis=(0, 2)))


def _usually_known(attitude: Array) -> IntArray:
    """Keyframes whose attitude, of covariance (K, 3, 3), is known about as well as most are.

    Before the first sample or in a gap nothing tells it: one such keyframe would outweigh all others in a mean.
    """
    variance = np.einsum("kii->k", attitude)
    return np.flatnonzero(variance <= UNUSUAL * np.median(variance))


def attitude_variance(found: Estimated, R_bs: Array, made_up: BoolArray | None) -> tuple[Array, Array]:
    """Mean variance (3,) rad^2, about the axes of b, of attitudes, and the part (3,) of it that all have in common.

    Of those that the mounting is fitted to. made_up (K,): keyframes without samples.
    """
    told = _told(found.state, made_up)
    some = told[:: max(1, len(told) // (10 * SAMPLES))]
    R_nb = found.state.R_ns[some] @ R_bs.T
    attitude = R_nb.transpose(0, 2, 1) @ found.uncertainty.antenna[some, 0:3, 0:3] @ R_nb
    attitude = attitude[_usually_known(attitude)]
    return np.einsum("kii->i", attitude) / len(attitude), np.diag(R_bs @ found.common_attitude @ R_bs.T)


def are_made_up(binned: BinnedImu) -> BoolArray | None:
    """Mask (K,) of the keyframes that the mounting is not fitted to since no samples tell them, None without any."""
    sampled = are_told(binned.missing)
    return None if np.all(sampled) else ~sampled
