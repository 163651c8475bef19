"""Batch solution of the graph: Gauss-Newton with robust weights, for noise that is given.

GTSAM preintegrates the inertial samples; increments.py and session_rows.py linearise; chain.py solves the whole chain
and returns the covariance of every keyframe in the same sweep. How noisy the session is, components.py tells by what
is left of such a solution; solve.py takes turns between the two.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, are_near
from smoother.estimate.graph.chain import ChainSolution, ChainSystem, moved_on, solve_chain
from smoother.estimate.graph.expected import ExpectedMotion
from smoother.estimate.graph.imu import BinnedImu, DensePath, are_told, corrected, dense_path
from smoother.estimate.graph.inertial import (
    InertialGraph,
    LinearInertial,
    add_inertial,
    empty_system,
    set_apart,
)
from smoother.estimate.graph.inputs import Data, Noise, Priors, constants_sigma
from smoother.estimate.graph.normal_equations import add_constants_prior, add_rows
from smoother.estimate.graph.relaxation import Relaxation
from smoother.estimate.graph.rows import Rows, after_step
from smoother.estimate.graph.sampled import are_unsampled
from smoother.estimate.graph.session_rows import expected_of, session_rows, slip_rows_of, steadying_rows, unsteady_share
from smoother.estimate.graph.slip import (
    Slip,
    SlipNoise,
    is_of_wheels,
    slip_after_step,
    slip_noise,
    slip_of,
)
from smoother.estimate.graph.state import (
    CONSTANTS_SIZE,
    LEVER_ARM,
    POSITION_LATENCY,
    ROTATION,
    SLIP,
    TRANSLATION,
    VELOCITY,
    ChainState,
)

CONVERGED = ((ROTATION, 5e-4), (TRANSLATION, 5e-3), (VELOCITY, 5e-3))  # rad, m, m/s: far below any sigma
# rad, m, m/s, three of each: how far a keyframe without samples may be off the path of the fixes
APART = np.repeat([3.0, 1e3, 1e2], 3)
HELD = 1e-4  # m, sigma of an arm whose height is held: it does not move by a digit
NEAR_FIX = 1.0  # s; beyond, a direction of the path is what the samples add up to


@dataclass(frozen=True, eq=False)
class Solved:
    """A linearised, solved graph at `state`: the state itself, its covariances and the rows they came from.

    linearised_at: the state before the step. Covariances are in its axes: turned along with what a step of some degrees
    moved attitudes by, positions would lend velocities their metres.
    Residuals of rows and slip are those after the step, those of inertial before it: only some are asked for.
    """

    state: ChainState
    linearised_at: ChainState
    solution: ChainSolution
    inertial: LinearInertial
    rows: dict[str, Rows]
    slip: Slip | None = None


@dataclass(frozen=True, eq=False)
class DrivenMotion:
    """The dense path of a state, and the motion expected along it."""

    path: DensePath
    felt: ExpectedMotion


@dataclass(frozen=True, eq=False)
class Linear:
    """A graph linearised at `state`, not solved: its normal equations, and what they came from."""

    state: ChainState
    system: ChainSystem
    inertial: LinearInertial
    rows: dict[str, Rows]
    slip: Slip | None


class Batch:
    """One session's graph. Data and inertial bins are fixed; states and noise go in and come out."""

    def __init__(self, data: Data, binned: BinnedImu, priors: Priors) -> None:
        self._data = data
        self._binned = binned
        self._priors = priors
        self._told = are_told(binned.missing)

    def graph(self, state: ChainState, noise: Noise) -> InertialGraph:
        """Preintegrate the inertial samples about the mean biases and the sensor errors of `state`."""
        biases = state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)
        return InertialGraph(self.bins(state), noise.inertial, *biases, state.constants)

    def bins(self, state: ChainState) -> BinnedImu:
        """Inertial bins with the state's errors of scale and misalignment and rectified vibration taken out."""
        return corrected(self._binned, state.constants)

    def converge(self, graph: InertialGraph, state: ChainState, noise: Noise, iterations: int) -> ChainState:
        """Gauss-Newton from `state`, at most `iterations` steps, shortened where the constants swing."""
        relaxation = Relaxation()
        for _ in range(iterations):
            state, step = self.move(graph, state, noise, relaxation)
            if converged(step.x):
                break
        return state

    def approach(
        self, graph: InertialGraph, state: ChainState, noise: Noise, near: float, iterations: int
    ) -> ChainState:
        """Gauss-Newton of the keyframes alone, the constants held, until attitudes move by less than `near` rad, rms.

        At most `iterations`. While attitudes are off by degrees, steps of the constants lead astray, and coming back
        takes more steps. With wheels, `state` was found without.
        """
        for i in range(iterations):
            linear = self.linear(graph, state, noise, was_without_wheels=i == 0)
            step = solve_chain(_of_keyframes(linear.system), with_covariance=False)
            state = state.retract(step.x, np.zeros(CONSTANTS_SIZE))
            if math.sqrt(float(np.mean(np.sum(step.x[:, ROTATION] ** 2, axis=1)))) < near:
                break
        return state

    def step(
        self,
        graph: InertialGraph,
        state: ChainState,
        noise: Noise,
        relaxation: Relaxation | None = None,
        held: Array | None = None,
        free: slice | None = None,
        *,
        was_without_wheels: bool = False,
    ) -> Solved:
        """One Gauss-Newton step with its covariance; residuals as :class:`Solved` says.

        relaxation: what the steps before tell of how far to go; None goes all the way.
        held (31, 31) is the covariance of constants that are to stay where they are, all but those that are free.
        was_without_wheels: `state` was found without wheels, which `noise` asks for.
        """
        linear = self.linear(graph, state, noise, was_without_wheels=was_without_wheels)
        solution = solve_chain(linear.system, held=held, free=free)
        return _solved(linear, solution, 1.0 if relaxation is None else relaxation.share(solution))

    def move(
        self, graph: InertialGraph, state: ChainState, noise: Noise, relaxation: Relaxation
    ) -> tuple[ChainState, ChainSolution]:
        """Like :meth:`step`, without a covariance but that of the constants: the state, and the whole step."""
        solution = solve_chain(self.linear(graph, state, noise).system, with_covariance=False)
        share = relaxation.share(solution)
        return state.retract(share * solution.x, share * solution.constants), solution

    def path(self, state: ChainState) -> DensePath:
        """Dense path through the keyframes of `state`."""
        return dense_path(
            self.bins(state), state.R_ns, state.position_n, state.velocity_n, state.accel_bias_s, state.gyro_bias_s
        )

    def motion(self, state: ChainState, noise: Noise) -> DrivenMotion:
        """Return the dense path of `state`, and the motion expected along it."""
        path = self.path(state)
        return DrivenMotion(path, expected_of(self._data, path, state, noise))

    def with_slip(self, solved: Solved, noise: Noise, motion: DrivenMotion) -> Noise:
        """Return the noise with the slip that shows in what was solved without any; motion: that of its state."""
        slip = self._slip(solved.state, motion)
        return replace(noise, slip=slip_noise(slip, solved.solution, solved.state.interval))

    def is_of_wheels(self, state: ChainState, noise: Noise) -> bool:
        """Whether what was solved without wheels slips as the constants say."""
        if noise.slip is None:
            return False
        return is_of_wheels(self._slip(state, self.motion(state, noise)), noise.slip.unsure, state.interval)

    def roll(self, linear: Linear, motion: DrivenMotion, gone: Array, slip_noise: SlipNoise, held: Array) -> Solved:
        """Solve what was linearised without wheels once more with them. motion: that of its state.

        All constants but those of slip go on by gone (31,), as they would without wheels; held (31, 31) is their
        covariance.
        """
        slip = self._slip(linear.state, motion)
        rows = slip_rows_of(slip, linear.state.interval, slip_noise, was_without_wheels=True)
        add_rows(linear.system, rows)
        solution = solve_chain(moved_on(linear.system, gone), held=held, free=SLIP)
        solution = replace(solution, constants=gone + solution.constants)
        return _solved(replace(linear, rows=linear.rows | {r.name: r for r in rows}, slip=slip), solution, 1.0)

    def _slip(self, state: ChainState, motion: DrivenMotion) -> Slip:
        return slip_of(state, motion.path, motion.felt, self._told, are_near(state.t, self._data.t, NEAR_FIX))

    def linear(
        self,
        graph: InertialGraph,
        state: ChainState,
        noise: Noise,
        motion: DrivenMotion | None = None,
        *,
        was_without_wheels: bool = False,
    ) -> Linear:
        """Linearise at `state`. motion: that of it with this noise, where it is known already.

        was_without_wheels: `state` was found without wheels, which `noise` asks for.
        """
        motion = self.motion(state, noise) if motion is None else motion
        path, felt = motion.path, motion.felt
        inertial = graph.linearize(state, noise.inertial, felt.means(self._binned.n_bins))
        if self._data.sampled is not None:
            apart = are_unsampled(self._data.sampled, state.t[:-1], state.t[1:])
            duration = state.interval + self._data.pauses.between(state.t)
            set_apart(inertial, apart, state, noise.inertial, APART, duration)
        rows = {r.name: r for r in session_rows(self._data, self._priors, path, felt, state, noise)}
        slip, share = None, unsteady_share(state, noise)
        if noise.slip is not None or share > 0.0:
            slip = self._slip(state, motion)
        if slip is not None and share > 0.0:
            steadying = steadying_rows(state, slip, share, with_path=noise.slip is None)  # slip asks for more of it
            rows.update({r.name: r for r in steadying})
        if slip is not None and noise.slip is not None:
            of_slip = slip_rows_of(slip, state.interval, noise.slip, was_without_wheels=was_without_wheels)
            rows.update({r.name: r for r in of_slip})
        system = empty_system(len(state.t))
        add_inertial(system, inertial)
        add_rows(system, list(rows.values()))
        prior = self._priors
        difference = state.constants.as_vector() - prior.constants
        add_constants_prior(system, difference, constants_sigma(prior, noise))
        if prior.holds_height:
            up_s = state.constants.level_axes_s[2]
            system.corner[LEVER_ARM, LEVER_ARM] += np.outer(up_s, up_s) / HELD**2
        return Linear(state, system, inertial, rows, slip)


