"""The expected motion against motion that is known, and what a fit of arm and latency makes of it."""

import math
from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.graph.expected import (
    LEAST_LEFT,
    DopplerNoise,
    ExpectedMotion,
    expected_motion,
    integrated,
    noise_left,
    quick_scatter,
    quickest_slope,
    shown_below,
    turning_lead,
)
from smoother.estimate.graph.wiener import Transform, most_probable
from smoother.estimate.model.imu import DensePath
from smoother.estimate.model.inertial_noise import InertialNoise
from smoother.fit.running import gaussian_mean
from smoother.units import DEG

DT = 0.04
T = np.asarray(DT * np.arange(15001), dtype=np.float64)  # ten minutes
MIDDLE = T[:-1] + 0.5 * DT
NOISE = InertialNoise(0.5, 3.0 * DEG, 0.003, 1e-4)
STILL = InertialNoise(1e-6, 1e-6, 0.003, 1e-4)
INTERVAL = 0.2  # s between keyframes
ARM = 0.4  # m, of the antenna ahead of the sensor


def driven(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Speed and yaw rate (N,): corners, each taken slowly, in a rhythm that wanders."""
    yaw_rate = 0.9 * np.sin(0.7 * t + 3.0 * np.sin(0.05 * t))
    return 16.0 - 5.0 * yaw_rate**2 + np.sin(0.23 * t), yaw_rate


def corners() -> tuple[DensePath, np.ndarray]:
    """A path without noise along a curve in the plane, whose nose points where it goes, and the yaw rate of its bins.

    A sideslip that comes and goes with the corner is added to the nose: what tells arm and latency apart.
    """
    speed, _ = driven(T)
    yaw = np.concatenate([[0.0], np.cumsum(driven(MIDDLE)[1] * DT)])
    course = yaw - 0.08 * np.sin(0.9 * T + 2.0 * np.sin(0.07 * T))
    zero, one = np.zeros_like(T), np.ones_like(T)
    R = np.stack([np.cos(yaw), -np.sin(yaw), zero, np.sin(yaw), np.cos(yaw), zero, zero, zero, one], axis=1)
    velocity = speed[:, None] * np.stack([np.cos(course), np.sin(course), zero], axis=1)
    rate = np.diff(yaw)[:, None] / DT * [0.0, 0.0, 1.0]
    return DensePath(
        T, R.reshape(-1, 3, 3), np.zeros_like(velocity), velocity, rate, np.diff(velocity, axis=0) / DT
    ), rate


def noisy(path: DensePath, noise: InertialNoise) -> DensePath:
    rng = np.random.default_rng(0)
    return DensePath(
        path.t,
        path.R_ns,
        path.position_n,
        path.velocity_n,
        path.angular_rate_s + noise.gyro / np.sqrt(DT) * rng.normal(size=path.angular_rate_s.shape),
        path.acceleration_n + noise.accel / np.sqrt(DT) * rng.normal(size=path.acceleration_n.shape),
    )


def expected(path: DensePath, level_axes_s: np.ndarray, noise: InertialNoise) -> ExpectedMotion:
    """Of a path that no velocities had a part in."""
    return expected_motion(path, level_axes_s, noise, None, INTERVAL)


def middles(felt: ExpectedMotion) -> tuple[np.ndarray, np.ndarray]:
    """Acceleration (N, 2) and yaw rate (N,) between the edges."""
    a, w = felt.acceleration_n, felt.turn_rate
    return 0.5 * (a[1:] + a[:-1])[:, :2], 0.5 * (w[1:] + w[:-1])


def fit(path: DensePath, acceleration: np.ndarray, yaw_rate: np.ndarray, late: np.ndarray) -> np.ndarray:
    """Arm (m) and latency (s) by least squares from what velocities (N, 2) differ by from the sensor's, `late`."""
    left = path.R_ns[:-1, :2, 1]
    design = np.stack([yaw_rate[:, None] * left, -acceleration], axis=2).reshape(-1, 2)
    return np.asarray(np.linalg.lstsq(design, late.ravel(), rcond=None)[0])


class TestExpectedMotion:
    def test_without_noise_it_is_the_motion_itself_at_the_edges(self) -> None:
        path, rate = corners()
        felt = expected(path, np.eye(3), STILL)
        for found, true in ((felt.acceleration_n, path.acceleration_n), (felt.turn_rate, rate[:, 2])):
            np.testing.assert_allclose(found[1:-1], 0.5 * (true[1:] + true[:-1]), atol=1e-4)

    def test_most_of_the_noise_is_gone(self) -> None:
        path, rate = corners()
        shaken = noisy(path, NOISE)
        acceleration, yaw_rate = middles(expected(shaken, np.eye(3), NOISE))
        assert np.std(yaw_rate - rate[:, 2]) < 0.2 * np.std(shaken.angular_rate_s[:, 2] - rate[:, 2])
        true = path.acceleration_n[:, :2]
        assert np.std(acceleration - true) < 0.5 * np.std(shaken.acceleration_n[:, :2] - true)

    def test_turn_and_lateral_force_tell_of_one_another_by_the_speed_beside_them(self) -> None:
        """Speeds change by half here: by a turn over the speed, or a force times it, next to nothing would be told."""
        path, rate = corners()
        left = path.R_ns[:-1, :2, 1]

        def off(noise: InertialNoise) -> tuple[float, float]:
            acceleration, yaw_rate = middles(expected(noisy(path, noise), np.eye(3), noise))
            beside = np.sum((acceleration - path.acceleration_n[:, :2]) * left, axis=1)
            return float(np.std(beside)), float(np.std(yaw_rate - rate[:, 2]))

        useless_turn, useless_force = off(replace(NOISE, gyro=1000.0 * DEG)), off(replace(NOISE, accel=100.0))
        assert off(replace(NOISE, gyro=0.3 * DEG))[0] < 0.8 * useless_turn[0]
        assert off(replace(NOISE, accel=0.1))[1] < 0.8 * useless_force[1]

    @pytest.mark.parametrize("column", [35.0 * DEG, 55.0 * DEG])
    def test_the_turn_of_a_box_on_the_wheel_is_that_of_its_kart(self, column: float) -> None:
        path, rate = corners()
        axis = np.array([-np.sin(column), 0.0, np.cos(column)])
        hand = gaussian_mean(np.random.default_rng(2).normal(size=(len(T), 1)), 0.15 / DT)[:, 0]
        angle = 0.15 * hand / np.std(hand) + 0.4 * driven(T + 0.2)[1]  # ahead of the bend
        wheel = so3.exp(angle[:, None] * axis)
        R_ns = path.R_ns @ wheel
        rates = so3.log(R_ns[:-1].transpose(0, 2, 1) @ R_ns[1:]) / DT
        shaken = noisy(replace(path, R_ns=R_ns, angular_rate_s=rates), NOISE)
        off = {}
        for is_steered in (False, True):
            felt = expected_motion(shaken, np.eye(3), NOISE, None, INTERVAL, is_steered=is_steered)
            off[is_steered] = np.std(middles(felt)[1] - rate[:, 2])
        assert off[False] > 0.2  # rad/s, of 0.6 that the kart turns by
        assert off[True] < 0.3 * off[False]

    def test_its_velocity_is_what_its_acceleration_adds_up_to(self) -> None:
        """All but slow changes, of which the fixes tell."""
        path, _ = corners()
        shaken = noisy(path, NOISE)
        added = np.concatenate([[np.zeros(3)], np.cumsum((shaken.acceleration_n - path.acceleration_n) * DT, axis=0)])
        shaken = replace(shaken, velocity_n=path.velocity_n + added)
        felt = expected(shaken, np.eye(3), NOISE)
        left = gaussian_mean(np.diff(felt.velocity_n[:, :2], axis=0) / DT - middles(felt)[0], 3.0)
        noise = gaussian_mean(np.diff(shaken.velocity_n[:, :2], axis=0) / DT - middles(felt)[0], 3.0)
        assert np.std(left[100:-100]) < 0.2 * np.std(noise[100:-100])
        # and of quick noise nothing: differences of this velocity are slopes, by which a thousandth counts
        quick = np.diff(felt.velocity_n[:, :2], axis=0) / DT - middles(felt)[0]
        quick -= gaussian_mean(quick, 0.2 / DT)
        assert np.std(quick[100:-100]) < 0.03 * np.std(np.diff(added, axis=0)[:, :2] / DT)

    def test_arm_and_latency_are_not_drawn_to_zero_by_the_noise_of_what_they_multiply(self) -> None:
        """Nor by what filters that know only one sensor each leave of it."""
        path, rate = corners()
        late = rate[:, 2:] * ARM * path.R_ns[:-1, :2, 1] - 0.02 * path.acceleration_n[:, :2]
        shaken = noisy(path, NOISE)
        arm, latency = fit(path, *middles(expected(shaken, np.eye(3), NOISE)), late)
        assert arm == pytest.approx(ARM, abs=0.1 * ARM)
        assert latency == pytest.approx(0.02, abs=0.002)
        plain_arm, _ = fit(path, shaken.acceleration_n[:, :2], shaken.angular_rate_s[:, 2], late)
        sigma = NOISE.gyro / np.sqrt(DT) * np.ones(1), NOISE.accel / np.sqrt(DT) * np.ones(2)
        acceleration = most_probable(
            Transform.of(shaken.acceleration_n[:, :2], DT), sigma[1], slice(0, 2)
        ).signal.values()
        turn = most_probable(Transform.of(shaken.angular_rate_s[:, 2:], DT), sigma[0], slice(0, 1)).signal.values()[
            :, 0
        ]
        alone_arm, _ = fit(path, acceleration, turn, late)
        assert abs(plain_arm - ARM) > 0.3 * ARM
        assert abs(alone_arm - ARM) > 2.0 * abs(arm - ARM)

    def test_the_yaw_rate_of_a_nose_that_turns_in_before_the_path_keeps_its_time(self) -> None:
        ahead = 0.1  # s
        speed, _ = driven(T)
        yaw, course = (np.concatenate([[0.0], np.cumsum(driven(MIDDLE + early)[1] * DT)]) for early in (ahead, 0.0))
        velocity = speed[:, None] * np.stack([np.cos(course), np.sin(course), 0.0 * T], axis=1)
        path, _ = corners()
        rate = np.diff(yaw) / DT
        path = replace(
            path,
            R_ns=so3.exp(yaw[:, None] * [0.0, 0.0, 1.0]),
            velocity_n=velocity,
            acceleration_n=np.diff(velocity, axis=0) / DT,
            angular_rate_s=rate[:, None] * [0.0, 0.0, 1.0],
        )
        found = middles(expected(noisy(path, NOISE), np.eye(3), NOISE))[1]
        slope = np.gradient(rate, DT)
        assert abs(float((found - rate) @ slope / (slope @ slope))) < 0.05 * ahead

    def test_a_slow_corner_is_known_as_well_as_a_quick_one(self) -> None:
        """And its error is none of what the acceleration does not tell, by which an arm would seem to be seen."""
        rng = np.random.default_rng(8)
        speed = 17.0 + 14.0 * np.sin(0.15 * T)
        turn = gaussian_mean(rng.normal(size=len(T)), 0.5 / DT)
        turn *= 8.0 / np.std(turn) / speed  # as much acceleration in each corner
        yaw = np.concatenate([[0.0], np.cumsum(0.5 * (turn[1:] + turn[:-1]) * DT)])
        zero = np.zeros_like(T)
        velocity = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw), zero], axis=1)
        rates = np.diff(yaw)[:, None] / DT * [0.0, 0.0, 1.0]
        R = so3.exp(np.stack([zero, zero, yaw], axis=1))
        path = DensePath(T, R, np.zeros_like(velocity), velocity, rates, np.diff(velocity, axis=0) / DT)
        found = expected(noisy(path, NOISE), np.eye(3), NOISE)
        error, slow = found.turn_rate - turn, speed < 8.0
        assert np.std(error[slow]) < 2.0 * np.std(error[~slow])
        assert np.std(error) == pytest.approx(np.sqrt(found.turn_variance), rel=0.3)

    def test_a_path_that_doppler_has_held_is_freed_of_what_noise_is_left_in_it_and_no_more(self) -> None:
        """With samples as bad as a real kart's, white noise for all would take a good part of the motion with it."""
        path, _ = corners()
        bad, doppler = replace(NOISE, accel=1.5), DopplerNoise(0.15, INTERVAL)
        n = len(MIDDLE)
        left = np.sqrt(noise_left(np.asarray(np.fft.rfftfreq(n, DT)), bad.accel, doppler, INTERVAL))[:, None]
        white = bad.accel / np.sqrt(DT) * np.random.default_rng(4).normal(size=(n, 3))
        held = replace(
            path, acceleration_n=path.acceleration_n + np.fft.irfft(left * np.fft.rfft(white, axis=0), n, axis=0)
        )
        true = path.acceleration_n[:, :2]
        knowing, not_knowing = (middles(expected_motion(held, np.eye(3), bad, d, INTERVAL))[0] for d in (doppler, None))
        assert np.std(knowing - true) < 0.85 * np.std(not_knowing - true)
        # most probable: what it misses is no part of it
        assert np.sum(knowing * (true - knowing)) == pytest.approx(0.0, abs=0.01 * np.sum(true**2))

    def test_the_turn_rate_is_left_to_the_samples(self) -> None:
        path, _ = corners()
        shaken = noisy(path, NOISE)
        alone, held = (expected_motion(shaken, np.eye(3), NOISE, d, INTERVAL) for d in (None, DopplerNoise(0.1, 0.2)))
        np.testing.assert_array_equal(alone.turn_rate, held.turn_rate)
        assert not np.allclose(alone.acceleration_n, held.acceleration_n, atol=0.1)

    def test_a_gyro_noisier_than_was_thought_leaves_no_noise_where_no_kart_turns(self) -> None:
        """Engines that the samples alias are not in the noise that was identified, and differ from axis to axis."""
        path, rate = corners()
        shaken, level = noisy(path, NOISE), np.eye(3)
        believed, known = (
            middles(expected(shaken, level, replace(NOISE, gyro=gyro)))[1] - rate[:, 2]
            for gyro in (0.8 * NOISE.gyro, NOISE.gyro)
        )
        assert np.std(believed) < 1.05 * np.std(known)

    def test_it_does_not_depend_on_how_the_box_is_mounted(self) -> None:
        path, _ = corners()
        shaken = noisy(path, NOISE)
        R_bs = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        turned = DensePath(
            path.t,
            path.R_ns @ R_bs,
            path.position_n,
            path.velocity_n,
            shaken.angular_rate_s @ R_bs,
            shaken.acceleration_n,
        )
        want, have = expected(shaken, np.eye(3), NOISE), expected(turned, R_bs, NOISE)
        np.testing.assert_allclose(have.acceleration_n, want.acceleration_n, atol=1e-9)
        np.testing.assert_allclose(have.turn_rate, want.turn_rate, atol=1e-9)

    def test_a_path_that_has_run_away_stays_as_it_is(self) -> None:
        path, _ = corners()
        away = path.acceleration_n.copy()
        away[7000] = np.inf
        felt = expected(replace(path, acceleration_n=away), np.eye(3), NOISE)
        np.testing.assert_array_equal(felt.velocity_n, path.velocity_n)
        assert np.isinf(felt.acceleration_n[7000, 0])
        unknown = expected(path, np.eye(3), replace(NOISE, gyro=np.nan))
        np.testing.assert_array_equal(unknown.velocity_n, path.velocity_n)

    def test_a_stretch_of_a_few_bins_and_a_kart_at_rest_stay_finite(self) -> None:
        zeros = np.zeros((6, 3))
        path = DensePath(T[:6], np.tile(np.eye(3), (6, 1, 1)), zeros, zeros, zeros[1:], zeros[1:])
        felt = expected(path, np.eye(3), NOISE)
        np.testing.assert_array_equal(felt.acceleration_n, zeros)
        np.testing.assert_array_equal(felt.turn_rate, zeros[:, 0])


