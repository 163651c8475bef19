"""The measurement covariances of the baseline's Kalman filter (thesis, eq. 2.66 and 2.67), from the session itself.

The thesis takes both from 30 s at rest. For the fixes that is right in kind and wrong in place: what counts is their
scatter from one to the next, and it can be had while driving. For the accelerations it is what breaks the thesis'
filter: at rest they scatter by 0.3 m/s^2, but in a corner gravity leaks in through a tilt of tens of degrees and stays
there for seconds. Such an error acts like white noise of the same spectral density, `variance * step = density`. The
density shows in the difference between the velocity changes of the accelerometer and those of the fixes. With it the
filter is good of its kind; the covariance at rest stays available, to show what the thesis saw.
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.estimate.baseline.alignment import FEWEST, MOVING, Course, velocities_at_fixes
from smoother.samples import GnssFixes

SPAN = 2.0  # s over which velocity changes are compared: about the length of a corner
LEAST_FIX_SIGMA = 0.2  # m; receivers that scatter less do so by filtering
FEWEST_STEPS_AT_REST = 50  # for a variance good to a fifth


def fix_variance(fixes: GnssFixes, position: Array, default_sigma: float) -> Array:
    """Variance (M,) m^2 per axis of each fix, of positions (M, 2) m.

    The scatter of neighbouring fixes about a straight line, at most what the receiver reports (`default_sigma` m if it
    reports nothing), because slow fixes bend with the path. Reports also say which fixes are worse than the usual.
    """
    reported = fixes.sigma_horizontal
    assert reported is not None
    known = np.isfinite(reported) & (reported > 0.0)
    usual = float(np.median(reported[known])) if np.any(known) else default_sigma
    sigma = max(min(_scatter(fixes.t, position), usual), LEAST_FIX_SIGMA)
    relative = np.where(known, np.maximum(np.where(known, reported, usual) / usual, 1.0), 1.0)
    return np.asarray((sigma * relative) ** 2)


def _scatter(t: Array, position: Array) -> float:
    """Sigma (m) per axis from bends between three fixes equally far apart; jumps count, the filter has to bear them."""
    step = np.diff(t)
    if step.size < 2:
        return float("inf")
    regular = np.abs(step - np.median(step)) < 0.2 * np.median(step)
    bend = (position[1:-1] - 0.5 * (position[:-2] + position[2:]))[regular[1:] & regular[:-1]]
    return float(np.sqrt(np.mean(bend**2) / 1.5)) if bend.size else float("inf")


def accel_covariance_in_motion(t: Array, acceleration: Array, course: Course, period: float) -> Array | None:
    """Covariance (2, 2) per step of `period` s that is equivalent to the error in motion; None with too few fixes.

    acceleration (N, 2) m/s^2 at t (N,) s, north and west. Spans in motion count, or all if there are too few.
    """
    fix_t, own, fixes = velocities_at_fixes(t, acceleration, course)
    later = np.searchsorted(fix_t, fix_t + SPAN - 1e-6)
    first = np.flatnonzero(later < fix_t.size)
    first = first[fix_t[later[first]] - fix_t[first] < 1.5 * SPAN]  # not across an outage
    moving = first[np.hypot(fixes[first, 0], fixes[first, 1]) > MOVING]
    first = moving if moving.size >= FEWEST else first
    if first.size < FEWEST:
        return None
    error = own - fixes
    change = error[later[first]] - error[first]
    duration = float(np.mean(fix_t[later[first]] - fix_t[first]))
    return np.asarray(change.T @ change / first.size / (duration * period))


def accel_covariance_at_rest(acceleration: Array, is_at_rest: BoolArray) -> Array | None:
    """Covariance (2, 2) of the accelerations (N, 2) m/s^2 of the steps at rest (N,): eq. 2.67; None with too few."""
    if np.count_nonzero(is_at_rest) < FEWEST_STEPS_AT_REST:
        return None
    return np.cov(acceleration[is_at_rest], rowvar=False)
