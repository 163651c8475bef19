"""A finished session is not smoothed again, unless something it was made from has changed."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from batch_stand_in import STAND_IN, MakeTask

import smoother
from smoother.batch.attempt import attempt
from smoother.batch.record import FILE_NAME, finished
from smoother.batch.task import Task


@pytest.fixture
def done(make_task: MakeTask) -> Task:
    task = make_task()
    assert attempt(task, command=STAND_IN).state == "done"
    return task


def test_a_finished_session_is_known_with_its_outcome(done: Task) -> None:
    said = finished(done)
    assert said is not None
    assert (said.state, said.facts.best_s) == ("done", 60.25)


def test_a_doubtful_session_is_finished_a_failed_one_is_not(make_task: MakeTask) -> None:
    for word, is_finished in (("doubtful", True), ("unusable", False), ("bug", False), ("crash", False)):
        task = make_task(word, word)
        attempt(task, command=STAND_IN)
        assert (finished(task) is not None) == is_finished, word


def test_a_touched_or_copied_file_is_still_the_same(done: Task) -> None:
    os.utime(done.inputs[0], (1.0, 1.0))
    os.utime(done.out / "summary.json", (1.0, 1.0))
    assert finished(done) is not None


def test_a_folder_that_was_moved_is_still_finished(done: Task, tmp_path: Path) -> None:
    done.session.rename(tmp_path / "moved")
    session = tmp_path / "moved"
    assert finished(replace(done, session=session, out=session / "smoothed", inputs=(session / "gps.csv",))) is not None


def rewrite(task: Task) -> Task:
    task.inputs[0].write_text("eins")  # as long as before
    return task


def add(task: Task) -> Task:
    (task.session / "session.toml").write_text("")
    return replace(task, inputs=(*task.inputs, task.session / "session.toml"))


def remove(task: Task) -> Task:
    return replace(task, inputs=())


def ask_otherwise(task: Task) -> Task:
    return replace(task, arguments=("--rate", "10"))


def smooth_by_hand(task: Task) -> Task:
    (task.out / "summary.json").write_text('{"options": "other"}')
    return task


def lose_the_report(task: Task) -> Task:
    (task.out / "report.html").unlink()
    return task


def lose_the_summary(task: Task) -> Task:
    (task.out / "summary.json").unlink()
    return task


def spoil_the_record(task: Task) -> Task:
    path = task.out / FILE_NAME
    path.write_text(path.read_text()[:-40])
    return task


def confuse_the_record(task: Task) -> Task:
    path = task.out / FILE_NAME
    path.write_text(path.read_text().replace('"done"', '"<script>"'))
    return task


@pytest.mark.parametrize(
    "change",
    [
        rewrite,
        add,
        remove,
        ask_otherwise,
        smooth_by_hand,
        lose_the_report,
        lose_the_summary,
        spoil_the_record,
        confuse_the_record,
    ],
)
def test_whatever_changed_makes_it_unfinished(change: Callable[[Task], Task], done: Task) -> None:
    assert finished(done) is not None
    assert finished(change(done)) is None


def test_another_version_of_this_program_makes_it_unfinished(done: Task, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(smoother, "__version__", "99")
    assert finished(done) is None


def test_tables_alone_need_no_report(make_task: MakeTask) -> None:
    task = replace(make_task(), arguments=("--no-figures",))
    attempt(task, command=STAND_IN)
    (task.out / "report.html").unlink()
    assert finished(task) is not None


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"form": 1}', "[" * 100_000, "\x00", '{"form": 1, "inputs": []}'])
def test_a_record_that_is_none_is_passed_over(text: str, done: Task) -> None:
    (done.out / FILE_NAME).write_text(text)
    assert finished(done) is None
