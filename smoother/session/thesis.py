"""The thesis' two files: out.txt (IMU, magnetometer, NMEA) and magcalib.txt. Owns their byte layout.

A record of out.txt is, little endian,

    RECORD_START  IMU_STRUCT  [flag]  END_STRUCT                              without GPS data, flag optional
    RECORD_START  IMU_STRUCT  GPS_FLAG  MAG_STRUCT  <NMEA block>  END_STRUCT  with GPS data

where the NMEA block is the receiver's whole buffer, so it has one length throughout a file: the sentence, then
whatever the buffer held before. magcalib.txt is RECORD_START (or its first byte) and MAG_STRUCT triples.

Nothing in a record says how long it is, the low byte of an end time can equal GPS_FLAG, and data can hold
RECORD_START. So every place that could start a record is a node, every length that leads to another one an edge, and
the chain that explains most of the file in the best order of time is the reading (dynamic programming from the end).
"""

import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, BoolArray, IntArray
from smoother.errors import SessionError
from smoother.samples import GnssFixes, Problem, RawImu, RawMag
from smoother.session.nmea import fixes_from_sentences
from smoother.session.rows import in_time_order
from smoother.session.text import whole
from smoother.units import DEG, MILLISECOND, STANDARD_GRAVITY
from smoother.words import counted

RECORD_START = b"YY"
IMU_STRUCT = struct.Struct("<I6h")  # start time in ms (wraps at 2^32), ax ay az gx gy gz in counts
GPS_FLAG = 0x71  # this byte after the IMU values: magnetometer and NMEA follow
NO_GPS_FLAG = 0x00  # the optional flag byte of a record without GPS data
MAG_STRUCT = struct.Struct("<3h")  # my, mx, -mz in counts
END_STRUCT = struct.Struct("<I")  # end time in ms

ACCEL_FULL_SCALE = 4.0 * STANDARD_GRAVITY  # m/s^2
GYRO_FULL_SCALE = 500.0 * DEG  # rad/s
ACCEL_SCALE = ACCEL_FULL_SCALE / 32768.0  # m/s^2 per count
GYRO_SCALE = GYRO_FULL_SCALE / 32768.0  # rad/s per count

_FLAG_OFFSET = len(RECORD_START) + IMU_STRUCT.size
_PLAIN = _FLAG_OFFSET + END_STRUCT.size  # bytes of a record without GPS data and without flag
_FLAGGED = _PLAIN + 1
_BLOCK_OFFSET = _FLAG_OFFSET + 1 + MAG_STRUCT.size
_WITH_GPS = _BLOCK_OFFSET + END_STRUCT.size  # plus the NMEA block

LONGEST_BLOCK = 4096  # bytes; no receiver buffer on the thesis' 20 KB of RAM is larger
LONGEST_RECORD_TIME = 10_000  # ms from start to end of one record
LONGEST_PAUSE = 600_000  # ms between records; after a longer one the chain has to be entered anew
BLOCK_VOTES = 0.8  # a block length with this share of the most votes counts as much: see find_block_length

# Scores of the search: a step is worth a record if structure and both time orders agree, and losing the thread costs
# as much as one record. A wrong time alone must not outweigh the structure.
_STRUCTURE, _END_ORDER, _NEXT_ORDER, _LOST = 0.5, 0.25, 0.25, 1.0
_LEADING_SENTENCES = re.compile(rb"[^$]*((?:\$[^\r\n$\x00]*[\r\n]*)+)")


@dataclass(frozen=True, eq=False)
class ThesisRecording:
    """What out.txt holds, on the logger's clock in seconds."""

    imu: RawImu
    mag: RawMag
    gnss: GnssFixes
    problems: list[Problem]


@dataclass(frozen=True, eq=False)
class Records:
    """Records found in a file: byte positions (K,) and whether each carries GPS data (K,); what was not resolved.

    block_length : bytes of the NMEA block, None without any. lost : stretches that could not be resolved, and their
    bytes. tail : bytes after the last whole record.
    """

    position: IntArray
    has_gps: BoolArray
    block_length: int | None
    lost: int
    lost_bytes: int
    tail: int


