"""Checks of heights: of another unit, that jump, and velocities upwards that contradict them.

Latitude and longitude of those fixes are as good as ever.
"""

import math

import numpy as np

from smoother.session.checks.columns import FixRows
from smoother.session.checks.table import Finding
from smoother.session.fix_columns import way_from_before
from smoother.units import FOOT
from smoother.words import counted

JUMP_HEIGHT = 50.0  # m from one fix to the next; recorded ones have 30 at most, of a receiver that is walked with
FASTEST_CLIMB = 50.0  # m/s
SLOPE_SPAN, SLOPE_WAY = 5.0, 30.0  # s and m over which the way rises or falls, beyond what heights scatter
STEEPEST = 0.3  # of the way, that it rises or falls by for half of it; hill climbs have 0.1, centimetres for metres 1
FEWEST_SLOPES, FEWEST_CLIMBS = 50, 20
CLIMB_TIME = 5.0  # s over which velocities upwards are compared with heights, whose noise then counts less
CLEARLY_ALIKE, CLEARLY = 0.5, 3.0  # correlation of the two; sigmas
LEAST_RISE = 0.6  # m of height for one by the velocities; real receivers have 0.7 to 1.3, and km/h make 0.28
SAME_FOOT = 0.1  # share
# m, rms of the climb in CLIMB_TIME. On flat ground heights wander with the receiver, and velocities that were smoothed
# follow them by as much as they like
HILLY = 0.5
LEAST_RISE_IN_FEET = 2.0  # likewise for one by the velocities, by CLEARLY; metres come nowhere near


def impossible_heights(f: FixRows) -> Finding | None:
    """Heights as steep as no road is: of another unit."""
    t, alt_m, way = f.columns.t, f.columns.alt_m, np.cumsum(way_from_before(f.columns))
    known = np.flatnonzero(np.isfinite(alt_m))
    later = np.searchsorted(t[known], t[known] + SLOPE_SPAN)
    first = np.flatnonzero(later < known.size)
    first, last = known[first], known[later[first]]
    gone = way[last] - way[first]
    far = (gone > SLOPE_WAY) & (t[last] - t[first] < 2.0 * SLOPE_SPAN)
    slope = np.abs(alt_m[last] - alt_m[first])[far] / gone[far]
    if slope.size < FEWEST_SLOPES or (usual := float(np.median(slope))) < STEEPEST:
        return None
    text = f"heights rise and fall by {100.0 * usual:.0f} % of the way, which no track does; in metres? None was used"
    return Finding(text, known.size, blank={"alt_m": np.ones(t.size, dtype=np.bool_)})


def height_jumps(f: FixRows) -> Finding | None:
    """Heights that no kart climbs to from those of the longest stretch without a jump."""
    t, alt_m = f.columns.t, f.columns.alt_m
    known = np.flatnonzero(np.isfinite(alt_m))
    height, at = alt_m[known], t[known]
    cuts = np.flatnonzero(np.abs(np.diff(height)) > JUMP_HEIGHT + FASTEST_CLIMB * np.diff(at)) + 1
    if not cuts.size:
        return None
    bounds = np.concatenate([[0], cuts, [known.size]])
    main = int(np.argmax(np.diff(bounds)))
    ends = [int(bounds[main]), int(bounds[main + 1]) - 1]
    bad = np.zeros(t.size, dtype=np.bool_)
    for side, pieces in ((1, range(main + 1, cuts.size + 1)), (0, range(main - 1, -1, -1))):
        near = ends[side]
        for piece in pieces:
            first, last = int(bounds[piece]), int(bounds[piece + 1]) - 1
            facing, far = (first, last) if side else (last, first)
            if abs(height[facing] - height[near]) > JUMP_HEIGHT + FASTEST_CLIMB * abs(at[facing] - at[near]):
                bad[known[first : last + 1]] = True
            else:
                near = far
    count = int(np.count_nonzero(bad))
    text = f"{counted(count, 'height')} far from those around, which no kart climbs to; not used"
    return Finding(text, count, blank={"alt_m": bad})


def wrong_climb(f: FixRows) -> Finding | None:
    """Velocities upwards that clearly contradict the heights: in km/h, or positive downwards."""
    share, sigma, _ = _rise_by_climb(f)
    if not share + CLEARLY * sigma <= LEAST_RISE:
        return None
    what = "fall where its heights rise" if share < 0.0 else f"are {1.0 / share:.1f} times what its heights rise"
    text = f"its velocities upwards {what}; not used. Are they in m/s, and positive upwards?"
    return Finding(text, blank={"velocity_up": np.ones(f.columns.t.size, dtype=np.bool_)})


def heights_in_feet(f: FixRows) -> Finding | None:
    """Heights that are in feet by the velocities upwards."""
    share, sigma, climbs = _rise_by_climb(f)
    is_feet = climbs > HILLY and abs(share * FOOT - 1.0) < SAME_FOOT and share - CLEARLY * sigma > LEAST_RISE_IN_FEET
    text = f"its heights rise {share:.1f} times as fast as its velocities upwards say, as if in feet; taken as such"
    return Finding(text, scale={"alt_m": FOOT}) if is_feet else None


def _rise_by_climb(f: FixRows) -> tuple[float, float, float]:
    """Metres of height for one that the velocities upwards say, and its sigma; NaN where the two are not alike.

    And how many metres, rms, they say for CLIMB_TIME.
    """
    unknown, c = (math.nan, math.nan, 0.0), f.columns
    known = np.flatnonzero(np.isfinite(c.velocity_up) & np.isfinite(c.alt_m))
    if known.size < FEWEST_CLIMBS:
        return unknown
    at, up, height = c.t[known], c.velocity_up[known], c.alt_m[known]
    way = np.concatenate([[0.0], np.cumsum(0.5 * (up[1:] + up[:-1]) * np.diff(at))])
    bounds = np.append(0, np.flatnonzero(np.diff(np.floor((at - at[0]) / CLIMB_TIME))) + 1)
    whole = np.diff(at[bounds]) < 1.5 * CLIMB_TIME
    said, risen = np.diff(way[bounds])[whole], np.diff(height[bounds])[whole]
    if said.size < FEWEST_CLIMBS or not (np.any(said) and np.any(risen)):
        return unknown
    alike = float(np.sum(said * risen) / np.sqrt(np.sum(said**2) * np.sum(risen**2)))
    if abs(alike) < CLEARLY_ALIKE:
        return unknown
    share = float(np.sum(said * risen) / np.sum(said**2))
    sigma = abs(share / alike) * math.sqrt(max(0.0, 1.0 - alike**2) / said.size)
    return share, sigma, float(np.sqrt(np.mean(said**2)))
