"""contracts.md 5: the files of results other than the trajectory."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

TABLES_ONLY = ("--no-figures", "--no-baseline")
Read = Callable[[Path], pl.DataFrame]


def test_smooth_session_writes_these_files(results: Path) -> None:
    tables = {"trajectory.csv", "baseline.csv", "gps.csv", "laps.csv"}
    assert {path.name for path in results.iterdir()} == tables | {"summary.json", "report.html", "figures"}
    figures = list((results / "figures").iterdir())
    assert len(figures) >= 5
    assert all(path.read_bytes().startswith(b"\x89PNG\r\n") for path in figures)


def test_gps_csv_holds_every_fix_in_the_frame_of_the_trajectory_with_residual_and_weight(
    simulated: Path, short_results: Path, read: Read
) -> None:
    fixes, recorded, trajectory = (
        read(path) for path in (short_results / "gps.csv", simulated / "gps.csv", short_results / "trajectory.csv")
    )
    np.testing.assert_allclose(fixes["t_s"], recorded["t_s"], atol=1e-6)
    np.testing.assert_allclose(fixes["lat_deg"], recorded["lat_deg"], atol=1e-8)
    assert ((fixes["weight"] >= 0.0) & (fixes["weight"] <= 1.0)).all()
    for axis in ("north", "west"):
        smoothed = np.interp(fixes["t_s"].to_numpy(), trajectory["t_s"].to_numpy(), trajectory[f"{axis}_m"].to_numpy())
        residual = smoothed - fixes[f"{axis}_m"].to_numpy()
        assert np.std(residual) > 1.0  # m
        np.testing.assert_allclose(fixes[f"residual_{axis}_m"].to_numpy(), residual, atol=0.5)


def test_laps_csv_has_a_row_for_every_lap_with_these_columns_first(results: Path, read: Read) -> None:
    laps = read(results / "laps.csv")
    wanted = ["lap", "start_s", "end_s", "lap_time_s", "lap_time_sigma_s", "valid", "reason", "sector1_s"]
    assert laps.columns[:9] == [*wanted, "sector1_sigma_s"]
    assert {"sector2_s", "sector2_sigma_s"} <= set(laps.columns)
    assert laps["lap"].to_list() == list(range(laps.height))
    assert (laps["reason"][0], laps["reason"][-1]) == ("out-lap", "in-lap")
    lines = (results / "laps.csv").read_text().splitlines()
    assert {line.split(",")[5] for line in lines[1:]} == {"true", "false"}
    np.testing.assert_allclose(laps["end_s"][:-1], laps["start_s"][1:], atol=2e-6)
    timed = laps.filter(pl.col("valid"))
    np.testing.assert_allclose(timed["end_s"] - timed["start_s"], timed["lap_time_s"], atol=2e-6)
    sectors = sum(timed[name].to_numpy() for name in laps.columns if re.fullmatch(r"sector\d+_s", name))
    np.testing.assert_allclose(sectors, timed["lap_time_s"], atol=1e-4)


def test_lap_times_are_those_of_the_line_within_their_sigma(drive: Path, results: Path, read: Read) -> None:
    timed, true = read(results / "laps.csv").filter(pl.col("valid")), read(drive / "truth_laps.csv")
    assert timed["lap"].to_list() == true["lap"].to_list() and timed.height >= 2
    sigma = timed["lap_time_sigma_s"].to_numpy()
    assert (sigma > 0.0).all() and (sigma < 0.1).all()
    assert (np.abs(timed["lap_time_s"].to_numpy() - true["lap_time_s"].to_numpy()) < 4.0 * sigma).all()


def test_summary_json_has_these_keys(summary: dict[str, Any]) -> None:
    wanted = {"version", "inputs", "counts", "origin", "problems", "identified", "residuals", "laps", "quality"}
    assert wanted | {"timings"} <= set(summary)
    assert re.fullmatch(r"\d+\.\d+\.\d+\S*", summary["version"])
    assert {"imu.csv", "gps.csv", "mag.csv", "session.toml"} <= set(summary["inputs"])
    assert "truth.csv" not in summary["inputs"]


def test_counts_are_those_of_the_files(drive: Path, trajectory: pl.DataFrame, summary: dict[str, Any]) -> None:
    counts = summary["counts"]
    rows = {name: len((drive / name).read_text().splitlines()) - 1 for name in ("imu.csv", "gps.csv", "mag.csv")}
    assert counts["rows"] == trajectory.height
    assert (counts["imu_samples"], counts["fixes"], counts["mag_samples"]) == tuple(rows.values())


def test_every_identified_value_has_value_sigma_unit_observable_and_source(summary: dict[str, Any]) -> None:
    wanted = {"gps_position_latency", "gps_velocity_latency", "lever_arm_b", "R_bs", "accel_noise", "gyro_noise"}
    assert wanted | {"gps_offset_sigma", "gps_offset_tau"} <= set(summary["identified"])
    for name, one in summary["identified"].items():
        assert set(one) == {"value", "sigma", "unit", "observable", "source"}, name
        assert isinstance(one["observable"], bool) and one["source"] and one["unit"], name
    units = {name: summary["identified"][name]["unit"] for name in ("gps_position_latency", "lever_arm_b")}
    assert units == {"gps_position_latency": "s", "lever_arm_b": "m"}


@pytest.mark.parametrize(("name", "true"), [("gps_position_latency", 0.2), ("gps_velocity_latency", 0.3)])
def test_a_row_stamped_t_was_true_a_latency_before(
    drive: Path, summary: dict[str, Any], read: Read, name: str, true: float
) -> None:
    found = summary["identified"][name]
    assert found["observable"] is True and found["source"] == "identified"
    assert abs(found["value"] - true) < 5.0 * found["sigma"] < 0.15
    fixes, truth = read(drive / "gps.csv"), read(drive / "truth.csv")
    t = fixes["t_s"].to_numpy()
    measured, channel = (
        (fixes["lat_deg"].to_numpy() * 111_200.0, truth["lat_deg"].to_numpy() * 111_200.0)
        if name == "gps_position_latency"
        else (fixes["speed_mps"].to_numpy(), np.hypot(truth["vel_north_mps"], truth["vel_west_mps"]))
    )

    def spread(latency: float) -> float:
        return float(np.std(measured - np.interp(t - latency, truth["t_s"].to_numpy(), channel)))

    assert spread(found["value"]) < 0.8 * min(spread(0.0), spread(-found["value"]), spread(2.5 * found["value"]))


def test_R_bs_turns_sensor_axes_into_those_of_the_kart(drive: Path, summary: dict[str, Any], read: Read) -> None:
    """Before the start the specific force is upwards."""
    rotation = np.array(summary["identified"]["R_bs"]["value"])
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    resting = read(drive / "imu.csv").filter(pl.col("t_s") < 4.0).select("ax", "ay", "az").mean().row(0)
    up = rotation @ np.array(resting) / np.linalg.norm(resting)
    assert up[2] > 0.99
    assert (rotation.T @ up)[2] < 0.99  # the box is turned, so this cannot be so by chance


def test_the_lever_arm_is_from_the_imu_to_the_antenna_in_axes_of_the_kart(summary: dict[str, Any]) -> None:
    arm = summary["identified"]["lever_arm_b"]
    assert len(arm["value"]) == len(arm["sigma"]) == 3
    assert arm["observable"] is True
    error = np.array(arm["value"][:2]) - [-0.6, 0.3]  # m, as simulated: the antenna is behind and to the left
    assert (np.abs(error) < 4.0 * np.array(arm["sigma"][:2])).all()
    assert max(arm["sigma"][:2]) < 0.15


def test_residuals_have_mean_rms_normalised_rms_and_rejected_of_every_factor(summary: dict[str, Any]) -> None:
    assert {"gps_position", "gps_velocity"} <= set(summary["residuals"])
    for name, one in summary["residuals"].items():
        assert {"mean", "rms", "normalised_rms", "rejected"} <= set(one), name
        assert one["rms"] >= abs(one["mean"]) * 0.999 and one["rejected"] >= 0, name


def test_laps_of_the_summary_are_those_of_laps_csv(results: Path, summary: dict[str, Any], read: Read) -> None:
    rows = read(results / "laps.csv").to_dicts()
    assert len(summary["laps"]) == len(rows)
    for one, row in zip(summary["laps"], rows, strict=True):
        for name in ("lap", "start_s", "end_s", "lap_time_s", "lap_time_sigma_s", "valid"):
            assert one[name] == row[name], name
        assert one["reason"] == (row["reason"] or "")


def test_quality_is_a_verdict_with_reasons_and_timings_are_seconds_of_stages(summary: dict[str, Any]) -> None:
    assert summary["quality"]["passed"] is True and summary["quality"]["reasons"] == []
    assert {"reading", "smoothing", "writing"} <= set(summary["timings"])
    assert all(seconds >= 0.0 for seconds in summary["timings"].values())


def test_the_report_is_one_file_that_opens_with_no_network(results: Path) -> None:
    page = (results / "report.html").read_text(encoding="utf-8")
    assert page.lstrip().lower().startswith("<!doctype html>")
    for link in re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)["']""", page):
        assert link.startswith(("data:", "#")), link
    for call in ("fetch(", "XMLHttpRequest", "WebSocket", "@import", "sendBeacon"):
        assert call not in page, call


