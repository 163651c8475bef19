"""The loop: take what came, step, write down, show. One thread beside the receiver's, so nothing here needs a lock."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from smoother.live.engine import Engine, Snapshot
from smoother.live.receiver import Chunk, LinkStatus, Receiver
from smoother.live.recording import SessionWriter

LONGEST_WAIT = 0.02  # s; between looks at the receiver


class View(Protocol):
    """Something that shows snapshots."""

    frames_a_second: float

    def draw(self, s: Snapshot, link: LinkStatus, delay: float) -> bool:
        """Show a snapshot; False when it was closed by hand."""
        ...


@dataclass(frozen=True)
class Frame:
    """One shown frame: delay s from the arrival of its newest bytes until it stood there; cost s of drawing it."""

    delay: float
    cost: float


def run(
    receiver: Receiver,
    engine: Engine,
    view: View,
    writer: SessionWriter | None = None,
    stop: Callable[[], bool] = lambda: False,
    watch: Callable[[Frame], None] = lambda frame: None,
) -> Snapshot:
    """Run until the source ends, the view is closed or `stop` says so. Returns the last snapshot.

    A frame that is late is left out, never queued: what is shown is always the newest. Raises what the source raises.
    """
    due = time.monotonic()
    snapshot = Snapshot()
    while not stop():
        link = receiver.status
        chunks = _come(receiver, engine, max(0.0, min(LONGEST_WAIT, due - time.monotonic())))
        snapshot, batches = engine.step(chunks)
        if writer is not None:
            for batch in batches:
                writer.add(batch.records, batch.restarted)
        now = time.monotonic()
        is_last = link.is_over and not chunks and not receiver.has_chunks and not engine.is_busy
        if now >= due or is_last:
            delay = max(0.0, now - snapshot.arrival) if snapshot.arrival else 0.0
            if not view.draw(snapshot, link, delay):
                return snapshot
            done = time.monotonic()
            watch(Frame(done - snapshot.arrival if chunks else delay, done - now))
            due = max(due + 1.0 / view.frames_a_second, done)
        if is_last:
            return snapshot
    return snapshot


def _come(receiver: Receiver, engine: Engine, wait: float) -> list[Chunk]:
    """What has come, waiting up to `wait` s. From a file, which loses nothing, nothing while the smoother is behind."""
    if receiver.waits and engine.is_behind:
        time.sleep(wait)
        return []
    return receiver.take(wait)
