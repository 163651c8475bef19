"""First look at the fixes of a session, before any model is fitted: which of them cannot be true.

Medians over neighbours only, so that jumps of seconds and single absurd rows lose against the fixes around them. What
is passed over here gets weight zero to start with, and may come back once the path is known better.
"""

from dataclasses import replace
from typing import Literal

import numpy as np
import polars as pl

from smoother.arrays import Array, BoolArray, median
from smoother.estimate.factors.rows import speeds_alone
from smoother.samples import Problem, Session
from smoother.words import counted, span

LONGEST_STEP = 2.5  # s; across a longer gap fixes are not compared with one another
RATE_ROWS = 15  # whose median step is the receiver's; single fixes that are missing do not change it
OTHER_RATE = np.log(1.7)  # of the steps before and after
QUICK = 0.3  # s between fixes, up to which steps between fixes separate a jump from driving
STEP = 0.2  # s over which these steps are taken; its two ends spoil less than half of VELOCITY_WINDOW
FEWEST_FIXES = 10  # in a run; fewer do not outvote anything
VELOCITY_WINDOW = 1.0  # s; a kart's velocity is nearly straight for as long
DEAD_RECKONING_WINDOW = 24.0  # s; jumps shorter than half of it are outvoted
JUMP = 5.0  # m; what the median of fix minus dead reckoning must be left by
JUMP_SPREADS = 5.0  # and in units of its usual scatter
ABSURD_DISTANCE, ABSURD_SPEED = 60.0, 70.0  # m, m/s: from the median of a few neighbours, whatever the vehicle does
ABSURD_CHANGE, ABSURD_ACCELERATION = 4.0, 20.0  # m/s, m/s^2: likewise for velocity
MEDIAN_TO_SIGMA = 0.849  # of the length of two normal numbers
FAST, LONGEST_DELAY = 3.0, 0.6  # m/s from which a lag of velocity shows, s


def plausible_positions(t: Array, position_n: Array, velocity_n: Array, has_velocity: BoolArray) -> BoolArray:
    """Mask (M,) of fixes whose horizontal position fits those around it and the velocity, sent or of the fixes.

    t (M,) s; position_n, velocity_n (M, 3), NaN where unknown; has_velocity (M,), as of :func:`plausible_velocities`.
    """
    good = _near_median(t, position_n[:, :2], 7, ABSURD_DISTANCE, ABSURD_SPEED)
    known = np.isfinite(position_n[:, :2]).all(axis=1) & good
    sent_n = np.where(has_velocity[:, None], velocity_n, np.nan)
    measured = known & has_velocities(sent_n)
    use_sent = most_have_velocity(sent_n[known])
    for rows in unbroken_runs(t, np.flatnonzero(measured if use_sent else known)):
        if rows.size >= FEWEST_FIXES and (use_sent or np.median(np.diff(t[rows])) <= QUICK):
            position = position_n[rows, :2]
            velocity = velocity_n[rows, :2] if use_sent else _steps(t[rows], position)
            good[rows] &= _follows_velocity(t[rows], position, velocity)
    return good


def with_courses(t: Array, position_n: Array, velocity_n: Array, speed: Array | None) -> Array:
    """Velocities (M, 3) m/s of fixes at t (M,) s; where nothing but the speed is known, along the way of the fixes."""
    only = np.flatnonzero(speeds_alone(velocity_n, speed) & np.isfinite(position_n[:, :2]).all(axis=1))
    if speed is None or len(only) < FEWEST_FIXES:
        return velocity_n
    out = velocity_n.copy()
    for rows in unbroken_runs(t, only):
        if len(rows) < FEWEST_FIXES:
            continue
        steps = running_median(
            _steps(t[rows], position_n[rows, :2]), VELOCITY_WINDOW / float(np.median(np.diff(t[rows])))
        )
        size = np.maximum(np.hypot(steps[:, 0], steps[:, 1]), 1e-6)
        out[rows, :2] = speed[rows, None] * steps / size[:, None]
    return out


