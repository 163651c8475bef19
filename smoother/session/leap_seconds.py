"""UTC that falls by whole seconds: a receiver that learns on the way how many leap seconds there are.

GPS time has none; the message that tells them comes every 12.5 minutes, and until then a receiver counts none of them,
or as many as its firmware knows. What it says afterwards is right. UTC that leaps forwards is not looked for: rows that
were lost, beside stamps that count on, look alike.
"""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, median
from smoother.samples import GnssFixes, Problem

MOST_LEAP_SECONDS = 20.0  # there are 18 since 2017
WHOLE = 0.1  # s; how near to whole seconds the fall is, by stamps that come now sooner, now later
LONGEST_PAUSE = 2.0  # s across the fall, by the stamps: after a longer one clocks are set in other ways, too
FEWEST_BESIDE, MOST_BESIDE = 5, 25  # fixes on either side, which tell by how much


def with_learnt_leap_seconds(gnss: GnssFixes, file: str, problems: list[Problem]) -> GnssFixes:
    """Return the fixes with UTC from before such a fall moved to that after it; said in `problems`.

    file : name for the sentences. The fixes themselves where UTC falls nowhere.
    """
    assert gnss.unix_s is not None
    unix_s = gnss.unix_s
    for row, fall in _falls(gnss.t, unix_s):
        unix_s = np.where(np.arange(unix_s.size) < row, unix_s - fall, unix_s)
        text = f"its UTC falls by {fall:.0f} s at {gnss.t[row]:.0f} s, as where a receiver learns of leap seconds"
        problems.append(Problem("gps_leap_seconds", f"{file}: {text}; the later is taken, for what was before too"))
    return gnss if unix_s is gnss.unix_s else replace(gnss, unix_s=unix_s)


def _spread(ahead: Array) -> float:
    """How far, s, stamps by UTC mostly are off one clock."""
    return median(np.abs(ahead - median(ahead)))


def _falls(t: Array, unix_s: Array) -> list[tuple[int, float]]:
    """The rows of fixes at t (N,) s before which their UTC (N,) s fell by whole seconds for good, and by how many."""
    known = np.flatnonzero(np.isfinite(unix_s))
    ahead = unix_s[known] - t[known]
    back = (np.diff(unix_s[known]) < 0.0) & (np.diff(t[known]) < LONGEST_PAUSE)
    falls = []
    for first in (np.flatnonzero(back) + 1).tolist():
        before, after = ahead[max(0, first - MOST_BESIDE) : first], ahead[first : first + MOST_BESIDE]
        fall = median(before) - median(after)
        is_whole = abs(fall - round(fall)) < WHOLE and 1 <= round(fall) <= MOST_LEAP_SECONDS
        are_steady = all(side.size >= FEWEST_BESIDE and _spread(side) < WHOLE for side in (before, after))
        if is_whole and are_steady:
            falls.append((int(known[first]), float(round(fall))))
    return falls
