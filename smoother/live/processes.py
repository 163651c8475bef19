"""Processes that do slow work beside the one that shows: started once, asked over a pipe, started again if they die.

A process here ends when its pipe closes, so none is left behind, however the one that started it ends.
"""

import contextlib
import signal
from collections import deque
from collections.abc import Callable, Iterator
from multiprocessing import get_context
from multiprocessing.connection import Connection
from typing import Any, Generic, TypeVar

from smoother.arrays import Array
from smoother.laps.results import GivenLines, Line
from smoother.live.identify import Window, find_line, identify
from smoother.live.lag import LagStart

T = TypeVar("T")
ENDS_WITHIN = 1.0  # s, before it is made to end


class Child:
    """A process that runs `serve(connection, *args)`, and this side of its pipe."""

    def __init__(self, serve: Callable[..., None], *args: object, has_children: bool = False) -> None:
        # spawned, not forked: threads run here, and a copy of their locks would hang
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs, *args), daemon=not has_children)
        with _interrupts_ignored():  # and so they are there: Ctrl-C in a terminal goes to every process
            self._process.start()
        theirs.close()

    @property
    def process_id(self) -> int:
        """Number of the process, for measurements."""
        return self._process.pid or 0

    @property
    def how_it_ended(self) -> str:
        """In words, once it has ended."""
        self._process.join(ENDS_WITHIN)
        code = self._process.exitcode
        return f"killed by signal {-code}" if code is not None and code < 0 else f"exit code {code}"

    def close(self) -> None:
        """Let it end, or make it."""
        self.connection.close()
        self._process.join(ENDS_WITHIN if not self._process.daemon else 0.0)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(ENDS_WITHIN)


@contextlib.contextmanager
def _interrupts_ignored() -> Iterator[None]:
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # not the main thread, which alone may say so
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class RemoteJob(Generic[T]):
    """Work that was asked for. What went wrong with it is its result, as text."""

    def __init__(self, look: Callable[[], None]) -> None:
        self._look = look
        self._answer: list[T | str] = []

    def done(self) -> bool:
        """Whether there is a result."""
        if not self._answer:
            self._look()
        return bool(self._answer)

    def result(self) -> T | str:
        """Return it. Only once it is done."""
        return self._answer[0]

    def answer(self, value: T | str) -> None:
        """Say the result."""
        self._answer.append(value)


class Background:
    """One process for work of seconds: a Worker. A job that is asked for while another runs waits for its turn."""

    def __init__(self) -> None:
        self._child: Child | None = Child(serve_jobs)
        self._jobs: deque[tuple[RemoteJob[Any], tuple[Any, ...]]] = deque()  # the first one is being done
        self._is_sent = False

    def __enter__(self) -> "Background":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        if self._child is not None:
            self._child.close()
        self._child = None

    def identify(self, window: Window) -> RemoteJob[LagStart | str]:
        """Start :func:`smoother.live.identify.identify`."""
        return self.ask(identify, window)

    def find_line(
        self, t: Array, position_n: Array, velocity_n: Array, given: GivenLines | None
    ) -> RemoteJob[Line | None]:
        """Start :func:`smoother.live.identify.find_line`."""
        return self.ask(find_line, t, position_n, velocity_n, given)

    def ask(self, function: Callable[..., Any], *args: object) -> RemoteJob[Any]:
        """Have a function of a module called there."""
        job: RemoteJob[Any] = RemoteJob(self._look)
        self._jobs.append((job, (function, *args)))
        self._look()
        return job

    def _look(self) -> None:
        """Take an answer that came; send the next question."""
        try:
            if self._is_sent and self._child is not None and self._child.connection.poll():
                answer = self._child.connection.recv()
                self._jobs.popleft()[0].answer(answer)
                self._is_sent = False
            if self._jobs and not self._is_sent:
                self._child = self._child or Child(serve_jobs)
                self._child.connection.send(self._jobs[0][1])
                self._is_sent = True
        except (EOFError, OSError):
            assert self._child is not None
            why = self._child.how_it_ended
            self.close()
            self._is_sent = False
            self._jobs.popleft()[0].answer(f"the process that works it out ended, {why}")


def serve_jobs(connection: Connection) -> None:
    """Be the process of :class:`Background`."""
    with contextlib.suppress(EOFError, OSError):  # nobody asks any more
        while True:
            function, *args = connection.recv()
            try:
                answer = function(*args)
            except Exception as error:  # said where it is shown; the next question may do better
                answer = describe(error)
            connection.send(answer)


def describe(error: BaseException) -> str:
    """One line that says what went wrong."""
    lines = str(error).splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
