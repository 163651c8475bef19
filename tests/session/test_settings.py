"""session.toml: what is read, and that every slip is answered with file, key and remedy."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from smoother.config import SessionConfig
from smoother.errors import ConfigError
from smoother.session.settings import DIRECTIONS, load_settings, rotation_from_axes


def read(directory: Path, text: str) -> SessionConfig:
    path = directory / "session.toml"
    path.write_text(text, encoding="utf-8")
    return load_settings(path)


def test_an_empty_file_states_nothing(tmp_path: Path) -> None:
    assert read(tmp_path, "") == SessionConfig()


def test_every_key_of_the_contract_is_read(tmp_path: Path) -> None:
    config = read(
        tmp_path,
        """
        [session]
        title = "Heat 2"
        driver = "N. N."
        kart = "7"
        track = "adria.json#north"
        date = 2024-05-31
        notes = "<b>damp</b>"
        [mounting]
        lever_arm_b = [-0.4, 0, 0.3]
        axes = "right-forward-up"
        [imu]
        accel_noise = 0.5
        gyro_noise = 5e-2
        accel_bias_walk = 1e-3
        gyro_bias_walk = 1e-4
        delay = 0.0059
        [gps]
        position_latency = 0.1
        velocity_latency = 0.2
        [magnetometer]
        use = false
        declination_deg = -3.5
        """,
    )
    assert (config.title, config.track, config.date) == ("Heat 2", "adria.json#north", "2024-05-31")
    assert config.notes == "<b>damp</b>"
    np.testing.assert_array_equal(config.mounting.lever_arm_b, [-0.4, 0.0, 0.3])
    np.testing.assert_array_equal(config.mounting.R_bs, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    assert (config.imu.accel_noise, config.imu.gyro_bias_walk) == (0.5, 1e-4)
    assert config.imu_delay == 0.0059
    assert (config.gps.position_latency, config.gps.velocity_latency) == (0.1, 0.2)
    assert config.magnetometer.use is False and config.magnetometer.declination_deg == -3.5


@pytest.mark.parametrize("date", ['"2024-05-31"', '"2024-05-31T10:00:00"', "2024-05-31T10:00:00Z"])
def test_a_date_may_be_a_text_or_a_toml_date(tmp_path: Path, date: str) -> None:
    assert read(tmp_path, f"[session]\ndate = {date}").date == "2024-05-31"


def test_all_24_right_handed_sets_of_axes_are_rotations_and_no_other_is_accepted() -> None:
    words = ["forward", "back", "left", "right", "up", "down"]
    accepted = []
    for axes in itertools.product(words, repeat=3):
        try:
            accepted.append(rotation_from_axes("-".join(axes)))
        except ValueError:
            continue
    assert len(accepted) == 24
    assert len({R.tobytes() for R in accepted}) == 24
    for R_bs in accepted:
        np.testing.assert_array_equal(R_bs @ R_bs.T, np.eye(3))
        assert np.linalg.det(R_bs) == pytest.approx(1.0)


def test_each_word_is_where_that_sensor_axis_points_in_the_body() -> None:
    R_bs = rotation_from_axes("left-up-forward")
    for axis, word in enumerate(("left", "up", "forward")):
        np.testing.assert_array_equal(R_bs @ np.eye(3)[axis], DIRECTIONS[word])


def test_a_matrix_typed_with_few_decimals_becomes_the_nearest_rotation(tmp_path: Path) -> None:
    config = read(tmp_path, "[mounting]\nR_bs = [[0.88, 0, 0.47], [0, 1, 0], [-0.47, 0, 0.88]]")
    R_bs = config.mounting.R_bs
    assert R_bs is not None
    np.testing.assert_allclose(R_bs @ R_bs.T, np.eye(3), atol=1e-12)
    assert R_bs[0, 2] == pytest.approx(np.sin(np.arctan2(0.47, 0.88)))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[imu]\naccel_nose = 1", r"\[imu\] accel_nose is unknown \(did you mean accel_noise\?\)"),
        ("[Mounting]\n", r"Mounting is unknown \(did you mean mounting\?\)"),
        ("[mounting]\nr_bs = 1", r"\[mounting\] r_bs is unknown \(did you mean R_bs\?\)"),
        ("titel = 3", r"titel is unknown"),
        ("session = 3", r"session is not a table; write \[session\]"),
        ("[session]\ntitle = 3", r"\[session\] title must be a text"),
        ("[session]\ndate = 'May'", r"date must be a date as"),
        ("[imu]\naccel_noise = 'x'", r"accel_noise must be a finite number"),
        ("[imu]\naccel_noise = true", r"accel_noise must be a finite number"),
        ("[imu]\naccel_noise = 0", r"must be greater than zero"),
        ("[imu]\naccel_noise = nan", r"must be a finite number"),
        ("[imu]\ndelay = 5.9", r"within 0 and 0.2 s; it is in seconds"),
        ("[imu]\ndelay = -0.01", r"within 0 and 0.2 s"),
        ("[gps]\nposition_latency = 100", r"it is in seconds"),
        ("[magnetometer]\nuse = 1", r"use must be true or false"),
        ("[magnetometer]\ndeclination_deg = 400", r"must lie within 180"),
        ("[mounting]\nlever_arm_b = [1, 2]", r"must be 3 finite numbers"),
        ("[mounting]\nlever_arm_b = ['1', '2', '3']", r"must be 3 finite numbers"),
        ("[mounting]\nlever_arm_b = [400, 0, 0]", r"it is in metres"),
        ("[mounting]\nlever_arm_b = [1e200, 0, 0]", r"it is in metres"),
        ("[mounting]\nR_bs = [[1, 0], [0, 1]]", r"must be 3 x 3 finite numbers"),
        ("[mounting]\nR_bs = [[1, 0, 0], [0, 1, 0], [0, 0, 2]]", r"is no rotation"),
        ("[mounting]\nR_bs = [[1, 0, 0], [0, 1e200, 0], [0, 0, 1]]", r"is no rotation"),
        ("[mounting]\nR_bs = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]", r"mirrors"),
        ("[mounting]\naxes = 'forward-left-down'", r"is left-handed"),
        ("[mounting]\naxes = 'forward-back-up'", r"at right angles"),
        ("[mounting]\naxes = 'forward-lef-up'", r"'lef' is no direction \(did you mean left\?\)"),
        ("[mounting]\naxes = 'forward-left'", r"has 2 directions"),
        ("[mounting]\naxes = 'forward-left-up'\nR_bs = [[1,0,0],[0,1,0],[0,0,1]]", r"say the same thing twice"),
        ("[imu\n", r"not valid TOML"),
    ],
)
def test_every_mistake_is_one_line_with_file_and_key(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message) as error:
        read(tmp_path, text)
    assert str(error.value).startswith("session.toml: ") and "\n" not in str(error.value)


def test_bytes_that_are_no_text_are_one_clear_error(tmp_path: Path) -> None:
    path = tmp_path / "session.toml"
    path.write_bytes(b"[session]\n\ndriver = 'J\xfcrgen'\n")
    with pytest.raises(ConfigError, match=r"^session.toml: line 3 is not in UTF-8; save it as UTF-8$"):
        load_settings(path)


@pytest.mark.parametrize("key", ["accel_noise", "gyro_noise", "accel_bias_walk", "gyro_bias_walk"])
@pytest.mark.parametrize("value", [1e300, 1e-300, 1e5])
def test_a_density_of_no_sensor_is_refused(tmp_path: Path, key: str, value: float) -> None:
    (tmp_path / "session.toml").write_text(f"[imu]\n{key} = {value}\n")
    with pytest.raises(ConfigError, match=rf"\[imu\] {key} must lie within 1e-12 and 1000"):
        load_settings(tmp_path / "session.toml")
