"""Where the keyframes are: equally spaced, and where the receiver felt its velocities, if that is equally spaced too.

Between two keyframes the path is a cubic, which misses a part of the motion that goes with the slope of its velocity:
read at an odd place in every interval, it looks like a latency, 1 ms of it in a kart. At the ends nothing is missed,
and nothing need be assumed of what the noise of the samples did in between.
"""

import math

import numpy as np

from smoother.arrays import Array

MOST_DRIFT = 2e-3  # of an interval, by which the fixes' may differ; more is another rate
ALIKE = 0.5  # least length of the mean phase, of 1, of fixes that fall at the same place in their intervals


def keyframe_times(start: float, end: float, interval: float, read_at: Array | None = None) -> Array:
    """Return equally spaced times (K,) s that cover [start, end], K >= 2, about `interval` s apart.

    read_at (N,) s: times at which the path will be read, where they are known, and best at a keyframe.
    """
    if read_at is not None and len(read_at) > 1:
        origin, interval = reading_grid(read_at, interval)
        if math.isfinite(origin):
            start = origin + interval * math.floor((start - origin) / interval)
    n = max(1, int(np.ceil((end - start) / interval - 1e-9)))
    return np.asarray(start + interval * np.arange(n + 1))


def reading_grid(read_at: Array, interval: float) -> tuple[float, float]:
    """Return a time and an interval, near the asked one, of a grid on which the times read_at (N,) lie.

    Times that lie all over their intervals, as those of a rate that is not a multiple, have no such grid: NaN and the
    interval as it was. What falls at one half of an interval as often as at the other needs none.
    """
    turns = (read_at - read_at[0]) / interval
    phase = np.unwrap(2.0 * np.pi * (turns % 1.0)) / (2.0 * np.pi)
    drift = float(np.polyfit(turns, phase, 1)[0])
    spacing = interval / (1.0 - drift) if abs(drift) < MOST_DRIFT else interval
    mean = np.mean(np.exp(2j * np.pi * (read_at - read_at[0]) / spacing))
    if abs(mean) < ALIKE:
        return math.nan, interval
    return float(read_at[0] + np.angle(mean) / (2.0 * np.pi) * spacing), spacing
