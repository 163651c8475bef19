"""Official (transponder) times from a file: one lap a row, in driving order."""

import csv
import math
from pathlib import Path

from smoother.errors import SessionError

NAMES = ("lap_time_s", "lap_time", "laptime", "time", "time_s")
LONGEST = 3600.0  # s; beyond, a row holds something else than a lap time


def load_official(path: Path) -> tuple[float, ...]:
    """Read lap times, as seconds or m:ss.mmm: of the column lap_time_s (or time), else of the last column.

    Rows without a time are left out; decimals may follow a comma. Raises SessionError, with file and remedy, where
    there is none at all.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            rows = [row for row in csv.reader(file, delimiter=_delimiter(path)) if row and not row[0].startswith("#")]
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror or error})") from error
    times = (parse_time(cell) for cell in _cells(rows))
    found = tuple(time for time in times if time is not None)
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
    """The cell of each row that may be a time; put together again where the comma in it was taken to end a cell."""
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


def _delimiter(path: Path) -> str:
    with path.open(encoding="utf-8-sig", errors="replace") as file:
        first = file.readline()
    return max(",;\t", key=first.count)


def _column(header: list[str]) -> int:
    names = [name.strip().lower() for name in header]
    for wanted in NAMES:
        if wanted in names:
            return names.index(wanted)
    return -1
