"""`smooth batch` as a person calls it, on sessions of GPS alone, which take a second each."""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from smoother.batch.page import page
from smoother.cli.main import run
from smoother.documents import STAGING

Captured = pytest.CaptureFixture[str]
QUICK = ["--no-baseline"]
BATCH = (sys.executable, "-P", "-m", "smoother.cli", "batch")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    directory = tmp_path_factory.mktemp("recorded") / "run"
    arguments = ["--duration", "140", "--seed", "4", "--preset", "white", "--no-imu", "--no-mag", "--track", "tinbarn"]
    assert run(["simulate", str(directory), *arguments]) == 0
    (directory / "truth.csv").unlink()
    return directory


@pytest.fixture
def day(recorded: Path, tmp_path: Path) -> Path:
    """Two karts with a session each, and a third whose receiver saw no sky."""
    for kart, driver in (("kart1", "Ann"), ("kart2", "<script>"), ("kart10", "Cay")):
        session = tmp_path / "day" / kart / "run1"
        shutil.copytree(recorded, session)
        (session / "session.toml").write_text(f'[session]\ndriver = "{driver}"\n')
    (tmp_path / "day" / "kart10" / "run1" / "gps.csv").write_text("t_s,lat_deg,lon_deg\n1,nan,nan\n")
    return tmp_path / "day"


def index(directory: Path) -> dict[str, dict[str, object]]:
    document = json.loads((directory / "sessions.json").read_text(encoding="utf-8"))
    return {session["session"]: session for session in document["sessions"]}