def read_out(path: Path) -> ThesisRecording:
    """Read out.txt. Raises SessionError if it holds no record or no NMEA sentence."""
    data = whole(path)
    if not data:
        raise SessionError(f"{path.name}: the file is empty; was the recording started?")
    records = find_records(data)
    if records.position.size == 0:
        raise SessionError(
            f"{path.name}: no record of the thesis' format ({len(data)} bytes); is it the logger's file?"
        )
    start_ms, counts = _imu_values(data, records.position)
    ordered = in_time_order(start_ms * MILLISECOND, counts, file=path.name, prefix="imu")
    t, index = ordered.t, ordered.index
    imu = RawImu(t, counts[index, :3], counts[index, 3:], ACCEL_SCALE, GYRO_SCALE, ACCEL_FULL_SCALE, GYRO_FULL_SCALE)
    with_gps = records.has_gps[index]
    position = records.position[index][with_gps]
    blocks = _blocks(data, position, records.block_length or 0)
    reading = fixes_from_sentences(zip(t[with_gps].tolist(), blocks, strict=True), path.name)
    mag = RawMag(t[with_gps], _field(data, position + _FLAG_OFFSET + 1))
    return ThesisRecording(
        imu, mag, reading.gnss, [*_unresolved(records, path.name), *ordered.problems, *reading.problems]
    )


def read_magcalib(path: Path) -> tuple[Array | None, list[Problem]]:
    """Read magcalib.txt: the field (K, 3) in counts, axes s, while the box was turned; None if nothing is in it."""
    data = np.frombuffer(whole(path), dtype=np.uint8)
    starts = _triple_starts(data)
    if starts.size == 0:
        return None, [Problem("magcalib_unusable", f"{path.name}: no magnetometer values in {data.size} bytes")]
    left = int(data.size - (starts[-1] + MAG_STRUCT.size))
    problems = []
    if left > 0:
        problems.append(
            Problem("magcalib_truncated", f"{path.name}: {left} bytes at the end are no whole triple", left)
        )
    return _field(data.tobytes(), starts), problems


def find_records(data: bytes) -> Records:
    """Find the chain of records that explains most of `data`."""
    octets = np.frombuffer(data, dtype=np.uint8)
    nodes = np.flatnonzero((octets[:-1] == RECORD_START[0]) & (octets[1:] == RECORD_START[1]))
    octets = np.concatenate([octets, np.zeros(_PLAIN, dtype=np.uint8)])  # so that a cut record can be looked at too
    block_length = find_block_length(octets, nodes, len(data))
    lengths = [_PLAIN, _FLAGGED] + ([] if block_length is None else [_WITH_GPS + block_length])
    targets, scores = _edges(octets, nodes, lengths, len(data))
    return _walk(len(data), nodes, targets, _best_edges(targets, scores), block_length)


def find_block_length(octets: npt.NDArray[np.uint8], nodes: IntArray, size: int) -> int | None:
    """Length of the NMEA block: the distance from flag to next record that most flagged records agree on.

    octets of the file, `size` of them and some zeros; nodes (K,) possible starts. A distance over several records
    collects almost as many votes as the true one, so the smallest among the well supported is taken. None if no
    record carries a sentence.
    """
    flagged = nodes[octets[nodes + _FLAG_OFFSET] == GPS_FLAG]
    ends = np.append(nodes, size)
    votes: dict[int, int] = {}
    for node in flagged[:2000].tolist():  # more would only repeat the vote
        first, last = np.searchsorted(ends, [node + _WITH_GPS + 1, node + _WITH_GPS + LONGEST_BLOCK + 1])
        for end in ends[first : min(last, first + 8)].tolist():
            block = octets[node + _BLOCK_OFFSET : end - END_STRUCT.size].tobytes()
            if b"$" in block and _is_ordered(octets, node, end):
                votes[len(block)] = votes.get(len(block), 0) + 1
    if not votes:
        return None
    most = max(votes.values())
    return min(length for length, count in votes.items() if count >= BLOCK_VOTES * most)


