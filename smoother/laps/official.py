"""Official (transponder) times from a file: one lap a row, in driving order."""

import csv
import math
from pathlib import Path

from smoother.errors import SessionError

NAMES = ("lap_time_s", "lap_time", "laptime", "time", "time_s")
LONGEST = 3600.0  # s; beyond, a row holds something else than a lap time


def load_official(path: Path) -> tuple[float, ...]:
    """Read lap times, as seconds or m:ss.mmm: of the column lap_time_s (or time), else of the last column.

    Rows without a time are left out. Raises SessionError, with file and remedy, where there is none at all.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
            rows = [row for row in csv.reader(file, delimiter=_delimiter(path)) if row and not row[0].startswith("#")]
    except OSError as error:
        raise SessionError(f"{path}: cannot be read ({error.strerror or error})") from error
    column = _column(rows[0]) if rows else -1
    times = (parse_time(row[column]) for row in rows if -len(row) <= column < len(row))
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
