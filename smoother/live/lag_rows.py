"""What the window's factors say, without the window: rows of a fix, the offset's step, the biases' step.

Constants of a stream, in this order: position latency, velocity latency, s; lever arm (3,) m in s; bias of the
receiver's velocity (3,) m/s in n; errors of scale and misalignment of force (3, 2) and of rate (3,), as in the batch
graph: by which the measured force grows per force along each level axis of the kart, the rate per rate about up.
"""

from dataclasses import dataclass

import gtsam
import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.inertial_noise import InertialNoise, interval_noise
from smoother.frames import GRAVITY_N

POSITION_LATENCY, VELOCITY_LATENCY, LEVER_ARM, DOPPLER_BIAS = 0, 1, slice(2, 5), slice(5, 8)
ACCEL_ERROR, GYRO_ERROR = slice(8, 14), slice(14, 17)
CONSTANTS = 17
_EYE = np.eye(3)


@dataclass(frozen=True, eq=False)
class Reading:
    """Motion at a keyframe that the rows of a fix are linear in: mean force and turn rate about up, in s."""

    force_s: Array
    skew_rate_s: Array


def fix_rows(
    R_ns: Array, p: Array, v: Array, offset: Array, constants: Array, reading: Reading, latency: float
) -> tuple[Array, tuple[Array, Array, Array, Array]]:
    """Predicted position and velocity (6,) of a fix, and Jacobians (6, .) by pose, velocity, offset, constants.

    latency s, of the velocity when the keyframe was placed. The rate in `reading` is held: the bias of the gyro moves
    the antenna's swing by a centimetre a second.
    """
    arm, turning = constants[LEVER_ARM], reading.skew_rate_s
    swing = turning @ arm
    late, late_velocity = latency - constants[POSITION_LATENCY], latency - constants[VELOCITY_LATENCY]
    a = R_ns @ reading.force_s + GRAVITY_N
    swung = arm + late * swing
    by_pose, by_velocity, by_offset, by_constants = (np.zeros((6, n)) for n in (6, 3, 3, CONSTANTS))
    by_pose[:3, :3] = -R_ns @ so3.skew(swung + 0.5 * late**2 * reading.force_s)
    by_pose[:3, 3:] = R_ns
    by_pose[3:, :3] = -R_ns @ so3.skew(swing + late_velocity * reading.force_s)
    by_velocity[:3], by_velocity[3:] = late * _EYE, _EYE
    by_offset[:3] = _EYE
    by_constants[:3, POSITION_LATENCY] = -(v + a * late) - R_ns @ swing
    by_constants[3:, VELOCITY_LATENCY] = -a
    by_constants[:3, LEVER_ARM] = R_ns @ (_EYE + late * turning)
    by_constants[3:, LEVER_ARM] = R_ns @ turning
    by_constants[3:, DOPPLER_BIAS] = _EYE
    moved = p + v * late + 0.5 * a * late**2 + R_ns @ swung + offset
    velocity = v + a * late_velocity + R_ns @ swing + constants[DOPPLER_BIAS]
    return np.concatenate([moved, velocity]), (by_pose, by_velocity, by_offset, by_constants)


