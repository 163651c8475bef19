"""Speed of every lap at entry and exit of a corner, and its minimum, with sigmas.

The sigma contains the position error: a metre along the track, where a kart brakes, is half a metre a second. The
minimum of many rows is biased by their noise, so speeds are smoothed first, as for the top speed.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.laps.path import interpolated
from smoother.laps.results import Traces
from smoother.laps.top_speed import smoothed_speed, speed_sigma
from smoother.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class CornerSpeeds:
    """Speeds (L,) m/s of all laps in one corner, NaN where unknown, each with its sigma (L,) m/s."""

    entry_speed: Array
    entry_speed_sigma: Array
    min_speed: Array
    min_speed_sigma: Array
    exit_speed: Array
    exit_speed_sigma: Array


@dataclass(frozen=True, eq=False)
class SmoothSpeed:
    """Smoothed speed of all rows of a trajectory: t (N,) s, speed and its sigma (N,) m/s."""

    t: Array
    speed: Array
    sigma: Array


def smooth_speed(trajectory: Trajectory) -> SmoothSpeed:
    """Return the smoothed speed of a trajectory, at least 0."""
    return SmoothSpeed(
        trajectory.t, np.maximum(smoothed_speed(trajectory.speed, trajectory.t), 0.0), speed_sigma(trajectory)
    )


def corner_speeds(speed: SmoothSpeed, traces: Traces, start: float, end: float) -> CornerSpeeds:
    """Return the speeds of all laps where a corner starts and ends (m along the track), and between them."""
    entry, entry_sigma = speed_at(speed, traces, start)
    exit_, exit_sigma = speed_at(speed, traces, end)
    least, least_sigma = _least(speed, traces, start, end)
    for other, sigma in ((entry, entry_sigma), (exit_, exit_sigma)):
        is_less = other < least  # by interpolation between rows
        least, least_sigma = np.where(is_less, other, least), np.where(is_less, sigma, least_sigma)
    return CornerSpeeds(entry, entry_sigma, least, least_sigma, exit_, exit_sigma)


def speed_at(speed: SmoothSpeed, traces: Traces, place: float) -> tuple[Array, Array]:
    """Return speed and sigma (L,) m/s of every lap at a track distance (m), NaN where the lap has no value.

    The slope of the speed over one sigma of the position before and after gives the contribution of its error.
    """
    at = np.full(len(traces.t), place)
    off = np.nan_to_num(_at(traces.place_sigma, traces.distance, at))
    there, before, after = (
        interpolated(_at(traces.t, traces.distance, at + by), speed.t, speed.speed) for by in (0.0 * off, -off, off)
    )
    own = interpolated(_at(traces.t, traces.distance, at), speed.t, speed.sigma)
    by_place = np.nan_to_num(np.stack([before - there, after - there]))
    return there, np.sqrt(own**2 + np.mean(by_place**2, axis=0))


def _least(speed: SmoothSpeed, traces: Traces, start: float, end: float) -> tuple[Array, Array]:
    out = np.full((2, len(traces.t)), np.nan)
    inside = (traces.distance >= start) & (traces.distance <= end)
    between = np.stack([_at(traces.t, traces.distance, np.full(len(out[0]), place)) for place in (start, end)], axis=1)
    known = np.isfinite(between).all(axis=1) & np.isfinite(traces.speed[:, inside]).all(axis=1)
    for lap in np.flatnonzero(known):
        first, last = np.searchsorted(speed.t, between[lap])
        if last > first:
            slowest = first + int(np.argmin(speed.speed[first:last]))
            out[:, lap] = speed.speed[slowest], speed.sigma[slowest]
    return out[0], out[1]


def _at(values: Array, distance: Array, places: Array) -> Array:
    """Rows of values (L, M), each at its own of the distances `places` (L,); NaN beside a NaN."""
    return np.array([np.interp(place, distance, row) for place, row in zip(places, values, strict=True)])
