"""Gyroscope scale and misalignment from the turns between resting positions, on simulated handling."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.fit.ellipsoid import FitError
from smoother.fit.gyro_turns import _directions, _rows, _turns, fit_gyro_matrix
from smoother.fit.resting import resting_positions
from smoother.fit.six_position import fit_accelerometer
from smoother.fit.standstill import detect_standstill
from smoother.sim.bench import BenchPlan, simulate_bench
from smoother.sim.scenario import ImuErrors, MagErrors
from smoother.units import DEG

FIELD_N = np.array([22.0, 0.0, -42.0])
DENSITY = 0.01 * DEG


def handled(seed, positions=14, noise=1.0):
    rng = np.random.default_rng(seed)
    errors = ImuErrors(
        rate=100.0,
        accel_noise=0.004 * noise,
        gyro_noise=DENSITY * noise,
        accel_bias=rng.normal(0.0, 0.3, 3),
        gyro_bias=rng.normal(0.0, 2.0 * DEG, 3),
        accel_matrix=np.eye(3) + rng.normal(0.0, 0.01, (3, 3)),
        gyro_matrix=np.eye(3) + rng.normal(0.0, 0.01, (3, 3)),
    )
    plan = BenchPlan(still=8.0, positions=positions, rest=5.0, waving=0.0)
    bench = simulate_bench(errors, MagErrors(rate=1.0), FIELD_N, rng, plan)
    t, force, rate = bench.imu.t, bench.imu.accel, bench.imu.gyro
    found = resting_positions(t, force, rate, detect_standstill(t, force, rate))
    return bench, t, rate, found, fit_accelerometer(found)


def test_without_noise_the_matrix_comes_back():
    bench, t, rate, positions, accel = handled(1, noise=1e-3)
    fit = fit_gyro_matrix(t, rate, positions, accel, DENSITY)
    np.testing.assert_allclose(fit.matrix, bench.truth.gyro_matrix, atol=2e-5)
    assert fit.rms_after < 0.05 * fit.rms_before


def test_nees_of_all_nine_is_that_of_nine():
    nees = []
    for seed in range(20, 32):
        bench, t, rate, positions, accel = handled(seed)
        fit = fit_gyro_matrix(t, rate, positions, accel, DENSITY)
        error = (fit.matrix - bench.truth.gyro_matrix).ravel()
        nees.append(error @ np.linalg.solve(fit.covariance, error))
    assert 5.4 < np.mean(nees) < 13.9  # 99.9 % of the mean of 12 chi-squares of 9


def test_the_jacobian_of_a_turn_is_the_numerical_one():
    _, t, rate, positions, accel = handled(2)
    up = _directions(positions, accel)
    turn = _turns(t, rate, positions, up)[3]

    def predicted(entries):
        matrix = entries.reshape(3, 3)
        R = np.eye(3)
        for step in so3.exp(turn.increments @ matrix.T):
            R = R @ step
        return R.T @ up[turn.first]

    rows = _rows(turn, up, accel, np.eye(3), len(positions))
    at = predicted(np.eye(3).ravel())
    across = so3.numerical_jacobian(predicted, np.eye(3).ravel(), 1e-6)
    ours = np.linalg.norm(rows.jacobian, axis=0)  # in a basis across the direction, whose length is the same
    np.testing.assert_allclose(ours, np.linalg.norm(across - np.outer(at, at @ across), axis=0), rtol=0.02, atol=0.01)


def test_the_biases_of_both_rests_turn_the_prediction_by_numerical_slopes():
    _, t, rate, positions, accel = handled(2)
    up = _directions(positions, accel)
    turn = _turns(t, rate, positions, up)[3]
    k = turn.first

    def predicted(biases):
        moved = list(positions)
        for i, by in enumerate(np.split(biases, 2)):
            moved[k + i] = replace(moved[k + i], rate=moved[k + i].rate + by)
        R = np.eye(3)
        for step in so3.exp(_turns(t, rate, moved, up)[3].increments):
            R = R @ step
        return R.T @ up[k]

    sources = _rows(turn, up, accel, np.eye(3), len(positions)).sources
    ours = np.linalg.norm(sources[:, np.r_[6 * k + 3 : 6 * k + 6, 6 * k + 9 : 6 * k + 12]], axis=0)
    at, slopes = predicted(np.zeros(6)), so3.numerical_jacobian(predicted, np.zeros(6), 1e-6)
    across = slopes - np.outer(at, at @ slopes)  # in a basis across the direction, whose length is the same
    np.testing.assert_allclose(ours, np.linalg.norm(across, axis=0), rtol=0.02, atol=0.01)


def test_few_turns_are_refused():
    _, t, rate, positions, accel = handled(3)
    with pytest.raises(FitError, match="between resting positions: too few"):
        fit_gyro_matrix(t, rate, positions[:5], accel, DENSITY)


def test_a_bias_that_is_hardly_known_makes_the_matrix_hardly_known():
    _, t, rate, positions, accel = handled(4)
    sure = fit_gyro_matrix(t, rate, positions, accel, DENSITY)
    unsure = [replace(p, rate_covariance=(0.05 * DEG) ** 2 * np.eye(3)) for p in positions]
    fit = fit_gyro_matrix(t, rate, unsure, accel, DENSITY)
    # a turn of 90 deg in 2 s: 0.05 deg/s over it, averaged over two rests, is 0.07 deg of 90
    assert np.median(fit.sigma) > 2.0 * np.median(sure.sigma)
    assert 2e-4 < np.median(fit.sigma) < 2e-3
