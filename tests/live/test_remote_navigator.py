"""What fails beside the display is said, and the display goes on."""

import operator
import os
import signal
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from smoother.live import remote_navigator
from smoother.live.processes import Background, RemoteJob
from smoother.live.remote_navigator import RemoteNavigator
from smoother.samples import ImuSamples


def second(t: float) -> ImuSamples:
    """A second of samples at rest."""
    n = 200
    times = t + np.arange(n) / n
    return ImuSamples(times, np.tile([0.0, 0.0, 9.8], (n, 1)), np.zeros((n, 3)))


def wait_for(condition: Callable[[], bool], seconds: float = 60.0) -> None:
    """Wait: a process starts within seconds, on a machine that others use."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.01)


def answer_of(job: RemoteJob[object]) -> object:
    wait_for(job.done)
    return job.result()


@pytest.fixture(scope="module")
def worker() -> Iterator[Background]:
    with Background() as background:
        yield background


@pytest.fixture(scope="module")
def navigating() -> Iterator[RemoteNavigator]:
    with RemoteNavigator() as made:
        yield made


def test_jobs_are_done_in_turn_in_another_process(worker: Background) -> None:
    first, second_job = worker.ask(os.getpid), worker.ask(operator.add, 1, 2)
    assert answer_of(second_job) == 3
    assert answer_of(first) not in (None, os.getpid())


def test_a_job_that_fails_is_answered_with_what_went_wrong(worker: Background) -> None:
    assert answer_of(worker.ask(operator.truediv, 1, 0)) == "ZeroDivisionError: division by zero"
    assert answer_of(worker.ask(operator.add, 1, 2)) == 3


def test_a_process_that_dies_is_reported_and_the_next_job_finds_another(worker: Background) -> None:
    said = answer_of(worker.ask(os._exit, 7))
    assert said == "the process that works it out ended, exit code 7"
    assert answer_of(worker.ask(operator.add, 1, 2)) == 3


class Broken:
    """Samples whose times cannot be read, but where they were made."""

    def __init__(self) -> None:
        self._made_in = os.getpid()

    @property
    def t(self) -> np.ndarray:
        if os.getpid() != self._made_in:
            raise RuntimeError("a bug")
        return np.zeros(1)


def test_an_exception_in_the_navigator_is_shown_and_the_stream_goes_on(navigating: RemoteNavigator) -> None:
    wait_for(lambda: navigating.exchange([second(0.0)], 0.5).arrival == 0.5)
    navigating.exchange([Broken()], 1.0)  # type: ignore[list-item]
    wait_for(lambda: "RuntimeError: a bug; the smoother begins again" in navigating.exchange([], 1.0).stage)
    navigating.exchange([second(2.0)], 2.5)
    wait_for(lambda: navigating.exchange([], 2.5).arrival == 2.5)


def test_a_navigator_that_hangs_is_not_waited_for_and_what_it_misses_is_counted(navigating: RemoteNavigator) -> None:
    wait_for(lambda: navigating.exchange([second(0.0)], 4.5).arrival == 4.5)
    os.kill(navigating.process_id, signal.SIGSTOP)
    began = time.monotonic()
    for t in range(1, 201):
        newest = navigating.exchange([second(float(t))], 5.0)
    assert time.monotonic() - began < 5.0
    assert navigating.is_behind
    assert newest.left_out == pytest.approx(200.0 - remote_navigator.MOST_WAITING, abs=3.0)
    os.kill(navigating.process_id, signal.SIGCONT)
    wait_for(lambda: not navigating.exchange([], 5.0).is_busy)
    assert not navigating.is_behind


def test_a_navigator_that_is_killed_is_reported_and_begins_again(
    navigating: RemoteNavigator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(remote_navigator, "START_AGAIN", 0.2)
    wait_for(lambda: navigating.exchange([second(0.0)], 9.5).arrival == 9.5)
    os.kill(navigating.process_id, signal.SIGKILL)
    wait_for(lambda: "killed by signal 9" in navigating.exchange([second(1.0)], 10.5).stage)
    wait_for(lambda: navigating.exchange([second(2.0)], 11.5).arrival == 11.5)


def test_no_process_is_left_behind() -> None:
    with RemoteNavigator() as navigating:
        wait_for(lambda: navigating.exchange([second(0.0)], 0.5).arrival == 0.5)
        assert navigating._child is not None
        process = navigating._child._process
    assert not process.is_alive()