def test_a_day_is_smoothed_and_smoothed_again_only_where_something_changed(day: Path, capsys: Captured) -> None:
    assert run(["batch", str(day), *QUICK]) == 2  # one is unusable
    told = capsys.readouterr()
    assert told.out.rstrip("\n").splitlines()[-1] == str(day / "sessions.html")
    assert "best laps of karts" in told.out
    assert "day/kart10/run1: gps.csv: no usable fix" in told.err
    first = index(day)
    assert [session["code"] for session in first.values()] == [0, 0, 2]
    assert list(first) == ["day/kart1/run1", "day/kart2/run1", "day/kart10/run1"]
    assert all((day / str(session["report"])).is_file() for session in first.values() if session["code"] == 0)
    assert first["day/kart2/run1"]["driver"] == "<script>"
    assert first["day/kart1/run1"]["best_s"] == first["day/kart2/run1"]["best_s"]
    assert not list(day.rglob("*.png"))

    (day / "kart2" / "run1" / "session.toml").write_text('[session]\ndriver = "Bob"\n')
    shutil.copy(day / "kart1/run1/gps.csv", day / "kart10/run1/gps.csv")
    assert run(["batch", str(day), *QUICK, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [session["kept"] for session in document["sessions"]] == [True, False, False]
    assert [session["driver"] for session in document["sessions"]] == ["Ann", "Bob", "Cay"]
    assert [best["driver"] for best in document["tracks"][0]["drivers"]] == ["Ann", "Bob", "Cay"]


def test_results_and_index_go_where_they_are_asked_to(day: Path, tmp_path: Path, capsys: Captured) -> None:
    shutil.rmtree(day / "kart2")
    shutil.rmtree(day / "kart10")
    before = sorted(day.rglob("*"))
    out = tmp_path / "out"
    assert run(["batch", str(day), "--out", str(out), "--no-figures", *QUICK]) == 0
    assert sorted(day.rglob("*")) == before
    assert (out / "day" / "kart1" / "run1" / "summary.json").is_file()
    assert capsys.readouterr().out.rstrip("\n").splitlines()[-1] == str(out / "sessions.html")
    assert run(["batch", str(day), "--out", str(out), "--no-figures", *QUICK, "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["sessions"][0]["kept"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "no session given"),
        (["nowhere"], "no such file"),
        (["."], "no session found"),
        ([".", "--jobs", "0"], "--jobs"),
        (["kart1", "--scheduler", "tcp://127.0.0.1:1"], "no Dask scheduler answers"),
    ],
)
def test_wrong_usage_is_one_line(
    arguments: list[str], words: str, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("smoother.batch.cluster.PATIENCE", 0.5)
    if "kart1" in arguments:
        shutil.copytree(recorded, tmp_path / "kart1")
    assert run(["batch", *arguments]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1


def left(day: Path) -> list[Path]:
    return list(day.rglob(f"{STAGING}*")) + list(day.rglob("*.tmp"))


@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 130), (signal.SIGHUP, 130)])
def test_a_batch_that_is_stopped_leaves_nothing_half_and_is_continued(
    number: signal.Signals, code: int, day: Path
) -> None:
    (day / "kart10/run1/gps.csv").unlink()
    batch = subprocess.Popen([*BATCH, day, *QUICK, "--jobs", "1"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    with batch:
        deadline = time.monotonic() + 60.0
        while not list(day.rglob(f"{STAGING}*")) and time.monotonic() < deadline:  # of a session
            time.sleep(0.02)
        batch.send_signal(number)
        assert batch.wait(30.0) == code
        assert batch.stderr is not None
        said = batch.stderr.read().decode()
    assert left(day) == []
    states = [session["state"] for session in index(day).values()]
    assert states.count("waiting") >= 1
    assert [(day / name).is_dir() for name in ("kart1/run1/smoothed", "kart2/run1/smoothed")].count(True) == (
        states.count("done")
    )
    wanted = f"smooth: stopped; {states.count('done')} of 2 sessions done. The same command does the rest"
    assert said.splitlines()[-1] == wanted
    if number == signal.SIGINT:
        assert subprocess.run([*BATCH, day, *QUICK], capture_output=True, check=False).returncode == 0
        assert [session["state"] for session in index(day).values()] == ["done", "done"]


def test_a_batch_that_is_stopped_while_it_writes_its_first_index_has_one(
    day: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[None] = []

    def stopped_once(title: str, *rest: Any) -> str:
        calls.append(None)
        if len(calls) == 1:
            raise KeyboardInterrupt
        return page(title, *rest)

    monkeypatch.setattr("smoother.batch.index.page", stopped_once)
    assert run(["batch", str(day), *QUICK]) == 130
    assert left(day) == []
    assert (day / "sessions.html").is_file()
    assert [session["state"] for session in index(day).values()] == ["waiting"] * 3


def test_a_stopped_batch_with_again_reports_how_to_continue(
    day: Path, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    def stopped(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("smoother.batch.local.run_here", stopped)
    assert run(["batch", str(day), *QUICK, "--again"]) == 130
    wanted = "smooth: stopped; 0 of 3 sessions done. The same command without --again does the rest"
    assert capsys.readouterr().err.splitlines()[-1] == wanted


def test_a_batch_that_is_killed_is_continued(day: Path) -> None:
    (day / "kart10/run1/gps.csv").unlink()
    with subprocess.Popen(
        [*BATCH, day, *QUICK, "--jobs", "2"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as batch:
        time.sleep(1.0)
        batch.kill()
    assert subprocess.run([*BATCH, day, *QUICK], capture_output=True, check=False).returncode == 0
    assert [session["state"] for session in index(day).values()] == ["done", "done"]


def test_what_went_wrong_anywhere_decides_the_exit_code() -> None:
    from smoother.batch.entries import Entry
    from smoother.batch.outcome import Outcome, State
    from smoother.batch.task import Task
    from smoother.cli.batching import exit_code

    def of(*states: State) -> int:
        return exit_code([Entry(Task(Path(), Path(), (), ""), Outcome(state)) for state in states])

    assert of("done", "done") == 0
    assert of("done", "doubtful") == 3
    assert of("doubtful", "unusable", "done") == 2
    assert of("doubtful", "limit") == 2
    assert of("broken", "unusable") == 1
    assert of("lost") == 1
