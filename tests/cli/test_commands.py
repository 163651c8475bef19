"""check, demo, simulate and evaluate as a person calls them."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother.cli.main import run
from smoother.session.load import load_raw

Captured = pytest.CaptureFixture[str]


def test_check_does_not_call_a_second_of_recording_good(monday: Path, capsys: Captured) -> None:
    for name, rows in (("imu.csv", 200), ("gps.csv", 6)):
        lines = (monday / name).read_text().splitlines(keepends=True)
        (monday / name).write_text("".join(lines[: rows + 1]))
    assert run(["check", str(monday)]) == 3
    said = capsys.readouterr().out.rstrip("\n").splitlines()
    assert said[-1] == "NOT GOOD TO DRIVE: only 1 s of fixes, too short to judge; record a minute"


def test_check_accepts_a_gps_alone_and_names_what_is_missing(monday: Path, capsys: Captured) -> None:
    for name in ("imu.csv", "mag.csv"):
        (monday / name).unlink()
    assert run(["check", str(monday)]) == 0
    said = capsys.readouterr().out.rstrip("\n").splitlines()
    assert said[-1] == "GOOD TO DRIVE, GPS only: no roll, pitch, sideslip"
    assert run(["check", str(monday), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["gps_only"] is True


def test_check_and_smooth_agree_on_a_motion_sensor_that_is_too_slow(monday: Path, capsys: Captured) -> None:
    header, *rows = (monday / "imu.csv").read_text().splitlines(keepends=True)
    (monday / "imu.csv").write_text("".join([header, *rows[::20]]))
    assert run(["check", str(monday)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    slow = "the motion sensor is too slow (10 samples a second, 20 are needed)"
    assert said.count("samples a second") == 2 and slow in said  # the other is the compass
    assert said.endswith("GOOD TO DRIVE, GPS only: no roll, pitch, sideslip")
    assert run([str(monday), "--no-baseline", "--no-figures", "--json"]) == 0
    texts = [problem["text"] for problem in json.loads(capsys.readouterr().out)["problems"]]
    assert f"imu.csv: {slow}: smoothed from GPS alone" in texts


def test_check_of_several_distinguishes_sessions_of_one_name(
    monday: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    for kart in ("a", "b", "c"):
        shutil.copytree(monday, tmp_path / kart / "run1")
    (tmp_path / "c" / "run1" / "gps.csv").write_text("t_s,lat_deg,lon_deg\n")
    assert run(["check", "a/run1", "b/run1", "c/run1"]) == 2
    said = capsys.readouterr()
    assert {"a/run1", "b/run1"} <= set(said.out.splitlines()) and "run1" not in said.out.splitlines()
    assert said.err.startswith("smooth: c/run1/gps.csv: ")
    assert run(["check", "a/run1", "b/run1", "--json"]) == 0
    assert [one["path"] for one in json.loads(capsys.readouterr().out)] == ["a/run1", "b/run1"]


def test_check_json_has_verdict_findings_and_numbers(simulated: Path, tmp_path: Path, capsys: Captured) -> None:
    assert run(["check", str(simulated), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["good"] is True
    assert document["reasons"] == []
    assert document["measures"]["fix_rate_hz"] == pytest.approx(5.0, rel=0.01)
    assert {"level", "topic", "text"} == set(document["findings"][0])
    (tmp_path / "empty").mkdir()
    assert run(["check", str(simulated), str(tmp_path / "empty"), "--json"]) == 2
    assert [sorted(document)[0] for document in json.loads(capsys.readouterr().out)] == ["findings", "error"]


def test_evaluate_prints_a_table(simulated: Path, capsys: Captured) -> None:
    assert run(["evaluate", str(simulated), "--skip", "5"]) == 0
    text = capsys.readouterr().out
    assert all(word in text for word in ("GPS alone", "baseline", "smoother", "horizontal (m)", "NEES"))


def test_evaluate_asks_about_a_truth_of_another_time(monday: Path, simulated: Path, capsys: Captured) -> None:
    truth = pl.read_csv(simulated / "truth.csv", infer_schema_length=None)
    truth.with_columns(t_s=1000.0 * pl.col("t_s")).write_csv(monday / "truth.csv")  # in ms
    assert run(["evaluate", str(monday)]) == 0
    said = capsys.readouterr().err
    assert "% of truth.csv lie outside the session; are its times on the session's clock, in s?" in said
    shutil.copy(simulated / "truth.csv", monday)
    assert run(["evaluate", str(monday)]) == 0
    assert "lie outside" not in capsys.readouterr().err


def test_settings_reach_the_simulation(tmp_path: Path) -> None:
    arguments = ["--duration", "20", "--gps-rate", "2", "--no-imu", "--no-mag", "--no-speed", "--track", "tinbarn"]
    assert run(["simulate", str(tmp_path / "s"), *arguments, "--set", "gnss.outages=5:4"]) == 0
    assert not (tmp_path / "s" / "imu.csv").exists()
    assert not (tmp_path / "s" / "mag.csv").exists()
    steps = np.diff(pl.read_csv(tmp_path / "s" / "gps.csv")["t_s"].to_numpy())
    assert np.median(steps) == pytest.approx(0.5, abs=0.01)
    assert np.max(steps) == pytest.approx(4.5, abs=0.3)


def test_the_thesis_form_can_be_read_back(tmp_path: Path) -> None:
    assert run(["simulate", str(tmp_path / "t"), "--duration", "20", "--format", "thesis"]) == 0
    raw = load_raw(tmp_path / "t")
    assert raw.imu is not None
    assert len(raw.gnss) > 50
    assert run(["simulate", str(tmp_path / "u"), "--duration", "20", "--format", "thesis", "--no-imu"]) == 2


def test_the_loggers_form_can_be_read_back(tmp_path: Path, capsys: Captured) -> None:
    assert run(["simulate", str(tmp_path / "k"), "--duration", "20", "--format", "klg"]) == 0
    raw = load_raw(tmp_path / "k")
    assert raw.imu is not None
    assert len(raw.imu.t) == 4000
    assert len(raw.gnss) > 50
    assert run(["simulate", str(tmp_path / "u"), "--duration", "20", "--format", "klg", "--imu-rate", "2000"]) == 2
    assert "at most 1000 times a second" in capsys.readouterr().err


def test_a_new_simulation_leaves_nothing_of_an_older_one(tmp_path: Path) -> None:
    assert run(["simulate", str(tmp_path / "s"), "--duration", "10"]) == 0
    assert run(["simulate", str(tmp_path / "s"), "--duration", "10", "--no-imu"]) == 0
    assert not (tmp_path / "s" / "imu.csv").exists()


def test_a_recording_is_never_written_over(tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "gps.csv").write_text("t_s,lat_deg,lon_deg\n1,45,12\n")
    for command in ("simulate", "demo"):
        assert run([command, str(tmp_path)]) == 2
        assert "would be lost" in capsys.readouterr().err
    assert (tmp_path / "gps.csv").read_text().startswith("t_s")


def test_all_figures_of_a_preset_are_listed(capsys: Captured) -> None:
    assert run(["simulate", "--list", "--preset", "kart_harsh", "--set", "gnss.rate=7"]) == 0
    text = capsys.readouterr().out
    assert "gnss.rate" in text
    assert "imu.gyro_noise" in text


def test_an_unknown_figure_names_the_nearest(tmp_path: Path, capsys: Captured) -> None:
    assert run(["simulate", str(tmp_path / "s"), "--set", "gnss.whit_horizontal=1"]) == 2
    assert "gnss.white_horizontal" in capsys.readouterr().err
