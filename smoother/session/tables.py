"""CSV tables: a header line, columns in any order, rows that may be damaged.

Columns stand between commas; the header line tells where they stand between semicolons or tabs instead, and numbers may
then have a decimal comma. Cells may be quoted.

A file whose cells are all numbers is read as such, four times faster; else every cell is read as text and cast
leniently, so a bad row costs itself and never the file. What can be wrong with a file as a whole (empty, no header, a
missing column) is a SessionError that names the file and what it has.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from smoother.arrays import Array, BoolArray
from smoother.disc import Growing, pieces, release, roomy
from smoother.errors import SessionError
from smoother.session.table_bytes import (
    HEAD_BYTES,
    LONGEST_LINE,
    end_of_text,
    plain_source,
    separator_of,
    text_head,
    unquoted,
)
from smoother.words import UNREADABLE, listed

LONG_FILE = 64 << 20  # bytes; an hour of samples. Longer ones are read in parts, which takes less memory
PART_BYTES = 32 << 20
_ISO_FORMATS = tuple(
    f"{form}{zone}" for form in ("%Y-%m-%dT%H:%M:%S%.f", "%Y%m%dT%H%M%S%.f") for zone in ("", "%:z", "%z")
)
ENOUGH_LINES = 20  # to know how many cells a row has
ODD_SHARE = 0.05  # of the characters of a damaged text; names in another encoding are far fewer
_MADE_DIFFERENT = re.compile(r"_duplicated_\d+$")  # by polars
_POINTED = re.compile(r"\s*[+-]?\d*\.\d*([eE][+-]?\d+)?\s*")
NOTHING = re.compile(r"(?i)^(?:[-*?.]+|#?n[./]?a\.?|nil|null|none|nan)$")  # as programs write cells without a number


class NoRowsError(SessionError):
    """A table that holds nothing: nothing is wrong with it that a person could mend, and the others may do."""


@dataclass(frozen=True)
class _Wanted:
    """What is read of a table, and what stands between its cells."""

    numbers: tuple[str, ...]
    required: tuple[str, ...]
    times: tuple[str, ...]
    separator: str

    @property
    def names(self) -> tuple[str, ...]:
        """All columns."""
        return (*self.numbers, *self.times)

    @property
    def flags(self) -> list[str]:
        """The columns of true and false: required cells that hold nothing, others that are not understood."""
        return [*(f"empty {name}" for name in self.required), *(f"unread {name}" for name in self.others)]

    @property
    def others(self) -> list[str]:
        """The columns that may be empty."""
        return [*(name for name in self.numbers if name not in self.required), *self.times]


@dataclass(frozen=True, eq=False)
class _Gathered:
    """Columns and flags of a whole table by name, and whether a last row was cut."""

    columns: dict[str, Array]
    flags: dict[str, BoolArray]
    cut: bool


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers of a CSV file: `columns` maps lower-case names to (N,) float64, NaN where a cell is no number.

    `empty` maps the required columns to (N,) bool: the cell holds nothing at all, rather than something unreadable.
    `unread` counts, for each optional column, the cells that hold something which is no number, or no time.
    `cut` : the last row was cut short, as by a loss of power, and is left out. Of columns of one name the first counts.
    """

    file: str
    columns: dict[str, Array]
    empty: dict[str, BoolArray]
    length: int
    unread: dict[str, int]
    cut: bool = False

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


def unique_names(names: Sequence[str]) -> list[str]:
    """Trim and lower the header cells; a repeated or empty name gets a suffix no contract uses."""
    seen: dict[str, int] = {}
    unique = []
    for name in names:
        plain = name.strip("\ufeff\x00 \t\r\n\"'").lower()
        seen[plain] = seen.get(plain, 0) + 1
        unique.append(plain if plain and seen[plain] == 1 else _repeated(plain, seen[plain]))
    return unique


def _own_names(names: Sequence[str]) -> list[str]:
    """The same of names that polars has made different in its own way."""
    return unique_names([_MADE_DIFFERENT.sub("", name) for name in names])


def _repeated(name: str, number: int) -> str:
    """What the column of a name is called that is the second of it, or of any other number."""
    return f"{name} #{number}"


