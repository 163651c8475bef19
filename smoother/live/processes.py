"""Worker processes for slow computations: started once, requests over a pipe, restarted if they end.

A worker ends when its pipe closes, also where the parent crashed.
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
ENDS_WITHIN = 1.0  # s before it is terminated


class Child:
    """A process that runs `serve(connection, *args)`, and this side of its pipe."""

    def __init__(self, serve: Callable[..., None], *args: object, has_children: bool = False) -> None:
        # spawned, not forked: copies of locks of running threads would hang
        context = get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(target=serve, args=(theirs, *args), daemon=not has_children)
        with _interrupts_ignored():  # inherited by the child: Ctrl-C in a terminal goes to every process
            self._process.start()
        theirs.close()

    @property
    def process_id(self) -> int:
        """Number of the process, for measurements."""
        return self._process.pid or 0

    @property
    def how_it_ended(self) -> str:
        """The way it ended, as text."""
        self._process.join(ENDS_WITHIN)
        code = self._process.exitcode
        return f"killed by signal {-code}" if code is not None and code < 0 else f"exit code {code}"

    def close(self) -> None:
        """Let it end, or terminate it."""
        self.connection.close()
        self._process.join(ENDS_WITHIN if not self._process.daemon else 0.0)
        if self._process.is_alive():
            self._process.terminate()
            self._process.join(ENDS_WITHIN)


@contextlib.contextmanager
def _interrupts_ignored() -> Iterator[None]:
    try:
        before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    except ValueError:  # signals can only be set in the main thread
        yield
        return
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


class RemoteJob(Generic[T]):
    """A requested computation; its result is text where it failed."""

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
        """Set the result."""
        self._answer.append(value)


class Background:
    """A Worker in one process; jobs are queued."""

    def __init__(self) -> None:
        self._child: Child | None = Child(serve_jobs)
        self._jobs: deque[tuple[RemoteJob[Any], tuple[Any, ...]]] = deque()  # the first one runs
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
        """Request the call of a function of a module."""
        job: RemoteJob[Any] = RemoteJob(self._look)
        self._jobs.append((job, (function, *args)))
        self._look()
        return job

    def _look(self) -> None:
        """Receive an answer; send the next request."""
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
    with contextlib.suppress(EOFError, OSError):  # the parent closed the pipe
        while True:
            function, *args = connection.recv()
            try:
                answer = function(*args)
            except Exception as error:  # reported as the result
                answer = describe(error)
            connection.send(answer)


def describe(error: BaseException) -> str:
    """An exception as one line."""
    lines = str(error).splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__
