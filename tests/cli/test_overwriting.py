"""`--out FILE` of export and compare never writes over what was recorded, and does over an earlier export."""

import shutil
from pathlib import Path

import pytest

from smoother.cli.exporting import FORMAT_NAMES
from smoother.cli.main import run
from smoother.cli.pipeline import Options
from smoother.export.formats import BY_NAME

DATA = Path(__file__).parent.parent / "data"
Captured = pytest.CaptureFixture[str]


@pytest.fixture(autouse=True)
def tables_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """No figures where a session is smoothed first: nothing here looks at them."""
    monkeypatch.setattr("smoother.cli.results.Options", lambda: Options(baseline=False, figures=False))


@pytest.fixture(scope="module")
def smoothed(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the simulated session with its results."""
    directory = Path(shutil.copytree(simulated, tmp_path_factory.mktemp("smoothed") / "monday"))
    assert run([str(directory), "--no-figures", "--no-baseline"]) == 0
    return directory


def assert_refused(arguments: list[str], out: Path, captured: Captured) -> None:
    before = out.read_bytes()
    assert run([*arguments, "--out", str(out)]) == 2
    said = captured.readouterr()
    assert out.read_bytes() == before
    assert said.out == "" and said.err.count("\n") == 1
    assert said.err.startswith(f"smooth: {out}: ") and "--out" in said.err


@pytest.mark.parametrize("name", ["gps.csv", "imu.csv", "mag.csv", "session.toml", "truth.csv"])
def test_a_file_of_the_session_is_not_written_over_and_nothing_is_computed(
    monday: Path, capsys: Captured, name: str
) -> None:
    assert_refused(["export", str(monday), "tum"], monday / name, capsys)
    assert_refused(["compare", str(monday), str(monday)], monday / name, capsys)
    assert not (monday / "smoothed").exists()


def test_a_link_to_a_file_of_the_session_is_that_file(monday: Path, tmp_path: Path, capsys: Captured) -> None:
    link = tmp_path / "run.tum"
    link.symlink_to(monday / "imu.csv")
    assert_refused(["export", str(monday), "tum"], link, capsys)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("LOG00001.KLG", (DATA / "golden.klg").read_bytes()),
        ("run.nmea", b"$GPRMC,100000.00,A,4502.0000,N,01208.9400,E,18.0,0.0,310524,,,A*5E\r\n" * 9),
        ("imu.csv", b"t_s,ax,ay,az,gx,gy,gz\n0.0,1,2,3,4,5,6\n"),
        ("out.txt", b"YY\0\0\0\0"),
        ("run.gpx", b'<?xml version="1.0"?><gpx creator="another">'),
    ],
)
def test_a_recording_elsewhere_is_not_written_over(
    monday: Path, tmp_path: Path, capsys: Captured, name: str, content: bytes
) -> None:
    (tmp_path / name).write_bytes(content)
    assert_refused(["export", str(monday), "gpx"], tmp_path / name, capsys)


@pytest.mark.parametrize("name", ["gps.csv", "trajectory.csv", "summary.json"])
def test_results_are_not_written_over(smoothed: Path, capsys: Captured, name: str) -> None:
    assert_refused(["export", str(smoothed), "aim"], smoothed / "smoothed" / name, capsys)


@pytest.mark.parametrize("form", FORMAT_NAMES)
def test_an_earlier_export_is_written_over_wherever_it_lies(smoothed: Path, tmp_path: Path, form: str) -> None:
    for out in (smoothed / f"run{BY_NAME[form].ending}", tmp_path / f"run{BY_NAME[form].ending}", tmp_path / "gps.csv"):
        for _ in range(2):
            assert run(["export", str(smoothed), form, "--out", str(out)]) == 0
        out.unlink()


def test_an_export_into_the_folder_of_a_recording_of_its_name_leaves_it(
    smoothed: Path, tmp_path: Path, capsys: Captured
) -> None:
    recording = tmp_path / "monday.vbo"
    assert run(["export", str(smoothed), "vbo", "--out", str(recording)]) == 0
    recording.write_bytes(recording.read_bytes().replace(b"kart-smoother", b"another box"))
    before = recording.read_bytes()
    capsys.readouterr()
    assert run(["export", str(recording), "vbo", "--out", str(tmp_path)]) == 2
    assert f"smooth: {recording}: belongs to the session" in capsys.readouterr().err
    assert recording.read_bytes() == before
