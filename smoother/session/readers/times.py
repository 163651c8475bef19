"""When the rows of another program's table were taken: from whatever its cells say of it.

Cells are numbers (seconds or parts of one, since the start or since 1970; days of a spreadsheet; digits of a clock,
HHMMSS), times of day, or moments with a date; or a table has a column for each of year .. second. A table often has
several such columns; the finest is the clock of the rows.
"""

import datetime as dt
import re
import unicodedata
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.samples import Problem
from smoother.session.readers.cells import floats, numbers_of
from smoother.session.rows import LATEST, over_midnight
from smoother.units import DAY

_BEGINNINGS = (  # of months, without accents
    "jan gen ene", "feb fev", "mar mrz", "apr avr abr", "may mai mag", "jun juin giu", "jul juil lug",
    "aug ago aou", "sep set", "oct okt ott out", "nov", "dec dez dic",
)  # fmt: skip
MONTHS = {word: number for number, words in enumerate(_BEGINNINGS, 1) for word in words.split()}
_DAY = r"\b(?P<day>\d{1,2})(?:st|nd|rd|th|er|o)?"
_MONTH, _YEAR = r"(?P<month>[a-z]{3,})\.?", r"(?P<year>\d{4}|\d{2})\b"
_NAMED = (  # 16 May 2026, 16-MAY-26, 16. Mai 2026, 16 de mayo de 2026; May 16, 2026
    re.compile(rf"{_DAY}\.?[\s/-]*(?:de |di )?\s*{_MONTH},?[\s/-]*(?:de |del )?\s*{_YEAR}"),
    re.compile(rf"\b{_MONTH}\s+(?P<day>\d{{1,2}})(?:st|nd|rd|th)?,?\s+{_YEAR}"),
)
_YEAR_FIRST = re.compile(r"\b(\d{4})[-/. ](\d{1,2})[-/. ](\d{1,2})\b")
_YEAR_LAST = re.compile(r"\b(\d{1,2})([-/.])(\d{1,2})\2(\d{4}|\d{2})\b")
_DIGITS = re.compile(r"^\D*(\d{8}|\d{6})(?:\.0*)?\D*$")
OLDEST_YEAR, CENTURY_FROM = 1990, 80  # of a date that is one: GPS is little older
ZONES = {  # hours ahead of UTC; of names that several zones share, none
    **dict.fromkeys(("z", "utc", "gmt", "wet", "ut"), 0.0),
    **dict.fromkeys(("cet", "mez", "bst", "west", "wesz", "hec"), 1.0),
    **dict.fromkeys(("cest", "mesz", "eet", "oez", "hece", "sast"), 2.0),
    **dict.fromkeys(("eest", "oesz", "msk"), 3.0),
    **{"nst": -3.5, "ndt": -2.5, "ast": -4.0, "adt": -3.0, "est": -5.0, "edt": -4.0, "cst": -6.0, "cdt": -5.0},
    **{"mst": -7.0, "mdt": -6.0, "pst": -8.0, "pdt": -7.0, "akst": -9.0, "akdt": -8.0, "hst": -10.0},
    **{"brt": -3.0, "art": -3.0, "jst": 9.0, "kst": 9.0, "awst": 8.0, "acst": 9.5, "acdt": 10.5},
    **{"aest": 10.0, "aedt": 11.0, "nzst": 12.0, "nzdt": 13.0},
}
_OFFSET = re.compile(r"(?i)^(?:utc|gmt|z)?\s*([+-])(\d{1,2}):?(\d{2})?$")


def day_of(text: str) -> dt.date | None:
    """The day of a date in words or in numbers, None where the order of day and month is ambiguous."""
    text = "".join(c for c in unicodedata.normalize("NFKD", text.lower()) if not unicodedata.combining(c))
    for pattern in _NAMED:
        for match in pattern.finditer(text):
            month = MONTHS.get(match["month"][:4], MONTHS.get(match["month"][:3]))
            if month is not None:
                return _date(_year(match["year"]), month, int(match["day"]))
    if iso := _YEAR_FIRST.search(text):
        return _date(int(iso[1]), int(iso[2]), int(iso[3]))
    for candidates in _readings(text):
        days = {day for candidate in candidates if (day := _date(*candidate)) is not None}
        if days:
            return days.pop() if len(days) == 1 else None
    return None


