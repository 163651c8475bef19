"""What rows say of rates and accelerations, against motion that is known."""

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.expected import DopplerNoise, expected_motion
from smoother.estimate.graph.felt import Felt, felt_on, swing_covariance
from smoother.estimate.model.imu import DensePath
from smoother.estimate.model.inertial_noise import InertialNoise
from smoother.fit.running import gaussian_mean
from smoother.units import DEG

DT = 0.02
N = 30_000  # bins, ten minutes
T = np.asarray(DT * np.arange(N + 1), dtype=np.float64)
NOISE = InertialNoise(0.5, 3.0 * DEG, 0.003, 1e-4)
MOUNTING = so3.exp(np.array([0.3, -0.2, 2.0]))  # R_bs


def moving(rng: np.random.Generator, shape: tuple[int, ...], rms: float, width: float) -> Array:
    values = gaussian_mean(rng.normal(size=shape), width / DT)
    return np.asarray(rms * values / np.std(values, axis=0))


def driven(noise: InertialNoise = NOISE) -> tuple[DensePath, Array, Array]:
    """A path at 15 m/s whose box is turned; its rates about n (N, 3) and accelerations in n (N, 3), without noise.

    Roll and pitch are small, and the kart accelerates to the side to which it turns.
    """
    rng = np.random.default_rng(0)
    roll, pitch = moving(rng, (N + 1, 2), 0.02, 0.3).T
    turn = moving(rng, (N,), 0.6, 0.4)
    yaw = np.concatenate([[0.0], np.cumsum(turn * DT)])
    zero = np.zeros_like(yaw)
    R_nb = so3.exp(np.stack([zero, zero, yaw], axis=1)) @ so3.exp(np.stack([roll, pitch, zero], axis=1))
    R_ns = R_nb @ MOUNTING
    rate_s = so3.log(R_ns[:-1].transpose(0, 2, 1) @ R_ns[1:]) / DT
    velocity_n = 15.0 * np.stack([np.cos(yaw), np.sin(yaw), 0.02 * moving(rng, (N + 1,), 1.0, 0.3)], axis=1)
    acceleration_n = np.diff(velocity_n, axis=0) / DT
    path = DensePath(
        T,
        R_ns,
        np.zeros_like(velocity_n),
        velocity_n,
        rate_s + noise.gyro / np.sqrt(DT) * rng.normal(size=(N, 3)),
        acceleration_n + noise.accel / np.sqrt(DT) * rng.normal(size=(N, 3)),
    )
    return path, np.einsum("nij,nj->ni", R_ns[:-1], rate_s), acceleration_n


def on(path: DensePath) -> Felt:
    return felt_on(path, MOUNTING, NOISE, None, 0.2)


def middles(values: Array) -> Array:
    return np.asarray(0.5 * (values[1:] + values[:-1]))


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_rates_err_by_what_is_said_and_far_less_than_averages_would() -> None:
    path, rate_n, _ = driven()
    felt = on(path)
    error = middles(felt.rate_n) - rate_n
    assert rms(error[:, 2]) == pytest.approx(np.sqrt(felt.turning), rel=0.25)
    assert rms(error[:, :2]) == pytest.approx(np.sqrt(felt.tilting), rel=0.25)
    averaged_n = gaussian_mean(np.einsum("nij,nj->ni", path.R_ns[:-1], path.angular_rate_s), 0.07 / DT)
    assert rms(error[:, 2]) < 0.7 * rms(averaged_n[:, 2] - rate_n[:, 2])
    assert rms(error[:, :2]) < 0.5 * rms(averaged_n[:, :2] - rate_n[:, :2])


def test_accelerations_err_less_than_averages_would() -> None:
    path, _, acceleration_n = driven()
    error = middles(on(path).acceleration_n) - acceleration_n
    averaged = gaussian_mean(path.acceleration_n, 0.07 / DT) - acceleration_n
    assert rms(error[:, :2]) < 0.9 * rms(averaged[:, :2])
    assert rms(error[:, 2]) < 0.9 * rms(averaged[:, 2])


def test_upright_or_not_the_turn_is_about_up() -> None:
    """A box that lies on its side, and a kart that leans: nothing is divided by how upright they are."""
    path, rate_n, _ = driven(InertialNoise(1e-6, 1e-6, 0.0, 0.0))
    felt = felt_on(path, MOUNTING, InertialNoise(1e-6, 1e-6, 0.0, 0.0), None, 0.2)
    np.testing.assert_allclose(middles(felt.rate_n)[500:-500], rate_n[500:-500], atol=0.02)


def test_doppler_upwards_says_how_much_noise_is_left_upwards() -> None:
    """A path that velocities hold upwards is filtered less than one that only the samples tell of."""
    path, _, _ = driven()
    doppler = DopplerNoise(0.05, 0.1)
    alone, held = (expected_motion(path, MOUNTING, NOISE, doppler, 0.2, up) for up in (None, doppler))
    assert rms(alone.acceleration_n[:, :2] - held.acceleration_n[:, :2]) < 0.05  # by as much as the kart leans
    slow = slice(1, 300)  # below 0.5 Hz
    power = [np.sum(np.abs(np.fft.rfft(felt.acceleration_n[:, 2])[slow]) ** 2) for felt in (alone, held)]
    assert power[0] < power[1]


def test_the_swing_is_as_unsure_as_its_rates() -> None:
    rng, (path, _, _) = np.random.default_rng(1), driven()
    felt, arm_n = Felt(path, np.zeros((N + 1, 3)), np.zeros((N + 1, 3)), 0.04, 0.01), np.array([[0.7, -0.2, 0.4]])
    errors = rng.normal(size=(200_000, 3)) * [0.2, 0.2, 0.1]
    want = np.cov(np.cross(errors, arm_n).T)
    np.testing.assert_allclose(swing_covariance(felt, arm_n)[0], want, atol=2e-2 * want.max())


def test_a_box_that_tilts_on_the_wheel_does_not_swing_the_antenna_up_and_down() -> None:
    t, rate_n = 0.2 * np.arange(3), np.tile([0.3, -0.2, 0.7], (3, 1))
    none = np.zeros((2, 3))
    path = DensePath(t, np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 3)), np.zeros((3, 3)), none, none)
    frame, wheel = (Felt(path, np.zeros((3, 3)), rate_n, 0.0, 0.0, is_steered) for is_steered in (False, True))
    np.testing.assert_allclose(frame.swing_at(t), rate_n)
    np.testing.assert_allclose(wheel.swing_at(t), rate_n * [0.0, 0.0, 1.0])
    np.testing.assert_allclose(wheel.rate_at(t), rate_n)  # the box does
