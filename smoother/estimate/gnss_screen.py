"""First look at the fixes of a session, before any model is fitted: which of them cannot be true.

Medians over neighbours only, so that jumps of seconds and single absurd rows lose against the fixes around them. What
is passed over here gets weight zero to start with, and may come back once the path is known better.
"""

import numpy as np
from scipy.ndimage import median_filter

from smoother.arrays import Array, BoolArray

LONGEST_STEP = 2.5  # s; across a longer gap fixes are not compared with one another
DEAD_RECKONING_WINDOW = 24.0  # s; jumps shorter than half of it are outvoted
JUMP = 5.0  # m; what the median of fix minus dead reckoning must be left by
JUMP_SPREADS = 6.0  # and in units of its usual scatter
ABSURD_DISTANCE, ABSURD_SPEED = 60.0, 70.0  # m, m/s: from the median of a few neighbours, whatever the vehicle does
ABSURD_CHANGE, ABSURD_ACCELERATION = 4.0, 20.0  # m/s, m/s^2: likewise for velocity
MAD_TO_SIGMA = 1.4826


def plausible_positions(t: Array, position_n: Array, velocity_n: Array) -> BoolArray:
    """Mask (M,) of fixes whose horizontal position fits those around it and, where there is any, the velocity.

    t (M,) s; position_n, velocity_n (M, 3), NaN where unknown.
    """
    good = _near_median(t, position_n[:, :2], 7, ABSURD_DISTANCE, ABSURD_SPEED)
    moving = np.isfinite(velocity_n[:, :2]).all(axis=1) & plausible_velocities(t, velocity_n)
    known = np.flatnonzero(moving & good & np.isfinite(position_n[:, :2]).all(axis=1))
    for rows in _runs(t, known):
        if rows.size >= 10:
            good[rows] &= _follows_velocity(t[rows], position_n[rows, :2], velocity_n[rows, :2])
    return good


def plausible_velocities(t: Array, velocity_n: Array) -> BoolArray:
    """Mask (M,) of fixes whose horizontal velocity fits those around it."""
    return _near_median(t, velocity_n[:, :2], 5, ABSURD_CHANGE, ABSURD_ACCELERATION)


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
    median = np.stack([median_filter(values[known, i], size, mode="reflect") for i in range(2)], axis=1)
    distance = np.hypot(*(values[known] - median).T)
    good[known] = distance <= slack + rate * reach
    return good


def _runs(t: Array, rows: np.ndarray) -> list[np.ndarray]:
    """Split row numbers where more than LONGEST_STEP lies between their times."""
    return np.split(rows, np.flatnonzero(np.diff(t[rows]) > LONGEST_STEP) + 1) if rows.size else []


def _follows_velocity(t: Array, position: Array, velocity: Array) -> BoolArray:
    """Whether positions (M, 2) minus the integrated velocity stay near their running median."""
    path = np.zeros_like(position)
    path[1:] = np.cumsum(0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None], axis=0)
    apart = position - path
    size = int(min(len(t), DEAD_RECKONING_WINDOW / np.median(np.diff(t)))) | 1
    apart = apart - np.stack([median_filter(apart[:, i], size, mode="nearest") for i in range(2)], axis=1)
    distance = np.hypot(apart[:, 0], apart[:, 1])
    return np.asarray(distance <= max(JUMP, JUMP_SPREADS * MAD_TO_SIGMA * float(np.median(distance))))
