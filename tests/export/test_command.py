"""`smooth export`: from a session to files, smoothed first where needed; evo agrees with `smooth evaluate`."""

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from evo import main_ape
from evo.core.metrics import PoseRelation
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

from smoother.cli.exporting import FORMAT_NAMES
from smoother.cli.main import run
from smoother.cli.pipeline import Options
from smoother.export.formats import BY_NAME
from smoother.frames import Origin, geodetic_to_nwu
from smoother.session.readers.vbo import read_vbo

Captured = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def smoothed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A simulated session with its results."""
    directory = tmp_path_factory.mktemp("export") / "monday"
    arguments = ["--duration", "40", "--seed", "11", "--preset", "white"]
    assert run(["simulate", str(directory), *arguments]) == 0
    assert run([str(directory), "--no-figures", "--no-baseline"]) == 0
    return directory


@pytest.fixture(autouse=True)
def tables_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures where a session is smoothed first: nothing here looks at them."""
    monkeypatch.setattr("smoother.cli.results.Options", lambda: Options(baseline=False, figures=False))


@pytest.fixture
def monday(smoothed: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(smoothed, tmp_path / "monday"))


def test_the_names_on_the_command_line_are_those_of_the_formats() -> None:
    assert set(FORMAT_NAMES) == set(BY_NAME)


def test_the_list_names_the_programs_of_each_format(capsys: Captured) -> None:
    for arguments in (["export", "--list"], ["export", "nowhere", "--list"]):
        assert run(arguments) == 0
        listed = capsys.readouterr().out
        assert all(re.search(rf"^{name}\s", listed, re.MULTILINE) for name in FORMAT_NAMES)
        assert "Google Earth" in listed and "i2" in listed


def test_out_and_rate_choose_the_place_and_the_rows(monday: Path, tmp_path: Path, capsys: Captured) -> None:
    target = tmp_path / "new" / "run.vbo"
    assert run(["export", str(monday), "vbo", "--out", str(target), "--rate", "10"]) == 0
    gnss = read_vbo(target).gnss
    np.testing.assert_allclose(np.diff(gnss.t), 0.1, atol=2e-3)
    assert run(["export", str(monday), "gpx", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "monday.gpx").exists()


def test_another_recording_in_the_same_folder_has_results_of_its_own(monday: Path, capsys: Captured) -> None:
    assert run(["export", str(monday), "vbo", "--out", str(monday / "other.vbo")]) == 0
    long_ago = (monday / "gps.csv").stat().st_mtime
    os.utime(monday / "other.vbo", (long_ago, long_ago))
    assert run(["export", str(monday / "other.vbo"), "gpx"]) == 0
    assert Path(capsys.readouterr().out.splitlines()[-1]).name == "other.gpx"
    place = monday / "smoothed" / "other"
    assert json.loads((place / "summary.json").read_text())["inputs"] == ["other.vbo", "session.toml"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["{}"], "smooth export SESSION FORMAT"),
        (["{}", "pdf"], "unknown format 'pdf'; known are vbo"),
        (["vbo", "{}"], "the session comes before the format: smooth export"),
        (["{}/nothing", "vbo"], "no such file or folder"),
        (["{}/smoothed", "vbo"], "holds results, not a recording"),
        (["{}", "vbo", "--rate", "1e9"], "--rate"),
        (["{}", "vbo", "--rate", "nan"], "--rate"),
        (["{}", "vbo", "--out", "{}/gps.csv/x.vbo"], "--out FILE"),
    ],
)
def test_what_cannot_be_exported_is_one_line_and_exit_code_2(
    monday: Path, capsys: Captured, arguments: list[str], message: str
) -> None:
    assert run(["export", *(argument.replace("{}", str(monday)) for argument in arguments)]) == 2
    output = capsys.readouterr()
    assert output.out == "" and output.err.count("\n") == 1 and message in output.err


def test_a_result_that_failed_its_gate_is_exported_with_exit_code_3(monday: Path, capsys: Captured) -> None:
    summary = monday / "smoothed" / "summary.json"
    document = json.loads(summary.read_text())
    document["quality"]["passed"] = False
    summary.write_text(json.dumps(document))
    assert run(["export", str(monday), "tum"]) == 3
    assert (monday / "smoothed" / "monday.tum").exists()
    assert "failed its quality gate" in capsys.readouterr().err


def test_an_export_is_a_recording_that_can_be_smoothed_again(monday: Path, tmp_path: Path, capsys: Captured) -> None:
    """Position from the smoothed rows, as fixes of another logger, comes out where it was."""
    for form in ("vbo", "racechrono", "aim", "gpx"):
        again = tmp_path / form
        again.mkdir()
        name = f"x{BY_NAME[form].ending}"
        assert run(["export", str(monday), form, "--rate", "10", "--out", str(again / name)]) == 0
        assert run([str(again), "--no-figures", "--no-baseline", "--rate", "10"]) == 0
        first = pl.read_csv(monday / "smoothed" / "trajectory.csv")
        second = pl.read_csv(again / "smoothed" / "trajectory.csv")
        t = second["t_s"].to_numpy() + first["t_s"][0]
        latitude = np.interp(t, first["t_s"].to_numpy(), first["lat_deg"].to_numpy())
        assert np.max(np.abs(second["lat_deg"].to_numpy() - latitude)) * 111_195 < 0.3  # m, its own smoothing


def test_evo_finds_the_error_that_evaluate_prints(monday: Path, capsys: Captured) -> None:
    """The absolute error of evo is of all three axes; evaluate gives the horizontal and the vertical part."""
    assert run(["export", str(monday), "tum"]) == 0
    capsys.readouterr()
    assert run(["evaluate", str(monday), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)["smoother"]
    estimate = file_interface.read_tum_trajectory_file(monday / "smoothed" / "monday.tum")
    reference = truth_of(monday, estimate.timestamps)
    result = main_ape.ape(reference, estimate, PoseRelation.translation_part)
    wanted = np.hypot(printed["horizontal_rms_m"], printed["up_rms_m"])
    assert result.stats["rmse"] == pytest.approx(wanted, rel=2e-3)


def truth_of(directory: Path, t: np.ndarray) -> PoseTrajectory3D:
    """truth.csv in n of the results, at times t of its span."""
    place = json.loads((directory / "smoothed" / "summary.json").read_text())["origin"]
    truth = pl.read_csv(directory / "truth.csv")
    lat, lon, alt = (truth[name].to_numpy() for name in ("lat_deg", "lon_deg", "alt_m"))
    position_n = geodetic_to_nwu(lat, lon, alt, Origin(**place))
    at = np.stack([np.interp(t, truth["t_s"].to_numpy(), position_n[:, i]) for i in range(3)], axis=-1)
    return PoseTrajectory3D(at, np.tile([1.0, 0.0, 0.0, 0.0], (t.size, 1)), t)
