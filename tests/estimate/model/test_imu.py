"""Bins and dense path against motions that are known in closed form."""

from dataclasses import replace

import gtsam
import numpy as np
import pytest

from smoother import so3
from smoother.estimate.factors.imu import preintegrate
from smoother.estimate.model.imu import BinnedImu, DensePath, bin_imu, dense_path, motion_at
from smoother.estimate.model.noise import InertialNoise
from smoother.frames import GRAVITY_N
from smoother.samples import ImuSamples
from smoother.units import DEG

from .shaken import NO_BIAS, Shaken, mean

NOISE = InertialNoise(0.1, 0.01, 1e-3, 1e-4)


def integrated(binned: BinnedImu, k: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Turn, velocity and position gained in interval k without gravity, axes of s at its start, step by step."""
    R, v, p = np.eye(3), np.zeros(3), np.zeros(3)
    for force, rate in zip(binned.specific_force_s[k], binned.angular_rate_s[k], strict=True):
        p = p + v * binned.dt + 0.5 * R @ force * binned.dt**2
        v = v + R @ force * binned.dt
        R = R @ so3.exp(rate * binned.dt)
    return R, v, p


def errors_of(binned: BinnedImu, motion: Shaken, k: int = 0) -> tuple[float, float, float]:
    """Attitude (rad), velocity (m/s) and position (m) that interval k integrates wrongly."""
    t0, t1 = binned.t[k : k + 2]
    turn, gained_v, gained_p = integrated(binned, k)
    start, end = motion.attitude(np.array([t0, t1]))
    velocity, position = motion.velocity_gain(t0, t1)
    return (
        float(np.linalg.norm(so3.log(turn.T @ start.T @ end))),
        float(np.linalg.norm(gained_v - velocity)),
        float(np.linalg.norm(gained_p - position)),
    )


def naive(imu: ImuSamples, t: np.ndarray, n_bins: int) -> BinnedImu:
    """What plain averaging into bins would make of the samples."""
    true = bin_imu(imu, t, n_bins, NO_BIAS, NO_BIAS)
    per_bin = round(len(imu.t) * true.dt / (imu.t[-1] - imu.t[0]))
    shape = (len(t) - 1, n_bins, per_bin, 3)
    inside = (imu.t > t[0] + 1e-9) & (imu.t < t[-1] + 1e-9)
    force, rate = (x[inside].reshape(shape).mean(axis=2) for x in (imu.specific_force_s, imu.angular_rate_s))
    return BinnedImu(t, true.dt, force, rate, true.missing)


class TestBins:
    def test_50_hz_bins_of_a_coning_and_sculling_logger_integrate_like_its_1_khz_samples(self) -> None:
        # 8 Hz, 3 deg and 4 m/s^2: a hard-driven kart over kerbs. 2 s are ten intervals between keyframes in one.
        motion, t = Shaken(8.0, 3.0 * DEG, 4.0), np.array([1.0, 3.0])
        imu = motion.samples(1000.0, 0.0, 4.0)
        attitude, velocity, position = errors_of(bin_imu(imu, t, 100, NO_BIAS, NO_BIAS), motion)
        raw_attitude, raw_velocity, raw_position = errors_of(bin_imu(imu, t, 2000, NO_BIAS, NO_BIAS), motion)
        # a bin of 20 ms spans a sixth of the period; what is left is of third order in it
        assert attitude < raw_attitude + 2e-4
        assert velocity < raw_velocity + 1e-3
        assert position < raw_position + 1e-3

    def test_plain_averages_would_drift_where_the_bins_do_not(self) -> None:
        motion, t = Shaken(8.0, 3.0 * DEG, 4.0), np.array([1.0, 3.0])
        imu = motion.samples(1000.0, 0.0, 4.0)
        good, plain = errors_of(bin_imu(imu, t, 100, NO_BIAS, NO_BIAS), motion), errors_of(naive(imu, t, 100), motion)
        assert plain[0] > 50.0 * good[0]  # coning
        assert plain[1] > 50.0 * good[1]  # sculling

    @pytest.mark.parametrize("rate", [25.0, 40.0, 50.0, 99.0, 200.0, 512.0, 1000.0, 2000.0])
    def test_any_rate_of_the_logger_integrates_to_the_same_motion(self, rate: float) -> None:
        motion = Shaken(0.7, 4.0 * DEG, 3.0)  # what a kart does, without vibration
        binned = bin_imu(motion.samples(rate, 0.0, 4.0), np.array([1.0, 2.0, 3.0]), 50, NO_BIAS, NO_BIAS)
        attitude, velocity, position = errors_of(binned, motion, 1)
        # a sample's own coning and sculling are lost with it: (motion's pace x interval)^2
        loss = (2.0 * np.pi * 0.7 / rate) ** 2
        assert attitude < 1e-5 + 0.01 * loss
        assert velocity < 1e-4 + 0.5 * loss
        assert position < 3e-4 + 0.5 * loss
        assert np.all(binned.missing == 0.0)

    def test_edges_between_the_samples_split_a_sample_by_its_share(self) -> None:
        t = np.arange(1, 11) * 0.1
        ramp = np.stack([np.arange(10.0)] * 3, axis=1)
        binned = bin_imu(ImuSamples(t, ramp, np.zeros((10, 3))), np.array([0.05, 0.25, 0.45]), 1, NO_BIAS, NO_BIAS)
        # 0.05..0.25 holds half of sample 0, all of sample 1, half of sample 2
        np.testing.assert_allclose(binned.specific_force_s[:, 0, 0], [1.0, 3.0])

    def test_jittering_stamps_lose_nothing(self) -> None:
        motion = Shaken(0.7, 4.0 * DEG, 3.0)
        end = np.cumsum(np.random.default_rng(0).uniform(0.002, 0.008, 800))
        width = np.diff(end, prepend=0.0)
        imu = ImuSamples(end, mean(motion.force_s, end, width), mean(motion.rate_s, end, width))
        binned = bin_imu(imu, np.array([1.0, 3.0]), 100, NO_BIAS, NO_BIAS)
        attitude, velocity, position = errors_of(binned, motion)
        assert attitude < 1e-4
        assert velocity < 1e-3
        assert position < 1e-3
        assert np.all(binned.missing == 0.0)

    def test_biases_are_taken_off_inside_and_put_back(self) -> None:
        motion, t = Shaken(8.0, 3.0 * DEG, 4.0), np.array([1.0, 1.2, 1.4])
        clean = motion.samples(1000.0, 0.0, 3.0)
        accel_bias, gyro_bias = np.array([0.5, -0.3, 0.8]), np.array([-1.0, 0.2, 0.6])  # up to 57 deg/s
        biased = ImuSamples(clean.t, clean.specific_force_s + accel_bias, clean.angular_rate_s + gyro_bias)
        want = bin_imu(clean, t, 10, NO_BIAS, NO_BIAS)
        found = bin_imu(biased, t, 10, accel_bias, gyro_bias)
        np.testing.assert_allclose(found.specific_force_s - accel_bias, want.specific_force_s, atol=1e-12)
        np.testing.assert_allclose(found.angular_rate_s - gyro_bias, want.angular_rate_s, atol=1e-12)

    def test_a_gap_is_flagged_with_its_length_and_bridged(self) -> None:
        motion = Shaken(0.7, 4.0 * DEG, 3.0)
        imu = motion.samples(200.0, 0.0, 3.0)
        kept = (imu.t <= 1.1 + 1e-9) | (imu.t > 1.3 + 1e-9)
        holed = ImuSamples(imu.t[kept], imu.specific_force_s[kept], imu.angular_rate_s[kept])
        t = 0.2 * np.arange(16)
        binned = bin_imu(holed, t[1:], 10, NO_BIAS, NO_BIAS)
        whole = bin_imu(imu, t[1:], 10, NO_BIAS, NO_BIAS)
        # from the last sample before it (1.1) to the interval of the first after it (1.3): 0.1 s in each of two
        np.testing.assert_allclose(binned.missing[[4, 5]], [0.5, 0.5], atol=0.03)
        assert np.all(np.delete(binned.missing, [4, 5]) == 0.0)
        assert np.max(np.abs(binned.specific_force_s - whole.specific_force_s)) < 0.5
        others = np.delete(np.arange(len(t) - 2), [4, 5])
        np.testing.assert_allclose(binned.angular_rate_s[others], whole.angular_rate_s[others], atol=1e-12)

    def test_before_the_first_and_after_the_last_sample_everything_is_missing(self) -> None:
        imu = Shaken(0.7, 0.0, 0.0).samples(200.0, 1.0, 2.0)
        binned = bin_imu(imu, 0.2 * np.arange(16), 10, NO_BIAS, NO_BIAS)
        np.testing.assert_allclose(binned.missing[:5], 1.0)
        np.testing.assert_allclose(binned.missing[5:10], 0.0, atol=1e-9)
        np.testing.assert_allclose(binned.missing[10:], 1.0)
        assert np.all(np.isfinite(binned.specific_force_s))

    def test_edges_of_the_bins_start_and_end_with_the_keyframes(self) -> None:
        binned = bin_imu(Shaken(1.0, 0.0, 0.0).samples(100.0, 0.0, 2.0), np.array([0.3, 0.7, 1.1]), 8, NO_BIAS, NO_BIAS)
        assert binned.n_bins == 8
        np.testing.assert_allclose(binned.edges, np.linspace(0.3, 1.1, 17))
        assert binned.dt == pytest.approx(0.05)

    def test_a_steady_turn_is_no_vibration(self) -> None:
        motion, t = Shaken(1.0, 0.0, 0.0), np.arange(0.2, 29.0, 0.2)
        imu = motion.samples(100.0, 0.0, 30.0)
        tone = 2.0 * np.sin(2.0 * np.pi * 12.0 * imu.t)[:, None] * [0.0, 0.6, 0.8]
        at_once = replace(imu, specific_force_s=imu.specific_force_s + np.where(imu.t[:, None] > 15.0, tone, 0.0))
        rough = bin_imu(at_once, t, 10, NO_BIAS, NO_BIAS).rough
        assert rough is not None
        assert np.median(rough[t[:-1] < 14.0, 0]) < 0.05  # forces of 5 m/s^2 that take seconds
        assert np.median(rough[t[:-1] > 16.0, 0]) > 1.5


Keyframes = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def keyframes_of(binned: BinnedImu, crooked: float, seed: int = 0) -> Keyframes:
    """R_ns, position, velocity and biases that follow the bins but for random steps of `crooked` at each keyframe."""
    rng, K = np.random.default_rng(seed), len(binned.t)
    accel_bias, gyro_bias = np.tile(rng.normal(size=3), (K, 1)), np.tile(0.1 * rng.normal(size=3), (K, 1))
    clean = replace(
        binned,
        specific_force_s=binned.specific_force_s - accel_bias[0],
        angular_rate_s=binned.angular_rate_s - gyro_bias[0],
    )
    R, p, v = [so3.exp(rng.normal(size=3))], [10.0 * rng.normal(size=3)], [10.0 * rng.normal(size=3)]
    for k in range(K - 1):
        T = binned.t[k + 1] - binned.t[k]
        turn, gained_v, gained_p = integrated(clean, k)
        step = crooked * rng.normal(size=(3, 3))
        p.append(p[k] + v[k] * T + 0.5 * GRAVITY_N * T**2 + R[k] @ gained_p + step[0])
        v.append(v[k] + GRAVITY_N * T + R[k] @ gained_v + step[1])
        R.append(R[k] @ turn @ so3.exp(step[2]))
    return np.array(R), np.array(p), np.array(v), accel_bias, gyro_bias


def shaken_bins(K: int, n_bins: int) -> BinnedImu:
    imu = Shaken(3.0, 0.02, 2.0).samples(200.0, 0.0, 0.2 * K + 1.0)
    return bin_imu(imu, 0.2 * np.arange(1, K + 1), n_bins, NO_BIAS, NO_BIAS)


def shaken_path(crooked: float = 0.3, n_bins: int = 10) -> tuple[BinnedImu, DensePath, Keyframes]:
    binned = shaken_bins(6, n_bins)
    keyframes = keyframes_of(binned, crooked)
    return binned, dense_path(binned, *keyframes), keyframes


class TestDensePath:
    @pytest.mark.parametrize("n_bins", [1, 2, 10])
    def test_it_passes_through_every_keyframe(self, n_bins: int) -> None:
        binned, path, (R, p, v, _, _) = shaken_path(n_bins=n_bins)
        np.testing.assert_allclose(path.t[::n_bins], binned.t)
        np.testing.assert_allclose(path.R_ns[::n_bins], R, atol=1e-12)
        np.testing.assert_allclose(path.position_n[::n_bins], p, atol=1e-12)
        np.testing.assert_allclose(path.velocity_n[::n_bins], v, atol=1e-12)

    def test_the_correction_jumps_neither_in_position_nor_in_velocity_at_a_keyframe(self) -> None:
        binned, path, (_, p, v, _, _) = shaken_path(n_bins=200)
        i, dt = 3 * 200, binned.dt
        # a mismatch of 0.3 m and 0.3 m/s in 0.2 s costs at most (6 x 0.3 / 0.2 + 4 x 0.3) / 0.2 = 51 m/s^2 an axis
        np.testing.assert_allclose(path.position_n[i + 1], p[3] + dt * v[3], atol=100.0 * dt**2)
        np.testing.assert_allclose(path.position_n[i - 1], p[3] - dt * v[3], atol=100.0 * dt**2)
        np.testing.assert_allclose(path.velocity_n[i + 1], v[3], atol=200.0 * dt)
        np.testing.assert_allclose(path.velocity_n[i - 1], v[3], atol=200.0 * dt)

    def test_keyframes_that_agree_with_the_inertial_samples_leave_them_alone(self) -> None:
        binned, path, (_, _, _, accel_bias, gyro_bias) = shaken_path(crooked=0.0)
        rate = (binned.angular_rate_s - gyro_bias[0]).reshape(-1, 3)
        np.testing.assert_allclose(path.angular_rate_s, rate, atol=1e-10)
        force = (binned.specific_force_s - accel_bias[0]).reshape(-1, 3)
        force_n = np.einsum("mij,mj->mi", path.R_ns[:-1], force)
        np.testing.assert_allclose(path.acceleration_n, force_n + GRAVITY_N, atol=1e-9)

    def test_gtsam_predicts_the_keyframes_that_leave_the_samples_alone(self) -> None:
        binned, _, (R, p, v, accel_bias, gyro_bias) = shaken_path(crooked=0.0)
        bias = gtsam.imuBias.ConstantBias(accel_bias[0], gyro_bias[0])
        for k in range(len(binned.t) - 1):
            (measured,) = preintegrate(binned.between(k, k + 2), NOISE, accel_bias[k], gyro_bias[k])
            end = measured.predict(gtsam.NavState(gtsam.Rot3(R[k]), p[k], v[k]), bias)
            # GTSAM adds turns in the tangent space of the interval's start, to first order in a bin
            np.testing.assert_allclose(end.attitude().matrix(), R[k + 1], atol=1e-4)
            np.testing.assert_allclose(end.velocity(), v[k + 1], atol=1e-3)
            np.testing.assert_allclose(end.position(), p[k + 1], atol=1e-4)

    def test_rates_and_accelerations_are_those_of_the_path_itself(self) -> None:
        binned, path, _ = shaken_path(crooked=0.01)  # 0.6 deg in 0.2 s: far more than a gyro misses
        np.testing.assert_allclose(path.acceleration_n, np.diff(path.velocity_n, axis=0) / binned.dt, atol=1e-9)
        turn = so3.log(path.R_ns[:-1].transpose(0, 2, 1) @ path.R_ns[1:]) / binned.dt
        np.testing.assert_allclose(path.angular_rate_s, turn, atol=0.01 * 2.0 * np.max(np.abs(turn)))

    def test_positions_are_the_integral_of_velocities(self) -> None:
        binned, path, _ = shaken_path(n_bins=200)
        mean_velocity = 0.5 * (path.velocity_n[1:] + path.velocity_n[:-1])
        np.testing.assert_allclose(np.diff(path.position_n, axis=0), mean_velocity * binned.dt, atol=1e-6)


class TestMotionAt:
    def test_at_its_own_edges_it_returns_the_path(self) -> None:
        _, path, _ = shaken_path(crooked=0.01)
        _, position_n, velocity_n = motion_at(path, path.t)
        np.testing.assert_allclose(position_n, path.position_n, atol=1e-9)
        np.testing.assert_allclose(velocity_n, path.velocity_n, atol=1e-9)

    def test_constant_acceleration_and_turn_are_reproduced_between_the_edges(self) -> None:
        t, a, w = 0.02 * np.arange(51), np.array([3.0, -2.0, 0.5]), np.array([0.3, -0.1, 2.0])
        path = DensePath(
            t,
            so3.exp(t[:, None] * w),
            0.5 * t[:, None] ** 2 * a + 5.0 * t[:, None],
            t[:, None] * a + 5.0,
            np.tile(w, (50, 1)),
            np.tile(a, (50, 1)),
        )
        ask = np.random.default_rng(1).uniform(0.0, 1.0, 200)
        R_ns, position_n, velocity_n = motion_at(path, ask)
        np.testing.assert_allclose(position_n, 0.5 * ask[:, None] ** 2 * a + 5.0 * ask[:, None], atol=1e-12)
        np.testing.assert_allclose(velocity_n, ask[:, None] * a + 5.0, atol=1e-12)
        np.testing.assert_allclose(R_ns, so3.exp(ask[:, None] * w), atol=1e-12)

    def test_position_and_velocity_are_continuous(self) -> None:
        _, path, _ = shaken_path(crooked=0.01)
        inner, tiny = path.t[1:-1], 1e-9
        (R_1, p_1, v_1), (R_2, p_2, v_2) = motion_at(path, inner - tiny), motion_at(path, inner + tiny)
        np.testing.assert_allclose(p_1, p_2, atol=1e-6)
        np.testing.assert_allclose(v_1, v_2, atol=1e-5)
        np.testing.assert_allclose(R_1, R_2, atol=1e-3)  # the spread of a crooked keyframe, first order

    def test_beyond_the_ends_it_coasts(self) -> None:
        _, path, _ = shaken_path(crooked=0.01)
        ends = np.array([path.t[0] - 2.0, path.t[-1] + 3.0])
        R_ns, position_n, velocity_n = motion_at(path, ends)
        np.testing.assert_allclose(position_n[0], path.position_n[0] - 2.0 * path.velocity_n[0])
        np.testing.assert_allclose(position_n[1], path.position_n[-1] + 3.0 * path.velocity_n[-1])
        np.testing.assert_allclose(velocity_n, path.velocity_n[[0, -1]], rtol=1e-9)
        np.testing.assert_allclose(R_ns[0], path.R_ns[0], atol=1e-12)
        np.testing.assert_allclose(R_ns[1], path.R_ns[-1], atol=1e-3)
