"""GraphSmoother: session in, trajectory out. The stages, in order; each is a function of what came before.

    velocities along positions -> one clock, force in step with rate, without pauses -> fixes alone -> align
    -> first guess -> identify noise and constants, on a part -> solve and identify, in turns,
    with magnetometer and wheels -> mounting -> output

Where samples cover a part of the fixes only, constants and noise are found from that part (output/windows.py). When the
inertial sensor cannot be used, or its solution fails, the result is the smoothing of the fixes alone.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.estimate.fixes.agreement import disagreement, disagreement_problems, in_agreement
from smoother.estimate.fixes.alone import GnssOnlyOptions, GnssSmoother
from smoother.estimate.fixes.reported_noise import unseen_wander
from smoother.estimate.initial.align import Alignment
from smoother.estimate.initial.begin import Begun, begin
from smoother.estimate.initial.guess import Start, have_samples
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.model.imu import sampled_spans
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import COLUMNS
from smoother.estimate.output.estimated import Estimated, attitude_variance, without_samples
from smoother.estimate.output.identified import field_values
from smoother.estimate.output.mounting import FittedMounting, along_wheels, fit_mounting, on_its_ground, without_heading
from smoother.estimate.output.stated import (
    contradicted_constants,
    contradicted_filter,
    contradicted_mounting,
    contradicted_noise,
)
from smoother.estimate.output.trajectory import build_trajectory, row_times
from smoother.estimate.preprocess.clock import clock_problems, clock_scale, in_session_time, in_true_time
from smoother.estimate.preprocess.force_delay import identified as identified_delay
from smoother.estimate.preprocess.pauses import NO_PAUSES, Pauses, opened_up, pauses_of
from smoother.estimate.solve import Solved, solve
from smoother.estimate.solvers.covariance import IndeterminateError
from smoother.samples import GnssFixes, ImuSamples, Problem, Session
from smoother.trajectory import (
    IMU_SHAKEN,
    MIRRORED_AXES,
    UNLIKE_AXES,
    VELOCITY_EARLY,
    EstimateReport,
    Identified,
    Trajectory,
)
from smoother.units import DEG
from smoother.words import counted

__all__ = ["GraphOptions", "GraphSmoother"]

Progress = Callable[[str, float], None]

UNLIKE = (
    "the inertial samples have nothing to do with the motion of the fixes; smoothed from the fixes alone. Is t_s of "
    "both files on one clock? Where the delay of the fixes is known, state it: [gps] position_latency in session.toml"
)
SHAKEN = 0.9  # m/s^2/sqrt(Hz); simulated karts below it know delay and arm as well as they say, those above do not
# rad/s/sqrt(Hz); harsh simulated karts have 3 deg/s and know their delays, a shaken box on a skid pad had 7 and did not
UNSTEADY = 5.0 * DEG
EARLY, EARLY_SIGMAS = 0.05, 3.0  # s, beyond which a fix can not come before it is true
LONG_APART = 0.3  # s; real velocities come 0.05 to 0.2 s after the positions, or with them
FEWEST_FIXES = 10
SHORTEST_OVERLAP = 5.0  # s of inertial samples and fixes together
FEWEST_SAMPLED = 3  # fixes in that time; fewer are an outage
# Least share of rate and force that the fixes must explain: karts 0.86 and more, a motorway 0.38, noise 0.04. And of
# what course and velocity change by between rare ones: real karts and cars, one fix in 3 to 10 s, have 0.95 and more,
# harsh simulated karts 0.96; with samples of another lap or time real ones have 0.6 and less. (Simulated drives are so
# much alike that those of another lap have up to 0.99.)
STRANGE, STRANGE_OF_CHANGES = 0.15, 0.9


FAR_APART = (
    "the inertial samples fit the fixes only with the antenna {:.1f} m from the box, which this motion can not tell "
    "from late or averaged speeds; smoothed from the fixes alone. Does the logger average its speeds? Leave speed and "
    "course out of the file. Are box and antenna that far apart? State it: [mounting] lever_arm_b in session.toml"
)


FAR_AS_STATED = (
    "with what is stated the inertial samples fit the fixes only with the antenna {:.1f} m from the box; smoothed from "
    "the fixes alone"
)


LONGEST_ARM = 2.5  # m from box to antenna, more than any kart is long


@dataclass
class GraphSmoother:
    """The factor-graph smoother. keep: called with what was solved, for who goes on from it."""

    options: GraphOptions = field(default_factory=GraphOptions)
    progress: Progress | None = None
    name: str = "smoother"
    keep: Callable[[Solved], None] | None = None

    def estimate(self, session: Session) -> Trajectory:
        """Return the smoothed trajectory, antenna positions in n, with sigmas and everything identified.

        Where the clock of the session is far off, `rate` and latencies are in true seconds, times are the session's.
        Where the force is late behind the rate (`accel_delay`), latencies are those against the rate.
        """
        scale, problems = clock_scale(session), clock_problems(session)
        if scale == 1.0:
            found = self._along_positions(session)
        else:
            found = in_session_time(self._along_positions(in_true_time(session, scale)), scale)
        told = found.report.problems
        return replace(found, report=replace(found.report, problems=(*told, *problems)))

    def _along_positions(self, session: Session) -> Trajectory:
        """Trajectory of a session in true time whose velocities may be turned or scaled against its positions."""
        apart = disagreement(session)
        found = self._in_true_time(in_agreement(session, apart))
        problems = (*found.report.problems, *disagreement_problems(apart))
        return replace(found, report=replace(found.report, problems=problems))

    def _in_true_time(self, session: Session) -> Trajectory:
        if session.imu is None:
            return self._from_fixes(session, ())
        if (problem := _too_little(session.imu, session.gnss)) is not None:
            return self._from_fixes(session, (problem,))
        watch = Stopwatch(self.progress)
        found = self._unless_it_fails(session, watch, pauses_of)
        if isinstance(found, IndeterminateError) and len(pauses_of(session)):
            # seconds between two pauses may not tell what those beside them would: through the pauses they do
            found = self._unless_it_fails(session, watch, lambda _: NO_PAUSES)
        if isinstance(found, Trajectory):
            return found
        if isinstance(found, _FixesAlone):
            return self._from_fixes(session, found.problems)
        text = f"the inertial solution failed ({found}); smoothed from the fixes alone"
        return self._from_fixes(session, (Problem("graph_failed", text),))

    def _unless_it_fails(
        self, session: Session, watch: "Stopwatch", cut_out: Callable[[Session], Pauses]
    ) -> Trajectory | Exception:
        try:
            return self._from_graph(session, watch, cut_out)
        except FAILURES as error:
            return error.with_traceback(None)  # else all that was being solved stays in memory

    def _from_fixes(self, session: Session, problems: tuple[Problem, ...]) -> Trajectory:
        trajectory = GnssSmoother(GnssOnlyOptions(rate=self.options.rate)).estimate(session)
        report = replace(trajectory.report, problems=trajectory.report.problems + problems)
        return replace(trajectory, report=report)

    def _from_graph(self, given: Session, watch: "Stopwatch", cut_out: Callable[[Session], Pauses]) -> Trajectory:
        """Trajectory of a session of which the pauses are cut out. Raises _FixesAlone if its samples are of no use."""
        options = self.options.for_fixes(given.gnss.t)
        with watch("align"):
            begun = begin(given, options, cut_out)
            session, start = begun.session, begun.start
        pauses, unlike = start.pauses, (*start.alignment.problems, Problem("imu_unusable", UNLIKE))
        if _is_strange(start.alignment):
            raise _FixesAlone(unlike)
        with watch("solve"):
            solved = solve(session, start, options, watch.say)
        with watch("output"):
            trajectory = _output(session, solved, options)
        if self.keep is not None:
            self.keep(solved)
        report = _completed_report(given, begun, solved, trajectory)
        report = replace(report, problems=(*report.problems, *_contradicted(session, solved)))
        trajectory = replace(trajectory, report=replace(report, timings=watch.seconds))
        if not len(pauses):
            return trajectory
        return opened_up(trajectory, pauses, row_times(given.gnss.t[0], given.gnss.t[-1], self.options.rate))


def _is_strange(alignment: Alignment) -> bool:
    """Whether samples and fixes are not of one motion, by what the fixes explain."""
    least = STRANGE_OF_CHANGES if alignment.by_changes else STRANGE
    return alignment.share_explained < least and not alignment.is_level_only


class _FixesAlone(Exception):
    """The samples are of no use, for what `problems` say."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        super().__init__()
        self.problems = problems


