"""Alternation of solution and noise identification, until neither changes."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import gtsam
import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.estimate.factors.gaussian import columns_of
from smoother.estimate.factors.graph import (
    TABLE,
    Factor,
    Graph,
    Measurements,
    Priors,
    build_graph,
    with_same_samples,
)
from smoother.estimate.factors.wheels import MOVING, rolling, slip_of
from smoother.estimate.model.heading import Heading
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import COLUMNS, KEYS, ROTATION, VELOCITY, State
from smoother.estimate.solvers.batch import Step, step
from smoother.estimate.solvers.covariance import Chain, Covariances
from smoother.estimate.solvers.variance_components import (
    USUAL_SLIP,
    Components,
    Scatter,
    slip_sigma,
    update_noise,
)

FIRST_STEPS = 3  # before the first noise
MOST_TURNS = 12
MOVED, CHANGED = 0.15, 0.1  # of a sigma (rms) that a step still moves the state by; relative change of the noise
UNMOVED = 0.05  # of a sigma, likewise: a step by which a change of noise is irrelevant
NEAR, NEARER = 1.0, 0.3  # of a sigma, likewise: for residuals and headings; for held constants
FREE = ("slip", "heading_offset")  # constants of the factors that join late
HELD: tuple[str, ...] = ()  # constants that move in a step that holds all
FIXED = 1e-7  # sigma of held constants, in their units
NEAR_ANGLE, STILL_ANGLE = 0.02, 3e-3  # rad, rms, of a step: near the solution, and converged
ALIKE = 0.05  # logarithm of a density up to which samples need not be preintegrated again

Progress = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Problem:
    """A session or a part of it: samples, measurements, priors, and initial values.

    usual: noise before any residual; scatter: of the samples; stated: names of densities that the settings state.
    """

    binned: BinnedImu
    measured: Measurements
    priors: Priors
    state: State
    usual: Noise
    scatter: Scatter
    stated: frozenset[str] = frozenset()
    table: tuple[Factor, ...] = TABLE


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved graph: the last step, its chain and covariances, its noise, and the components that identified it:
    None for a given noise.
    """

    graph: Graph
    step: Step
    chain: Chain
    covariances: Covariances
    components: Components | None = None

    @property
    def state(self) -> State:
        """The state after the last step."""
        return self.step.after

    @property
    def noise(self) -> Noise:
        """The noise that the graph was solved with."""
        return self.graph.noise


def identify(
    problem: Problem,
    noise: Noise,
    progress: Progress,
    first_steps: int = FIRST_STEPS,
    *,
    wheels: bool = False,
    sigmas: "Sigmas | None" = None,
    heading: Callable[[State], Heading | None] | None = None,
) -> Solution:
    """Solve a problem and identify its noise, starting from `noise`; `progress` gets the finished share.

    wheels: the factor joins after the noise is identified and attitudes are accurate, where the sensor follows the
    path. From then on only the sigma of the slip is identified: the slip is smoother than its process, which would bias
    the noise of the samples and the latencies (1.4 ms on twelve karts). sigmas: of a solution of a part of the session,
    where there is one. heading: of a magnetometer, likewise; it returns the headings that can be used.
    """
    values, state = problem.state.values(), problem.state
    wheels = wheels and not state.geometry.is_steered
    graph = _graph(problem, state, noise)
    for _ in range(first_steps):
        values = step(graph, values, KEYS if sigmas is None else HELD).moved
    damping, is_settled, is_renewed, rolls, turn = Damping(), False, False, None, 0
    while True:
        taken = step(graph, values)
        values, turn = taken.moved, turn + 1
        is_last = turn == MOST_TURNS
        progress(turn / MOST_TURNS)
        at_rest = NEARER if wheels else MOVED
        if sigmas is not None and moved(taken, sigmas) > (at_rest if is_settled else NEAR) and not is_last:
            continue  # covariances cost as much as a step, and are useless before convergence
        chain = taken.chain()
        covariances = chain.covariances()
        sigmas = Sigmas.of(covariances)
        better, found = update_noise(
            graph, taken, covariances, problem.binned, problem.scatter, problem.usual, set(problem.stated)
        )
        better = damping.damped(graph.noise, better)
        change, move, joined = relative_change(graph.noise, better), moved(taken, sigmas), False
        is_settled, is_renewed = change < CHANGED or (is_renewed and move < UNMOVED), True
        if heading is not None and move < NEAR:
            field, heading = heading(taken.after), None
            problem, joined = with_heading(problem, field), field is not None
        if wheels and move < NEARER and is_settled:
            wheels, rolls = False, rolling_at(taken, covariances.keyframes, graph)
        if rolls is None and ((move < MOVED and is_settled and not joined) or is_last):
            return Solution(graph, taken, chain, covariances, found)
        graph, constants = _renewed(problem, graph, taken.after, better), covariances.constants
        del taken, chain, covariances  # the next step needs the room
        if rolls is not None:
            return _with_wheels(problem, rolls, graph, values, constants, found)


