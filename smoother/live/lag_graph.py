"""The graph of a moving window: marginalised keyframes, their prior, and prediction of one keyframe."""

from dataclasses import dataclass, field, replace
from typing import Any

import gtsam
import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, block, linear_factors, put_in_blocks
from smoother.estimate.factors.graph import Graph
from smoother.estimate.factors.imu import imu_factors, imu_rows
from smoother.estimate.factors.rows import Rows
from smoother.estimate.factors.wheels import MOVING, slip_of, without_slides
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import (
    CONSTANTS_SIZE,
    DIMENSIONS,
    KEYFRAME_SIZE,
    KEYS,
    OF_KEYFRAMES,
    OFFSET,
    ROTATION,
    SIZES,
    TRANSLATION,
    State,
    keyframe_keys,
    vector_values,
)
from smoother.estimate.solvers.batch import Step
from smoother.estimate.solvers.covariance import Covariances
from smoother.frames import wrap_angle

_SUMS = ("velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")  # variables with additive steps
_MOTION = OFFSET.start  # columns of a keyframe that an IMU factor has


@dataclass(frozen=True, eq=False)
class WindowGraph(Graph):
    """The graph of the keyframes in a window. before: keyframes that left it, used by the low-pass of the motion."""

    before: State = field(kw_only=True)

    def rows(self, state: State) -> list[Rows]:
        """All rows of the window at `state`. Those of earlier keyframes are in the prior."""
        first, joined = len(self.before.t), joined_states(self.before, state)
        graph = replace(self, measured=replace(self.measured, rolls=rolling(joined, self.noise)))
        rows = [r.take(np.flatnonzero(r.interval >= first)) for r in Graph.rows(graph, joined)]
        return [replace(r, interval=r.interval - first) for r in rows]


@dataclass(frozen=True, eq=False)
class Marginal:
    """The marginal of eliminated keyframes on the first remaining one and the constants `names`.

    A (r, 18 + c + 1): whitened Jacobian by both and right side, of the difference from `at`, that keyframe.
    """

    A: Array
    names: tuple[str, ...]
    at: State

    @staticmethod
    def of(taken: Step, prior: gtsam.NonlinearFactorGraph, leave: int) -> "Marginal":
        """Eliminate the first `leave` keyframes of a step on a graph with `prior`."""
        rows = [r.take(np.flatnonzero(r.interval < leave)) for r in taken.rows.values()]
        system = linear_factors(rows, leave, taken.unknown)
        known = prior.linearize(taken.state.part(slice(0, 1)).values())
        for i in range(known.size()):
            put_in_blocks(known.at(i), taken.unknown, system)
        ordering = gtsam.Ordering([block(k) for k in range(leave)])
        _, left = system.eliminatePartialSequential(ordering, gtsam.EliminateQR)
        A = left.augmentedJacobian(gtsam.Ordering([block(leave), CONSTANTS_BLOCK]))
        return Marginal(A, taken.unknown, taken.state.part(slice(leave, leave + 1)))

    def moved_to(self, now: State) -> "Marginal":
        """The same where the keyframe is `now`, by its axes there: rotation and position move independently.

        GTSAM keeps the axes of the linearisation point, and retracts the position along a screw. Axes rotated by a
        degree against those of the measurements give spurious information on the position: on Adria's recording the
        path was 2 m off after minutes. Source: Huang, Mourikis & Roumeliotis 2010.
        """
        then, turn = self.at, self.at.R_ns[0].T @ now.R_ns[0]
        moves = [so3.log(turn), then.R_ns[0].T @ (now.position_n[0] - then.position_n[0])]
        moves += [getattr(now, name)[0] - getattr(then, name)[0] for name in _SUMS]
        moves += [now.constants[name] - then.constants[name] for name in self.names]
        A = self.A.copy()
        A[:, -1] -= self.A[:, :-1] @ np.concatenate(moves)
        A[:, ROTATION] = A[:, ROTATION] @ gtsam.Rot3.LogmapDerivative(moves[0])
        A[:, TRANSLATION] = A[:, TRANSLATION] @ turn
        return Marginal(A, self.names, now)

    def factors(self) -> gtsam.NonlinearFactorGraph:
        """The same as the prior of a window that begins with its keyframe."""
        keys = [*keyframe_keys(0), *(KEYS[name] for name in self.names)]
        sizes = [*DIMENSIONS, *(SIZES[name] for name in self.names), 1]
        factor = gtsam.GaussianConditional(keys, 1, gtsam.VerticalBlockMatrix(sizes, self.A))
        graph = gtsam.NonlinearFactorGraph()
        graph.add(gtsam.LinearContainerFactor(factor, self.at.values()))
        return graph


