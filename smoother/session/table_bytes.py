"""Bytes of a table, made plain: unpacked, in UTF-8, with ends of lines, without quotation marks.

Knows what stands between cells, and nothing of columns.
"""

import contextlib
import re
import zlib
from pathlib import Path
from typing import BinaryIO

from smoother.errors import SessionError

WIDE_BYTES, FEWEST_WIDE = 256, 8  # looked at, and characters that tell


def wide_encoding(data: bytes) -> str | None:
    """How a text of two bytes a character is encoded, by its mark or by the zeros of Latin ones; None for others."""
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


HEAD_BYTES = 65536
LONGEST_LINE = 1 << 20  # bytes; longer is no row, and would fill the memory
ROW_BYTES = 4096  # a row is mostly shorter
LARGEST_UNPACKED = 2 << 30  # bytes of a file that cannot be read as it lies on the disk
PACKED_STEP = 4096  # bytes; unpacked at most four megabytes
GZIP = zlib.MAX_WBITS | 16
SEPARATORS = ",;\t"  # of as many the first
_QUOTED = re.compile(rb'"([^"\n]*)"')  # ends with its line: a mark without a partner must not swallow the rows behind
_LONE_RETURN = re.compile(rb"(?<=[^\r\n])\r(?=[^\r\n])")  # ends a line like those of old Macs, among others
_DECIMAL_COMMA = re.compile(rb"\s*([+-]?\d*),(\d+)\s*")


def end_of_text(file: BinaryIO, end: int) -> int:
    """Where the zeros begin that a file ends with."""
    while end > 0:
        begin = max(0, end - LONGEST_LINE)
        file.seek(begin)
        if text := file.read(end - begin).rstrip(b"\0"):
            return begin + len(text)
        end = begin
    return 0


def plain_source(path: Path) -> Path | bytes:
    """The file itself where polars can read it lazily, else its bytes made plain."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    plain = not head.startswith(b"\x1f\x8b") and (b"\n" in head or b"\r" not in head)
    plain = plain and _LONE_RETURN.search(head) is None
    plain = plain and wide_encoding(head) is None and _is_utf8(path)
    if plain:
        _require_lines(path)
    return path if plain else _plain_bytes(_whole(path), path.name)


def _is_utf8(path: Path) -> bool:
    """Whether a path is text, as polars wants it; names out of an archive of another system are mostly not."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        return False
    return True


def _require_lines(path: Path) -> None:
    """Raise SessionError where a megabyte holds no end of a line; looks at a few bytes of each."""
    with path.open("rb") as file:
        for start in range(0, end_of_text(file, path.stat().st_size), LONGEST_LINE):
            file.seek(start)
            if b"\n" not in file.read(ROW_BYTES):
                rest = file.read(LONGEST_LINE - ROW_BYTES)
                if len(rest) == LONGEST_LINE - ROW_BYTES and b"\n" not in rest:
                    raise SessionError(
                        f"{path.name}: a line of more than {LONGEST_LINE} characters; this is no CSV table"
                    )


def text_head(path: Path) -> str:
    """Return the first HEAD_BYTES of a file as plain text. Raises SessionError where it cannot be read."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
    except OSError as error:
        raise SessionError(f"{path.name}: cannot be read ({error.strerror or error})") from error
    return _plain_bytes(head, path.name).decode("utf-8", errors="replace")


def separator_of(header: str) -> str:
    """What stands between the cells: whichever of SEPARATORS the header line has most of."""
    return max(SEPARATORS, key=header.count)


def unquoted(data: bytes, separator: str) -> bytes:
    """The same without quotation marks. What is quoted ends with its line at the latest, so that a mark in a damaged
    row costs that row; a separator in quotes is a decimal comma or only text."""

    def bare(cell: re.Match[bytes]) -> bytes:
        inside = cell[1]
        if separator.encode() not in inside:
            return inside
        number = _DECIMAL_COMMA.fullmatch(inside)
        return b".".join(number.groups()) if number else inside.replace(separator.encode(), b" ")

    return _QUOTED.sub(bare, data)


def _whole(path: Path) -> bytes:
    """The bytes of a file that has to be changed in memory, where there is room for them."""
    if path.stat().st_size > LARGEST_UNPACKED:
        raise SessionError(f"{path.name}: more than {LARGEST_UNPACKED >> 20} MB; save it as UTF-8 with ends of lines")
    return path.read_bytes()


def _plain_bytes(data: bytes, file: str) -> bytes:
    """Gunzip (a damaged archive yields what is whole), UTF-16 to UTF-8, lone carriage returns to newlines."""
    if data.startswith(b"\x1f\x8b"):
        data = _gunzip(data, file)
    data = in_utf8(data)
    return _LONE_RETURN.sub(b"\n", data) if b"\n" in data else data.replace(b"\r", b"\n")


def _gunzip(data: bytes, file: str) -> bytes:
    """What can be unpacked, up to the first byte that is damaged. Raises SessionError where it has no end."""
    whole, place = bytearray(), 0
    decoder = zlib.decompressobj(wbits=GZIP)
    while place < len(data):
        before = decoder.copy()
        try:
            whole += decoder.decompress(data[place : place + PACKED_STEP])
        except zlib.error:
            return bytes(whole + _until_damage(before, data[place : place + PACKED_STEP]))
        if len(whole) > LARGEST_UNPACKED:
            raise SessionError(f"{file}: more than {LARGEST_UNPACKED >> 20} MB when unpacked; unpack it first")
        place += PACKED_STEP
        if decoder.eof:  # archives may stand one behind the other
            place = min(place, len(data)) - len(decoder.unused_data)
            decoder = zlib.decompressobj(wbits=GZIP)
    return bytes(whole)


def _until_damage(decoder: "zlib._Decompress", data: bytes) -> bytearray:
    whole = bytearray()
    with contextlib.suppress(zlib.error):
        for byte in data:
            whole += decoder.decompress(bytes([byte]))
    return whole
