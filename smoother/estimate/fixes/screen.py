"""First look at the fixes of a session, before any model is fitted: which of them cannot be true.

Medians over neighbours only, so that jumps of seconds and single absurd rows lose against the fixes around them. What
is passed over here gets weight zero to start with, and may come back once the path is known better.
"""

from typing import Literal

import numpy as np
import polars as pl

from smoother.arrays import Array, BoolArray
from smoother.estimate.factors.rows import speeds_alone

LONGEST_STEP = 2.5  # s; across a longer gap fixes are not compared with one another
RATE_ROWS = 15  # whose median step is the receiver's; single fixes that are missing do not change it
OTHER_RATE = np.log(1.7)  # of the steps before and after
QUICK = 0.3  # s between fixes, up to which their own steps tell a jump from driving
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
    use_sent = most_say_velocity(sent_n[known])
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
    """Mask (M,) of the fixes that say how fast they move on the level: velocity_n (M, 2 or 3) m/s, NaN if unknown."""
    return np.asarray(np.isfinite(velocity_n[:, :2]).all(axis=1))


def most_say_velocity(velocity_n: Array) -> bool:
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
    apart = beside_dead_reckoning(t, position, velocity)
    apart = apart - running_median(apart, min(DEAD_RECKONING_WINDOW / interval, len(t)))
    distance = np.hypot(apart[:, 0], apart[:, 1])
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
    apart = position - path
    quick, moved = apart - running_median(apart, size), velocity - running_median(velocity, size)
    return np.asarray(apart - _delay(quick, moved) * moved)


def _delay(apart: Array, velocity: Array) -> float:
    """How long (s) the velocity lags the position: the median of what each fix says of it, so that jumps do not."""
    fast = np.hypot(velocity[:, 0], velocity[:, 1]) > FAST
    if not fast.any():
        return 0.0
    share = np.sum(apart[fast] * velocity[fast], axis=1) / np.sum(velocity[fast] ** 2, axis=1)
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