def rolling(state: State, noise: Noise) -> BoolArray | None:
    """Keyframes (K,) of a state at which wheels roll; None where this is unknown, by the noise of a whole session."""
    if noise.slip is None:
        return None
    slip = slip_of(state, LowPassedMotion(state, noise.inertial.accel, noise.inertial.gyro))
    moves = np.hypot(state.velocity_n[:, 0], state.velocity_n[:, 1]) > MOVING
    return without_slides(wrap_angle(slip.value * slip.level), moves, 0.0, state.interval)


def joined_states(one: State, two: State) -> State:
    """The keyframes of both, with the constants of the second."""
    both: dict[str, Any] = {name: np.concatenate([getattr(x, name) for x in (one, two)]) for name in OF_KEYFRAMES}
    return replace(two, **both)


def predicted(state: State, measured: gtsam.PreintegratedCombinedMeasurements, t: float, offset: float) -> State:
    """The state with one keyframe more, at t s. offset: share of the slow error of the fixes that remains then."""
    bias = gtsam.imuBias.ConstantBias(state.accel_bias_s[-1], state.gyro_bias_s[-1])
    pose = gtsam.Pose3(gtsam.Rot3(state.R_ns[-1]), state.position_n[-1])
    then = measured.predict(gtsam.NavState(pose, state.velocity_n[-1]), bias)
    newest = replace(
        state.part(slice(-1, None)),
        t=np.array([t]),
        R_ns=then.attitude().matrix()[None],
        position_n=then.position()[None],
        velocity_n=then.velocity()[None],
        offset_n=offset * state.offset_n[-1:],
    )
    return joined_states(state, newest)


def extrapolated(
    last: State, known: Covariances, measured: gtsam.PreintegratedCombinedMeasurements, t: float
) -> tuple[State, Covariances]:
    """A keyframe and the state at t s after it, with their covariances: by the IMU factor between both.

    known: covariances, of which the last keyframe's count.
    """
    two, interval = predicted(last, measured, t, 1.0), np.zeros(1, np.int64)
    values = two.values()
    rows = imu_rows(imu_factors([measured], interval).linearize(values), interval, two)
    by_last, by_then, by_constants = np.split(rows.jacobian()[0], [KEYFRAME_SIZE, 2 * KEYFRAME_SIZE], axis=1)
    root = np.linalg.inv(by_then[:, :_MOTION])
    moved, still = np.zeros((2, KEYFRAME_SIZE)), np.zeros(CONSTANTS_SIZE)
    moved[1, :_MOTION] = -root @ rows.residual[0]
    P, cross, S = known.keyframes[-1], known.with_constants[-1], known.constants
    J = -root @ np.hstack([by_last, by_constants])
    with_all = J @ np.block([[P, cross], [cross.T, S]])
    P_then, cross_then = np.zeros_like(P), np.zeros_like(cross)
    P_then[:_MOTION, :_MOTION], cross_then[:_MOTION] = with_all @ J.T + root @ root.T, with_all[:, KEYFRAME_SIZE:]
    neighbours = np.zeros((1, *P.shape))  # not used
    both = Covariances(np.stack([P, P_then]), neighbours, S, np.stack([cross, cross_then]))
    return two.with_values(values.retract(vector_values(moved, still))), both