@dataclass(frozen=True, eq=False)
class FixError:
    """What GTSAM calls for a fix: whitened residual (r,), and Jacobians (r, .) by its four variables if it wants them.

    keys of pose, velocity, offset, constants; measured, sigma (6,); known: which of the six were measured; latency as
    in :func:`fix_rows`; robust: sigmas beyond which position or velocity loses weight (Cauchy).
    """

    keys: list[int]
    measured: Array
    sigma: Array
    known: np.ndarray
    reading: Reading
    latency: float
    robust: float

    def __call__(self, _: object, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """Return the residual; write the Jacobians into the list, as GTSAM wants it."""
        pose = values.atPose3(self.keys[0])
        velocity, offset, constants = (values.atVector(key) for key in self.keys[1:])
        R_ns, p = pose.rotation().matrix(), pose.translation()
        predicted, blocks = fix_rows(R_ns, p, velocity, offset, constants, self.reading, self.latency)
        known = self.known
        whitened = np.zeros(6)
        whitened[known] = (predicted - self.measured)[known] / self.sigma[known]
        weight = np.empty(6)
        weight[:3] = 1.0 / (1.0 + whitened[:3] @ whitened[:3] / self.robust**2)
        weight[3:] = 1.0 / (1.0 + whitened[3:] @ whitened[3:] / self.robust**2)
        root = np.sqrt(weight)
        if jacobians is not None:
            scale = (root / self.sigma)[known, None]
            for i, block in enumerate(blocks):
                jacobians[i] = np.asfortranarray(block[known] * scale)
        return np.asarray((root * whitened)[known])


def offset_step(left: int, right: int, phi: float, sigma: Array) -> gtsam.NonlinearFactor:
    """Step of the first-order Gauss-Markov offset of the fixes: linear, stated about zero. Source: Gelb 1974, 3.8."""
    model = gtsam.noiseModel.Diagonal.Sigmas(sigma * np.sqrt(1.0 - phi**2))
    factor = gtsam.JacobianFactor(left, -phi * _EYE, right, _EYE, np.zeros(3), model)
    return gtsam.LinearContainerFactor(factor, _zeros({left: 3, right: 3}))


def felt_errors(level_axes_s: Array, force_s: Array, rate_s: Array) -> Array:
    """Errors (6,) of mean force and rate (3,), in s, by the constants, (6, 17).

    level_axes_s (3, 3): rows are the kart's axes in s, two level ones and up.
    """
    by_constants = np.zeros((6, CONSTANTS))
    by_constants[:3, ACCEL_ERROR] = np.kron(_EYE, level_axes_s[:2] @ force_s)
    by_constants[3:, GYRO_ERROR] = (level_axes_s[2] @ rate_s) * _EYE
    return by_constants


def bias_start(bias: int, constants: int, mean: Array, sigma: Array, felt: Array) -> gtsam.NonlinearFactor:
    """Prior on the first bias as felt, mean and sigma (6,) of what is left without the errors `felt` (6, 17)."""
    model = gtsam.noiseModel.Diagonal.Sigmas(sigma)
    factor = gtsam.JacobianFactor(bias, np.eye(6), constants, -felt, mean, model)
    return gtsam.LinearContainerFactor(factor, _zeros({constants: CONSTANTS}, bias))


def bias_step(left: int, right: int, constants: int, more_felt: Array, sigma: Array) -> gtsam.NonlinearFactor:
    """Step of the bias as felt: its walk, sigma (6,), and the errors (6, 17) felt more than in the last step."""
    model = gtsam.noiseModel.Diagonal.Sigmas(sigma)
    factor = gtsam.JacobianFactor(left, -np.eye(6), right, np.eye(6), constants, -more_felt, np.zeros(6), model)
    return gtsam.LinearContainerFactor(factor, _zeros({constants: CONSTANTS}, left, right))


def _zeros(vectors: dict[int, int], *biases: int) -> gtsam.Values:
    values = gtsam.Values()
    for key, size in vectors.items():
        values.insert(key, np.zeros(size))
    for key in biases:
        values.insert(key, gtsam.imuBias.ConstantBias())
    return values


def preintegrated(
    binned: BinnedImu, noise: InertialNoise, accel_bias: Array, gyro_bias: Array
) -> gtsam.PreintegratedImuMeasurements:
    """Preintegrate the single interval of `binned` about biases (3,)."""
    accel, gyro = (float(density[0]) for density in interval_noise(binned, noise))
    bias = gtsam.imuBias.ConstantBias(accel_bias, gyro_bias)
    measured = gtsam.PreintegratedImuMeasurements(carrying(accel, gyro), bias)
    for force, rate in zip(binned.specific_force_s[0], binned.angular_rate_s[0], strict=True):
        measured.integrateMeasurement(force, rate, binned.dt)
    return measured


def carrying(accel: float, gyro: float) -> gtsam.PreintegrationParams:
    """Parameters of a preintegration with densities accel m/s^2/sqrt(Hz) and gyro rad/s/sqrt(Hz)."""
    params = gtsam.PreintegrationParams.MakeSharedU(-float(GRAVITY_N[2]))
    params.setAccelerometerCovariance(np.eye(3) * accel**2)
    params.setGyroscopeCovariance(np.eye(3) * gyro**2)
    params.setIntegrationCovariance(np.eye(3) * 1e-8)
    return params