def test_text_from_files_never_stands_raw_in_the_report_nor_inside_a_script(fixes_alone: Path, smooth: Any) -> None:
    evil = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    (fixes_alone / "session.toml").write_text(f"[session]\ntitle = {json.dumps(evil)}\nnotes = {json.dumps(evil)}\n")
    assert smooth(fixes_alone, "--no-baseline", "--no-pictures").code == 0
    page = (fixes_alone / "smoothed" / "report.html").read_text(encoding="utf-8")
    assert "alert(1)" in page  # it is shown, as text
    for raw in ("<script>alert", "</script><script>", "<img src=x"):
        assert raw not in page, raw


def test_out_names_the_folder_of_the_results_and_inputs_stay_as_they_are(
    short: Path, smooth: Any, tmp_path: Path
) -> None:
    before = {path.name: path.read_bytes() for path in short.iterdir()}
    assert smooth(short, "--out", tmp_path / "new" / "place", *TABLES_ONLY).code == 0
    names = {path.name for path in (tmp_path / "new" / "place").iterdir()}
    assert names == {"trajectory.csv", "gps.csv", "laps.csv", "summary.json"}
    assert {path.name: path.read_bytes() for path in short.iterdir()} == before


@pytest.mark.parametrize(("option", "missing"), [("--no-baseline", "baseline.csv"), ("--no-figures", "report.html")])
def test_what_is_left_out_is_not_written_and_nothing_of_it_stays(
    short: Path, smooth: Any, option: str, missing: str
) -> None:
    (short / "smoothed").mkdir()
    (short / "smoothed" / missing).write_text("of an earlier run")
    assert smooth(short, *{option, "--no-figures"}).code == 0
    assert not (short / "smoothed" / missing).exists()
