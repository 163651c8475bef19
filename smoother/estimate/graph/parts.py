"""Parts of a start: its busiest stretch, what is sampled of it, and the keyframes from one to another."""

from dataclasses import replace

import numpy as np

from smoother.arrays import BoolArray
from smoother.estimate.graph.inputs import Data
from smoother.estimate.graph.sampled import has_hole
from smoother.estimate.graph.start import MAX_LATENCY, Start, busiest_span, have_samples


def busiest_part(start: Start, span: float) -> Start:
    """Return the stretch of `span` seconds with most fixes at speed, or all of it when it is not much longer.

    What was driven is known of the whole session, of which a start may be a stretch already.
    """
    t, driven = start.state.t, start.driven
    inside = (driven.t >= t[0]) & (driven.t <= t[-1])
    if not np.any(inside):
        return start
    is_told = None if driven.is_told is None else driven.is_told[inside]
    driven = replace(driven, t=driven.t[inside], velocity_n=driven.velocity_n[inside], is_told=is_told)
    begin, end = busiest_span(driven, start.spans, span)
    if end == driven.t[-1]:
        return start
    first, last = np.searchsorted(t, [begin - MAX_LATENCY, end])
    return stretch(start, int(first), min(int(last), len(t) - 1))


def is_partly_sampled(start: Start) -> bool:
    """Whether some of the fixes have no samples, and must not tell the constants."""
    return has_hole(start.spans, start.data.t[0], start.data.t[-1])


def where_sampled(start: Start) -> Start:
    """Return the start that the constants are found from: the fixes that have samples, holes between them not bridged.

    The start itself where all of it is sampled.
    """
    if not is_partly_sampled(start):
        return start
    t = start.state.t
    spans = start.spans[(start.spans[:, 1] > t[0]) & (start.spans[:, 0] < t[-1])]
    first, last = np.searchsorted(t, [spans[0, 0], spans[-1, 1]])
    part = stretch(start, max(int(first) - 1, 0), min(int(last), len(t) - 1))
    data = _of_fixes(part.data, have_samples(spans, part.data.t))
    return replace(part, data=replace(data, sampled=spans, pauses=start.pauses))


def longest_sampled(start: Start) -> Start:
    """Return the longest stretch of the start that has samples throughout; the start itself where all of it has."""
    if not is_partly_sampled(start):
        return start
    t = start.state.t
    inside = np.clip(start.spans, t[0], t[-1])
    begin, end = inside[np.argmax(np.diff(inside, axis=1)[:, 0])]
    first, last = np.searchsorted(t, [begin, end])
    part = stretch(start, max(int(first) - 1, 0), min(int(last), len(t) - 1))
    return replace(part, data=_of_fixes(part.data, have_samples(start.spans, part.data.t)))


def fixes_between(start: Start, first: int, last: int) -> BoolArray:
    """Mask (N,) of the fixes that are read between the keyframes first and last, whatever their latency."""
    t, keyframes = start.data.t, start.state.t
    return np.asarray((t > keyframes[first] + MAX_LATENCY) & (t < keyframes[last]))


def stretch(start: Start, first: int, last: int) -> Start:
    """Return the start of the keyframes first .. last alone."""
    data = start.data
    still = data.still[(data.still >= first) & (data.still < last)] - first
    part = replace(_of_fixes(data, fixes_between(start, first, last)), still=still, heading=None)
    state, binned = start.state.between(first, last + 1), start.binned.between(first, last + 1)
    return replace(start, state=state, data=part, binned=binned)


def _of_fixes(data: Data, use: BoolArray) -> Data:
    """Return the measurements with the fixes `use` (N,) alone."""
    names = ("t", "position_n", "velocity_n", "position_scale", "velocity_scale")
    doubted = None if data.doubted is None else data.doubted[use]
    return replace(data, doubted=doubted, **{name: getattr(data, name)[use] for name in names})
