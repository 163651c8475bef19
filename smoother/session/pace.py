"""A clock that ran at another pace for a while, in samples and fixes alike: brought back by the receiver's UTC.

The clock of a phone is slewed, and the oscillator of a logger runs away as it warms up. Seconds that are none make laps
too long or too short, and nothing else of them tells: what was felt and what the fixes say stay together. A drift that
is even over the whole session, and steps, are for others.

Stamps of fixes that wait in a queue look alike beside UTC, but those of the samples are then right: UTC is followed
only where fixes come when they were felt by the clock as it is, and not by UTC. Nor is it where UTC ran away: then
fixes move as fast as their Doppler says by the clock as it is.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, median, runs_of
from smoother.disc import thinned
from smoother.frames import Origin
from smoother.samples import Beside, GnssFixes, Problem, RawImu

KNOT = 5.0  # s over which the lead of the clock over UTC is averaged
FEWEST_OF_KNOT, FEWEST_KNOTS = 4, 8
SLOPE_KNOTS = 3  # over which a pace is measured
CRYSTAL = 2e-3  # of one pace against the usual; less is a crystal that warms up, and harmless
BEYOND_BELIEF = 0.1  # more is no pace, but a clock that was set, or a queue
LEAST_LEAD = 0.06  # s that the clock gains or loses in all: four sigmas of a lap time
SIGMAS = 8.0  # of the scatter of knots
STEP_SHARE = 0.3  # of what is gained, in the stamps of two fixes: a clock that was set
LONGEST_BETWEEN = 2.5  # s from one fix to the next, that tell how fast the clock ran
DRIVES = 3.0  # m/s
FEWEST_DRIVEN = 40  # fixes, while the clock ran otherwise
NEARER = 0.5  # of what is between way and Doppler by UTC, to which it has to come by the clock, for that to be right
SURE = 3.0  # standard errors of the mean of ratios, by their scatter
TELLS = 6e-3  # of the ratio of way and Doppler: less, the wander of fixes comes up to in half a minute
LAGS = np.arange(-0.2, 0.85, 0.05)  # s by which fixes may be late
FEWEST_FELT = 100  # fixes
ENOUGH = 400_000  # samples, evenly taken


@dataclass(frozen=True, eq=False)
class Pace:
    """How far a clock was ahead of UTC, beyond its usual pace: `lead` (K,) s at times `at` (K,) s of the clock.

    off : (first, last) time, s, and pace against the usual of each stretch in which it ran otherwise.
    """

    at: Array
    lead: Array
    off: tuple[tuple[float, float, float], ...]

    def true(self, t: Array) -> Array:
        """Times t (N,) s of the clock, as one that always ran at its usual pace would show them."""
        return np.asarray(t - np.interp(t, self.at, self.lead))


def with_even_pace(
    gnss: GnssFixes, imu: RawImu | None, beside: Beside, file: str, problems: list[Problem]
) -> tuple[GnssFixes, RawImu | None, Beside]:
    """Return the recording with the times of a clock that ran fast or slow for a while made even, said in `problems`.

    file : name of the fixes' for the sentences. The same where UTC shows nothing, or not for certain.
    """
    assert gnss.unix_s is not None
    pace = _pace(gnss.t, gnss.unix_s)
    if pace is None:
        return gnss, imu, beside
    t = pace.true(gnss.t)
    if imu is not None and not _are_of_one_clock(gnss, imu, pace):
        return gnss, imu, beside
    when = " and ".join(
        f"{100.0 * abs(ran):.2g} % {'fast' if ran > 0.0 else 'slow'} from {first:.0f} to {last:.0f} s"
        for first, last, ran in pace.off
    )
    what = f"{file}: by UTC the recording's clock ran {when}, {pace.lead[-1]:+.2f} s in all"
    if _is_contradicted(gnss, t, pace):
        text = f"{what}; by the speed of the fixes it was UTC that ran otherwise, and t_s is believed"
        problems.append(Problem("clock_pace_doubtful", text))
        return gnss, imu, beside
    problems.append(Problem("clock_pace", f"{what}; taken out, so that later times differ from t_s by as much"))
    gnss = replace(gnss, t=t)
    imu = None if imu is None else replace(imu, t=pace.true(imu.t))
    return gnss, imu, beside.retimed(pace.true)


def _pace(t: Array, unix_s: Array) -> Pace | None:
    """How the clock of stamps t (N,) s ran against UTC (N,) s; None where it ran evenly, or nothing tells."""
    known = np.flatnonzero(np.isfinite(unix_s))
    if known.size < FEWEST_KNOTS * FEWEST_OF_KNOT:
        return None
    t, utc = t[known], unix_s[known] - unix_s[known[0]]
    if np.any(np.diff(utc) <= 0.0):
        return None
    at, lead = _knots(t, t - utc)
    if at.size < FEWEST_KNOTS:
        return None
    slope = (lead[SLOPE_KNOTS:] - lead[:-SLOPE_KNOTS]) / (at[SLOPE_KNOTS:] - at[:-SLOPE_KNOTS])
    noise = MAD_TO_SIGMA * median(np.abs(np.diff(lead, 2) - median(np.diff(lead, 2)))) / np.sqrt(6.0)
    off = np.zeros(slope.size, dtype=np.bool_)
    for _ in range(3):  # the median is that of the usual pace once the other is out
        usual = median(slope[~off])
        off = np.abs(slope - usual) > max(CRYSTAL, SIGMAS * noise / (SLOPE_KNOTS * KNOT))
        if np.mean(off) > 0.5:
            return None
    if abs(usual) > BEYOND_BELIEF or not off.any():
        return None
    lead = lead - usual * at
    stretches, gained = [], np.zeros(at.size)
    for begin, behind in zip(*(index.tolist() for index in runs_of(off)), strict=True):
        first, last = max(0, begin - 1), min(behind + SLOPE_KNOTS, at.size - 1)  # where it began within three knots
        gain = lead[last] - lead[first]
        rows = np.flatnonzero((t >= at[first]) & (t <= at[last]))
        jumps = np.abs(np.diff((t - utc - usual * t)[rows]))[
            np.minimum(np.diff(utc[rows]), np.diff(t[rows])) < LONGEST_BETWEEN
        ]
        if abs(gain) < max(LEAST_LEAD, SIGMAS * noise):
            continue
        if np.max(jumps, initial=0.0) > max(STEP_SHARE * abs(gain), LEAST_LEAD):
            return None  # a clock that was set, or a queue that was emptied
        here = slice(first, last + 1)
        gained[here] = np.diff(lead[here], prepend=lead[first])
        stretches.append(_stretch(at[here], lead[here]))
    if not stretches or any(abs(ran) > BEYOND_BELIEF for *_, ran in stretches):
        return None
    return Pace(at, np.cumsum(gained), tuple(stretches))


def _knots(t: Array, lead: Array) -> tuple[Array, Array]:
    """Times (K,) s and median leads (K,) s of the stretches of KNOT s that hold enough fixes."""
    member = np.floor((t - t[0]) / KNOT).astype(np.int64)
    starts = np.flatnonzero(np.diff(member, prepend=-1))
    parts = [slice(a, b) for a, b in zip(starts, np.append(starts[1:], t.size), strict=True) if b - a >= FEWEST_OF_KNOT]
    return np.array([np.mean(t[part]) for part in parts]), np.array([np.median(lead[part]) for part in parts])


def _stretch(at: Array, lead: Array) -> tuple[float, float, float]:
    """When most of a lead (K,) s came up, at times (K,) s, and how fast."""
    share = (lead - lead[0]) / (lead[-1] - lead[0])
    inside = np.flatnonzero((share > 0.1) & (share < 0.9))
    if inside.size < 2:
        return float(at[0]), float(at[-1]), float((lead[-1] - lead[0]) / (at[-1] - at[0]))
    ran = float(np.polyfit(at[inside], lead[inside], 1)[0])
    middle, half = float(np.mean(at[inside])), abs(0.5 * (lead[-1] - lead[0]) / ran)
    return max(float(at[0]), middle - half), min(float(at[-1]), middle + half), ran


def _is_contradicted(gnss: GnssFixes, t: Array, pace: Pace) -> bool:
    """Whether the fixes move as fast as Doppler says by their stamps, and clearly not by t (N,) s, their UTC.

    Compared with the rest of the session, as velocities may be longer than they should be.
    """
    position = gnss.position_n(Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0))[:, :2]
    velocity = 0.5 * (gnss.velocity_n[1:, :2] + gnss.velocity_n[:-1, :2])
    speed = np.linalg.norm(velocity, axis=1)
    driven = (np.diff(gnss.t) < LONGEST_BETWEEN) & (speed > DRIVES)
    way = np.sum(np.diff(position, axis=0) * velocity, axis=1) / np.where(driven, speed, 1.0)
    middle = 0.5 * (gnss.t[1:] + gnss.t[:-1])
    fast, slow = (
        driven
        & np.any([(middle > first) & (middle < last) & (sign * ran > 0.0) for first, last, ran in pace.off], axis=0)
        for sign in (1.0, -1.0)
    )
    rest = driven & ~fast & ~slow
    if min(np.count_nonzero(fast | slow), np.count_nonzero(rest)) < FEWEST_DRIVEN:
        return False

    groups = [rows for rows in (fast, slow, rest) if np.count_nonzero(rows) >= FEWEST_DRIVEN]

    def longer(times: Array, rows: BoolArray) -> float:
        return float(np.sum(way[rows]) / np.sum((speed * np.diff(times))[rows]))

    def off(times: Array) -> float:
        return max(abs(longer(times, rows) / longer(times, rest) - 1.0) for rows in groups)

    unsure = max(_scatter([longer(gnss.t, piece) for piece in _pieces(middle, rows)]) for rows in groups)
    return off(gnss.t) < NEARER * off(t) and off(t) > max(TELLS, SURE * unsure)


def _pieces(at: Array, rows: BoolArray) -> list[BoolArray]:
    """The rows (N,) at times (N,) s, in masks of KNOT s that have enough of them."""
    member = np.floor(at / (2.0 * KNOT))
    masks = [rows & (member == one) for one in np.unique(member[rows])]
    return [mask for mask in masks if np.count_nonzero(mask) >= 2 * FEWEST_OF_KNOT]


def _scatter(values: list[float]) -> float:
    """Standard error of the mean of independent values; infinite where there are hardly any."""
    return float(np.std(values, ddof=1) / np.sqrt(len(values))) if len(values) > 2 else np.inf


def _are_of_one_clock(gnss: GnssFixes, imu: RawImu, pace: Pace) -> bool:
    """Whether samples and fixes go together as they are stamped, rather than with the fixes alone by UTC.

    What the box turns about the usual force is compared with the turning of the course, at whatever delay fits best.
    """
    north, west = gnss.velocity_n[:, 0], gnss.velocity_n[:, 1]
    if not np.isfinite(north).any():
        position = gnss.position_n(Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0))
        north, west = (np.gradient(position[:, axis], gnss.t) for axis in (0, 1))
    rows = np.flatnonzero(np.hypot(north, west) > DRIVES)
    if rows.size < FEWEST_FELT:
        return True
    course = np.unwrap(np.arctan2(west[rows], north[rows]))
    dt = np.diff(gnss.t[rows])
    use = (dt > 0.0) & (dt < LONGEST_BETWEEN)
    turned = np.where(use, np.diff(course) / np.where(use, dt, 1.0), 0.0)
    first, last = gnss.t[rows][:-1], gnss.t[rows][1:]
    step = max(1, len(imu.t) // ENOUGH)
    up = np.median(thinned(imu.accel, step), axis=0)
    rate = thinned(imu.gyro, step) @ (up / max(float(np.linalg.norm(up)), 1e-9)) * imu.gyro_scale
    times = thinned(imu.t, step)
    angle = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(times))])
    late = np.interp(first, pace.at, pace.lead)

    def together(first: Array, last: Array) -> float:
        felt = [np.interp(last - lag, times, angle) - np.interp(first - lag, times, angle) for lag in LAGS]
        return max(float(np.corrcoef(one[use] / dt[use], turned[use])[0, 1]) for one in felt)

    return together(first, last) > together(first - late, last - late)
