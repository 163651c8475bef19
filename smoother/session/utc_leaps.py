"""Where UTC and the stamps of fixes leapt against one another for good: one of the two clocks was set.

A fix whose own step in UTC is odd, and in stamps is not, tells that it was UTC; the other way round it was the stamps.
In a gap either may have been.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from smoother.arrays import Array, median

LEAST, BESIDE = 0.25, 15  # s by which a clock was set, and fixes on either side that tell by how much
STEADY = 0.1  # of the leap, that delays on either side may scatter by
SEEN = 2.0  # s from one fix to the next, in which it shows which of the two it was


@dataclass(frozen=True)
class Leap:
    """From fix `row` on, UTC is ahead of the stamps by `by` s more than before; set: which clock that was."""

    row: int
    by: float
    set: Literal["utc", "stamps", "either"]


def leaps(t: Array, unix_s: Array) -> Iterator[Leap]:
    """Find the leaps between stamps t (N,) s, increasing, and UTC unix_s (N,) s."""
    ahead, usual = unix_s - t, median(np.diff(unix_s))
    for row in (np.flatnonzero(np.abs(np.diff(ahead)) > LEAST) + 1).tolist():
        before, after = ahead[max(0, row - BESIDE) : row], ahead[row : row + BESIDE]
        by = median(after) - median(before)
        steady = max(median(np.abs(side - median(side))) for side in (before, after))
        if min(before.size, after.size) < BESIDE or abs(by) < LEAST or steady > STEADY * abs(by):
            continue
        in_stamps, in_utc = float(t[row] - t[row - 1]), float(unix_s[row] - unix_s[row - 1])
        if min(in_stamps, in_utc) > SEEN:
            yield Leap(row, by, "either")
        elif abs(in_utc - usual) > abs(in_stamps - usual):
            exact = in_utc - usual * max(1, round(in_stamps / usual))  # fixes are evenly apart, stamps come as they may
            yield Leap(row, exact if abs(exact - by) < STEADY * abs(by) else by, "utc")
        else:
            yield Leap(row, by, "stamps")


def without_leaps(t: Array, unix_s: Array) -> Array:
    """Return UTC (N,) s that goes on as it began where it was set; stamps that were set stay for UTC to tell."""
    level = np.array(unix_s)
    for leap in leaps(t, unix_s):
        if leap.set == "utc":
            level[leap.row :] -= leap.by
    return level
