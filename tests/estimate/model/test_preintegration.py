"""What GTSAM makes of the bins: the covariance of white noise, and every interval about its own bias."""

from dataclasses import replace

import numpy as np

from smoother import so3
from smoother.estimate.factors.imu import preintegrate
from smoother.estimate.model.imu import BinnedImu, bin_imu
from smoother.estimate.model.noise import InertialNoise

from .shaken import NO_BIAS, Shaken

NOISE = InertialNoise(0.1, 0.01, 1e-3, 1e-4)


def preintegrated(binned: BinnedImu, bias: tuple[np.ndarray, np.ndarray] = (NO_BIAS, NO_BIAS)):
    return preintegrate(binned, NOISE, *bias)


def test_preintegrated_covariance_is_that_of_white_noise() -> None:
    imu = Shaken(0.0, 0.0, 0.0, turn=0.0).samples(200.0, 0.0, 3.0)
    measured = preintegrated(bin_imu(imu, np.array([1.0, 2.0]), 50, NO_BIAS, NO_BIAS))[0]
    P = measured.preintMeasCov()  # rotation, position, velocity, biases
    assert P.shape == (15, 15)
    np.testing.assert_allclose(np.sqrt(np.diag(P)[0:3]), NOISE.gyro, rtol=0.02)  # after one second
    # velocity: accel noise, and gravity leaning with the attitude: q_g^2 g^2 T^3 / 3 on the level axes
    level, up = np.sqrt(NOISE.accel**2 + (NOISE.gyro * 9.8) ** 2 / 3.0), NOISE.accel
    np.testing.assert_allclose(np.sqrt(P[8, 8]), up, rtol=0.1)  # the forces of the drive lean a little too
    np.testing.assert_allclose(np.sqrt(np.diag(P)[6:8]), level, rtol=0.1)
    np.testing.assert_allclose(np.sqrt(np.diag(P)[9:12]), NOISE.accel_bias_walk, rtol=1e-6)
    np.testing.assert_allclose(np.sqrt(np.diag(P)[12:15]), NOISE.gyro_bias_walk, rtol=1e-6)


def test_every_interval_turns_as_its_own_bins_do() -> None:
    binned = bin_imu(
        Shaken(1.0, 0.1, 1.0).samples(100.0, 0.0, 2.0), np.array([0.4, 0.8, 1.2, 1.6]), 20, NO_BIAS, NO_BIAS
    )
    turned = []
    for rates in binned.angular_rate_s:
        R = np.eye(3)
        for rate in rates:
            R = R @ so3.exp(rate * binned.dt)
        turned.append(R)
    assert np.max(np.abs(turned[0] - turned[1])) > 0.01
    for found in (preintegrated(binned), preintegrate(binned, NOISE, NO_BIAS, NO_BIAS)):
        np.testing.assert_allclose(
            [measured.deltaRij().matrix() for measured in found], turned, atol=2e-4
        )  # a rotation vector is added up


def test_what_bins_integrate_the_samples_to_is_the_position_s_own_noise() -> None:
    imu = Shaken(0.0, 0.0, 0.0, turn=0.0).samples(200.0, 0.0, 3.0)
    binned = bin_imu(imu, np.array([1.0, 2.0]), 50, NO_BIAS, NO_BIAS)
    quiet = replace(NOISE, accel=1e-9, gyro=1e-9, accel_bias_walk=1e-9, gyro_bias_walk=1e-9)
    (measured,) = preintegrate(binned, quiet, NO_BIAS, NO_BIAS)
    np.testing.assert_allclose(np.diag(measured.preintMeasCov())[3:6], 1e-8, rtol=1e-3)  # m^2, after one second
