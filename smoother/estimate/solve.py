"""Solving a session: constants and noise from the busiest part, then all of it, in one graph or in windows; and its
magnetometer, which is checked against attitudes without it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.estimate.factors.constraints import heading_rows
from smoother.estimate.factors.graph import GraphOptions
from smoother.estimate.initial.guess import (
    Start,
    busiest_part,
    informed,
    is_partly_sampled,
    longest_sampled,
    problem_of,
)
from smoother.estimate.model.heading import Heading, heading_from_field
from smoother.estimate.model.imu import HOLE, MOSTLY_MISSING, BinnedImu
from smoother.estimate.model.state import State
from smoother.estimate.output.estimated import Estimated, estimated, known_from
from smoother.estimate.output.windows import WINDOW, is_long, solve_in_windows
from smoother.estimate.solvers.identify import Sigmas, Solution, identify, solve_held
from smoother.estimate.solvers.incremental import FOUND, solve_as_stream
from smoother.estimate.solvers.variance_components import USUAL_SLIP
from smoother.fit.magnetic_model import session_field
from smoother.samples import MagSamples, Problem, Session

Say = Callable[[float], None]


@dataclass(frozen=True, eq=False)
class Solved:
    """A solved session: its start, the estimate, and the used headings."""

    start: Start
    found: Estimated
    heading: Heading | None
    problems: tuple[Problem, ...]


UNUSED = Problem("magnetometer_unused", "the magnetometer disagrees with the gyro and the course; it was left out")


@dataclass
class Compass:
    """The magnetometer of a session along `start`: its heading and problems, after a call of :meth:`heading`.

    is_level: the mean of its headings is ignored, as where it is fitted to each window of a session anew.
    """

    session: Session
    start: Start
    is_level: bool = False
    found: Heading | None = None
    problems: tuple[Problem, ...] = field(default=())

    def heading(self, state: State) -> Heading | None:
        """Return the headings that can be used, by the attitudes of `state`."""
        mag = self.session.mag
        if mag is None or self.session.config.magnetometer.use is False:
            return None
        earth, self.problems = session_field(self.session)
        mag = _readings_beside_samples(mag, self.start.binned)
        found = heading_from_field(mag, state, earth.declination, earth.inclination, self.start.data.still)
        if found is None:
            self.problems = (*self.problems, UNUSED)
        elif self.is_level:
            rows = heading_rows(state, found.interval, found.field_s, found.field_yaw, found.sigma, has_offset=False)
            found = replace(found, has_offset=False, field_yaw=found.field_yaw + float(np.median(rows.residual)))
        self.found = found
        return found


def _readings_beside_samples(mag: MagSamples, binned: BinnedImu) -> MagSamples:
    """The readings of the intervals that have inertial samples.

    In a hole the tilt is uncertain, which a steep field amplifies in the heading, so that the iterations diverge.
    """
    if not np.any(binned.missing):
        return mag
    interval = np.clip(np.searchsorted(binned.t, mag.t) - 1, 0, len(binned.missing) - 1)
    use = binned.missing[interval] < MOSTLY_MISSING
    return replace(mag, t=mag.t[use], field_s=mag.field_s[use])


def solve(session: Session, start: Start, options: GraphOptions, say: Say) -> Solved:
    """Identify constants and noise on the busiest part, then solve all of the session."""
    busiest = problem_of(longest_sampled(start))
    first = identify(busiest, busiest.usual, lambda share: say(0.5 * share))
    start = informed(session, start, options, first.state)
    if is_partly_sampled(start) or is_long(start):
        return _solve_in_windows(session, start, first, options, say)
    compass = Compass(session, start)
    if options.solver == "isam2":
        solution = _streamed(start, first, compass, options)
    else:
        solution = _identified(start, first, compass, options, lambda share: say(0.5 + 0.5 * share))
    known = known_from(solution, start.priors, start, session.config)
    return Solved(start, estimated(solution, known), compass.found, compass.problems)


def _identified(start: Start, part: Solution, compass: Compass, options: GraphOptions, say: Say) -> Solution:
    """The solution of a start, with the constants and noise of a part as initial values."""
    wheels, sigmas = options.wheels and start.wheels, Sigmas.of(part.covariances)
    return identify(
        problem_of(start), replace(part.noise, slip=None), say, 1, wheels=wheels, sigmas=sigmas, heading=compass.heading
    )


def _streamed(start: Start, part: Solution, compass: Compass, options: GraphOptions) -> Solution:
    """The same as a stream, with the noise of that part."""
    noise = replace(part.noise, slip=USUAL_SLIP if options.wheels and start.wheels else None)
    covariance, problem = part.covariances.constants, problem_of(start)
    solution = solve_as_stream(problem, noise, covariance, compass.heading, FOUND)
    return replace(solution, components=part.components)


def _solve_in_windows(session: Session, start: Start, first: Solution, options: GraphOptions, say: Say) -> Solved:
    """Solve all of a session with the constants and the noise of its busiest part that has samples throughout."""
    busiest = longest_sampled(busiest_part(start, WINDOW))
    compass = Compass(session, busiest)
    main = _identified(busiest, first, compass, options, lambda share: say(0.3 * share))
    known = known_from(main, busiest.priors, busiest, session.config)
    if not _is_whole(busiest, start):  # over hours the common errors of attitude differ from those of one window
        known = replace(known, common_attitude=np.zeros((3, 3)))
    constants, heading, problems = main.state.constants, compass.found, compass.problems
    del main, compass, busiest  # the windows need the room
    start = replace(start, state=replace(start.state, constants=constants))
    solver = solve_as_stream if options.solver == "isam2" else solve_held

    def solve_window(part: Start) -> Solution:
        heading = Compass(session, part, is_level=True).heading
        return solver(problem_of(part), known.noise, known.constants_covariance, heading)

    found = solve_in_windows(start, solve_window, known, lambda share: say(0.3 + 0.7 * share))
    return Solved(start, found, heading, problems)


def _is_whole(part: Start, start: Start) -> bool:
    """Whether a part of a start is all of it that has samples."""
    t, whole = part.state.t, start.state.t
    first, last = max(start.spans[0, 0], whole[0]), min(start.spans[-1, 1], whole[-1])
    return bool(t[0] - first <= HOLE and last - t[-1] <= HOLE)
