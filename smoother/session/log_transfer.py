"""Logs that went through a transfer as text, which changes the ends of lines: undone where the checksums prove it."""

import re
from collections.abc import Callable
from mmap import mmap

from smoother.session.log_decode import Blocks, find_blocks

FEWEST_DAMAGED = 2  # blocks; a log that was cut short has one
DAMAGED_SHARE = 0.25  # of the whole ones; every block with a sentence in it is damaged by a transfer
MANY_MORE = 1.5  # times as many whole blocks prove it
LARGEST = 1 << 30  # bytes that are changed in memory; a day has less

_BARE_END = re.compile(rb"(\*[0-9A-F]{2})\n")  # of a sentence, which had a carriage return before the line feed

# What was done to the file, and how it is undone: exactly, or but for what looks like the end of a line by chance.
_UNDOINGS: tuple[tuple[str, Callable[[bytes], bytes]], ...] = (
    ("put a carriage return before each line feed", lambda data: data.replace(b"\r\n", b"\n")),
    ("took the carriage returns before line feeds", lambda data: _BARE_END.sub(rb"\1\r\n", data)),
    (
        "put a carriage return before each line feed that had none",
        lambda data: _BARE_END.sub(rb"\1\r\n", data.replace(b"\r\n", b"\n")),
    ),
)


def find_blocks_of_any(data: bytes | mmap) -> tuple[Blocks, str]:
    """Return the whole blocks in `data`, and what a transfer as text had done to it, "" for nothing."""
    blocks, damaged = find_blocks(data)
    if damaged < max(FEWEST_DAMAGED, DAMAGED_SHARE * len(blocks)) or len(data) > LARGEST:
        return blocks, ""
    done = ""
    for what, undo in _UNDOINGS:
        undone, _ = find_blocks(undo(bytes(data)))
        if len(undone) > MANY_MORE * len(blocks):
            blocks, done = undone, what
    return blocks, done
