"""Real files of loggers and cameras, and sessions with faults that people reported: what is read of them is right."""

import struct
from pathlib import Path

import numpy as np
import pytest

from smoother import api
from smoother.arrays import Array
from smoother.cli.pipeline import calibrated, read
from smoother.errors import SessionError
from smoother.laps.analysis import analyse
from smoother.laps.stage import Stated, fix_path, options_on
from smoother.laps.tracks import TrackFile, line_from_text
from smoother.samples import Session
from smoother.session.load import load_raw
from smoother.session.readers.gopro import streams_in
from smoother.trajectory import Trajectory
from smoother.units import DEG

SONOMA_LINE = line_from_text("38.16140,-122.45462;38.16168,-122.45462")
LATITUDE, WEST, EAST = 52.12, -17.41, 17.41
FIRST_FIX = 4.730  # s after the log began; its first fix has time zero
CASES = {  # fixes that are read, longitude
    "aim_rs3_kart": (3896, EAST),
    "course_flat_degrees/session.csv": (1949, WEST),
    "degrees_hemisphere_columns": (1949, WEST),
    "degrees_hemisphere_nocourse": (1949, WEST),
    "degrees_letters": (1949, WEST),
    "gopro_csv_folder": (1449, WEST),
    "gpx_whole_seconds_10hz": (1949, EAST),
    "harry_en": (1949, WEST),
    "imu_raw_lsb": (1449, EAST),
    "kml_gxtrack": (1949, WEST),
    "position_jump_25m_named": (975, EAST),
    "position_jump_25m_nocourse/session.csv": (975, EAST),
    "quoted_comma_note": (1949, WEST),
    "racecapture_log": (1449, WEST),
    "sensorlogger_folder": (1449, EAST),
    "time_ms_column": (1949, EAST),
    "time_ymdhms_columns": (1949, EAST),
    "vbo_colon_time": (1949, WEST),
}


def smoothed(directory: Path) -> tuple[Session, Trajectory]:
    session = calibrated(read(directory), directory)
    return session, api.smooth(session)


def lap_times(session: Session, trajectory: Trajectory, *tracks: TrackFile) -> list[float]:
    laps = analyse(trajectory, fix_path(session), options_on(trajectory, session.origin, Stated(tracks))).laps
    return [lap.time for lap in laps if lap.is_timed]


@pytest.mark.parametrize("name", CASES)
def test_a_case_is_read_at_its_place_at_its_speed(data_directory: Path, name: str) -> None:
    fixes, longitude = CASES[name]
    period = {3896: 0.05, 975: 0.2}.get(fixes, 0.1)  # AiM's own program writes 20 rows for 10 fixes
    raw = load_raw(data_directory / "cases" / name)
    assert len(raw.gnss) == fixes
    assert np.median(raw.gnss.lat_deg) == pytest.approx(LATITUDE, abs=0.01)
    assert np.median(raw.gnss.lon_deg) == pytest.approx(longitude, abs=0.01)
    assert np.median(np.diff(raw.gnss.t)) == pytest.approx(period, abs=0.001)
    if "_gxtrack" not in name and "gpx" not in name:  # which have no speeds
        assert np.nanmax(raw.gnss.speed) * 3.6 == pytest.approx(114.0, abs=2.0)


def test_positions_of_two_decimals_are_refused(data_directory: Path) -> None:
    with pytest.raises(SessionError, match="decimals"):
        load_raw(data_directory / "cases" / "degrees_two_decimals")


def test_an_aim_log_is_the_same_drive_as_its_table(data_directory: Path) -> None:
    log = load_raw(data_directory / "aim_xrk_adria_first_half")
    table = load_raw(data_directory / "kart_adria_first_half")
    assert log.imu is not None and table.imu is not None
    same = slice(0, 500)  # then a sample is missing in the table
    np.testing.assert_allclose(log.imu.accel[same], table.imu.accel[same], atol=1e-3)
    np.testing.assert_allclose(log.imu.gyro[same], table.imu.gyro[same], atol=1e-4)
    rows = np.append(0, np.arange(2, len(log.gnss) + 1))  # one fix has a wrong time in the log
    np.testing.assert_allclose(log.gnss.lat_deg, table.gnss.lat_deg[rows], atol=1e-7)
    fast = table.gnss.speed[rows] > 3.0
    apart = course(log.gnss.velocity_n) - course(table.gnss.velocity_n[rows])
    np.testing.assert_allclose(np.angle(np.exp(1j * apart[fast][1:])) / DEG, 0.0, atol=0.2)  # none before a step back


def course(velocity_n: Array) -> Array:
    return np.arctan2(-velocity_n[:, 1], velocity_n[:, 0])


def test_an_aim_log_gives_its_beacon_laps_and_the_trajectory_of_its_table(data_directory: Path) -> None:
    session, found = smoothed(data_directory / "aim_xrk_adria_first_half")
    times = lap_times(session, found)
    assert times[-4:] == pytest.approx([53.070, 52.207, 50.968, 49.828], abs=0.05)
    _, table = smoothed(data_directory / "kart_adria_first_half")
    rows = (table.t > table.t[0] + 15.0) & (table.t < found.t[-1] + FIRST_FIX)
    at = table.t[rows] - FIRST_FIX
    assert found.sigmas is not None and table.sigmas is not None
    for name in ("position_n", "velocity_n"):
        for axis in range(2):
            ours, sigma = (np.interp(at, found.t, getattr(of, name)[:, axis]) for of in (found, found.sigmas))
            apart = ours - getattr(table, name)[rows, axis]
            both = np.hypot(sigma, getattr(table.sigmas, name)[rows, axis])
            assert np.percentile(np.abs(apart - np.median(apart)) / both, 95) < 2.0


def test_a_racecapture_log_gives_the_laps_of_its_own_counter(data_directory: Path) -> None:
    session, found = smoothed(data_directory / "racecapture_sonoma")
    assert not {"imu_axes_disagree", "imu_mirrored"} & {problem.code for problem in found.report.problems}
    times = lap_times(session, found, SONOMA_LINE)
    assert times == pytest.approx([128.1, 126.3, 127.8, 126.4, 127.9, 130.6, 126.8], abs=0.15)


@pytest.mark.parametrize(
    ("name", "lat", "lon", "gps"), [("hero7", 42.34258, -8.75261, "GPS5"), ("hero11", 42.42615, -8.64998, "GPS9")]
)
def test_the_streams_of_a_camera(data_directory: Path, name: str, lat: float, lon: float, gps: str) -> None:
    data = (data_directory / f"gopro_{name}_raw" / f"{name}.raw").read_bytes()
    size, repeat = struct.unpack(">BH", data[5:8])
    streams = dict(streams_in(np.frombuffer(data[: 8 + -(-size * repeat // 4) * 4], "<u4")))
    assert {"ACCL", "GYRO", gps} <= set(streams)
    assert np.mean(np.linalg.norm(streams["ACCL"], axis=1)) == pytest.approx(9.8, abs=1.0)
    np.testing.assert_allclose(streams[gps][:, :2], [[lat, lon]] * len(streams[gps]), atol=2e-5)


def test_a_video_without_gps_is_refused_with_a_remedy(data_directory: Path) -> None:
    with pytest.raises(SessionError, match=r"^karma\.mp4: no GPS in it, .*; switch the GPS on"):
        load_raw(data_directory / "gopro_karma")
