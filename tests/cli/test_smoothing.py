"""`smooth SESSION` from files to files: what is written, what is said, and how it ends."""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import polars as pl
import pytest

from smoother.cli import pipeline
from smoother.cli.main import run
from smoother.estimate.judge.quality import Quality

TABLES_ONLY = ["--no-figures", "--no-baseline"]
Captured = pytest.CaptureFixture[str]


def contents(directory: Path) -> dict[str, str]:
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in directory.iterdir() if path.is_file()}


def test_results_that_no_longer_hold_do_not_stay_behind(monday: Path, capsys: Captured) -> None:
    out = monday / "smoothed"
    (out / "figures").mkdir(parents=True)
    mine = out / "figures" / "mine.png"
    for path in (mine, out / "baseline.csv", out / "report.html", out / "figures" / "overview.png"):
        path.write_bytes(b"of an earlier run")
    assert run([str(monday), *TABLES_ONLY]) == 0
    assert capsys.readouterr().out.rstrip("\n").splitlines()[-1] == str(out / "trajectory.csv")
    assert not (out / "baseline.csv").exists()
    assert not (out / "report.html").exists()
    assert list((out / "figures").iterdir()) == [mine]


def test_what_is_removed_of_an_earlier_run_is_reported_and_leaves_no_empty_folder(
    monday: Path, capsys: Captured
) -> None:
    out = monday / "smoothed"
    assert run([str(monday)]) == 0
    pictures = len(list((out / "figures").iterdir()))
    assert "removed" not in capsys.readouterr().err
    assert run([str(monday), "--json", *TABLES_ONLY]) == 0
    output = capsys.readouterr()
    json.loads(output.out)
    (said,) = output.err.splitlines()
    assert f"{out}: removed baseline.csv, report.html and {pictures} figures of an earlier run" in said
    assert not (out / "figures").exists()
    assert run([str(monday), *TABLES_ONLY]) == 0
    assert capsys.readouterr().err == ""