def read_header(path: Path) -> tuple[str, ...]:
    """Column names of a CSV file, lower case and trimmed; () if it is empty. Raises SessionError if unreadable."""
    line = _header_line(path)
    separator = separator_of(line)
    bare = unquoted(line.encode(), separator).decode()
    return tuple(unique_names(bare.split(separator))) if line.strip() else ()


def head_lines(path: Path, most: int) -> list[str]:
    """The first lines that are not blank, at `most` so many. Raises SessionError if the file is unreadable."""
    return [line for line in text_head(path).splitlines() if line.strip()][:most]


def names_of(line: str) -> tuple[str, ...]:
    """The cells of a line, as they stand there but for quotation marks."""
    separator = separator_of(line)
    return tuple(cell.strip() for cell in unquoted(line.encode(), separator).decode().split(separator))


def _header_line(path: Path) -> str:
    return _first_line(text_head(path))


def _first_line(text: str) -> str:
    return next((line for line in text.splitlines() if line.strip()), "")


def read_table(
    path: Path, required: Sequence[str], optional: Sequence[str] = (), iso_times: Sequence[str] = ()
) -> Table:
    """Read the named columns of a CSV file, plain or gzip; others are ignored, blank lines too.

    iso_times : optional columns of ISO 8601 times, of the extended form or the basic one, returned as seconds since
    1970 (UTC where no zone is given).
    Raises NoRowsError for an empty file or no rows, SessionError for a missing column or an unreadable file.
    """
    header = read_header(path)
    if not header:
        raise NoRowsError(f"{path.name}: the file is empty; expected a header line with {', '.join(required)}")
    head = text_head(path)
    if not head.strip("\0"):
        raise NoRowsError(f"{path.name}: begins with {len(head)} zero bytes; was it ever written? Copy it again")
    _require_columns(path.name, header, required, head)
    _require_points(path.name, header, head)
    numbers, times = (tuple(name for name in names if name in header) for names in ((*required, *optional), iso_times))
    wanted = _Wanted(numbers, tuple(required), times, separator_of(_header_line(path)))
    found = _gathered(path, wanted)
    if len(found.columns[required[0]]) == 0:
        raise NoRowsError(f"{path.name}: a header line, but no rows; was the recording started?")
    empty = {name: found.flags[f"empty {name}"] for name in required}
    unread = {name: int(found.flags[f"unread {name}"].sum()) for name in wanted.others}
    return Table(path.name, found.columns, empty, len(found.columns[required[0]]), unread, found.cut)


def _require_columns(file: str, header: Sequence[str], required: Sequence[str], head: str) -> None:
    """Raise SessionError where a column is missing, or all of the first line, of names, is, or the file is no text."""
    missing = [name for name in required if name not in header]
    if missing and _is_binary(head):
        raise SessionError(f"{file}: not a text table, but a file of another kind; wanted {', '.join(required)}, ..")
    if missing and not any(name in header for name in required) and _are_numbers(header):
        first = f"{', '.join(required)}, .." if len(header) > len(required) else ", ".join(required)
        raise SessionError(
            f"{file}: the first line is numbers, and no header; put a line with the column names above it ({first})"
        )
    if missing:
        raise SessionError(f"{file}: no column {missing[0]}; has {listed(header)}{_remedy(missing[0], header)}")


def _remedy(missing: str, header: Sequence[str]) -> str:
    """What to do about a column that is missing where the header shows it in another form; else nothing."""
    if len(header) == 1 and missing in re.split(r"\W+", header[0]):
        return "; write commas between the columns"
    with_more = next((name for name in header if re.match(rf"{missing}\W", name)), None)
    return "" if with_more is None else f"; write names alone, as {missing}"


def _is_binary(head: str) -> bool:
    """Whether more than a few of the characters are none that a text holds; a card leaves zeros behind a text."""
    text = head.rstrip("\0")
    odd = sum(not (c.isprintable() or c in "\t\r\n") or c == UNREADABLE for c in text)
    return odd > ODD_SHARE * len(text)


def _are_numbers(header: Sequence[str]) -> bool:
    """Whether the first line is a row: cells that are numbers or empty, or times; names have letters in front."""
    return any(cell[:1].isdigit() for cell in header) and all(cell[:1] in "+-.0123456789 #" for cell in header)


