"""Numbers and times as the report says them; a dash where something is unknown."""

import math

from smoother.laps import clock

DASH = "–"


def lap_clock(seconds: float, digits: int = 3) -> str:
    """Return 1:02.345, or 58.648 below a minute."""
    return clock.lap_clock(seconds, digits, DASH)


def number(value: float, digits: int = 2, signed: bool = False) -> str:
    """Return a number without a negative zero."""
    if not math.isfinite(value):
        return DASH
    return f"{round(value, digits) + 0.0:{'+' if signed else ''}.{digits}f}"


def with_sigma(value: float, sigma: float, digits: int, signed: bool = False) -> str:
    """Return value ± sigma, or the value alone."""
    text = number(value, digits, signed)
    return text if text == DASH or not (math.isfinite(sigma) and sigma > 0.0) else f"{text} ± {number(sigma, digits)}"
