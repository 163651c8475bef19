"""Lap times and times of day as text."""

import datetime as dt
import math
from collections.abc import Iterable


def lap_clock(seconds: float | None, digits: int = 3, unknown: str = "-") -> str:
    """Return 1:02.345, 58.648 below a minute, 1:00:52.892 from an hour on; `unknown` where there is no time."""
    if seconds is None or not math.isfinite(seconds):
        return unknown
    minutes, rest = divmod(round(seconds, digits), 60.0)
    if not minutes:
        return f"{rest:.{digits}f}"
    hours, minutes = divmod(minutes, 60.0)
    whole = f"{int(hours)}:{int(minutes):02d}" if hours else f"{int(minutes)}"
    return f"{whole}:{rest:0{digits + 3}.{digits}f}"


def spread_text(spread: float | None, unknown: str = "-") -> str:
    """Return the spread of lap times as text, 0.123 s, or `within the timing noise`."""
    if spread is None or not math.isfinite(spread):
        return unknown
    if spread == 0.0:
        return "within the timing noise"
    return f"{spread:.3f} s" if spread >= 0.0005 else "below 0.001 s"


def chance_text(theoretical: float, raw: float, best: float) -> str:
    """Return the sum of the best sectors (raw, s) as text, and its bias by chance; `best`: the time of the best lap."""
    added = f"best sectors add up to {lap_clock(raw)}"
    if theoretical > best - 0.0005:
        return f"{added}: faster than the best lap by chance only"
    excess = round(theoretical, 3) - round(raw, 3)  # of the displayed times
    return f"{added}, which is {excess:.3f} s too fast by chance"


def local_time(unix: float) -> str:
    """Return the time of day in the time zone of this machine, 14:03:21; see :func:`local_zone`."""
    return _local(unix).strftime("%H:%M:%S")


def local_day(unix: float, with_zone: bool = True) -> str:
    """Return the day and time of day in the time zone of this machine, with its name: 2024-05-01 14:03 CEST."""
    return _local(unix).strftime("%Y-%m-%d %H:%M %Z" if with_zone else "%Y-%m-%d %H:%M")


def local_zone(moments: Iterable[float]) -> str:
    """Return the zone of times of day of this machine, CEST; CEST/CET where the clock was changed between them."""
    return "/".join(dict.fromkeys(_local(unix).strftime("%Z") for unix in moments))


def _local(unix: float) -> dt.datetime:
    return dt.datetime.fromtimestamp(round(unix, 3), dt.UTC).astimezone()  # else noon may be 11:59:59
