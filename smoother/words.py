"""Counts and lengths of time as people read them, the same on the terminal, on pages and in problems. Imports nothing
of this project."""

import re


def counted(count: int, noun: str) -> str:
    """Return '1 row' or '2 rows', '2 fixes'."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}{'es' if noun.endswith('x') else 's'}"


def duration(seconds: float) -> str:
    """Return 9 min 43 s, or 1 h 2 min for long ones."""
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def repeated(text: str, count: int) -> str:
    """Return what was met `count` times, saying so unless the text does."""
    return text if count == 1 or re.search(rf"(?<![\d.]){count}(?![\d.]*\d)", text) else f"{text} ({count} times)"
