"""The sessions of a batch on the cores of this machine: a thread waits for each process."""

import os
import sys
import threading
from collections.abc import Generator, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed

from smoother.batch.attempt import COMMAND, attempt
from smoother.batch.outcome import Outcome
from smoother.batch.task import Task


def cores() -> int:
    """Return how many cores this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


def run_here(
    tasks: Sequence[Task], jobs: int, command: Sequence[str] = COMMAND
) -> Generator[tuple[Task, Outcome], None, None]:
    """Yield each session with what became of it, as they end; `jobs` run at a time, those with most to read first.

    Closing the iterator, or an exception where it is used, ends the processes that run; these sessions are as if they
    had not been begun.
    """
    stop = threading.Event()
    with ThreadPoolExecutor(max_workers=jobs) as pool:
        waiting = {pool.submit(attempt, task, stop, command): task for task in largest_first(tasks)}
        try:
            for done in as_completed(waiting):
                yield waiting[done], done.result()
        finally:
            stop.set()
            pool.shutdown(wait=True, cancel_futures=True)


def largest_first(tasks: Sequence[Task]) -> list[Task]:
    """Return the sessions by the bytes of their inputs, most first."""
    return sorted(tasks, key=lambda task: -task.size)
