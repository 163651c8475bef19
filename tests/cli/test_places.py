"""`--out DIR` writes over nothing that somebody else made, and no session's results over another's."""

import os
import shutil
from pathlib import Path

import pytest

from smoother.cli.directories import output_directory
from smoother.cli.main import run
from smoother.cli.smoothing import output_directories
from smoother.errors import UsageError

QUICK = ["--no-figures", "--no-baseline"]
SENTENCE = "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\r\n"
Captured = pytest.CaptureFixture[str]


def contents(directory: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in directory.iterdir() if path.is_file()}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("LOG001.KLG", b"KLOG"),
        ("walk.nmea", SENTENCE.encode()),
        ("day.vbo", b"File created on 01/05/2024\r\n\r\n[header]\r\nsatellites\r\ntime\r\nlatitude\r\n"),
        ("ride.gpx", b'<?xml version="1.0"?><gpx><trk/></gpx>'),
        ("imu.csv", b"t_s,ax_mps2,ay_mps2,az_mps2\n"),
    ],
)
def test_a_folder_with_any_recording_is_no_place_for_results(
    monday: Path, tmp_path: Path, capsys: Captured, name: str, content: bytes
) -> None:
    from smoother.session.log_format import MAGIC

    out = tmp_path / "card"
    out.mkdir()
    out.joinpath(name).write_bytes(MAGIC + content if name.endswith("KLG") else content)
    before = contents(out)
    assert run([str(monday), "--out", str(out), *QUICK]) == 2
    assert "holds a recording" in capsys.readouterr().err
    assert contents(out) == before


@pytest.mark.parametrize("name", ["report.html", "baseline.csv", "laps.csv", "summary.json", "trajectory.csv"])
def test_files_of_the_same_names_that_somebody_else_made_stay(
    monday: Path, tmp_path: Path, capsys: Captured, name: str
) -> None:
    out = tmp_path / "mine"
    out.mkdir()
    out.joinpath(name).write_text("{}\n")
    before = contents(out)
    assert run([str(monday), "--out", str(out), *QUICK]) == 2
    assert f"--out {out}: holds {name}, which is not of this program" in capsys.readouterr().err
    assert contents(out) == before


def test_results_give_way_to_new_ones_even_if_their_last_file_is_missing(monday: Path, tmp_path: Path) -> None:
    out = tmp_path / "there"
    assert run([str(monday), "--out", str(out), *QUICK]) == 0
    for left in ("summary.json", "gps.csv"):
        assert run([str(monday), "--out", str(out), *QUICK]) == 0
        (out / left).unlink()  # as after a run that was killed
    assert run([str(monday), "--out", str(out), *QUICK]) == 0


def test_a_folder_with_other_things_takes_results(monday: Path, tmp_path: Path) -> None:
    out = tmp_path / "desk"
    (out / "monday").mkdir(parents=True)
    (out / "notes.txt").write_text("rain")
    shutil.copy(monday / "gps.csv", out / "monday")
    assert output_directory(monday, out, "monday") == out
    (out / "gps.csv").write_bytes((monday / "gps.csv").read_bytes())
    with pytest.raises(UsageError, match="holds a recording"):
        output_directory(monday, out, "monday")


def test_no_session_takes_the_place_of_another(tmp_path: Path) -> None:
    names = ["a/x", "b/x", "c/x-2", "d/x", "e/y", "f/x-2"]
    sessions = tuple(tmp_path / name for name in names)
    for session in sessions:
        session.mkdir(parents=True)
    places = [place.name for place in output_directories(tmp_path / "out", sessions) if place is not None]
    assert places == ["x", "x-3", "x-2", "x-4", "y", "x-2-2"]


def test_exports_of_results_that_changed_are_named(monday: Path, capsys: Captured) -> None:
    assert run([str(monday), *QUICK]) == 0
    assert run(["export", str(monday), "gpx"]) == 0
    exported = next((monday / "smoothed").glob("*.gpx"))
    before = exported.read_bytes()
    capsys.readouterr()
    assert run([str(monday), *QUICK]) == 0
    assert "export again" not in capsys.readouterr().err  # the same results
    assert run([str(monday), *QUICK, "--rate", "25"]) == 0
    assert f"{exported.name} of an earlier run was kept" in capsys.readouterr().err
    assert exported.read_bytes() == before and not os.path.lexists(monday / exported.name)
