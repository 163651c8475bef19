"""Which times of a session the inertial samples cover, where that is not all of it: a sensor starts late or pauses."""

import numpy as np

from smoother.arrays import Array, BoolArray

HOLE = 2.0  # s without samples; what is made up in shorter ones, samples on both sides keep near to what it was
FEW = 0.05  # share of a session without samples that changes no figure of the others


def sampled_spans(t: Array) -> Array:
    """Return first and last times (S, 2) s of the stretches of samples at t (N,) s, N > 0, that have no hole."""
    before = np.flatnonzero(np.diff(t) > HOLE)
    return np.column_stack([t[np.append(0, before + 1)], t[np.append(before, len(t) - 1)]])


def has_hole(spans: Array, first: float, last: float) -> bool:
    """Whether there is a hole between the spans (S, 2) s, or before or after all of them, from time first to last s."""
    inside = spans[(spans[:, 1] > first) & (spans[:, 0] < last)]
    return len(inside) != 1 or inside[0, 0] - first > HOLE or last - inside[0, 1] > HOLE


def are_sampled(spans: Array, since: Array, until: Array) -> BoolArray:
    """Whether all of each time from since to until (N,) s, the two in order, is within one of the spans (S, 2) s."""
    latest = np.searchsorted(spans[:, 0], since, side="right") - 1
    return np.asarray((latest >= 0) & (until <= spans[np.maximum(latest, 0), 1]))
