"""Dates as programs write them: in words of five languages or in numbers, where they can be read one way only; zones.

Months are told by their first letters, which English, German, French, Italian and Spanish share or have for themselves.
"""

import datetime as dt
import re
import unicodedata
from collections.abc import Iterator

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
    """The day of a date in words or in numbers, None where the order of day and month is anybody's guess."""
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
