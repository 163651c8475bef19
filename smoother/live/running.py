"""The loop: receive, step, record, show. Receiver and recorder have threads of their own."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from smoother.live.engine import Engine, Snapshot
from smoother.live.frame import Frame
from smoother.live.receiver import Chunk, LinkStatus, Receiver
from smoother.live.recording import Recorder


class View(Protocol):
    """Shows frames."""

    frames_a_second: float

    def draw(self, frame: Frame) -> bool:
        """Show a frame; False when the view was closed by hand."""
        ...


@dataclass(frozen=True)
class Drawn:
    """One shown frame: delay s from the arrival of its newest bytes until it was drawn, smoother_delay s likewise of
    the newest bytes in the smoother's state (NaN without one); cost s of drawing it.
    """

    delay: float
    smoother_delay: float
    cost: float


def run(
    receiver: Receiver,
    engine: Engine,
    view: View,
    recorder: Recorder | None = None,
    stop: Callable[[], bool] = lambda: False,
    watch: Callable[[Drawn], None] = lambda drawn: None,
) -> Snapshot:
    """Run until the source ends, the view is closed or `stop` returns True. Returns the last snapshot.

    Late frames are dropped, never queued. Raises the exceptions of the source.
    """
    due = time.monotonic()
    snapshot = Snapshot()
    while not stop():
        link = receiver.status
        # s between polls of the receiver
        chunks = _received(receiver, engine, max(0.0, min(0.02, due - time.monotonic())))
        snapshot, batches = engine.step(chunks)
        if recorder is not None and batches:
            recorder.add(batches)
        now = time.monotonic()
        is_last = link.is_over and not chunks and not receiver.has_chunks and not engine.is_busy
        if now >= due or is_last:
            if not view.draw(_frame(snapshot, link, recorder, now, receiver.waits and engine.is_behind)):
                return snapshot
            done = time.monotonic()
            smoother_delay = done - snapshot.smoother_arrival if snapshot.lag is not None else float("nan")
            watch(Drawn(done - snapshot.arrival if snapshot.arrival else 0.0, smoother_delay, done - now))
            due = max(due + 1.0 / view.frames_a_second, done)
        if is_last:
            return snapshot
    return snapshot


def _frame(snapshot: Snapshot, link: LinkStatus, recorder: Recorder | None, now: float, is_held: bool) -> Frame:
    return Frame(
        snapshot,
        link,
        max(0.0, now - snapshot.arrival) if snapshot.arrival else 0.0,
        max(0.0, now - snapshot.smoother_arrival) if snapshot.lag is not None else float("nan"),
        recorder.status if recorder is not None else None,
        is_held,
    )


def _received(receiver: Receiver, engine: Engine, wait: float) -> list[Chunk]:
    """Received data, waiting up to `wait` s. A file waits while the smoother is behind."""
    if receiver.waits and engine.is_behind:
        time.sleep(wait)
        return []
    return receiver.take(wait)
