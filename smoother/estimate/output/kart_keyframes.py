"""Keyframes of the kart: from the pose of the sensor to the place of the antenna and the attitude of the kart.

With the covariance of both, and what it leaves out that no residual shows: the mounting, climbing, a turning wheel.
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release, roomy
from smoother.estimate.factors.position import arm_axes
from smoother.estimate.factors.rows import Between
from smoother.estimate.output.dense_rows import TOGETHER, DenseSource, parts_of
from smoother.estimate.output.estimated import Estimated, attitude_variance, without_samples
from smoother.estimate.output.mounting import FittedMounting
from smoother.frames import UP_N
from smoother.samples import Session
from smoother.trajectory import (
    Keyframes,
)

SLOPE = 0.03  # rms of ground, as of a hilly road on record; karting tracks have less
# m/s, forgotten in half a minute or later: two modules in one car have 0.020 each beside what their sigmas hold, one
# beside the heights of RTK 0.018; of the level velocities of both it is 0.003 to 0.013
SLOW_UPWARDS = 0.02


def _left_of_attitude(found: Estimated, mounting: FittedMounting, unsampled: BoolArray | None) -> Array:
    """Share (3,), by axis of b, of the attitude's errors that is left once the mounting is fitted to it.

    An error that all keyframes have in common, by the bias of an axis that nothing shows, is taken for a part of the
    mounting: the box seems askew by so much more, and the kart is none the worse for it.
    unsampled (K,): keyframes without samples.
    """
    if not mounting.is_fitted:
        return np.ones(3)
    mean, common = attitude_variance(found, mounting.R_bs, unsampled)
    left = np.sqrt(np.clip(1.0 - common / mean, 0.0, 1.0))
    return np.array([*left[:2], 1.0]) if mounting.by_wheels else np.asarray(left)


def keyframes_of_kart(
    session: Session, found: Estimated, source: DenseSource, mounting: FittedMounting, unseen: Array
) -> Keyframes:
    """Antenna and kart at the keyframes, with the covariance of attitude (in n), velocity and position.

    unseen (3,) m^2: variance of the slow error of the fixes that no session shows. Upwards velocities are as unsure as
    ground that is taken to be level where no fix has a height, and by the slow error of a receiver's own.
    """
    state, antenna, known = found.state, found.uncertainty.antenna, found.known
    R, arms_n = state.R_ns, arm_axes(Between.at(state, state.t)) @ state.constants["lever_arm"]
    R_nb, covariance, velocity_n = R @ mounting.R_bs.T, roomy(antenna.shape), state.velocity_n.copy()
    left = _left_of_attitude(found, mounting, without_samples(source.binned))
    of_mounting = np.array([*mounting.sigma[:2], 0.0]) if mounting.by_wheels else mounting.sigma
    is_held = known.priors.held_s is not None and known.drives  # the height of the antenna, which tilting swings it by
    height_sigma = float(known.priors.constants["lever_arm"][1][2]) if is_held else 0.0
    has_upwards = bool(np.any(np.isfinite(session.gnss.velocity_n[:, 2])))
    slope = 0.0 if known.has_height or has_upwards else SLOPE
    for part in parts_of(state.t, source.pauses):
        covariance[part] = antenna[part]
        covariance[part, 6:9, 6:9] += np.diag(unseen)
        left_n = (R_nb[part] * left) @ R_nb[part].transpose(0, 2, 1)
        covariance[part, 0:3] = left_n @ covariance[part, 0:3]
        covariance[part, :, 0:3] = covariance[part, :, 0:3] @ left_n
        covariance[part, 0:3, 0:3] += (R_nb[part] * of_mounting**2) @ R_nb[part].transpose(0, 2, 1)
        near, arm_n = source.around(state.t[part]), arms_n[part]
        swing_n = near.swing_at(state.t[part])
        velocity_n[part] += np.cross(swing_n, arm_n)
        by_height = height_sigma * np.cross(swing_n, UP_N)
        covariance[part, 3:6, 3:6] += near.swing_covariance(arm_n) + by_height[:, :, None] * by_height[:, None, :]
        covariance[part, 5, 5] += slope**2 * np.sum(velocity_n[part, :2] ** 2, axis=1)
        covariance[part, 5, 5] += SLOW_UPWARDS**2 if has_upwards else 0.0
        release(covariance, antenna, source.binned)
    return Keyframes(
        t=state.t,
        position_n=state.position_n + arms_n,
        velocity_n=velocity_n,
        R_nb=R_nb,
        covariance=covariance,
        accel_bias_s=state.accel_bias_s,
        gyro_bias_s=state.gyro_bias_s,
        sigma_accel_bias=found.uncertainty.biases[:, :3],
        sigma_gyro_bias=found.uncertainty.biases[:, 3:],
        gps_offset_n=state.offset_n,
        unseen_offset=unseen,
    )


def widen(keyframes: Keyframes, swing: Array) -> None:
    """Add what the box stands off the kart, (3,) rad rms about the axes of b, to the errors of the kart's attitude."""
    for part in pieces(len(keyframes.t), TOGETHER):
        R_nb = keyframes.R_nb[part]
        keyframes.covariance[part, 0:3, 0:3] += (R_nb * swing**2) @ R_nb.transpose(0, 2, 1)
        release(keyframes)
