"""The navigator in a process of its own, to which items are passed whenever it has answered; nothing waits for it."""

import contextlib
import time
from collections import deque
from dataclasses import replace
from multiprocessing.connection import Connection

from smoother.laps.tracks import TrackFile
from smoother.live.navigator import Item, Navigation, Navigator
from smoother.live.processes import Background, Child, describe
from smoother.samples import ImuSamples

MOST_WAITING = 60.0  # s of waiting samples; older ones are dropped, and counted
BEHIND = 5.0  # s of waiting samples, above which a source that can wait has to
START_AGAIN = 5.0  # s after a process died


class RemoteNavigator:
    """The navigator in another process. `exchange` passes items and returns the newest navigation without waiting."""

    def __init__(self, tracks: tuple[TrackFile, ...] = ()) -> None:
        self._tracks = tracks
        self._child: Child | None = None
        self._waiting: deque[Item] = deque()
        self._arrival = 0.0
        self._asked_at: float | None = None  # time of the unanswered question; None: it has answered
        self._answered_at = 0.0
        self._is_new = False  # the logger was restarted
        self._flaw = ""
        self._left_out = 0.0
        self._start_at = 0.0
        self._navigation = Navigation()
        self._start()

    def __enter__(self) -> "RemoteNavigator":
        return self

    def __exit__(self, *_: object) -> None:
        if self._child is not None:
            self._child.close()
        self._child = None

    @property
    def process_id(self) -> int:
        """Number of the process, for measurements; 0 while there is none."""
        return 0 if self._child is None else self._child.process_id

    @property
    def is_behind(self) -> bool:
        """Whether more than BEHIND s wait, so that a source that can wait should."""
        return self._seconds_waiting() > BEHIND

    def restart(self) -> None:
        """Start anew: the logger was switched off and on."""
        self._waiting.clear()
        self._is_new, self._flaw = True, ""

    def exchange(self, items: list[Item], arrival: float) -> Navigation:
        """Pass items, arrival s of their bytes; return the newest navigation."""
        self._waiting.extend(items)
        self._arrival = max(self._arrival, arrival)
        while self._seconds_waiting() > MOST_WAITING:
            self._left_out += _length(self._waiting.popleft())
        try:
            self._exchange()
        except (EOFError, OSError):
            self._fail()
        is_busy = self._navigation.is_busy or bool(self._waiting) or self._asked_at is not None
        return replace(self._navigation, is_busy=is_busy, left_out=self._left_out)

    def _exchange(self) -> None:
        now = time.monotonic()
        if self._child is None:
            if now < self._start_at:
                return
            self._start()
        assert self._child is not None
        pipe = self._child.connection
        if self._asked_at is not None and pipe.poll():
            self._navigation, self._asked_at, self._answered_at = pipe.recv(), None, now
        is_due = self._waiting or self._is_new or now - self._answered_at > 0.1  # s between questions without new data
        if self._asked_at is None and is_due:
            # items passed together: four seconds of the usual stream, which fit into the pipe
            items = [self._waiting.popleft() for _ in range(min(100, len(self._waiting)))]
            pipe.send((items, self._arrival, self._is_new, self._flaw))
            self._is_new, self._flaw, self._asked_at = False, "", now

    def _start(self) -> None:
        self._child, self._asked_at = Child(serve, self._tracks, has_children=True), None

    def _fail(self) -> None:
        """Report that the process ended; the next one starts START_AGAIN later, without its state."""
        assert self._child is not None
        self._flaw = f"the smoother's process ended, {self._child.how_it_ended}; it begins again"
        self._child.close()
        self._child, self._asked_at, self._is_new = None, None, True
        self._start_at = time.monotonic() + START_AGAIN
        self._navigation = Navigation(laps=self._navigation.laps, stage=f"not yet: {self._flaw}")

    def _seconds_waiting(self) -> float:
        waiting = self._waiting
        return float(waiting[-1].t[-1] - waiting[0].t[0]) if waiting else 0.0


def _length(item: Item) -> float:
    """Duration, s, of samples."""
    return float(item.t[-1] - item.t[0]) if isinstance(item, ImuSamples) else 0.0


def serve(connection: Connection, tracks: tuple[TrackFile, ...]) -> None:
    """Be the process of :class:`RemoteNavigator`: answer each batch of items with the navigation, work in between.

    An exception is reported; the stream continues with another navigator.
    """
    with Background() as worker, contextlib.suppress(EOFError, OSError):
        navigator = Navigator(worker, tracks)
        while True:
            try:
                navigator.work()
            except Exception as error:
                navigator = Navigator(worker, tracks, flaw=_flaw_of(error))
            if not connection.poll(0.02):  # s between polls of a worker that has not answered
                continue
            items, arrival, is_new, flaw = connection.recv()
            if is_new:
                navigator = Navigator(worker, tracks, flaw=flaw)
            try:
                navigator.take(items, arrival)
                answer = navigator.look()
            except Exception as error:
                navigator = Navigator(worker, tracks, flaw=_flaw_of(error))
                answer = navigator.look()
            connection.send(answer)


def _flaw_of(error: Exception) -> str:
    return f"{describe(error)}; the smoother begins again"
