"""One session in a process of its own: whatever that does, there is an outcome, and nothing half is left."""

import resource
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import pytest
from batch_stand_in import STAND_IN, MakeTask, starts

from smoother.batch.attempt import COMMAND, Stopped, _megabytes, attempt
from smoother.batch.record import finished
from smoother.batch.task import ERROR_LOG
from smoother.documents import STAGING

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are enforced on Linux only")


def left(out: Path) -> list[str]:
    return [path.name for path in out.glob(f"{STAGING}*")]


def own_peak_mb() -> float:
    """Of this process, with which the peak of a child begins: other tests here may have needed a gigabyte."""
    return _megabytes(resource.getrusage(resource.RUSAGE_SELF))


def test_a_good_session_has_its_best_lap_that_counts_and_its_cost(make_task: MakeTask) -> None:
    said = attempt(make_task(), command=STAND_IN)
    assert (said.state, said.code, said.message) == ("done", 0, "")
    facts = said.facts
    assert (facts.best_lap, facts.best_s, facts.best_sigma_s, facts.laps) == (2, 60.25, 0.03, 2)
    assert (facts.driver, facts.track, facts.length_m, facts.problems) == ("D", None, 900.0, 1)
    assert 0.0 < said.cost.cpu_s < 10.0
    assert 1.0 < said.cost.memory_mb < max(400.0, own_peak_mb() + 1.0)
    assert said.cost.starts == 1


def test_a_doubtful_session_has_results_and_reasons(make_task: MakeTask) -> None:
    said = attempt(make_task("doubtful"), command=STAND_IN)
    assert (said.state, said.code) == ("doubtful", 3)
    assert "far from the fixes" in said.message
    assert said.has_results


def test_an_unusable_session_has_its_own_message(make_task: MakeTask) -> None:
    task = make_task("unusable")
    (task.session / "SESSION.TOML").write_text('[session]\ndriver = "E"\nkart = "7"\n')
    said = attempt(task, command=STAND_IN)
    assert (said.state, said.code, said.message) == ("unusable", 2, "gps.csv: no usable fix")
    assert (said.facts.driver, said.facts.kart) == ("E", "7")
    assert not said.has_results


def test_a_crash_is_an_outcome_and_its_words_are_kept(make_task: MakeTask) -> None:
    task = make_task("crash")
    said = attempt(task, command=STAND_IN)
    assert (said.state, said.code) == ("broken", 1)
    assert "SIGSEGV" in said.message
    assert "Segmentation fault" in (task.out / ERROR_LOG).read_text()
    assert left(task.out) == []


def test_a_bug_is_reported_in_one_clean_line_until_it_is_gone(make_task: MakeTask) -> None:
    task = make_task("bug")
    said = attempt(task, command=STAND_IN)
    assert (said.state, said.code) == ("broken", 1)
    assert "ZeroDivisionError: a [31m <b>" in said.message
    assert said.message.isprintable()
    assert "Traceback" in (task.out / ERROR_LOG).read_text()
    assert attempt(make_task("fine"), command=STAND_IN).state == "done"
    assert not (task.out / ERROR_LOG).exists()


def test_a_session_that_hangs_is_ended_with_all_that_it_started(make_task: MakeTask) -> None:
    task = make_task("hang", seconds=1.0)
    start = time.monotonic()
    said = attempt(task, command=STAND_IN)
    assert time.monotonic() - start < 20.0
    assert (said.state, said.code) == ("limit", 2)
    assert "1 s" in said.message
    assert left(task.out) == []
    assert starts(task) == 1


@linux_only
def test_a_session_that_grows_beyond_its_limit_is_reported(make_task: MakeTask) -> None:
    said = attempt(make_task("grow", megabytes=200), command=STAND_IN)
    assert (said.state, said.code) == ("limit", 2)
    assert "200 MB" in said.message
    assert attempt(make_task("grow", megabytes=2000), command=STAND_IN).state == "done"


def test_a_session_killed_from_outside_is_started_once_more(make_task: MakeTask) -> None:
    once, twice = make_task("killed 1", "once"), make_task("killed 9", "twice")
    said = attempt(once, command=STAND_IN)
    assert (said.state, said.cost.starts, starts(once)) == ("done", 2, 2)
    said = attempt(twice, command=STAND_IN)
    assert (said.state, said.code, starts(twice)) == ("broken", 1, 2)
    assert "SIGKILL, 2 times" in said.message
    assert left(once.out) == left(twice.out) == []


def test_a_stopped_session_leaves_nothing(make_task: MakeTask) -> None:
    task, stop = make_task("hang"), threading.Event()
    threading.Timer(0.6, stop.set).start()
    with pytest.raises(Stopped):
        attempt(task, stop, STAND_IN)
    assert starts(task) == 1 and not task.out.exists()


def test_folders_that_were_made_for_a_stopped_session_go_and_others_stay(make_task: MakeTask, tmp_path: Path) -> None:
    for made in (tmp_path / "season", tmp_path / "there" / "kart1" / "run"):
        made.mkdir(parents=True)
    for out in ("season/kart1/run", "there/kart1/run"):
        task, stop = replace(make_task("hang", out.replace("/", "-")), out=tmp_path / out), threading.Event()
        threading.Timer(0.6, stop.set).start()
        with pytest.raises(Stopped):
            attempt(task, stop, STAND_IN)
        assert starts(task) == 1
    assert list((tmp_path / "season").iterdir()) == []
    assert (tmp_path / "there" / "kart1" / "run").is_dir()


def test_a_disk_that_is_full_costs_the_record_not_the_outcome(
    make_task: MakeTask, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("smoother.batch.record.keep", full)
    task = make_task()
    assert attempt(task, command=STAND_IN).state == "done"
    assert finished(task) is None


def test_a_process_that_cannot_be_started_is_an_outcome(make_task: MakeTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/nowhere/python")
    said = attempt(make_task(), command=STAND_IN)
    assert (said.state, said.code) == ("broken", 1)
    assert "No such file" in said.message


def test_the_words_of_a_result_that_cannot_be_read_are_an_outcome(make_task: MakeTask) -> None:
    task = make_task()
    task.out.mkdir()
    for text in ("", "[]", '{"laps": [{"valid": true, "lap_time_s": "x"}]}', '{"session": 3}'):
        (task.out / "summary.json").write_text(text)
        said = attempt(task, command=("-c", "pass"))
        assert (said.state, said.code) == ("broken", 1), text


def test_no_module_of_the_working_directory_stands_in_for_ours(tmp_path: Path) -> None:
    (tmp_path / "smoother.py").write_text("print('hostile')")
    call = [sys.executable, *COMMAND, "--version"]
    done = subprocess.run(call, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "hostile" not in done.stdout
