"""Dates as programs write them: in English words or in numbers, where they can be read one way only."""

import datetime as dt
import re

MONTHS = ("jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec")
NAMED_DATE = (  # April 11, 2026; 11 April 2026; 11-Apr-2026
    re.compile(r"\b(?P<month>[a-z]{3})[a-z]*\.?\s+(?P<day>\d{1,2}),?\s+(?P<year>\d{4})\b"),
    re.compile(r"\b(?P<day>\d{1,2})\.?[\s-]+(?P<month>[a-z]{3})[a-z]*\.?,?[\s-]+(?P<year>\d{4})\b"),
)
YEAR_FIRST = re.compile(r"\b(\d{4})[-/.](\d{1,2})[-/.](\d{1,2})\b")
YEAR_LAST = re.compile(r"\b(\d{1,2})([-/.])(\d{1,2})\2(\d{4})\b")
OLDEST_YEAR = 1990  # of a date that is one: GPS is little older


def day_of(text: str) -> dt.date | None:
    """The day of a date in English words or in numbers, None where the order of day and month is anybody's guess."""
    text = text.lower()
    for pattern in NAMED_DATE:
        for match in pattern.finditer(text):
            if match["month"] in MONTHS:
                return _date(int(match["year"]), MONTHS.index(match["month"]) + 1, int(match["day"]))
    if iso := YEAR_FIRST.search(text):
        return _date(int(iso[1]), int(iso[2]), int(iso[3]))
    if numbers := YEAR_LAST.search(text):
        first, second, year = int(numbers[1]), int(numbers[3]), int(numbers[4])
        days = {_date(year, second, first), *([] if numbers[2] == "." else [_date(year, first, second)])} - {None}
        return days.pop() if len(days) == 1 else None
    return None


def _date(year: int, month: int, day: int) -> dt.date | None:
    try:
        return dt.date(year, month, day) if year >= OLDEST_YEAR else None
    except ValueError:
        return None