def _readings(text: str) -> Iterator[list[tuple[int, int, int]]]:
    """What numbers may mean, year, month and day; the likelier first."""
    if numbers := _YEAR_LAST.search(text):
        first, second, year = int(numbers[1]), int(numbers[3]), _year(numbers[4])
        yield [(year, second, first), *([] if numbers[2] == "." else [(year, first, second)])]
        if len(numbers[4]) == 2:
            yield [(_year(numbers[1]), second, int(numbers[4]))]
    elif digits := _DIGITS.match(text):
        a, b, c = digits[1][:-4], digits[1][-4:-2], digits[1][-2:]
        readings = [(_year(a), int(b), int(c))]
        if len(digits[1]) == 6:
            readings.append((_year(c), int(b), int(a)))
        else:
            readings.append((int(digits[1][4:]), int(digits[1][2:4]), int(digits[1][:2])))
        yield readings


def _year(digits: str) -> int:
    year = int(digits)
    return year if len(digits) > 2 else year + (1900 if year >= CENTURY_FROM else 2000)


def _date(year: int, month: int, day: int) -> dt.date | None:
    try:
        return dt.date(year, month, day) if OLDEST_YEAR <= year < 2100 else None
    except ValueError:
        return None


def zone_offset(zone: str) -> float | None:
    """Seconds that a zone is ahead of UTC, by its name, as CEST, or its offset, as +02:00 or UTC+2; None if unknown."""
    zone = zone.strip().lower()
    if (match := _OFFSET.match(zone)) is not None:
        return (-1.0 if match[1] == "-" else 1.0) * (3600.0 * int(match[2]) + 60.0 * int(match[3] or 0))
    return None if zone not in ZONES else 3600.0 * ZONES[zone]


CLOCK = (  # hours, minutes, seconds, half of the day, zone
    r"(?i)(?:^|[^\d:])(\d{1,2}) ?[:h] ?(\d{2}) ?[:m] ?(\d{2}(?:[.,:]\d+)?)s?\s*([ap]\.?m\b\.?)?"
    r"\s*((?:utc|gmt|z)?\s?[+-]\d{1,2}:?\d{2}\b|(?:utc|gmt)[+-]\d{1,2}\b|\(?[a-z]{1,5}\)?(?:$|[\s,]))?"
)
BASIC_CLOCK = r"(?i)\b(\d{8})[t ](\d{2})(\d{2})(\d{2})"  # of ISO 8601, YYYYMMDDTHHMMSS
UNIX = "unix"  # unit of seconds since 1970, for certain
SHORT_CLOCK = r"^\s*(\d{1,3}):(\d{2}[.,]\d+)\s*$"  # minutes and seconds
PARTS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "μs": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "d": DAY}  # s
PARTS |= {"sec": 1.0, "seconds": 1.0, "secs": 1.0, "second": 1.0, "unix time": 1.0, "msec": 1e-3, "millis": 1e-3}
PARTS |= {"milliseconds": 1e-3, "microseconds": 1e-6, "nanoseconds": 1e-9, "minutes": 60.0, "hours": 3600.0}
PARTS |= {"days": DAY}
EARLIEST_UNIX, LATEST_UNIX = 631152000.0, 4102444800.0  # s; 1990 and 2100
SPREADSHEET_EPOCH = 25_569.0  # days from 30 December 1899 to 1970
SLOWEST = 30.0  # s between rows; a kart is somewhere else by then
FASTEST = 1e-3  # s; of a spreadsheet's days, what is finer is no time between rows
DIGITS_LEAP = 40.0  # of HHMMSS, from 59 s to the next minute
MOSTLY = 0.5  # of the cells that are there
FEWEST_SECONDS, MOSTLY_EVEN = 8, 0.9  # to know how many rows a second has; share that has as many
MOST_DATES = 1000  # different ones in one column; more are no dates
DATE_PARTS, CLOCK_PARTS = ("year", "month", "day"), ("hour", "minute", "second")


@dataclass(frozen=True, eq=False)
class Moments:
    """One column: seconds (N,), NaN where unknown. Since 1970 where `has_date`, else of the day where `is_of_day`, else
    since any moment. `unit` of a number of the last kind, "" if unknown. `has_zone` where UTC is known.
    """

    seconds: Array
    has_date: bool = False
    is_of_day: bool = False
    unit: str = "s"
    has_zone: bool = True

    @property
    def falls(self) -> int:
        """How many times are before the one above."""
        return int(np.count_nonzero(np.diff(self.seconds[np.isfinite(self.seconds)]) < 0.0))

    @property
    def fineness(self) -> int:
        """How many different times there are."""
        return int(np.unique(self.seconds[np.isfinite(self.seconds)]).size)