def plausible_velocities(t: Array, velocity_n: Array) -> BoolArray:
    """Mask (M,) of fixes whose horizontal velocity fits those around it."""
    return _near_median(t, velocity_n[:, :2], 5, ABSURD_CHANGE, ABSURD_ACCELERATION)


def has_velocities(velocity_n: Array) -> BoolArray:
    """Mask (M,) of the fixes with a level velocity: velocity_n (M, 2 or 3) m/s, NaN if unknown."""
    return np.asarray(np.isfinite(velocity_n[:, :2]).all(axis=1))


def most_have_velocity(velocity_n: Array) -> bool:
    """Whether most of the fixes do: velocity_n (M, 2 or 3) m/s, NaN if unknown."""
    return bool(np.count_nonzero(has_velocities(velocity_n)) > 0.5 * len(velocity_n))


def _near_median(t: Array, values: Array, size: int, slack: float, rate: float) -> BoolArray:
    """Whether values (M, 2) lie within slack + rate x (half the window's time) of the median of `size` neighbours."""
    good = np.ones(len(t), dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(values).all(axis=1))
    if known.size < 3:
        return good
    size = min(size, known.size if known.size % 2 else known.size - 1)
    index = np.arange(known.size)
    first, last = np.maximum(index - size // 2, 0), np.minimum(index + size // 2, known.size - 1)
    reach = np.maximum(t[known[last]] - t[known], t[known] - t[known[first]])
    median = running_median(values[known], size, at_ends="symmetric")
    distance = np.hypot(*(values[known] - median).T)
    good[known] = distance <= slack + rate * reach
    return good


def unbroken_runs(t: Array, rows: np.ndarray) -> list[np.ndarray]:
    """Split row numbers where more than LONGEST_STEP lies between their times, or the receiver changes its rate."""
    runs = np.split(rows, np.flatnonzero(np.diff(t[rows]) > LONGEST_STEP) + 1) if rows.size else []
    return [part for run in runs for part in _of_one_rate(t, run)]


def _of_one_rate(t: Array, rows: np.ndarray) -> list[np.ndarray]:
    """Split row numbers where the time from one to the next becomes another, for good; most have one for all."""
    if rows.size < 2 * RATE_ROWS:
        return [rows]
    steps = running_median(np.diff(t[rows])[:, None], RATE_ROWS)[:, 0]
    return np.split(rows, np.flatnonzero(np.abs(np.diff(np.log(np.maximum(steps, 1e-3)))) > OTHER_RATE) + 1)


def _steps(t: Array, position: Array) -> Array:
    """Velocity (M, 2) from positions (M, 2) to those STEP later; a jump spoils few of them, which the median outvotes.

    Differences of neighbouring fixes at a high rate would show only their noise.
    """
    last = len(t) - 1
    after = np.minimum(np.arange(last) + max(1, round(STEP / float(np.median(np.diff(t))))), last)
    step = (position[after] - position[:-1]) / (t[after] - t[:-1])[:, None]
    return np.concatenate([step, step[-1:]])


def _follows_velocity(t: Array, position: Array, velocity: Array) -> BoolArray:
    """Whether positions (M, 2) minus the integrated velocity stay near their running median."""
    interval = float(np.median(np.diff(t)))
    difference = beside_dead_reckoning(t, position, velocity)
    difference = difference - running_median(difference, min(DEAD_RECKONING_WINDOW / interval, len(t)))
    distance = np.hypot(difference[:, 0], difference[:, 1])
    return np.asarray(distance <= max(JUMP, JUMP_SPREADS * MEDIAN_TO_SIGMA * float(np.median(distance))))


def beside_dead_reckoning(t: Array, position: Array, velocity: Array) -> Array:
    """Positions (M, 2) minus the integrated velocity (M, 2), m, at fixes t (M,) s that no long gap parts.

    From the first of them on, with a velocity that is as late as the positions.
    """
    interval = float(np.median(np.diff(t)))
    velocity = running_median(velocity, min(VELOCITY_WINDOW / interval, len(t)))
    path = np.zeros_like(position)
    path[1:] = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None], axis=0)
    size = min(DEAD_RECKONING_WINDOW / interval, len(t))
    difference = position - path
    quick, moved = difference - running_median(difference, size), velocity - running_median(velocity, size)
    return np.asarray(difference - _delay(quick, moved) * moved)


