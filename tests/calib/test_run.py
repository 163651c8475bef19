"""Everything that a recording offers, from its files to the calibration."""

from pathlib import Path

import numpy as np
import pytest

from calib.allan import _values
from calib.recording import load_recording
from calib.run import RunOptions, run
from smoother import so3
from smoother.calibration import load_calibration, save_calibration
from smoother.fit.allan import NoiseFigures
from smoother.frames import Origin
from smoother.session.settings import load_settings
from smoother.sim.record import write_csv
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG


@pytest.fixture(scope="module")
def results(handled):
    return run([load_recording(handled.directory)], RunOptions(place=Origin(45.0, 12.0, 0.0)))


def within(found, true, sigma, times=4.5):
    assert np.all(np.abs(np.asarray(found) - true) < times * np.asarray(sigma)), (found, true, sigma)


def test_every_value_of_a_handled_logger_comes_back_within_its_sigma(handled, results):
    found, truth = results.calibration, handled.bench.truth
    within(found.accel_offset, truth.accel_offset, found.sigmas["accel_offset"])
    within(found.accel_matrix, truth.accel_matrix, found.sigmas["accel_matrix"])
    within(found.gyro_matrix, truth.gyro_matrix, found.sigmas["gyro_matrix"])
    within(found.gyro_bias_slope, handled.bench.errors.gyro_slope, found.sigmas["gyro_bias_slope"])
    within(found.hard_iron, truth.hard_iron, found.sigmas["hard_iron"])
    to_accel = truth.accel_matrix @ handled.bench.imu_errors.accel_matrix
    within(found.soft_iron, so3.normalized(to_accel) @ truth.soft_iron, found.sigmas["soft_iron"])
    assert np.max(found.sigmas["accel_offset"]) < 0.005
    assert np.max(found.sigmas["gyro_matrix"]) < 0.001


def test_every_comparison_is_better_after_than_before(results):
    comparisons = [comparison for outcome in results.outcomes for comparison in outcome.comparisons]
    assert len(comparisons) >= 5
    for comparison in comparisons:
        assert comparison.after < 0.2 * comparison.before, comparison


def test_each_procedure_ran_and_nothing_was_refused(results):
    assert [outcome.procedure for outcome in results.outcomes] == [
        "timing and vibration",
        "gyroscope bias",
        "accelerometer",
        "gyroscope scale",
        "noise at rest",
        "magnetometer",
        "magnetometer against gyroscope",
        "level and heading",
    ]
    assert results.refusals == ()


def test_the_file_gives_the_calibration_back_and_its_noise_fits_session_toml(results, tmp_path: Path):
    path = tmp_path / "calibration.toml"
    save_calibration(path, results.calibration, results.notes)
    again = load_calibration(path)
    for name in ("accel_offset", "accel_matrix", "gyro_bias", "gyro_matrix", "gyro_bias_slope", "soft_iron"):
        np.testing.assert_allclose(getattr(again, name), getattr(results.calibration, name), rtol=1e-8, atol=1e-12)
        np.testing.assert_allclose(again.sigmas[name], results.calibration.sigmas[name], rtol=1e-8)
    assert again.gyro_temperature_span == pytest.approx(results.calibration.gyro_temperature_span)
    table = path.read_text().split("[imu]")[1].split("\n[")[0]
    (tmp_path / "session.toml").write_text("[imu]" + table)
    settings = load_settings(tmp_path / "session.toml").imu
    assert settings.gyro_noise == pytest.approx(0.01 * DEG, rel=0.05)
    assert settings.accel_noise == pytest.approx(0.004, rel=0.05)


def test_of_two_recordings_the_better_value_counts(handled, tmp_path: Path):
    """A recording of the magnetometer alone adds nothing to a better one, and takes nothing away."""
    (tmp_path / "mag.csv").write_text((handled.directory / "mag.csv").read_text())
    both = run([load_recording(tmp_path), load_recording(handled.directory)])
    assert {outcome.procedure for outcome in both.outcomes} >= {"accelerometer", "magnetometer"}
    assert both.calibration.hard_iron is not None


def test_the_first_thousand_samples_are_taken_when_asked(handled):
    recording = load_recording(handled.directory)
    found = run([recording], RunOptions(first_samples=True)).calibration
    np.testing.assert_allclose(found.gyro_bias, recording.rate[:1000].mean(axis=0))


def test_laps_alone_calibrate_no_magnetometer(tmp_path: Path):
    write_csv(simulate_preset("kart", 2, duration=90.0), tmp_path)
    results = run([load_recording(tmp_path)])
    outcomes = {outcome.procedure: outcome for outcome in results.outcomes}
    assert results.calibration.hard_iron is None  # the smoother fits it to the session
    assert "accelerometer" not in outcomes
    reasons = {refusal.procedure: refusal.reason for refusal in results.refusals}
    assert "on a bench" in reasons["accelerometer"]
    assert all("\n" not in reason for reason in reasons.values())


def test_bounds_of_noise_that_was_not_seen_are_written_out():
    zero, seen = np.zeros((3, 3)), np.ones((3, 3), dtype=bool)
    seen[:2, 2] = False
    figures = NoiseFigures(zero, zero, np.full((3, 3), 8.0e-5), seen, np.zeros((3, 3, 3)))
    assert _values("accelerometer", figures, 1.0, "m/s²")[2].note == "not seen on x, y: at most 0.000080, 0.000080"