def _require_points(file: str, header: Sequence[str], head: str) -> None:
    """Raise SessionError where numbers have decimal commas and commas stand between them too.

    Read as they stand, a longitude would be the decimals of the latitude. Then rows have more cells than there are
    names, and no number has a point.
    """
    if '"' in head or separator_of(_first_line(head)) != ",":
        return
    lines = [line for line in head.splitlines() if line.strip()][1 : ENOUGH_LINES + 1]
    cells = [line.rstrip(", \t").split(",") for line in lines]
    longer = [row for row in cells if len(row) > len(header)]
    if lines and 2 * len(longer) > len(lines) and not any(_POINTED.fullmatch(cell) for row in longer for cell in row):
        raise SessionError(
            f"{file}: {len(header)} names in the header line, but rows of {len(longer[0])} cells; with decimal commas "
            "write semicolons between the cells, or points for decimals"
        )


def _gathered(path: Path, wanted: _Wanted) -> _Gathered:
    """What a file holds; of a long one from all parts."""
    try:
        source, is_quoted = plain_source(path), '"' in text_head(path)
        end, cut = _end_of_rows(source, wanted.separator.encode())
        if isinstance(source, bytes):
            source = source[:end]
        elif path.stat().st_size <= LONG_FILE and end < path.stat().st_size:
            source = source.read_bytes()[:end]
        if isinstance(source, bytes) or path.stat().st_size <= LONG_FILE:
            if is_quoted:
                source = unquoted(source.read_bytes() if isinstance(source, Path) else source, wanted.separator)
            frame = _read_cells(source, wanted)
            flags = {name: frame[name].to_numpy() for name in wanted.flags}
            return _Gathered({name: _column(frame, name) for name in wanted.names}, flags, cut)
        return _gathered_in_parts(path, wanted, end, cut, is_quoted)
    except pl.exceptions.PolarsError as error:
        raise SessionError(f"{path.name}: not readable as a CSV table ({str(error).splitlines()[0]})") from error
    except OSError as error:
        raise SessionError(f"{path.name}: cannot be read ({error.strerror or error})") from error


def _gathered_in_parts(path: Path, wanted: _Wanted, end: int, cut: bool, is_quoted: bool) -> _Gathered:
    """The same of a long file, `end` bytes of which are rows: a part of it at a time is in memory."""
    growing = {name: Growing() for name in wanted.names}
    flags = {name: Growing(dtype=np.bool_) for name in wanted.flags}
    for lines in _parts(path, end):
        frame = _read_cells(unquoted(lines, wanted.separator) if is_quoted else lines, wanted)
        for name, column in growing.items():
            column.add(_column(frame, name))
        for name, flag in flags.items():
            flag.add(frame[name].to_numpy())
    columns = {name: column.rows for name, column in growing.items()}
    return _Gathered(columns, {name: flag.rows for name, flag in flags.items()}, cut)


def _parts(path: Path, end: int) -> Iterator[bytes]:
    """The first `end` bytes of a file in parts of whole lines, each below the header."""
    with path.open("rb") as file:
        header = file.readline(LONGEST_LINE)
        while not header.strip() and (more := file.readline(LONGEST_LINE)):
            header = more
        while lines := file.read(min(PART_BYTES, end - file.tell())):
            yield header + lines + file.readline(min(LONGEST_LINE, end - file.tell()))


def _end_of_rows(source: Path | bytes, separator: bytes) -> tuple[int, bool]:
    """Where the whole rows of a file end, and whether a row that was cut short stands behind them.

    A card has room reserved for a file that grows: after a loss of power zeros may follow the last row.
    """
    if isinstance(source, bytes):
        end = len(source.rstrip(b"\0"))
        begin = max(0, end - HEAD_BYTES)
        tail = source[begin:end]
    else:
        with source.open("rb") as file:
            end = end_of_text(file, source.stat().st_size)
            begin = max(0, end - HEAD_BYTES)
            file.seek(begin)
            tail = file.read(end - begin)
    cut = _length_cut(tail, separator)
    return end - cut, cut > 0


