"""`smooth calibrate`, from files to files, and what `smooth SESSION` then says."""

import json
from pathlib import Path

import numpy as np
import pytest

from calib.outcome import Comparison
from smoother.calibration import load_calibration
from smoother.cli.calibrating import _comparison_text, _pair
from smoother.cli.main import run
from smoother.sim.bench import BenchPlan, simulate_bench, write_bench
from smoother.sim.record import write_csv
from smoother.sim.scenario import ImuErrors, MagErrors
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

FIELD_N = np.array([22.0, -1.2, -42.0])


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(5)
    imu = ImuErrors(rate=100.0, accel_noise=0.004, gyro_noise=0.01 * DEG, accel_bias=np.array([0.2, -0.3, 0.1]))
    mag = MagErrors(rate=40.0, noise=0.01, hard_iron_s=np.array([20.0, -30.0, 10.0]))
    directory = tmp_path_factory.mktemp("bench")
    plan = BenchPlan(still=65.0, positions=12, rest=5.0, waving=30.0)
    write_bench(simulate_bench(imu, mag, FIELD_N, rng, plan), directory)
    return directory


def test_it_writes_the_calibration_and_a_page_and_prints_before_and_after(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["calibrate", str(bench), "--out", str(tmp_path), "--place", "45.0,12.0", "--date", "2026-05-16"]) == 0
    said = capsys.readouterr().out
    assert "before" in said and "after" in said and "±" in said
    assert said.strip().splitlines()[-1] == str(tmp_path / "calibration.html")
    page = (tmp_path / "calibration.html").read_text()
    assert page.count("data:image/png;base64,") == len(list((tmp_path / "calibration").glob("*.png"))) >= 5
    assert "://" not in page  # opens without a network
    found = load_calibration(tmp_path / "calibration.toml")
    np.testing.assert_allclose(found.accel_offset, [0.2, -0.3, 0.1], atol=0.01)
    np.testing.assert_allclose(found.hard_iron, [20.0, -30.0, 10.0], atol=0.3)


@pytest.mark.parametrize(
    ("value", "sigma", "text"),
    [
        (199.990275, 0.000013, "199.990 ± below 0.001"),
        (9.9995, 0.0, "9.99950 ± below 0.00001"),
        (98.85981, 0.0011, "98.8598 ± 0.0011"),
        (0.001099, 4.3e-6, "0.0010990 ± 0.0000043"),
        (-0.85258, 0.0001, "-0.85258 ± 0.00010"),
        (0.0, 0.0015, "0.0000 ± 0.0015"),
        (0.0, 0.0, "0"),
    ],
)
def test_numbers_have_no_more_digits_than_count_and_a_sigma_is_never_nought(
    value: float, sigma: float, text: str
) -> None:
    assert _pair(value, sigma) == text


