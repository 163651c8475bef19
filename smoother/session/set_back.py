"""A clock that was set back by an hour while it recorded, as at the end of summer time, or by a day, as times of day
are at midnight: what follows is joined.

A clock that was started again falls back by any time. One that falls by an hour or a day to the second was set, and
where the UTC of the fixes goes on, nothing was between.
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release
from smoother.samples import Problem
from smoother.session.rows import persists
from smoother.units import DAY

FALLS = {  # s, and what is said of it
    3600.0: "its clock was set back by an hour at {:.0f} s",
    DAY: "its times of day start again at midnight, after {:.0f} s",
}
TO_THE_SECOND = 1.0  # s
LONGEST_PAUSE = 10.0  # s by UTC across the fall


def joined_where_set_back(t: Array, prefix: str, file: str, unix_s: Array | None = None) -> tuple[Array, list[Problem]]:
    """Times t (N,) s without falls by an hour or a day, and what to say of them; `t` itself where there are none.

    unix_s (N,) s : UTC of the rows, NaN where unknown. Where it is known on both sides of a fall, it has to go on.
    """
    problems: list[Problem] = []
    for fall, said in FALLS.items():
        if not _falls_by(t, fall):
            continue
        known = np.flatnonzero(np.isfinite(t))
        falls = _falls(t[known], fall, None if unix_s is None else unix_s[known])
        if np.any(falls):
            at = float(t[known[np.flatnonzero(falls)[0] - 1]])
            joined = t.copy()
            joined[known] += fall * np.cumsum(falls)
            t = joined
            text = f"{file}: {said.format(at)}; what follows is joined to what was before"
            problems.append(Problem(f"{prefix}_clock_set_back", text, int(np.count_nonzero(falls))))
    return t, problems


def _falls(t: Array, fall: float, unix_s: Array | None) -> BoolArray:
    """Mask (N,) of the rows at known times t (N,) s before which a clock was set back by `fall` s, for good."""
    step = np.diff(t, prepend=t[:1])
    goes_on = step + fall < TO_THE_SECOND
    if unix_s is not None:
        utc_step = np.diff(unix_s, prepend=unix_s[:1])
        with np.errstate(invalid="ignore"):
            by_utc = (utc_step > 0.0) & (np.abs(step + fall - utc_step) < TO_THE_SECOND)
        goes_on = np.where(np.isfinite(utc_step), by_utc, goes_on)
    falls = (step + fall > -TO_THE_SECOND) & (step + fall < LONGEST_PAUSE) & goes_on
    return np.asarray(falls & persists(t, step < 0.0))


def _falls_by(t: Array, fall: float) -> bool:
    """Whether any step of t (N,) is back by about `fall` s: hardly ever, and then nothing more is looked at."""
    for part in pieces(t.size - 1):
        step = np.diff(t[part.start : part.stop + 1])
        release(t)
        if np.any((step < LONGEST_PAUSE - fall) & (step > -TO_THE_SECOND - fall)):
            return True
    return False
