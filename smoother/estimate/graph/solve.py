"""Solving in turns: the noise and the constants of a session from a part of it, then the whole until it stays."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, median
from smoother.estimate.graph.batch import Batch, DrivenMotion, Linear, Solved, constants_moved, moved, variances
from smoother.estimate.graph.chain import NotPositiveDefiniteError, solve_chain
from smoother.estimate.graph.coarse import FOR_CONSTANTS, near_solution
from smoother.estimate.graph.components import OWN_SCATTER, Scatter, bias_walks, slip_update, update_noise
from smoother.estimate.graph.first_noise import scatter_of
from smoother.estimate.graph.heading import Heading, heading_from_field
from smoother.estimate.graph.imu import MOSTLY_MISSING, BinnedImu
from smoother.estimate.graph.incremental import solve_as_stream
from smoother.estimate.graph.inertial import InertialGraph
from smoother.estimate.graph.inertial_noise import ROUND
from smoother.estimate.graph.inputs import Data, Noise, Priors
from smoother.estimate.graph.lasting import Memory, counted, shared_out
from smoother.estimate.graph.noise_steps import NoiseSteps
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.parts import busiest_part, where_sampled
from smoother.estimate.graph.relaxation import Relaxation
from smoother.estimate.graph.session_rows import doppler_noise, unsteady_share
from smoother.estimate.graph.slip import SlipNoise, with_nose
from smoother.estimate.graph.start import Start
from smoother.estimate.graph.state import HEADING_OFFSET, SLIP, VELOCITY, ChainState, Constants
from smoother.fit.magnetic_model import session_field
from smoother.samples import MagSamples, Problem, Session

WELL_KNOWN = 0.15  # of a sigma, which further steps would still move by; it adds 1 % to the error
CONSTANTS_WELL_KNOWN = 0.25  # likewise of the constants: 3 %
# Of a sigma: a step that moves constants by more has them still on their way. On an oval the alignment may be half a
# second off, and steps from there are short by the noise that they take from what is still wrong, which hardly changes
# from turn to turn. So many times the usual turns they have, at most; where the start is near none is added
ON_THE_WAY, FARTHER = 0.5, 4
TINY = 0.25  # of either: steps that no longer shrink, but only go to and fro
LARGE = 2.0  # of either: steps that are another one's beginning, whatever the proportion
WORSE = 1.25  # ratio of the noise of the fixes; from part to whole of a session it changes by some per cent
SETTLED = 0.05  # relative change of the noise below which another round changes no digit that people read
SLIP_ROUNDS = 2  # at most, of finding how much slip there is; the first one comes to within an eighth of it
# Of a sigma: a first step with wheels by less leaves less than that to the next one, 0.1 after 0.7 to 1.4; where the
# slip it was taken with is ALIKE, by its logarithm, to the one that it tells
FAR, ALIKE = 2.0, 0.125
ROLLED = 0.25  # of a sigma, which further steps with wheels would still move by; it adds 3 % to the error
ROLLING = 7e-4, 2  # rad, rms, that the last of at most so many steps moves attitudes by, before the one that counts
STREAM_ROLLING = 3e-5, 4  # likewise of a stream, whose weights are to be those of the batch
MOSTLY_ROLLING = 0.9  # mean weight of the rows of slip; simulated karts have 0.97 and more
STEADY = 0.1  # relative change of the noise; when it changed by more before the last step, another one is worth it

Say = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Solution:
    """A solved session, and what it was solved with; heading: of the magnetometer, None where that is not used."""

    solved: Solved
    noise: Noise
    priors: Priors
    problems: tuple[Problem, ...]
    heading: Heading | None = None


def solve_whole(session: Session, start: Start, noise: Noise, options: GraphOptions, say: Say) -> Solution:
    """Solve all keyframes of `start` in one system, with the constants and the noise that they tell.

    A magnetometer that makes the fixes look worse than they were without it is left out.
    """
    state = near_solution(start, noise, options.approaches, FOR_CONSTANTS)
    data, priors, problems = with_heading(session, start, state)
    batch = Batch(data, start.binned, priors)
    graph = batch.graph(state, noise)
    solved, found = finish(batch, graph, state, noise, start, options, say)
    if data.heading is not None and _is_worse(found, noise):
        batch = Batch(start.data, start.binned, start.priors)
        without, calm = finish(batch, graph, state, noise, start, options, say)
        if _is_worse(found, calm):
            text = "with the magnetometer the fixes fit worse than without it; it was left out"
            problem = Problem("magnetometer_unused", text)
            data, priors, problems = start.data, start.priors, (*problems, problem)
            solved, found = without, calm
        else:
            batch = Batch(data, start.binned, priors)
    noise = found
    if options.solver == "isam2":
        constants, held = solved.state.constants, solved.solution.constants_covariance
        with_wheels = noise.slip is not None
        no_slip = replace(noise, slip=None)
        solved = solve_as_stream(
            batch, data, start.binned, priors, no_slip, start.state, constants, held if with_wheels else None
        )
        if with_wheels:
            graph = batch.graph(solved.state, noise)
            state = batch.approach(graph, solved.state, noise, *STREAM_ROLLING)
            solved = batch.step(graph, state, noise, held=held)
    return Solution(solved, noise, priors, problems, data.heading)


def _is_worse(noise: Noise, other: Noise) -> bool:
    """Whether the fixes were found to be much noisier than in `other`."""
    levels = ((noise.position[0], other.position[0]), (noise.velocity[0], other.velocity[0]))
    return any(one > WORSE * two for one, two in levels)


def identify(start: Start, options: GraphOptions, say: Say) -> tuple[Constants, tuple[Array, Array], Noise]:
    """Find constants, mean biases of force and rate and noise, turn by turn."""
    start = where_sampled(start)
    state, noise = _settle(start, start.state, start.noise, scatter_of(start.binned), options, say)
    return state.constants, (state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)), noise


def _settle(
    start: Start, state: ChainState, noise: Noise, scatter: Scatter, options: GraphOptions, say: Say
) -> tuple[ChainState, Noise]:
    """Converge, then re-estimate the noise after each further step until it stays."""
    batch = Batch(start.data, start.binned, start.priors)
    graph = batch.graph(state, noise)
    state = batch.converge(graph, state, noise, options.iterations)
    relaxation, steps = Relaxation(), NoiseSteps()
    for turn in range(FARTHER * options.rounds):
        graph = _serving(batch, graph, state, noise)
        solved = batch.step(graph, state, noise, relaxation)
        state = solved.state
        better = steps.towards(_reestimated(solved, noise, start, scatter), noise)
        settled = noise.change(better) < SETTLED
        noise = better
        say(0.7 * min((turn + 1) / options.rounds, 1.0))
        if (settled or turn + 1 >= options.rounds) and constants_moved(solved.solution) < ON_THE_WAY:
            break
    return state, noise


def finish(
    batch: Batch,
    graph: InertialGraph,
    state: ChainState,
    noise: Noise,
    start: Start,
    options: GraphOptions,
    say: Say,
) -> tuple[Solved, Noise]:
    """Steps over the whole session, each with a better noise, until they no longer matter; the last one counts."""
    scatter, relaxation = scatter_of(start.binned), Relaxation()
    solved: Solved | None = None
    steps: list[tuple[float, float]] = []
    change, noise_steps, known = 0.0, NoiseSteps(), np.empty((0, 0))
    for turn in range(options.final_rounds):
        graph = _serving(batch, graph, state, noise)
        solved = None  # gone before the next one: of a long session, two do not fit
        solved = batch.step(graph, state, noise, relaxation)
        state = solved.state
        known = variances(solved.solution)
        steps.append((moved(solved.solution, known), constants_moved(solved.solution)))
        say(1.0 - 0.3 * 0.5 ** (turn + 1))  # most are settled after two
        if turn + 1 == options.final_rounds or are_settled(steps, change):
            break
        better = noise_steps.towards(_reestimated(solved, noise, start, scatter, by_place=True), noise)
        change, noise = noise.change(better), better
        if not start.wheels or change >= STEADY:
            continue
        motion = batch.motion(state, noise)
        rolling = batch.with_slip(solved, noise, motion)
        if rolling.slip is not None:
            solved = None
            graph = _serving(batch, graph, state, noise)
            rolling = with_lasting(rolling, start, scatter, state, known)
            most = options.final_rounds
            # not named here: what it was linearised from is to go as soon as wheels are added to it
            return on_wheels(
                batch,
                graph,
                start,
                _settled(batch, graph, state, noise, relaxation, steps, known, motion, most),
                noise,
                rolling,
                options,
            )
        del motion
    assert solved is not None
    rolling = batch.with_slip(solved, noise, batch.motion(state, noise)) if start.wheels else noise
    rolling = with_lasting(rolling, start, scatter, state, known)
    if rolling.slip is None and rolling.counted == 1.0:
        return solved, rolling
    held = solved.solution.constants_covariance
    del solved
    if rolling.slip is not None:
        return on_wheels(batch, graph, start, LastStep(state, held), noise, rolling, options)
    graph = _serving(batch, graph, state, rolling)
    return batch.step(graph, state, rolling, held=held), rolling


@dataclass(frozen=True, eq=False)
class Taken:
    """What a step was taken from: the linearised graph and its motion; gone (31,), by how much the constants went."""

    linear: Linear
    motion: DrivenMotion
    gone: Array


@dataclass(frozen=True, eq=False)
class LastStep:
    """The last step without wheels: the state after it, and the covariance (31, 31) of the constants.

    taken: what it was taken from, where that is at hand.
    """

    state: ChainState
    held: Array
    taken: Taken | None = None


def _settled(
    batch: Batch,
    graph: InertialGraph,
    state: ChainState,
    noise: Noise,
    relaxation: Relaxation,
    steps: list[tuple[float, float]],
    known: Array,
    motion: DrivenMotion,
    most: int,
) -> LastStep:
    """Go on from `steps` with the noise as it is, until settled or `most` were gone.

    Without the covariance of the keyframes: known (K, 18), their variances of the last step, is as good. With the
    noise, that is a third of what a turn costs. motion: that of `state`.
    """
    steps = list(steps)
    while True:
        linear = batch.linear(graph, state, noise, motion)
        step = solve_chain(linear.system, with_covariance=False)
        share = relaxation.share(step)
        gone = share * step.constants
        after = state.retract(share * step.x, gone)
        steps.append((moved(step, known), constants_moved(step)))
        if are_settled(steps) or len(steps) >= most:
            return LastStep(after, step.constants_covariance, Taken(linear, motion, gone))
        state = after
        motion = batch.motion(state, noise)


def _serving(batch: Batch, graph: InertialGraph, state: ChainState, noise: Noise) -> InertialGraph:
    """The graph, or where `noise` is too far from its own, one that is preintegrated with it about `state`."""
    return graph if graph.serves(noise.inertial) else batch.graph(state, noise)


def with_lasting(noise: Noise, start: Start, scatter: Scatter, state: ChainState, known: Array) -> Noise:
    """Return the noise with what of it is an error of velocities that lasts moved to these, from the force.

    Constants and attitude rest on the sum of both, and are to stay. known (K, 18): variances of the keyframes.
    """
    lasting, doppler, inertial = start.data.lasting, doppler_noise(start.data, noise), noise.inertial
    if lasting == 0.0 or doppler is None:
        return noise
    memory = Memory.shown(doppler.sigma, float(median(known[:, VELOCITY][:, :2].ravel())), doppler.every)
    density = memory.density(doppler.sigma)
    if not start.stated.accel_noise:
        least = OWN_SCATTER * scatter.accel
        inertial, lasting, less = shared_out(inertial, lasting, memory, state.constants.level_axes_s, least)
        density = math.sqrt(max(density**2 - less, least**2))
    return replace(noise, inertial=inertial, counted=counted(doppler.sigma, lasting, density, doppler.every))


def on_wheels(
    batch: Batch,
    graph: InertialGraph,
    start: Start,
    last: LastStep,
    noise: Noise,
    rolling: Noise,
    options: GraphOptions,
) -> tuple[Solved, Noise]:
    """Solve again, after a last step without that was taken with `noise`, with wheels that roll along.

    The scatter of slip is found on the way, on a part of a long session first. All other noise stays, and all constants
    but those of slip. Slip is smoother than its process: what that expects of quick steps would be missed in the
    samples' noise, and be looked for in latencies and lever arm. Where the rows do not fit, what comes back is without
    them again.
    """
    without, held = last.state, last.held
    slip = _slip_of_part(start, last, rolling, options.identification_span)
    graph = _serving(batch, graph, without, rolling)
    taken = last.taken
    del last
    if taken is not None and _differ_in_slip_alone(without, noise, rolling):
        found = batch.roll(taken.linear, taken.motion, taken.gone, slip, held)
    else:
        found = batch.step(graph, without, replace(rolling, slip=slip), held=held, free=SLIP, was_without_wheels=True)
    del taken
    for _ in range(SLIP_ROUNDS):
        better = slip_update(found, slip)
        size = moved(found.solution, variances(found.solution))
        if size < ROLLED or (size < FAR and abs(math.log(better.sigma / slip.sigma)) < ALIKE):
            slip = replace(slip, shown=better.shown)
            break
        slip, state = better, found.state
        del found  # two do not fit
        found = batch.step(graph, state, replace(rolling, slip=slip), held=held, free=SLIP)
    if fits_wheels(found):
        assert found.slip is not None
        return found, replace(rolling, slip=with_nose(found.slip, slip))
    del found
    rolling = replace(rolling, slip=None)
    return batch.step(graph, without, rolling, held=held if rolling.counted > 1.0 else None), rolling


def _differ_in_slip_alone(state: ChainState, noise: Noise, rolling: Noise) -> bool:
    """Whether wheels may be added to what was linearised with `noise`: where rows are else the same in `rolling`."""
    same = rolling.inertial is noise.inertial and rolling.counted == noise.counted  # but for with_lasting
    return same and unsteady_share(state, rolling) == 0.0


def _slip_of_part(start: Start, last: LastStep, rolling: Noise, span: float) -> SlipNoise:
    """Return what to assume of the slip, from the busiest `span` s, where the session is much longer than that."""
    slip = rolling.slip
    assert slip is not None
    part = busiest_part(replace(start, state=last.state), span)
    if len(part.state.t) > 0.5 * len(last.state.t):
        return slip
    batch, state = Batch(part.data, part.binned, part.priors), part.state
    with suppress(NotPositiveDefiniteError, np.linalg.LinAlgError):  # the whole session may hold what a part lets go
        graph = batch.graph(state, rolling)
        return slip_update(batch.step(graph, state, rolling, held=last.held, free=SLIP, was_without_wheels=True), slip)
    return slip


def fits_wheels(solved: Solved) -> bool:
    """Whether few of the rows of slip had to be weighed down: in part of a session the box may be loose."""
    weight = solved.rows["slip"].weight
    return len(weight) == 0 or float(np.mean(weight)) > MOSTLY_ROLLING


def are_settled(steps: Sequence[tuple[float, float]], change: float = 0.0) -> bool:
    """Whether further steps no longer matter, by what the last two moved keyframes and constants, in sigmas.

    change: of the noise from the last step but one to the last, relative.
    Steps that shrink in proportion: those to come add up to the last one times ratio / (1 - ratio). The larger the last
    one is, the less is left to that proportion.
    """
    if len(steps) < 2 or change > STEADY:
        return False
    limits = WELL_KNOWN, CONSTANTS_WELL_KNOWN
    return all(
        last < TINY * limit or (last < LARGE * limit and last**2 * max(1.0, last / limit) < limit * (before - last))
        for before, last, limit in zip(*steps[-2:], limits, strict=True)
    )


def _reestimated(solved: Solved, noise: Noise, start: Start, scatter: Scatter, *, by_place: bool = False) -> Noise:
    """Noise from the residuals, but for the densities that the settings state."""
    stated, doppler = start.stated, doppler_noise(start.data, noise)
    is_stated = bool(stated.accel_noise)
    better = update_noise(
        solved, noise, start.binned, scatter, doppler, force_is_stated=is_stated, by_place=by_place and not is_stated
    )
    duration = solved.state.interval + start.data.pauses.between(solved.state.t)
    inertial = bias_walks(solved, better.inertial, start.noise.inertial, duration)
    for name in ("accel_bias_walk", "gyro_bias_walk"):
        if getattr(stated, name):
            inertial = replace(inertial, **{name: getattr(stated, name)})
    if stated.accel_noise:
        inertial = replace(inertial, accel=stated.accel_noise, accel_share=0.0, accel_shape=ROUND)
    if stated.gyro_noise:
        inertial = replace(inertial, gyro=stated.gyro_noise, gyro_share=0.0, gyro_shape=ROUND)
    return replace(better, inertial=inertial)


def with_heading(session: Session, start: Start, state: ChainState) -> tuple[Data, Priors, tuple[Problem, ...]]:
    """Add heading factors where there is a magnetometer that agrees with the attitude found without it."""
    data, priors = start.data, start.priors
    if session.mag is None or session.config.magnetometer.use is False:
        return data, priors, ()
    earth, problems = session_field(session)
    mag = _readings_beside_samples(session.mag, start.binned)
    heading = heading_from_field(mag, state, earth.declination, earth.inclination, data.still)
    if heading is None:
        text = "the magnetometer disagrees with the gyro and the course; it was left out"
        return data, priors, (*problems, Problem("magnetometer_unused", text))

    sigma = priors.constants_sigma.copy()
    sigma[HEADING_OFFSET] = heading.offset_sigma
    return replace(data, heading=heading), replace(priors, constants_sigma=sigma), problems


def _readings_beside_samples(mag: MagSamples, binned: BinnedImu) -> MagSamples:
    """The readings of the intervals that have inertial samples.

    In a hole nobody knows how the kart leans to some degrees, by which a steep field turns its heading two or three
    times as far. A heading factor turns the kart alone; where it can lean as well, the two chase one another.
    """
    if not np.any(binned.missing):
        return mag
    interval = np.clip(np.searchsorted(binned.t, mag.t) - 1, 0, len(binned.missing) - 1)
    use = binned.missing[interval] < MOSTLY_MISSING
    return replace(mag, t=mag.t[use], field_s=mag.field_s[use])
