"""Many sessions on this machine: one bad one never stops the others, and stopping leaves nothing."""

import time
from contextlib import closing

import pytest
from batch_stand_in import STAND_IN, MakeTask, starts

from smoother.batch.local import cores, largest_first, run_here
from smoother.batch.record import finished
from smoother.documents import STAGING


def test_bad_sessions_of_every_kind_do_not_stop_the_others(make_task: MakeTask) -> None:
    words = ["fine", "crash", "fine", "hang", "bug", "unusable", "killed 9", "doubtful", "fine"]
    tasks = [make_task(word, f"run{i}", seconds=2.0) for i, word in enumerate(words)]
    said = {task.name: outcome.state for task, outcome in run_here(tasks, 3, STAND_IN)}
    wanted = ["done", "broken", "done", "limit", "broken", "unusable", "broken", "doubtful", "done"]
    assert [said[task.name] for task in tasks] == wanted


def test_two_at_a_time_take_half_as_long(make_task: MakeTask) -> None:
    tasks = [make_task("slow 0.7", f"run{i}") for i in range(6)]
    took = []
    for jobs in (1, 3):
        start = time.monotonic()
        assert len(list(run_here(tasks, jobs, STAND_IN))) == 6
        took.append(time.monotonic() - start)
    assert took[1] < 0.75 * took[0]  # they sleep: a third, and the starts of the processes on a busy machine


def test_what_is_largest_is_started_first(make_task: MakeTask) -> None:
    tasks = [make_task("fine" + " " * size, f"run{size}") for size in (1, 3, 2)]
    assert [task.name for task in largest_first(tasks)] == ["run3", "run2", "run1"]


def test_stopping_ends_what_runs_and_begins_nothing_more(make_task: MakeTask) -> None:
    tasks = [make_task("fine                  ", "first"), *(make_task("slow 30", f"run{i}") for i in range(5))]
    start = time.monotonic()
    with closing(run_here(tasks, 2, STAND_IN)) as outcomes:
        assert next(outcomes)[0].name == "first"
    assert time.monotonic() - start < 20.0
    assert sum(starts(task) for task in tasks[1:]) <= 2
    for task in tasks[1:]:
        assert finished(task) is None
        assert list(task.session.rglob(f"{STAGING}*")) == []


def test_an_exception_where_outcomes_are_used_stops_too(make_task: MakeTask) -> None:
    tasks = [make_task("fine        ", "first"), *(make_task("slow 30", f"run{i}") for i in range(3))]
    with pytest.raises(KeyboardInterrupt), closing(run_here(tasks, 1, STAND_IN)) as outcomes:
        for _ in outcomes:
            raise KeyboardInterrupt
    assert sum(starts(task) for task in tasks) <= 2


def test_this_machine_has_cores() -> None:
    assert cores() >= 1