def test_a_reason_of_two_recordings_is_reported_once_with_both(
    bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("still", "again"):
        (tmp_path / name).mkdir()
        rows = (bench / "imu.csv").read_text().splitlines()
        (tmp_path / name / "imu.csv").write_text("\n".join(rows[:6000]) + "\n")
    still = [str(tmp_path / name) for name in ("still", "again")]
    assert run(["calibrate", *still, "--out", str(tmp_path), "--no-figures"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert said.count("1 resting position in different directions: too few") == 1
    assert "ten seconds each (still, again)" in said
    assert "1 rest, " in said


def test_json_holds_every_value_with_its_sigma(bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["calibrate", str(bench), "--out", str(tmp_path), "--no-figures", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    procedures = {one["procedure"]: one for one in document["procedures"]}
    offset = next(value for value in procedures["accelerometer"]["values"] if value["name"] == "offset")
    assert len(offset["value"]) == len(offset["sigma"]) == 3
    assert not (tmp_path / "calibration.html").exists()


def test_values_of_other_sensors_in_an_earlier_calibration_are_kept(bench: Path, tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(
        "[gyroscope]\nbias = [1.0, 2.0, 3.0]\n[magnetometer]\nhard_iron = [1.0, 2.0, 3.0]\n"
        "soft_iron = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n[mine]\nnote = 'box 7'\n"
    )
    only_mag = tmp_path / "mag"
    only_mag.mkdir()
    (only_mag / "mag.csv").write_text((bench / "mag.csv").read_text())
    assert run(["calibrate", str(only_mag), "--out", str(tmp_path), "--no-figures"]) == 0
    found = load_calibration(tmp_path / "calibration.toml")
    np.testing.assert_array_equal(found.gyro_bias, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(found.hard_iron, [20.0, -30.0, 10.0], atol=0.3)
    assert 'note = "box 7"' in (tmp_path / "calibration.toml").read_text()


@pytest.mark.parametrize("where", [".", ".."])
def test_smooth_uses_the_calibration_and_reports_it(
    where: str, bench: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    session = tmp_path / "session"
    write_csv(simulate_preset("kart", 1, duration=30.0), session)
    (session / "truth.csv").unlink()
    (session / where / "calibration.toml").write_text("[accelerometer]\noffset = [0.2, -0.3, 0.1]\n")
    assert run([str(session), "--no-figures", "--no-baseline"]) in (0, 3)
    name = "calibration.toml" if where == "." else "../calibration.toml"
    assert f"accelerometer offset (by {name})" in " ".join(capsys.readouterr().out.split())
    summary = json.loads((session / "smoothed" / "summary.json").read_text())
    assert summary["calibration"] == [
        {"quantity": "accel_offset", "value": [0.2, -0.3, 0.1], "sigma": None, "unit": "m/s^2", "source": name}
    ]


def test_a_simulated_session_is_not_calibrated_by_the_folder_above(tmp_path: Path) -> None:
    from smoother.calibration import find_calibration

    (tmp_path / "calibration.toml").write_text("")
    (tmp_path / "session").mkdir()
    assert find_calibration(tmp_path / "session") is not None
    (tmp_path / "session" / "truth.csv").write_text("")
    assert find_calibration(tmp_path / "session") is None


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["calibrate"], "no session given"),
        (["calibrate", "nowhere"], "no such file"),
        (["calibrate", ".", "--place", "here"], "wanted two numbers"),
        (["calibrate", ".", "--date", "May"], "wanted a date"),
        (["calibrate", "."], "nothing to calibrate from"),
    ],
)
def test_wrong_usage_is_one_line_and_exit_code_2(
    arguments: list[str], says: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(arguments) == 2
    said = capsys.readouterr().err
    assert says in said
    assert len(said.strip().splitlines()) == 1


def test_a_drive_without_a_stop_is_still_checked_for_timing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(6)
    values = rng.normal([0.0, 0.0, 9.8, 0.0, 0.0, 0.0], [3.0, 3.0, 3.0, 1.0, 1.0, 1.0], (3000, 6))
    lines = [f"{i / 25:.3f}," + ",".join(f"{value:.5f}" for value in row) for i, row in enumerate(values)]
    (tmp_path / "imu.csv").write_text("t_s,ax,ay,az,gx,gy,gz\n" + "\n".join(lines) + "\n")
    assert run(["calibrate", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "motion sensor, rate" in said.out
    assert "no calibration.toml is written" in said.err
    assert not (tmp_path / "calibration.toml").exists()


def test_a_recording_without_information_is_refused_with_the_reasons(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = "\n".join(f"{i / 50:.3f},1.0,2.0,3.0" for i in range(500))
    (tmp_path / "mag.csv").write_text("t_s,mx,my,mz\n" + rows + "\n")
    assert run(["calibrate", str(tmp_path)]) == 2
    assert "the points are constant" in capsys.readouterr().err


def test_a_residual_too_small_to_show_is_given_as_below() -> None:
    said = _comparison_text(Comparison("mean rate at rest, rms", 1.2344, 8.022e-07, "deg/s"))
    assert said == "1.234 deg/s before, below 0.001 deg/s after"