class TestQuickestSlope:
    def test_motion_is_followed_as_far_as_keyframes_can(self) -> None:
        path, _ = corners()
        assert quickest_slope(Transform.of(path.acceleration_n[:, :2], DT), INTERVAL) == 0.5 / INTERVAL

    def test_vibration_that_is_folded_to_some_hertz_is_no_part_of_slopes(self) -> None:
        """Four hertz and nearly two, of 3 m/s^2 each, come and go as an engine does; above the noise by far."""
        path, _ = corners()
        on = np.clip(np.sin(0.3 * MIDDLE), 0.0, None)
        shake = 3.0 * on * (np.sin(2.0 * np.pi * 4.0 * MIDDLE) + np.sin(2.0 * np.pi * 1.9 * MIDDLE))
        ahead = path.R_ns[:-1, :, 0]
        shaken = replace(path, acceleration_n=path.acceleration_n + shake[:, None] * ahead)
        calm = replace(NOISE, accel=0.1)
        have, want = (expected(p, np.eye(3), calm) for p in (shaken, path))
        edges = 0.5 * (shake[1:] + shake[:-1])[:, None] * path.R_ns[1:-1, :, 0]
        left = have.slow.acceleration_n[1:-1] - want.slow.acceleration_n[1:-1]
        assert np.std(have.acceleration_n[1:-1] - want.acceleration_n[1:-1]) > 0.7 * np.std(edges)
        assert np.std(left) < 0.2 * np.std(edges)

    def test_slopes_are_of_what_the_receiver_shows_late_and_little_else(self) -> None:
        assert [shown_below(r) for r in (-0.01, 0.0, 1e-3)] == [2.5, 2.5, 2.5]
        assert shown_below(0.5 * 0.15**2) == pytest.approx(math.sqrt(0.3 / 0.01125) / (2.0 * np.pi))
        assert shown_below(0.3) == 0.45  # what drives a kart round its bends is not slower
        path, _ = corners()
        weave = 3.0 * np.sin(2.0 * np.pi * 1.2 * MIDDLE)
        weaving = replace(path, acceleration_n=path.acceleration_n + weave[:, None] * path.R_ns[:-1, :, 0])
        calm = replace(NOISE, accel=0.01)
        for below, seen in ((2.5, True), (0.8, False)):
            have, want = (
                expected_motion(p, np.eye(3), calm, None, INTERVAL, slopes_below=below) for p in (weaving, path)
            )
            left = np.linalg.norm(have.slow.acceleration_n - want.slow.acceleration_n, axis=1)[50:-50]
            assert (np.std(left) > 0.2 * np.std(weave)) == seen
            answered = np.linalg.norm(have.answered.acceleration_n - want.answered.acceleration_n, axis=1)[50:-50]
            assert np.std(answered) > 0.2 * np.std(weave)

    def test_quick_receivers_tell_constants_by_no_quicker_motion_than_others(self) -> None:
        """What a chassis does over kerbs, four times a second: keyframes 0.08 s apart follow it, nobody drove it."""
        path, _ = corners()
        kerbs = 0.5 * np.sin(2.0 * np.pi * 4.0 * MIDDLE) * np.clip(np.sin(0.3 * MIDDLE), 0.0, None)
        rolling = replace(path, acceleration_n=path.acceleration_n + kerbs[:, None] * path.R_ns[:-1, :, 1])
        calm = replace(NOISE, accel=0.01)
        have, want = (expected_motion(p, np.eye(3), calm, None, 0.08) for p in (rolling, path))
        size = np.std(0.5 * (kerbs[1:] + kerbs[:-1]))
        found, driven = (
            np.linalg.norm(one.acceleration_n - other.acceleration_n, axis=1)[50:-50]
            for one, other in ((have, want), (have.slow, want.slow))
        )
        assert np.sqrt(np.mean(found**2)) > 0.8 * size
        assert np.sqrt(np.mean(driven**2)) < 0.1 * size

    def test_less_is_followed_by_and_by(self) -> None:
        rng = np.random.default_rng(0)
        white = Transform.of(rng.normal(size=(20_000, 2)), DT)
        found = []
        for share in (0.1, 0.6, 0.8, 2.0):
            shaken = np.where((white.frequency > 2.0)[:, None], np.sqrt(share), 1.0)
            found.append(quickest_slope(replace(white, coefficients=white.coefficients * shaken), INTERVAL))
        assert found[0] == 2.5 > found[1] > found[2] > found[3] == 1.5


