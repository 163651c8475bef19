"""GTSAM's preintegration of the bins and its CombinedImuFactor over each interval, with columns for scale and
misalignment of the sensors.

An error in proportion to force or rate acts like a bias in proportion to it, so its Jacobian is that of both biases of
a factor times force or rate. These are the keyframes' own: the measured ones hold the noise that is in the residual too
(errors in variables, see model/motion.py)."""

from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.noise import InertialNoise, shared_densities
from smoother.estimate.model.state import State
from smoother.frames import GRAVITY_N
from smoother.units import STANDARD_GRAVITY

# where GTSAM has the columns of a factor, X V X V B B, in the order of the tangents of both keyframes
_SIDES = (
    (slice(0, 6), slice(6, 9), slice(18, 24)),
    (slice(9, 15), slice(15, 18), slice(24, 30)),
)
SIZE = 15  # residuals: rotation, position, velocity, bias of force, bias of rate


def imu_factors(
    preintegrated: Sequence[gtsam.PreintegratedCombinedMeasurements], at: IntArray
) -> gtsam.NonlinearFactorGraph:
    """Return a CombinedImuFactor for each interval `at` (M,), between keyframes k and k + 1."""
    graph = gtsam.NonlinearFactorGraph()
    for k in at.tolist():
        graph.add(gtsam.CombinedImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), preintegrated[k]))
    return graph


def imu_rows(linear: gtsam.GaussianFactorGraph, at: IntArray, state: State) -> Rows:
    """The IMU factors of the intervals `at` (M,) as rows of 15, whitened: rotation, position, velocity, biases.

    linear: factors as GTSAM linearised them at `state`.
    """
    n = len(at)
    read = [linear.at(k).jacobian() for k in range(n)]
    A = np.array([a for a, _ in read]).reshape(n, SIZE, 2 * SIZE)  # a window may have no samples
    b = np.array([b for _, b in read]).reshape(n, SIZE)
    left, right = (
        np.concatenate([A[:, :, part] for part in side] + [np.zeros((n, SIZE, 3))], axis=2) for side in _SIDES
    )
    by_bias = left[:, :, 9:15] + right[:, :, 9:15]  # of both biases alike: their walk has no part in it
    force, rate = (values[at] for values in _force_and_rate(state))
    accel_scale, gyro_scale = state.constants["accel_scale"].reshape(3, 2), state.constants["gyro_scale"]
    error = np.hstack([force @ accel_scale.T, rate[:, None] * gyro_scale])
    residual = (by_bias @ error[:, :, None])[:, :, 0] - b
    constants = {
        "accel_scale": (by_bias[:, :, :3, None] * force[:, None, None, :]).reshape(n, SIZE, 6),
        "gyro_scale": by_bias[:, :, 3:] * rate[:, None, None],
    }
    full = np.ones((n, SIZE))
    return Rows("imu", at, residual, full, left, right, constants, full[:, 0])


def _force_and_rate(state: State) -> tuple[Array, Array]:
    """Specific force along the two level axes (K-1, 2) m/s^2, and angular rate about up (K-1,) rad/s, by interval."""
    R, T, axes = state.R_ns[:-1], state.interval, state.geometry.level_axes_s
    turn = so3.log(R.transpose(0, 2, 1) @ state.R_ns[1:])
    force_n = np.diff(state.velocity_n, axis=0) / T - GRAVITY_N
    force_s = np.einsum("kji,kj->ki", R @ so3.exp(0.5 * turn), force_n)
    return force_s @ axes[:2].T, turn @ axes[2] / T


def preintegrate(
    binned: BinnedImu, noise: InertialNoise, accel_bias: Array, gyro_bias: Array
) -> list[gtsam.PreintegratedCombinedMeasurements]:
    """Preintegrate the K-1 intervals about biases (3,), m/s^2 and rad/s."""
    n_bins, dt = binned.n_bins, binned.dt
    densities = zip(*(values.tolist() for values in shared_densities(binned, noise)), strict=True)
    bias = gtsam.imuBias.ConstantBias(accel_bias, gyro_bias)
    forces, rates = list(binned.specific_force_s.reshape(-1, 3)), list(binned.angular_rate_s.reshape(-1, 3))
    params: dict[tuple[float, float], gtsam.PreintegrationCombinedParams] = {}
    out, first = [], 0
    for density in densities:
        if density not in params:
            params[density] = preintegration_parameters(density[0], density[1], noise)
        measured = gtsam.PreintegratedCombinedMeasurements(params[density], bias)
        integrate = measured.integrateMeasurement
        for i in range(first, first + n_bins):
            integrate(forces[i], rates[i], dt)
        first += n_bins
        out.append(measured)
    return out


def preintegration_parameters(accel: float, gyro: float, noise: InertialNoise) -> gtsam.PreintegrationCombinedParams:
    """Return GTSAM's parameters for densities of force and rate, with shapes and walks of `noise`."""
    params = gtsam.PreintegrationCombinedParams.MakeSharedU(STANDARD_GRAVITY)
    eye = np.eye(3)
    params.setAccelerometerCovariance(np.array(noise.accel_shape) * accel**2)
    params.setGyroscopeCovariance(np.array(noise.gyro_shape) * gyro**2)
    params.setIntegrationCovariance(eye * 1e-8)  # the bins integrate the samples to this, m^2/s
    params.setBiasAccCovariance(eye * noise.accel_bias_walk**2)
    params.setBiasOmegaCovariance(eye * noise.gyro_bias_walk**2)
    return params
