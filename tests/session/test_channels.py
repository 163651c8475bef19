"""What was logged beside the motion: from channels.csv and other loggers' tables to trajectory.csv and exports."""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother.cli.main import run
from smoother.samples import Channel
from smoother.session.load import load_raw
from smoother.session.readers.channels import column_name

from .folders import gps_csv

COUNT = 400


def drive(folder: Path, channels: str) -> None:
    (folder / "gps.csv").write_text(gps_csv(COUNT))
    (folder / "channels.csv").write_text(channels)


def table() -> str:
    """RPM at 10 Hz with a hole, a temperature once a second, a gear, and one that never changes."""
    rows = []
    for k in range(10 * COUNT // 5):
        t = k / 10
        rpm = "" if 30.0 < t < 40.0 else f"{9000 + 100 * t:.0f}"
        rows.append(f"{t:.1f},{rpm},{50 + t / 10 if k % 10 == 0 else ''},{1 + (t > 20)},7")
    return "\n".join(["t_s,rpm,water_temp_c,gear,spare", *rows]) + "\n"


@pytest.mark.parametrize(
    ("name", "unit", "column"),
    [
        ("RPM", "rpm", "rpm"), ("Engine RPM", "", "rpm"), ("Water Temp", "°C", "water_temp_c"),
        ("TPS", "%", "throttle_pct"),
        ("Logger Temperature", "C", "logger_temperature_c"), ("water_temp_c", "", "water_temp_c"),
        ("Lap", "", "logged_lap"),
        ("Brake Pressure", "bar", "brake_pressure_bar"), ("hr", "bpm", "heart_rate_bpm"), ("3rd", "", "logged_3rd"),
    ],
)  # fmt: skip
def test_names_of_columns(name: str, unit: str, column: str) -> None:
    assert column_name(name, unit) == column


def test_channels_csv_is_read_and_named_among_the_inputs(tmp_path: Path) -> None:
    drive(tmp_path, table())
    raw = load_raw(tmp_path)
    assert raw.inputs == ("gps.csv", "channels.csv")
    assert [channel.name for channel in raw.channels] == ["rpm", "water_temp_c", "gear"]
    rpm, temperature, _ = raw.channels
    np.testing.assert_allclose(rpm.values, np.round(9000 + 100 * rpm.t))
    assert len(temperature.t) == COUNT // 5 and not np.any((rpm.t > 30.05) & (rpm.t < 39.95))


def test_a_table_of_channels_that_cannot_be_read_costs_nothing_else(tmp_path: Path) -> None:
    drive(tmp_path, "time,rpm\n0,1\n")
    raw = load_raw(tmp_path)
    assert len(raw.gnss) == COUNT and raw.channels == ()
    assert "channels_unusable" in {problem.code for problem in raw.problems}


def test_columns_of_another_loggers_table_are_channels(tmp_path: Path) -> None:
    rows = [
        f"{k / 10:.1f},{45 + 1e-5 * k:.7f},{12 + 1e-7 * k * k:.8f},{9000 + k},{80 + k / 50:.1f},{k % 3}"
        for k in range(COUNT)
    ]
    (tmp_path / "session.csv").write_text("\n".join(["Time (s),Lat,Lon,RPM,Water (°C),Index", *rows]) + "\n")
    channels = load_raw(tmp_path).channels
    assert [(channel.name, channel.unit) for channel in channels] == [("rpm", ""), ("water_c", "°C")]
    np.testing.assert_allclose(channels[0].values, 9000 + np.arange(COUNT))


def test_holes_are_not_interpolated_and_a_gear_has_no_values_between() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.1), np.arange(20.0, 30.0, 0.1)])
    smooth = Channel("rpm", "rpm", t, 100.0 * t).at(np.array([-1.0, 5.05, 15.0, 25.05, 31.0]))
    np.testing.assert_allclose(smooth, [np.nan, 505.0, np.nan, 2505.0, np.nan])
    gear = Channel("gear", "", t, np.where(t < 5.0, 1.0, 2.0)).at(np.array([4.95, 5.05, 29.9]))
    np.testing.assert_allclose(gear, [1.0, 2.0, 2.0])


def test_channels_reach_the_trajectory_the_report_and_exports(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    drive(tmp_path, table())
    run([str(tmp_path), "--no-baseline"])
    results = tmp_path / "smoothed"
    rows = pl.read_csv(results / "trajectory.csv")
    assert rows.columns[-4:] == ["lap_distance_m", "rpm", "water_temp_c", "gear"]
    t, rpm = (rows[name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy() for name in ("t_s", "rpm"))
    outside = (t < 30.0) | (t > 40.0)
    np.testing.assert_allclose(rpm[outside], 9000 + 100 * t[outside], atol=1.0)
    assert np.isnan(rpm[(t > 30.1) & (t < 39.9)]).all()
    page = (results / "report.html").read_text(encoding="utf-8")
    assert '"title":"rpm"' in page and "<th>water temp c</th>" in page
    for form, title in (("aim", '"RPM"'), ("vbo", "rpm"), ("racechrono", ",coolant_temp,"), ("gpx", "<ks:gear>")):
        out = tmp_path / f"out.{form}"
        run(["export", str(tmp_path), form, "--out", str(out)])
        assert title in out.read_text(encoding="utf-8")
    run(["export", str(tmp_path), "motec", "--out", str(tmp_path / "out.ld")])
    assert b"Engine RPM" in (tmp_path / "out.ld").read_bytes()
    capsys.readouterr()
