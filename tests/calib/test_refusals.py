"""Degenerate recordings are refused, each by one clear sentence that says what to do."""

from dataclasses import replace

import numpy as np
import pytest

from calib import allan, ellipsoid, gyro_bias, level, six_position, timing
from calib.recording import Recording, load_recording
from calib.run import run
from smoother.calibration import Calibration
from smoother.errors import SessionError
from smoother.fit.ellipsoid import FitError
from smoother.samples import RawImu, RawMag


def imu_of(accel, gyro=None):
    accel = np.asarray(accel, dtype=float)
    t = np.arange(len(accel)) / 100.0
    return RawImu(t, accel, np.zeros_like(accel) if gyro is None else gyro)


def mag_of(field):
    return Recording("m", mag=RawMag(np.arange(len(field)) / 40.0, field))


def sphere(n=3000, rng=None):
    direction = (np.random.default_rng(1) if rng is None else rng).normal(size=(n, 3))
    return 48.0 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [10.0, 20.0, -5.0]


@pytest.mark.parametrize(
    ("field", "says"),
    [
        (sphere()[:3], "3 points are too few"),
        (np.ones((500, 3)), "constant"),
        (sphere() * [1.0, 1.0, 0.0], "one plane"),
        (np.where(np.arange(9000).reshape(3000, 3) == 5, np.nan, sphere()), "not finite"),
        (np.minimum(sphere(), 30.0), "saturated"),
    ],
    ids=["three", "constant", "plane", "nan", "saturated"],
)
def test_degenerate_magnetometers(field, says):
    with pytest.raises(FitError, match=says) as error:
        ellipsoid.calibrate(mag_of(field))
    assert "\n" not in str(error.value)


def test_a_half_covered_sphere_is_refused_with_the_sides_to_turn():
    field = sphere()
    field = field[field[:, 2] > 15.0] + 0.2 * np.random.default_rng(2).normal(size=(np.sum(field[:, 2] > 15.0), 3))
    with pytest.raises(FitError, match=r"cover only .* % of the sphere; turn the sides .*-z.* to the ground"):
        ellipsoid.calibrate(mag_of(field))


def test_without_a_sensor_each_procedure_names_the_missing_one():
    nothing = Recording("empty")
    for procedure in (gyro_bias.calibrate, six_position.calibrate, timing.calibrate):
        with pytest.raises(FitError, match="no motion sensor"):
            procedure(nothing)
    with pytest.raises(FitError, match="no magnetometer"):
        ellipsoid.calibrate(nothing)
    for against in (allan.calibrate, level.calibrate):
        with pytest.raises(FitError, match="no motion sensor"):
            against(nothing, Calibration())


def test_a_logger_that_never_lay_still_has_no_bias_but_a_remedy():
    rng = np.random.default_rng(3)
    recording = Recording("waved", imu_of(rng.normal(0.0, 9.0, (3000, 3)), rng.normal(0.0, 2.0, (3000, 3))))
    for procedure in (gyro_bias.calibrate, six_position.calibrate):
        with pytest.raises(FitError, match="lay"):
            procedure(recording)


def test_a_short_rest_is_no_allan_deviation():
    still = np.tile([0.0, 0.0, 9.8], (3000, 1)) + 0.01 * np.random.default_rng(4).normal(size=(3000, 3))
    with pytest.raises(FitError, match=r"the longest rest is .* s, too short"):
        allan.calibrate(Recording("still", imu_of(still, 0.001 * still)), Calibration())


def test_a_dead_sensor_is_refused():
    dead = Recording("dead", imu_of(np.tile([0.0, 0.0, 9.8], (20000, 1))))
    with pytest.raises(FitError, match="never change"):
        allan.calibrate(dead, Calibration())


def test_a_folder_without_a_sensor_is_an_error(tmp_path):
    with pytest.raises(SessionError, match="nothing to calibrate from"):
        load_recording(tmp_path)


def test_every_refusal_of_a_run_is_one_sentence():
    results = run([Recording("dead", replace(imu_of(np.ones((3000, 3))), temperature=np.full(3000, 25.0)))])
    assert results.refusals
    assert all("\n" not in refusal.reason and refusal.reason for refusal in results.refusals)