def _delay(difference: Array, velocity: Array) -> float:
    """How long (s) the velocity lags the position: the median over the fixes, against jumps."""
    fast = np.hypot(velocity[:, 0], velocity[:, 1]) > FAST
    if not fast.any():
        return 0.0
    share = np.sum(difference[fast] * velocity[fast], axis=1) / np.sum(velocity[fast] ** 2, axis=1)
    return float(np.clip(np.median(share), -LONGEST_DELAY, LONGEST_DELAY))


def running_median(values: Array, size: float, at_ends: Literal["short", "symmetric"] = "short") -> Array:
    """Median of `size` neighbours, rounded to odd, of each column of values (M, 2).

    at_ends: of those that there are, or of what is there and its mirror image.
    """
    odd = max(int(size) // 2 * 2 + 1, 1)
    beyond = odd // 2 if at_ends == "symmetric" else 0
    padded = np.pad(values, ((beyond, beyond), (0, 0)), mode="symmetric")
    columns = [pl.Series(padded[:, i]).rolling_median(odd, min_samples=1, center=True) for i in range(values.shape[1])]
    return np.stack([c.to_numpy()[beyond : beyond + len(values)] for c in columns], axis=1)


# Receivers that have just found their satellites converge from tens of metres: after a start or a tunnel positions may
# drift for a minute while the velocity is right at once. No Gauss-Markov offset goes so far; it would bend the path.
# Positions minus the integrated velocity show how the error of the fixes changes. Where it changes in the first minutes
# by far more than later, and for good, the receiver had not settled.

UNSETTLED = "gps_settling"  # problem code
SETTLING_LASTS = 20.0  # s over which a change is looked at: positions wander less in it than a receiver settles by
SETTLING_MEDIAN = 3.0  # s, by a median
SETTLING, SETTLINGS = 6.0, 3.0  # m, and times the usual change; a Gauss-Markov error does it in 2 runs of 1000
SHORTEST_SETTLING = 5.0  # s; what is over sooner is a jump, SETTLING_LASTS or now
STEPWISE = 0.7  # of the whole change within SHORTEST_SETTLING s: a step, as of false Doppler, and no settling
LOST_SATELLITES = 5.0  # s without fixes, in which a receiver may lose its satellites
EARLY = 120.0  # s, in which a receiver settles
FEWEST_LATER = 200  # fixes later than that, from which on they alone define the usual change
COMES_AND_GOES = 0.1  # of the time: calm while it comes in, or as far astray after: an error that comes again and again
SETTLED = 1.2  # times the usual change, from which on a receiver wanders as it always does


def unsettled(session: Session) -> BoolArray:
    """Mask (N,) of the fixes whose positions still drift to where they should be; none without Doppler.

    A receiver may measure its velocity less often than its positions, but for most of the time it has to.
    """
    t, position_n, velocity_n = session.gnss.t, session.fix_position_n[:, :2], session.gnss.velocity_n[:, :2]
    out = np.zeros(len(t), dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(position_n).all(axis=1) & has_velocities(velocity_n))
    unbroken = unbroken_runs(t, known)
    runs = [rows for rows in unbroken if t[rows[-1]] - t[rows[0]] > 2.0 * SETTLING_LASTS]
    if 2 * sum(int(rows[-1] - rows[0]) + 1 for rows in unbroken) < len(t) or not runs:
        return out
    errors = [_error(t[rows], position_n[rows], velocity_n[rows]) for rows in runs]
    changes = [_changes(t[rows], error) for rows, error in zip(runs, errors, strict=True)]
    late = [change[t[rows[: len(change)]] - t[rows[0]] > EARLY] for rows, change in zip(runs, changes, strict=True)]
    usual = median(np.concatenate(late if sum(map(len, late)) > FEWEST_LATER else changes))
    for rows, error, change in zip(runs, errors, changes, strict=True):
        if rows[0] == known[0] or t[rows[0]] - t[known[known < rows[0]][-1]] >= LOST_SATELLITES:
            out[rows[0] : rows[_settled_at(t[rows], error, change, usual)]] = True
    return out


def without_positions(session: Session, out: BoolArray) -> Session:
    """Return the session with the positions of the fixes `out` (N,) unknown, their velocities as they are."""
    gnss = session.gnss
    lat_deg, lon_deg, alt_m = (np.where(out, np.nan, v) for v in (gnss.lat_deg, gnss.lon_deg, gnss.alt_m))
    return replace(session, gnss=replace(gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))


def settling_problems(t: Array, out: BoolArray) -> tuple[Problem, ...]:
    """Say so where positions of fixes at t (N,) s were left out."""
    if not out.any():
        return ()
    text = (
        f"the receiver had not settled {_when(out)}: for {span(_lasts(t, out))} its positions came in from many "
        f"metres off, against the speed it measured; {counted(int(out.sum()), 'position')} left out. Switch it on a "
        "minute before driving"
    )
    return (Problem(UNSETTLED, text, int(out.sum())),)


def _far(lasts: float, usual: float) -> float:
    """Least change, m, in so many s that an error which wanders by `usual` m in SETTLING_LASTS s does not reach."""
    return max(SETTLING, SETTLINGS * usual * float(np.sqrt(max(1.0, lasts / SETTLING_LASTS))))


def _settled_at(t: Array, error: Array, change: Array, usual: float) -> int:
    """Index of the first fix of a receiver that has settled, at t (M,) s with errors (M, 2) m; 0 if it always had.

    change (K,) m in the SETTLING_LASTS s from each of the first K on, of which `usual` m is the session's median.
    """
    is_far, is_calm = change > max(SETTLING, SETTLINGS * usual), change <= SETTLED * usual
    early = np.flatnonzero(is_far & (t[: len(change)] - t[0] < EARLY))
    calm = np.flatnonzero(is_calm)
    calm = calm[calm > early[-1]] if early.size else calm[:0]
    if not calm.size or t[calm[0]] - t[0] < SHORTEST_SETTLING:
        return 0
    if max(np.mean(is_far[calm[0] :]), np.mean(is_calm[early[0] : early[-1] + 1])) > COMES_AND_GOES:
        return 0
    far = _far(float(t[calm[0]] - t[0]), usual)
    total = float(np.hypot(*(error[calm[0]] - error[0])))
    soon = np.minimum(np.searchsorted(t, t[: calm[0]] + SHORTEST_SETTLING), len(t) - 1)
    at_once = float(np.max(np.hypot(*(error[soon] - error[: calm[0]]).T)))
    return int(calm[0]) if total > far and at_once < STEPWISE * total else 0


def _error(t: Array, position: Array, velocity: Array) -> Array:
    """Errors (M, 2) m of positions (M, 2) m at t (M,) s, but for a constant, steadied."""
    interval = float(np.median(np.diff(t)))
    return running_median(beside_dead_reckoning(t, position, velocity), min(SETTLING_MEDIAN / interval, len(t)))


def _changes(t: Array, error: Array) -> Array:
    """How far, m, errors (M, 2) m go in the SETTLING_LASTS s from each fix at t (M,) s on, of those that can."""
    later = np.searchsorted(t, t + SETTLING_LASTS)
    later = later[later < len(t)]
    return np.asarray(np.hypot(*(error[later] - error[: len(later)]).T))


def _when(mask: BoolArray) -> str:
    """When the receiver had not settled."""
    times = int(np.count_nonzero(np.diff(mask.astype(np.int8), prepend=0) > 0))
    if times > 1:
        return f"{times} times"
    return "at the start" if mask[0] else "after a gap"


def _lasts(t: Array, mask: BoolArray) -> float:
    """How long, s, the runs of true values last at t (N,) s, to the first that is false again."""
    after = np.append(t[1:], t[-1])
    return float(np.sum((after - t)[mask]))
