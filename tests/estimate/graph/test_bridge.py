"""Where there are no samples the fixes' path stands in: a level kart that points along it, and no other interval."""

from collections.abc import Callable
from dataclasses import replace

import gtsam
import numpy as np
import pytest

from smoother.estimate.gnss_path import GnssPath, GnssPathOptions, fit_gnss_path
from smoother.estimate.graph.bridge import along_path, with_path
from smoother.estimate.graph.imu import MISSING_ACCEL, PATH_GYRO, BinnedImu, InertialNoise, interval_noise, preintegrate
from smoother.frames import euler_from_rotation, rotation_from_euler, wrap_angle
from smoother.units import DEG

LATENCY = 0.3  # s
R_BS = rotation_from_euler(0.1, -0.2, 1.0)
ACCEL_BIAS, GYRO_BIAS = np.array([0.3, -0.2, 0.1]), np.array([0.02, -0.01, 0.03])
T, N_BINS, K = 0.2, 5, 200
NOISE = InertialNoise(0.1, 0.01, 1e-3, 1e-4)
AT = (np.arange(K - 1) >= 20) & (np.arange(K - 1) < 150)


@pytest.fixture(scope="module")
def path(lap_fixes: Callable) -> GnssPath:
    return fit_gnss_path(lap_fixes(3, latency=LATENCY, lag=0.0).session)


def bridged(path: GnssPath) -> tuple[BinnedImu, BinnedImu, np.ndarray]:
    """Bins of nonsense, those with the path in the intervals AT, and the attitudes along it."""
    t = 20.0 + T * np.arange(K)
    values = np.random.default_rng(0).normal(size=(2, K - 1, N_BINS, 3))
    binned = BinnedImu(t, T / N_BINS, *values, AT.astype(np.float64), np.full((K - 1, 2), 0.5))
    R_ns = along_path(path, t, LATENCY, R_BS)
    assert R_ns is not None
    return binned, with_path(binned, AT, path, LATENCY, R_ns, (ACCEL_BIAS, GYRO_BIAS)), R_ns


def test_the_kart_is_level_and_points_where_it_went_at_its_own_time(path: GnssPath, lap_motion: Callable) -> None:
    binned, _, R_ns = bridged(path)
    roll, pitch, yaw = euler_from_rotation(R_ns @ R_BS.T)
    np.testing.assert_allclose([roll, pitch], 0.0, atol=1e-9)
    x, y, _ = lap_motion(binned.t, 1).T
    fast = np.hypot(x, y) > 8.0  # m/s; in a hairpin the course turns by more than the path can say
    assert np.sqrt(np.mean(wrap_angle(yaw - np.arctan2(y, x))[fast] ** 2)) < 1.5 * DEG
    at_the_stamp = wrap_angle(yaw[:-1] - np.arctan2(y, x)[1:])[fast[1:]]
    assert np.sqrt(np.mean(at_the_stamp**2)) > 5.0 * DEG


def test_what_is_felt_moves_the_kart_along_the_path(path: GnssPath, lap_motion: Callable) -> None:
    binned, filled, R_ns = bridged(path)
    bias = gtsam.imuBias.ConstantBias(ACCEL_BIAS, GYRO_BIAS)
    position_n, velocity_n = lap_motion(binned.t), lap_motion(binned.t, 1)
    position_n[:, 2] = velocity_n[:, 2] = 0.0  # level ground
    for k, measured in enumerate(preintegrate(filled, NOISE, ACCEL_BIAS, GYRO_BIAS)):
        if AT[k]:
            left = gtsam.NavState(gtsam.Rot3(R_ns[k]), position_n[k], velocity_n[k])
            right = measured.predict(left, bias)
            np.testing.assert_allclose(right.attitude().matrix(), R_ns[k + 1], atol=1e-3)
            np.testing.assert_allclose(right.position(), position_n[k + 1], atol=0.08)
            np.testing.assert_allclose(right.velocity(), velocity_n[k + 1], atol=0.8)


def test_intervals_with_samples_keep_them_and_their_noise(path: GnssPath) -> None:
    binned, filled, _ = bridged(path)
    for name in ("specific_force_s", "angular_rate_s", "rough"):
        np.testing.assert_array_equal(getattr(filled, name)[~AT], getattr(binned, name)[~AT])
    one, two = interval_noise(binned, NOISE), interval_noise(filled, NOISE)
    np.testing.assert_array_equal(np.array(two)[:, ~AT], np.array(one)[:, ~AT])


def test_the_noise_is_what_the_path_is_unsure_of(path: GnssPath) -> None:
    _, filled, _ = bridged(path)
    accel, gyro = interval_noise(filled, NOISE)
    assert filled.path_sigma is not None
    np.testing.assert_allclose(accel[AT], np.hypot(NOISE.accel, filled.path_sigma[AT] * np.sqrt(T)))
    np.testing.assert_allclose(gyro[AT], np.hypot(NOISE.gyro, PATH_GYRO * np.sqrt(T)))
    assert np.all(filled.path_sigma[AT] < 0.5 * MISSING_ACCEL)


def test_a_stated_delay_is_in_the_path_already(lap_fixes: Callable, path: GnssPath) -> None:
    session = lap_fixes(3, latency=LATENCY, lag=0.0).session
    stated = fit_gnss_path(session, GnssPathOptions(position_latency=LATENCY))
    np.testing.assert_allclose(bridged(stated)[2], bridged(path)[2], atol=0.05)


def test_a_kart_that_never_moves_points_nowhere(lap_fixes: Callable) -> None:
    session = lap_fixes(3, duration=20.0, doppler=None).session
    gnss = session.gnss
    still = {name: np.full(len(gnss), getattr(gnss, name)[0]) for name in ("lat_deg", "lon_deg")}
    path = fit_gnss_path(replace(session, gnss=replace(gnss, **still)))
    assert along_path(path, np.arange(0.0, 10.0, T), 0.0, R_BS) is None
