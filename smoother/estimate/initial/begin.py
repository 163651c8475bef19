"""What a session is before it is solved: on one clock, force and rate of one time, without pauses, and aligned."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import BoolArray
from smoother.estimate.averages import averages_of
from smoother.estimate.gnss_settling import settling_problems, unsettled
from smoother.estimate.in_step import in_step
from smoother.estimate.initial.align import align
from smoother.estimate.initial.guess import Start, make_start
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.left_out import tell_motion, without_fixes, without_positions
from smoother.estimate.path_motion import PathMotion, sampled_at_speed
from smoother.estimate.pauses import Pauses, closed_up
from smoother.estimate.preprocess.agreement import false_stops, stop_problems, stream_problems
from smoother.estimate.preprocess.clock import ONE_CLOCK, Clock, moved
from smoother.estimate.preprocess.clock_fit import fit_clock, fit_lags, place_step
from smoother.estimate.preprocess.search import DELAY, search_clock
from smoother.estimate.preprocess.streams import Measured, compare_streams
from smoother.fit.force_delay import UNSEEN, ForceDelay
from smoother.samples import Problem, Session

EXPLAINED = 0.8  # share of rate and force by fixes of one clock: most have more; less is another time, or motion
BARELY = 0.3  # sigmas, from which on a drift that was taken out is corrected
PASSES = 3  # of clocks, each of which is fitted to what the one before has left
# of rate and force, by which a delay of the force is not believed. True ones explain 0.005 more to 0.0015 less (a nose
# that turns in early takes the part of a force that is), hairpins that seemed to show one of 0.1 s 0.006 to 0.017 less.
LESS_EXPLAINED = 0.003


@dataclass(frozen=True, eq=False)
class Begun:
    """A session with its samples on the clock of its fixes and its force at the time of its rate, and its start.

    clock: what was taken out. left_out (N,): fixes as given of which no position is used, None where all are;
    `problems` say why.
    """

    session: Session
    start: Start
    delay: ForceDelay
    clock: Clock = ONE_CLOCK
    problems: tuple[Problem, ...] = ()
    left_out: BoolArray | None = None

    @property
    def explains(self) -> float:
        """Share of rate and force that the fixes explain."""
        return self.start.alignment.share_explained


def begin(given: Session, options: GraphOptions, cut_out: Callable[[Session], Pauses]) -> Begun:
    """Begin with a session, without the fixes that stand while the kart drives, and those that had not settled."""
    begun = _on_one_clock(given, options, cut_out)
    clock, out = begun.clock, begun.clock.unsure(given.gnss.t)
    given, line = moved(given, clock.moves), replace(clock, steps=())

    def begin_again(without: Session) -> Begun:
        on_one = line.taken_out(without)
        return _begun(on_one, options, cut_out(on_one))

    stopped, of_stops = _false_stops(begun)
    if stopped.any():
        begun = begin_again(without_fixes(given, out | stopped))
    rest = without_fixes(given, out | stopped) if (out | stopped).any() else given
    early = unsettled(rest)
    if early.any():
        begun = begin_again(without_positions(rest, early))
    problems = (
        *settling_problems(given.gnss.t, early),
        *of_stops,
        *_stream_problems(begun),
    )
    left_out = out | stopped | early
    return replace(begun, clock=clock, problems=problems, left_out=left_out if left_out.any() else None)


def _on_one_clock(given: Session, options: GraphOptions, cut_out: Callable[[Session], Pauses]) -> Begun:
    """Begin with a session, whose samples' clock may show another time than that of its fixes, step or drift."""
    begun = _begun(given, options, cut_out(given))
    if begun.start.alignment.is_level_only:
        return begun
    fitted = _with_fitted_clock(given, begun, options, cut_out)
    if fitted.explains >= EXPLAINED:
        return fitted
    assert given.imu is not None
    found = search_clock(given.imu, _driven(given, begun))
    if found is None:
        return fitted
    offset, drift = found
    clock = Clock(offset, drift, drifts=drift != 0.0, zero=float(given.gnss.t[0]))
    on_one = clock.taken_out(given)
    other = replace(_begun(on_one, options, cut_out(on_one)), clock=clock)
    if offset != 0.0:  # which the alignment knows better than a search in steps
        clock = replace(clock, offset=offset + DELAY - other.start.alignment.lag)
        on_one = clock.taken_out(given)
        other = replace(_begun(on_one, options, cut_out(on_one)), clock=clock)
    other = _with_fitted_clock(given, other, options, cut_out)
    return other if other.explains > max(fitted.explains, EXPLAINED) else fitted


