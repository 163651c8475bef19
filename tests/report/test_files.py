"""The written tables, read back by a library that did not write them."""

import csv
import datetime as dt
import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother.frames import Origin, nwu_to_geodetic, rotation_from_euler
from smoother.report import files
from smoother.report.files import replacing, to_json, write_fixes, write_trajectory
from smoother.samples import Session
from smoother.trajectory import FixResiduals, Trajectory
from smoother.units import DEG
from smoother.utc_clock import UtcClock

ORIGIN = Origin(45.0, 12.0, 30.0)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def column(path: Path, name: str) -> np.ndarray:
    return np.array([float(row[name]) for row in rows(path)])


def test_every_column_holds_its_quantity_in_its_unit(tmp_path: Path, trajectory: Trajectory) -> None:
    path = tmp_path / "trajectory.csv"
    write_trajectory(path, trajectory, ORIGIN, UtcClock(0.0, 1.7e9))
    lat, lon, alt = nwu_to_geodetic(trajectory.position_n, ORIGIN)
    half = 0.51e-4  # half of the last digit that is written
    assert trajectory.sigmas is not None
    expected = {
        "t_s": (trajectory.t, 1e-6),
        "lat_deg": (lat, 1e-9),
        "lon_deg": (lon, 1e-9),
        "alt_m": (alt, half),
        "west_m": (trajectory.position_n[:, 1], half),
        "vel_up_mps": (trajectory.velocity_n[:, 2], half),
        "speed_mps": (np.hypot(trajectory.velocity_n[:, 0], trajectory.velocity_n[:, 1]), half),
        "pitch_deg": (trajectory.euler[:, 1] / DEG, half),
        "accel_left_mps2": (trajectory.acceleration_b[:, 1], half),
        "yaw_rate_dps": (trajectory.angular_rate_b[:, 2] / DEG, half),
        "sigma_up_m": (trajectory.sigmas.position_n[:, 2], half),
        "sigma_vel_west_mps": (trajectory.sigmas.velocity_n[:, 1], half),
        "sigma_yaw_deg": (trajectory.sigmas.attitude[:, 2] / DEG, half),
        "sigma_track_m": (trajectory.sigmas.track, half),
    }
    for name, (values, tolerance) in expected.items():
        np.testing.assert_allclose(column(path, name), values, rtol=0.0, atol=tolerance, err_msg=name)


def test_utc_is_iso_8601_and_empty_without_a_clock(tmp_path: Path, trajectory: Trajectory) -> None:
    path = tmp_path / "trajectory.csv"
    start = dt.datetime(2024, 2, 29, 23, 59, 30, tzinfo=dt.UTC)
    write_trajectory(path, trajectory, ORIGIN, UtcClock(float(trajectory.t[0]), start.timestamp()))
    written = [dt.datetime.fromisoformat(row["utc"]) for row in rows(path)]
    assert written[0] == start
    assert abs((written[-1] - start).total_seconds() - (trajectory.t[-1] - trajectory.t[0])) < 1e-3
    write_trajectory(path, trajectory, ORIGIN, None)
    assert {row["utc"] for row in rows(path)} == {""}


def test_what_the_estimator_does_not_know_is_nan(tmp_path: Path, trajectory: Trajectory) -> None:
    path = tmp_path / "baseline.csv"
    n = len(trajectory)
    bare = Trajectory(**{**vars(trajectory), "sigmas": None, "R_nb": np.full((n, 3, 3), np.nan)})
    write_trajectory(path, bare, ORIGIN, None)
    assert np.isnan(column(path, "sigma_track_m")).all()
    assert np.isnan(column(path, "roll_deg")).all()
    assert np.isfinite(column(path, "north_m")).all()


def test_a_place_without_a_height_has_its_latitude_and_longitude(tmp_path: Path, trajectory: Trajectory) -> None:
    whole, flat = tmp_path / "trajectory.csv", tmp_path / "baseline.csv"
    position_n = trajectory.position_n * [1.0, 1.0, np.nan]
    write_trajectory(whole, trajectory, ORIGIN, None)
    write_trajectory(flat, Trajectory(**{**vars(trajectory), "position_n": position_n}), ORIGIN, None)
    for name in ("lat_deg", "lon_deg"):
        np.testing.assert_allclose(column(flat, name), column(whole, name), atol=2e-8)
    assert np.isnan(column(flat, "alt_m")).all() and np.isnan(column(flat, "up_m")).all()


def test_yaw_stays_within_its_half_open_turn_after_rounding(tmp_path: Path) -> None:
    yaw = np.array([-np.pi + 1e-7, np.pi, 0.0])
    zero = np.zeros(3)
    vector = np.zeros((3, 3))
    turned = Trajectory(np.arange(3.0), vector, vector, rotation_from_euler(zero, zero, yaw), vector, vector)
    write_trajectory(tmp_path / "t.csv", turned, ORIGIN, None)
    assert list(column(tmp_path / "t.csv", "yaw_deg")) == [180.0, 180.0, 0.0]


def test_fixes_carry_residual_and_weight_of_those_that_were_used(tmp_path: Path, session: Session) -> None:
    path = tmp_path / "gps.csv"
    index = np.array([0, 3])
    residuals = FixResiduals(index, np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), np.array([0.5, 1.0]))
    write_fixes(path, session, residuals)
    assert column(path, "weight")[index] == pytest.approx([0.5, 1.0])
    assert column(path, "residual_west_m")[index] == pytest.approx([2.0, 5.0])
    assert np.isnan(column(path, "weight")[1])
    np.testing.assert_allclose(column(path, "north_m"), session.fix_position_n[:, 0], atol=1e-4)
    np.testing.assert_allclose(column(path, "lat_deg"), session.gnss.lat_deg, atol=1e-9)


def test_an_interrupted_write_leaves_the_old_file_and_no_rubbish(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    path.write_text("old")
    with pytest.raises(RuntimeError), replacing(path) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_table_that_is_written_in_parts_is_the_same_to_the_byte(
    tmp_path: Path, trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    laps = pl.Series("lap", [None, *range(len(trajectory) - 1)], dtype=pl.Int64), np.arange(len(trajectory)) * 1.5
    write_trajectory(tmp_path / "whole.csv", trajectory, ORIGIN, UtcClock(0.0, 1.7e9), laps)
    monkeypatch.setattr(files, "TOGETHER", 7)
    write_trajectory(tmp_path / "parts.csv", trajectory, ORIGIN, UtcClock(0.0, 1.7e9), laps)
    assert (tmp_path / "parts.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    assert len(rows(tmp_path / "parts.csv")) == len(trajectory) > 7


def test_json_is_strict() -> None:
    document = {
        "nan": float("nan"),
        "array": np.array([1.0, np.inf]),
        "count": np.int64(3),
        "yes": np.True_,
        1: (None,),
    }

    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    read = json.loads(to_json(document), parse_constant=refuse)
    assert read == {"nan": None, "array": [1.0, None], "count": 3, "yes": True, "1": [None]}
