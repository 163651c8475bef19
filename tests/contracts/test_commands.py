"""contracts.md 6: every command with its options."""

import json
import os
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

TABLES_ONLY = ("--no-figures", "--no-baseline")
Read = Callable[[Path], pl.DataFrame]
COMMANDS = ("calibrate", "check", "demo", "simulate", "evaluate", "export", "laps", "compare", "live", "batch")
OPTIONS = {
    "": "--out --rate --solver --no-baseline --json --open --recording",
    "simulate": "--seed --preset --format --set --list",
    "evaluate": "--json",
    "laps": "--line --json",
    "export": "--out --rate",
    "compare": "--line --json --out --open",
    "batch": "--jobs --scheduler --json",
    "live": "--json --record",
}


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_every_command_has_help_with_its_options(smooth: Any, command: str) -> None:
    printed = smooth(*filter(None, [command]), "--help")
    assert printed.code == 0 and f"Usage: smooth {command}".strip() in printed.out
    for option in OPTIONS.get(command, "").split():
        assert option in printed.out, option


def test_check_reports_whether_it_is_good_to_drive_and_why(simulated: Path, smooth: Any) -> None:
    printed = smooth("check", simulated)
    assert printed.code == 0 and printed.last == "GOOD TO DRIVE"
    document = smooth("check", simulated, "--json").document
    assert document["good"] is True and document["reasons"] == []
    assert {"level", "topic", "text"} == set(document["findings"][0])
    measures = document["measures"]
    assert measures["fix_rate_hz"] == pytest.approx(5.0, rel=0.01)
    assert measures["imu_rate_hz"] == pytest.approx(200.0, rel=0.01)
    assert {"fix_gap_longest_s", "accel_clipped_share", "accel_vibration_mps2"} <= set(measures)


def test_check_reports_what_to_mend_with_exit_code_3(short: Path, smooth: Any) -> None:
    (short / "imu.csv").unlink()
    printed = smooth("check", short)
    assert printed.code == 3 and printed.last.startswith("NOT GOOD TO DRIVE: ")
    document = smooth("check", short, "--json").document
    assert document["good"] is False and document["reasons"]


@pytest.mark.slow
def test_demo_simulates_a_session_of_the_logger_smooths_it_and_prints_the_report_path(
    smooth: Any, tmp_path: Path
) -> None:
    printed = smooth("demo", tmp_path / "demo", "--duration", "20")
    assert printed.code == 0
    assert printed.last == str(tmp_path / "demo" / "smoothed" / "report.html")
    assert Path(printed.last).exists()
    names = {path.name for path in (tmp_path / "demo").iterdir()}
    assert "truth.csv" in names and any(name.endswith(".KLG") for name in names)


@pytest.mark.parametrize("form", ["csv", "klg", "thesis"])
def test_simulate_writes_a_session_and_its_truth_in_each_form(smooth: Any, tmp_path: Path, form: str) -> None:
    assert smooth("simulate", tmp_path, "--duration", "20", "--format", form).code == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert "truth.csv" in names
    assert {"csv": "imu.csv" in names, "klg": any(n.endswith(".KLG") for n in names), "thesis": "out.txt" in names}[
        form
    ]
    document = smooth("check", tmp_path, "--json").document
    assert document["measures"]["fixes"] > 60 and document["measures"]["imu_rate_hz"] > 40.0


def test_a_seed_makes_the_same_session_again_and_every_noise_can_be_set(
    smooth: Any, read: Read, tmp_path: Path
) -> None:
    for name, words in (
        ("a", ["--seed", "3"]),
        ("b", ["--seed", "3"]),
        ("c", ["--seed", "4"]),
        ("d", ["--seed", "3", "--set", "gnss.white_horizontal=20"]),
    ):
        assert smooth("simulate", tmp_path / name, "--duration", "10", *words).code == 0
    first, same, other = ((tmp_path / name / "imu.csv").read_bytes() for name in "abc")
    assert first == same != other
    quiet, loud = (float(np.std(np.diff(read(tmp_path / name / "gps.csv")["lat_deg"], 2))) for name in "ad")
    assert loud > 10.0 * quiet
    listed = smooth("simulate", "--list").out
    assert "gnss.white_horizontal" in listed and "imu.gyro_noise" in listed