def with_heading(problem: Problem, field: Heading | None) -> Problem:
    """The problem with the headings of a magnetometer, if there are any."""
    if field is None:
        return problem
    known = problem.priors.constants | {"heading_offset": (np.zeros(1), np.array([field.offset_sigma]))}
    measured, priors = replace(problem.measured, heading=field), replace(problem.priors, constants=known)
    return replace(problem, measured=measured, priors=priors)


def _with_wheels(
    problem: Problem, rolls: BoolArray, graph: Graph, values: gtsam.Values, constants: Array, found: Components
) -> Solution:
    """Solve with wheels that roll at the keyframes `rolls` (K,), after a solution without them: once to identify the
    slip, then until convergence. Constants are held, except those that wheels and heading determine.

    constants (C, C): covariance of the constants, and found: of the noise, without wheels.
    """
    state = graph.state
    held = held_at(replace(problem, measured=replace(problem.measured, rolls=rolls)), state, FREE)
    noise, sigmas, turn = replace(graph.noise, slip=USUAL_SLIP), None, 0
    while True:
        graph = with_same_samples(graph, held.measured, noise, held.priors, state)
        taken = step(graph, values, FREE if sigmas is None else KEYS)
        values, turn = taken.moved, turn + 1
        if sigmas is not None and moved(taken, sigmas) > MOVED and turn < MOST_TURNS:
            continue
        chain = taken.chain().with_constants(constants, columns_of(FREE))
        covariances = chain.covariances()
        if sigmas is not None:
            return Solution(graph, taken, chain, covariances, found)
        sigmas, noise = Sigmas.of(covariances), replace(noise, slip=slip_sigma(taken, covariances, USUAL_SLIP))
        del taken, chain, covariances  # as above


def _graph(problem: Problem, state: State, noise: Noise) -> Graph:
    p = problem
    return build_graph(p.binned, p.measured, noise, p.priors, state, p.table)


def _renewed(problem: Problem, graph: Graph, state: State, noise: Noise) -> Graph:
    """The graph with another noise and what joined the problem; samples are preintegrated again where it matters."""
    one, two = graph.noise.inertial, noise.inertial
    if max(abs(math.log(one.accel / two.accel)), abs(math.log(one.gyro / two.gyro))) > ALIKE:
        return _graph(problem, state, noise)
    return with_same_samples(graph, problem.measured, noise, problem.priors, state)


@dataclass(frozen=True, eq=False)
class Sigmas:
    """Mean variances (18,) of a keyframe and those of the constants (C,)."""

    keyframe: Array
    constants: Array

    @staticmethod
    def of(covariances: Covariances) -> "Sigmas":
        """Of a solution."""
        keyframe = np.einsum("kii->i", covariances.keyframes) / len(covariances.keyframes)
        return Sigmas(keyframe, np.diag(covariances.constants))


def moved(step: Step, sigmas: Sigmas) -> float:
    """Root mean square of a step of attitude, velocity, and of latencies and arm, each over its sigma; the largest."""
    of_keyframe = np.mean(step.keyframes**2, axis=0) / sigmas.keyframe
    of_constants = step.constants**2 / np.maximum(sigmas.constants, FIXED**2)
    squares = [np.mean(of_keyframe[part]) for part in (ROTATION, VELOCITY)]
    squares += [np.mean(of_constants[COLUMNS[name]]) for name in ("position_latency", "velocity_latency", "lever_arm")]
    return math.sqrt(float(max(squares)))


