"""Text files as plain bytes: unpacked, in UTF-8, each line ended by a line feed; in blocks of whole lines.

Knows nothing of cells. Memory stays bounded whatever a file holds: a line too long to be one ends the reading.
"""

import codecs
import contextlib
import itertools
import zlib
from collections.abc import Iterator
from pathlib import Path

from smoother.errors import SessionError

WIDE_BYTES, FEWEST_WIDE = 256, 8  # of a beginning that shows the encoding; characters it takes
HEAD_BYTES = 65536
BLOCK_BYTES = 8 << 20
LONGEST_LINE = 1 << 20  # bytes; the rows of a car with 400 channels have 6000
LARGEST_UNPACKED = 2 << 30  # bytes
PACKED_STEP = 4096  # bytes; unpacked at most four megabytes
GZIP_MAGIC, GZIP = b"\x1f\x8b", zlib.MAX_WBITS | 16


def wide_encoding(data: bytes) -> str | None:
    """Encoding of a text of two bytes a character, by its mark or by the zeros of Latin letters; None for others."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    even, odd = data[0:WIDE_BYTES:2], data[1:WIDE_BYTES:2]
    if len(odd) < FEWEST_WIDE or (0 in even) == (0 in odd):
        return None
    if not any(odd):
        return "utf-16-le"
    return "utf-16-be" if not any(even) else None


def in_utf8(data: bytes) -> bytes:
    """Return a text of two bytes a character, or the beginning of one, in UTF-8; others as they are."""
    encoding = wide_encoding(data)
    return data if encoding is None else data.decode(encoding, errors="replace").encode()


def whole(path: Path) -> bytes:
    """Return all bytes of a file. Raises SessionError, one line, if it is unreadable."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from error


def unreadable(path: Path, error: OSError) -> SessionError:
    """The error of a file that the system does not let us read."""
    return SessionError(f"{path.name}: cannot be read ({error.strerror or error})")


def text_head(path: Path, size: int = HEAD_BYTES) -> str:
    """Return the beginning of a file, some `size` bytes, as plain text. Raises SessionError if it is unreadable."""
    head = b""
    for chunk in _plain(path, size):
        head += chunk
        if len(head) >= size:
            break
    return head.decode("utf-8", errors="replace")


def text_blocks(path: Path, skip: int = 0) -> Iterator[bytes]:
    """Yield the lines of a file behind the first `skip`, block by block; only the last line may lack its line feed.

    Zeros at the end of a file, which a card reserved for rows to come, are left out. Raises SessionError where the file
    is unreadable or a line has no end.
    """
    rest = b""
    for chunk in _without_padding(_plain(path, BLOCK_BYTES), path.name):
        rest = rest + chunk if rest else chunk
        end = rest.rfind(b"\n") + 1
        _require_line(path.name, len(rest) - end)
        if end and len(rest) >= BLOCK_BYTES:
            yield _behind(skip, rest[:end])
            rest, skip = rest[end:], 0
    yield _behind(skip, rest)


def _behind(skip: int, block: bytes) -> bytes:
    """The lines of a block behind the first `skip`."""
    lines = block.split(b"\n", skip) if skip else [block]
    return lines[-1] if len(lines) > skip else b""


def _require_line(file: str, size: int) -> None:
    if size > LONGEST_LINE:
        raise SessionError(f"{file}: a line of more than {LONGEST_LINE} characters; this is no table")


def _plain(path: Path, size: int) -> Iterator[bytes]:
    """The bytes of a file, unpacked, in UTF-8 and with line feeds, in parts of some `size` bytes."""
    held = b""  # a carriage return whose line feed may be in the next part
    for chunk in _decoded(_unpacked(_stored(path, size), path.name, size)):
        text = held + chunk if held else chunk
        held = b"\r" if text.endswith(b"\r") else b""
        if b"\r" in text:
            text = text[: len(text) - len(held)].replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        yield text
    if held:
        yield b"\n"


def _stored(path: Path, size: int) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            while chunk := file.read(size):
                yield chunk
    except OSError as error:
        raise unreadable(path, error) from error


def _unpacked(chunks: Iterator[bytes], file: str, size: int) -> Iterator[bytes]:
    """What a gzip archive holds, up to its first damaged byte; other files as they are."""
    first = next(chunks, b"")
    if not first.startswith(GZIP_MAGIC):
        yield from itertools.chain([first], chunks)
        return
    decoder, whole, total = zlib.decompressobj(wbits=GZIP), bytearray(), 0
    for chunk in itertools.chain([first], chunks):
        for place in range(0, len(chunk), PACKED_STEP):
            data = chunk[place : place + PACKED_STEP]
            while data:
                before = decoder.copy()
                try:
                    whole += decoder.decompress(data)
                except zlib.error:
                    yield bytes(whole) + _until_damage(before, data)
                    return
                data = decoder.unused_data
                if decoder.eof:  # archives may stand one behind the other
                    decoder = zlib.decompressobj(wbits=GZIP)
            if total + len(whole) > LARGEST_UNPACKED:
                raise SessionError(f"{file}: more than {LARGEST_UNPACKED >> 20} MB when unpacked; unpack it first")
            if len(whole) >= size:
                yield bytes(whole)
                total += len(whole)
                whole.clear()
    yield bytes(whole)


def _until_damage(decoder: "zlib._Decompress", data: bytes) -> bytes:
    whole = bytearray()
    with contextlib.suppress(zlib.error):
        for byte in data:
            whole += decoder.decompress(bytes([byte]))
    return bytes(whole)


def _decoded(chunks: Iterator[bytes]) -> Iterator[bytes]:
    """Text of two bytes a character in UTF-8, other text as it is."""
    first = next(chunks, b"")
    encoding = wide_encoding(first)
    if encoding is None:
        yield from itertools.chain([first], chunks)
        return
    decoder = codecs.getincrementaldecoder(encoding)("replace")
    for chunk in itertools.chain([first], chunks):
        yield decoder.decode(chunk).encode()


def _without_padding(chunks: Iterator[bytes], file: str) -> Iterator[bytes]:
    """The same without the zeros at the end."""
    zeros = 0
    for chunk in chunks:
        text = chunk.rstrip(b"\0")
        if text:
            _require_line(file, zeros)
            yield bytes(zeros) + text if zeros else text
        zeros = len(chunk) - len(text) + (0 if text else zeros)