@pytest.mark.slow
def test_calibrate_writes_calibration_toml_of_what_was_recorded(smooth: Any, tmp_path: Path) -> None:
    """A box that lies still: the bias of its gyroscope."""
    rng = np.random.default_rng(1)
    bias = np.array([0.02, -0.01, 0.005])
    force, rate = (
        rng.normal(0.0, 0.02, (7000, 3)) + np.array([0.0, 0.0, 9.81]),
        rng.normal(0.0, 0.002, (7000, 3)) + bias,
    )
    samples = np.hstack([force, rate])
    names = ("ax", "ay", "az", "gx", "gy", "gz")
    columns = {name: samples[:, i] for i, name in enumerate(names)}
    pl.DataFrame({"t_s": np.arange(7000) / 100.0, **columns}).write_csv(tmp_path / "imu.csv")
    printed = smooth("calibrate", tmp_path, "--no-figures", "--place", "45,12", "--date", "2026-05-16")
    assert printed.code == 0
    found = tomllib.loads((tmp_path / "calibration.toml").read_text())["gyroscope"]["bias"]
    np.testing.assert_allclose(found, bias, atol=5e-4)


@pytest.mark.slow
def test_evaluate_json_has_one_object_per_estimator_with_these_figures(simulated: Path, smooth: Any) -> None:
    document = smooth("evaluate", simulated, "--json").document
    assert list(document) == ["gps", "baseline", "smoother"]
    wanted = "horizontal_rms_m up_rms_m velocity_rms_mps roll_rms_deg pitch_rms_deg yaw_rms_deg relative_1s_rms_m"
    for figures in document.values():
        assert {*wanted.split(), "coverage_1sigma", "nees"} <= set(figures)
    smoother = document["smoother"]
    assert smoother["horizontal_rms_m"] < 0.5 * document["gps"]["horizontal_rms_m"]
    assert 0.3 < smoother["coverage_1sigma"] <= 1.0
    assert 0.0 < smoother["yaw_rms_deg"] < 3.0


def test_evaluate_needs_a_truth(short: Path, smooth: Any) -> None:
    (short / "truth.csv").unlink()
    printed = smooth("evaluate", short)
    assert printed.code == 2 and "truth.csv" in printed.err and printed.err.count("\n") == 1


def test_laps_are_those_of_the_summary_and_of_a_line_that_is_given(
    drive: Path, results: Path, summary: dict[str, Any], smooth: Any
) -> None:
    written = (results / "summary.json").stat().st_mtime_ns
    document = smooth("laps", drive, "--json").document
    assert document["laps"] == summary["laps"]
    line = document["lap_analysis"]["start_line"]
    ends = ";".join(f"{line[side]['lat_deg']},{line[side]['lon_deg']}" for side in ("left", "right"))
    again = smooth("laps", drive, "--line", ends, "--json").document["laps"]
    times = [[lap["lap_time_s"] for lap in laps if lap["valid"]] for laps in (summary["laps"], again)]
    assert len(times[0]) >= 2 and times[1] == pytest.approx(times[0], abs=2e-3)
    assert (results / "summary.json").stat().st_mtime_ns == written
    assert "±" in smooth("laps", drive).out


@pytest.mark.slow
def test_compare_puts_laps_of_several_sessions_on_one_reference_line(
    drive: Path, results: Path, smooth: Any, tmp_path: Path
) -> None:
    other = Path(shutil.copytree(drive, tmp_path / "sunday"))
    printed = smooth("compare", drive, other, "--json", "--out", tmp_path / "page.html")
    assert printed.code == 0 and (tmp_path / "page.html").stat().st_size > 10_000
    one, two = printed.document["sessions"]
    assert (one["session"], two["session"]) == ("monday", "sunday")
    assert one["lap_analysis"]["length_m"] == two["lap_analysis"]["length_m"]
    assert one["laps"] == two["laps"]


@pytest.mark.parametrize("words", [["export", "SESSION", "tum", "--out", "x.tum"], ["laps", "SESSION"]])
def test_results_that_are_missing_or_older_than_the_inputs_are_made_again(
    fixes_alone: Path, smooth: Any, monkeypatch: pytest.MonkeyPatch, words: list[str]
) -> None:
    monkeypatch.chdir(fixes_alone.parent)
    command = [str(fixes_alone) if word == "SESSION" else word for word in words]
    written = fixes_alone / "smoothed" / "trajectory.csv"
    assert smooth(*command).code == 0
    first = written.stat().st_mtime_ns
    assert smooth(*command).code == 0
    assert written.stat().st_mtime_ns == first
    (fixes_alone / "session.toml").write_text('[session]\ntitle = "later"\n')
    later = written.stat().st_mtime + 5.0
    os.utime(fixes_alone / "session.toml", (later, later))
    assert smooth(*command).code == 0
    assert written.stat().st_mtime_ns > first


