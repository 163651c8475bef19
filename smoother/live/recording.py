"""The stream written down as the logger's own card would hold it: blocks of a `.klg` file, as they come."""

import zlib
from pathlib import Path
from typing import BinaryIO

import numpy as np

from smoother.errors import UsageError
from smoother.session.log_encode import SETUP_EVERY, lay_out
from smoother.session.log_format import BLOCK_BYTES, CAPACITY, CRC_AT, CRC_STRUCT, LogRecords, Setup

FILE_NAME = "LIVE{:04d}.KLG"
FLUSH_EVERY = 1.0  # s of records; what is lost when the computer fails
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
        self._file: BinaryIO | None = None
        self._waiting: list[LogRecords] = []
        self._blocks = self._samples = self._session = 0
        self._flushed_us = 0
        self.path: Path | None = None
        self.bytes_written = 0

    def add(self, records: LogRecords, restarted: bool = False) -> None:
        """Take in records; those of a second are written together. Raises OSError when the disk is full."""
        if restarted:
            self._finish()
        newest = _newest_us(records)
        if not self._waiting:
            self._flushed_us = min(self._flushed_us, newest) if self._file else newest
        self._waiting.append(records)
        if newest - self._flushed_us > FLUSH_EVERY * 1e6:
            self._flush()
            self._flushed_us = newest

    def close(self) -> None:
        """Write what is left."""
        self._finish()

    def _finish(self) -> None:
        self._flush()
        if self._file is not None:
            self._file.close()
        self._file, self._blocks, self._samples = None, 0, 0

    def _open(self) -> BinaryIO:
        if self._file is None:
            number = 1
            while (path := self._directory / FILE_NAME.format(number)).exists():
                number += 1
            self.path = path
            self._session = int(self._rng.integers(1, 2**32))
            self._file = path.open("wb")
        return self._file

    def _flush(self) -> None:
        waiting, self._waiting = self._waiting, []
        if not waiting:
            return
        records = _joined(waiting)
        blocks = lay_out(records, self._session, CAPACITY, SETUP_EVERY)
        file = self._open()
        for block in blocks:
            _stamp(block, self._session, self._blocks, self._samples)
            self._blocks += 1
            file.write(block.tobytes())
        self._samples += len(records.imu_t)
        self.bytes_written += len(blocks) * BLOCK_BYTES
        file.flush()


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
    """One set of records, in order. The settings are those of the last that has them; without any, as they usually are.

    Blocks without SETUP would be read with the wrong ranges, hence never none.
    """
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
        tuple(pulse for part in parts for pulse in part.pps),
        tuple(gap for part in parts for gap in part.gaps),
        tuple(event for part in parts for event in part.events),
        tuple(test for part in parts for test in part.self_tests),
        stops[-1] if stops else None,
    )
