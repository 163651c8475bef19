"""The facade: documents, notebooks and benchmarks use nothing else, and it finds what the command line finds."""

import ast
import inspect
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother import api
from smoother.cli.main import run
from smoother.errors import SessionError, UsageError
from smoother.laps.results import GivenLines, LapAnalysis
from smoother.samples import Session
from smoother.trajectory import Trajectory

ROOT = Path(__file__).resolve().parent.parent
PLAIN = (  # modules that docs/python.md names as stable
    *("api", "arrays", "calibration", "config", "errors", "frames", "samples", "so3", "trajectory", "units"),
    *("laps.results", "sim.scenario"),
)
DRAWING = ("report.style", "report.calibration_figures", "sim.bench", "sim.sensors")  # notebooks, beside PLAIN
PARTS = ("batch", "export", "laps", "live", "report", "sim")  # benchmarks measure these themselves, beside PLAIN
EXCEPTIONS = {  # of benchmarks
    "ablations": ("estimate.factors",),  # whose table has what can be left out
    "lap_wander": ("fit.lap_registration",),  # which it measures
    "lap_closure": ("fit.lap_crossings",),  # at whose stations it measures
    "calibration_honesty": ("fit.allan",),  # the fit of calib that its sigmas are tested of
}


def modules(source: str) -> Iterator[str]:
    """Modules of the package that Python source imports, without `smoother.`."""
    for node in ast.walk(ast.parse(source)):
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            inside = [f"{node.module}.{alias.name}" for alias in node.names]
            names = [name if _is_module(name) else str(node.module) for name in inside]
        yield from (name.removeprefix("smoother.") for name in names if name.split(".")[0] == "smoother")


def _is_module(name: str) -> bool:
    path = ROOT.joinpath(*name.split("."))
    return path.is_dir() or path.with_suffix(".py").is_file()


def beyond(source: str, allowed: tuple[str, ...]) -> list[str]:
    """Imported modules that are none of `allowed`, nor inside one."""
    return [name for name in modules(source) if not any(f"{name}.".startswith(f"{one}.") for one in allowed)]


