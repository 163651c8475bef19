"""From bytes to records: finds the blocks that are whole, walks all of them at once, and counts what is missing.

Nothing here raises on any bytes: a block that fails its CRC is lost, the others need nothing from it.
"""

import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from mmap import mmap
from operator import eq
from typing import Any, TypeVar, overload

import numpy as np
import numpy.typing as npt

from smoother.arrays import IntArray
from smoother.disc import Growing, pieces, release, roomy
from smoother.session import log_format as form
from smoother.session.log_format import Event, Gap, LogRecords, SelfTest, Setup, Stop

SENTENCES_TOGETHER = 1 << 14  # sentences that are extracted together


class Sentences(Sequence[tuple[int, bytes]]):
    """Pairs of time in us and text that behave like a tuple of them; held as columns, on the disc where they are many.

    Filled by `extend` while a recording is decoded, and not changed after.
    """

    def __init__(self) -> None:
        self._t_us, self._end, self._text = Growing(dtype=np.int64), Growing(dtype=np.int64), Growing(dtype=np.uint8)

    def extend(self, sentences: Sequence[tuple[int, bytes]]) -> None:
        """Append pairs of time in us and text."""
        lengths = np.array([len(text) for _, text in sentences], dtype=np.int64)
        self._end.add(len(self._text) + np.cumsum(lengths))
        self._t_us.add(np.array([t_us for t_us, _ in sentences], dtype=np.int64))
        self._text.add(np.frombuffer(b"".join(text for _, text in sentences), dtype=np.uint8))

    def __len__(self) -> int:
        return len(self._t_us)

    @overload
    def __getitem__(self, at: int) -> tuple[int, bytes]: ...
    @overload
    def __getitem__(self, at: slice) -> tuple[tuple[int, bytes], ...]: ...
    def __getitem__(self, at: int | slice) -> tuple[int, bytes] | tuple[tuple[int, bytes], ...]:
        rows = range(len(self))[at]
        if isinstance(rows, int):
            return self._between(rows, rows + 1)[0]
        return tuple(self._between(row, row + 1)[0] for row in rows)

    def __iter__(self) -> Iterator[tuple[int, bytes]]:
        for some in pieces(len(self), SENTENCES_TOGETHER):
            yield from self._between(some.start, some.stop)
            release(self._t_us.rows, self._end.rows, self._text.rows)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and len(self) == len(other) and all(map(eq, self, other))

    __hash__ = None  # type: ignore[assignment]  # it is filled bit by bit

    def __repr__(self) -> str:
        return repr(tuple(self))

    def _between(self, first: int, last: int) -> list[tuple[int, bytes]]:
        start = int(self._end.rows[first - 1]) if first else 0
        ends = (self._end.rows[first:last] - start).tolist()
        text = self._text.rows[start : start + ends[-1]].tobytes()
        times = self._t_us.rows[first:last].tolist()
        return [(t, text[begin:end]) for t, begin, end in zip(times, [0, *ends[:-1]], ends, strict=True)]


Bytes = npt.NDArray[np.uint8]
TOGETHER = 1 << 15  # blocks that are worked on together, 16 MB of them


@dataclass(frozen=True, eq=False)
class Blocks:
    """Whole blocks: content (K, 512) bytes and their heads (K,) in HEAD_LAYOUT; base_us (K,) us."""

    content: Bytes
    head: npt.NDArray[np.void]
    base_us: IntArray

    @staticmethod
    def of(content: Bytes) -> "Blocks":
        """Wrap blocks (K, 512) whose CRC is right."""
        head = np.empty(len(content), dtype=form.HEAD_LAYOUT)
        for part in pieces(len(content), TOGETHER):
            head[part] = np.ascontiguousarray(content[part, : form.RECORDS_AT]).view(form.HEAD_LAYOUT)[:, 0]
            release(content)
        base = head["base_low"].astype(np.int64) + (head["base_high"].astype(np.int64) << 32)
        return Blocks(content, head, base)

    def select(self, keep: npt.NDArray[np.generic] | slice) -> "Blocks":
        """Return the blocks chosen by a mask (K,), by indices, or by a slice, which copies nothing."""
        content = self.content[keep] if isinstance(keep, slice) else _rows(self.content, np.arange(len(self))[keep])
        return Blocks(content, self.head[keep], self.base_us[keep])

    def __len__(self) -> int:
        return len(self.content)


