"""AiM CSV as Race Studio exports it: quoted rows about the session, names, units, and the values at an even rate.

Times count from the start of the log, whose date and time of day are local: without a word about the zone they are
taken as this computer's, and said so. They tell when laps began, and take no part in the clock of the fixes. Only the
GPS channels are used: which way the inertial channels of a given AiM box point, the file does not say.
"""

import datetime as dt
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.dates import day_of
from smoother.session.foreign import (
    LENGTH_UNITS,
    SPEED_UNITS,
    ForeignReading,
    axes_note,
    date_note,
    factor,
    fixes_from,
    speed_unit_note,
)
from smoother.session.records import head_of, read_records

WHAT = "AiM CSV with GPS channels"
MARK = "aim csv file"
TIME, LATITUDE, LONGITUDE = "time", "gps latitude", "gps longitude"
OPTIONAL = ("gps speed", "gps nsat", "gps heading", "gps altitude", "gps posaccuracy", "gps spdaccuracy")
INERTIAL = ("inlineacc", "lateralacc", "rollrate", "yawrate")
CLOCK = re.compile(r"(\d{1,2}):(\d{2})(?::(\d{2})(?:[.,]\d*)?)?\s*([ap]m)?", re.IGNORECASE)
SEPARATORS = ",;\t"  # of as many the first
OWN_UTC = "time is utc."  # as this program's own export says


@dataclass(frozen=True)
class _Columns:
    """Names (lower case, repeated ones made different) and units of the columns, and what stands between cells.

    about : the first value of each row before them, by its name in lower case.
    """

    names: list[str]
    units: list[str]
    separator: str
    about: dict[str, str]

    def unit(self, name: str) -> str:
        return self.units[self.names.index(name)]


def read_aim(path: Path) -> ForeignReading:
    """Read an AiM CSV. Raises SessionError, one line, where it is none or nothing in it can be used."""
    columns, offset = _header(path)
    names = columns.names
    missing = [name for name in (LATITUDE, LONGITUDE) if name not in names]
    if missing:
        raise SessionError(f"{path.name}: no channel {missing[0].title()}; export it with the GPS channels")
    wanted = [TIME, LATITUDE, LONGITUDE, *(name for name in OPTIONAL if name in names)]
    records = read_records(path, offset, names, wanted, columns.separator, WHAT)

    def value(name: str, units: dict[str, float] | None = None, usual: str = "") -> Array:
        scale = 1.0 if units is None or name not in names else factor(columns.unit(name), units, usual)
        return records.column(name) * scale

    gnss, problems = fixes_from(
        path.name,
        value(TIME),
        value(LATITUDE),
        value(LONGITUDE),
        alt_m=value("gps altitude", LENGTH_UNITS, "m"),
        speed=value("gps speed", SPEED_UNITS, "km/h"),
        course_deg=value("gps heading"),
        sigma_horizontal=value("gps posaccuracy", LENGTH_UNITS, "mm"),
        sigma_velocity=value("gps spdaccuracy", SPEED_UNITS, "km/h"),
        num_sv=value("gps nsat"),
    )
    if "gps speed" in names:
        problems = [*speed_unit_note(path.name, columns.unit("gps speed"), "km/h"), *problems]
    problems = [*axes_note(path.name, [name for name in INERTIAL if name in names]), *problems]
    unix_at_zero, date_problems = _start(path.name, columns.about)
    problems = [*records.problems(path.name), *date_problems, *problems]
    return ForeignReading(gnss, problems, unix_at_zero=unix_at_zero)


def _start(file: str, about: dict[str, str]) -> tuple[float | None, list[Problem]]:
    """UTC at which the log began, to the minute or second it was written to, and what had to be assumed for it."""
    day, clock = day_of(about.get("date", "")), _clock(about.get(TIME, ""))
    if day is None or clock is None:
        return None, [date_note(file, "no date and time of day in it that can be read one way; laps have none")]
    moment = dt.datetime.combine(day, clock)
    if OWN_UTC in about.get("comment", "").lower():
        return moment.replace(tzinfo=dt.UTC).timestamp(), []
    zone = moment.astimezone()
    text = f"date and time of day are local, the zone is not in it; taken as this computer's ({zone:%Z})"
    return zone.timestamp(), [date_note(file, text)]


def _clock(text: str) -> dt.time | None:
    if (match := CLOCK.fullmatch(text.strip())) is None:
        return None
    hour, half = int(match[1]), (match[4] or "").lower()
    if half and not 1 <= hour <= 12:
        return None
    hour = hour % 12 + 12 * (half == "pm") if half else hour
    try:
        return dt.time(hour, int(match[2]), int(match[3] or 0))
    except ValueError:
        return None


def _header(path: Path) -> tuple[_Columns, int]:
    """The names and units and the byte at which the rows after the units begin."""
    state = {"seen": 0}

    def is_last(line: str) -> bool:
        if state["seen"]:
            return True  # the row of units follows the names at once
        cells = _cells(line, _separator(line))
        state["seen"] = int(cells[0] == TIME and len(cells) > 2 and any(cell.startswith("gps") for cell in cells))
        return False

    lines, offset = head_of(path, is_last, WHAT)
    separator = _separator(lines[-2])
    names = [name.replace("_", " ") for name in _cells(lines[-2], separator)]
    names = [name if names.index(name) == i else f"{name} #{i}" for i, name in enumerate(names)]
    units = _cells(lines[-1], separator)
    return _Columns(names, (units + [""] * len(names))[: len(names)], separator, _about(lines[:-2], separator)), offset


def _about(lines: Sequence[str], separator: str) -> dict[str, str]:
    """What each row about the session says, by its first cell in lower case; the last wins."""
    rows = [line.partition(separator) for line in lines]
    return {name.strip(' "').lower(): rest.strip(' "\r\n' + separator) for name, _, rest in rows}


def _separator(line: str) -> str:
    return max(SEPARATORS, key=line.count)


def _cells(line: str, separator: str) -> list[str]:
    return [cell.strip(' "').lower() for cell in line.split(separator)]
