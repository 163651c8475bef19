"""`smooth simulate`: the files of a session appear together, or the earlier ones stay."""

from pathlib import Path

import pytest

from smoother.cli.main import run
from smoother.cli.simulating import write
from smoother.errors import UsageError
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
    write(simulation, tmp_path / "new", "csv", told=True)
    write(simulation, tmp_path / "new", "thesis")
    names = {path.name for path in (tmp_path / "new").iterdir()}
    assert "out.txt" in names
    assert not names & {"imu.csv", "gps.csv", "session.toml"}


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