@dataclass(frozen=True)
class Losses:
    """What a recording lacks. blocks: missing by their numbers; samples: of the IMU in them; unreadable: rest of a
    block, of a newer version; duplicates: blocks that came twice."""

    blocks: int = 0
    samples: int = 0
    unreadable: int = 0
    duplicates: int = 0


def find_blocks(data: bytes | mmap) -> tuple[Blocks, int]:
    """Return the blocks in `data` that are whole, wherever they begin, and how many damaged ones show their magic."""
    positions, damaged, view = array("q"), 0, memoryview(data)
    at = data.find(form.MAGIC, 0)
    while at >= 0:
        if _is_whole(view, at):
            positions.append(at)
            at += form.BLOCK_BYTES
        else:
            damaged += 1
            at += 1
        if len(positions) % TOGETHER == 0:
            release(data)
        at = data.find(form.MAGIC, at)
    return Blocks.of(_blocks_at(np.frombuffer(data, dtype=np.uint8), np.frombuffer(positions, dtype=np.int64))), damaged


def _is_whole(view: memoryview, at: int) -> bool:
    block = view[at : at + form.BLOCK_BYTES]
    if len(block) < form.BLOCK_BYTES or int.from_bytes(block[18:20], "little") > form.CAPACITY:
        return False
    return zlib.crc32(block[: form.CRC_AT]) == int.from_bytes(block[form.CRC_AT :], "little")


def _blocks_at(octets: Bytes, positions: IntArray) -> Bytes:
    """Blocks (K, 512): the bytes of the file themselves where no damage lies between, to spare a day of them a copy."""
    if positions.size == 0:
        return np.zeros((0, form.BLOCK_BYTES), dtype=np.uint8)
    start, end = positions[0], positions[-1] + form.BLOCK_BYTES
    if end - start == positions.size * form.BLOCK_BYTES:
        return octets[start:end].reshape(-1, form.BLOCK_BYTES)
    return _rows(np.lib.stride_tricks.sliding_window_view(octets, form.BLOCK_BYTES), positions)


def _rows(content: Bytes, index: IntArray) -> Bytes:
    """Rows `index` (K,) of blocks (N, 512), on the disc where they are many."""
    out = roomy((len(index), form.BLOCK_BYTES), np.uint8)
    for part in pieces(len(index), TOGETHER):
        out[part] = content[index[part]]
        release(out, content)
    return out


def in_sequence(blocks: Blocks) -> tuple[Blocks, int]:
    """Return the blocks of one recording in order of their numbers, each once, and how many came again."""
    _, first = np.unique(blocks.head["sequence"], return_index=True)
    if len(first) == len(blocks) and np.array_equal(first, np.arange(len(blocks))):
        return blocks, 0
    return blocks.select(first), len(blocks) - len(first)


def decode(blocks: Blocks) -> tuple[LogRecords, Losses]:
    """Return the records of one recording, and what it lacks. The blocks may come in any order."""
    blocks, duplicates = in_sequence(blocks)
    short = {name: Growing(width, dtype) for name, (width, dtype) in _SHORT_COLUMNS.items()}
    long: dict[int, list[tuple[int, bytes]]] = {kind: [] for kind in range(form.GAP, form.STOP + 1)}
    sentences, in_block, unreadable = Sentences(), [], 0
    for some in [*pieces(len(blocks), TOGETHER)] or [slice(0)]:
        part = _decode_some(blocks.select(some))
        for name, rows in part.short.items():
            short[name].add(rows)
        for kind, records in long.items():
            records += part.long[kind]
        sentences.extend(part.long[form.GPS])
        in_block.append(part.imu_in_block)
        unreadable += part.unreadable
    release(blocks)
    found = {name: column.rows for name, column in short.items()}
    missing_blocks, missing_samples = _missing(blocks, np.concatenate(in_block))
    all_records = LogRecords(**found, sentences=sentences, **_long_records(long))  # type: ignore[arg-type]
    return all_records, Losses(missing_blocks, missing_samples, unreadable, duplicates)


