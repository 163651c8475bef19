"""GTSAM preintegration of the bins of each interval between keyframes, with the noise of that interval."""

import gtsam
import numpy as np

from smoother.arrays import Array
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.noise import InertialNoise, shared_densities
from smoother.units import STANDARD_GRAVITY


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
