"""What a session is before it is solved: on one clock, force and rate of one time, without pauses, and aligned."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import BoolArray
from smoother.estimate.clock_offset import EXPLAINED, NO_OFFSET, ClockOffset, clock_offset, without_offset
from smoother.estimate.clock_steps import ClockStep, beside_steps, moves_of, session_steps
from smoother.estimate.clocks import UNSEEN_DRIFT, ClockDrift, clock_drift, on_clock_of_fixes
from smoother.estimate.gnss_coasting import coasting, coasting_problems
from smoother.estimate.gnss_settling import settling_problems, unsettled
from smoother.estimate.in_step import in_step
from smoother.estimate.initial.align import align
from smoother.estimate.initial.guess import Start, make_start
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.left_out import without_fixes, without_positions
from smoother.estimate.path_motion import PathMotion
from smoother.estimate.pauses import Pauses, closed_up
from smoother.estimate.retimed import moved
from smoother.estimate.stretches import false_stands, stretch_problems
from smoother.fit.force_delay import UNSEEN, ForceDelay
from smoother.samples import Problem, Session

# of rate and force, by which a delay of the force is not believed. True ones explain 0.005 more to 0.0015 less (a nose
# that turns in early takes the part of a force that is), hairpins that seemed to show one of 0.1 s 0.006 to 0.017 less.
LESS_EXPLAINED = 0.003
LOOKS = 3  # for fixes of a receiver that went straight on; those that are left out first hid others


@dataclass(frozen=True, eq=False)
class Begun:
    """A session with its samples on the clock of its fixes and its force at the time of its rate, and its start.

    left_out (N,) : fixes as given of which no position is used, None where all are; `problems` say why.
    """

    session: Session
    start: Start
    delay: ForceDelay
    drift: ClockDrift = UNSEEN_DRIFT
    offset: ClockOffset = NO_OFFSET
    steps: tuple[ClockStep, ...] = ()
    problems: tuple[Problem, ...] = ()
    left_out: BoolArray | None = None


def begin(given: Session, options: GraphOptions, cut_out: Callable[[Session], Pauses]) -> Begun:
    """Begin with a session, without the fixes of a receiver that went straight on or had not settled."""
    begun = _on_one_clock(given, options, cut_out, seeks_steps=True)
    steps = begun.steps
    of_steps = beside_steps(given, steps)
    given, out = moved(given, moves_of(steps)), of_steps.copy()
    for _ in range(LOOKS):
        more = coasting(begun.session, begun.start.alignment, begun.start.driven) & ~out
        if not more.any():
            break
        out |= more
        begun = _on_one_clock(without_fixes(given, out), options, cut_out)
    stood, of_stands = false_stands(begun.session, begun.start.driven, begun.start.alignment, begun.start.pauses)
    if stood.any():
        begun = _on_one_clock(without_fixes(given, out | stood), options, cut_out)
    rest = without_fixes(given, out | stood) if (out | stood).any() else given
    early = unsettled(rest)
    if early.any():
        begun = _on_one_clock(without_positions(rest, early), options, cut_out)
    start = begun.start
    problems = (
        *coasting_problems(out & ~of_steps),
        *settling_problems(given.gnss.t, early),
        *of_stands,
        *stretch_problems(begun.session, start.driven, start.alignment, start.pauses),
    )
    left_out = out | stood | early
    return replace(begun, steps=steps, problems=problems, left_out=left_out if left_out.any() else None)


def _on_one_clock(
    given: Session, options: GraphOptions, cut_out: Callable[[Session], Pauses], *, seeks_steps: bool = False
) -> Begun:
    """Begin with a session, whose samples' clock may show another time than that of its fixes, step or drift."""
    begun = _at_one_pace(given, options, cut_out, seeks_steps=seeks_steps)
    if _explains(begun) >= EXPLAINED or begun.start.alignment.is_level_only:
        return begun
    assert given.imu is not None
    offset = clock_offset(given.imu, _driven(given, begun))
    if not offset.is_found:
        return begun
    better = _at_one_pace(without_offset(given, offset), options, cut_out)
    return replace(better, offset=offset) if _explains(better) > max(_explains(begun), EXPLAINED) else begun


def _explains(begun: Begun) -> float:
    """Share of rate and force that the fixes explain."""
    return begun.start.alignment.share_explained


def _at_one_pace(
    given: Session, options: GraphOptions, cut_out: Callable[[Session], Pauses], *, seeks_steps: bool = False
) -> Begun:
    """Begin with a session whose clocks may drift: they do where samples and fixes then explain more of one another."""
    begun, drift = _begun(given, options, cut_out(given)), UNSEEN_DRIFT
    if seeks_steps:  # before a drift, which one that is large would pass for
        given, begun = _without_steps(given, begun, options, cut_out)
    assert given.imu is not None
    stays = not all(step.is_placed for step in begun.steps)  # and would pass for a drift
    if not (stays or begun.start.alignment.is_level_only):
        driven = _driven(given, begun)
        with suppress(np.linalg.LinAlgError):  # then nothing is known of a drift, and that is all
            drift = clock_drift(given.imu, driven, begun.start.alignment)
    if drift.is_found:
        on_one = on_clock_of_fixes(given, drift)
        better = _begun(on_one, options, cut_out(on_one))
        if _explains(better) > max(_explains(begun), EXPLAINED):
            return replace(better, drift=drift, steps=begun.steps)
        drift = replace(drift, is_found=False)
    return replace(begun, drift=drift)


def _driven(given: Session, begun: Begun) -> PathMotion:
    """The path at the fixes as given, since in pauses that are closed clocks run on."""
    return replace(begun.start.driven, t=given.gnss.t)


def _without_steps(
    given: Session, begun: Begun, options: GraphOptions, cut_out: Callable[[Session], Pauses]
) -> tuple[Session, Begun]:
    """Session and beginning without steps between its clocks; what leaves less in common of the two was none."""
    if begun.start.alignment.is_level_only:
        return given, begun
    steps: tuple[ClockStep, ...] = ()
    with suppress(np.linalg.LinAlgError):  # then nothing is known of steps, and that is all
        steps = session_steps(given, _driven(given, begun), begun.start.alignment)
    if not any(step.is_placed for step in steps):
        return given, replace(begun, steps=steps)
    out, on_one = beside_steps(given, steps), moved(given, moves_of(steps))
    on_one = without_fixes(on_one, out) if out.any() else on_one
    better = _begun(on_one, options, cut_out(on_one))
    return (on_one, replace(better, steps=steps)) if _explains(better) > _explains(begun) else (given, begun)


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
