"""Calibration: what it does to samples, and the file it is read from."""

import tomllib
from pathlib import Path

import numpy as np
import pytest

from smoother.calibration import Calibration, load_calibration, merged, save_calibration
from smoother.errors import ConfigError
from smoother.frames import Origin
from smoother.samples import GnssFixes, Problem, RawImu, RawMag, RawSession
from smoother.units import DEG, STANDARD_GRAVITY

RNG = np.random.default_rng(0)
T = np.arange(5) * 0.01
COUNTS = RNG.integers(-30000, 30000, (5, 3)).astype(float)
CROOKED = np.eye(3) + 0.05 * RNG.normal(size=(3, 3))
FIXES = GnssFixes([0.0], [45.0], [12.0], [0.0], np.zeros((1, 3)))

TEXT = """
[accelerometer]
offset = [0.1, -0.2, 0.3]
matrix = [[1.01, 0.0, 0.0], [0.0, 0.99, 0.001], [0.0, 0.0, 1.0]]
[gyroscope]
bias = [0.01, 0.02, -0.03]
[magnetometer]
hard_iron = [10.0, 20.0, 30.0]
soft_iron = [[0.02, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.02]]
"""


def written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "calibration.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_values_only_the_scale_is_applied() -> None:
    raw = RawImu(T, COUNTS, COUNTS, STANDARD_GRAVITY / 16384.0, DEG / 131.0, 2.0 * STANDARD_GRAVITY, 250.0 * DEG)
    imu = Calibration().apply_to_imu(raw)
    np.testing.assert_allclose(imu.specific_force_s, COUNTS / 16384.0 * STANDARD_GRAVITY)
    np.testing.assert_allclose(imu.angular_rate_s, COUNTS / 131.0 * DEG)
    np.testing.assert_array_equal(imu.t, T)
    assert imu.accel_full_scale == 2.0 * STANDARD_GRAVITY
    assert imu.gyro_full_scale == 250.0 * DEG


def test_a_sensor_with_known_errors_reads_the_truth_again() -> None:
    true, offset, scale = RNG.normal(size=(5, 3)), np.array([0.3, -0.1, 0.2]), 0.001
    counts = (true @ np.linalg.inv(CROOKED).T + offset) / scale
    raw = RawImu(T, counts, counts, scale, scale)
    calibration = Calibration(offset, CROOKED, offset, CROOKED)
    np.testing.assert_allclose(calibration.apply_to_imu(raw).specific_force_s, true, atol=1e-12)
    np.testing.assert_allclose(calibration.apply_to_imu(raw).angular_rate_s, true, atol=1e-12)


