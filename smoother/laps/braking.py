"""The braking point of each lap before a corner, and its sigma.

It is the start of the zone with the largest loss of speed before the apex, where the deceleration exceeds that of a
released throttle. Its sigma follows from that of the acceleration: the search is repeated with thresholds higher and
lower by it. Where a driver brakes hard all three agree; where he hardly brakes, or brakes twice, they differ.
"""

import numpy as np

from smoother.arrays import Array, runs_of
from smoother.laps.delta import BRAKING, BRAKING_ENDS
from smoother.laps.results import Traces

ACCELERATION_SIGMA = 0.5  # m/s^2, of the smoothed acceleration
EARLY = 30.0  # m before its segment at which braking for a corner may begin


def braking_points(traces: Traces, start: float, apex: float) -> tuple[Array, Array]:
    """Return the braking point (L,) m of each lap between `start` and `apex` (m), or somewhat before, and its sigma.

    NaN where a lap did not brake.
    """
    point, sigma = np.full(len(traces.t), np.nan), np.full(len(traces.t), np.nan)
    part = np.flatnonzero((traces.distance >= start - EARLY) & (traces.distance <= apex))
    if part.size < 2:
        return point, sigma
    d, slowing = traces.distance[part], -traces.longitudinal[:, part]
    for lap in np.flatnonzero(np.isfinite(slowing).sum(axis=1) > 1):
        point[lap] = _beginning(d, slowing[lap], start, 0.0)
        if not np.isfinite(point[lap]):
            continue
        others = np.array([_beginning(d, slowing[lap], start, by) for by in (-ACCELERATION_SIGMA, ACCELERATION_SIGMA)])
        late = np.nan_to_num(others - point[lap])
        place = np.interp(point[lap], traces.distance, np.nan_to_num(traces.place_sigma[lap]))
        sigma[lap] = np.sqrt(place**2 + np.mean(late**2))
    return point, sigma


def _beginning(distance: Array, slowing: Array, start: float, more: float) -> float:
    """Start (m) of the zone with the largest loss of speed among those that end after `start`; NaN without one.

    distance (M,) m; slowing (M,) m/s^2; more: m/s^2, added to the thresholds.
    """
    enter, leave = more - BRAKING, more - BRAKING_ENDS
    best, beginning = 0.0, np.nan
    for a, b in zip(*runs_of(slowing > leave), strict=True):
        later = np.arange(a, b)[distance[a:b] >= start]
        if not later.size or slowing[a:b].max() < enter:
            continue
        if (gain := float(slowing[later].sum())) > best:
            best, beginning = gain, _crossing(distance, slowing, a, leave)
    return beginning


def _crossing(distance: Array, slowing: Array, first: int, leave: float) -> float:
    """Distance (m) at which `leave` was passed before the point `first`."""
    if first == 0 or not np.isfinite(slowing[first - 1]):
        return float(distance[first])
    share = (slowing[first] - leave) / (slowing[first] - slowing[first - 1])
    return float(distance[first] - share * (distance[first] - distance[first - 1]))
