"""From records to bytes, as the logger's writer lays them out: the counterpart of `log_decode.py`.

Block boundaries are found one block at a time, the bytes of all records of a type are written at once.
"""

import zlib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from smoother.arrays import BoolArray, IntArray
from smoother.session import log_format as form
from smoother.session.log_format import Gap, LogRecords

SETUP_EVERY = 5_000_000  # us
_BITS_PER_BYTE = 10  # 8N1


@dataclass(frozen=True)
class LongRecord:
    """One long record: when it was recorded (which orders it), its own time, both us, its type and its data."""

    recorded_us: int
    t_us: int
    kind: int
    data: bytes
    imu_lost: int = 0


@dataclass(frozen=True, eq=False)
class _Queue:
    """All records (R,) in the order in which they are recorded. row: number within the arrays or list of its type."""

    kind: npt.NDArray[np.uint8]
    t_us: IntArray
    length: IntArray
    imu: IntArray  # samples of the IMU that a record counts
    row: IntArray


def encode(records: LogRecords, session: int) -> bytes:
    """Return a recording as the blocks of one file.

    SETUP and CONFIG stand first and every 5 s; a sentence is recorded when its last byte came in. Raises ValueError
    for what the format cannot hold.
    """
    return lay_out(records, session, form.CAPACITY, SETUP_EVERY).tobytes()


def lay_out(records: LogRecords, session: int, capacity: int, setup_every: int) -> npt.NDArray[np.uint8]:
    """Return the blocks (K, 512) of a recording, with at most `capacity` bytes of records each; setup_every in us."""
    short = _short_rows(records)
    long = _long_records(records, setup_every)
    queue = _queue(short, long)
    if queue.t_us.size and queue.t_us.min() < 0:
        raise ValueError("times before power-on cannot be recorded")
    first, base = _boundaries(queue, capacity)
    content = np.zeros((len(first), form.BLOCK_BYTES), dtype=np.uint8)
    block = np.repeat(np.arange(len(first)), np.diff(first, append=len(queue.kind)))
    before = np.cumsum(queue.length) - queue.length
    at = block * form.BLOCK_BYTES + form.RECORDS_AT + before - before[first][block] if len(first) else before
    since = queue.t_us - base[block] if len(first) else queue.t_us
    _put_short(content.reshape(-1), queue, short, at, since)
    _put_long(content.reshape(-1), queue, long, at, since)
    _put_heads(content, queue, first, base, session)
    return content


def _short_rows(records: LogRecords) -> dict[int, tuple[IntArray, npt.NDArray[np.void]]]:
    """Times and rows of each short type, without their place in a block."""
    rows = {}
    parts = ((form.IMU, records.imu_t, records.imu), (form.MAG, records.mag_t, records.mag))
    for kind, times, counts in (*parts, (form.TEMPERATURE, records.temperature_t, records.temperature)):
        row = np.zeros(len(times), dtype=form.SHORT_LAYOUTS[kind])
        row["type"], row["counts"] = kind, counts
        if kind == form.MAG:
            row["flags"] = records.mag_flags
        rows[kind] = (times, row)
    return rows


def _long_records(records: LogRecords, setup_every: int) -> list[LongRecord]:
    """All long records, in order of when they are recorded."""
    long = list(_sentences(records))
    long += [LongRecord(e.t_us, e.t_us, form.EVENT, form.EVENT_STRUCT.pack(e.code, e.value)) for e in records.events]
    long += [_gap(gap) for gap in records.gaps]
    for test in records.self_tests:
        data = form.SELF_TEST_STRUCT.pack(*test.response, test.factory_code, test.passed)
        long.append(LongRecord(test.t_us, test.t_us, form.SELF_TEST, data))
    long.sort(key=lambda record: record.recorded_us)
    times = [t for t in (records.imu_t, records.mag_t, records.temperature_t) if t.size]
    start = min([int(t[0]) for t in times] + [record.recorded_us for record in long], default=0)
    end = max([int(t[-1]) for t in times] + [record.recorded_us for record in long], default=start)
    return [*_described(records, range(start, end + 1, setup_every)), *long, *_stopped(records)]


