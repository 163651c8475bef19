"""Tables of cells between separators: one engine for the project's columns and for tables of other programs.

polars reads the cells; rows with quotation marks go through Python's csv module first (RFC 4180). Columns are read as
numbers, and a column with any other cell once more as text, so that a bad cell costs itself. A row that has not as many
cells as there are names is left out, whatever its cells: which of them is missing is unknown.
"""

import csv
import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.disc import Growing, pieces, release, roomy
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.readers.cells import Numbers, are_words, finite, numbers_of
from smoother.session.readers.times import read_moments
from smoother.session.text import HEAD_BYTES, text_blocks, text_head
from smoother.words import UNREADABLE, counted, listed

SEPARATORS = ",;\t"  # of as many the first
MOST_LINES_OF_A_ROW = 20  # with line ends in its cells
COMMENT = b"#"
ODD_SHARE = 0.05  # of the characters of a damaged text; names in another encoding are far fewer
_INSIDE = "\x1f"  # a separator within a quoted cell, while polars reads the row


class NoRowsError(SessionError):
    """A table that holds nothing: nothing is wrong with it that a person could mend, and the others may do."""


@dataclass(frozen=True, eq=False)
class Rows:
    """Columns of a table by their places in a row, each (N,), of the rows that have as many cells as there are names.

    problems : rows that have not, and a last row that was cut short, as by a loss of power.
    """

    columns: dict[int, Numbers]
    problems: tuple[Problem, ...]


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers of a CSV file: `columns` maps lower-case names to (N,) float64, NaN where a cell is no number.

    `unread` counts, for each optional column, the cells that hold something which is no number, or no time.
    `problems` : rows that were left out. Of columns of one name the first counts.
    """

    file: str
    columns: dict[str, Array]
    length: int
    unread: dict[str, int]
    problems: tuple[Problem, ...]

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    def column(self, name: str) -> Array:
        """Column (N,), NaN throughout if the file has no such column."""
        return self.columns[name] if name in self.columns else np.full(self.length, np.nan)

    def stack(self, *names: str) -> Array:
        """Return columns side by side, (N, len(names))."""
        columns, out = [self.column(name) for name in names], roomy((self.length, len(names)))
        for part in pieces(self.length):
            np.stack([column[part] for column in columns], axis=-1, out=out[part])
            release(out, columns)
        return out


def separator_of(line: str) -> str:
    """Return what separates the cells: whichever of SEPARATORS a line has most of."""
    return max(SEPARATORS, key=line.count)


def cells_of(line: str, separator: str | None = None) -> tuple[str, ...]:
    """Return the cells of a line, without quotation marks and spaces around them."""
    line = line.strip("\ufeff\r\n")
    row = _parsed(line, separator or separator_of(line))
    return tuple(cell.strip(' "\ufeff\r\t\0') for cell in row)


def head_lines(path: Path, most: int) -> list[str]:
    """Return the first lines that are not blank, at `most` so many. Raises SessionError if the file is unreadable."""
    return [line for line in text_head(path).splitlines() if line.strip()][:most]


def read_header(path: Path) -> tuple[str, ...]:
    """Column names of a CSV file, lower case and trimmed; () if it is empty. Raises SessionError if unreadable."""
    lines = head_lines(path, 1)
    return _unique(cells_of(lines[0])) if lines else ()


def _unique(names: Sequence[str]) -> tuple[str, ...]:
    """Names in lower case; one that is empty or repeated has a suffix that no contract uses."""
    lower = [name.strip("'").lower() for name in names]
    return tuple(
        name if name and name not in lower[:i] else f"{name} #{lower[: i + 1].count(name)}"
        for i, name in enumerate(lower)
    )


def read_table(
    path: Path,
    required: Sequence[str],
    optional: Sequence[str] = (),
    iso_times: Sequence[str] = (),
    *,
    prefix: str = "gps",
) -> Table:
    """Read the named columns of a CSV file, plain or gzip; others are ignored, blank lines too.

    iso_times : optional columns of ISO 8601 times, of the extended form or the basic one, returned as seconds since
    1970 (UTC where no zone is given). prefix : of the codes of problems.
    Raises NoRowsError for an empty file or no rows, SessionError for a missing column or an unreadable file.
    """
    head = text_head(path)
    if head and not head.strip("\0"):
        raise NoRowsError(f"{path.name}: begins with {len(head)} zero bytes; was it ever written? Copy it again")
    lines = head.split("\n")
    skip = next((i for i, line in enumerate(lines) if line.strip()), len(lines))
    if skip == len(lines):
        raise NoRowsError(f"{path.name}: the file is empty; expected a header line with {', '.join(required)}")
    header = _unique(cells_of(lines[skip]))
    _require_columns(path.name, header, required, head)
    numbers, times = (
        {name: header.index(name) for name in names if name in header} for names in ((*required, *optional), iso_times)
    )
    separator = separator_of(lines[skip])
    rows = read_rows(
        path,
        skip + 1,
        len(header),
        separator,
        numbers.values(),
        times.values(),
        has_decimal_commas=True,
        prefix=prefix,
    )
    columns, unread = {}, {}
    for name, place in numbers.items():
        found = rows.columns[place]
        # a unit that stands in the cells may be another than that of the name
        columns[name] = np.full(found.values.size, np.nan) if found.unit else found.values
        unread[name] = found.unread + (int(np.count_nonzero(np.isfinite(found.values))) if found.unit else 0)
    for name, place in times.items():
        columns[name], unread[name] = _unix_seconds(rows.columns[place])
    of_others = {name: count for name, count in unread.items() if name not in required}
    return Table(path.name, columns, len(columns[required[0]]), of_others, rows.problems)


def _unix_seconds(column: Numbers) -> tuple[Array, int]:
    """Seconds (N,) since 1970 of ISO 8601 times, and how many cells hold anything else."""
    cells = column.cells
    assert cells is not None
    moments = read_moments(cells, "")
    seconds = moments.seconds if moments is not None and moments.has_date else np.full(len(cells), np.nan)
    filled = (cells.str.strip_chars() != "").fill_null(value=False).to_numpy()
    return seconds, int(np.count_nonzero(filled & np.isnan(seconds)))


def _require_columns(file: str, header: Sequence[str], required: Sequence[str], head: str) -> None:
    """Raise SessionError where a column is missing, or all of the first line, of names, is, or the file is no text."""
    missing = [name for name in required if name not in header]
    if not missing:
        return
    if _is_binary(head):
        raise SessionError(f"{file}: not a text table, but a file of another kind; wanted {', '.join(required)}, ..")
    if not any(name in header for name in required) and _are_numbers(header):
        first = f"{', '.join(required)}, .." if len(header) > len(required) else ", ".join(required)
        raise SessionError(
            f"{file}: the first line is numbers, and no header; put a line with the column names above it ({first})"
        )
    remedy = ""
    if len(header) == 1 and missing[0] in re.split(r"\W+", header[0]):
        remedy = "; write commas between the columns"
    elif any(re.match(rf"{missing[0]}\W", name) for name in header):
        remedy = f"; write names alone, as {missing[0]}"
    raise SessionError(f"{file}: no column {missing[0]}; has {listed(header)}{remedy}")


def _is_binary(head: str) -> bool:
    """Whether more than a few of the characters are none that a text holds; a card leaves zeros behind a text."""
    text = head.rstrip("\0")
    odd = sum(not (c.isprintable() or c in "\t\r\n") or c == UNREADABLE for c in text)
    return odd > ODD_SHARE * len(text)


def _are_numbers(header: Sequence[str]) -> bool:
    """Whether the first line is a row: cells that are numbers or empty, or times; names have letters in front."""
    return any(cell[:1].isdigit() for cell in header) and all(cell[:1] in "+-.0123456789 #" for cell in header)


def read_rows(
    path: Path,
    skip: int,
    width: int,
    separator: str | None,
    numbers: Collection[int],
    texts: Collection[int] = (),
    *,
    has_decimal_commas: bool = False,
    prefix: str = "gps",
) -> Rows:
    """Read rows of `width` cells below the first `skip` lines: columns of numbers, and of texts, which may be numbers.

    separator : None for any white space. Columns of few short words have their cells, as of texts: they may be
    hemispheres. has_decimal_commas : a comma in a cell is never one between thousands.
    prefix : of the codes of problems.
    Raises NoRowsError without rows, SessionError where no row fits or a line is endless.
    """
    values, kept = {i: Growing() for i in (*numbers, *texts)}, {i: list[pl.Series]() for i in texts}
    unread, units = dict.fromkeys(values, 0), dict[int, str]()
    form = _Form(separator or " ", width, separator is None, has_decimal_commas)
    length = misfits = found = 0
    is_cut = False
    for block in text_blocks(path, skip):
        lines, is_cut = form.without_cut_row(block)
        try:
            columns, odd, first_odd = form.read(lines, [i for i in values if i not in kept], kept)
        except pl.exceptions.PolarsError as error:
            raise SessionError(f"{path.name}: not readable as a CSV table ({str(error).splitlines()[0]})") from error
        if not length:
            kept |= {i: [] for i, column in columns.items() if i not in kept and are_words(column)}
        for i, column in columns.items():
            values[i].add(column.values)
            unread[i] += column.unread
            units.setdefault(i, column.unit)
        for i, cells in kept.items():
            of_column = columns[i].cells
            assert of_column is not None
            cells.append(of_column)
        length += len(next(iter(columns.values())).values)
        misfits, found = misfits + odd, found or first_odd
    if misfits and not length:
        remedy = ", or with decimal commas write semicolons between the cells" if separator == "," else ""
        raise SessionError(
            f"{path.name}: rows have {found} values, but {width} columns are named; mend the line of names{remedy}"
        )
    if not length:
        raise NoRowsError(f"{path.name}: a header line, but no rows; was the recording started?")
    problems = []
    if is_cut:
        problems.append(Problem(f"{prefix}_row_cut", f"{path.name}: 1 row cut short at the end of the file; dropped"))
    if misfits:
        text = f"{path.name}: {counted(misfits, 'row')} without the {width} values of a row; dropped"
        problems.append(Problem(f"{prefix}_row_damaged", text, misfits))
    columns = {
        i: Numbers(values[i].rows, unread[i], units[i], pl.concat(kept[i]) if i in kept else None) for i in values
    }
    return Rows(columns, tuple(problems))


@dataclass(frozen=True)
class _Form:
    """How the rows of a file are written."""

    separator: str
    width: int
    is_spaced: bool
    has_decimal_commas: bool

    def without_cut_row(self, block: bytes) -> tuple[bytes, bool]:
        """The block without a last row that has no end and fewer cells, or a shorter last cell, than all others.

        A number that lost its last digits is a number still: of a longitude of 11.23456 the cut 11.2 is as good.
        """
        if block.endswith(b"\n"):
            return block, False
        begin = max(0, len(block) - HEAD_BYTES)
        others = block[begin:].split(b"\n")[1 if begin else 0 :]
        last = others.pop() if others else b""
        mark = self.separator.encode()
        ends = [(line.count(mark), len(line.rpartition(mark)[2].rstrip())) for line in others if line.strip()]
        if not ends or not last.strip():
            return block, False
        cells, size = last.count(mark), len(last.rpartition(mark)[2])
        fewest = min(count for count, _ in ends)
        is_cut = cells < fewest or (cells == fewest and size < min(size for _, size in ends))
        return block[: len(block) - len(last)] if is_cut else block, is_cut

    def read(
        self, block: bytes, numbers: Collection[int], texts: Collection[int]
    ) -> tuple[dict[int, Numbers], int, int]:
        """The columns of a block of lines, how many rows do not fit, and how many cells the first of those has."""
        misfits = found = 0
        frame = self._cells(block, numbers, texts) if self._may_fit(block) else None
        if frame is None or frame[str(self.width)].null_count() < frame.height:
            block, misfits, found = self._fitted(block.split(b"\n"))
            frame = self._cells(block, numbers, texts)
        odd = [i for i in numbers if frame[str(i)].null_count()]
        again = self._cells(block, (), odd) if odd else frame
        columns = {}
        for i in (*numbers, *texts):
            if i in odd or i in texts:
                cells = self._restored((again if i in odd else frame)[str(i)])
                columns[i] = replace(numbers_of(cells, has_decimal_commas=self.has_decimal_commas), cells=cells)
            else:
                values = frame[str(i)].to_numpy()
                columns[i] = Numbers(finite(values), int(np.count_nonzero(np.isinf(values))))
        return columns, misfits, found

    def _may_fit(self, block: bytes) -> bool:
        """Whether all rows fit as far as counts show, and need no other care."""
        lines = block.count(b"\n") + (not block.endswith(b"\n"))
        is_plain = not self.is_spaced and b'"' not in block and COMMENT not in block
        return is_plain and block.count(self.separator.encode()) == lines * (self.width - 1)

    def _cells(self, block: bytes, numbers: Collection[int], texts: Collection[int]) -> pl.DataFrame:
        """The columns of numbers, null where a cell is none, of texts, and of what stands behind the last column."""
        header = self.separator.join(map(str, range(self.width + 1)))
        return pl.read_csv(
            header.encode() + b"\n" + block,
            columns=[str(i) for i in (*numbers, *texts, self.width)],
            separator=self.separator,
            infer_schema=False,
            schema_overrides={str(i): pl.Float64 for i in numbers},
            ignore_errors=True,
            truncate_ragged_lines=True,
            quote_char=None,
            encoding="utf8-lossy",
        )

    def _restored(self, cells: pl.Series) -> pl.Series:
        return cells.str.replace_all(_INSIDE, self.separator, literal=True)

    def _fitted(self, lines: list[bytes]) -> tuple[bytes, int, int]:
        """The rows that fit, without quotation marks; how many do not, and how many cells the first of those has."""
        mark, fitted, misfits, found, i = self.separator.encode(), list[bytes](), 0, 0, 0
        while i < len(lines):
            line, used = self._unquoted(lines, i) if b'"' in lines[i] else (lines[i], 1)
            i += used
            if not line.strip() or line.lstrip().startswith(COMMENT):
                continue
            if self.is_spaced:
                line = b" ".join(line.replace(b",", b".").split())  # some programs write decimal commas
            more = line.count(mark) + 1 - self.width
            if more < 0 or (more > 0 and b"".join(line.rsplit(mark, more)[1:]).strip()):
                misfits, found = misfits + 1, found or more + self.width
                continue
            fitted.append(line)
        return b"\n".join(fitted), misfits, found

    def _unquoted(self, lines: list[bytes], first: int) -> tuple[bytes, int]:
        """The row that begins with a line with quotation marks, and how many lines it takes.

        A cell in quotes may run over several lines; a mark without a partner costs its line, and not those behind it.
        """
        for used in range(1, min(MOST_LINES_OF_A_ROW, len(lines) - first) + 1):
            text = b"\n".join(lines[first : first + used]).decode("utf-8", errors="replace")
            if text.count('"') % 2 == 0:
                row = _parsed(text, self.separator)
                if used == 1 or len(row) == self.width:
                    cells = (cell.replace(self.separator, _INSIDE).replace("\n", " ") for cell in row)
                    return self.separator.join(cells).encode(), used
                break
        return lines[first].replace(b'"', b""), 1


def _parsed(text: str, separator: str) -> list[str]:
    try:
        return next(csv.reader([text], delimiter=separator, skipinitialspace=True), [])
    except csv.Error:
        return text.split(separator)
