"""Sideslip where heading and direction of travel are accurate enough, else the reason why there is none.

The direction of travel is that of the antenna. The mounting is identified from the same motion, so a constant
sideslip, also on straights, is attributed to the mounting and is not observable.
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release
from smoother.fit.plan_path import PlanPath
from smoother.frames import euler_from_rotation, wrap_angle
from smoother.trajectory import BOX_ON_WHEEL, Trajectory
from smoother.units import DEG

MOVING = 5.0  # m/s, above which a heading can be compared with a course
OBSERVABLE = 2.5 * DEG  # rad, sigma of sideslip: a kart slides 3 to 8 deg


def sideslip_of(trajectory: Trajectory, path: PlanPath) -> tuple[Array, Array]:
    """Return sideslip and its sigma, (N,) rad; NaN where they are not observable."""
    out = np.full((2, len(trajectory)), np.nan)
    if why_hidden(trajectory, path):
        return out[0], out[1]
    all_sigma = _sigma(trajectory, path)
    for part in pieces(len(trajectory)):
        velocity, speed, sigma = path.velocity_n[part], path.speed[part], all_sigma[part]
        yaw = euler_from_rotation(trajectory.R_nb[part])[2]
        sideslip = wrap_angle(np.arctan2(velocity[:, 1], velocity[:, 0]) - yaw)
        hidden = ~(speed > MOVING) | ~(sigma < 2.0 * OBSERVABLE)
        out[:, part] = np.where(hidden, np.nan, np.stack([sideslip, sigma]))
        release(trajectory.R_nb)
    return out[0], out[1]


def why_hidden(trajectory: Trajectory, path: PlanPath) -> str:
    """Return why there is no sideslip, as text; empty where there is."""
    mounting = trajectory.report.identified.get("R_bs")
    if trajectory.report.mode != "full":
        return "no motion sensor could be used"
    if trajectory.sigmas is None:
        return "the estimator gave no sigmas"
    if any(problem.code == BOX_ON_WHEEL for problem in trajectory.report.problems):
        return "the logger turns with the steering wheel, so the heading of the kart is not known"
    if mounting is not None and not mounting.observable:
        return "the mounting of the logger could not be found"
    moving = path.speed > MOVING
    if not moving.any():
        return "the kart was never faster than a walk"
    sigma = float(np.nanmedian(_sigma(trajectory, path)[moving]))
    if not sigma < OBSERVABLE:
        return f"its uncertainty is ± {sigma / DEG:.1f} deg, and a kart slides 3 to 8"
    return ""


def _sigma(trajectory: Trajectory, path: PlanPath) -> Array:
    """Sigma (N,) rad: heading, and velocity across the direction of travel."""
    assert trajectory.sigmas is not None
    sigma = np.empty(len(trajectory))
    for part in pieces(len(trajectory)):
        velocity, yaw = trajectory.sigmas.velocity_n[part], trajectory.sigmas.attitude[part, 2]
        across = np.hypot(velocity[:, 0], velocity[:, 1]) / np.sqrt(2.0)
        sigma[part] = np.hypot(yaw, across / np.maximum(path.speed[part], 0.1))
        release(trajectory.sigmas)
    return sigma


def outward(sideslip: Array, sigma: Array, inside: BoolArray, turns_left: bool) -> tuple[Array, Array]:
    """Return the mean slide (L,) rad of each lap at the points `inside` (M,) of a corner, and its sigma (L,) rad.

    sideslip, sigma (L, M) rad. Positive: the kart points into the corner. Errors of the heading last longer than a
    corner, so the sigma of the mean is that of a point. NaN where part of it is not observable.
    """
    there, spread = sideslip[:, inside], sigma[:, inside]
    if there.shape[1] == 0:
        return np.full(len(there), np.nan), np.full(len(there), np.nan)
    mean = there.mean(axis=1) * (-1.0 if turns_left else 1.0)
    return mean, np.sqrt((spread**2).mean(axis=1))
