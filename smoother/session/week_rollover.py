"""Dates that are 1024 weeks back: GPS sends its week as ten bits, and the firmware of old receivers guesses the rest.

Such a receiver has the time of day right and the year wrong by 19.6. (Twice that is not looked for: a receiver that
knows no week yet begins in that of 1980.)
"""

import datetime as dt
from dataclasses import replace

import numpy as np

from smoother.arrays import median
from smoother.samples import GnssFixes, Problem
from smoother.units import DAY

ROLLOVER = 1024.0 * 7.0 * DAY  # s
OLD = 1262304000.0  # s since 1970, the year 2010: recordings before it are rarer than receivers that lost count
EARLIEST = 1420070400.0  # s since 1970, the year 2015: an older recording of an even older receiver is as likely real
AHEAD = 366.0 * DAY  # s by which the clock of the machine that reads may be behind
SAME_DAY = 2.0 * DAY  # s from its noon; a date that a person states may be of another zone of time


def with_present_dates(
    gnss: GnssFixes, file: str, now: float, stated: str | None, problems: list[Problem]
) -> GnssFixes:
    """Return the fixes with dates before 2010 put on by 1024 weeks, where that is plausible; said in `problems`.

    now : s since 1970, which no recording is much later than. stated : the date of the settings (ISO 8601), which
    decides where it agrees with one of the two.
    """
    assert gnss.unix_s is not None
    with np.errstate(invalid="ignore"):
        old = gnss.unix_s < OLD
    if not old.any():
        return gnss
    written = median(gnss.unix_s[old])
    day = _unix(stated)
    if day is not None and abs(written - day) < SAME_DAY:
        return gnss
    count = int(np.count_nonzero(old))
    if not _is_rolled_over(written, now, day):
        text = f"{file}: its dates ({_date(written)}) are before 2010; is the receiver's firmware too old?"
        problems.append(Problem("gps_date_old", f"{text} State `date` in session.toml", count))
        return gnss
    text = (
        f"{file}: its dates ({_date(written)}) are 1024 weeks back, as firmware has them that is too old for its "
        f"week numbers; taken as {_date(written + ROLLOVER)}. If they are right, state `date` in session.toml"
    )
    problems.append(Problem("gps_week_rollover", text, count))
    return replace(gnss, unix_s=np.where(old, gnss.unix_s + ROLLOVER, gnss.unix_s))


def _is_rolled_over(written: float, now: float, day: float | None) -> bool:
    """Whether a date of fixes, s since 1970, is a plausible one with 1024 weeks more.

    day : the one that a person stated, which decides where it agrees.
    """
    present = written + ROLLOVER
    return EARLIEST <= present <= now + AHEAD or (day is not None and abs(present - day) < SAME_DAY)


def _unix(date: str | None) -> float | None:
    """Noon of a date (ISO 8601), s since 1970; None where there is none that can be read."""
    try:
        day = None if date is None else dt.date.fromisoformat(date)
    except ValueError:
        return None
    return None if day is None else (day - dt.date(1970, 1, 1)).days * DAY + 0.5 * DAY


def _date(unix: float) -> str:
    return (dt.date(1970, 1, 1) + dt.timedelta(days=unix // DAY)).isoformat()