def _is_ordered(octets: npt.NDArray[np.uint8], node: int, end: int) -> bool:
    start_ms, end_ms = _u32(octets, np.array([node + 2, end - END_STRUCT.size]))
    return bool((end_ms - start_ms) % 2**32 <= LONGEST_RECORD_TIME)


def _u32(octets: npt.NDArray[np.uint8], position: IntArray) -> IntArray:
    """Little-endian unsigned numbers at the positions (K,); the reader sees to it that they lie inside."""
    wide = octets[position[:, None] + np.arange(4)].astype(np.int64)
    return np.asarray(wide @ (1 << np.array([0, 8, 16, 24])))


def _edges(octets: npt.NDArray[np.uint8], nodes: IntArray, lengths: list[int], size: int) -> tuple[IntArray, Array]:
    """For every node and record length the node it leads to (K, M), K for the end of the file, and its score (K, M).

    A score of -inf marks a length that does not fit.
    """
    count = nodes.size
    targets = np.full((count, len(lengths)), count, dtype=np.int64)
    scores = np.full((count, len(lengths)), -np.inf)
    if count == 0:
        return targets, scores
    flag = octets[nodes + _FLAG_OFFSET]
    start_ms = _u32(octets, nodes + len(RECORD_START))
    for column, length in enumerate(lengths):
        end = nodes + length
        target = np.searchsorted(nodes, end)
        at_node = nodes[np.minimum(target, count - 1)] == end
        half_start = (end == size - 1) & (octets[np.minimum(end, size)] == RECORD_START[0])
        fits = at_node | (end == size) | half_start
        if length == _FLAGGED:
            fits &= flag != GPS_FLAG
        elif length != _PLAIN:
            fits &= flag == GPS_FLAG
        end_ms = _u32(octets, np.minimum(end, size) - END_STRUCT.size)
        next_ms = np.where(at_node, start_ms[np.minimum(target, count - 1)], end_ms)
        score = _STRUCTURE + _END_ORDER * ((end_ms - start_ms) % 2**32 <= LONGEST_RECORD_TIME)
        score = score + _NEXT_ORDER * ((next_ms - end_ms) % 2**32 <= LONGEST_PAUSE)
        targets[:, column] = np.where(at_node, target, count)
        scores[:, column] = np.where(fits, score, -np.inf)
    return targets, scores


def _best_edges(targets: IntArray, scores: Array) -> list[int]:
    """Column of the edge to take from each node for the best total score to the end, -1 to skip to the next node."""
    count = targets.shape[0]
    best = [0.0] * (count + 1)
    choice = [-1] * count
    best[count] = 0.0
    target_rows, score_rows = targets.tolist(), scores.tolist()
    for node in range(count - 1, -1, -1):
        top, column = best[node + 1] - _LOST, -1
        for m, score in enumerate(score_rows[node]):
            total = score + best[target_rows[node][m]]
            if total > top:
                top, column = total, m
        best[node], choice[node] = top, column
    return choice


def _walk(size: int, nodes: IntArray, targets: IntArray, choice: list[int], block_length: int | None) -> Records:
    """Follow the chosen edges from the first node; count where the thread was lost."""
    taken, lost, lost_bytes, tail = [], 0, 0, size
    node, lost_from = 0, 0
    while node < nodes.size:
        column = choice[node]
        if column < 0:
            node += 1
            continue
        position = int(nodes[node])
        if position > lost_from:
            lost, lost_bytes = lost + 1, lost_bytes + position - lost_from
        taken.append((position, column == 2))
        node = int(targets[node, column])
        lost_from = int(nodes[node]) if node < nodes.size else size
        tail = size - lost_from
    table = np.array(taken, dtype=np.int64).reshape(-1, 2)
    return Records(table[:, 0], table[:, 1] == 1, block_length, lost, lost_bytes, tail)


