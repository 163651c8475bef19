"""Between the first edition's preparation and output and the graph of GTSAM; it goes with what it bridges.

In: a Start becomes a Problem. Out: a Solution becomes the Solved that the output reads. Constants that the graph of
GTSAM does not have (evenness, delay of the course) stay zero, with no covariance.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.factors.graph import WHEELS_BELOW, Measurements, Priors, table_without
from smoother.estimate.factors.ground import far_from_heights
from smoother.estimate.factors.heading import heading_rows
from smoother.estimate.factors.motion_prior import unsampled
from smoother.estimate.factors.rows import Rows, after_step
from smoother.estimate.factors.wheels import slip_of
from smoother.estimate.graph import batch as old_batch
from smoother.estimate.graph import inertial as old_inertial
from smoother.estimate.graph import inputs
from smoother.estimate.graph import rows as old_rows
from smoother.estimate.graph import state as old
from smoother.estimate.graph.chain import ChainFactor, ChainSolution
from smoother.estimate.graph.estimated import Estimated, are_made_up, estimated
from smoother.estimate.graph.first_noise import scatter_of
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.parts import is_partly_sampled
from smoother.estimate.graph.row_components import RowComponent
from smoother.estimate.graph.slip import DIFFERENT, FIT_SIGMA, MEMORY, PRIOR, SlipNoise, corners
from smoother.estimate.graph.solve import Say, with_heading
from smoother.estimate.graph.solve import Solution as OldSolution
from smoother.estimate.graph.start import Start, informed
from smoother.estimate.graph.told import told_by
from smoother.estimate.graph.uncertainty import nose_variance
from smoother.estimate.graph.windows import WindowsSolution, is_long, solve_in_windows
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, KEYFRAME_SIZE, Geometry, State
from smoother.estimate.solvers.covariance import Chain
from smoother.estimate.solvers.identify import Problem, Sigmas, Solution, identify, solve_held, with_rectification
from smoother.estimate.solvers.variance_components import Scatter
from smoother.samples import Problem as SessionProblem
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
DENSITIES = ("accel_noise", "gyro_noise", "accel_bias_walk", "gyro_bias_walk")


def solve_part(session: Session, part: Start, noise: inputs.Noise, options: GraphOptions, say: Say) -> OldSolution:
    """Identify constants and noise of a part of a session that has samples throughout, from `noise`."""
    problem, _ = problem_of(part, options)
    field = _Field(session, part)
    wheels = options.wheels and part.wheels
    solved = identify(problem, noise_before(noise), say, 1, wheels=wheels, heading=field.heading)
    theirs = solved_of(solved)
    return OldSolution(theirs, noise_of(solved, theirs, part.noise), field.priors, field.problems, field.data.heading)


def solve_window(
    session: Session, part: Start, noise: inputs.Noise, held: Array, options: GraphOptions
) -> old_batch.Solved:
    """Solve a window with constants and noise that are known; held (31, 31): covariance of the constants."""
    problem, _ = problem_of(part, options)
    covariance = np.zeros((CONSTANTS_SIZE, CONSTANTS_SIZE))
    covariance[np.ix_(OURS, OURS)] = held[np.ix_(THEIRS, THEIRS)]
    slip = None if noise.slip is None else noise.slip.sigma
    known = replace(noise_before(noise), slip=slip)
    return solved_of(solve_held(problem, known, covariance, _LevelField(session, part).heading))


def solve_with_gtsam(
    session: Session, start: Start, options: GraphOptions, say: Say, doubted: BoolArray
) -> tuple[Start, Estimated, OldSolution | WindowsSolution]:
    """Identify constants and noise on the busiest part, then solve all of the session, with the graph of GTSAM."""
    wheels = options.wheels and start.wheels
    problem, noise = problem_of(start, options)
    part = identify(problem, noise, lambda share: say(0.5 * share))
    state = part.state
    biases = state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)
    first = start.noise
    start = informed(session, start, options, chain_state(state).constants, biases, doubted)
    if is_partly_sampled(start) or is_long(start):
        in_windows = solve_in_windows(session, start, noise_of(part, solved_of(part), first), options, say)
        return start, in_windows.found, in_windows
    whole, _ = problem_of(start, options)
    whole = with_rectification(replace(whole, state=replace(whole.state, constants=state.constants)), part)
    field = _Field(session, start)
    noise = replace(part.noise, slip=None)
    solved = identify(
        whole,
        noise,
        lambda share: say(0.5 + 0.5 * share),
        1,
        wheels=wheels,
        sigmas=Sigmas.of(part.covariances),
        heading=field.heading,
    )
    theirs = solved_of(solved)
    found = noise_of(solved, theirs, start.noise)
    solution = OldSolution(theirs, found, field.priors, field.problems, field.data.heading)
    return start, estimated(theirs, nose_variance(session, found), are_made_up(start.binned)), solution


@dataclass
class _Field:
    """What the magnetometer is worth, once it was asked."""

    session: Session
    start: Start

    def __post_init__(self) -> None:
        self.data, self.priors = self.start.data, self.start.priors
        self.problems: tuple[SessionProblem, ...] = ()

    def heading(self, state: State) -> Heading | None:
        """Return the headings that can be used, by the attitudes of `state`."""
        self.data, self.priors, self.problems = with_heading(self.session, self.start, chain_state(state))
        return self.data.heading


class _LevelField(_Field):
    """Headings whose mean says nothing: the magnetometer is fitted to each window anew, and its offset with it."""

    def heading(self, state: State) -> Heading | None:
        """Return the headings that can be used, turned to the yaw of `state` in the mean."""
        found = super().heading(state)
        if found is None:
            return None
        known = replace(found, has_offset=False)
        rows = heading_rows(state, known.interval, known.field_s, known.field_yaw, known.sigma, has_offset=False)
        return replace(known, field_yaw=known.field_yaw + float(np.median(rows.residual)))


def problem_of(start: Start, options: GraphOptions) -> tuple[Problem, Noise]:
    """Return a start as a problem of the graph, and the noise to begin with."""
    d, p, noise = start.data, start.priors, noise_before(start.noise)
    state = state_of(start.state)
    ground = None if d.heights is None else far_from_heights(d.heights, state.t)
    share, renewed = (None, None)
    if len(d.claims.renewed):
        share, renewed = d.claims.between(state.t, float(p.constants[0]))
    measured = Measurements(
        d.t,
        d.position_n,
        d.velocity_n,
        d.position_scale,
        d.velocity_scale,
        d.still,
        d.doubted,
        ground=ground if ground is not None and len(ground[0]) else None,
        unsampled=unsampled(start.binned.missing),
        offset_share=share,
        offset_renewed=renewed,
    )
    constants = {name: (p.constants[part], p.constants_sigma[part]) for name, part in PARTS.items()}
    held_s = state.geometry.level_axes_s[2] if p.holds_height else None
    priors = Priors(p.accel_bias, p.gyro_bias, p.gyro_bias_mean, constants, held_s)
    scatter = scatter_of(start.binned)
    stated = frozenset(name for name in DENSITIES if getattr(start.stated, name))
    found, table = Scatter(scatter.accel, scatter.gyro), table_without(options.without)
    return Problem(start.binned, measured, priors, state, noise, found, stated, table), noise


def state_of(s: old.ChainState) -> State:
    """Return a state of the first edition as one of the graph of GTSAM."""
    constants = s.constants.as_vector()
    return State(
        s.t,
        s.R_ns,
        s.position_n,
        s.velocity_n,
        s.accel_bias_s,
        s.gyro_bias_s,
        s.offset_n,
        {name: constants[part] for name, part in PARTS.items()},
        Geometry(s.constants.level_axes_s, s.constants.is_steered),
    )


def chain_state(s: State) -> old.ChainState:
    """Inverse of :func:`state_of`."""
    vector = np.zeros(old.CONSTANTS_SIZE)
    for name, part in PARTS.items():
        vector[part] = s.constants[name]
    constants = old.Constants.from_vector(vector, s.geometry.level_axes_s, is_steered=s.geometry.is_steered)
    return old.ChainState(s.t, s.R_ns, s.position_n, s.velocity_n, s.accel_bias_s, s.gyro_bias_s, s.offset_n, constants)


def noise_before(n: inputs.Noise) -> Noise:
    """Return the noise that a start has."""
    accel, gyro, rectification = n.sensor_error.tolist()
    spread = {
        "accel_scale": np.full(6, accel),
        "gyro_scale": np.full(3, gyro),
        "rectification": np.full(6, rectification),
    }
    inertial = replace(n.inertial, local=None)
    return Noise(
        inertial,
        n.position,
        n.velocity,
        n.offset_sigma,
        n.offset_tau,
        constants=spread,
        offset_most=n.offset_most,
    )


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


def noise_of(s: Solution, solved: old_batch.Solved, before: inputs.Noise) -> inputs.Noise:
    """Return the noise that was found, in the first edition's type."""
    n, found = s.noise, s.components
    force, rate = (
        old_inertial.VarianceComponent(c.squares_of, c.redundancy_of, c.squares_in, c.redundancy_in)
        for c in (found.force, found.rate)
    )
    position, velocity = (RowComponent(c.squares, c.expected) for c in (found.position, found.velocity))
    spread = np.array([float(n.constants[name][0]) for name in ("accel_scale", "gyro_scale", "rectification")])
    noise = replace(
        before,
        inertial=n.inertial,
        position=n.position,
        velocity=n.velocity,
        offset_sigma=n.offset_sigma,
        sensor_error=spread,
    )
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
