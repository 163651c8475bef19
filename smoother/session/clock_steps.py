"""A clock that was set back once, by a moment: as telephones and receivers do that learn the time while they record.

The rows go on evenly, only their times do not. Rows that were written twice, or in another order, have times that come
again as well, but a leap ahead beside them, or the values that were there before.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, median

BESIDE = 10  # rows on either side, whose times go on
EVEN = 0.6  # share of the usual time between rows by which it may differ
LONGEST = 20.0  # s; a clock that falls back by more was started again; 18 are the leap seconds since 2017
MOST_FALLS = 20  # of times in rows whose clock was set back; more are in another order
NEARBY = 2  # times the rows that the clock went back by; rows in another order leap ahead within as many
SAME = 0.5  # share of the rows whose time comes again that may hold the same values


class StepBack(NamedTuple):
    """From row `row` on, the clock was `by` s behind what it was before.

    is_even : times go on evenly on both sides, and nowhere do they leap ahead by as much, as a clock does that is set
    right again.
    """

    row: int
    by: float
    is_even: bool


def find_step_back(t: Array, values: Sequence[npt.NDArray[Any]] = ()) -> StepBack | None:
    """Find where the clock of times t (N,) s was set back, once and for good; None where it was not, or often.

    values : each (N,) or (N, M), by which rows written twice are told from others.
    """
    step = np.diff(t)
    falls = np.flatnonzero(step < 0.0) + 1
    if not 0 < falls.size <= MOST_FALLS:
        return None
    usual = median(step)
    found = [row for row in falls.tolist() if _goes_on(t, row, usual) and not _comes_again(t, row, values)]
    if usual <= 0.0 or len(found) != 1:
        return None
    row = found[0]
    near = np.concatenate([step[row - BESIDE : row - 1], step[row : row + BESIDE - 1]])
    by = _by(t, row, float(np.mean(near)))
    is_even = np.all(np.abs(near - usual) < EVEN * usual) and np.all(np.abs(step - usual - by) > usual)
    return StepBack(row, by, bool(is_even))


def _by(t: Array, row: int, usual: float) -> float:
    """By how much, s, times t (N,) s fall at a row, with rows `usual` s apart; the middle of rows on either side."""
    lag = t[row - BESIDE : row + BESIDE] - usual * np.arange(2 * BESIDE)
    return median(lag[:BESIDE]) - median(lag[BESIDE:])


def _goes_on(t: Array, row: int, usual: float) -> bool:
    """Whether times t (N,) s fall at a row, a little, and are in order before and after, without a leap ahead."""
    fall = float(t[row - 1] - t[row]) + usual
    again = int(fall / usual) + 1 if fall < min(LONGEST, t.size * usual) else t.size
    if not BESIDE + again <= row <= t.size - BESIDE - again:
        return False
    before, after = (np.diff(part) for part in (t[row - BESIDE - again : row], t[row : row + BESIDE + again]))
    if not (np.all(before > 0.0) and np.all(after > 0.0)):
        return False
    ahead = np.diff(t) - usual
    near = np.maximum(ahead[max(0, row - 1 - NEARBY * again) : row + NEARBY * again], 0.0)
    return bool(np.sum(near[near > EVEN * usual]) < 0.5 * fall)


def _comes_again(t: Array, row: int, values: Sequence[npt.NDArray[Any]]) -> bool:
    """Whether rows whose time t (N,) s is that of one before this row mostly are the same row."""
    _, before, after = np.intersect1d(t[:row], t[row:], return_indices=True)
    if before.size == 0 or not values:
        return False
    same = np.ones(before.size, dtype=np.bool_)
    for value in values:
        alike = np.equal(value[before], value[row + after])
        same &= alike if alike.ndim == 1 else np.all(alike, axis=1)
    return bool(np.mean(same) > SAME)