def read_moments(cells: pl.Series, unit: str) -> Moments | None:
    """Return the times in a column of text, None without any. unit : of its numbers, "" if not known,
    or the zone of its times of day.
    """
    numbers = numbers_of(cells).values
    filled = int(np.count_nonzero((cells.str.len_chars() > 0).fill_null(value=False).to_numpy()))
    if filled and np.count_nonzero(np.isfinite(numbers)) > MOSTLY * filled:
        return moments_of_numbers(numbers, unit)
    of_day, zone_known, dates = _of_text(cells)
    if not filled or np.count_nonzero(np.isfinite(of_day)) <= MOSTLY * filled:
        return _elapsed(cells, filled)
    if (ahead := zone_offset(unit)) is not None and not zone_known:
        of_day, zone_known = of_day - ahead, True
    if np.count_nonzero(np.isfinite(dates)) > MOSTLY * filled:
        return Moments(dates + of_day, has_date=True, has_zone=zone_known)
    return Moments(of_day, is_of_day=True, has_zone=zone_known)


def _elapsed(cells: pl.Series, filled: int) -> Moments | None:
    """Minutes and seconds since the start."""
    parts = cells.str.replace(",", ".", literal=True).str.extract_groups(SHORT_CLOCK).struct.unnest()
    minutes, seconds = (floats(parts[str(i)].cast(pl.Float64, strict=False)) for i in (1, 2))
    t = 60.0 * minutes + seconds
    return Moments(t) if filled and np.count_nonzero(np.isfinite(t)) > MOSTLY * filled else None


def read_days(cells: pl.Series) -> Array:
    """Midnight (N,), s since 1970, of the days in a column of text, NaN without one."""
    days = _of_text(cells)[2]
    if np.isfinite(days).any():
        return days
    numbers = numbers_of(cells).values  # of a spreadsheet
    unix = (np.floor(numbers) - SPREADSHEET_EPOCH) * DAY
    with np.errstate(invalid="ignore"):
        return np.where((unix >= EARLIEST_UNIX) & (unix <= LATEST_UNIX), unix, np.nan)


def days_of_parts(parts: Mapping[str, Array]) -> Array | None:
    """Midnight (N,), s since 1970, by columns (N,) of year, month and day; None without one of them."""
    if any(name not in parts for name in DATE_PARTS):
        return None
    year, month, day = (parts[name] for name in DATE_PARTS)
    year = np.where(year < 100.0, year + 2000.0, year)
    with np.errstate(invalid="ignore"):
        good = (year >= 1990) & (year < 2100) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    months = np.where(good, (year - 1970) * 12 + month - 1, 0).astype(np.int64)
    midnight = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + np.where(good, day, 1) - 1
    return np.where(good, midnight * DAY, np.nan)


def moments_of_parts(parts: Mapping[str, Array]) -> Moments | None:
    """Times of the day by columns (N,) of hour, minute and second; None without one of them."""
    if any(name not in parts for name in CLOCK_PARTS):
        return None
    hour, minute, second = (parts[name] for name in CLOCK_PARTS)
    of_day = np.round(3600.0 * hour + 60.0 * minute + second, 6)
    if (fraction := parts.get("millisecond")) is not None and np.nanmax(np.abs(second % 1.0), initial=0.0) == 0.0:
        of_day = np.round(of_day + 1e-3 * fraction, 6)
    return Moments(running(of_day), is_of_day=True, has_zone=False)


def with_fractions(columns: Sequence[Moments], milliseconds: Array | None) -> list[Moments]:
    """The columns, those of whole seconds with the milliseconds (N,) that stand in a column of their own."""
    if milliseconds is None:
        return list(columns)
    known = milliseconds[np.isfinite(milliseconds)]
    if not known.size or np.min(known) < 0.0 or np.max(known) >= 1000.0:
        return list(columns)
    return [
        replace(m, seconds=np.round(m.seconds + 1e-3 * milliseconds, 6))
        if (m.has_date or m.is_of_day) and np.nanmax(np.abs(m.seconds % 1.0), initial=0.0) == 0.0
        else m
        for m in columns
    ]


def spread_evenly(seconds: Array) -> tuple[Array, int]:
    """Times (N,) s without fractions, of which most are shared by as many rows, with even fractions; and how many.

    The first second is one that had begun. As they are, and 1, where they have fractions or no row shares them.
    """
    known = np.flatnonzero(np.isfinite(seconds))
    t = seconds[known]
    if t.size < 2 or np.any(t != np.floor(t)):
        return seconds, 1
    new = np.append(True, np.diff(t) != 0.0)
    first, group = np.flatnonzero(new), np.cumsum(new) - 1
    size = np.diff(np.append(first, t.size))
    usual = int(np.median(size))
    if size.size < FEWEST_SECONDS or usual < 2 or np.mean(np.abs(size[1:-1] - usual) <= 1) < MOSTLY_EVEN:
        return seconds, 1
    place = np.arange(t.size) - first[group] + np.where(group == 0, max(usual - int(size[0]), 0), 0)
    spread = seconds.copy()
    spread[known] = t + place / np.maximum(size, usual)[group]
    return spread, usual


