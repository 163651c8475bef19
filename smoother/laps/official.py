"""Official (transponder) times from a file: one lap a row, in driving order."""

import csv
import math
from pathlib import Path

from smoother.documents import LARGEST, read_bounded
from smoother.errors import SessionError
from smoother.session.text import in_utf8
from smoother.words import UNREADABLE

NAMES = ("lap_time_s", "lap_time", "laptime", "time", "time_s")
LONGEST = 3600.0  # s; a larger value is no lap time


def load_official(path: Path) -> tuple[float, ...]:
    """Read lap times, as seconds or m:ss.mmm: of the column lap_time_s (or time), else of the last column.

    Rows without a time are skipped; decimals may follow a comma. Raises SessionError, with file and remedy, without
    any.
    """
    lines = _lines(path)
    delimiter = max(",;\t", key=lines[0].count) if lines else ","
    rows = [row for line in lines if (row := _row(line, delimiter)) and not row[0].startswith("#")]
    times = (parse_time(cell) for cell in _cells(rows))
    found = tuple(time for time in times if time is not None)
    if len(found) > 10_000:  # laps; the cost of matching grows with the square
        raise SessionError(f"{path}: {len(found)} lap times, more than anybody drives; is it of another kind?")
    if not found:
        raise SessionError(f"{path}: no lap times; wanted a column lap_time_s in seconds or m:ss.mmm")
    return found


def parse_time(text: str) -> float | None:
    """Return seconds of "62.345", "1:02.345" or "1:02,345"; None for anything else."""
    minutes, _, rest = text.strip().replace(",", ".").rpartition(":")
    try:
        seconds = float(rest) + 60.0 * (float(minutes) if minutes else 0.0)
    except ValueError:
        return None
    return seconds if math.isfinite(seconds) and 0.0 < seconds < LONGEST else None


def _cells(rows: list[list[str]]) -> list[str]:
    """The cell of each row that may be a time; joined again where a decimal comma split it."""
    if not rows:
        return []
    column, width = _column(rows[0]), len(rows[0])
    if column >= 0:
        cut = [slice(column, column + 1 + (len(row) == width + 1)) for row in rows]
    else:
        cut = [slice(-2 if _are_halves(rows) else -1, None)] * len(rows)
    return [",".join(row[part]) for row, part in zip(rows, cut, strict=True)]


def _are_halves(rows: list[list[str]]) -> bool:
    """Whether two whole numbers in a row are "52,78", a time with a decimal comma, and no lap with its time."""
    if not all(len(row) == 2 and row[1].isdecimal() for row in rows):
        return False
    first = [row[0] for row in rows]
    return first != [str(i) for i in range(int(first[0]), int(first[0]) + len(rows))] if first[0].isdecimal() else True


def _lines(path: Path) -> list[str]:
    """The lines of the file, in any encoding. Raises SessionError where it is too large, or unreadable."""
    too_large = f"{path}: larger than {LARGEST >> 20} MB; this is no table of lap times"
    data = read_bounded(path, SessionError, too_large)
    lines = [line.decode("utf-8-sig", errors="replace") for line in in_utf8(data).splitlines()]
    odd = sum(line.count(UNREADABLE) for line in lines)
    # of undecodable characters; more are a file of another kind
    return lines if odd <= 0.05 * sum(map(len, lines)) else []


def _row(line: str, delimiter: str) -> list[str]:
    """The cells of a line. Each is parsed alone, so that an unbalanced quotation mark affects one row."""
    # characters; a longer one is damaged
    return next(csv.reader([line], delimiter=delimiter), []) if len(line) <= 4096 else []


def _column(header: list[str]) -> int:
    names = [name.strip().lower() for name in header]
    for wanted in NAMES:
        if wanted in names:
            return names.index(wanted)
    return -1
