"""Pieces that several text formats share: times, quoting, rows, parts that are put together at the end."""

import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import IO
from xml.sax.saxutils import escape

import numpy as np

from smoother.arrays import Array
from smoother.export.source import Source, one_line

PRODUCT = "kart-smoother"


def milliseconds(unix_s: Array) -> np.ndarray:
    """UTC (N,) s since 1970 as whole milliseconds."""
    return np.round(unix_s * 1e3).astype(np.int64)


def iso_times(unix_s: Array) -> list[str]:
    """UTC (N,) s since 1970 as ISO 8601 with milliseconds and Z."""
    text = np.datetime_as_string(milliseconds(unix_s).astype("datetime64[ms]"), unit="ms")
    return [f"{moment}Z" for moment in text.tolist()]


def start_stamp(source: Source) -> np.datetime64:
    """UTC of the first row, to the second."""
    return np.datetime64(int(np.floor(source.clock.at(source.start) + 5e-4)), "s")


def date_and_time(source: Source) -> tuple[str, str]:
    """UTC of the first row as DD/MM/YYYY and HH:MM:SS."""
    date, _, time = str(start_stamp(source)).partition("T")
    year, month, day = date.split("-")
    return f"{day}/{month}/{year}", time


def lines(template: str, columns: Sequence[Array | list[str]]) -> str:
    """Fill the template with every row of the columns; it ends with its own newline."""
    plain = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
    return "".join(template % row for row in zip(*plain, strict=True))


def cells(values: Array, form: str) -> list[str]:
    """Numbers as text, empty where not finite."""
    return [form % value if value - value == 0.0 else "" for value in values.tolist()]


def quoted(text: str) -> str:
    """Return a CSV cell in quotation marks."""
    return '"' + one_line(text).replace('"', '""') + '"'


def xml(text: str) -> str:
    """Return text for an XML element or attribute."""
    return escape(one_line(text), {'"': "&quot;"})


def lap_clock(seconds: float) -> str:
    """Return 1:07.123."""
    whole = round(seconds * 1e3)
    return f"{whole // 60000}:{whole // 1000 % 60:02d}.{whole % 1000:03d}"


@contextmanager
def parts(count: int) -> Iterator[list[IO[str]]]:
    """Give temporary text files for a format whose columns stand one after another: rows are passed over once."""
    with ExitStack() as stack:
        yield [stack.enter_context(tempfile.TemporaryFile("w+", encoding="utf-8", newline="")) for _ in range(count)]


def append(target: IO[str], part: IO[str]) -> None:
    """Copy a temporary part, whole, to the end of the target, and empty it."""
    part.seek(0)
    shutil.copyfileobj(part, target)
    part.seek(0)
    part.truncate()
