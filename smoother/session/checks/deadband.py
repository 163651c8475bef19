"""Receivers that write 0 for any low speed: which of their zeros are none, by the positions that move on."""

import numpy as np

from smoother.arrays import Array, BoolArray, are_near
from smoother.session.checks.columns import FixRows
from smoother.session.checks.table import Finding
from smoother.session.checks.way_steps import BASELINE, NOISE_TIMES, STUCK_ROWS, distance, steps_of, stretches
from smoother.session.fix_columns import FixColumns, metres, sent_speed
from smoother.words import counted

LEAST_THRESHOLD = 0.5  # m/s; a receiver that writes lower speeds than this, 0 apart, has measured its zeros
SLOW_TIME = 5.0  # s over which the positions tell whether a kart stands; half of it at the ends of a stretch of zeros
LEAST_SLOW, LEAST_SLOW_WAY = 0.5, 5.0  # m/s and m; at rest positions wander as fast for a moment, or as far in minutes
# m/s; a receiver that often passes from 0 to more than this, or back, and never shows less, has measured none of its 0s
SURE_THRESHOLD = 0.8
ENOUGH_MISSED, MOST_MISSED = 6.0, 2.0  # fixes that should have shown less, in all and of one pass
BESIDE_MOTION = 1.0  # s in which a kart comes to rest from such a speed, or back to it
SETTLED = 120.0  # s after the first fix, or a hole of SLOW_TIME, from which on positions do not come in from elsewhere
SAME_WAY = 0.5  # cosine of the angle between how a kart was pushed and how it drives on


def zeros_of_slow(f: FixRows) -> Finding | None:
    """Zeros of a receiver that writes 0 for any low speed, where the positions move on.

    Taken for measured, the positions of a kart that is pushed would pass for those of a receiver that has not settled.
    Those of one that has not are left to the zeros: they come to rest, where a kart is pushed to drive. Of a receiver
    that surely writes them nothing is measured while a kart comes to rest.
    """
    c, t = f.columns, f.columns.t
    speed = sent_speed(c)
    lowest = float(np.min(speed[speed > 0.0], initial=np.inf))
    if not LEAST_THRESHOLD <= lowest < np.inf:
        return None
    least = NOISE_TIMES * steps_of(t, c).noise(slice(None)) * BASELINE  # m
    is_sure, wrong = _is_threshold(t, speed, lowest), np.zeros(t.size, dtype=np.bool_)
    for first, end in stretches(speed == 0.0, 0):
        if not is_sure and end - first < STUCK_ROWS:
            continue
        moves = _move(t, c, first, end, least)
        moves = are_near(t[first:end], t[first:end][moves], BESIDE_MOTION) if is_sure else moves
        for begin, behind in stretches(moves, first):
            is_way = _drives_on(t, c, behind, end) or (is_sure and _came_driving(t, c, begin, first))
            is_far = _way(c, begin, behind - 1) > LEAST_SLOW_WAY and (is_way or _is_settled(t, begin))
            wrong[begin:behind] = is_far or (is_sure and is_way)
        if is_sure:
            wrong[first:end] |= _beside_motion(t, first, end)
    count = int(np.count_nonzero(wrong))
    where = f"while the positions move on{f' or within {BESIDE_MOTION:g} s of motion' if is_sure else ''}"
    text = f"speed is 0 in {counted(count, 'row')} {where}, and never between 0 and {lowest:.2g} m/s; not used there"
    names = ("speed", "velocity_north", "velocity_east", "velocity_up")
    return Finding(text, count, blank=dict.fromkeys(names, wrong)) if count else None


def _is_threshold(t: Array, speed: Array, lowest: float) -> bool:
    """Whether speeds (N,) pass so often, and so slowly, from 0 to `lowest` m/s or back that some between were due."""
    if lowest < SURE_THRESHOLD or t.size < 3:
        return False
    usual = float(np.median(np.diff(t)))
    missed = 0.0
    for one, two, three in ((0, 1, 2), (2, 1, 0)):  # at rest, moving, and what comes after, or came before
        still, slow, quick = (speed[k : speed.size - 2 + k] for k in (one, two, three))
        whole = np.isfinite(quick) & (t[2:] - t[:-2] < 3.0 * usual)
        change = np.abs(quick - slow)[(still == 0.0) & (slow > 0.0) & whole]
        missed += float(np.sum(np.clip(lowest / np.maximum(change, 1e-3) - 1.0, 0.0, MOST_MISSED)))
    return missed >= ENOUGH_MISSED


def _beside_motion(t: Array, first: int, end: int) -> BoolArray:
    """Mask of the rows first to end of zeros that come soon after motion, or before: the kart has yet to stop."""
    at = t[first:end]
    beside = np.zeros(at.size, dtype=np.bool_)
    if first > 0:
        beside |= at - t[first - 1] < BESIDE_MOTION
    if end < t.size:
        beside |= t[end] - at < BESIDE_MOTION
    return beside


def _move(t: Array, c: FixColumns, first: int, end: int, least: float) -> BoolArray:
    """Mask of the rows first to end about which positions move on.

    least : m that they have to, in SLOW_TIME, to be told from noise.
    """
    north, east = metres(c)
    at = t[first:end]
    before, after = first + np.searchsorted(at, [at - 0.5 * SLOW_TIME, at + 0.5 * SLOW_TIME])
    after = np.minimum(after, end - 1)
    return np.asarray(distance(north, east, before, after) > np.maximum(LEAST_SLOW * (t[after] - t[before]), least))


def _way(c: FixColumns, first: int, last: int) -> float:
    """How far, m, from one row to another."""
    north, east = metres(c)
    return float(np.hypot(north[last] - north[first], east[last] - east[first]))


def _is_settled(t: Array, row: int) -> bool:
    """Whether a receiver has had its satellites for long: positions of one that stands drift in before."""
    holes = np.flatnonzero(np.diff(t[: row + 1]) > SLOW_TIME)
    return bool(t[row] - t[holes[-1] + 1 if holes.size else 0] > SETTLED)


def _drives_on(t: Array, c: FixColumns, behind: int, end: int) -> bool:
    """Whether positions that moved up to row `behind` go on the same way from row `end` on, where speeds are sent."""
    if end == t.size or t[end] - t[behind - 1] > 0.5 * SLOW_TIME:
        return False
    return _is_one_way(t, c, t[end] - SLOW_TIME, end, t[end] + 0.5 * SLOW_TIME)


def _came_driving(t: Array, c: FixColumns, begin: int, first: int) -> bool:
    """Whether positions that move from row `begin` on came the same way up to row `first`, the first without speed."""
    if first == 0 or t[begin] - t[first - 1] > 0.5 * SLOW_TIME:
        return False
    return _is_one_way(t, c, t[first - 1] - 0.5 * SLOW_TIME, first - 1, t[first - 1] + SLOW_TIME)


def _is_one_way(t: Array, c: FixColumns, before: float, at: int, after: float) -> bool:
    """Whether positions go on from row `at` to `after` s as they came to it from `before` s."""
    (i, k), (north, east) = np.searchsorted(t, [before, after]).tolist(), metres(c)
    k = min(k, t.size - 1)
    came, goes = (np.array([north[b] - north[a], east[b] - east[a]]) for a, b in ((i, at), (at, k)))
    return bool(came @ goes > SAME_WAY * np.linalg.norm(came) * np.linalg.norm(goes))
