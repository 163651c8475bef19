"""How fast a lap was where a corner begins and ends, and at its slowest, with sigmas.

A speed at a place is as unsure as the place: a metre along the track, where a kart brakes, is half a metre a second.
The lowest of many rows is the unluckiest of them, so speeds are steadied first, as for the top speed.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.laps.path import interpolated
from smoother.laps.results import Traces
from smoother.laps.top_speed import speed_sigma, steadied
from smoother.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class CornerSpeeds:
    """Speeds (L,) m/s of all laps in one corner, NaN where unknown, each with its sigma (L,) m/s."""

    entry: Array
    entry_sigma: Array
    least: Array
    least_sigma: Array
    exit: Array
    exit_sigma: Array


@dataclass(frozen=True, eq=False)
class SteadySpeed:
    """Speed of all rows of a trajectory without the noise of single ones: t (N,) s, speed and its sigma (N,) m/s."""

    t: Array
    speed: Array
    sigma: Array


def steady_speed(trajectory: Trajectory) -> SteadySpeed:
    """Return the speed of a trajectory steadied over a moment; never below 0, as a parabola may be at a stop."""
    return SteadySpeed(trajectory.t, np.maximum(steadied(trajectory.speed, trajectory.t), 0.0), speed_sigma(trajectory))


def corner_speeds(speed: SteadySpeed, traces: Traces, start: float, end: float) -> CornerSpeeds:
    """Return the speeds of all laps where a corner starts and ends (m along the track), and between them."""
    entry, entry_sigma = speed_at(speed, traces, start)
    exit_, exit_sigma = speed_at(speed, traces, end)
    least, least_sigma = _least(speed, traces, start, end)
    for other, sigma in ((entry, entry_sigma), (exit_, exit_sigma)):
        is_less = other < least  # by what lies between the rows
        least, least_sigma = np.where(is_less, other, least), np.where(is_less, sigma, least_sigma)
    return CornerSpeeds(entry, entry_sigma, least, least_sigma, exit_, exit_sigma)


def speed_at(speed: SteadySpeed, traces: Traces, place: float) -> tuple[Array, Array]:
    """Return speed and sigma (L,) m/s of every lap at a track distance (m), NaN where it was not there.

    Speeds a sigma of the place before and after it tell what that makes of the speed.
    """
    at = np.full(len(traces.t), place)
    off = np.nan_to_num(_at(traces.place_sigma, traces.distance, at))
    there, before, after = (
        interpolated(_at(traces.t, traces.distance, at + by), speed.t, speed.speed) for by in (0.0 * off, -off, off)
    )
    own = interpolated(_at(traces.t, traces.distance, at), speed.t, speed.sigma)
    by_place = np.nan_to_num(np.stack([before - there, after - there]))
    return there, np.sqrt(own**2 + np.mean(by_place**2, axis=0))


def _least(speed: SteadySpeed, traces: Traces, start: float, end: float) -> tuple[Array, Array]:
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
