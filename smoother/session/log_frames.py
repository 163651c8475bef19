"""The logger's records as a stream: frames as they come over USART1 (firmware/FORMAT.md, section 7).

A frame carries what a block carries, so both are decoded by the same code.
"""

import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.session.log_decode import Blocks, decode
from smoother.session.log_encode import lay_out
from smoother.session.log_format import (
    BLOCK_BYTES,
    CRC_STRUCT,
    FRAME_CAPACITY,
    FRAME_HEAD,
    FRAME_SYNC,
    RECORDS_AT,
    LogRecords,
)

_LENGTH_AT = len(FRAME_SYNC)
_BASE_AND_USED = struct.Struct("<IHH")
_BASE_AT, _SEQUENCE_AT = 12, 8
SETUP_EVERY = 2_000_000  # us


@dataclass(frozen=True)
class Frame:
    """One good frame: its number (modulo 65536), base time in us, and its records."""

    number: int
    base_us: int
    records: bytes


def find_frames(data: bytes) -> tuple[list[Frame], int]:
    """Return the frames in `data` and how many bytes are done with; the rest belongs before what comes next.

    Text between frames and damaged frames are passed over.
    """
    frames, at = [], 0
    while (at := _next_sync(data, at)) < len(data):
        size = _whole(data, at)
        if size == 0:
            break
        frame = _frame(data[at : at + size])
        if frame is not None:
            frames.append(frame)
        at += size if frame is not None else 1
    return frames, at


def _next_sync(data: bytes, at: int) -> int:
    """Place of the next sync, or of its first byte at the very end; the end without one."""
    found = data.find(FRAME_SYNC, at)
    if found >= 0:
        return found
    return len(data) - 1 if data[at:].endswith(FRAME_SYNC[:1]) else len(data)


def _whole(data: bytes, at: int) -> int:
    """Length of the frame at `at`, 0 while more bytes are needed. A length no frame has gives 1: go on behind it."""
    if at + _LENGTH_AT >= len(data):
        return 0
    records = data[at + _LENGTH_AT]
    if not 1 <= records <= FRAME_CAPACITY:
        return 1
    size = FRAME_HEAD.size + records + CRC_STRUCT.size
    return size if at + size <= len(data) else 0


def _frame(text: bytes) -> Frame | None:
    """The frame that fills `text`, None if it is damaged."""
    body = text[: -CRC_STRUCT.size]
    crc = int.from_bytes(text[-CRC_STRUCT.size :], "little")
    if len(text) <= FRAME_HEAD.size or zlib.crc32(body[_LENGTH_AT:]) != crc:
        return None
    _, _, number, low, high = FRAME_HEAD.unpack_from(text)
    return Frame(number, low | high << 32, body[FRAME_HEAD.size :])


def decode_frames(frames: Sequence[Frame]) -> LogRecords:
    """Return the records of frames, in order."""
    content = np.zeros((len(frames), BLOCK_BYTES), dtype=np.uint8)
    view = content.reshape(-1).data
    for i, frame in enumerate(frames):
        start = i * BLOCK_BYTES
        struct.pack_into("<I", view, start + _SEQUENCE_AT, i)
        base = (frame.base_us & 0xFFFFFFFF, frame.base_us >> 32)
        _BASE_AND_USED.pack_into(view, start + _BASE_AT, *base, len(frame.records))
        view[start + RECORDS_AT : start + RECORDS_AT + len(frame.records)] = frame.records
    return decode(Blocks.of(content))[0]


def encode_frames(records: LogRecords, first_number: int = 0) -> bytes:
    """Return the records as frames, each as full as it can be."""
    frames = []
    for i, block in enumerate(lay_out(records, 1, FRAME_CAPACITY, SETUP_EVERY)):
        low, high, used = _BASE_AND_USED.unpack_from(block, _BASE_AT)
        head = FRAME_HEAD.pack(FRAME_SYNC, used, (first_number + i) & 0xFFFF, low, high)
        body = head + block[RECORDS_AT : RECORDS_AT + used].tobytes()
        frames.append(body + CRC_STRUCT.pack(zlib.crc32(body[_LENGTH_AT:])))
    return b"".join(frames)


def lost_frames(frames: Sequence[Frame]) -> int:
    """Return how many frames are missing between the first and the last."""
    steps = np.diff([frame.number for frame in frames])
    return int(np.sum((steps - 1) & 0xFFFF)) if len(frames) > 1 else 0
