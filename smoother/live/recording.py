"""Recording of the stream in the format of the logger's card: blocks of a `.klg` file.

The file is a complete session at every moment: data is written at once, and the blocks of the last second are written
again, in place, as they fill. So nothing is lost however the program ends.
"""

import contextlib
import os
import queue
import threading
import time
import zlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path

import numpy as np

from smoother.errors import UsageError
from smoother.live.decoding import Batch
from smoother.session.log_encode import SETUP_EVERY, lay_out
from smoother.session.log_format import BLOCK_BYTES, CAPACITY, CRC_AT, CRC_STRUCT, IMU, LogRecords, Setup

FILE_NAME = "LIVE{:04d}.KLG"
REWRITTEN = 1.0  # s of records whose blocks are written again as they fill
SYNC_EVERY = 1.0  # s; at most this is lost when the computer fails
ENDS_WITHIN = 10.0  # s, after which a hanging disc is given up
MOST_WAITING = 4096  # lists of batches; minutes of a disc that hangs
_SEQUENCE, _IMU_NUMBER = slice(8, 12), slice(20, 24)


class SessionWriter:
    """A directory that `smooth` accepts. A restarted logger begins another file, with a session of its own."""

    def __init__(self, directory: Path, rng: np.random.Generator) -> None:
        """Make `directory`. Raises UsageError if it cannot be written to."""
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(f"{directory}: cannot be made ({error.strerror or error})") from error
        self._directory, self._rng = directory, rng
        self._file: FileIO | None = None
        self._filling: LogRecords | None = None  # records in the blocks that are written again
        self._blocks = self._samples = 0  # before those blocks
        self._session = self._any_session()
        self._began_us = 0
        self.path: Path | None = None
        self.bytes_written = 0

    def add(self, records: LogRecords, restarted: bool = False) -> None:
        """Write records. Raises OSError when the disk is full, and the next call tries again; ValueError for
        records that the format cannot hold, which are dropped.
        """
        if restarted:
            self.close()
        newest = _newest_us(records)
        if self._filling is None:
            self._began_us = newest
        filling = _joined([records] if self._filling is None else [self._filling, records])
        blocks = self._laid_out(filling)
        # s of records that wait for room on a full disc
        self._filling = filling if newest - self._began_us < 60.0 * 1e6 else None
        _write_all(self._open(), blocks, self._blocks * BLOCK_BYTES)
        self.bytes_written = self._blocks * BLOCK_BYTES + len(blocks)
        if newest - self._began_us > REWRITTEN * 1e6:
            self._blocks += len(blocks) // BLOCK_BYTES
            self._samples += len(filling.imu_t) + sum(gap.count for gap in filling.gaps if gap.source == IMU)
            self._filling = None

    def sync(self) -> None:
        """Flush the file to the disc. Raises OSError."""
        if self._file is not None:
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """End the file. Raises OSError if its rest cannot be written."""
        file, self._file = self._file, None
        self._filling, self._blocks, self._samples, self._session = None, 0, 0, self._any_session()
        if file is not None:
            file.close()

    def _any_session(self) -> int:
        return int(self._rng.integers(1, 2**32))

    def _open(self) -> FileIO:
        if self._file is None:
            number = 1
            while (path := self._directory / FILE_NAME.format(number)).exists():
                number += 1
            self.path = path
            self._file = FileIO(path, "xb")
        return self._file

    def _laid_out(self, records: LogRecords) -> bytes:
        """Blocks of records, numbered after the final ones."""
        blocks = lay_out(records, self._session, CAPACITY, SETUP_EVERY)
        for i, block in enumerate(blocks):
            _stamp(block, self._session, self._blocks + i, self._samples)
        return blocks.tobytes()


def _write_all(file: FileIO, data: bytes, at: int) -> None:
    file.seek(at)
    rest = memoryview(data)
    while rest:
        rest = rest[file.write(rest) :]


@dataclass(frozen=True)
class RecordingStatus:
    """State of the recording: file name, written bytes, and the newest failure."""

    name: str = ""
    bytes_written: int = 0
    flaw: str = ""


