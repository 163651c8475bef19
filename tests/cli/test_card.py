"""A card with several recordings of the logger."""

import json
from pathlib import Path

import pytest

from smoother.cli.main import run
from smoother.sim.record_log import DRIVE_FILE, write_klg
from smoother.sim.simulation import simulate_preset

Captured = pytest.CaptureFixture[str]
QUICK = ["--no-figures", "--no-baseline"]


@pytest.fixture(scope="module")
def drives(tmp_path_factory: pytest.TempPathFactory) -> list[bytes]:
    directory = tmp_path_factory.mktemp("drives")
    files = []
    for seed in (1, 2):
        write_klg(simulate_preset("kart", seed, duration=30.0), directory)
        files.append((directory / DRIVE_FILE).read_bytes())
    return files


@pytest.fixture
def card(tmp_path: Path, drives: list[bytes]) -> Path:
    for number, content in enumerate(drives, 1):
        (tmp_path / f"LOG0000{number}.KLG").write_bytes(content)
    return tmp_path


def test_one_recording_is_chosen_by_its_number_or_its_file(card: Path, tmp_path: Path, capsys: Captured) -> None:
    assert run([str(card), "--recording", "2", "--json", *QUICK]) == 0
    assert json.loads(capsys.readouterr().out)["session"]["name"] == "LOG00002"
    assert [path.name for path in (card / "smoothed").iterdir()] == ["LOG00002"]
    assert run([str(card / "LOG00001.KLG"), "--out", str(tmp_path / "one"), "--json", *QUICK]) == 0
    assert json.loads(capsys.readouterr().out)["session"]["name"] == "LOG00001"


@pytest.mark.parametrize("number", ["3", "99"])
def test_an_unknown_number_is_refused_with_the_count(card: Path, capsys: Captured, number: str) -> None:
    assert run([str(card), "--recording", number]) == 2
    assert "holds 2 recordings of the logger" in capsys.readouterr().err


def test_every_recording_of_a_card_is_checked(card: Path, capsys: Captured) -> None:
    assert run(["check", str(card), "--json"]) == 0
    assert [one["session"] for one in json.loads(capsys.readouterr().out)] == ["LOG00001", "LOG00002"]
    assert run(["check", str(card), "--recording", "2", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["session"] == "LOG00002"


@pytest.mark.parametrize("command", ["export", "evaluate"])
def test_commands_for_one_session_ask_which(card: Path, capsys: Captured, command: str) -> None:
    assert run([command, str(card), *(["gpx"] if command == "export" else [])]) == 2
    told = capsys.readouterr().err
    assert "2 recordings (1 LOG00001.KLG, 2 LOG00002.KLG); select one with --recording N" in told


def test_results_of_each_recording_are_kept_in_a_folder_of_their_own(card: Path, capsys: Captured) -> None:
    assert run([str(card / "LOG00001.KLG"), *QUICK]) == 0
    assert run(["laps", str(card / "LOG00002.KLG")]) == 0
    assert run(["export", str(card), "gpx", "--recording", "2"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(card / "smoothed" / "LOG00002" / "LOG00002.gpx")
    for name in ("LOG00001", "LOG00002"):
        summary = json.loads((card / "smoothed" / name / "summary.json").read_text())
        assert summary["session"]["name"] == name
    assert sorted(path.name for path in (card / "smoothed").iterdir()) == ["LOG00001", "LOG00002"]


def test_laps_of_a_card_are_those_of_every_recording_which_are_not_smoothed_again(card: Path, capsys: Captured) -> None:
    assert run([str(card), *QUICK]) == 0
    written = [(card / "smoothed" / name / "summary.json").stat().st_mtime_ns for name in ("LOG00001", "LOG00002")]
    capsys.readouterr()
    assert run(["laps", str(card), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [Path(one["session"]).name for one in told] == ["LOG00001.KLG", "LOG00002.KLG"]
    after = [(card / "smoothed" / name / "summary.json").stat().st_mtime_ns for name in ("LOG00001", "LOG00002")]
    assert after == written


def test_a_damaged_recording_does_not_keep_the_others_from_being_smoothed(card: Path, capsys: Captured) -> None:
    data = (card / "LOG00001.KLG").read_bytes()
    (card / "LOG00001.KLG").write_bytes(data[:512])
    assert run([str(card), *QUICK]) == 2
    assert "LOG00001.KLG" in capsys.readouterr().err
    assert (card / "smoothed" / "LOG00002" / "trajectory.csv").exists()