def solve_held(
    problem: Problem, noise: Noise, covariance: Array, heading: Callable[[State], Heading | None] | None = None
) -> Solution:
    """Solve a part of a session with a given noise and held constants.

    covariance (C, C): of the constants, which is in that of the keyframes. heading: as for :func:`identify`.
    """
    problem = held_at(problem, problem.state)
    slip = None if problem.state.geometry.is_steered else noise.slip
    noise = replace(noise, slip=None, constants={})
    graph, values = _graph(problem, problem.state, noise), problem.state.values()
    for _ in range(MOST_TURNS):
        taken = step(graph, values, HELD)
        values, is_near = taken.moved, attitude_moved(taken) < NEAR_ANGLE
        joins = is_near and (heading is not None or slip is not None)
        if attitude_moved(taken) < STILL_ANGLE and not joins:
            break
        if joins and heading is not None:
            field, heading = heading(taken.after), None
            problem = replace(problem, measured=replace(problem.measured, heading=field))
        if joins and slip is not None:
            rolls = rolling_at(taken, taken.chain().given_constants, graph)
            if rolls is not None:
                problem = replace(problem, measured=replace(problem.measured, rolls=rolls))
                noise = replace(noise, slip=slip)
            slip = None
        if joins:
            graph = with_same_samples(graph, problem.measured, noise, problem.priors, taken.after)
    taken = step(graph, values)  # with the constants, whose errors count in the covariances
    chain = taken.chain().with_constants(covariance)
    return Solution(graph, taken, chain, chain.covariances())


def held_at(problem: Problem, state: State, free: tuple[str, ...] = ()) -> Problem:
    """The problem with constants held at those of `state`, except free ones."""
    priors = {
        name: problem.priors.constants[name] if name in free else (value, np.full(len(value), FIXED))
        for name, value in state.constants.items()
    }
    return replace(problem, priors=replace(problem.priors, constants=priors))


def rolling_at(step: Step, covariances: Array, graph: Graph) -> BoolArray | None:
    """Whether and where wheels roll, by a step without them and the covariances (K, 18, 18) of its keyframes."""
    state, inertial = step.after, graph.noise.inertial
    slip = slip_of(state, LowPassedMotion(state, inertial.accel, inertial.gyro))
    sampled = np.zeros(len(state.t), dtype=np.bool_)
    sampled[graph.sampled] = sampled[graph.sampled + 1] = True
    speed = np.hypot(state.velocity_n[:, 0], state.velocity_n[:, 1])
    variance = np.einsum("ki,kij,kj->k", slip.by_keyframe, covariances, slip.by_keyframe)
    return rolling(slip, (speed > MOVING) & sampled, variance, state.interval)


class Damping:
    """Halves the steps of densities and sigmas that change sign, against oscillation."""

    def __init__(self) -> None:
        self._last, self._share = np.zeros(0), np.ones(0)

    def damped(self, before: Noise, after: Noise) -> Noise:
        """Return the noise part of the way from `before` to `after`."""
        old, new = _levels(before), _levels(after)
        if not self._last.size:
            self._last, self._share = np.zeros_like(new), np.ones_like(new)
        step = new - old
        self._share = np.where(step * self._last < 0.0, 0.5 * self._share, np.minimum(1.0, 1.2 * self._share))
        self._last = step
        levels = np.exp(old + self._share * step)
        inertial = replace(after.inertial, accel=float(levels[0]), gyro=float(levels[1]))
        return replace(after, inertial=inertial, position=levels[2:5], velocity=levels[5:8])


def _levels(noise: Noise) -> Array:
    """Logarithms (8,) of the densities and the sigmas of fixes."""
    return np.log([noise.inertial.accel, noise.inertial.gyro, *noise.position, *noise.velocity])


def attitude_moved(step: Step) -> float:
    """Root mean square turn of all keyframes in a step, rad."""
    return math.sqrt(float(np.mean(np.sum(step.keyframes[:, ROTATION] ** 2, axis=1))))


def relative_change(one: Noise, two: Noise) -> float:
    """Largest relative difference of the densities, the sigmas of fixes and those of factors.

    The slow error and the slip converge later, without effect on reported values.
    """
    if one.sigmas.keys() != two.sigmas.keys():
        return math.inf
    of_factors = [abs(math.log(sigma / one.sigmas[name])) for name, sigma in two.sigmas.items()]
    return float(np.max([*np.abs(_levels(two) - _levels(one)), *of_factors]))
