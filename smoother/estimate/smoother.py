"""GraphSmoother: session in, trajectory out. The stages in order; each is a function of the previous ones.

    true time -> velocities along positions -> one clock, force in step with rate, without pauses -> path of the fixes,
    alignment, first guess -> noise and constants of a part -> solve and identify, with magnetometer and wheels ->
    mounting -> trajectory

Where samples cover a part of the fixes only, constants and noise are found from that part (output/windows.py). When the
inertial sensor cannot be used, or its solution fails, the result is the smoothing of the fixes alone.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.estimate.factors.graph import GraphOptions
from smoother.estimate.fixes.agreement import disagreement, disagreement_problems, in_agreement
from smoother.estimate.fixes.alone import GnssOnlyOptions, GnssSmoother
from smoother.estimate.fixes.reported_noise import unseen_wander
from smoother.estimate.initial.begin import AlignedSession, begin
from smoother.estimate.initial.guess import Start
from smoother.estimate.model.state import COLUMNS
from smoother.estimate.output.estimated import Estimated
from smoother.estimate.output.identified import field_values
from smoother.estimate.output.mounting import FittedMounting, along_wheels, fit_mounting, without_heading
from smoother.estimate.output.problems import early, shaken, too_far, too_few, unlike
from smoother.estimate.output.trajectory import build_trajectory, row_times
from smoother.estimate.preprocess.clock import clock_problems, clock_scale, in_session_time, in_true_time
from smoother.estimate.preprocess.pauses import opened_up
from smoother.estimate.solve import Solved, solve
from smoother.samples import Problem, Session
from smoother.trajectory import EstimateReport, Trajectory

__all__ = ["GraphOptions", "GraphSmoother"]

Progress = Callable[[str, float], None]


@dataclass
class GraphSmoother:
    """The factor-graph smoother. keep: called with the solution, for callers that continue from it."""

    options: GraphOptions = field(default_factory=GraphOptions)
    progress: Progress | None = None
    name: str = "smoother"
    keep: Callable[[Solved], None] | None = None

    def estimate(self, session: Session) -> Trajectory:
        """Return the smoothed trajectory, antenna positions in n, with sigmas and identified constants.

        Where the clock of the session has a scale error, `rate` and latencies are in true seconds, times are the
        session's. Where the accelerometer has a latency (`accel_delay`), the other latencies are relative to the
        gyroscope.
        """
        scale = clock_scale(session)
        true = session if scale == 1.0 else in_true_time(session, scale)
        differences = disagreement(true)
        found = self._estimate(in_agreement(true, differences))
        found = with_problems(found, (*disagreement_problems(differences), *clock_problems(session)))
        return found if scale == 1.0 else in_session_time(found, scale)

    def _estimate(self, session: Session) -> Trajectory:
        """Trajectory of a session in true time; of its fixes alone where the samples cannot be used."""
        problems = () if session.imu is None else too_few(session.imu, session.gnss)
        if session.imu is not None and not problems:
            try:
                return self._from_graph(session, Stopwatch(self.progress))
            except NotUsableError as reason:
                problems = reason.problems
            except (ArithmeticError, np.linalg.LinAlgError) as error:  # an indeterminate system is an arithmetic one
                text = f"the inertial solution failed ({error}); smoothed from the fixes alone"
                problems = (Problem("graph_failed", text),)
        return with_problems(GnssSmoother(GnssOnlyOptions(rate=self.options.rate)).estimate(session), problems)

    def _from_graph(self, given: Session, watch: "Stopwatch") -> Trajectory:
        """Trajectory by the graph. Raises NotUsableError where samples and fixes do not fit."""
        options = self.options.for_fixes(given.gnss.t)
        with watch("align"):
            aligned = begin(given, options)
        session, start = aligned.session, aligned.start
        _require_none((*aligned.unusable, *unlike(start.alignment)))
        with watch("solve"):
            solved = solve(session, start, options, watch.say)
        start, found = solved.start, solved.found
        _require_none(too_far(session, found, start.alignment))
        with watch("output"):
            trajectory = build_trajectory(
                session,
                found,
                _mounting(session, found, start),
                start.fine,
                options.rate,
                np.array(options.offset_sigma) * start.receiver,
                start.pauses,
                unseen_wander(session.gnss.t, start.path, found.known.noise.offset_tau),
            )
        if self.keep is not None:
            self.keep(solved)
        report = _completed_report(given, aligned, solved, trajectory)
        trajectory = replace(trajectory, report=replace(report, timings=watch.seconds))
        if not len(start.pauses):
            return trajectory
        return opened_up(trajectory, start.pauses, row_times(given.gnss.t[0], given.gnss.t[-1], self.options.rate))


class NotUsableError(Exception):
    """The samples cannot be used, for the reasons in `problems`."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        super().__init__()
        self.problems = problems


def _require_none(problems: tuple[Problem, ...]) -> None:
    if problems:
        raise NotUsableError(problems)


def with_problems(trajectory: Trajectory, problems: tuple[Problem, ...]) -> Trajectory:
    """Return the trajectory with more problems in its report."""
    report = trajectory.report
    return replace(trajectory, report=replace(report, problems=(*report.problems, *problems)))


def _completed_report(
    given: Session, aligned: AlignedSession, solved: Solved, trajectory: Trajectory
) -> EstimateReport:
    """Report of the trajectory, with the results of earlier stages."""
    report, start, found = trajectory.report, solved.start, solved.found
    return replace(
        report,
        identified={
            **report.identified,
            **field_values(solved.heading, found),
            "accel_delay": aligned.delay.identified(),
            "imu_clock_drift": aligned.clock.identified(),
        },
        left_out=aligned.left_out,
        problems=(
            *start.alignment.problems,
            *report.problems,
            *solved.problems,
            *shaken(aligned.session, found.known.noise),
            *early(report.identified),
            *aligned.problems,
            *aligned.clock.problems(float(np.ptp(given.gnss.t))),
        ),
    )


def _mounting(session: Session, found: Estimated, start: Start) -> FittedMounting:
    stated = session.config.mounting.R_bs
    if stated is not None:
        mounting = FittedMounting(stated, np.zeros(3), True)
    else:
        mounting = _fitted_mounting(found, start)
    return without_heading(mounting) if start.alignment.is_level_only else mounting


def _fitted_mounting(found: Estimated, start: Start) -> FittedMounting:
    state, known = found.state, found.known
    height_sigma = float(np.sqrt(2.0) * known.noise.offset_sigma[2]) if known.has_height else None
    mounting = fit_mounting(state, start.alignment.R_bs, start.fine.missing, height_sigma)
    if not mounting.is_fitted or known.wheels_heading is None:
        return mounting
    slip = COLUMNS["slip"].start
    return along_wheels(mounting, state, float(known.constants_covariance[slip, slip]) + known.wheels_heading)


class Stopwatch:
    """Time of each stage, and progress reports."""

    def __init__(self, progress: Progress | None) -> None:
        self.seconds: dict[str, float] = {}
        self._progress = progress
        self._stage = ""

    def __call__(self, stage: str) -> "Stopwatch":
        self._stage = stage
        return self

    def __enter__(self) -> None:
        self._since = time.perf_counter()
        self.say(0.0)

    def __exit__(self, *_: object) -> None:
        taken = time.perf_counter() - self._since
        self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + taken
        self.say(1.0)

    def say(self, fraction: float) -> None:
        """Report progress of the current stage."""
        if self._progress is not None:
            self._progress(self._stage, fraction)
