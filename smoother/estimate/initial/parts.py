"""Parts of a start: its busiest stretch, what is sampled of it, and the keyframes from one to another."""

from dataclasses import replace

import numpy as np

from smoother.arrays import BoolArray
from smoother.estimate.factors.graph import MAX_LATENCY
from smoother.estimate.initial.guess import Start, busiest_span, have_samples
from smoother.estimate.model.imu import has_hole


def busiest_part(start: Start, span: float) -> Start:
    """Return the stretch of `span` seconds with most fixes at speed, or all of it when it is not much longer.

    What was driven is known of the whole session, of which a start may be a stretch already.
    """
    t, driven = start.state.t, start.driven
    inside = (driven.t >= t[0]) & (driven.t <= t[-1])
    if not np.any(inside):
        return start
    is_reported = None if driven.is_reported is None else driven.is_reported[inside]
    driven = replace(driven, t=driven.t[inside], velocity_n=driven.velocity_n[inside], is_reported=is_reported)
    begin, end = busiest_span(driven, start.spans, span)
    if end == driven.t[-1]:
        return start
    first, last = np.searchsorted(t, [begin - MAX_LATENCY, end])
    return stretch(start, int(first), min(int(last), len(t) - 1))


def is_partly_sampled(start: Start) -> bool:
    """Whether some of the fixes have no samples, and must not tell the constants."""
    return has_hole(start.spans, start.data.t[0], start.data.t[-1])


def longest_sampled(start: Start) -> Start:
    """Return the longest stretch of the start that has samples throughout; the start itself where all of it has."""
    if not is_partly_sampled(start):
        return start
    t = start.state.t
    inside = np.clip(start.spans, t[0], t[-1])
    begin, end = inside[np.argmax(np.diff(inside, axis=1)[:, 0])]
    first, last = np.searchsorted(t, [begin, end])
    part = stretch(start, max(int(first) - 1, 0), min(int(last), len(t) - 1))
    return replace(part, data=part.data.of(have_samples(start.spans, part.data.t)))


def fixes_between(start: Start, first: int, last: int) -> BoolArray:
    """Mask (N,) of the fixes that are read between the keyframes first and last, whatever their latency."""
    return start.data.are_between(start.state.t, first, last + 1)


def stretch(start: Start, first: int, last: int) -> Start:
    """Return the start of the keyframes first .. last alone."""
    data = start.data.between(start.state.t, first, last + 1)
    state, binned = start.state.part(slice(first, last + 1)), start.binned.between(first, last + 1)
    return replace(start, state=state, data=data, binned=binned)