def _with_fitted_clock(
    given: Session, begun: Begun, options: GraphOptions, cut_out: Callable[[Session], Pauses]
) -> Begun:
    """Begin with a session without what its streams show of its clock beyond that of `begun`.

    A clock by which samples and fixes have less in common is none.
    """
    for _ in range(PASSES):
        on_one = begun.clock.taken_out(given)
        clock = begun.clock
        with suppress(np.linalg.LinAlgError):  # then nothing is known of a clock, and that is all
            clock = _refined(clock, on_one, begun)
        if clock.does_as(begun.clock):
            return replace(begun, clock=clock)
        out, session = clock.unsure(given.gnss.t), clock.taken_out(given)
        session = without_fixes(session, out) if out.any() else session
        better = replace(_begun(session, options, cut_out(session)), clock=clock)
        margin = LESS_EXPLAINED if begun.clock.drifts else 0.0  # a drift that is only corrected explains about as much
        if not better.explains > begun.explains - margin:
            return replace(begun, clock=begun.clock.not_beyond(clock))
        begun = better
    return begun


def _refined(clock: Clock, session: Session, begun: Begun) -> Clock:
    """The clock with what the streams of a session, from which it is taken out, show beyond it."""
    assert session.imu is not None
    measured, path = _measured(session, begun), _driven(session, begun)
    streams = compare_streams(measured, path, sampled_at_speed(session.imu, path), begun.start.alignment.lag)
    if streams is None:
        return clock
    fit = fit_clock(streams)
    placed = () if clock.steps else range(len(fit.steps))
    steps = tuple(place_step(streams, fit, k, measured, path, (session.imu.t, session.gnss.t)) for k in placed)
    drift = fit.drift or fit_lags(streams, fit.steps, is_line=True).changes[-1]
    lasts = float(np.ptp(streams.t))
    is_drifting = fit.is_line or (clock.drifts and abs(drift.value) > BARELY * drift.sigma)
    return clock.and_beyond(-drift.value / lasts, drift.sigma / lasts, steps, session, is_drifting=is_drifting)


def _measured(session: Session, begun: Begun) -> Measured:
    assert session.imu is not None
    alignment = begun.start.alignment
    return Measured(averages_of(session.imu), alignment.R_bs, alignment.gyro_bias_s)


def _driven(session: Session, begun: Begun) -> PathMotion:
    """The path at the fixes of a session in which pauses are not closed: in these, clocks run on."""
    return replace(begun.start.driven, t=session.gnss.t)


def _false_stops(begun: Begun) -> tuple[BoolArray, tuple[Problem, ...]]:
    """Mask (N,) of the fixes that stand while the kart drives on, and what to report."""
    session, start = begun.session, begun.start
    assert session.imu is not None
    use = sampled_at_speed(session.imu, start.driven)
    if start.alignment.is_level_only:
        return np.zeros(len(session.gnss), dtype=np.bool_), ()
    out, stops = false_stops(_measured(session, begun), session.imu.t, start.driven, use, start.alignment.lag)
    return out, stop_problems(start.pauses.opened(stops) - _first(begun))


def _stream_problems(begun: Begun) -> tuple[Problem, ...]:
    """What the streams show that nothing explains: lags that change, and stretches of another motion."""
    session, start = begun.session, begun.start
    assert session.imu is not None
    use = sampled_at_speed(session.imu, start.driven)
    use = use[tell_motion(session, by_velocity=start.driven.is_measured)[use]]  # no line across fixes left out
    if start.alignment.is_level_only:
        return ()
    streams = compare_streams(_measured(session, begun), start.driven, use, start.alignment.lag)
    if streams is None:
        return ()
    first, last = (start.pauses.opened(t) - _first(begun) for t in (streams.first, streams.last))
    return stream_problems(streams, first, last)


def _first(begun: Begun) -> float:
    """Time of the first fix, s, pauses included."""
    return float(begun.start.pauses.opened(begun.session.gnss.t[:1])[0])


def _begun(given: Session, options: GraphOptions, pauses: Pauses) -> Begun:
    """Begin with a session of one clock, of which pauses are cut out.

    A nose that turns in and out of hairpins on its own makes a delay of the force too. It is none where the fixes,
    which have nothing to do with it, explain less of force and rate without it.
    """
    given = closed_up(given, pauses) if len(pauses) else given
    session, delay = in_step(given) if options.in_step else (given, UNSEEN)
    # densities and constants are known to some per cent from two minutes of driving
    start = make_start(session, options, options.identification_span, pauses=pauses)
    if delay.is_found:
        assert given.imu is not None
        as_given = align(given.imu, start.driven).share_explained
        if as_given > start.alignment.share_explained + LESS_EXPLAINED:
            start = make_start(given, options, options.identification_span, pauses=pauses)
            return Begun(given, start, UNSEEN)
    return Begun(session, start, delay)