def _early(identified: Mapping[str, Identified]) -> tuple[Problem, ...]:
    """Say so where fixes come before they are true: stamps of samples and fixes are then not on one clock."""
    latency = identified["gps_position_latency"]
    if not (latency.observable and isinstance(latency.value, float) and isinstance(latency.sigma, float)):
        return ()
    if latency.value + EARLY_SIGMAS * latency.sigma > -EARLY:
        return ()
    text = (
        f"the fixes seem to come {-latency.value:.2f} s before they are true: the samples' t_s is late by more than "
        "that against theirs. Place and time are the samples'; with columns of your own, bring them onto one clock"
    )
    return (Problem("gps_early", text),)


def _velocities_early(identified: Mapping[str, Identified]) -> tuple[Problem, ...]:
    """Say so where velocities come before they are true while positions come after: no clock does that.

    A receiver that averages its positions over seconds pulls both delays away from one another, and antenna and line
    with them.
    """
    position, velocity = identified["gps_position_latency"], identified["gps_velocity_latency"]
    late, early, sigma = position.value, velocity.value, velocity.sigma
    if not (velocity.observable and position.observable):
        return ()
    if not (isinstance(late, float) and isinstance(early, float) and isinstance(sigma, float)):
        return ()
    if early + EARLY_SIGMAS * sigma > -EARLY or late - early < LONG_APART:
        return ()
    text = (
        f"the velocities of the fixes seem to come {-early:.2f} s before they are true and the positions {late:.2f} s "
        "after, as where a receiver averages its positions over seconds: line, speeds and delays are wrong. Switch "
        "that filter off in the receiver, or leave speed and course out of the file"
    )
    return (Problem(VELOCITY_EARLY, text),)


