"""Numbers and times as the report says them; a dash where something is unknown."""

import datetime as dt
import math

DASH = "–"


def lap_clock(seconds: float, digits: int = 3) -> str:
    """Return 1:02.345, or 58.648 below a minute."""
    if not math.isfinite(seconds):
        return DASH
    minutes, rest = divmod(round(seconds, digits), 60.0)
    return f"{int(minutes)}:{rest:0{digits + 3}.{digits}f}" if minutes else f"{rest:.{digits}f}"


def number(value: float, digits: int = 2, signed: bool = False) -> str:
    """Return a number without a negative zero."""
    if not math.isfinite(value):
        return DASH
    return f"{round(value, digits) + 0.0:{'+' if signed else ''}.{digits}f}"


def with_sigma(value: float, sigma: float, digits: int, signed: bool = False) -> str:
    """Return value ± sigma, or the value alone."""
    text = number(value, digits, signed)
    return text if text == DASH or not (math.isfinite(sigma) and sigma > 0.0) else f"{text} ± {number(sigma, digits)}"


def counted(count: int, word: str) -> str:
    """Return 1 lap, 2 laps."""
    return f"{count} {word}" + ("" if count == 1 else "s")


def local_time(unix: float) -> str:
    """Return the time of day as the clock of this machine would have shown it, 14:03:21."""
    return dt.datetime.fromtimestamp(unix, dt.UTC).astimezone().strftime("%H:%M:%S")


def local_day(unix: float) -> str:
    """Return the day and time of day as this machine would have shown them, 2024-05-01 14:03."""
    return dt.datetime.fromtimestamp(unix, dt.UTC).astimezone().strftime("%Y-%m-%d %H:%M")
