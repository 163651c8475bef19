"""Text files of other programs: a head of free lines, then rows of numbers. Read in blocks, with bounds on everything.

A row that has not as many values as the file names columns is left out and counted, whatever its values; a line too
long to be one ends the reading, so that memory stays small whatever the file holds.
"""

import csv
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.readers.cells import Numbers, numbers_of
from smoother.session.table_bytes import WIDE_BYTES, in_utf8, wide_encoding
from smoother.words import counted

BLOCK_BYTES = 4 << 20
LONGEST_LINE = 1 << 20  # bytes; the rows of a car with 400 channels have 6000
MOST_LINES_OF_A_ROW = 20  # with line ends in its cells
MOST_WORDS, LONGEST_WORD = 4, 8  # different ones in a column of hemispheres, and their letters
LONGEST_HEAD = 4 << 20  # bytes
LARGEST_WIDE = 256 << 20  # bytes of a file that is read as a whole, twice that in memory; hours of a VBOX in UTF-16


@dataclass(frozen=True, eq=False)
class Rows:
    """Columns of a table, in the order that they were asked for, each (N,); and what was wrong with its rows.

    misfits : rows with too many or too few cells; found : cells in the first of them.
    """

    values: list[Array]
    cells: list[pl.Series | None]
    unread: list[int]
    units: list[str]
    length: int
    misfits: int
    expected: int
    found: int

    def problems(self, file: str) -> list[Problem]:
        """What was wrong with the rows as a whole."""
        if not self.misfits:
            return []
        text = f"{file}: {counted(self.misfits, 'row')} without the {self.expected} values of a row; dropped"
        return [Problem("gps_row_damaged", text, self.misfits)]


def _opened(path: Path) -> BinaryIO:
    """A file for reading, in lines that end with a line feed; one of two bytes a character, or with carriage returns
    alone, as old Macs write it, is made plain in memory. Raises SessionError if such a one is huge."""
    with path.open("rb") as file:
        head = file.read(LONGEST_LINE)
    is_wide = wide_encoding(head[:WIDE_BYTES]) is not None
    if not is_wide and (b"\n" in head or b"\r" not in head):
        return path.open("rb")
    if path.stat().st_size > LARGEST_WIDE:
        what = "in UTF-16" if is_wide else "in lines that end with carriage returns"
        raise SessionError(f"{path.name}: more than {LARGEST_WIDE >> 20} MB {what}; save it as UTF-8 with line feeds")
    text = in_utf8(path.read_bytes())
    return BytesIO(text if b"\n" in text[:LONGEST_LINE] else text.replace(b"\r", b"\n"))


def head_of(path: Path, is_last: Callable[[str], bool], what: str) -> tuple[list[str], int]:
    """Return the lines of a file up to the one that `is_last`, that one too, and where the next begins.

    That is a byte of the file, of its text in UTF-8. `what` names what it has to be. Raises SessionError where there is
    no such line, or one is endless.
    """
    head: list[str] = []
    offset = 0
    try:
        with _opened(path) as file:
            while line := file.readline(LONGEST_LINE + 1):
                _require_short(path.name, line, len(head) + 1, what)
                offset += len(line)
                head.append(line.decode("utf-8", errors="replace").strip("\ufeff\r\n"))
                if is_last(head[-1]):
                    return head, offset
                if offset > LONGEST_HEAD:
                    break
    except OSError as error:
        raise SessionError(f"{path.name}: cannot be read ({error.strerror or error})") from error
    if not any(line.strip() for line in head):
        raise SessionError(f"{path.name}: the file is empty; expected {what}")
    raise SessionError(f"{path.name}: no rows; not, or not a whole, {what}")


