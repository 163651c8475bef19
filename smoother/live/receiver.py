"""A thread that reads a source, reconnects after a lost cable, and has bounded buffers."""

import threading
import time
from collections import deque
from dataclasses import dataclass, replace

from smoother.live.sources import Source

MOST_WAITING = 256 << 10  # bytes not yet taken; a minute of the usual stream
READ_AHEAD = 8 << 10  # likewise of a source that can wait; two seconds, so that it is followed in small steps
RETRY_EVERY = 0.25  # s


@dataclass(frozen=True)
class Chunk:
    """Received bytes; arrival s on the monotonic clock. after_break: the cable was pulled before them."""

    arrival: float
    data: bytes
    after_break: bool = False


@dataclass(frozen=True)
class LinkStatus:
    """State of the connection: open now, at its end, number of losses, bytes dropped because they were not taken."""

    is_open: bool = False
    is_over: bool = False
    disconnects: int = 0
    dropped_bytes: int = 0
    received_bytes: int = 0
    error: str = ""


class Receiver:
    """Reads in the background. `take` returns everything received."""

    def __init__(self, source: Source, *, waits: bool = False) -> None:
        """waits: let the source wait while the buffer is full (a file) instead of dropping the oldest bytes (a
        line)."""
        self._source, self.waits = source, waits
        self._chunks: deque[Chunk] = deque()
        self._waiting = 0
        self._status = LinkStatus()
        self._lock = threading.Lock()
        self._arrived = threading.Event()
        self._stop = threading.Event()
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._run, name="receiver", daemon=True)

    def __enter__(self) -> "Receiver":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=2.0)

    @property
    def status(self) -> LinkStatus:
        """The state of the connection. Raises the exception that ended the thread."""
        if self._failure is not None:
            raise self._failure
        return self._status

    @property
    def has_chunks(self) -> bool:
        """Whether there is received data that was not taken."""
        return bool(self._chunks)

    def take(self, timeout: float = 0.0) -> list[Chunk]:
        """Return the data since the last call, waiting up to `timeout` s for any."""
        if timeout > 0.0:
            self._arrived.wait(timeout)
        with self._lock:
            chunks = list(self._chunks)
            self._chunks.clear()
            self._waiting = 0
            self._arrived.clear()
        return chunks

    def _run(self) -> None:
        try:
            self._follow()
        except Exception as error:  # raised again by `status`
            self._failure = error

    def _follow(self) -> None:
        was_open = False
        while not self._stop.is_set():
            try:
                self._source.open()
            except OSError as error:
                self._set(is_open=False, error=str(error))
                self._stop.wait(RETRY_EVERY)
                continue
            self._set(is_open=True, error="")
            is_over = self._read(after_break=was_open)
            was_open = True
            self._source.close()
            if is_over:
                self._set(is_open=False, is_over=True)
                self._arrived.set()
                return

    def _read(self, after_break: bool) -> bool:
        """Read until the end (True) or until the connection is lost (False)."""
        try:
            while not self._stop.is_set():
                data = self._source.read()
                if data is None:
                    if not self._source.can_return:
                        return True
                    raise OSError("closed by the other side")
                if data:
                    self._put(Chunk(time.monotonic(), data, after_break))
                    after_break = False
        except OSError as error:
            self._set(is_open=False, disconnects=self._status.disconnects + 1, error=str(error))
            self._stop.wait(RETRY_EVERY)
        return False

    def _put(self, chunk: Chunk) -> None:
        while self.waits and self._waiting > READ_AHEAD and not self._stop.wait(0.005):
            pass
        with self._lock:
            self._chunks.append(chunk)
            self._waiting += len(chunk.data)
            dropped = 0
            while self._waiting > MOST_WAITING and len(self._chunks) > 1 and not self.waits:
                oldest = self._chunks.popleft()
                self._waiting -= len(oldest.data)
                dropped += len(oldest.data)
            self._arrived.set()
        status = self._status
        self._set(dropped_bytes=status.dropped_bytes + dropped, received_bytes=status.received_bytes + len(chunk.data))

    def _set(self, **changes: int | bool | str) -> None:
        self._status = replace(self._status, **changes)  # type: ignore[arg-type]