def _shaken(session: Session, noise: Noise) -> tuple[Problem, ...]:
    """Say so where samples are farther from the motion than any road pushes them.

    An engine that turns nearly as often as samples are taken folds to the same push or turn wherever the kart is at
    that speed. Lap by lap it goes with the motion as a delay or an arm does; as white noise, which sigmas count on, it
    would not.
    """
    density = noise.inertial.accel
    if session.config.imu.accel_noise is not None or density < SHAKEN:
        return ()
    text = (
        f"the inertial samples are {density:.1f} m/s^2/sqrt(Hz) off the motion, as where the sampling folds the "
        "engine's vibration into it: delays of the GPS and the antenna's place may be off by many times their sigma. "
        "Damp the box, or sample faster with the sensor's low-pass filter on"
    )
    return (Problem(IMU_SHAKEN, text),)


def _unsteady(session: Session, noise: Noise) -> tuple[Problem, ...]:
    """Say so where rates are farther from the turning of the path than gyroscopes and roads make them."""
    density = noise.inertial.gyro
    if session.config.imu.gyro_noise is not None or density < UNSTEADY:
        return ()
    text = (
        f"the turn rates are {density / DEG:.1f} deg/s/sqrt(Hz) off the motion, as of a box that is shaken or loose or "
        "a kart that only circles: delays of the GPS and the antenna's place may be off by many times their sigma. "
        "Mount the box firmly and damp it; drive bends to both sides and straights"
    )
    return (Problem("imu_rate_unsteady", text),)