def put_together(columns: Sequence[Moments], days: Array | None) -> tuple[Moments, Moments | None]:
    """The clock of the rows, the finest of `columns`, one or more; and UTC, from whichever has the date.

    days (N,) : midnight of each row's day, s since 1970, for times of day.
    """
    dated = [_with_day(moments, days) for moments in columns]
    clock = max(dated, key=lambda moments: moments.fineness - moments.falls)  # of as fine ones the first
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
    """Report that a file does not give the zone of its times."""
    return Problem("gps_date_assumed", f"{file}: its times of day have no zone; taken as UTC")


def moments_of_numbers(numbers: Array, unit: str) -> Moments:
    """Times by numbers (N,) : in their unit where it is known, else of whichever kind explains them."""
    finest = 1.0 if unit == UNIX else PARTS.get(unit, min(PARTS.values()))
    numbers = np.where(np.abs(numbers) * finest < LATEST, numbers, np.nan)  # what no clock shows is damaged
    if unit == UNIX:
        return Moments(numbers, has_date=True)
    known = numbers[np.isfinite(numbers)]
    steps = np.diff(known)
    step = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else np.inf
    middle = float(np.median(known)) if known.size else np.nan
    for part in (PARTS[unit],) if unit in PARTS else (1.0, 1e-3, 1e-6, 1e-9):
        if EARLIEST_UNIX <= middle * part <= LATEST_UNIX and step * part < SLOWEST:
            return Moments(numbers * part, has_date=True)
    if unit in PARTS and unit != "d":
        return Moments(numbers * PARTS[unit])
    if FASTEST < step * DAY < SLOWEST and EARLIEST_UNIX <= (middle - SPREADSHEET_EPOCH) * DAY <= LATEST_UNIX:
        unix = (numbers - SPREADSHEET_EPOCH) * DAY
        return Moments(np.round(unix, 3), has_date=True, has_zone=False)
    if FASTEST < step * DAY < SLOWEST and np.all((known >= 0.0) & (known < 1.0)) and known.size > 2:
        return Moments(running(np.round(numbers * DAY, 3)), is_of_day=True, has_zone=False)
    if _are_digits(known):
        return Moments(running(time_of_day(numbers)), is_of_day=True, has_zone=False)
    return Moments(numbers, unit="")


def _are_digits(known: Array) -> bool:
    """Whether times (N,) are digits of a clock, HHMMSS: at the end of each minute they leap by 40, and never before."""
    leaps = np.diff(known)[np.diff(known // 100) > 0.0] % 100.0
    is_minute = (leaps >= DIGITS_LEAP) & (leaps < DIGITS_LEAP + SLOWEST)
    return bool(leaps.size and np.all(is_minute) and np.isfinite(time_of_day(known)).all())


def _of_text(cells: pl.Series) -> tuple[Array, bool, Array]:
    """Seconds of the day (N,), of UTC where a zone is given; whether one is; midnight (N,) s since 1970; NaN if
    none."""
    cells = cells.str.replace(BASIC_CLOCK, "${1} ${2}:${3}:${4}")
    parts = cells.str.extract_groups(CLOCK).struct.unnest()
    hours, minutes = (floats(parts[str(i)].cast(pl.Float64, strict=False)) for i in (1, 2))
    seconds = floats(parts["3"].str.replace("[,:]", ".").cast(pl.Float64, strict=False))
    half, zone = (parts[str(i)].str.strip_chars(" ,()") for i in (4, 5))
    afternoon = half.str.to_lowercase().str.starts_with("p").fill_null(value=False).to_numpy()
    hours = np.where(half.is_null().to_numpy(), hours, hours % 12 + 12.0 * afternoon)
    with np.errstate(invalid="ignore"):
        good = (hours < 24.0) & (minutes < 60.0) & (seconds < 61.0)
    ahead = _mapped(zone, lambda text: float("nan") if (offset := zone_offset(text)) is None else offset)
    known_zone = bool(np.isfinite(ahead).any())
    of_day = np.where(good, np.round(3600.0 * hours + 60.0 * minutes + seconds, 6), np.nan) - np.nan_to_num(ahead)
    dates = _mapped(cells.str.replace(CLOCK, " "), _midnight)
    if not np.isfinite(dates).any() and of_day.size:
        of_day = running(of_day)
    return of_day, known_zone, dates


def running(of_day: Array) -> Array:
    """Seconds (N,) of the day that run on over midnight."""
    good = np.isfinite(of_day)
    run = of_day.copy()
    run[good] = over_midnight(of_day[good]) if good.any() else of_day[good]
    return run


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
    return floats(cells.replace_strict(different, values, default=None, return_dtype=pl.Float64))


def _midnight(text: str) -> float:
    day = day_of(text)
    return float("nan") if day is None else (day.toordinal() - 719_163) * DAY  # of 1 January 1970
