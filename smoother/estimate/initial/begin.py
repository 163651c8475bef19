"""A session before it is solved: on one clock, force at the time of the rate, without pauses, and aligned."""

from dataclasses import dataclass, replace

from smoother.arrays import BoolArray
from smoother.estimate.factors.graph import GraphOptions
from smoother.estimate.fixes.screen import settling_problems, unsettled, without_positions
from smoother.estimate.initial.align import align
from smoother.estimate.initial.guess import Start, make_start
from smoother.estimate.preprocess.clock import ONE_CLOCK, Clock, Step, fit_drift, fit_step
from smoother.estimate.preprocess.force_delay import UNSEEN, ForceDelay, in_step
from smoother.estimate.preprocess.pauses import closed_up, pauses_of
from smoother.estimate.preprocess.streams import (
    Measured,
    Streams,
    averages_of,
    compare_streams,
    sampled_at_speed,
)
from smoother.samples import Problem, Session

BARELY = 0.3  # sigmas above which a corrected drift is corrected again
PASSES = 5  # of the clock, each fitted to the residual of the one before
# of the explained share of rate and force; a latency of the force that reduces it by more is rejected. True ones change
# it by +0.005 to -0.0015 (sideslip partly acts like a latency), hairpins that seemed to show one of 0.1 s by -0.006 to
# -0.017.
LESS_EXPLAINED = 0.003


@dataclass(frozen=True, eq=False)
class AlignedSession:
    """A session with its samples on the clock of its fixes and its force at the time of its rate, and its start.

    clock: what was corrected. left_out (N,): fixes as given of which no position is used, None where all are;
    `problems` say why. unusable: why the samples cannot be used.
    """

    session: Session
    start: Start
    delay: ForceDelay
    clock: Clock = ONE_CLOCK
    problems: tuple[Problem, ...] = ()
    left_out: BoolArray | None = None
    unusable: tuple[Problem, ...] = ()

    @property
    def explains(self) -> float:
        """Share of rate and force that the fixes explain."""
        return self.start.alignment.share_explained


def begin(given: Session, options: GraphOptions) -> AlignedSession:
    """Begin with a session, without the positions of a receiver that had not settled."""
    early = unsettled(given)
    if not early.any():
        return _on_one_clock(given, options)
    aligned = _on_one_clock(without_positions(given, early), options)
    return replace(aligned, problems=settling_problems(given.gnss.t, early), left_out=early)


def _on_one_clock(given: Session, options: GraphOptions) -> AlignedSession:
    """Begin with a session, corrected for a drift between the clocks of samples and fixes; a step is refused.

    A correction after which the fixes explain less of the samples is rejected.
    """
    aligned = _aligned(given, options)
    for _ in range(PASSES):
        corrected = aligned.clock.corrected(given)
        streams = _streams(corrected, aligned)
        if streams is None:
            return aligned
        beyond, step = fit_drift(streams), fit_step(streams)
        drifts_on = aligned.clock.drifts and abs(beyond.value) > BARELY * beyond.sigma
        if beyond.is_sure or drifts_on:
            clock = aligned.clock.and_beyond(beyond, float(given.gnss.t[0]))
        elif step is not None and step.is_sure:
            return replace(aligned, unusable=(_step_problem(step),))
        else:
            return replace(aligned, clock=aligned.clock.without_more(beyond))
        better = replace(_aligned(clock.corrected(given), options), clock=clock)
        if not better.explains > aligned.explains - LESS_EXPLAINED * drifts_on:
            return replace(aligned, clock=aligned.clock.without_more(beyond))
        aligned = better
    return aligned


def _step_problem(step: Step) -> Problem:
    text = (
        f"the samples' clock steps by {step.value:+.2f} s against that of the fixes near t_s = {step.at:.0f}; smoothed "
        "from the fixes alone. Cut the session there"
    )
    return Problem("clock_step", text)


def _streams(session: Session, aligned: AlignedSession) -> Streams | None:
    """Samples and fixes compared, pauses included."""
    alignment = aligned.start.alignment
    if alignment.is_level_only:
        return None
    assert session.imu is not None
    measured = Measured(averages_of(session.imu), alignment.R_bs, alignment.gyro_bias_s)
    path = replace(aligned.start.driven, t=session.gnss.t)
    return compare_streams(measured, path, sampled_at_speed(session.imu, path), alignment.lag)


def _aligned(given: Session, options: GraphOptions) -> AlignedSession:
    """Begin with a session of one clock, and cut its pauses out.

    A latency of the force is rejected where the fixes explain less of force and rate after its correction.
    """
    pauses = pauses_of(given)
    given = closed_up(given, pauses) if len(pauses) else given
    session, delay = in_step(given) if options.in_step else (given, UNSEEN)
    # densities and constants are known to some per cent from two minutes of driving
    start = make_start(session, options, options.identification_span, pauses=pauses)
    if delay.is_found:
        assert given.imu is not None
        as_given = align(given.imu, start.driven).share_explained
        if as_given > start.alignment.share_explained + LESS_EXPLAINED:
            start = make_start(given, options, options.identification_span, pauses=pauses)
            return AlignedSession(given, start, UNSEEN)
    return AlignedSession(session, start, delay)
