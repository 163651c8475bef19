"""Where a lap began to brake for a corner, and how sure that is.

The zone that takes most speed before the apex counts, from where the kart slows by more than the foot off the pedal
does. How unsure the acceleration is tells how unsure the place is: it is looked for again with thresholds higher and
lower by that much. Where a driver brakes hard both are near; where he hardly does, or brakes twice, they are far apart.
"""

import numpy as np

from smoother.arrays import Array, runs_of
from smoother.laps.delta import BRAKING, BRAKING_ENDS
from smoother.laps.results import Traces

ACCELERATION_SIGMA = 0.5  # m/s^2, of the smoothed acceleration that tells a braking zone
EARLY = 30.0  # m before its segment that the braking for a corner may begin


def braking_points(traces: Traces, start: float, apex: float) -> tuple[Array, Array]:
    """Return where each lap began to brake between `start` and `apex` (m), or somewhat before, (L,) m, and its sigma.

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
    """Distance (m) at which the zone begins that takes most speed of those that last beyond `start`; NaN without one.

    distance (M,) m; slowing (M,) m/s^2; more: m/s^2 by which thresholds are higher.
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