def _too_little(imu: ImuSamples, fixes: GnssFixes) -> Problem | None:
    """Why samples and fixes are too few, or too short a time together, to place one by the other; None if not."""
    if len(fixes) < FEWEST_FIXES:
        text = f"{counted(len(fixes), 'fix')} can not tell how the box lies (at least {FEWEST_FIXES})"
        return Problem("gps_too_few", f"{text}; smoothed from the fixes alone")
    together = _overlap(imu, fixes)
    if together <= 0.0:
        text = "the inertial samples and the fixes have no time in common; smoothed from the fixes alone"
        return Problem("imu_elsewhere", text)
    if together < SHORTEST_OVERLAP:
        text = f"the inertial samples and the fixes have only {together:.1f} s in common"
        return Problem("imu_too_short", f"{text} (at least {SHORTEST_OVERLAP:.0f}); smoothed from the fixes alone")
    sampled = int(np.count_nonzero(have_samples(sampled_spans(imu.t), fixes.t)))
    if sampled < FEWEST_SAMPLED:
        text = f"only {counted(sampled, 'fix')} came while there were inertial samples (at least {FEWEST_SAMPLED})"
        return Problem("imu_too_short", f"{text}; smoothed from the fixes alone")
    return None


def _overlap(imu: ImuSamples, fixes: GnssFixes) -> float:
    """Longest time, s, that both cover without a hole."""
    if len(imu.t) < 2:
        return 0.0
    first, last = np.clip(sampled_spans(imu.t), fixes.t[0], fixes.t[-1]).T
    return float(np.max(last - first))


FAILURES = (_FixesAlone, ArithmeticError, np.linalg.LinAlgError)  # an indeterminate system is an arithmetic one


class Stopwatch:
    """Time of each stage, and progress to whoever wants to see it."""

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


def _output(session: Session, solved: Solved, options: GraphOptions) -> Trajectory:
    """Trajectory of what was solved. Raises _FixesAlone where the antenna is too far from the box."""
    start, found = solved.start, solved.found
    level_arm = float(np.linalg.norm(found.state.geometry.level_axes_s[:2] @ found.state.constants["lever_arm"]))
    if session.config.mounting.lever_arm_b is None and level_arm > LONGEST_ARM:
        wrong = contradicted_constants(session, found)
        text = (FAR_AS_STATED if wrong else FAR_APART).format(level_arm)
        raise _FixesAlone((*start.alignment.problems, *wrong, Problem("arm_too_long", text)))
    return build_trajectory(
        session,
        found,
        _mounting(session, found, start),
        start.fine,
        options.rate,
        np.array(options.offset_sigma) * start.receiver,
        start.pauses,
        unseen_wander(session.gnss.t, start.path, found.known.noise.offset_tau),
    )


def _completed_report(given: Session, begun: Begun, solved: Solved, trajectory: Trajectory) -> EstimateReport:
    """Report of the trajectory, with what was found out before there was one, and what speaks against it."""
    told, start, found = trajectory.report, solved.start, solved.found
    return replace(
        told,
        identified={
            **told.identified,
            **field_values(solved.heading, found),
            "accel_delay": identified_delay(begun.delay),
            "imu_clock_drift": begun.clock.identified(),
        },
        left_out=begun.left_out,
        problems=(
            *start.alignment.problems,
            *told.problems,
            *solved.problems,
            *_shaken(begun.session, found.known.noise),
            *_unsteady(begun.session, found.known.noise),
            *_early(told.identified),
            *_velocities_early(told.identified),
            *begun.problems,
            *begun.clock.problems(float(np.ptp(given.gnss.t))),
        ),
    )


def _contradicted(session: Session, solved: Solved) -> tuple[Problem, ...]:
    """Report what was stated of the session that it contradicts, unless axes are wrong."""
    start, found = solved.start, solved.found
    if any(problem.code in (MIRRORED_AXES, UNLIKE_AXES) for problem in start.alignment.problems):
        return ()
    stated, out = session.config.mounting.R_bs, contradicted_constants(session, found)
    if stated is not None and not found.state.geometry.is_steered and not start.alignment.is_level_only:
        out += contradicted_mounting(stated, _fitted_mounting(found, start))
    return (*out, *contradicted_filter(session), *contradicted_noise(start))


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
    if not mounting.is_fitted:
        return mounting
    mean, common = attitude_variance(found, mounting.R_bs, without_samples(start.fine))
    own = float(max(mean[0] - common[0], 0.0))
    mounting = on_its_ground(mounting, state, own, start.fine.missing)
    if known.wheels_heading is None:
        return mounting
    slip = COLUMNS["slip"].start
    return along_wheels(mounting, state, float(known.constants_covariance[slip, slip]) + known.wheels_heading)