def read_rows(
    path: Path,
    offset: int,
    width: int,
    separator: str | None,
    what: str,
    *,
    texts: Collection[int] = (),
    comment: str = "",
) -> Rows:
    """Read rows of `width` cells from byte `offset` on, all columns as numbers, and those of `texts` as they stand too.

    separator : what stands between cells, None for any white space. comment : what lines begin with that are no rows.
    Columns of few short words are kept as they stand too: they may be hemispheres. Raises SessionError where no row
    fits, or a line is endless.
    """
    parts: list[list[Numbers]] = []
    kept: dict[int, list[pl.Series]] = {place: [] for place in texts}
    length = misfits = found = 0
    for lines in _line_blocks(path, offset, what):
        rows, odd, first_odd = _split([line for line in lines if not _is_comment(line, comment)], separator, width)
        misfits, found = misfits + odd, found or first_odd
        if not rows:
            continue
        columns = [pl.Series(column, dtype=pl.String) for column in zip(*rows, strict=True)]
        numbers = [numbers_of(column, has_decimal_commas=separator != ",") for column in columns]
        if not parts:
            kept |= {i: [] for i, column in enumerate(columns) if i not in kept and _are_words(column, numbers[i])}
        for place, series in kept.items():
            series.append(columns[place])
        parts.append(numbers)
        length += len(rows)
    if length == 0:
        if misfits:
            raise SessionError(
                f"{path.name}: rows have {found} values, but {width} columns are named; mend the line of names"
            )
        raise SessionError(f"{path.name}: a header, but no rows; was the recording started?")
    each = [[block[i] for block in parts] for i in range(width)]
    return Rows(
        [np.concatenate([block.values for block in blocks]) for blocks in each],
        [pl.concat(kept[i]) if i in kept else None for i in range(width)],
        [sum(block.unread for block in blocks) for blocks in each],
        [blocks[0].unit for blocks in each],
        length,
        misfits,
        width,
        found,
    )


def _is_comment(line: str, comment: str) -> bool:
    return bool(comment) and line.lstrip(' "').startswith(comment)


def _are_words(column: pl.Series, numbers: Numbers) -> bool:
    """Whether cells (N,) are few different short words."""
    if np.isfinite(numbers.values).any():
        return False
    different = column.unique().drop_nulls()
    return len(different) <= MOST_WORDS and int(different.str.len_chars().max() or 0) <= LONGEST_WORD  # type: ignore[arg-type]


def _line_blocks(path: Path, offset: int, what: str) -> Iterator[list[str]]:
    """Yield lists of whole lines that are not blank."""
    with _opened(path) as file:
        file.seek(offset)
        rest = b""
        while block := file.read(BLOCK_BYTES):
            lines = (rest + block).replace(b"\r\n", b"\n").replace(b"\r", b"\n").split(b"\n")
            rest = lines.pop()
            _require_short(path.name, rest, None, what)
            yield [line.decode("utf-8", errors="replace") for line in lines if line.strip()]
        if rest.strip():
            yield [rest.decode("utf-8", errors="replace")]


def _require_short(file: str, line: bytes, number: int | None, what: str) -> None:
    if len(line) > LONGEST_LINE:
        place = "a line" if number is None else f"line {number}"
        raise SessionError(f"{file}: {place} has more than {LONGEST_LINE} characters; this is no {what}")


def _split(lines: list[str], separator: str | None, width: int) -> tuple[list[list[str]], int, int]:
    """Rows of `width` cells, how many lines were none, and how many cells the first of those has.

    RFC 4180 by the library's parser. A cell in quotes may run over several lines; a mark without a partner costs its
    line, and not those behind it.
    """
    if separator is None:
        split = [line.replace(",", ".").split() for line in lines]  # some programs write decimal commas
        odd = [row for row in split if len(row) != width]
        return [row for row in split if len(row) == width], len(odd), len(odd[0]) if odd else 0
    rows: list[list[str]] = []
    misfits = found = i = 0
    while i < len(lines):
        row, used = _quoted(lines, i, separator, width) if '"' in lines[i] else (lines[i].split(separator), 1)
        if (fitted := _fitted(row, width)) is None:
            misfits, found = misfits + 1, found or len(row)
        else:
            rows.append(fitted)
        i += used
    return rows, misfits, found


def _fitted(row: list[str], width: int) -> list[str] | None:
    """A row of `width` cells; blank ones beyond that are none."""
    if len(row) > width and not any(cell.strip() for cell in row[width:]):
        return row[:width]
    return row if len(row) == width else None


def _quoted(lines: list[str], first: int, separator: str, width: int) -> tuple[list[str], int]:
    """The row that begins with a line in which there are quotation marks, and how many lines it takes."""
    for used in range(1, MOST_LINES_OF_A_ROW + 1):
        text = "\n".join(lines[first : first + used])
        if text.count('"') % 2 == 0:
            row = _parsed(text, separator)
            if used > 1 and _fitted(row, width) is None:
                break
            return row, used
        if first + used >= len(lines):
            break
    return _parsed(lines[first].replace('"', ""), separator), 1


def _parsed(text: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return []