def test_hard_and_soft_iron_bring_the_field_back_to_length_one() -> None:
    unit = RNG.normal(size=(5, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    iron = np.array([12.0, -7.0, 30.0])
    raw = RawMag(T, unit @ np.linalg.inv(CROOKED / 48.0).T + iron)
    calibrated = Calibration().with_magnetometer(iron, CROOKED / 48.0).apply_to_mag(raw)
    assert calibrated.is_calibrated
    np.testing.assert_allclose(calibrated.field_s, unit, atol=1e-12)


def test_a_magnetometer_without_calibration_keeps_its_unit() -> None:
    mag = Calibration().apply_to_mag(RawMag(T, COUNTS))
    assert not mag.is_calibrated
    np.testing.assert_array_equal(mag.field_s, COUNTS)


def test_apply_carries_everything_else_of_the_session_along() -> None:
    problem = Problem("code", "text")
    raw = RawSession("name", FIXES, inputs=("a.csv",), problems=(problem,), unix_at_zero=5.0)
    session = Calibration().apply(raw, Origin(45.0, 12.0, 0.0))
    assert (session.name, session.inputs, session.problems, session.unix_at_zero) == (
        "name",
        ("a.csv",),
        (problem,),
        5.0,
    )
    assert session.gnss is FIXES
    assert session.imu is None
    assert session.mag is None
    full = Calibration().apply(
        RawSession("name", FIXES, RawImu(T, COUNTS, COUNTS), RawMag(T, COUNTS)), Origin(45.0, 12.0, 0.0)
    )
    assert full.imu is not None
    assert full.mag is not None


def test_values_are_read_only_and_their_shapes_checked() -> None:
    with pytest.raises(ValueError, match="read-only"):
        Calibration().accel_offset[0] = 1.0
    with pytest.raises(ValueError, match="gyro_matrix has shape"):
        Calibration(gyro_matrix=np.eye(2))
    with pytest.raises(ValueError, match="hard_iron has shape"):
        Calibration(hard_iron=np.zeros(2), soft_iron=np.eye(3))


def test_hard_iron_without_soft_iron_is_refused() -> None:
    with pytest.raises(ValueError, match="come together"):
        Calibration(hard_iron=np.zeros(3))


def test_a_file_is_read_and_what_it_leaves_out_changes_nothing(tmp_path: Path) -> None:
    found = load_calibration(written(tmp_path, TEXT))
    np.testing.assert_array_equal(found.accel_offset, [0.1, -0.2, 0.3])
    np.testing.assert_array_equal(found.accel_matrix[1], [0.0, 0.99, 0.001])
    np.testing.assert_array_equal(found.gyro_bias, [0.01, 0.02, -0.03])
    np.testing.assert_array_equal(found.gyro_matrix, np.eye(3))
    np.testing.assert_array_equal(found.hard_iron, [10.0, 20.0, 30.0])
    np.testing.assert_array_equal(found.soft_iron, 0.02 * np.eye(3))


def test_an_empty_file_changes_nothing(tmp_path: Path) -> None:
    found = load_calibration(written(tmp_path, ""))
    np.testing.assert_array_equal(found.accel_matrix, np.eye(3))
    assert found.hard_iron is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[accelerometer", "calibration.toml: not valid TOML"),
        ("gyroscope = 3", r"calibration.toml: gyroscope is not a table; write \[gyroscope\]"),
        ("[gyroscope]\nbias = [1.0, 2.0]", r"\[gyroscope\] bias must be 3 finite numbers"),
        ("[gyroscope]\nbias = 'zero'", r"\[gyroscope\] bias must be 3 finite numbers"),
        ("[gyroscope]\nbias = [0.0, 0.0, nan]", r"\[gyroscope\] bias must be 3 finite numbers"),
        ("[accelerometer]\nmatrix = [[1.0], [2.0]]", r"\[accelerometer\] matrix must be 3 x 3 finite numbers"),
        ("[accelerometer]\nmatrix = [[1, 0, 0], [0, 1], [0, 0, 1]]", r"matrix must be 3 x 3 finite numbers"),
        ("[magnetometer]\nhard_iron = [1.0, 2.0, 3.0]", "needs both hard_iron and soft_iron"),
        (
            "[gyroscope]\nbais = [1.0, 2.0, 3.0]",
            r"\[gyroscope\] bais is unknown \(did you mean bias\?\); known: bias",
        ),
        (
            "[accelerometer]\nbias = [1, 2, 3]",
            r"\[accelerometer\] bias is unknown; known: offset, offset_sigma, ",
        ),
        ("[gyroscope.old]\nbias = [1, 2, 3]", r"\[gyroscope\] old is unknown"),
        (
            "[Gyroscope]\n",
            r"Gyroscope is unknown \(did you mean gyroscope\?\); known tables: accelerometer",
        ),
        ("[acelerometer]\nscale = 2", r"acelerometer is unknown \(did you mean accelerometer\?\)"),
        ("[gyro]\nbias = [1, 2, 3]", r"gyro is unknown; known tables"),
        ("bias = [1, 2, 3]", r"bias is unknown; known tables"),
    ],
)
def test_a_flawed_file_is_named_with_the_key_and_the_remedy(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_calibration(written(tmp_path, text))


def test_what_is_for_people_is_passed_over(tmp_path: Path) -> None:
    notes = "[gyroscope]\nnote = 'of May'\nrest_s = 60.0\nturns = 6\n[mine]\nbox = 7\n[imu]\ngyro_noise = 1e-4\n"
    unused = "[magnetometer_in_kart]\nhard_iron = [1.0, 2.0, 3.0]\nassumed = ['up']\n[allan.gyroscope]\nturns = 1\n"
    assert not load_calibration(written(tmp_path, f"title = 'box'\nyear = 2026\n{notes}{unused}")).applied()


def test_a_file_that_is_not_text_is_not_valid(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_bytes(b"# box\n# J\xfcrgen\n")
    with pytest.raises(ConfigError, match=r"^calibration.toml: line 2 is not in UTF-8; save it as UTF-8$"):
        load_calibration(path)


def test_a_temperature_moves_the_bias_within_what_was_seen() -> None:
    slope = np.array([0.001, 0.0, -0.002])
    calibration = Calibration(
        gyro_bias=np.ones(3), gyro_bias_slope=slope, gyro_temperature=30.0, gyro_temperature_span=(25.0, 35.0)
    )
    temperature = np.array([30.0, 32.0, 50.0, np.nan, 25.0])
    raw = RawImu(T, COUNTS, np.zeros((5, 3)), temperature=temperature)
    rate = calibration.apply_to_imu(raw).angular_rate_s
    expected = -1.0 - np.array([0.0, 2.0, 5.0, 0.0, -5.0])[:, None] * slope
    np.testing.assert_allclose(rate, expected)
    np.testing.assert_allclose(calibration.apply_to_imu(RawImu(T, COUNTS, np.zeros((5, 3)))).angular_rate_s, -1.0)


def test_what_is_saved_is_what_is_loaded(tmp_path: Path) -> None:
    made = Calibration(
        accel_offset=np.array([0.1, 0.2, 1e-7]),
        gyro_bias=np.array([1.0, 2.0, 3.0]),
        gyro_bias_slope=np.array([1e-5, 0.0, 0.0]),
        gyro_temperature=31.0,
        gyro_temperature_span=(20.0, 40.0),
        sigmas={"accel_offset": np.full(3, 1e-3)},
    )
    path = tmp_path / "calibration.toml"
    save_calibration(path, made, {"imu": {"comment": "# at rest", "gyro_noise": 1e-4}, "names": {"box": 'a "b"\\'}})
    found = load_calibration(path)
    for name in ("accel_offset", "gyro_bias", "gyro_bias_slope", "gyro_temperature", "gyro_temperature_span"):
        np.testing.assert_allclose(getattr(found, name), getattr(made, name))
    np.testing.assert_allclose(found.sigmas["accel_offset"], 1e-3)
    assert found.hard_iron is None
    assert tomllib.loads(path.read_text())["names"]["box"] == 'a "b"\\'


def test_a_newer_calibration_replaces_only_what_it_determines() -> None:
    older = Calibration(accel_offset=np.ones(3), gyro_bias=np.ones(3), sigmas={"gyro_bias": np.ones(3)})
    both = merged(older, Calibration(gyro_bias=np.full(3, 2.0)))
    np.testing.assert_array_equal(both.accel_offset, 1.0)
    np.testing.assert_array_equal(both.gyro_bias, 2.0)
    assert "gyro_bias" not in both.sigmas


def test_only_what_changes_a_sensor_that_is_there_was_applied() -> None:
    calibration = Calibration(accel_offset=np.ones(3), source="calibration.toml").with_magnetometer(
        np.zeros(3), np.eye(3)
    )
    assert [value.quantity for value in calibration.applied()] == ["accel_offset", "hard_iron", "soft_iron"]
    assert [value.quantity for value in calibration.applied(has_mag=False)] == ["accel_offset"]
    assert calibration.applied(has_imu=False, has_mag=False) == ()
    assert calibration.applied()[0].source == "calibration.toml"
    assert Calibration().applied() == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[gyroscope]\nbias_per_kelvin = [0.01, 0.02, 0.03]", "needs the temperature"),
        (
            "[gyroscope]\nbias_per_kelvin = [0.01, 0.02, 0.03]\ntemperature = 'hot'",
            "temperature must be a finite number",
        ),
        ("[gyroscope]\nbias_per_kelvin = [0.01, 0.02, 0.03]\ntemperature = 5\ntemperature_span = 3", "two numbers"),
        ("[accelerometer]\noffset = [0, 0, 1]\noffset_sigma = [0.1]", "offset_sigma must be 3 finite numbers"),
        ("[accelerometer]\noffset = [0, 0, 1e200]", "offset must be 3 finite numbers"),
    ],
)
def test_flawed_temperatures_and_sigmas_are_named(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        load_calibration(written(tmp_path, text))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[accelerometer]\nmatrix = [[1, 0, 0], [0, 0, 0], [0, 0, 1]]", "stretches by 0 to 1"),
        ("[accelerometer]\nmatrix = [[0, 0, 0], [0, 0, 0], [0, 0, 0]]", "stretches by 0 to 0"),
        ("[gyroscope]\nmatrix = [[1000, 0, 0], [0, 1000, 0], [0, 0, 1000]]", "stretches by 1e"),
        ("[accelerometer]\noffset = [50, 0, 0]", "larger than 10 m/s"),
        ("[gyroscope]\nbias = [10, 0, 0]", "larger than 4 rad/s"),
        ("[gyroscope]\nbias = [true, false, true]", "must be 3 finite numbers"),
        ("[gyroscope]\nbias = ['1', '2', '3']", "must be 3 finite numbers"),
        ("[gyroscope]\nbias = [0, 0, 0]\nbias_sigma = [-1, 1, 1]", "is negative"),
        ("[magnetometer]\nhard_iron = [0, 0, 0]\nsoft_iron = [[1, 0, 0], [0, 1, 0], [0, 0, 0]]", "makes a disc"),
    ],
)
def test_values_that_no_sensor_needs_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "calibration.toml").write_text(text)
    with pytest.raises(ConfigError, match=reason):
        load_calibration(tmp_path / "calibration.toml")