class TestIntegrated:
    def test_from_edge_to_edge_it_changes_by_a_bin(self) -> None:
        values = np.random.default_rng(3).normal(size=(4999, 2))  # no quick length
        found = integrated(values, DT)
        assert found.shape == (5000, 2)
        np.testing.assert_allclose(np.diff(found, axis=0)[-1], DT * values[-1])
        left = values - values.mean(axis=0) - np.diff(found, axis=0) / DT
        assert np.std(left[:-1]) < 0.1  # only what is slow: 0.08 of all

    def test_what_is_slow_is_not_in_it(self) -> None:
        t = DT * (np.arange(8192) + 0.5)
        whole = 8192 * DT
        for cycles, share in ((2, 0.0), (round(0.5 * whole), 1.0)):  # 0.006 and 0.5 Hz
            angular = 2.0 * np.pi * cycles / whole
            found = integrated(np.cos(angular * t)[:, None], DT)[:-1, 0]
            true = np.sin(angular * (t - 0.5 * DT)) / angular
            np.testing.assert_allclose(found, share * true, atol=0.02 / angular)


class TestNoiseLeft:
    def test_it_is_the_error_of_a_path_between_exact_readings(self) -> None:
        """White force, whose mean from one reading to the next is known exactly: within, all of it is left."""
        n, per = 200_000, 5
        white = np.random.default_rng(6).normal(size=(n // per, per))
        left = (white - white.mean(axis=1, keepdims=True)).ravel()
        frequency, power = np.fft.rfftfreq(n, DT), np.abs(np.fft.rfft(left)) ** 2 / n
        share = noise_left(np.asarray(frequency), 1.0, DopplerNoise(1e-9, per * DT), per * DT)
        for low, high in ((1.5, 2.0), (2.5, 3.5), (4.0, 4.8)):
            band = (frequency > low) & (frequency < high)
            of_path = (share[band].mean() - LEAST_LEFT) / (1.0 - LEAST_LEFT)
            assert power[band].mean() == pytest.approx(of_path, rel=0.05)

    def test_of_a_mean_both_sensors_know_their_part(self) -> None:
        frequency, doppler = np.array([0.6]), DopplerNoise(0.3, 0.01)  # so dense that it is a process in time
        of_doppler = (2.0 * np.pi * frequency * 0.3) ** 2 * 0.01
        left = noise_left(frequency, 0.2, doppler, 0.01)
        of_path = of_doppler / (0.2**2 + of_doppler)
        np.testing.assert_allclose(left, LEAST_LEFT + (1.0 - LEAST_LEFT) * of_path, rtol=0.01)

    def test_without_velocities_and_far_above_their_rate_all_is_left(self) -> None:
        frequency = np.array([0.1, 1.0, 20.0])
        np.testing.assert_array_equal(noise_left(frequency, 1.0, None, 0.2), 1.0)
        assert noise_left(frequency, 1.0, DopplerNoise(0.1, 0.2), 0.2)[2] > 0.98

    def test_never_is_nothing_left(self) -> None:
        left = noise_left(np.array([0.0, 1e-3]), 1.0, DopplerNoise(0.1, 0.2), 0.2)
        np.testing.assert_allclose(left, LEAST_LEFT, rtol=1e-3)


class TestQuickScatter:
    def test_it_is_that_of_the_noise_and_not_of_the_motion(self) -> None:
        noise = 0.7 * np.random.default_rng(8).normal(size=len(MIDDLE))
        values = (5.0 * driven(MIDDLE)[1] + noise)[:, None]
        assert quick_scatter(Transform.of(values, DT)) == pytest.approx(0.7, rel=0.03)

    def test_bins_too_long_to_tell_say_nothing(self) -> None:
        assert quick_scatter(Transform.of(np.ones((100, 1)), 0.2)) == 0.0


class TestTurningLead:
    def test_the_time_is_found_in_noise(self) -> None:
        rng, n, lead = np.random.default_rng(6), 15000, 3
        motion = gaussian_mean(rng.normal(size=(n + lead, 1)), 8.0)[:, 0]
        motion *= 6.0 / np.std(motion)
        values = np.column_stack([motion[:n], motion[lead:]]) + 3.0 * rng.normal(size=(n, 2))
        assert turning_lead(Transform.of(values, DT)) == pytest.approx(lead * DT, abs=0.01)
        assert turning_lead(Transform.of(values[:, ::-1], DT)) == pytest.approx(-lead * DT, abs=0.01)

    def test_where_nothing_is_shared_there_is_none(self) -> None:
        turns = np.sin(0.7 * MIDDLE)
        assert turning_lead(Transform.of(np.column_stack([turns, -turns]), DT)) == 0.0
        assert turning_lead(Transform.of(np.zeros((100, 2)), DT)) == 0.0

    def test_a_lead_beyond_what_karts_have_fades(self) -> None:
        """That of a box on the steering wheel is near the limit; all or nothing of it would be two solutions."""
        n, leads = 15000, np.arange(1, 20)
        motion = gaussian_mean(np.random.default_rng(6).normal(size=(n + 20, 1)), 25.0)[:, 0]
        both = [np.column_stack([motion[:n], motion[lead : n + lead]]) for lead in leads]
        found = np.array([turning_lead(Transform.of(values, DT)) for values in both])
        short, long = leads * DT < 0.14, leads * DT > 0.31
        assert short.any()
        assert long.any()
        np.testing.assert_allclose(found[short], leads[short] * DT, rtol=0.15)
        np.testing.assert_allclose(found[long], 0.0, atol=1e-12)
        assert np.max(np.abs(np.diff(found))) < 2.0 * DT


def test_velocities_come_as_often_as_they_are_known() -> None:
    t = np.arange(0.0, 10.1, 0.2)
    known = np.where(np.arange(len(t)) % 2, np.nan, 1.0)
    assert DopplerNoise.of(t, known, 0.1) == DopplerNoise(0.1, pytest.approx(0.4))
    assert DopplerNoise.of(t, np.full(len(t), np.nan), 0.1) is None
