"""Between the first edition's preparation and the graph of GTSAM: a Start becomes a Problem."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.estimate.factors.graph import Measurements, Priors
from smoother.estimate.factors.ground import far_from_heights
from smoother.estimate.factors.heading import heading_rows
from smoother.estimate.factors.motion_prior import unsampled
from smoother.estimate.graph import inputs
from smoother.estimate.graph import state as old
from smoother.estimate.graph.first_noise import scatter_of
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.parts import busiest_part, is_partly_sampled, longest_sampled
from smoother.estimate.graph.sampled import HOLE
from smoother.estimate.graph.solve import Say, with_heading
from smoother.estimate.graph.start import Start, informed
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import Geometry, State
from smoother.estimate.output.estimated import Estimated, estimated, known_from
from smoother.estimate.output.windows import WINDOW, is_long, solve_in_windows
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
DENSITIES = ("accel_noise", "gyro_noise", "accel_bias_walk", "gyro_bias_walk")


@dataclass(frozen=True, eq=False)
class Solved:
    """A solved session: the start it was solved from, what was found, and the headings that were used."""

    start: Start
    found: Estimated
    heading: Heading | None
    problems: tuple[SessionProblem, ...]


def solve(session: Session, start: Start, options: GraphOptions, say: Say, doubted: BoolArray) -> Solved:
    """Identify constants and noise on the busiest part, then solve all of the session."""
    problem, noise = problem_of(start)
    first = identify(problem, noise, lambda share: say(0.5 * share))
    state = first.state
    biases = state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)
    start = informed(session, start, options, chain_state(state).constants, biases, doubted)
    if is_partly_sampled(start) or is_long(start):
        return _solve_in_windows(session, start, first.noise, options, say)
    whole, _ = problem_of(start)
    whole = with_rectification(replace(whole, state=replace(whole.state, constants=state.constants)), first)
    field, noise = _Field(session, start), replace(first.noise, slip=None)
    sigmas = Sigmas.of(first.covariances)
    solution = _identified(whole, noise, field, options, lambda share: say(0.5 + 0.5 * share), sigmas)
    known = known_from(solution, whole.priors, start, session.config)
    return Solved(start, estimated(solution, known), field.data.heading, field.problems)


def _identified(
    problem: Problem, noise: Noise, field: "_Field", options: GraphOptions, say: Say, sigmas: Sigmas | None = None
) -> Solution:
    wheels = options.wheels and field.start.wheels
    return identify(problem, noise, say, 1, wheels=wheels, sigmas=sigmas, heading=field.heading)


def _solve_in_windows(session: Session, start: Start, noise: Noise, options: GraphOptions, say: Say) -> Solved:
    """Solve all of a session with the constants and the noise of its busiest part that has samples throughout."""
    busiest = longest_sampled(busiest_part(start, WINDOW))
    problem, _ = problem_of(busiest)
    field = _Field(session, busiest)
    main = _identified(problem, replace(noise, slip=None), field, options, lambda s: say(0.3 * s))
    known = known_from(main, problem.priors, busiest, session.config)
    if not _is_whole(busiest, start):  # over hours other errors of attitude are common than in one window
        known = replace(known, common_attitude=np.zeros((3, 3)))
    constants, heading, problems = main.state.constants, field.data.heading, field.problems
    del main, problem, field, busiest  # the windows need the room
    start = replace(start, state=replace(start.state, constants=_old_constants(constants, start.state.constants)))

    def solve_window(part: Start) -> Solution:
        problem, _ = problem_of(part)
        return solve_held(problem, known.noise, known.constants_covariance, _LevelField(session, part).heading)

    found = solve_in_windows(start, solve_window, known, lambda share: say(0.3 + 0.7 * share))
    return Solved(start, found, heading, problems)


def _is_whole(part: Start, start: Start) -> bool:
    """Whether a part of a start is all of it that has samples."""
    t, whole = part.state.t, start.state.t
    first, last = max(start.spans[0, 0], whole[0]), min(start.spans[-1, 1], whole[-1])
    return bool(t[0] - first <= HOLE and last - t[-1] <= HOLE)


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


def problem_of(start: Start) -> tuple[Problem, Noise]:
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
    problem = Problem(start.binned, measured, priors, state, noise, Scatter(scatter.accel, scatter.gyro), stated)
    return problem, noise


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
    before = old.Constants(
        0.0, 0.0, np.zeros(3), level_axes_s=s.geometry.level_axes_s, is_steered=s.geometry.is_steered
    )
    constants = _old_constants(s.constants, before)
    return old.ChainState(s.t, s.R_ns, s.position_n, s.velocity_n, s.accel_bias_s, s.gyro_bias_s, s.offset_n, constants)


def _old_constants(constants: Mapping[str, Array], before: old.Constants) -> old.Constants:
    vector = before.as_vector()
    for name, part in PARTS.items():
        vector[part] = constants[name]
    return old.Constants.from_vector(vector, before.level_axes_s, is_steered=before.is_steered)


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
