"""Solving a session, and looking again where what comes out can not be right.

A first look identifies constants and noise and solves. An arm longer than karts are is looked for again from a louder
force; a delay that the size of the force contradicts, held to that. Of two looks the better one counts, with a doubt.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import BoolArray
from smoother.estimate.graph.chain import NotPositiveDefiniteError
from smoother.estimate.graph.edges import jumped_beside_outages
from smoother.estimate.graph.estimated import Estimated, are_made_up, estimated
from smoother.estimate.graph.identified import UNSTEADY_DELAY, doubt_by_rates
from smoother.estimate.graph.inputs import Noise
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.parts import is_partly_sampled
from smoother.estimate.graph.solve import Say, Solution, identify, solve_whole
from smoother.estimate.graph.start import (
    Start,
    for_late_course,
    for_slow_receiver,
    held_by_size,
    informed,
    is_late_course,
    make_start,
    on_path_without,
    with_louder_force,
)
from smoother.estimate.graph.state import CONSTANTS_SIZE, LEVER_ARM, POSITION_LATENCY
from smoother.estimate.graph.uncertainty import nose_variance
from smoother.estimate.graph.windows import WindowsSolution, is_long, solve_in_windows
from smoother.estimate.path_motion import MIN_SPEED
from smoother.samples import Session

AT_ODDS = 4.0  # sigmas between the delay found and that by the size of the force; shaken boxes have up to two
LONGEST_ARM = 2.5  # m from box to antenna, more than any kart is long

Look = Callable[[Start], Start]


def as_it_is(start: Start) -> Start:
    """Return `start`: a first look."""
    return start


@dataclass(frozen=True, eq=False)
class Looked:
    """A solved session, what it was solved with, and the start that it went out from.

    doubt: see :func:`smoother.estimate.graph.identified.identified_values`.
    """

    start: Start
    found: Estimated
    solution: Solution | WindowsSolution
    doubt: float = 0.0


def look(session: Session, start: Start, options: GraphOptions, say: Say, seen: Look = as_it_is) -> Looked:
    """Identify and solve; once more, held to it, where the delay is not that which the size of the force tells.

    Where rates do not tell attitudes these are turned to suit any delay, but the size of the force suits one alone. Of
    the two the nearer one counts, as unsure as it is still off.
    """
    first = _within_reach(session, start, options, say, seen)
    timing = session.config.gps
    if not start.by_size.is_seen or (timing.position_latency, timing.velocity_latency) != (None, None):
        return first
    if not (off := _off_by_size(first)).is_at_odds:
        return first
    nearer = first
    with suppress(NotPositiveDefiniteError, np.linalg.LinAlgError):
        again = _within_reach(session, start, options, say, lambda start: held_by_size(seen(start)))
        if abs((second := _off_by_size(again)).delay) < abs(off.delay):
            nearer, off = again, second
    return replace(nearer, doubt=max(nearer.doubt, 1.0, abs(off.delay) / UNSTEADY_DELAY))


@dataclass(frozen=True)
class _OffBySize:
    """delay s by which positions are found later than the size of the force tells, and what that is unsure by."""

    delay: float
    sigma: float

    @property
    def is_at_odds(self) -> bool:
        """Whether they can not both be right."""
        return abs(self.delay) > AT_ODDS * self.sigma


def _off_by_size(solved: Looked) -> _OffBySize:
    """By how much the delay of positions is off from that by size; an antenna ahead by l is earlier there by l/V."""
    start, constants = solved.start, solved.found.state.constants
    speed = start.driven.speed
    slowness = float(np.mean(1.0 / speed[speed > MIN_SPEED]))
    by_constants = np.zeros(CONSTANTS_SIZE)
    by_constants[POSITION_LATENCY], by_constants[LEVER_ARM] = 1.0, -slowness * constants.level_axes_s[0]
    delay = constants.position_latency - slowness * float(constants.level_axes_s[0] @ constants.lever_arm_s)
    own = float(by_constants @ solved.found.constants_covariance @ by_constants)
    unsteady = UNSTEADY_DELAY * doubt_by_rates(solved.solution.noise.inertial.gyro)
    late = start.by_size.delay + start.path.position_latency
    return _OffBySize(delay - late, float(np.sqrt(own + start.by_size.sigma**2 + unsteady**2)))


def _within_reach(session: Session, start: Start, options: GraphOptions, say: Say, seen: Look) -> Looked:
    """Identify and solve; where the arm comes out too long, once more from a louder force.

    That one counts where its arm is none too long and its rates are the quieter ones: a wrong arm and delay turn
    attitudes, which the rates do not follow. An arm that is as long, or averaged speeds, stay as they were found. What
    two looks find differently is no surer than where rates tell nothing.
    """
    first = Looked(*_identify_and_solve(session, start, options, say, seen))
    if session.config.mounting.lever_arm_b is not None or level_arm(first.found) <= LONGEST_ARM:
        return first

    def louder(start: Start) -> Start:
        return with_louder_force(seen(start))

    again = Looked(*_identify_and_solve(session, start, options, say, louder), doubt=1.0)
    is_quieter = again.solution.noise.inertial.gyro < first.solution.noise.inertial.gyro
    return again if is_quieter and level_arm(again.found) <= LONGEST_ARM else first


def _identify_and_solve(
    session: Session, start: Start, options: GraphOptions, say: Say, seen: Look
) -> tuple[Start, Estimated, Solution | WindowsSolution]:
    """Identify constants and noise on a part, then solve all of the session; also the start that this went out from.

    seen: what the start is made into, the one without fixes that jumped too.
    """
    start = seen(start)
    doubted = _jumped(session, start, start.noise, options, with_doppler=False)
    if doubted.any():
        start = seen(make_start(session, options, options.identification_span, doubted, start.pauses))
    if options.solver != "isam2":
        from smoother.estimate.bridge import solve_with_gtsam  # which imports what is above this module

        return solve_with_gtsam(session, start, options, say, doubted)
    constants, biases, noise = identify(start, options, say)
    if (slow := for_slow_receiver(start, constants)) is not None:
        start = slow
        constants, biases, noise = identify(start, options, say)
    if (late := for_late_course(start, constants)) is not None:
        told = identify(late, options, say)
        if is_late_course(constants.course_delay, told[0].course_delay, options.course_delay_sigma):
            start, (constants, biases, noise) = late, told
    start = informed(session, start, options, constants, biases, doubted)
    again = _jumped(session, start, noise, options)  # in all of it, and with its noise
    if np.any(again != doubted):
        start = informed(session, on_path_without(session, start, again), options, constants, biases, again)
    return start, *_solve(session, start, noise, options, say)


def _solve(
    session: Session, start: Start, noise: Noise, options: GraphOptions, say: Say
) -> tuple[Estimated, Solution | WindowsSolution]:
    """Solve a session in one piece, or with constants of a part of it; and what it was solved with."""
    if is_partly_sampled(start) or is_long(start):
        in_windows = solve_in_windows(session, start, noise, options, say)
        return in_windows.found, in_windows
    whole = solve_whole(session, start, noise, options, say)
    return estimated(whole.solved, nose_variance(session, whole.noise), are_made_up(start.binned)), whole


def _jumped(
    session: Session, start: Start, noise: Noise, options: GraphOptions, *, with_doppler: bool = True
) -> BoolArray:
    """Mask (N,) of the fixes that jumped beside an outage; with_doppler: also of those that say how fast they move."""
    found = jumped_beside_outages(start, noise, options.approaches, with_doppler=with_doppler)
    return np.isin(session.gnss.t, found)


def level_arm(found: Estimated) -> float:
    """How far, m, the antenna is found from the box, seen from above."""
    constants = found.state.constants
    return float(np.linalg.norm(constants.level_axes_s[:2] @ constants.lever_arm_s))
