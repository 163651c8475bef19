"""The path of a trajectory in plan, its level accelerations, and its gaps without fixes."""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release
from smoother.fit.plan_path import PlanPath
from smoother.fit.running import local_polynomial
from smoother.frames import to_left
from smoother.laps.results import FixPath
from smoother.trajectory import Trajectory

GAP = 2.0  # s without fixes, after which the position of a kart without an inertial sensor is unknown
SMOOTHED_OVER = 0.5  # s, of the cubics that give acceleration where there is no inertial sensor


def interpolated(at: Array, t: Array, values: Array) -> Array:
    """Return values (N,) over t (N,) at a few times (K,), linearly, held beyond the ends.

    Like numpy.interp, which copies read-only t and values in every call.
    """
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    slope = (values[k + 1] - values[k]) / (t[k + 1] - t[k])
    inside = values[k] + slope * (at - t[k])
    return np.asarray(np.where(at <= t[0], values[0], np.where(at >= t[-1], values[-1], inside)))


def plan_path(trajectory: Trajectory) -> PlanPath:
    """Return the path of a trajectory's antenna."""
    return PlanPath(
        trajectory.t, trajectory.position_n[:, :2], trajectory.velocity_n[:, :2], trajectory.position_n[:, 2]
    )


def level_acceleration(trajectory: Trajectory, path: PlanPath | None = None) -> Array:
    """Return the acceleration (N, 2) m/s^2 along and left of the path, that of the trajectory.

    By the inertial sensor where the attitude is known, else from the smoothed speed over :data:`SMOOTHED_OVER`.
    """
    path, acceleration_n = path or plan_path(trajectory), np.empty((len(trajectory), 2))
    for part in pieces(len(trajectory)):
        R, a = trajectory.R_nb[part], trajectory.acceleration_b[part]
        acceleration_n[part] = np.einsum("nij,nj->ni", R[:, :2], a)
        release(trajectory.R_nb, trajectory.acceleration_b)
    unknown = ~np.isfinite(acceleration_n).all(axis=1)
    if unknown.any():
        acceleration_n[unknown] = _from_velocity(path)[unknown]
    forward = path.velocity_n / np.maximum(path.speed, 1e-9)[:, None]
    along = np.sum(acceleration_n * forward, axis=1)
    left = to_left(forward, acceleration_n)
    return np.stack([along, left], axis=1)


def _from_velocity(path: PlanPath) -> Array:
    step = float(np.median(np.diff(path.t)))
    window = max(5, 2 * round(0.5 * SMOOTHED_OVER / step) + 1)
    if len(path.t) < window:
        return np.gradient(path.velocity_n, path.t, axis=0) if len(path.t) > 1 else np.zeros((len(path.t), 2))
    return local_polynomial(path.velocity_n, window, 3, derivative=1, step=step)


def in_gaps(t: Array, fixes: FixPath) -> BoolArray:
    """Mask (N,) of times t (N,) s in a gap of the fixes."""
    if len(fixes.t) < 2:
        return np.zeros(len(t), dtype=np.bool_)
    inside = np.zeros(len(t), dtype=np.bool_)
    for part in pieces(len(t)):
        before = np.clip(np.searchsorted(fixes.t, t[part]) - 1, 0, len(fixes.t) - 2)
        start, end = fixes.t[before], fixes.t[before + 1]
        inside[part] = (end - start > GAP) & (t[part] > start) & (t[part] < end)
    return inside