def _imu_values(data: bytes, position: IntArray) -> tuple[Array, Array]:
    """Start times (K,) ms and counts (K, 6) of the records at `position` (K,)."""
    octets = np.frombuffer(data, dtype=np.uint8)
    words = octets[position[:, None] + len(RECORD_START) + np.arange(IMU_STRUCT.size)]
    fields = np.ascontiguousarray(words).view(np.dtype([("ms", "<u4"), ("counts", "<i2", (6,))]))[:, 0]
    return fields["ms"].astype(np.float64), fields["counts"].astype(np.float64)


def _field(data: bytes, position: IntArray) -> Array:
    """Magnetic field (K, 3) in counts, axes s, from the triples my, mx, -mz at `position` (K,)."""
    octets = np.frombuffer(data, dtype=np.uint8)
    words = octets[position[:, None] + np.arange(MAG_STRUCT.size)]
    triple = np.ascontiguousarray(words).view("<i2").astype(np.float64)
    return np.stack([triple[:, 1], triple[:, 0], -triple[:, 2]], axis=-1)


def _blocks(data: bytes, position: IntArray, length: int) -> list[bytes]:
    """The sentences at the head of each NMEA block; what the buffer held before is left out."""
    blocks = []
    for start in (position + _BLOCK_OFFSET).tolist():
        match = _LEADING_SENTENCES.match(data[start : start + length])
        blocks.append(match.group(1) if match else b"")
    return blocks


def _unresolved(records: Records, file: str) -> list[Problem]:
    problems = []
    if records.lost:
        text = (
            f"{file}: {counted(records.lost, 'part')} ({records.lost_bytes} bytes) without a readable record; skipped"
        )
        problems.append(Problem("out_unresolved", text, records.lost))
    if records.tail:
        text = f"{file}: the last {records.tail} bytes are no whole record; skipped"
        problems.append(Problem("out_truncated", text))
    return problems


def _triple_starts(octets: npt.NDArray[np.uint8]) -> IntArray:
    """Positions of the triples, whether the start byte(s) stand before each of them or only once."""
    mark = RECORD_START[0]
    for marks in (2, 1):
        stride = marks + MAG_STRUCT.size
        first = np.arange(0, octets.size - stride + 1, stride)
        marked = np.all(octets[first[:, None] + np.arange(marks)] == mark, axis=1)
        if first.size > 1 and np.mean(marked) > 0.5:
            return _marked_triples(octets, marks)
    once = 0
    while once < min(2, octets.size) and octets[once] == mark:
        once += 1
    readings = [np.arange(skip, octets.size - MAG_STRUCT.size + 1, MAG_STRUCT.size) for skip in {once, min(once, 1)}]
    return min(readings, key=lambda starts: _typical_size(octets, starts))


def _typical_size(octets: npt.NDArray[np.uint8], starts: IntArray) -> float:
    """Median magnitude of the counts. Read one byte off, low bytes become high ones and the values huge.

    So one start byte before a value that begins with another is known from two start bytes, also in a cut file.
    """
    return float(np.median(np.abs(_field(octets.tobytes(), starts)))) if starts.size else np.inf


def _marked_triples(octets: npt.NDArray[np.uint8], marks: int) -> IntArray:
    """Positions of triples that stand between two marks, or a mark and the end; damaged ones are passed over."""
    mark, stride, starts, place = RECORD_START[0], marks + MAG_STRUCT.size, [], 0
    is_mark = octets == mark
    while place + stride <= octets.size:
        here = bool(np.all(is_mark[place : place + marks]))
        follows = is_mark[place + stride : place + stride + marks]
        if here and bool(np.all(follows)):
            starts.append(place + marks)
            place += stride
        else:
            place += 1
    return np.array(starts, dtype=np.int64)