class Recorder:
    """Writes in a thread, so that a slow disc delays no frame."""

    def __init__(self, writer: SessionWriter) -> None:
        self._writer = writer
        self._batches: queue.Queue[Sequence[Batch] | None] = queue.Queue(MOST_WAITING)
        self.status = RecordingStatus()
        self._synced_at = time.monotonic()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)

    def __enter__(self) -> "Recorder":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with contextlib.suppress(queue.Full):  # of a hanging disc; the thread ends with the program
            self._batches.put(None, timeout=ENDS_WITHIN)
        self._thread.join(ENDS_WITHIN)

    @property
    def path(self) -> Path | None:
        """The newest file."""
        return self._writer.path

    def add(self, batches: Sequence[Batch]) -> None:
        """Queue batches for writing."""
        try:
            self._batches.put_nowait(batches)
        except queue.Full:
            self.status = replace(self.status, flaw="the disc has taken nothing for minutes, records were lost")

    def settle(self) -> None:
        """Wait until all added batches were written or failed."""
        self._batches.join()

    def _run(self) -> None:
        while (batches := self._batches.get()) is not None:
            for batch in batches:
                self._attempt(self._write, batch)
            if time.monotonic() - self._synced_at > SYNC_EVERY:
                self._attempt(self._writer.sync)
                self._synced_at = time.monotonic()
            self._batches.task_done()
        self._attempt(self._writer.close)

    def _write(self, batch: Batch) -> None:
        self._writer.add(batch.records, batch.restarted)
        name = self._writer.path.name if self._writer.path else ""
        self.status = RecordingStatus(name, self._writer.bytes_written)

    def _attempt(self, what, *args) -> None:  # type: ignore[no-untyped-def]
        """Call a function; store its failure and continue, since the disc may have room again."""
        try:
            what(*args)
        except OSError as error:
            self.status = replace(self.status, flaw=error.strerror or str(error))
        except ValueError as error:  # records that the format cannot hold, of a damaged stream
            self.status = replace(self.status, flaw=str(error))


def _stamp(block: np.ndarray, session: int, blocks: int, samples: int) -> None:
    """Continue the numbers of the blocks written before, in place."""
    block[4:8] = np.frombuffer(session.to_bytes(4, "little"), dtype=np.uint8)
    for part, before in ((_SEQUENCE, blocks), (_IMU_NUMBER, samples)):
        own = int.from_bytes(block[part].tobytes(), "little") if part is _IMU_NUMBER else 0
        block[part] = np.frombuffer(((own + before) % 2**32).to_bytes(4, "little"), dtype=np.uint8)
    block[CRC_AT:] = np.frombuffer(CRC_STRUCT.pack(zlib.crc32(block[:CRC_AT].tobytes())), dtype=np.uint8)


def _newest_us(records: LogRecords) -> int:
    times = [int(t[-1]) for t in (records.imu_t, records.mag_t, records.temperature_t) if t.size]
    times += [t for t, _ in records.sentences[-1:]]
    return max(times, default=0)


def _joined(parts: list[LogRecords]) -> LogRecords:
    """One set of records, in order, with the last known settings or the default ones, which give the ranges."""
    setups = [part.setup for part in parts if part.setup is not None]
    stops = [part.stop for part in parts if part.stop is not None]
    return LogRecords(
        setups[-1] if setups else Setup(),
        next((part.config for part in reversed(parts) if part.config), ""),
        np.concatenate([part.imu_t for part in parts]),
        np.concatenate([part.imu for part in parts]),
        np.concatenate([part.mag_t for part in parts]),
        np.concatenate([part.mag for part in parts]),
        np.concatenate([part.mag_flags for part in parts]),
        np.concatenate([part.temperature_t for part in parts]),
        np.concatenate([part.temperature for part in parts]),
        tuple(sentence for part in parts for sentence in part.sentences),
        tuple(gap for part in parts for gap in part.gaps),
        tuple(event for part in parts for event in part.events),
        tuple(test for part in parts for test in part.self_tests),
        stops[-1] if stops else None,
    )
