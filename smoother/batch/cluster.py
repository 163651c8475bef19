"""The sessions of a batch on a running Dask cluster, whose workers see the same files under the same paths.

Dask sends a task again when the worker that had it dies, and gives a task up after it has taken several workers down.
What runs there is :func:`smoother.batch.attempt.attempt`: a process of its own for each session, as here.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from smoother.batch.attempt import COMMAND, attempt
from smoother.batch.local import largest_first
from smoother.batch.outcome import Outcome, one_line
from smoother.batch.task import Task
from smoother.errors import UsageError

if TYPE_CHECKING:
    from distributed import Client, Future

PATIENCE = 10.0  # s that a scheduler may take to answer
INSTALL = "pip install 'kart-smoother[dask]'"


def run_on_cluster(
    tasks: Sequence[Task], address: str, command: Sequence[str] = COMMAND
) -> Generator[tuple[Task, Outcome], None, None]:
    """Yield each session with what became of it, as they end; those with most to read first.

    Raises UsageError where Dask is not installed or no scheduler answers. Closing the iterator gives back what waits;
    what a worker has begun it brings to its end.
    """
    client = connect(address)
    words = logging.getLogger("distributed.client")
    level = words.level
    words.setLevel(logging.CRITICAL)  # a scheduler that goes away is an outcome; Dask prints a page about it
    try:
        from distributed import as_completed

        ordered = largest_first(tasks)
        # pure=False: the same session in another batch is another task, not a result that is remembered
        futures = client.map(attempt, ordered, stop=None, command=tuple(command), pure=False)
        waiting = dict(zip(futures, ordered, strict=True))
        try:
            for done in as_completed(futures, loop=client.loop):
                yield waiting[done], _outcome(done)
        finally:
            client.cancel(futures)
    finally:
        client.close()
        words.setLevel(level)


def connect(address: str) -> Client:
    """Return a client of the scheduler. Raises UsageError, one line with a remedy."""
    try:
        from distributed import Client
    except ImportError as error:
        raise UsageError(f"--scheduler needs Dask: {INSTALL}") from error
    try:
        with _no_garbage_collected():
            return Client(address, timeout=PATIENCE, set_as_default=False)
    except (OSError, ValueError) as error:
        raise UsageError(f"--scheduler {address}: no Dask scheduler answers there ({one_line(str(error))})") from error


@contextmanager
def _no_garbage_collected() -> Iterator[None]:
    """Keep the collector off: closing an earlier client needs the lock that a new one holds while it starts."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


def _outcome(future: Future[Any]) -> Outcome:
    """Return what a worker sent, or why it sent nothing."""
    if future.status == "finished":
        result = future.result()
        assert isinstance(result, Outcome)
        return result
    error = future.exception() if future.status == "error" else None
    if error is None:
        return Outcome("lost", "the cluster gave it up; run the same command again")
    if type(error).__name__ == "KilledWorker":
        return Outcome("lost", "the workers that had it died, one after the other")
    return Outcome("broken", one_line(f"the worker could not run it ({type(error).__name__}: {error})"))