def _solved(linear: Linear, solution: ChainSolution, share: float) -> Solved:
    """Return the state after a `share` of the step, with the residuals that :class:`Solved` says."""
    return Solved(
        linear.state.retract(share * solution.x, share * solution.constants),
        linear.state,
        solution,
        linear.inertial,
        {name: after_step(r, solution.x, solution.constants) for name, r in linear.rows.items()},
        None if linear.slip is None else slip_after_step(linear.slip, solution.x, solution.constants),
    )


def converged(step: Array) -> bool:
    """Whether a step (K, 18) is too small to matter."""
    return all(float(np.max(np.abs(step[:, part]))) < limit for part, limit in CONVERGED)


def variances(solution: ChainSolution) -> Array:
    """Variances (K, 18) of the keyframes."""
    return np.asarray(np.einsum("kii->ki", solution.covariance))


def moved(solution: ChainSolution, variance: Array) -> float:
    """Root mean square of a step of attitude and velocity, each over its sigma; variance (K, 18)."""
    squares = (np.mean(solution.x[:, part] ** 2 / variance[:, part]) for part in (ROTATION, VELOCITY))
    return math.sqrt(float(max(squares)))


def constants_moved(solution: ChainSolution) -> float:
    """Root mean square of a step of latencies and lever arm, each over its sigma."""
    part = slice(POSITION_LATENCY.start, LEVER_ARM.stop)
    sigma2 = np.diag(solution.constants_covariance)[part]
    return math.sqrt(float(np.mean(solution.constants[part] ** 2 / sigma2)))


def _of_keyframes(system: ChainSystem) -> ChainSystem:
    """Return the system without the constants: they stay where they are."""
    n_keyframes, n = system.rhs.shape
    none = np.empty((n_keyframes, n, 0))
    return replace(system, border=none, corner=np.empty((0, 0)), rhs_constants=np.empty(0))
