"""The course of fixes with a speed alone, as of cameras and of RaceBox: that of the way between them."""

import numpy as np

from smoother.arrays import Array, IntArray, median
from smoother.samples import Problem
from smoother.session.doppler import SAME_SPEED
from smoother.session.fix_columns import METRES_PER_DEGREE, FixColumns

LONGEST_CHORD = 0.42  # s; of two steps of 5 Hz
SHORTEST_CHORD, LONGEST_WAY = 1.0, 100.0  # m; nothing that has a driver goes farther in a chord's time
FEWEST_CHORDS = 50
DELAYS = np.arange(-0.3, 0.501, 0.02)  # s of speeds behind their positions


def course_of_way(c: FixColumns) -> Array:
    """Course (N,) deg of the fixes, where none says it that of the way between their neighbours.

    Speeds come behind their positions, or before them: the course is that of the way which was as fast. Only where
    points come so often that a chord points as its middle does.
    """
    t, speed = c.t, c.speed
    if np.isfinite(c.course_deg).any() or t.size < 2 * FEWEST_CHORDS or not np.all(np.diff(t) > 0.0):
        return c.course_deg
    usual = float(np.median(np.diff(t)))
    if usual > LONGEST_CHORD / 2.0:
        return c.course_deg
    north, east = _metres(c)
    reach = max(1, int(LONGEST_CHORD / usual / 2.0))
    run, north, east = (values[2 * reach :] - values[: -2 * reach] for values in (t, north, east))
    good = (run > 0.0) & (run < 2.0 * LONGEST_CHORD) & (np.hypot(north, east) > SHORTEST_CHORD)
    good &= np.isfinite(speed[reach:-reach]) & (np.hypot(north, east) < LONGEST_WAY)
    if np.count_nonzero(good) < FEWEST_CHORDS:
        return c.course_deg
    at, run, north, east = t[reach:-reach][good], run[good], north[good], east[good]
    rate, sent = np.hypot(north, east) / run, speed[reach:-reach][good]
    sent = sent * _in_another_unit(rate, sent)
    off = [np.median(np.abs(np.interp(at - delay, at, rate) - sent)) for delay in DELAYS]
    course = np.interp(t - DELAYS[int(np.argmin(off))], at, np.unwrap(np.arctan2(east, north)))
    near = np.min(np.abs(np.stack([t - at[k] for k in _beside(at, t)])), axis=0) < LONGEST_CHORD
    return np.where(near, np.degrees(course) % 360.0, np.nan)


def _metres(c: FixColumns) -> tuple[Array, Array]:
    """North and east (N,) m from the middle of the fixes: the first may be at 0, 0, where there was none yet."""
    lat, lon = median(c.lat_deg), median(c.lon_deg)
    east = np.mod(c.lon_deg - lon + 180.0, 360.0) - 180.0
    return (c.lat_deg - lat) * METRES_PER_DEGREE, east * METRES_PER_DEGREE * np.cos(np.radians(lat))


def _in_another_unit(rate: Array, sent: Array) -> float:
    """By what speeds (K,) as sent are to be multiplied to be as fast as the way (K,) m/s; 1 where they are in m/s.

    What their unit is will be said when they are compared with the positions; here it must not pass for a delay.
    """
    typical = median(sent)
    scale = median(rate) / typical if typical > 0.0 else 1.0
    return 1.0 if SAME_SPEED[0] < 1.0 / scale < SAME_SPEED[1] else scale


def _beside(at: Array, t: Array) -> tuple[IntArray, IntArray]:
    """The last of the times at (K,) s before each of t (N,) s, and the next one."""
    right = np.clip(np.searchsorted(at, t), 0, at.size - 1)
    return np.maximum(right - 1, 0), right


def course_note(file: str) -> Problem:
    """Say that the course is that of the way."""
    return Problem("gps_course_of_way", f"{file}: its speeds have no course; taken from the way between the points")
