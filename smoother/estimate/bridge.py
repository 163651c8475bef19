"""Between the graph of GTSAM and the first edition's output; it goes with what it bridges.

Out: a Solution becomes the Solved that the output reads. Constants that the graph of GTSAM does not have (evenness,
delay of the course) stay zero, with no covariance.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.graph import WHEELS_BELOW, Priors
from smoother.estimate.factors.rows import Rows, after_step
from smoother.estimate.factors.wheels import slip_of
from smoother.estimate.graph import batch as old_batch
from smoother.estimate.graph import inertial as old_inertial
from smoother.estimate.graph import inputs
from smoother.estimate.graph import rows as old_rows
from smoother.estimate.graph import state as old
from smoother.estimate.graph.chain import ChainFactor, ChainSolution
from smoother.estimate.graph.estimated import Estimated, are_made_up, estimated
from smoother.estimate.graph.row_components import RowComponent
from smoother.estimate.graph.slip import DIFFERENT, FIT_SIGMA, MEMORY, PRIOR, SlipNoise, corners
from smoother.estimate.graph.solve import Say
from smoother.estimate.graph.solve import Solution as OldSolution
from smoother.estimate.graph.told import told_by
from smoother.estimate.graph.uncertainty import nose_variance
from smoother.estimate.graph.windows import WindowsSolution, is_long, solve_in_windows
from smoother.estimate.initial.compass import Compass
from smoother.estimate.initial.guess import Start, informed, problem_of
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.initial.parts import is_partly_sampled, longest_sampled
from smoother.estimate.model.heading import Heading
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, KEYFRAME_SIZE, State
from smoother.estimate.solvers.covariance import Chain
from smoother.estimate.solvers.identify import Sigmas, Solution, identify, solve_held, with_rectification
from smoother.estimate.solvers.incremental import solve_as_stream
from smoother.estimate.solvers.variance_components import SENSOR_SCALE
from smoother.samples import Session

PARTS = {
    "position_latency": old.POSITION_LATENCY,
    "velocity_latency": old.VELOCITY_LATENCY,
    "lever_arm": old.LEVER_ARM,
    "doppler_bias": old.DOPPLER_BIAS,
    "velocity_response": old.VELOCITY_RESPONSE,
    "heading_offset": old.HEADING_OFFSET,
    "slip": old.SLIP,
    "accel_scale": old.ACCEL_ERROR,
    "gyro_scale": old.GYRO_ERROR,
    "rectification": old.RECTIFICATION,
}
OURS = np.concatenate([np.arange(COLUMNS[name].start, COLUMNS[name].stop) for name in PARTS])
THEIRS = np.concatenate([np.arange(part.start, part.stop) for part in PARTS.values()])


def solve_part(
    session: Session, part: Start, noise: Noise, options: GraphOptions, say: Say
) -> tuple[Solution, OldSolution]:
    """Identify constants and noise of a part of a session that has samples throughout, from `noise`."""
    compass, wheels = Compass(session, part), options.wheels and part.wheels
    solved = identify(problem_of(part), noise, say, 1, wheels=wheels, heading=compass.heading)
    return solved, _old_solution(solved, part, compass)


def solve_window(session: Session, part: Start, noise: Noise, held: Array, options: GraphOptions) -> old_batch.Solved:
    """Solve a window with constants and noise that are known; held (C, C): covariance of the constants."""
    solve = solve_as_stream if options.solver == "isam2" else solve_held
    return solved_of(solve(problem_of(part), noise, held, Compass(session, part, is_level=True).heading))


def solve_session(
    session: Session, start: Start, options: GraphOptions, say: Say
) -> tuple[Start, Estimated, OldSolution | WindowsSolution]:
    """Identify constants and noise on the busiest part, then solve all of the session."""
    wheels, busiest = options.wheels and start.wheels, problem_of(longest_sampled(start))
    part = identify(busiest, busiest.usual, lambda share: say(0.5 * share))
    start = informed(session, start, options, part.state)
    if is_partly_sampled(start) or is_long(start):
        in_windows = solve_in_windows(session, start, part.noise, options, say)
        return start, in_windows.found, in_windows
    whole, compass = with_rectification(problem_of(start), part), Compass(session, start)
    solved = identify(
        whole,
        replace(part.noise, slip=None),
        lambda share: say(0.5 + 0.5 * share),
        1,
        wheels=wheels,
        sigmas=Sigmas.of(part.covariances),
        heading=compass.heading,
    )
    if options.solver == "isam2":
        held = replace(whole, state=replace(whole.state, constants=solved.state.constants))
        solved = solve_as_stream(held, solved.noise, solved.covariances.constants, compass.heading)
    solution = _old_solution(solved, start, compass)
    beyond = nose_variance(session, solution.noise)
    return start, estimated(solution.solved, beyond, are_made_up(start.binned)), solution


def _old_solution(solved: Solution, start: Start, compass: Compass) -> OldSolution:
    theirs = solved_of(solved)
    priors = old_priors(start.priors, compass.found)
    return OldSolution(theirs, noise_of(solved, theirs), priors, compass.problems, compass.found)


def chain_state(s: State) -> old.ChainState:
    """Return a state as one of the first edition."""
    vector = np.zeros(old.CONSTANTS_SIZE)
    for name, part in PARTS.items():
        vector[part] = s.constants[name]
    constants = old.Constants.from_vector(vector, s.geometry.level_axes_s, is_steered=s.geometry.is_steered)
    return old.ChainState(s.t, s.R_ns, s.position_n, s.velocity_n, s.accel_bias_s, s.gyro_bias_s, s.offset_n, constants)


def old_priors(p: Priors, heading: Heading | None) -> inputs.Priors:
    """Return priors as the first edition's."""
    mean, sigma = np.zeros(old.CONSTANTS_SIZE), np.full(old.CONSTANTS_SIZE, 1e-3)
    for name, part in PARTS.items():
        mean[part], sigma[part] = p.constants[name]
    if heading is not None:
        sigma[old.HEADING_OFFSET] = heading.offset_sigma
    of_biases = p.accel_bias, p.gyro_bias, p.gyro_bias_mean
    return inputs.Priors(*of_biases, mean, sigma, p.held_s is not None, p.has_height, p.drives)


