"""A clock that was set back by an hour while it recorded, as at the end of summer time: what follows is joined.

A clock that was started again falls back by any time. One that falls by an hour to the second was set, and where the
UTC of the fixes goes on, nothing was between.
"""

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces, release
from smoother.samples import Problem
from smoother.session.rows import persists

HOUR = 3600.0  # s
TO_THE_SECOND = 1.0  # s
LONGEST_PAUSE = 10.0  # s by UTC across the fall


def joined_by_the_hour(t: Array, prefix: str, file: str, unix_s: Array | None = None) -> tuple[Array, list[Problem]]:
    """Times t (N,) s without falls by an hour, and what to say of them; `t` itself where there are none.

    unix_s (N,) s : UTC of the rows, NaN where unknown. Where it is known on both sides of a fall, it has to go on.
    """
    if not _falls_by_an_hour(t):
        return t, []
    known = np.flatnonzero(np.isfinite(t))
    step = np.diff(t[known], prepend=t[known[:1]])
    falls = (step + HOUR > -TO_THE_SECOND) & (step + HOUR < LONGEST_PAUSE) & persists(t[known], step < 0.0)
    if unix_s is None:
        falls &= step + HOUR < TO_THE_SECOND
    else:
        utc_step = np.diff(unix_s[known], prepend=unix_s[known[:1]])
        with np.errstate(invalid="ignore"):
            goes_on = (utc_step > 0.0) & (np.abs(step + HOUR - utc_step) < TO_THE_SECOND)
        falls &= np.where(np.isfinite(utc_step), goes_on, step + HOUR < TO_THE_SECOND)
    if not np.any(falls):
        return t, []
    joined = t.copy()
    joined[known] += HOUR * np.cumsum(falls)
    at = float(t[known[np.flatnonzero(falls)[0] - 1]])
    text = f"{file}: its clock was set back by an hour at {at:.0f} s; what follows is joined to what was before"
    return joined, [Problem(f"{prefix}_clock_set_back", text, int(np.count_nonzero(falls)))]


def _falls_by_an_hour(t: Array) -> bool:
    """Whether any step of t (N,) is back by about an hour: hardly ever, and then nothing more is looked at."""
    for part in pieces(t.size - 1):
        step = np.diff(t[part.start : part.stop + 1])
        release(t)
        if np.any((step < LONGEST_PAUSE - HOUR) & (step > -TO_THE_SECOND - HOUR)):
            return True
    return False
