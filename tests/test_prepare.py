"""From RawSession to Session: the origin of n, and which calibration wins."""

from pathlib import Path

import numpy as np
import pytest

from smoother.errors import ConfigError, SessionError
from smoother.frames import Origin
from smoother.prepare import choose_origin, prepare
from smoother.samples import GnssFixes, RawImu, RawMag, RawSession

N = 20
LAT, LON = 45.0 + 1e-5 * np.arange(N), 12.0 - 1e-5 * np.arange(N)


def fixes(lat: np.ndarray = LAT, lon: np.ndarray = LON, alt: float | np.ndarray = 30.0, **columns) -> GnssFixes:
    n = len(lat)
    return GnssFixes(np.arange(n) * 0.2, lat, lon, np.broadcast_to(alt, n), np.zeros((n, 3)), **columns)


def ball(centre: np.ndarray, matrix: np.ndarray, n: int = 400) -> np.ndarray:
    """Readings (n, 3) of a magnetometer turned in every direction."""
    direction = np.random.default_rng(0).normal(size=(n, 3))
    return direction / np.linalg.norm(direction, axis=1, keepdims=True) @ matrix.T + centre


def test_a_single_fix_is_no_session() -> None:
    with pytest.raises(SessionError, match=r"^lone: only one usable fix"):
        prepare(RawSession("lone", fixes(LAT[:1], LON[:1])))


@pytest.mark.parametrize(("decimals", "steps"), [(0, "111195 m"), (2, "1112 m"), (3, "111 m"), (4, ""), (7, "")])
def test_positions_of_too_few_digits_are_refused(decimals: int, steps: str) -> None:
    lat, lon = np.round(45.0 + np.arange(50) / 9e3, decimals), np.round(12.0 + np.arange(50) / 7e3, decimals)
    raw = RawSession("coarse", fixes(lat, lon))
    if not steps:
        prepare(raw)
        return
    with pytest.raises(
        SessionError, match=f"^coarse: positions have {decimals} decimals of a degree, steps of {steps}"
    ):
        prepare(raw)


def test_the_origin_is_the_first_fix() -> None:
    assert choose_origin(fixes()) == Origin(45.0, 12.0, 30.0)


def test_fixes_the_receiver_itself_distrusts_do_not_place_the_origin() -> None:
    sigma = np.r_[np.full(3, 50.0), np.full(N - 3, 2.0)]
    assert choose_origin(fixes(sigma_horizontal=sigma)).lat_deg == LAT[3]
    assert choose_origin(fixes(sigma_horizontal=np.full(N, 50.0))).lat_deg == LAT[0]


def test_a_first_fix_in_another_country_is_passed_over() -> None:
    lat = LAT.copy()
    lat[0] = 50.0
    assert choose_origin(fixes(lat)).lat_deg == LAT[1]
    lon = LON.copy()
    lon[0] = 0.0
    assert choose_origin(fixes(LAT, lon)).lat_deg == LAT[1]


def test_a_distant_fix_that_claims_to_be_good_does_not_beat_a_near_one() -> None:
    lat = LAT.copy()
    lat[0] = 50.0
    sigma = np.r_[1.0, np.full(N - 1, 30.0)]
    assert choose_origin(fixes(lat, sigma_horizontal=sigma)).lat_deg == LAT[1]


def test_an_unknown_height_of_the_origin_is_the_usual_one() -> None:
    alt = np.r_[np.nan, np.full(N - 1, 12.0)]
    assert choose_origin(fixes(alt=alt)).alt_m == 12.0
    assert choose_origin(fixes(alt=np.full(N, np.nan))).alt_m == 0.0


def test_a_session_without_a_fix_ends_in_one_clear_line() -> None:
    with pytest.raises(SessionError, match="morning: no usable GPS fix"):
        prepare(RawSession("morning", fixes(np.empty(0), np.empty(0))))


def test_the_field_of_magcalib_calibrates_the_magnetometer() -> None:
    centre, matrix = np.array([20.0, -5.0, 8.0]), np.diag([45.0, 50.0, 55.0])
    readings = ball(centre, matrix)
    mag = RawMag(np.arange(len(readings)) * 0.1, readings)
    session = prepare(RawSession("s", fixes(), mag=mag, mag_calibration_field=readings))
    assert session.mag is not None
    assert session.mag.is_calibrated
    np.testing.assert_allclose(np.linalg.norm(session.mag.field_s, axis=1), 1.0, atol=1e-6)
    assert session.problems == ()


def test_a_calibration_file_wins_over_magcalib(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text(
        "[magnetometer]\nhard_iron = [1.0, 2.0, 3.0]\nsoft_iron = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", encoding="utf-8"
    )
    readings = ball(np.array([20.0, -5.0, 8.0]), 50.0 * np.eye(3))
    mag = RawMag(np.arange(len(readings)) * 0.1, readings)
    session = prepare(RawSession("s", fixes(), mag=mag, mag_calibration_field=readings), path)
    assert session.mag is not None
    np.testing.assert_allclose(session.mag.field_s, readings - [1.0, 2.0, 3.0])


def test_a_useless_magcalib_is_a_problem_and_not_the_end() -> None:
    mag = RawMag(np.arange(3.0), np.ones((3, 3)))
    session = prepare(RawSession("s", fixes(), mag=mag, mag_calibration_field=np.ones((50, 3))))
    assert session.mag is not None
    assert not session.mag.is_calibrated
    assert [p.code for p in session.problems] == ["magcalib_unusable"]


def test_a_flawed_calibration_file_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text("[gyroscope]\nbias = 3\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"calibration\.toml"):
        prepare(RawSession("s", fixes()), path)


def test_a_session_names_its_calibration(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text("[gyroscope]\nbias = [0.1, 0.2, 0.3]\n", encoding="utf-8")
    readings = ball(np.array([20.0, -5.0, 8.0]), 50.0 * np.eye(3))
    mag = RawMag(np.arange(len(readings)) * 0.1, readings)
    imu = RawImu(np.arange(5.0), np.zeros((5, 3)), np.zeros((5, 3)))
    session = prepare(RawSession("s", fixes(), imu=imu, mag=mag, mag_calibration_field=readings), path)
    sources = {value.quantity: value.source for value in session.calibration}
    assert sources == {
        "gyro_bias": "calibration.toml",
        "hard_iron": "magcalib.txt",
        "soft_iron": "magcalib.txt",
    }


def test_a_calibration_of_another_logger_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text(
        "[magnetometer]\nhard_iron = [0.0, 0.0, 0.0]\nsoft_iron = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n", encoding="utf-8"
    )
    readings = ball(np.array([20.0, -5.0, 8.0]), 50.0 * np.eye(3))
    session = prepare(RawSession("s", fixes(), mag=RawMag(np.arange(len(readings)) * 0.1, readings)), path)
    assert [p.code for p in session.problems] == ["mag_calibration_misfit"]