def test_fixes_alone_show_nothing_of_an_unused_motion_sensor(monday: Path, capsys: Captured) -> None:
    samples = pl.read_csv(monday / "imu.csv")
    samples[::20].write_csv(monday / "imu.csv")
    assert run([str(monday), *TABLES_ONLY]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "no usable IMU samples, smoothed from GPS only" in text and "GPS slow error" in text
    for row in ("mounting", "antenna from logger", "accelerometer noise", "gyroscope noise"):
        assert row not in text
    (monday / "imu.csv").unlink()
    assert run([str(monday), *TABLES_ONLY]) == 0
    assert "fixes, no IMU, smoothed from GPS only" in capsys.readouterr().out


def test_a_recording_is_no_place_for_results(monday: Path, simulated: Path, tmp_path: Path, capsys: Captured) -> None:
    tuesday = Path(shutil.copytree(simulated, tmp_path / "tuesday"))
    for place in (monday, tuesday):
        before = contents(place)
        assert run([str(monday), "--out", str(place)]) == 2
        assert "would be overwritten" in capsys.readouterr().err
        assert contents(place) == before


@pytest.mark.parametrize(
    ("name", "content", "settings"),
    [
        ("calibration.toml", "[accelerometer", ""),
        ("official.csv", "404, not found", ""),
        ("mine.geojson", "{", '[session]\ntrack = "mine.geojson"\n'),
    ],
)
def test_what_keeps_a_session_from_being_smoothed_is_seen_at_the_track(
    monday: Path, capsys: Captured, name: str, content: str, settings: str
) -> None:
    (monday / name).write_text(content)
    (monday / "session.toml").write_text(settings)
    assert run([str(monday), *TABLES_ONLY]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and name in said
    assert run(["check", str(monday)]) == 2
    assert capsys.readouterr().err == said


def test_a_mirrored_sensor_is_reported_and_not_good_to_drive(tmp_path: Path, capsys: Captured) -> None:
    monday = tmp_path / "monday"
    assert run(["simulate", str(monday), "--duration", "60", "--seed", "3"]) == 0
    assert run(["check", str(monday)]) == 0
    samples = pl.read_csv(monday / "imu.csv")
    samples.with_columns(-pl.col("ay"), -pl.col("gy")).write_csv(monday / "imu.csv")
    capsys.readouterr()
    assert run([str(monday), "--json", *TABLES_ONLY]) == 3
    document = json.loads(capsys.readouterr().out)
    assert any("not right-handed" in reason for reason in document["quality"]["reasons"])
    assert "imu_mirrored" in [problem["code"] for problem in document["problems"]]
    assert run(["check", str(monday), "--json"]) == 3
    assert any("not right-handed" in reason for reason in json.loads(capsys.readouterr().out)["reasons"])


@pytest.mark.parametrize("coordinate", ["lon_deg", "lat_deg"])
def test_a_mirrored_track_fails_the_gate(tmp_path: Path, capsys: Captured, coordinate: str) -> None:
    monday = tmp_path / "monday"
    assert run(["simulate", str(monday), "--duration", "60", "--seed", "3"]) == 0
    fixes = pl.read_csv(monday / "gps.csv")
    fixes.with_columns(-pl.col(coordinate)).write_csv(monday / "gps.csv")
    capsys.readouterr()
    assert run([str(monday), "--json", *TABLES_ONLY]) == 3
    document = json.loads(capsys.readouterr().out)
    assert any("longitude or latitude has the wrong sign" in problem["text"] for problem in document["problems"])


@pytest.fixture(scope="module")
def results(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("results") / "smoothed"
    assert run([str(simulated), "--out", str(out), *TABLES_ONLY]) == 0
    return out


def test_results_are_no_recording(monday: Path, capsys: Captured) -> None:
    assert run([str(monday), *TABLES_ONLY]) == 0
    assert run([str(monday / "smoothed"), *TABLES_ONLY]) == 2
    assert "holds results, not a recording" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["trajectory.csv", "laps.csv", "monday.vbo"])
@pytest.mark.parametrize(
    "command",
    [[], ["check"], ["laps"], ["batch"], ["export", "FILE", "gpx"], ["compare", "FILE", "FILE"], ["evaluate"]],
    ids=lambda command: " ".join(command) or "smooth",
)
def test_a_file_of_results_is_no_recording_either(
    results: Path, tmp_path: Path, capsys: Captured, name: str, command: list[str]
) -> None:
    place = Path(shutil.copytree(results, tmp_path / "smoothed"))
    (place / name).touch()
    file = str(place / name)
    words = [file if word == "FILE" else word for word in command]
    assert run(words if file in words else [*command, file]) == 2
    said = capsys.readouterr().err
    assert "no recording" in said.replace("not a", "no") and "name the folder it was made from" in said
    assert not (place / "smoothed").exists() and "Traceback" not in said


def test_a_place_that_cannot_be_written_is_one_line(monday: Path, tmp_path: Path, capsys: Captured) -> None:
    (tmp_path / "taken").write_text("a file")
    assert run([str(monday), "--out", str(tmp_path / "taken")]) == 2
    output = capsys.readouterr()
    assert output.err.count("\n") == 1
    assert f"{tmp_path / 'taken'}: a file, where a folder for the results is wanted; move it, or" in output.err
    assert "--out DIR" in output.err


def test_a_file_called_as_the_folder_for_the_results_is_named(
    monday: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    (monday / "smoothed").write_text("")
    said = "a file, where a folder for the results is wanted; move it, or name another place with --out DIR"
    monkeypatch.chdir(tmp_path)
    assert run([str(monday), *TABLES_ONLY]) == 0
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"smooth: {monday / 'smoothed'}: {said}; the results go to smoothed/monday"
    monkeypatch.chdir(monday)
    assert run([".", *TABLES_ONLY]) == 2
    assert capsys.readouterr().err.splitlines()[-1] == f"smooth: smoothed: {said}"


def test_a_folder_where_a_result_is_to_go_is_named_and_nothing_is_written_beside_it(
    monday: Path, capsys: Captured
) -> None:
    (folder := monday / "smoothed" / "trajectory.csv").mkdir(parents=True)
    assert run([str(monday), *TABLES_ONLY]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"smooth: {folder}: a folder, where a file of the results is wanted; move it, or")
    assert [path.name for path in (monday / "smoothed").iterdir()] == ["trajectory.csv"]


def test_a_locked_card_sends_its_results_to_the_working_directory(
    monday: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    made = Path.mkdir

    def mkdir(path: Path, *mode: int, **asked: bool) -> None:
        if monday in path.parents:
            raise PermissionError(13, "Permission denied")
        made(path, *mode, **asked)

    monkeypatch.setattr(Path, "mkdir", mkdir)
    assert run([str(monday), *TABLES_ONLY]) == 0
    output = capsys.readouterr()
    assert output.out.rstrip("\n").splitlines()[-1] == "smoothed/monday/trajectory.csv"
    assert "cannot be written to" in output.err


@pytest.mark.parametrize(
    "command", [[], ["check"], ["laps"], ["evaluate"]], ids=lambda words: " ".join(words) or "smooth"
)
@pytest.mark.parametrize(
    ("spoil", "place"),
    [
        (lambda d: (d / "session.toml").write_text("[session]\ntitel = 1\n"), "fleet/run1/session.toml: "),
        (lambda d: (d / "gps.csv").write_text("t_s,lat_deg,lon_deg\n"), "fleet/run1/gps.csv: "),
        (lambda d: (d / "gps.csv").unlink(), "fleet/run1: "),
    ],
)
def test_an_error_in_a_session_names_its_place(
    monday: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: Captured,
    spoil: Callable[[Path], object],
    place: str,
    command: list[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "fleet").mkdir()
    spoil(monday.rename(tmp_path / "fleet" / "run1"))
    assert run([*command, "fleet/run1"]) == 2
    assert capsys.readouterr().err.startswith(f"smooth: {place}")
    monkeypatch.chdir(tmp_path / "fleet" / "run1")
    assert run([*command, "."]) == 2
    assert "fleet" not in capsys.readouterr().err  # as it was named


@pytest.mark.parametrize("named", [".", "gps.csv", "../run1"])
def test_a_session_that_cannot_be_used_is_named_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured, named: str
) -> None:
    (tmp_path / "run1").mkdir()
    (tmp_path / "run1" / "gps.csv").write_text("t_s,lat_deg,lon_deg,alt_m\n0,45,12,30\n")
    monkeypatch.chdir(tmp_path / "run1")
    assert run([named]) == 2
    assert capsys.readouterr().err == f"smooth: {named}: only one usable fix, which is no track\n"


def test_of_several_sessions_the_path_stands_above_each(
    monday: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    for kart in ("a", "b"):
        shutil.copytree(monday, tmp_path / kart / "run1")
    (tmp_path / "a" / "run1" / "session.toml").unlink()
    (tmp_path / "b" / "run1" / "session.toml").write_text('[session]\ntitle = "Final"\n')
    assert run(["a/run1", "b/run1", *TABLES_ONLY]) == 0
    assert {"a/run1", "b/run1: Final"} <= set(capsys.readouterr().out.splitlines())


def test_a_session_named_by_several_paths_is_smoothed_once_with_a_warning(
    monday: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "link").symlink_to(monday)
    shutil.copytree(monday, tmp_path / "other" / "monday")
    names = ["monday", "monday", "./monday", "link", "other/monday"]
    assert run([*names, "--out", "out", *TABLES_ONLY]) == 0
    said = capsys.readouterr()
    assert said.err.splitlines() == ["smooth: monday: named 4 times (also as link); taken once"]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["monday", "monday-2"]
    assert run(["other/monday", "other/monday", *TABLES_ONLY]) == 0
    assert capsys.readouterr().err.splitlines() == ["smooth: other/monday: named 2 times; taken once"]


def test_a_result_that_fails_its_gate_is_written_reported_and_exit_code_3(
    monday: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    failed = Quality(False, ("the trajectory leaves the fixes for 40 s",), {})
    monkeypatch.setattr("smoother.estimate.judge.quality.assess", lambda session, estimate: failed)
    assert run([str(monday), *TABLES_ONLY]) == 3
    output = capsys.readouterr()
    assert output.err.count("\n") == 1
    assert "failed its quality gate: the trajectory leaves the fixes for 40 s" in output.err
    assert "NOT TO BE TRUSTED" in output.out
    assert json.loads((monday / "smoothed" / "summary.json").read_text())["quality"]["passed"] is False


def test_a_bug_keeps_its_traceback(monday: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(path: Path) -> None:
        raise ZeroDivisionError

    monkeypatch.setattr(pipeline, "read", broken)
    with pytest.raises(ZeroDivisionError):  # main() lets it through: Python prints it and exits with 1
        run([str(monday)])


def test_a_title_cannot_give_orders_to_the_terminal(monday: Path, capsys: Captured) -> None:
    (monday / "session.toml").write_text('[session]\ntitle = "\\u001b[31m[bold]red[/bold]\\n$x"\n')
    assert run([str(monday), *TABLES_ONLY]) == 0
    output = capsys.readouterr()
    assert "\x1b" not in output.out
    assert "[31m[bold]red[/bold] $x" in output.out


def console_script() -> str:
    return str(Path(sys.executable).parent / "smooth")


def test_a_reader_that_closes_the_pipe_is_no_error() -> None:
    if shutil.which("bash") is None:
        pytest.skip("needs system package bash")
    command = f"set -o pipefail; {console_script()} --help | head -c 1"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("command", ["simulate --list", "check monday", "laps monday"])
def test_a_table_whose_reader_has_gone_is_no_error(command: str, monday: Path) -> None:
    if shutil.which("bash") is None:
        pytest.skip("needs system package bash")
    piped = f"{console_script()} {command} | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", piped], cwd=monday.parent, capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("0\n", "")


def test_sessions_are_smoothed_whether_or_not_anybody_reads_of_them(monday: Path) -> None:
    if shutil.which("bash") is None:
        pytest.skip("needs system package bash")
    shutil.copytree(monday, monday.with_name("tuesday"))
    piped = f"{console_script()} monday tuesday --no-figures --no-baseline | true; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", piped], cwd=monday.parent, capture_output=True, text=True, check=False)
    assert done.stdout == "0\n"
    assert (monday.with_name("tuesday") / "smoothed" / "trajectory.csv").exists()


def test_output_that_has_no_room_is_one_line() -> None:
    full = Path("/dev/full")
    if not full.exists():
        pytest.skip("needs a device that is full")
    with full.open("w") as out:
        done = subprocess.run([console_script(), "--help"], stdout=out, stderr=subprocess.PIPE, text=True, check=False)
    said = "smooth: what is printed cannot be written (No space left on device)\n"
    assert (done.returncode, done.stderr) == (2, said)


def test_errors_may_have_nowhere_to_go(monday: Path) -> None:
    if shutil.which("bash") is None:
        pytest.skip("needs system package bash")
    command = f"{console_script()} {monday} --no-figures --no-baseline 2>&-"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.returncode == 0 and done.stdout.endswith("trajectory.csv\n")


@pytest.mark.parametrize("to", ["a pipe that nobody reads", "a disk that is full"])
def test_a_warning_that_cannot_be_written_stops_nothing(to: str, monday: Path) -> None:
    (monday / "smoothed").write_text("in the way: a warning comes before anything is smoothed")
    words = [console_script(), "monday", "--no-figures", "--no-baseline"]
    if to == "a disk that is full":
        if not Path("/dev/full").exists():
            pytest.skip("needs a device that is full")
        nowhere = os.open("/dev/full", os.O_WRONLY)
    else:
        reader, nowhere = os.pipe()
        os.close(reader)
    (where := monday.parent / "elsewhere").mkdir()
    words[1] = str(monday)
    done = subprocess.run(words, cwd=where, stdout=subprocess.PIPE, stderr=nowhere, text=True, check=False)
    refused = subprocess.run([console_script(), "nothere"], stderr=nowhere, check=False)
    os.close(nowhere)
    assert done.returncode == 0 and done.stdout.endswith("trajectory.csv\n")
    assert (where / "smoothed" / "monday" / "trajectory.csv").exists()
    assert refused.returncode == 2


@pytest.mark.skipif(sys.platform == "darwin", reason="its file system knows no names that are not UTF-8")
def test_a_folder_whose_name_is_not_utf8_is_a_session(monday: Path, capsys: Captured) -> None:
    folder = monday.rename(monday.with_name(os.fsdecode(b"M\xfcller")))
    name = str(folder)
    for words in ([name], ["laps", name], ["evaluate", name], ["export", name, "tum"], ["check", name]):
        assert run(words) in {0, 3}, words  # 3: half a minute is too short for a check
    assert capsys.readouterr().err == ""
    assert json.loads((folder / "smoothed" / "summary.json").read_text())["session"]["name"] == "M?ller"
    assert {"report.html", "laps.csv", "trajectory.csv"} <= {path.name for path in (folder / "smoothed").iterdir()}


@pytest.mark.parametrize("words", [[""], ["{monday}", "--out", ""], ["laps", ""]])
def test_an_empty_argument_is_not_taken_for_the_folder_one_stands_in(
    words: list[str], monday: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(monday)
    assert run([word.format(monday=monday) for word in words]) == 2
    assert capsys.readouterr().err == ("smooth: an argument is empty; is a variable not set that should hold a name?\n")
    assert not (monday / "smoothed").exists()


def test_a_folder_with_a_line_end_in_its_name_is_named_once(tmp_path: Path, capsys: Captured) -> None:
    (folder := tmp_path / "two\nlines").mkdir()
    assert run([str(folder)]) == 2
    assert capsys.readouterr().err.count("two lines") == 1