_TIMES = ((), np.int64)
_SHORT_COLUMNS: dict[str, tuple[tuple[int, ...], type]] = {
    "imu_t": _TIMES,
    "imu": ((6,), np.int16),
    "mag_t": _TIMES,
    "mag": ((3,), np.int16),
    "mag_flags": ((), np.uint8),
    "temperature_t": _TIMES,
    "temperature": ((), np.int16),
}


@dataclass(frozen=True, eq=False)
class _Part:
    """Records of some blocks: short ones as arrays by field of LogRecords, long ones as (us, bytes) by type.

    imu_in_block: samples of the IMU in each block or known to be lost in it. unreadable: see Losses.
    """

    short: dict[str, npt.NDArray[Any]]
    long: dict[int, list[tuple[int, bytes]]]
    imu_in_block: IntArray
    unreadable: int


def _decode_some(blocks: Blocks) -> _Part:
    octets = blocks.content.reshape(-1)
    position, unreadable = walk(blocks)
    kind = octets[position]
    long = position[kind >= form.FIRST_LONG]
    short: dict[str, npt.NDArray[Any]] = {}
    for name, layout in (("imu", form.IMU), ("mag", form.MAG), ("temperature", form.TEMPERATURE)):
        rows, short[f"{name}_t"] = _short_records(octets, blocks.base_us, position[kind == layout], layout)
        short[name] = np.ascontiguousarray(rows["counts"])
        if layout == form.MAG:
            short["mag_flags"] = np.ascontiguousarray(rows["flags"])
    imu_in_block = np.bincount(position[kind == form.IMU] // form.BLOCK_BYTES, minlength=len(blocks))
    imu_in_block += _imu_gaps(octets, long, len(blocks))
    part = _Part(short, _long_by_type(octets, blocks.base_us, long), imu_in_block, unreadable)
    release(blocks.content)
    return part


_SHORT_LENGTH = np.array(
    [form.SHORT_LAYOUTS[kind].itemsize if kind in form.SHORT_LAYOUTS else 0 for kind in range(256)]
)


def walk(blocks: Blocks) -> tuple[IntArray, int]:
    """Find all records of all blocks: one step takes the next record of every block.

    Returns the positions (R,) of the records in the joined blocks, ascending, and how many blocks have an unreadable
    rest.
    """
    octets = blocks.content.reshape(-1)
    start = np.arange(len(blocks), dtype=np.int64) * form.BLOCK_BYTES + form.RECORDS_AT
    end = start + blocks.head["used"]
    at, end = start[end > start], end[end > start]
    found, unreadable = [], 0
    while at.size:
        kind = octets[at]
        length = _SHORT_LENGTH[kind]
        long = np.flatnonzero(kind >= form.FIRST_LONG)
        length[long] = form.LONG_LAYOUT.itemsize + octets[at[long] + 1].astype(np.int64)
        good = (length > 0) & (at + length <= end)
        unreadable += int(np.count_nonzero(~good))
        found.append(at[good])
        at, end = (at + length)[good], end[good]
        more = at < end
        at, end = at[more], end[more]
    return np.sort(np.concatenate(found)) if found else np.zeros(0, dtype=np.int64), unreadable


def _layout_at(octets: Bytes, position: IntArray, layout: np.dtype[np.void]) -> npt.NDArray[np.void]:
    """Structures (R,) that begin at any byte."""
    if position.size == 0:
        return np.zeros(0, dtype=layout)
    count = octets.size - layout.itemsize + 1
    everywhere: npt.NDArray[np.void] = np.ndarray((count,), layout, octets.data, strides=(1,))
    return everywhere[position]


def _short_records(
    octets: Bytes, base_us: IntArray, position: IntArray, kind: int
) -> tuple[npt.NDArray[np.void], IntArray]:
    rows = _layout_at(octets, position, form.SHORT_LAYOUTS[kind])
    return rows, base_us[position // form.BLOCK_BYTES] + rows["since"]


def _long_by_type(octets: Bytes, base_us: IntArray, position: IntArray) -> dict[int, list[tuple[int, bytes]]]:
    """Time and content of the long records."""
    head = _layout_at(octets, position, form.LONG_LAYOUT)
    times = (base_us[position // form.BLOCK_BYTES] + head["since"]).tolist()
    of_kind: dict[int, list[tuple[int, bytes]]] = {kind: [] for kind in range(form.GPS, form.STOP + 1)}
    for kind, length, t_us, at in zip(
        head["type"].tolist(), head["length"].tolist(), times, position.tolist(), strict=True
    ):
        if kind in of_kind:
            start = at + form.LONG_LAYOUT.itemsize
            of_kind[kind].append((t_us, octets[start : start + length].tobytes()))
    return of_kind


def _long_records(of_kind: dict[int, list[tuple[int, bytes]]]) -> dict[str, object]:
    """The long records but sentences as fields of LogRecords."""
    setups, stops = _whole(of_kind[form.SETUP], _setup), _whole(of_kind[form.STOP], _stop)
    return {
        "gaps": tuple(_whole(of_kind[form.GAP], _gap)),
        "setup": setups[-1] if setups else None,
        "config": _config([data for _, data in of_kind[form.CONFIG]]),
        "events": tuple(_whole(of_kind[form.EVENT], _event)),
        "self_tests": tuple(_whole(of_kind[form.SELF_TEST], _self_test)),
        "stop": stops[-1] if stops else None,
    }


T = TypeVar("T")


def _whole(records: Sequence[tuple[int, bytes]], read: Callable[[int, bytes], T]) -> list[T]:
    """Read those records that are as long as their type must be."""
    values = []
    for t_us, data in records:
        try:
            values.append(read(t_us, data))
        except struct.error:
            continue
    return values


def _gap(_: int, data: bytes) -> Gap:
    source, reason, count, first, first_high, last, last_high = form.GAP_STRUCT.unpack_from(data)
    return Gap(source, reason, count, first | first_high << 32, last | last_high << 32)


def _setup(_: int, data: bytes) -> Setup:
    return Setup.unpack(data)


def _event(t_us: int, data: bytes) -> Event:
    return Event(t_us, *form.EVENT_STRUCT.unpack_from(data))


def _self_test(t_us: int, data: bytes) -> SelfTest:
    *response, code, passed = form.SELF_TEST_STRUCT.unpack_from(data)
    return SelfTest(t_us, tuple(response), code, passed)


def _stop(t_us: int, data: bytes) -> Stop:
    return Stop(t_us, *form.STOP_STRUCT.unpack_from(data))


def _config(pieces: Sequence[bytes]) -> str:
    """The settings from the last set of pieces that is complete; they repeat."""
    text, so_far = "", b""
    for piece in pieces:
        if len(piece) < form.CONFIG_STRUCT.size:
            continue
        offset, total = form.CONFIG_STRUCT.unpack_from(piece)
        so_far = so_far if offset else b""
        if offset == len(so_far):
            so_far += piece[form.CONFIG_STRUCT.size :]
        if len(so_far) == total:
            text = so_far.decode("ascii", errors="replace")
    return text


def _imu_gaps(octets: Bytes, position: IntArray, blocks: int) -> IntArray:
    """Lost samples (K,) of the IMU by the gaps in each block."""
    lost = np.zeros(blocks, dtype=np.int64)
    length = form.LONG_LAYOUT.itemsize + form.GAP_STRUCT.size
    for at in position[octets[position] == form.GAP].tolist():
        if octets[at + 1] >= form.GAP_STRUCT.size:
            gap = _gap(0, octets[at + form.LONG_LAYOUT.itemsize : at + length].tobytes())
            lost[at // form.BLOCK_BYTES] += gap.count if gap.source == form.IMU else 0
    return lost


def _missing(blocks: Blocks, samples_in_block: IntArray) -> tuple[int, int]:
    """Blocks missing by their numbers, and samples of the IMU missing by theirs; what came last cannot be known."""
    if len(blocks) == 0:
        return 0, 0
    number = blocks.head["imu_number"].astype(np.int64)
    expected = np.concatenate([[0], number[:-1] + samples_in_block[:-1]])
    step = (number - expected) & 0xFFFFFFFF
    samples = int(step[step < 0x80000000].sum())
    return int(blocks.head["sequence"][-1]) + 1 - len(blocks), samples
