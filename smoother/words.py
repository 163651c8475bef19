"""Counts and lengths of time as people read them, the same on the terminal, on pages and in problems. Imports nothing
of this project."""

import difflib
import math
import re
from collections.abc import Iterable, Sequence

UNREADABLE = "\ufffd"  # what a decoder leaves of bytes that are no character
SLOWER_WHERE = {"entry": "into it", "minimum": "at its slowest", "exit": "out of it"}  # of a corner
MOST_DIGITS = 7  # behind the point; a sigma below a millionth is that of something exact


def counted(count: int, noun: str) -> str:
    """Return '1 row' or '2 rows', '2 fixes'."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}{'es' if noun.endswith('x') else 's'}"


def listed(names: Sequence[str], most: int = 12, longest: int = 24) -> str:
    """Return names out of a file with commas between, the first and the beginnings of long ones, fit to be shown."""
    shown = ("".join(c if c.isprintable() and c != UNREADABLE else "?" for c in name) for name in names[:most])
    parts = [name if len(name) <= longest else name[: longest - 2] + ".." for name in shown]
    return ", ".join([*parts, ".."] if len(names) > most else parts)


def did_you_mean(word: str, known: Iterable[str], cutoff: float = 0.5) -> str:
    """Return ' (did you mean bias?)' with the known word that is most like one that is none of them; '' without any."""
    by_lower = {name.lower(): name for name in known}
    close = difflib.get_close_matches(word.lower(), by_lower, n=1, cutoff=cutoff)
    return f" (did you mean {by_lower[close[0]]}?)" if close else ""


def duration(seconds: float) -> str:
    """Return 9 min 43 s, or 1 h 2 min for long ones."""
    minutes, rest = divmod(round(seconds), 60)
    if minutes >= 60:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def span(seconds: float) -> str:
    """Return 0.15 s or 5.2 s, and a :func:`duration` from 100 s on."""
    return f"{seconds:.3g} s" if seconds < 99.95 else duration(seconds)


def repeated(text: str, count: int) -> str:
    """Return what was met `count` times, saying so unless the text does."""
    return text if count == 1 or re.search(rf"(?<![\d.]){count}(?![\d.]*\d)", text) else f"{text} ({count} times)"


def sigma_digits(sigma: float) -> int | None:
    """Return how many digits behind the point show two of `sigma` that count; None where it is unknown or zero."""
    if not (sigma > 0.0 and math.isfinite(sigma)):
        return None
    return min(max(0, 1 - math.floor(math.log10(sigma))), MOST_DIGITS)


def speed_digits(sigma: float) -> int:
    """Return how many digits tell the sigma of a speed, in the unit it is shown in: one, or two where that is 0.0."""
    return 1 if sigma >= 0.05 else 2


def loss_digits(sigma: float) -> int:
    """Return how many digits behind the point a lost time s is shown with: two, or those that its sigma needs."""
    return max(2, (sigma_digits(sigma) or 0) - 1)


def measured(values: Sequence[float], sigmas: Sequence[float], digits: int) -> tuple[str, str]:
    """Return values, and their sigmas, each list with commas between; each sigma says how many digits both have.

    digits behind the point where a sigma is unknown. No sigmas: the second text is empty.
    """
    places = [sigma_digits(sigma) for sigma in sigmas] if sigmas else [None] * len(values)
    known = [digits if place is None else place for place in places]
    shown = [f"{round(value, place) + 0.0:.{place}f}" for value, place in zip(values, known, strict=True)]
    return ", ".join(shown), ", ".join(f"{sigma:.{place}f}" for sigma, place in zip(sigmas, known, strict=False))
