"""GTSAM's CombinedImuFactor over each interval, with columns for scale and misalignment of the sensors.

GTSAM preintegrates and linearises. An error in proportion to force or rate acts like a bias in proportion to it, so its
Jacobian is that of both biases of a factor times force or rate. These are the keyframes' own: the measured ones hold
the noise that is in the residual too (errors in variables, see model/motion.py).
"""

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, KEYFRAME_SIZE, State
from smoother.frames import GRAVITY_N

# where GTSAM has the columns of X V X V B B of a factor, and where the tangents of two keyframes have them
_FROM_TO = (
    (slice(0, 6), slice(0, 6)),
    (slice(6, 9), slice(6, 9)),
    (slice(9, 15), slice(18, 24)),
    (slice(15, 18), slice(24, 27)),
    (slice(18, 24), slice(9, 15)),
    (slice(24, 30), slice(27, 33)),
)
SIZE = 15  # residuals: rotation, position, velocity, bias of force, bias of rate


def imu_factors(
    preintegrated: Sequence[gtsam.PreintegratedCombinedMeasurements], first: int = 0
) -> gtsam.NonlinearFactorGraph:
    """Return a CombinedImuFactor for each interval between keyframes first, first + 1, .."""
    graph = gtsam.NonlinearFactorGraph()
    for k, measured in enumerate(preintegrated, first):
        graph.add(gtsam.CombinedImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), measured))
    return graph


def whitened_imu(linear: gtsam.GaussianFactorGraph, n: int, state: State, shaken: Array) -> Array:
    """Jacobian and, as last column, minus the residual (n, 15, 36 + C + 1), whitened, of n IMU factors.

    linear: factors as GTSAM linearised them at `state`, those of the intervals first. shaken (n, 2): power of the
    vibration of force and of rate beyond the session's mean, over it; it pushes an accelerometer (rectification).
    """
    read = [linear.at(k).jacobian() for k in range(n)]
    A, b = np.array([a for a, _ in read]), np.array([b for _, b in read])
    out = np.zeros((n, SIZE, 2 * KEYFRAME_SIZE + CONSTANTS_SIZE + 1))
    for of_gtsam, ours in _FROM_TO:
        out[:, :, ours] = A[:, :, of_gtsam]
    by_bias = A[:, :, 18:24] + A[:, :, 24:30]  # of both biases alike: their walk has no part in it
    force, rate = _force_and_rate(state)
    by_accel = (by_bias[:, :, :3, None] * force[:, None, None, :]).reshape(n, SIZE, 6)
    by_gyro = by_bias[:, :, 3:] * rate[:, None, None]
    by_constants = out[:, :, 2 * KEYFRAME_SIZE : -1]
    by_constants[:, :, COLUMNS["accel_scale"]], by_constants[:, :, COLUMNS["gyro_scale"]] = by_accel, by_gyro
    by_vibration = (by_bias[:, :, :3, None] * shaken[:, None, None, :]).reshape(n, SIZE, 6)
    by_constants[:, :, COLUMNS["rectification"]] = by_vibration
    b = b - by_vibration @ state.constants["rectification"]
    out[:, :, -1] = b - by_accel @ state.constants["accel_scale"] - by_gyro @ state.constants["gyro_scale"]
    return out


def _force_and_rate(state: State) -> tuple[Array, Array]:
    """Specific force along the two level axes (K-1, 2) m/s^2, and angular rate about up (K-1,) rad/s, by interval."""
    R, T, axes = state.R_ns[:-1], state.interval, state.geometry.level_axes_s
    turn = so3.log(R.transpose(0, 2, 1) @ state.R_ns[1:])
    force_n = np.diff(state.velocity_n, axis=0) / T - GRAVITY_N
    force_s = np.einsum("kji,kj->ki", R @ so3.exp(0.5 * turn), force_n)
    return force_s @ axes[:2].T, turn @ axes[2] / T
