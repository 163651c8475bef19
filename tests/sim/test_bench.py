"""The simulated bench: readings that are what the truth beside them says."""

from pathlib import Path

import numpy as np

from smoother import so3
from smoother.session.beside import read_mag
from smoother.session.csv_form import read_imu
from smoother.sim.bench import BenchErrors, BenchPlan, bench_truth, simulate_bench, write_bench
from smoother.sim.scenario import ImuErrors, MagErrors
from smoother.units import STANDARD_GRAVITY

FIELD_N = np.array([22.0, -1.0, -42.0])
CROOKED = np.eye(3) + np.array([[0.01, 0.02, 0.0], [-0.01, 0.0, 0.005], [0.0, 0.01, -0.02]])


def bench(seed=0, imu=None, mag=None, **plan):
    rng = np.random.default_rng(seed)
    imu = ImuErrors(rate=100.0) if imu is None else imu
    mag = MagErrors(rate=20.0) if mag is None else mag
    return simulate_bench(imu, mag, FIELD_N, rng, BenchPlan(still=5.0, positions=8, waving=10.0, **plan))


def test_at_rest_a_perfect_logger_reads_gravity_and_no_rate():
    made = bench()
    still = ~made.is_moved
    np.testing.assert_allclose(np.linalg.norm(made.imu.accel[still], axis=1), STANDARD_GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(made.imu.gyro[still], 0.0, atol=1e-12)
    assert 0.5 < np.mean(still) < 0.9


def test_the_rates_add_up_to_the_attitudes():
    made = bench()
    R = made.R_ns[0]
    for step in so3.exp(made.imu.gyro[1:] / 100.0):
        R = R @ step
    np.testing.assert_allclose(R, made.R_ns[-1], atol=1e-9)


def test_the_field_has_its_strength_and_turns_with_the_logger():
    made = bench()
    np.testing.assert_allclose(np.linalg.norm(made.mag.field, axis=1), np.linalg.norm(FIELD_N), rtol=1e-12)
    np.testing.assert_allclose(made.mag.field[19], made.R_ns[99].T @ FIELD_N, atol=1e-9)


def test_the_truth_undoes_the_errors():
    imu = ImuErrors(rate=100.0, accel_bias=np.array([0.1, 0.2, 0.3]), accel_matrix=CROOKED, gyro_matrix=CROOKED)
    mag = MagErrors(rate=20.0, hard_iron_s=np.array([5.0, 6.0, 7.0]), soft_iron=CROOKED @ CROOKED.T)
    made = bench(imu=imu, mag=mag)
    calibrated = (made.imu.accel[~made.is_moved] - made.truth.accel_offset) @ made.truth.accel_matrix.T
    np.testing.assert_allclose(np.linalg.norm(calibrated, axis=1), STANDARD_GRAVITY, rtol=1e-12)
    unit = (made.mag.field - made.truth.hard_iron) @ made.truth.soft_iron.T
    np.testing.assert_allclose(np.linalg.norm(unit, axis=1), 1.0, rtol=1e-12)
    truth = bench_truth(imu, mag, 1.0)
    np.testing.assert_allclose(truth.accel_matrix, truth.accel_matrix.T, atol=1e-15)
    np.testing.assert_allclose(truth.gyro_matrix @ CROOKED, truth.accel_matrix @ CROOKED, atol=1e-12)


def test_warming_up_moves_the_bias_by_the_slope():
    rng = np.random.default_rng(1)
    errors = BenchErrors(gyro_slope=np.array([0.001, 0.0, -0.002]))
    plan = BenchPlan(still=200.0, positions=0, waving=0.0, warm_up=10.0)
    made = simulate_bench(ImuErrors(rate=50.0), MagErrors(rate=1.0), FIELD_N, rng, plan, errors)
    warmer = made.imu.temperature[-1] - made.imu.temperature[0]
    np.testing.assert_allclose(made.imu.gyro[-1] - made.imu.gyro[0], warmer * errors.gyro_slope, atol=2e-5)


def test_the_files_hold_the_readings(tmp_path: Path):
    made = bench()
    write_bench(made, tmp_path)
    imu, _ = read_imu(tmp_path / "imu.csv")
    mag, _ = read_mag(tmp_path / "mag.csv")
    np.testing.assert_allclose(imu.accel, made.imu.accel, atol=1e-6)
    np.testing.assert_allclose(mag.field, made.mag.field, atol=1e-4)
    assert "temp_c" in (tmp_path / "imu.csv").read_text().splitlines()[0]