class ChainOfGtsam:
    """A ChainFactor: joint covariances of a chain of GTSAM, by the first edition's columns."""

    def __init__(self, chain: Chain) -> None:
        self._chain = chain

    def covariance(self, first: IntArray, left: Array, right: Array, constants: Array) -> Array:
        """Covariance (q, q) of q functions, as Chain.joint."""
        ours = np.zeros((len(first), CONSTANTS_SIZE))
        ours[:, OURS] = constants[:, THEIRS]
        return self._chain.joint(first, left, right, ours)

    def thinnable(self, times: int) -> int:
        """As often as is asked for."""
        return times

    def thinned(self, times: int, keep: Callable[[Array], Array]) -> ChainFactor:
        """Return the factor of the first, third .. keyframes alone, `times` over; `keep` copies its arrays."""
        chain = self._chain.thinned(2**times)
        gain, influence, root = (keep(values) for values in (chain.gain, chain.influence, chain.root))
        return cast(ChainFactor, ChainOfGtsam(Chain(gain, influence, root, chain.constants)))


def rows_of(r: Rows) -> old_rows.Rows:
    """Return rows in the first edition's type."""
    constants = np.zeros((*r.residual.shape, old.ROW_CONSTANTS_SIZE))
    for name, block in r.constants.items():
        constants[:, :, PARTS[name]] = block
    return old_rows.Rows(r.name, r.interval, r.residual, r.sigma, r.left, r.right, constants, r.weight)


def solved_of(s: Solution) -> old_batch.Solved:
    """Return a solution in the first edition's type."""
    step, c, n = s.step, s.covariances, old.CONSTANTS_SIZE
    keyframes = len(step.state.t)
    constants, own, cross = np.zeros(n), np.zeros((n, n)), np.zeros((keyframes, KEYFRAME_SIZE, n))
    constants[THEIRS], own[np.ix_(THEIRS, THEIRS)] = step.constants[OURS], c.constants[np.ix_(OURS, OURS)]
    cross[:, :, THEIRS] = c.with_constants[:, :, OURS]
    solution = ChainSolution(
        step.keyframes, constants, c.keyframes, c.neighbours, own, cross, cast(ChainFactor, ChainOfGtsam(s.chain))
    )
    whitened = np.zeros((keyframes - 1, 15, 46))
    imu = step.rows["imu"]
    whitened[imu.interval, :, :15], whitened[imu.interval, :, 15:30] = imu.left[:, :, :15], imu.right[:, :, :15]
    by_constants = np.concatenate(list(imu.constants.values()), axis=2)
    whitened[imu.interval, :, 30 : 30 + by_constants.shape[2]] = by_constants
    whitened[imu.interval, :, 45] = imu.residual
    rows = {
        name: rows_of(after_step(r, step.keyframes, step.constants)) for name, r in step.rows.items() if name != "imu"
    }
    inertial = old_inertial.LinearInertial(whitened)
    return old_batch.Solved(chain_state(s.state), chain_state(step.state), solution, inertial, rows, None)


def noise_of(s: Solution, solved: old_batch.Solved) -> inputs.Noise:
    """Return the noise that was found, in the first edition's type."""
    n, found = s.noise, s.components
    force, rate = (
        old_inertial.VarianceComponent(c.squares_of, c.redundancy_of, c.squares_in, c.redundancy_in)
        for c in (found.force, found.rate)
    )
    position, velocity = (RowComponent(c.squares, c.expected) for c in (found.position, found.velocity))
    spread = np.array([float(n.constants[name][0]) if n.constants else 0.0 for name in SENSOR_SCALE])
    of_fixes = n.position, n.velocity, n.offset_sigma, n.offset_tau
    noise = inputs.Noise(n.inertial, *of_fixes, spread, n.offset_tau_spread, offset_most=n.offset_most)
    noise = replace(noise, told=told_by(solved, noise, (force, rate), (position, velocity)))
    return noise if n.slip is None else replace(noise, slip=_slip_noise(s, n.slip))


def _slip_noise(s: Solution, sigma: float) -> SlipNoise:
    slip, rolls = slip_of(s.state, LowPassedMotion(s.state, WHEELS_BELOW)), s.graph.measured.rolls
    assert rolls is not None
    k = np.flatnonzero(rolls)
    by = slip.by_constants[k]
    fit = np.linalg.solve(by.T @ by + np.diag((FIT_SIGMA / PRIOR) ** 2), by.T @ slip.value[k])
    different = min(DIFFERENT, len(k) * s.state.interval / (2.0 * MEMORY), corners(by[:, 1] / by[:, 0]))
    moments = by.T @ by / len(k)
    return SlipNoise(sigma, 0.0, 0.0, moments, different, apart=float(fit[0]), shown=float(len(k)))
