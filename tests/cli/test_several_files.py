"""Several recordings in one folder that each stand alone: none takes the place of another's results."""

import json
from pathlib import Path

import pytest

from smoother.batch.find import find_sessions
from smoother.cli.directories import usual_output
from smoother.cli.main import run

QUICK = ["--no-figures", "--no-baseline"]
Captured = pytest.CaptureFixture[str]


def gpx(offset: float) -> str:
    points = "".join(
        f'<trkpt lat="{45 + offset + 1e-4 * k:.6f}" lon="{12 + 1e-6 * k * k:.6f}"><ele>8</ele>'
        f"<time>2024-05-01T10:00:{k:02d}Z</time></trkpt>"
        for k in range(50)
    )
    return f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>"


def table(offset: float) -> str:
    rows = [f"{k},{45 + offset + 1e-4 * k:.6f},{12 + 1e-6 * k * k:.6f}" for k in range(50)]
    return "\n".join(["t_s,lat_deg,lon_deg", *rows, ""])


def origin(directory: Path) -> float:
    return float(json.loads((directory / "summary.json").read_text())["origin"]["lat_deg"])


@pytest.mark.parametrize(("ending", "content"), [("gpx", gpx), ("csv", table)])
def test_results_of_each_are_kept(tmp_path: Path, ending: str, content: object, capsys: Captured) -> None:
    files = [tmp_path / f"2024.05.0{number}.{ending}" for number in (1, 2)]
    for number, file in enumerate(files):
        file.write_text(content(0.1 * number))  # type: ignore[operator]
        assert run([str(files[0]), *QUICK]) == 0
    assert run([str(files[1]), *QUICK]) == 0
    one, two = (tmp_path / "smoothed" / file.stem for file in files)
    assert (origin(one), origin(two)) == (45.0, 45.1)
    assert origin(tmp_path / "smoothed") == 45.0  # of the time when the first was alone
    written = (one / "trajectory.csv").stat().st_mtime_ns
    assert run(["export", str(files[0]), "tum"]) == 0
    assert (one / "trajectory.csv").stat().st_mtime_ns == written and list(one.glob("*.tum"))
    assert "replaced" not in capsys.readouterr().err


def test_smooth_and_batch_agree_where_results_go(tmp_path: Path) -> None:
    names = ["a.gpx", "b.gpx", "b.vbo", "monday/gps.csv", "monday/phone.gpx", "monday/phone.csv", "alone/a.gpx"]
    for name in [*names, "walk/a.nmea", "walk/imu.csv"]:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("t_s,lat_deg,lon_deg\n" if name.endswith("csv") else "")
    places = {
        "a.gpx": "smoothed/a",
        "b.gpx": "smoothed/b",
        "b.vbo": "smoothed/b",
        "monday": "monday/smoothed",
        "monday/gps.csv": "monday/smoothed",
        "monday/phone.gpx": "monday/smoothed/phone",
        "monday/phone.csv": "monday/smoothed/phone",
        "alone/a.gpx": "alone/smoothed",
        "walk/a.nmea": "walk/smoothed",
    }
    for name, place in places.items():
        assert usual_output(tmp_path / name) == tmp_path / place, name
        (task,) = find_sessions([tmp_path / name]).tasks
        assert task.out == (tmp_path / place).resolve(), name


def test_replaced_results_of_another_recording_are_reported(tmp_path: Path, capsys: Captured) -> None:
    out = ["--out", str(tmp_path / "out")]
    for number, name in enumerate(("rc1.gpx", "rc2.gpx")):
        (tmp_path / name).write_text(gpx(0.1 * number))
    assert run([str(tmp_path / "rc1.gpx"), *out, *QUICK]) == 0
    assert run([str(tmp_path / "rc1.gpx"), *out, *QUICK]) == 0
    assert "replaced" not in capsys.readouterr().err
    assert run([str(tmp_path / "rc2.gpx"), *out, *QUICK]) == 0
    assert "held the results of another recording (rc1), which were replaced" in capsys.readouterr().err
