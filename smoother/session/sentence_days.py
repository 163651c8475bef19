"""The day of every NMEA sentence: most tell a time of day only, some (RMC, ZDA) a date too.

A file may hold the recordings of several days, one behind the other. Where the date changes and the time of day does
not go on, another day begins; where it goes on the receiver's calendar was set, or turned over late, and it is one day.
"""

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.units import DAY

FEWEST_OF_A_DAY = 10  # dates, one behind the other; fewer are damaged ones
MOST_DAYS = 3660.0  # from most dates; farther off is what a receiver tells before it knows the date (1980, 2000, 2006)
LONGEST_PAUSE = 2.0  # s; after a longer one, or back in time, a new date is that of another recording


def on_their_days(utc: Array, day: Array) -> Array:
    """Times (N,) s in file order with those of other days moved there by their dates; `utc` itself where none are.

    utc (N,) s : as if all were one recording, running on over midnight. day (N,) : dates, days since 1970, NaN where
    the sentence tells none, or none that counts.
    """
    dated, ahead = _lasting(*_near(np.flatnonzero(np.isfinite(day)), day, utc))
    moved = utc
    for i in np.flatnonzero(np.diff(ahead)).tolist():
        first = int(dated[i]) + 1 + int(np.argmax(np.abs(np.diff(utc[dated[i] : dated[i + 1] + 1]))))
        if not 0.0 <= utc[first] - utc[first - 1] <= LONGEST_PAUSE:
            moved = moved + DAY * (ahead[i + 1] - ahead[i]) * (np.arange(utc.size) >= first)
    return moved


def _near(dated: IntArray, day: Array, utc: Array) -> tuple[IntArray, Array]:
    """The rows (M,) of those `dated` that tell a date near most others, and by how many days it is ahead of `utc`."""
    ahead = day[dated] - np.floor(utc[dated] / DAY)
    if not dated.size:
        return dated, ahead
    near = np.abs(ahead - np.percentile(ahead, 50, method="nearest")) < MOST_DAYS
    return dated[near], ahead[near]


def _lasting(dated: IntArray, ahead: Array) -> tuple[IntArray, Array]:
    """The same without those that differ from what is before and behind for a few rows only."""
    bounds = np.concatenate([[0], np.flatnonzero(np.diff(ahead)) + 1, [ahead.size]])
    lasts = np.repeat(np.diff(bounds) >= FEWEST_OF_A_DAY, np.diff(bounds))
    return dated[lasts], ahead[lasts]
