"""When the rows of another program's table were taken: from whatever its cells say of it.

Cells are numbers (seconds or parts of one, since the start or since 1970; or digits of a clock, HHMMSS), times of day,
or moments with a date. A table often has several such columns; the finest is the clock of the rows.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.samples import Problem
from smoother.session.dates import day_of
from smoother.session.rows import over_midnight
from smoother.units import DAY

CLOCK = r"(?i)t?(\d{1,2}):(\d{2}):(\d{2}(?:\.\d+)?)\s*([ap]m)?\s*(z|utc|gmt)?\s*([+-]\d{2}:?\d{2})?"
PARTS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}  # s
PARTS |= {"sec": 1.0, "seconds": 1.0, "msec": 1e-3, "milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9}
EARLIEST_UNIX, LATEST_UNIX = 631152000.0, 4102444800.0  # s; 1990 and 2100
SLOWEST = 30.0  # s between rows; a kart is somewhere else by then
DIGITS_LEAP = 40.0  # of HHMMSS, from 59 s to the next minute
MOSTLY = 0.5  # of the cells that are there
MOST_DATES = 1000  # different ones in one column; more are no dates


@dataclass(frozen=True, eq=False)
class Moments:
    """One column: seconds (N,), NaN where unknown. Since 1970 where `has_date`, else of the day where `is_of_day`, else
    since any moment. `unit` where a number of the last kind did not say: "". `has_zone` where UTC was told.
    """

    seconds: Array
    has_date: bool = False
    is_of_day: bool = False
    unit: str = "s"
    has_zone: bool = True

    @property
    def fineness(self) -> int:
        """How many different times there are."""
        return int(np.unique(self.seconds[np.isfinite(self.seconds)]).size)


def read_moments(cells: pl.Series, unit: str) -> Moments | None:
    """Return the times that a column of text says, None where it says none. unit : of its numbers, "" if not known."""
    numbers = _floats(cells.cast(pl.Float64, strict=False))
    filled = int(np.count_nonzero((cells.str.len_chars() > 0).fill_null(value=False).to_numpy()))
    if filled and np.count_nonzero(np.isfinite(numbers)) > MOSTLY * filled:
        return _of_numbers(numbers, unit)
    of_day, zone_known, dates = _of_text(cells)
    if not filled or np.count_nonzero(np.isfinite(of_day)) <= MOSTLY * filled:
        return None
    if np.count_nonzero(np.isfinite(dates)) > MOSTLY * filled:
        return Moments(dates + of_day, has_date=True, has_zone=zone_known)
    return Moments(of_day, is_of_day=True, has_zone=zone_known)


def read_days(cells: pl.Series) -> Array:
    """Midnight (N,), s since 1970, of the days that a column of text says, NaN where it says none."""
    return _of_text(cells)[2]


def put_together(columns: Sequence[Moments], days: Array | None) -> tuple[Moments, Moments | None]:
    """The clock of the rows, the finest of `columns`, one or more; and UTC, from whichever tells the date.

    days (N,) : midnight of each row's day, s since 1970, for times of day.
    """
    dated = [_with_day(moments, days) for moments in columns]
    clock = max(dated, key=lambda moments: moments.fineness)  # of as fine ones the first
    with_date = [moments for moments in dated if moments.has_date]
    return clock, max(with_date, key=lambda moments: moments.fineness, default=None)


def time_of_day(clock: Array) -> Array:
    """Seconds (N,) since midnight from HHMMSS.sss as a number; NaN where that is no time."""
    clock = np.where(np.abs(clock) < 1e6, clock, np.nan)
    with np.errstate(invalid="ignore"):
        hours, minutes, seconds = clock // 10_000, clock // 100 % 100, clock % 100
        good = (clock >= 0.0) & (hours < 24) & (minutes < 60) & (seconds < 61)
    return np.where(good, np.round(hours * 3600 + minutes * 60 + seconds, 6), np.nan)


def zone_note(file: str) -> Problem:
    """Say that a file does not tell in which zone its times are."""
    return Problem("gps_date_assumed", f"{file}: it does not say in which zone its times of day are; taken as UTC")


def _of_numbers(numbers: Array, unit: str) -> Moments:
    known = numbers[np.isfinite(numbers)]
    steps = np.diff(known)
    step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf
    for part in (PARTS[unit],) if unit in PARTS else (1.0, 1e-3, 1e-6, 1e-9):
        if EARLIEST_UNIX <= np.median(known) * part <= LATEST_UNIX and step * part < SLOWEST:
            return Moments(numbers * part, has_date=True)
    if unit in PARTS:
        return Moments(numbers * PARTS[unit])
    return Moments(_running(time_of_day(numbers)), is_of_day=True) if _are_digits(known) else Moments(numbers, unit="")


def _are_digits(known: Array) -> bool:
    """Whether times (N,) are digits of a clock, HHMMSS: at the end of each minute they leap by 40, and never before."""
    leaps = np.diff(known)[np.diff(known // 100) > 0.0] % 100.0
    is_minute = (leaps >= DIGITS_LEAP) & (leaps < DIGITS_LEAP + SLOWEST)
    return bool(leaps.size and np.all(is_minute) and np.isfinite(time_of_day(known)).all())


def _of_text(cells: pl.Series) -> tuple[Array, bool, Array]:
    """Seconds of the day (N,), of UTC where a zone is told; whether one is; midnight (N,) s since 1970; NaN if none."""
    parts = cells.str.extract_groups(CLOCK).struct.unnest()
    hours, minutes, seconds = (_floats(parts[str(i)].cast(pl.Float64, strict=False)) for i in (1, 2, 3))
    half, utc, zone = (parts[str(i)] for i in (4, 5, 6))
    afternoon = (half.str.to_lowercase() == "pm").fill_null(value=False).to_numpy()
    hours = np.where(half.is_null().to_numpy(), hours, hours % 12 + 12.0 * afternoon)
    with np.errstate(invalid="ignore"):
        good = (hours < 24.0) & (minutes < 60.0) & (seconds < 61.0)
    zone_seconds = np.where(zone.is_null().to_numpy(), 0.0, _mapped(zone, _offset))
    of_day = np.where(good, np.round(3600.0 * hours + 60.0 * minutes + seconds, 6) - zone_seconds, np.nan)
    dates = _mapped(cells.str.replace(CLOCK, " "), _midnight)
    if not np.isfinite(dates).any() and of_day.size:
        of_day = _running(of_day)
    return of_day, not bool((utc.is_null() & zone.is_null()).all()), dates


def _running(of_day: Array) -> Array:
    """Seconds (N,) of the day that run on over midnight."""
    good = np.isfinite(of_day)
    running = of_day.copy()
    running[good] = over_midnight(of_day[good]) if good.any() else of_day[good]
    return running


def _with_day(moments: Moments, days: Array | None) -> Moments:
    """The same with the date of the first row that has one, where there is any; times of day run on over midnight."""
    if not moments.is_of_day or days is None:
        return moments
    first = np.flatnonzero(np.isfinite(days) & np.isfinite(moments.seconds))
    if not first.size:
        return moments
    midnight = days[first[0]] - DAY * (moments.seconds[first[0]] // DAY)
    return Moments(moments.seconds + midnight, has_date=True, has_zone=moments.has_zone)


def _mapped(cells: pl.Series, value: Callable[[str], float]) -> Array:
    """What `value` (N,) makes of each cell, NaN for empty ones, and for all where there are too many different ones."""
    different = cells.unique().drop_nulls().to_list()
    if not different or len(different) > MOST_DATES:
        return np.full(len(cells), np.nan)
    values = [value(text) for text in different]
    return _floats(cells.replace_strict(different, values, default=None, return_dtype=pl.Float64))


def _offset(zone: str) -> float:
    """Seconds that a zone, as +02:00, is ahead of UTC."""
    return (-1.0 if zone[0] == "-" else 1.0) * (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:]))


def _midnight(text: str) -> float:
    day = day_of(text)
    return float("nan") if day is None else (day.toordinal() - 719_163) * DAY  # of 1 January 1970


def _floats(series: pl.Series) -> Array:
    values = series.fill_null(np.nan).to_numpy()
    return np.where(np.isfinite(values), values, np.nan)