def _length_cut(tail: bytes, separator: bytes) -> int:
    """How many bytes at the end are a row without end that has fewer cells, or a shorter last cell, than all others.

    A number that lost its last digits is a number still: of a longitude of 11.23456 the cut 11.2 is as good a place.
    """
    *before, last = tail.splitlines() or [b""]
    others = [line for line in before[1:] if line.strip()]  # the first is the header, or cut itself
    if tail.endswith((b"\n", b"\r")) or not last.strip() or not others:
        return 0
    fewest = min(line.count(separator) for line in others)
    shortest = min(len(line.rpartition(separator)[2].rstrip()) for line in others)
    cells = last.count(separator)
    is_cut = cells < fewest or (cells == fewest and len(last.rpartition(separator)[2]) < shortest)
    return len(last) if is_cut else 0


def _read_cells(source: Path | bytes, wanted: _Wanted) -> pl.DataFrame:
    """The columns and flags of a table: as numbers throughout, or else cell by cell."""
    nothing = [pl.lit(value=False).alias(f"empty {name}") for name in wanted.required]
    nothing += [
        pl.col(name).is_infinite().fill_null(value=False).alias(f"unread {name}")
        for name in wanted.others
        if name not in wanted.times
    ]
    clean = _scan(source, wanted, wanted.numbers).select(*wanted.numbers, *_times(wanted), *nothing)
    frame = clean.collect(engine="streaming")
    if frame.select(wanted.numbers).null_count().sum_horizontal().sum() == 0:
        return frame
    return _lenient(source, wanted).collect(engine="streaming")


def _scan(source: Path | bytes, wanted: _Wanted, numbers: Sequence[str] = ()) -> pl.LazyFrame:
    """The file with the columns `numbers` as numbers, null where a cell is none; the others as text."""
    return pl.scan_csv(
        source.absolute() if isinstance(source, Path) else source,  # else ~ at its start is a home folder
        glob=False,  # a name may hold brackets, stars and question marks
        separator=wanted.separator,
        infer_schema=False,
        schema_overrides=dict.fromkeys(numbers, pl.Float64),
        ignore_errors=True,
        truncate_ragged_lines=True,
        quote_char=None,
        encoding="utf8-lossy",
        with_column_names=_own_names,
    )


def _lenient(source: Path | bytes, wanted: _Wanted) -> pl.LazyFrame:
    """The same from a file with cells that are padded, empty or no numbers; blank lines are left out."""
    blank = {name: _is_blank(name) for name in wanted.required}
    chosen = [
        *(_number(name).alias(name) for name in wanted.numbers),
        *_times(wanted),
        *(blank[name].alias(f"empty {name}") for name in wanted.required),
        *(_is_unread(name).alias(f"unread {name}") for name in wanted.others if name not in wanted.times),
    ]
    return _scan(source, wanted).filter(~pl.all_horizontal(blank.values())).select(chosen)


def _cell(name: str) -> pl.Expr:
    return pl.col(name).str.strip_chars(" \t\r")


def _number(name: str) -> pl.Expr:
    """A cell as a number; a comma in it is a decimal one, as it does not part cells."""
    return _cell(name).str.replace(",", ".", literal=True).cast(pl.Float64, strict=False)


def _is_blank(name: str) -> pl.Expr:
    return _cell(name).is_null() | (_cell(name) == "")


def _is_unread(name: str) -> pl.Expr:
    """Whether a cell holds something that is no finite number, and no word for nothing either."""
    number = _number(name)
    is_none = number.is_null() & ~_is_blank(name) & ~_cell(name).str.contains(NOTHING.pattern)
    return is_none | number.is_infinite().fill_null(value=False)


def _times(wanted: _Wanted) -> Iterator[pl.Expr]:
    """The columns of times in seconds since 1970, and of each where it holds something else."""
    for name in wanted.times:
        seconds = _unix_seconds(_cell(name))
        yield seconds.alias(name)
        yield (seconds.is_null() & ~_is_blank(name)).alias(f"unread {name}")


def _column(frame: pl.DataFrame, name: str) -> Array:
    values = frame[name].to_numpy()  # null becomes NaN
    finite = np.isfinite(values)
    return values if finite.all() else np.where(finite, values, np.nan)


def _unix_seconds(cell: pl.Expr) -> pl.Expr:
    text = cell.str.replace(r"(?i)\s*(z|utc)$", "").str.replace(" ", "T", literal=True)
    text = text.str.replace(",", ".", literal=True)
    parsed = [text.str.to_datetime(form, strict=False, time_unit="us").dt.epoch("us") for form in _ISO_FORMATS]
    return pl.coalesce(parsed).cast(pl.Float64) / 1e6
