"""Text files of other programs: a head of free lines, then rows of numbers. Read in blocks, with bounds on everything.

A row that has not as many values as the file names columns is left out and counted, whatever its values; a line too
long to be one ends the reading, so that memory stays small whatever the file holds.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.encoding import WIDE_BYTES, in_utf8, wide_encoding
from smoother.session.tables import NOTHING
from smoother.words import counted

BLOCK_BYTES = 4 << 20
LONGEST_LINE = 1 << 20  # bytes; the rows of a car with 400 channels have 6000
LONGEST_HEAD = 4 << 20  # bytes
LARGEST_WIDE = 256 << 20  # bytes of a file that is read as a whole, twice that in memory; hours of a VBOX in UTF-16


@dataclass(frozen=True, eq=False)
class Records:
    """Columns by name, each (N,), NaN where a cell is no number; and how many rows had too many or too few cells.

    texts : the cells (N,) of columns that were asked for as they stand.
    """

    columns: dict[str, Array]
    length: int
    misfits: int
    expected: int
    found: int  # cells in the first row that does not fit
    texts: dict[str, pl.Series] = field(default_factory=dict)
    unread: dict[str, int] = field(default_factory=dict)  # cells of columns of numbers that hold something else
    words: dict[str, int] = field(default_factory=dict)  # the same of columns that hold hardly any number

    def column(self, name: str) -> Array:
        """Column (N,), NaN throughout if the file has no such column."""
        return self.columns.get(name, np.full(self.length, np.nan))

    def problems(self, file: str) -> list[Problem]:
        """What was wrong with the rows."""
        said = []
        if self.misfits:
            text = f"{file}: {counted(self.misfits, 'row')} without the {self.expected} values of a row; dropped"
            said.append(Problem("gps_row_damaged", text, self.misfits))
        for name, count in self.unread.items():
            text = f"{file}: {name.partition(' #')[0]} of {counted(count, 'row')} is no number; not used"
            said.append(Problem("gps_unread", text, count))
        return said


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


def read_records(
    path: Path,
    offset: int,
    names: Sequence[str],
    wanted: Sequence[str],
    separator: str | None,
    what: str,
    *,
    texts: Sequence[str] = (),
    comment: bytes = b"",
) -> Records:
    """Read the rows from byte `offset` on; the columns `wanted` of all `names` are kept, and `texts` as they stand.

    comment : what lines begin with that are no rows.

    separator : what stands between cells, None for any white space. Quotation marks are ignored. With semicolons or
    tabs a comma is the decimal point. Raises SessionError where no row fits, or a line is endless.
    """
    parts: list[pl.DataFrame] = []
    length = misfits = found = 0
    for lines in _line_blocks(path, offset, what):
        if comment:
            lines = [line for line in lines if not line.lstrip(b' "').startswith(comment)]
        rows, widths = _split(lines, separator)
        fits = widths == len(names)
        if not fits.all():
            misfits += int(np.count_nonzero(~fits))
            found = found or int(widths[~fits][0])
            rows = [row for row, fit in zip(rows, fits.tolist(), strict=True) if fit]
        if rows:
            parts.append(_numbers(rows, names, wanted, texts))
            length += len(rows)
    if length == 0:
        if misfits:
            raise SessionError(
                f"{path.name}: rows have {found} values, but {len(names)} columns are named; mend the line of names"
            )
        raise SessionError(f"{path.name}: a header, but no rows; was the recording started?")
    table = pl.concat(parts)
    columns = {name: _finite(table[name]) for name in wanted}
    unread = {name: int(table[_as_unread(name)].sum()) for name in wanted}
    of_numbers = {name: n for name, n in unread.items() if 0 < n <= np.count_nonzero(np.isfinite(columns[name]))}
    as_text = {name: table[_as_text(name)] for name in texts}
    words = {name: n for name, n in unread.items() if n and name not in of_numbers}
    return Records(columns, length, misfits, len(names), found, as_text, of_numbers, words)


def _line_blocks(path: Path, offset: int, what: str) -> Iterator[list[bytes]]:
    """Yield lists of whole lines that are not blank."""
    with _opened(path) as file:
        file.seek(offset)
        rest = b""
        while block := file.read(BLOCK_BYTES):
            lines = (rest + block).replace(b"\r", b"\n").split(b"\n")
            rest = lines.pop()
            _require_short(path.name, rest, None, what)
            yield [line for line in lines if line.strip()]
        if rest.strip():
            yield [rest]


def _require_short(file: str, line: bytes, number: int | None, what: str) -> None:
    if len(line) > LONGEST_LINE:
        place = "a line" if number is None else f"line {number}"
        raise SessionError(f"{file}: {place} has more than {LONGEST_LINE} characters; this is no {what}")


def _split(lines: list[bytes], separator: str | None) -> tuple[list[bytes], np.ndarray]:
    """Rows with a comma between the cells, and how many cells each has."""
    if separator is None:
        cells = [line.replace(b",", b".").split() for line in lines]  # some programs write decimal commas
        return [b",".join(row) for row in cells], np.array([len(row) for row in cells], dtype=np.int64)
    mark = separator.encode()
    rows = [line.strip(b" \r\n").replace(b'"', b"") for line in lines]  # a tab may end in a blank cell
    if separator != ",":
        rows = [row.replace(b",", b".").replace(mark, b",") for row in rows]
    return rows, np.array([row.count(b",") + 1 for row in rows], dtype=np.int64)


def _as_text(name: str) -> str:
    """The name of a column of cells as they stand, beside its numbers."""
    return f"{name} as text"


def _numbers(rows: list[bytes], names: Sequence[str], wanted: Sequence[str], texts: Sequence[str]) -> pl.DataFrame:
    places = [names.index(name) for name in dict.fromkeys((*wanted, *texts))]
    header = ",".join(f"c{i}" for i in range(len(names))).encode()
    data = BytesIO(b"\n".join((header, *rows)))
    frame = pl.read_csv(
        data, infer_schema=False, quote_char=None, encoding="utf8-lossy", columns=[f"c{i}" for i in places]
    )
    cells = {name: pl.col(f"c{names.index(name)}").str.strip_chars() for name in (*wanted, *texts)}
    numbers = [cells[name].cast(pl.Float64, strict=False).alias(name) for name in wanted]
    unread = [_is_unread(cells[name]).alias(_as_unread(name)) for name in dict.fromkeys(wanted)]
    return frame.select(*numbers, *unread, *(cells[name].alias(_as_text(name)) for name in texts))


def _is_unread(cell: pl.Expr) -> pl.Expr:
    """Whether a cell holds something that is no number, and no word for nothing either."""
    is_something = (cell != "") & ~cell.str.contains(NOTHING.pattern)
    return cell.cast(pl.Float64, strict=False).is_null() & is_something.fill_null(value=False)


def _as_unread(name: str) -> str:
    return f"unread {name}"


def _finite(series: pl.Series) -> Array:
    values = series.fill_null(np.nan).to_numpy()
    return np.where(np.isfinite(values), values, np.nan)
