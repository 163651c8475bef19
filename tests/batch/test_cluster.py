"""The same on a Dask cluster: a scheduler and two workers on this machine, as other programs run them."""

import gc
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from batch_stand_in import STAND_IN, MakeTask, starts

from smoother.batch.cluster import connect, run_on_cluster
from smoother.batch.record import finished
from smoother.errors import UsageError

pytest.importorskip("distributed", reason="no Dask")

STARTING = 60.0  # s; three interpreters on a busy machine


@dataclass
class Cluster:
    """A scheduler, and the processes of its workers."""

    address: str
    start: Callable[[], subprocess.Popen[bytes]]
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)


def process(stack: ExitStack, module: str, *arguments: str) -> subprocess.Popen[bytes]:
    call = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
    started = subprocess.Popen(call, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, cwd=Path(__file__).parent)
    stack.callback(started.wait)
    stack.callback(started.kill)
    return started


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    """Two workers without a nanny: one that is killed is gone."""
    note = tmp_path / "scheduler.json"
    with ExitStack() as stack:
        at = ("--scheduler-file", str(note))
        process(stack, "dask_scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard", "--no-show", *at)
        until = time.monotonic() + STARTING
        while not (note.exists() and note.read_text().endswith("}")) and time.monotonic() < until:
            time.sleep(0.05)
        options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(tmp_path / "dask"))

        def worker() -> subprocess.Popen[bytes]:
            return process(stack, "dask_worker", *at, "--host", "127.0.0.1", *options)

        yield Cluster(json.loads(note.read_text())["address"], worker, [worker(), worker()])


def test_when_a_worker_is_killed_in_the_middle_all_sessions_come_out(cluster: Cluster, make_task: MakeTask) -> None:
    words = ["slow 0.4"] * 8 + ["crash", "unusable"]
    tasks = [make_task(word, f"run{i}") for i, word in enumerate(words)]
    states: dict[str, str] = {}
    with closing(run_on_cluster(tasks, cluster.address, STAND_IN)) as outcomes:
        for task, outcome in outcomes:
            states[task.name] = outcome.state
            if len(states) == 2:
                cluster.workers[0].kill()
    assert [states[task.name] for task in tasks] == ["done"] * 8 + ["broken", "unusable"]
    assert all(finished(task) is not None for task in tasks[:8])
    assert cluster.workers[0].poll() is not None
    assert cluster.workers[1].poll() is None


def test_a_session_that_takes_every_worker_down_is_given_up_and_the_others_come_out(
    cluster: Cluster, make_task: MakeTask
) -> None:
    cluster.workers += [cluster.start() for _ in range(3)]
    bad, good = make_task("fine      ", "bad"), [make_task("fine", f"run{i}") for i in range(3)]
    killing = "import os, signal, sys; 'bad' in sys.argv[1] and os.kill(os.getppid(), signal.SIGKILL)\n"
    command = (*STAND_IN[:-1], killing + STAND_IN[-1])
    with closing(run_on_cluster([bad, *good], cluster.address, command)) as outcomes:
        states = {task.name: outcome.state for task, outcome in outcomes}
    assert states == {"bad": "lost", "run0": "done", "run1": "done", "run2": "done"}


def test_sessions_that_wait_are_given_back_when_a_batch_stops(cluster: Cluster, make_task: MakeTask) -> None:
    tasks = [make_task("fine              ", "first"), *(make_task("slow 1", f"run{i}") for i in range(8))]
    with closing(run_on_cluster(tasks, cluster.address, STAND_IN)) as outcomes:
        next(outcomes)
    time.sleep(2.5)
    begun = sum(starts(task) for task in tasks)
    time.sleep(1.5)
    assert sum(starts(task) for task in tasks) == begun < 9


def test_a_client_that_failed_is_not_taken_apart_while_the_next_one_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Dask takes one lock for both, and would wait for ever."""
    collected_while_starting = []

    class Started:
        def __init__(self, *_: object, **__: object) -> None:
            collected_while_starting.append(gc.isenabled())
            raise OSError("nobody there")

    monkeypatch.setattr("distributed.Client", Started)
    assert gc.isenabled()
    with pytest.raises(UsageError, match="nobody there"):
        connect("tcp://127.0.0.1:1")
    assert gc.isenabled()
    assert collected_while_starting == [False]


def test_no_scheduler_and_no_dask_are_one_line_each(make_task: MakeTask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smoother.batch.cluster.PATIENCE", 0.3)
    for address in ("tcp://127.0.0.1:1", "nonsense", "http://x"):
        with pytest.raises(UsageError, match="no Dask scheduler answers"):
            next(run_on_cluster([make_task()], address, STAND_IN))
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match=r"kart-smoother\[dask\]"):
        next(run_on_cluster([make_task()], "tcp://127.0.0.1:1", STAND_IN))
