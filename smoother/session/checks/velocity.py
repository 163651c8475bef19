"""Checks of the velocity that a receiver sends, held against the positions it sends with it.

A speed in another unit, a course that points elsewhere: the positions are right without them, and the column is not
used. A velocity that agrees is left as it is. Velocities and positions are compared over about a second, and the steps
are chosen by the velocities alone: chosen by the positions, noise would make a slow kart seem a fast one.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, IntArray
from smoother.session.checks.table import Check, Finding
from smoother.session.fix_columns import ABSURD_SPEED, METRES_PER_DEGREE, FixColumns, FixRows, metres, sent_speed
from smoother.session.rows import longest_increasing
from smoother.units import KMH, KNOT, MPH
from smoother.words import counted

BASELINE = 1.0  # s; over less, noise of the positions counts
FEWEST_STEPS = 20
FASTER = 5.0  # m/s
LEAST_TIME = 10.0  # s of steps that show a direction
UNIT_RATIOS = {  # what speeds in one unit are, read as another, in true ones
    "km/h": 1.0 / KMH,
    "mph": 1.0 / MPH,
    "knots": 1.0 / KNOT,
    **{f"m/s, read as {name}": size for name, size in (("km/h", KMH), ("mph", MPH), ("knots", KNOT))},
    **{f"{name}, read as km/h": KMH / size for name, size in (("mph", MPH), ("knots", KNOT))},
    **{f"km/h, read as {name}": size / KMH for name, size in (("mph", MPH), ("knots", KNOT))},
}
SAME_UNIT = 0.02  # share; real receivers are within 0.015 of their positions, and the nearest two of them 5 % apart
SAME_SPEED = (0.85, 1.18)  # speed by that of the positions; beyond, it is wrong whatever explains it
ABSURD_SHARE = 10.0  # and more are speeds that are reported as impossible
SAME_SPEED_OF_CHORDS = 1.5  # likewise where positions come no faster than BASELINE: a chord is shorter than its bend
MOVING = 1.0  # m/s; slower, receivers leave the course empty
LEAST_GAIN, SAME_GAIN = 0.5, 0.85  # of velocity along the way of the positions; a course as close is written so
DELAYS = (0.0, 0.25, 0.5, 0.75, 1.0, -0.25, -0.5)  # s by which velocities come behind their positions, or before them
DIRECTION = ("course_deg", "velocity_north", "velocity_east", "velocity_up")


@dataclass(frozen=True, eq=False)
class Ways:
    """Stretches of about BASELINE in which the vehicle drives: rows first and last (K,), and how long each is (K,) s.

    sent (K,) : mean velocity, m/s, north + i east, by the velocities that were sent.
    """

    first: IntArray
    last: IntArray
    time: Array
    sent: npt.NDArray[np.complex128]

    def gain(self, lat_deg: Array, lon_deg: Array) -> float:
        """Velocity of positions (N,) along the one sent, as a share of it, mostly: 1 where they agree."""
        return float(np.median((self.by_position(lat_deg, lon_deg) / self.sent).real))

    def by_position(self, lat_deg: Array, lon_deg: Array) -> npt.NDArray[np.complex128]:
        """Mean velocity (K,) m/s, north + i east, by positions (N,)."""
        north = lat_deg[self.last] - lat_deg[self.first]
        east = np.mod(lon_deg[self.last] - lon_deg[self.first] + 180.0, 360.0) - 180.0
        way = METRES_PER_DEGREE * (north + 1j * east * np.cos(np.radians(lat_deg[self.first])))
        return np.asarray(way / self.time, dtype=np.complex128)


def ways_of(c: FixColumns, delay: float = 0.0) -> Ways | None:
    """The ways of a vehicle whose velocities come `delay` s late; None where too few velocities are known."""
    velocity = sent_speed(c) * np.exp(1j * np.radians(c.course_deg))
    velocity = np.where(np.isfinite(c.velocity_north), c.velocity_north + 1j * c.velocity_east, velocity)
    velocity = np.where(np.isfinite(velocity) | ~(sent_speed(c) <= MOVING), velocity, 0.0)
    rows = np.flatnonzero(np.isfinite(velocity) & np.isfinite(c.t) & ~c.is_blank)
    rows = rows[longest_increasing(c.t[rows])]
    if rows.size < FEWEST_STEPS:
        return None
    t, v = c.t[rows], velocity[rows]
    later = np.searchsorted(t, t + BASELINE)
    first = np.flatnonzero(later < t.size)
    last = later[first]
    time = t[last] - t[first]
    travelled = np.append(0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t)))
    with np.errstate(over="ignore", invalid="ignore"):
        sent = (np.interp(t[last] + delay, t, travelled) - np.interp(t[first] + delay, t, travelled)) / time
        good = (time < 2.0 * BASELINE) & (np.abs(sent) > FASTER) & (np.abs(sent) < ABSURD_SPEED)
    if np.count_nonzero(good) < FEWEST_STEPS or np.ptp(t[first[good]]) < LEAST_TIME:
        return None
    return Ways(rows[first[good]], rows[last[good]], time[good], sent[good])


def no_course(f: FixRows) -> Finding | None:
    """Speeds without a direction."""
    c = f.columns
    moving = (c.speed > MOVING) & ~np.isfinite(c.velocity_north)
    lost = int(np.count_nonzero(moving & ~np.isfinite(c.course_deg)))
    if lost <= 0.5 * np.count_nonzero(c.speed > MOVING):
        return None
    return Finding(f"{counted(lost, 'moving fix')} with a speed but no course; the speed is used alone", lost)


def speed_unit(f: FixRows) -> Finding | None:
    """Speeds in another unit, turned into m/s; not used where no unit explains them.

    Speeds that are 3.6 times too large would pass for fixes that are noisy and late.
    """
    c, every = f.columns, np.ones(f.columns.t.size, dtype=np.bool_)
    share, highest = _share_of_speed(c)
    if not (share < SAME_SPEED[0] or highest < share < ABSURD_SHARE):
        return None
    unit = next((name for name, ratio in UNIT_RATIOS.items() if abs(share / ratio - 1.0) < SAME_UNIT), None)
    text = f"its speeds are {share:.2f} times those of its positions"
    if unit is None:
        blank = dict.fromkeys(("speed", "velocity_north", "velocity_east", "velocity_up"), every)
        return Finding(f"{text}; not used. What is their unit?", blank=blank)
    scale = dict.fromkeys(("speed", "velocity_north", "velocity_east"), 1.0 / UNIT_RATIOS[unit])
    return Finding(f"{text}, as if in {unit}; converted", scale=scale, blank={"velocity_up": every})


def _share_of_speed(c: FixColumns) -> tuple[float, float]:
    """Speed as sent divided by speed from the positions, NaN where too few steps show it or they do not agree about it;
    and the largest share that is no contradiction.
    """
    speed = sent_speed(c)
    later = np.searchsorted(c.t, c.t + BASELINE)
    first = np.flatnonzero((later < c.t.size) & np.isfinite(speed))
    last = later[first]
    run = c.t[last] - c.t[first]
    place = np.array(metres(c))
    middle = (first + last) // 2
    travelled = sum(np.hypot(*(place[:, b] - place[:, a])) for a, b in ((first, middle), (middle, last))) / run
    sums = np.append(0.0, np.cumsum(np.nan_to_num(speed, posinf=0.0)))
    sent = (sums[last + 1] - sums[first]) / (last + 1 - first)
    good = (run < 2.0 * BASELINE) & np.isfinite(speed[last])
    good &= sent > 0.5 * np.percentile(sent[good], 95.0) if np.any(good) else False
    if np.count_nonzero(good) < FEWEST_STEPS or not np.median(travelled[good]) > FASTER:
        return float("nan"), np.inf
    with np.errstate(divide="ignore"):
        low, share, high = np.percentile(sent[good] / travelled[good], (25.0, 50.0, 75.0), method="nearest")
    highest = SAME_SPEED[1] if np.median((last - first)[good]) >= 2 else SAME_SPEED_OF_CHORDS
    return (float(share) if high < 1.25 * low else float("nan")), highest


def wrong_course(f: FixRows) -> Finding | None:
    """A direction that is another than that in which the positions go."""
    c = f.columns
    gain = _best_gain(c)
    if gain is None or gain > LEAST_GAIN:
        return None
    has_parts = np.isfinite(c.velocity_north) & np.isfinite(c.velocity_east)
    course = np.where(has_parts, np.degrees(np.arctan2(c.velocity_east, c.velocity_north)), c.course_deg)
    unknown = np.full(c.t.size, np.nan)
    plain = replace(c, speed=sent_speed(c), velocity_north=unknown, velocity_east=unknown)
    gains = ((how, _best_gain(replace(plain, course_deg=other(course)))) for how, other in _OTHER_COURSES.items())
    hint = next((f", as if {how}" for how, other in gains if (other or 0.0) > SAME_GAIN), "")
    text = f"course is mostly {np.degrees(np.arccos(max(gain, -1.0))):.0f} deg off the way of the positions{hint}"
    return Finding(f"{text}; not used", blank=dict.fromkeys(DIRECTION, np.ones(c.t.size, dtype=np.bool_)))


def _best_gain(c: FixColumns) -> float | None:
    """Gain of the positions by the velocities, early or late as these may be; None where too few of them are known, or
    the positions hardly move."""
    every = [ways for delay in DELAYS if (ways := ways_of(c, delay)) is not None]
    if not every or not np.median(np.abs(every[0].by_position(c.lat_deg, c.lon_deg))) > FASTER:
        return None
    return max(ways.gain(c.lat_deg, c.lon_deg) for ways in every)


_OTHER_COURSES: dict[str, Callable[[Array], Array]] = {
    "in radians": np.degrees,
    "it pointed backwards": lambda course: course + 180.0,
    "anticlockwise from north": np.negative,
    "anticlockwise from east, or latitude and longitude exchanged": lambda course: 90.0 - course,
}


VELOCITY_CHECKS = (
    Check("gps_no_course", "fixes", ("speed",), no_course),
    Check("gps_speed_unit", "fixes", (), speed_unit),
    Check("gps_course_wrong", "fixes", (), wrong_course),
)
