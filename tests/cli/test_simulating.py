"""`smooth simulate`: the files of a session appear together, or the earlier ones stay."""

import json
import os
import sys
from pathlib import Path

import pytest

from smoother.cli.main import run
from smoother.cli.simulating import write
from smoother.config import Mounting
from smoother.errors import UsageError
from smoother.session.load import load_raw
from smoother.session.settings import load_settings
from smoother.sim import record
from smoother.sim.simulation import Simulation, simulate_preset


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("white", 1, duration=10.0)


def test_a_simulation_that_fails_leaves_the_one_before(
    simulation: Simulation, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(simulation, tmp_path, "csv")
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(record, "write_truth", full)
    with pytest.raises(UsageError, match="No space left"):
        write(simulation, tmp_path, "csv")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


def test_files_of_another_format_go(simulation: Simulation, tmp_path: Path) -> None:
    write(simulation, tmp_path / "new", "csv", states_truth=True)
    write(simulation, tmp_path / "new", "thesis")
    names = {path.name for path in (tmp_path / "new").iterdir()}
    assert "out.txt" in names
    assert not names & {"imu.csv", "gps.csv"}
    assert load_settings(tmp_path / "new" / "session.toml").mounting == Mounting()  # what was told is gone


@pytest.mark.parametrize("form", ["csv", "klg", "thesis"])
@pytest.mark.parametrize("told", [False, True])
def test_a_simulation_is_marked_wherever_it_is_shown(
    simulation: Simulation, tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str, told: bool
) -> None:
    """A report that is handed on must not pass for one of a drive."""
    write(simulation, tmp_path, form, states_truth=told)
    assert run([str(tmp_path), "--no-baseline", "--no-pictures"]) in (0, 3)
    title = f"Simulated session ({simulation.scenario.name}, {simulation.scenario.track})"
    assert capsys.readouterr().out.splitlines()[0] == title
    page = (tmp_path / "smoothed" / "report.html").read_text(encoding="utf-8")
    assert f"<title>{title}</title>" in page and f"<h1>{title}</h1>" in page
    assert json.loads((tmp_path / "smoothed" / "summary.json").read_text())["session"]["title"] == title


@pytest.mark.skipif(sys.platform == "darwin", reason="its file system knows no names that are not UTF-8")
@pytest.mark.parametrize("form", ["csv", "klg", "thesis"])
def test_a_folder_whose_name_is_not_utf8_is_written_into(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], form: str
) -> None:
    folder = tmp_path / os.fsdecode(b"M\xfcller")
    assert run(["simulate", str(folder), "--duration", "10", "--format", form]) == 0
    assert capsys.readouterr().err == ""
    assert {"truth.csv", "truth_laps.csv", "session.toml"} < {path.name for path in folder.iterdir()}


VBO = "[header]\ntime\n[column names]\ntime lat long\n[data]\n"


@pytest.mark.parametrize(
    "name", ["heat.vbo", "heat.gpx", "heat.nmea", "gps.csv.gz", "LOG00007.KLG", "calibration.toml"]
)
@pytest.mark.parametrize("command", [["simulate", "--duration", "10"], ["demo", "--duration", "20"]])
def test_a_simulation_does_not_push_a_recording_aside(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, command: list[str]
) -> None:
    (tmp_path / name).write_text(VBO)
    assert run([command[0], str(tmp_path), *command[1:]]) == 2
    said = capsys.readouterr().err
    assert name in said and "name another folder" in said and said.count("\n") == 1
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_recording_put_beside_a_simulation_keeps_the_next_one_out(simulation: Simulation, tmp_path: Path) -> None:
    write(simulation, tmp_path, "csv")
    write(simulation, tmp_path, "klg")  # what a simulation wrote may go
    (tmp_path / "heat.vbo").write_text(VBO)
    with pytest.raises(UsageError, match=r"heat\.vbo"):
        write(simulation, tmp_path, "csv")
    assert (tmp_path / "LOG00002.KLG").exists()


@pytest.mark.parametrize("value", ["nan", "-0.5"])
def test_a_sigma_that_is_none_is_refused_in_a_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], value: str
) -> None:
    target = tmp_path / "new"
    assert run(["simulate", str(target), "--duration", "20", "--set", f"gnss.white_horizontal={value}"]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1
    assert said.err.startswith(f"smooth: gnss.white_horizontal is {value}; it has to be a number of 0 or more")
    assert not target.exists()


@pytest.mark.parametrize(("form", "states"), [("csv", True), ("klg", False), ("thesis", False)])
def test_what_the_low_pass_delays_is_stated_once(form: str, states: bool, tmp_path: Path) -> None:
    """The log holds it itself, and the thesis' logger did not know it."""
    assert run(["simulate", str(tmp_path / "s"), "--preset", "white", "--duration", "20", "--format", form]) == 0
    assert ("delay = 0.0025" in (tmp_path / "s" / "session.toml").read_text()) == states
    assert "imu_delay_known" not in [problem.code for problem in load_raw(tmp_path / "s").problems]