@pytest.mark.slow
def test_compare_smooths_first_what_was_not(
    drive: Path, results: Path, fixes_alone: Path, smooth: Any, tmp_path: Path
) -> None:
    printed = smooth("compare", drive, fixes_alone, "--json", "--out", tmp_path / "page.html")
    assert printed.code == 0
    assert [one["session"] for one in printed.document["sessions"]] == ["monday", "tuesday"]
    assert (fixes_alone / "smoothed" / "trajectory.csv").exists()


def test_a_path_that_exists_is_always_a_session_whatever_its_name(
    fixes_alone: Path, smooth: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    fixes_alone.rename(fixes_alone.parent / "check")
    monkeypatch.chdir(fixes_alone.parent)
    assert smooth("check", "--json", *TABLES_ONLY).code == 0
    assert Path("check/smoothed/trajectory.csv").exists()


def test_commands_take_several_sessions_and_one_that_is_unusable_does_not_stop_the_others(
    short: Path, smooth: Any, tmp_path: Path
) -> None:
    (tmp_path / "empty").mkdir()
    printed = smooth("check", tmp_path / "empty", short, "--json")
    assert printed.code == 2
    bad, good = printed.document
    assert "error" in bad and good["good"] is True
    printed = smooth(tmp_path / "empty", short, "--json", "--out", tmp_path / "out", *TABLES_ONLY)
    assert printed.code == 2
    bad, good = printed.document
    assert "error" in bad and good["quality"]["passed"] is True
    assert (tmp_path / "out" / "tuesday" / "trajectory.csv").exists()


@pytest.mark.slow
def test_live_shows_attitude_and_speed_of_a_recording_as_lines_of_json(smooth: Any, tmp_path: Path) -> None:
    made = ["simulate", tmp_path / "k", "--duration", "12", "--format", "klg", "--track", "tinbarn"]
    assert smooth(*made, "--standstill", "2").code == 0
    (recording, *_) = sorted((tmp_path / "k").glob("*.KLG"))[-1:]
    printed = smooth("live", recording, "--speed", "max", "--json")
    assert printed.code == 0
    lines = [json.loads(line) for line in printed.out.splitlines()]
    assert lines
    assert 0.0 < lines[-1]["gps"]["speed_mps"] < 50.0
    assert {"roll_deg", "pitch_deg", "yaw_deg"} <= set(lines[-1]["smoother"] or lines[-1]["madgwick"])


@pytest.mark.slow
def test_batch_smooths_every_session_below_a_folder_and_writes_one_page(
    fixes_alone: Path, smooth: Any, tmp_path: Path
) -> None:
    shutil.copytree(fixes_alone, tmp_path / "day" / "a")
    assert smooth("batch", tmp_path / "day", "--jobs", "1", *TABLES_ONLY).code == 0
    assert (tmp_path / "day" / "a" / "smoothed" / "trajectory.csv").exists()
    for ending in ("html", "json", "csv"):
        assert (tmp_path / "day" / f"sessions.{ending}").exists()


def test_a_truth_may_be_north_west_and_up_of_the_origin_instead_of_degrees(
    short: Path, short_results: Path, smooth: Any
) -> None:
    origin = json.loads((short_results / "summary.json").read_text())["origin"]
    truth = pl.read_csv(short / "truth.csv")
    lat = np.radians(origin["lat_deg"])
    shrink = 1.0 - 0.00669438 * np.sin(lat) ** 2  # WGS 84: radii of curvature along and across the meridian
    along, across = 6_378_137.0 * 0.99330562 / shrink**1.5, 6_378_137.0 * np.cos(lat) / shrink**0.5
    north = np.radians(truth["lat_deg"] - origin["lat_deg"]) * along
    west = -np.radians(truth["lon_deg"] - origin["lon_deg"]) * across
    in_metres = truth.drop("lat_deg", "lon_deg", "alt_m").with_columns(
        north_m=north, west_m=west, up_m=truth["alt_m"] - origin["alt_m"]
    )
    in_degrees = smooth("evaluate", short, "--json").document["smoother"]
    in_metres.write_csv(short / "truth.csv")
    found = smooth("evaluate", short, "--json").document["smoother"]
    assert found["horizontal_rms_m"] == pytest.approx(in_degrees["horizontal_rms_m"], abs=0.03)
    assert found["up_rms_m"] == pytest.approx(in_degrees["up_rms_m"], abs=0.02)