def code_of(path: Path) -> str:
    """The Python of a document, a notebook or a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".md":
        return "\n".join(re.findall(r"^```python\n(.*?)^```", text, re.MULTILINE | re.DOTALL))
    if path.suffix == ".ipynb":
        return "\n".join("".join(c["source"]) for c in json.loads(text)["cells"] if c["cell_type"] == "code")
    return text


def test_the_document_imports_stable_modules_alone_and_names_them() -> None:
    page = ROOT / "docs" / "python.md"
    assert beyond(code_of(page), PLAIN) == []
    stated = page.read_text(encoding="utf-8").partition("All of it goes through")[2].partition("\n\n")[0]
    assert {name.removeprefix("smoother.") for name in re.findall(r"`([a-z0-9_.]+)`", stated)} >= set(PLAIN)


@pytest.mark.parametrize("path", sorted((ROOT / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_import_stable_modules_and_what_draws(path: Path) -> None:
    assert beyond(code_of(path), (*PLAIN, *DRAWING)) == []


@pytest.mark.parametrize("path", sorted((ROOT / "benchmarks").glob("*.py")), ids=lambda path: path.stem)
def test_benchmarks_import_stable_modules_and_the_parts_that_they_measure(path: Path) -> None:
    assert beyond(code_of(path), (*PLAIN, *PARTS, *EXCEPTIONS.get(path.stem, ()))) == []


@pytest.mark.parametrize(
    "source",
    ["import smoother.estimate.solvers", "from smoother import estimate", "from smoother.session.load import load_raw"],
)
def test_an_import_of_the_inside_is_found(source: str) -> None:
    assert len(beyond(source, (*PLAIN, *PARTS))) == 1


def test_every_exception_is_needed() -> None:
    for name, allowed in EXCEPTIONS.items():
        found = set(beyond(code_of(ROOT / "benchmarks" / f"{name}.py"), (*PLAIN, *PARTS)))
        assert {one for one in allowed if any(f"{module}.".startswith(f"{one}.") for module in found)} == set(allowed)


def test_every_public_name_is_a_documented_function() -> None:
    functions = {
        name for name, value in vars(api).items() if inspect.isfunction(value) and value.__module__ == api.__name__
    }
    assert set(api.__all__) == {name for name in functions if not name.startswith("_")}
    for name in api.__all__:
        assert len(inspect.getdoc(getattr(api, name)) or "") > 40, name


# ---- the same figures as the command line ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Both:
    """One session through the facade, and the folders of its results by facade and command."""

    session: Session
    trajectory: Trajectory
    analysis: LapAnalysis
    document: dict[str, object]
    folder: Path
    ours: Path
    theirs: Path


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> Both:
    folder = tmp_path_factory.mktemp("session")
    ours, theirs = tmp_path_factory.mktemp("facade"), tmp_path_factory.mktemp("command")
    simulation = api.simulate("kart", 3, track="tinbarn", duration=100.0)
    api.write_session(simulation, folder)
    session = api.read(folder)
    trajectory = api.smooth(session)
    analysis = api.laps(session, trajectory, folder=folder)
    document = api.write_results(ours, session, trajectory, analysis, api.baseline(session))
    assert run([str(folder), "--out", str(theirs), "--json"]) == 0
    return Both(session, trajectory, analysis, document, folder, ours, theirs)


def test_tables_are_those_of_the_command(both: Both) -> None:
    for name in ("trajectory.csv", "gps.csv", "laps.csv", "baseline.csv"):
        assert (both.ours / name).read_bytes() == (both.theirs / name).read_bytes(), name
    assert len(pl.read_csv(both.ours / "trajectory.csv")) == len(both.trajectory)


def test_the_summary_is_that_of_the_command(both: Both) -> None:
    ours, theirs = (json.loads((folder / "summary.json").read_text()) for folder in (both.ours, both.theirs))
    assert ours.keys() == both.document.keys() == theirs.keys() - {"files"}
    assert len(ours["laps"]) > 2
    for name in ours.keys() - {"options", "timings"}:
        assert ours[name] == theirs[name], name


def test_errors_are_those_of_smooth_evaluate(both: Both, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["evaluate", str(both.folder), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    truth = api.read_truth(both.folder, both.session.origin)
    for key, trajectory in (("smoother", both.trajectory), ("gps", api.gps_alone(both.session))):
        found = api.evaluate(trajectory, truth)
        for name in ("horizontal_rms_m", "relative_1s_rms_m", "horizontal_velocity_rms_mps"):
            assert getattr(found, name) == pytest.approx(printed[key][name], rel=1e-6), (key, name)
    t = truth.t[(truth.t > 20.0) & (truth.t < 60.0)]
    errors = api.errors_between(api.resample(both.trajectory, t), api.resample(truth, t))
    assert np.sqrt(np.mean(errors.velocity_n[:, :2] ** 2)) < 0.5


def test_without_the_motion_sensor_a_session_is_as_one_that_has_none(both: Both) -> None:
    alone = api.smooth(both.session, imu=False)
    assert alone.report.mode == "gps-only"
    assert np.isnan(alone.R_nb).all()
    np.testing.assert_array_equal(alone.position_n, api.smooth(replace(both.session, imu=None, mag=None)).position_n)


def test_options_reach_the_smoother(both: Both) -> None:
    short = replace(both.session, gnss=both.session.gnss.select(np.arange(200)))
    slow = api.smooth(short, rate=10.0)
    np.testing.assert_allclose(np.diff(slow.t), 0.1, atol=1e-9)
    free = api.smooth(short, rate=10.0, wheels=False)
    assert not np.array_equal(free.velocity_n, slow.velocity_n)
    stages: list[str] = []
    api.smooth(short, rate=10.0, solver="isam2", progress=lambda stage, share: stages.append(stage))
    assert stages


def test_factors_that_are_left_out_do_not_count(both: Both) -> None:
    short = replace(both.session, gnss=both.session.gnss.select(np.arange(200)))

    def found(*without: str) -> Trajectory:
        out = api.smooth(short, rate=10.0, without=without)
        assert out.report.mode == "full" and out.report.keyframes is not None
        return out

    with_all = found()
    for name, rows in (("gps_velocity", "gps_velocity"), ("wheels", "slip"), ("standstill", "standstill")):
        less = found(name)
        assert with_all.report.residuals[rows].count > 10 and less.report.residuals[rows].count == 0, name
        assert np.abs(less.velocity_n - with_all.velocity_n).max() > 1e-3, name
    offsets = [np.abs(one.report.keyframes.gps_offset_n).max() for one in (with_all, found("gps_offset"))]
    assert offsets[0] > 0.3 and offsets[1] < 0.01
    with pytest.raises(UsageError, match=r"no factor is called 'gps'; there are .*gps_position, "):
        found("gps")


def test_a_given_line_is_where_laps_begin(both: Both) -> None:
    found = both.analysis.start_line
    assert found is not None
    tangent = np.array([found.left_n[1] - found.right_n[1], found.right_n[0] - found.left_n[0]])
    ends = np.stack([found.left_n, found.right_n]) + 20.0 * tangent / np.linalg.norm(tangent)
    moved = api.laps(both.session, both.trajectory, ends)
    again = api.laps(both.session, both.trajectory, GivenLines(ends))
    assert [lap.start for lap in moved.laps] == [lap.start for lap in again.laps]
    timed, before = ([lap.start for lap in one.laps if lap.is_timed] for one in (moved, both.analysis))
    nearest = np.abs(np.subtract.outer(timed, before)).min(axis=1)
    assert np.all((nearest > 0.3) & (nearest < 5.0))  # s, that 20 m take
    with pytest.raises(UsageError, match="neither a track file"):
        api.laps(both.session, both.trajectory, "no such track")


def test_degrees_per_second_of_a_self_made_session_are_converted(both: Both) -> None:
    raw = api.read_raw(both.folder)
    assert raw.imu is not None
    wrong = replace(raw, imu=replace(raw.imu, gyro_scale=np.degrees(raw.imu.gyro_scale)))
    found = api.prepared(wrong)
    assert found.imu is not None and both.session.imu is not None
    np.testing.assert_allclose(found.imu.angular_rate_s, both.session.imu.angular_rate_s, rtol=1e-9)


def test_even_times_are_those_that_files_get(tmp_path: Path) -> None:
    simulation = api.simulate("kart", 5, duration=40.0)
    api.write_session(simulation, tmp_path)
    even, read = api.prepared(simulation.raw, even_times=True), api.read(tmp_path)
    assert even.imu is not None and read.imu is not None and simulation.raw.imu is not None
    np.testing.assert_allclose(even.imu.t, read.imu.t, atol=1e-5)
    np.testing.assert_allclose(even.gnss.t, read.gnss.t, atol=1e-5)
    assert np.abs(simulation.raw.imu.t - even.imu.t).max() > 1e-4


def test_what_cannot_be_read_raises_one_line(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match="no recording found"):
        api.read(tmp_path)
    with pytest.raises(UsageError, match="no recording 1"):
        api.read(tmp_path, recording=1)
