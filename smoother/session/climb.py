"""Velocities upwards against heights: which of both is in another unit, or points the other way."""

import math
from dataclasses import replace

import numpy as np

from smoother.arrays import Array
from smoother.session.fix_columns import FixColumns
from smoother.session.rows import RowFilter
from smoother.session.way_steps import (
    FEWEST_STEPS,
)
from smoother.units import FOOT

CLIMB_TIME = 5.0  # s over which velocities upwards are compared with heights, whose noise then counts less
CLEARLY_ALIKE, CLEARLY = 0.5, 3.0  # correlation of the two; sigmas
LEAST_RISE = 0.6  # m of height for one by the velocities; real receivers have 0.7 to 1.3, and km/h make 0.28
SAME_FOOT = 0.1  # share; of 98 sessions that tell it to a tenth, heights in metres are as near to theirs in 89
# m, rms of the climb in CLIMB_TIME. On flat ground heights wander with the receiver, and velocities that were smoothed
# follow them by as much as they like
HILLY = 0.5
LEAST_RISE_IN_FEET = 2.0  # likewise for one by the velocities, by CLEARLY; metres come nowhere near


def without_wrong_climb(rows: RowFilter, t: Array, c: FixColumns) -> FixColumns:
    """The columns without velocities upwards that clearly contradict the heights: in km/h, or positive downwards.

    Heights that are in feet by these velocities are turned into metres.
    """
    share, sigma, climbs = _rise_by_climb(t, c)
    if share + CLEARLY * sigma <= LEAST_RISE:
        what = "fall where its heights rise" if share < 0.0 else f"are {1.0 / share:.1f} times what its heights rise"
        rows.say("climb_wrong", f"its velocities upwards {what}; not used. Are they in m/s, and positive upwards?", 1)
        return replace(c, velocity_up=np.full(t.size, np.nan))
    if climbs > HILLY and abs(share * FOOT - 1.0) < SAME_FOOT and share - CLEARLY * sigma > LEAST_RISE_IN_FEET:
        text = f"its heights rise {share:.1f} times as fast as its velocities upwards say, as if in feet; taken as such"
        rows.say("height_unit", text, 1)
        return replace(c, alt_m=c.alt_m * FOOT)
    return c


def _rise_by_climb(t: Array, c: FixColumns) -> tuple[float, float, float]:
    """Metres of height for one that the velocities upwards tell, and its sigma; NaN where the two are not alike.

    And how many metres, rms, they tell for CLIMB_TIME.
    """
    unknown = float("nan"), float("nan"), 0.0
    known = np.flatnonzero(np.isfinite(c.velocity_up) & np.isfinite(c.alt_m))
    if known.size < FEWEST_STEPS:
        return unknown
    at, up, height = t[known], c.velocity_up[known], c.alt_m[known]
    way = np.concatenate([[0.0], np.cumsum(0.5 * (up[1:] + up[:-1]) * np.diff(at))])
    bounds = np.append(0, np.flatnonzero(np.diff(np.floor((at - at[0]) / CLIMB_TIME))) + 1)
    whole = np.diff(at[bounds]) < 1.5 * CLIMB_TIME
    told, risen = np.diff(way[bounds])[whole], np.diff(height[bounds])[whole]
    if told.size < FEWEST_STEPS or not (np.any(told) and np.any(risen)):
        return unknown
    alike = float(np.sum(told * risen) / np.sqrt(np.sum(told**2) * np.sum(risen**2)))
    if abs(alike) < CLEARLY_ALIKE:
        return unknown
    share = float(np.sum(told * risen) / np.sum(told**2))
    sigma = abs(share / alike) * math.sqrt(max(0.0, 1.0 - alike**2) / told.size)
    return share, sigma, float(np.sqrt(np.mean(told**2)))