def _sentences(records: LogRecords) -> Iterator[LongRecord]:
    baud = (records.setup.gps_baud if records.setup else 0) or 9600
    for t_us, sentence in records.sentences:
        if len(sentence) > form.LONGEST_SENTENCE:
            raise ValueError(f"a sentence of {len(sentence)} bytes is longer than {form.LONGEST_SENTENCE}")
        yield LongRecord(t_us + len(sentence) * _BITS_PER_BYTE * 1_000_000 // baud, t_us, form.GPS, sentence)


def _gap(gap: Gap) -> LongRecord:
    first, last = gap.first_us, gap.last_us
    times = (first & 0xFFFFFFFF, first >> 32, last & 0xFFFFFFFF, last >> 32)
    data = form.GAP_STRUCT.pack(gap.source, gap.reason, gap.count, *times)
    return LongRecord(last, last, form.GAP, data, gap.count if gap.source == form.IMU else 0)


def _described(records: LogRecords, times: Iterable[int]) -> Iterator[LongRecord]:
    """SETUP and CONFIG at these times."""
    if records.setup is None:
        return
    setup, text = records.setup.pack(), records.config.encode("ascii")
    for t_us in times:
        yield LongRecord(t_us, t_us, form.SETUP, setup)
        for offset in range(0, len(text), form.CONFIG_PIECE):
            data = form.CONFIG_STRUCT.pack(offset, len(text)) + text[offset : offset + form.CONFIG_PIECE]
            yield LongRecord(t_us, t_us, form.CONFIG, data)


def _stopped(records: LogRecords) -> Iterator[LongRecord]:
    if (stop := records.stop) is not None:
        counts = (stop.imu_records, stop.imu_lost, stop.gps_records, stop.most_blocks, stop.card_retries)
        yield LongRecord(np.iinfo(np.int64).max, stop.t_us, form.STOP, form.STOP_STRUCT.pack(stop.reason, *counts))


def _queue(short: dict[int, tuple[IntArray, npt.NDArray[np.void]]], long: list[LongRecord]) -> _Queue:
    """Merge all records in order of their recording; at equal times long ones first, then IMU, MAG, TEMPERATURE."""
    recorded = [np.array([record.recorded_us for record in long], dtype=np.int64)]
    kind = [np.array([record.kind for record in long], dtype=np.uint8)]
    t_us = [np.array([record.t_us for record in long], dtype=np.int64)]
    length = [np.array([form.LONG_STRUCT.size + len(record.data) for record in long], dtype=np.int64)]
    imu = [np.array([record.imu_lost for record in long], dtype=np.int64)]
    row = [np.arange(len(long))]
    for of_kind, (times, rows) in short.items():
        recorded.append(times)
        t_us.append(times)
        kind.append(np.full(len(times), of_kind, dtype=np.uint8))
        length.append(np.full(len(times), rows.itemsize, dtype=np.int64))
        imu.append(np.full(len(times), of_kind == form.IMU, dtype=np.int64))
        row.append(np.arange(len(times)))
    order = np.argsort(np.concatenate(recorded), kind="stable")
    return _Queue(
        np.concatenate(kind)[order],
        np.concatenate(t_us)[order],
        np.concatenate(length)[order],
        np.concatenate(imu)[order],
        np.concatenate(row)[order],
    )


def _boundaries(queue: _Queue, capacity: int) -> tuple[IntArray, IntArray]:
    """First record (K,) and base time (K,) us of each block: as many records as fit, none 65 ms after the base."""
    is_short = queue.kind < form.FIRST_LONG
    newest = np.maximum.accumulate(np.where(is_short, queue.t_us, np.iinfo(np.int64).min))
    end_bytes = np.cumsum(queue.length)
    short_at, short_t = np.flatnonzero(is_short), queue.t_us[is_short]
    latest = np.maximum.accumulate(queue.t_us)
    first, base, at, total = [], [], 0, len(queue.kind)
    while at < total:
        start_bytes = end_bytes[at] - queue.length[at]
        base_us = _base(queue, newest, is_short, at)
        by_size = int(np.searchsorted(end_bytes, start_bytes + capacity, side="right"))
        late = int(np.searchsorted(short_t, base_us + form.LONGEST_SHORT_TIME, side="right"))
        by_time = int(short_at[late]) if late < len(short_at) else total
        by_time = min(by_time, int(np.searchsorted(latest, base_us + form.LONGEST_LONG_TIME, side="right")))
        first.append(at)
        base.append(base_us)
        at = max(at + 1, min(by_size, by_time))
    return np.array(first, dtype=np.int64), np.array(base, dtype=np.int64)


def _base(queue: _Queue, newest: IntArray, is_short: BoolArray, at: int) -> int:
    """Base of a block that begins with record `at`: the newest sample's time while samples come, see log_writer.c."""
    t_us = int(queue.t_us[at])
    return int(newest[at]) if not is_short[at] and t_us <= newest[at] + form.LONGEST_SHORT_TIME else t_us


def _put_short(
    octets: npt.NDArray[np.uint8],
    queue: _Queue,
    short: dict[int, tuple[IntArray, npt.NDArray[np.void]]],
    at: IntArray,
    since: IntArray,
) -> None:
    for kind, (_, rows) in short.items():
        mine = np.flatnonzero(queue.kind == kind)
        if mine.size == 0:
            continue
        rows["since"][queue.row[mine]] = since[mine]
        count = octets.size - rows.itemsize + 1
        everywhere: npt.NDArray[np.void] = np.ndarray((count,), rows.dtype, octets.data, strides=(1,))
        everywhere[at[mine]] = rows[queue.row[mine]]


def _put_long(
    octets: npt.NDArray[np.uint8], queue: _Queue, long: list[LongRecord], at: IntArray, since: IntArray
) -> None:
    mine = np.flatnonzero(queue.kind >= form.FIRST_LONG)
    for row, place, time in zip(queue.row[mine].tolist(), at[mine].tolist(), since[mine].tolist(), strict=True):
        record = long[row]
        text = form.LONG_STRUCT.pack(record.kind, len(record.data), time) + record.data
        octets[place : place + len(text)] = np.frombuffer(text, dtype=np.uint8)


def _put_heads(content: npt.NDArray[np.uint8], queue: _Queue, first: IntArray, base: IntArray, session: int) -> None:
    head = np.zeros(len(first), dtype=form.HEAD_LAYOUT)
    head["magic"], head["session"], head["sequence"] = form.MAGIC, session, np.arange(len(first))
    head["base_low"], head["base_high"] = base & 0xFFFFFFFF, base >> 32
    if len(first):
        head["used"] = np.add.reduceat(queue.length, first)
        head["imu_number"] = (np.cumsum(queue.imu) - queue.imu)[first] & 0xFFFFFFFF
    content[:, : form.RECORDS_AT] = head.view(np.uint8).reshape(len(first), form.RECORDS_AT)
    view = content.reshape(-1).data
    for start in range(0, content.size, form.BLOCK_BYTES):
        form.CRC_STRUCT.pack_into(view, start + form.CRC_AT, zlib.crc32(view[start : start + form.CRC_AT]))
