"""Choosing the rows of a stream that form one time axis, and counting the others. Knows times, not files or units."""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces, release, roomy
from smoother.samples import Problem
from smoother.units import DAY
from smoother.words import counted

GLITCH_SHARE = 0.01  # up to this share of rows out of order is flaws; more has a cause of its own
GLITCH_ROWS = 10
UNEVEN, MOSTLY = 0.45, 0.95  # of the usual step, and of the steps: those of one recording are as even
RESTART_STEP = 1.0  # s; a clock that falls back further, for good, was started again
SHUFFLE_DISTANCE = 64  # rows; a stream written in small shuffled batches is sorted, not thinned
STRAY_GAP = 600.0  # s; see _stray_ends
LATEST = 1e10  # s; even seconds since 1970 are fewer
LONGEST_GAP = 86400.0  # s; a few rows further from the others are of no recording

Values = Sequence[npt.NDArray[Any]]  # columns, each (N,) or (N, M), by which rows of one time differ


@dataclass(frozen=True, eq=False)
class Ordered:
    """Times t (K,) s, strictly increasing, the index (K,) of their rows, and what was done."""

    t: Array
    index: IntArray
    problems: list[Problem]


class _Sentences:
    """Sentences about the rows of one file."""

    def __init__(self, file: str, prefix: str) -> None:
        self._file, self._prefix = file, prefix

    def that(self, code: str, sentence: str, count: int) -> list[Problem]:
        return [Problem(f"{self._prefix}_{code}", f"{self._file}: {sentence}", count)] if count else []

    def dropped(self, code: str, count: int, reason: str) -> list[Problem]:
        return self.that(code, f"{counted(count, 'row')} {reason}; dropped", count)


def in_time_order(t: Array, *values: npt.NDArray[Any], file: str, prefix: str) -> Ordered:
    """Choose the rows that form one strictly increasing time axis.

    t : (N,) s as written. values : columns by which rows of one time are distinguished. Single rows out of order or
    repeated are dropped, or sorted in where they are missing (the first of a repeated time stays); a stray far-future
    stamp costs itself, not what follows it. Rows in another order that are one recording, sorted, are sorted. After a
    restart of the clock only the longest part is kept.
    """
    if _is_flawless(t):
        time = t.view()
        time.flags.writeable = False
        return Ordered(time, _all_of(t.size), [])
    said = _Sentences(file, prefix)
    index = np.flatnonzero(np.abs(t) <= LATEST)
    problems = said.dropped("absurd_time", t.size - index.size, "with a time beyond any clock")
    if index.size == 0:
        return Ordered(t[index], index, problems)
    chosen, time, more = _sorted(said, t[index], [value[index] for value in values])
    problems += more
    index, keep = index[chosen], longest_increasing(time)
    repeated = ~keep & np.isin(time, time[keep])
    problems += said.dropped("repeated_time", int(np.count_nonzero(repeated)), "repeating the time of another row")
    problems += said.dropped("out_of_order", int(np.count_nonzero(~keep & ~repeated)), "out of time order")
    index, time = index[keep], time[keep]
    stray = _stray_ends(time)
    problems += said.dropped("stray_time", int(np.count_nonzero(stray)), "far outside the time of the recording")
    return Ordered(time[~stray], index[~stray], problems)


@np.errstate(over="ignore", invalid="ignore")  # absurd times are dropped later, with their reason
def _is_flawless(t: Array) -> bool:
    """Whether all rows stand in time order without a long gap; a day is looked at bit by bit."""
    if t.size == 0 or not (abs(t[0]) <= LATEST and abs(t[-1]) <= LATEST):
        return False
    for part in pieces(t.size - 1):
        step = np.diff(t[part.start : part.stop + 1])
        release(t)
        if not np.all((step > 0.0) & (step <= STRAY_GAP)):
            return False
    return True


def _all_of(n: int) -> IntArray:
    index = roomy(n, np.int64)
    for part in pieces(n):
        index[part] = np.arange(part.start, part.stop)
        release(index)
    return index


def is_all(index: IntArray, n: int) -> bool:
    """Whether index (K,) is that of all n rows, in their order."""
    return index.size == n and all(np.array_equal(index[part], np.arange(part.start, part.stop)) for part in pieces(n))


def over_midnight(time_of_day: Array) -> Array:
    """Seconds (N,) that run on over midnight, in file order, from the UTC of day of each row.

    Days are counted on the median of five neighbours, so that one damaged time cannot shift all that follow.
    """
    padded = np.pad(time_of_day, 2, mode="edge")
    steady = np.median(np.lib.stride_tricks.sliding_window_view(padded, 5), axis=1)
    steps = np.diff(steady, prepend=steady[:1])
    steady = steady + DAY * np.cumsum(np.where(steps < -0.5 * DAY, 1, np.where(steps > 0.5 * DAY, -1, 0)))
    return np.asarray(time_of_day + DAY * np.round((steady - time_of_day) / DAY))


def longest_increasing(t: Array) -> BoolArray:
    """Mask (N,) of a longest strictly increasing subsequence of t (N,), the first row of equal times.

    Rows above everything before and below everything after belong to every such subsequence; only the stretches
    between them are searched (patience sorting), so a clean stream costs two passes.
    """
    if t.size < 2 or np.all(np.diff(t) > 0.0):
        return np.ones(t.size, dtype=np.bool_)
    highest_before = np.concatenate([[-np.inf], np.maximum.accumulate(t)[:-1]])
    lowest_after = np.concatenate([np.minimum.accumulate(t[::-1])[::-1][1:], [np.inf]])
    keep = (t > highest_before) & (t < lowest_after)
    edge = np.diff(np.concatenate([[False], ~keep, [False]]).astype(np.int8))
    for start, end in zip(np.flatnonzero(edge == 1), np.flatnonzero(edge == -1), strict=True):
        keep[start + _patience(t[start:end])] = True
    return keep


def _patience(t: Array) -> IntArray:
    """Indices of a longest strictly increasing subsequence. Source: Fredman 1975, patience sorting."""
    tails: list[float] = []
    tail_index: list[int] = []
    parent = np.full(t.size, -1, dtype=np.int64)
    for i, value in enumerate(t.tolist()):
        place = bisect_left(tails, value)
        if place < len(tails) and tails[place] == value:
            continue  # the first row of a repeated time stays
        parent[i] = tail_index[place - 1] if place else -1
        if place == len(tails):
            tails.append(value)
            tail_index.append(i)
        else:
            tails[place], tail_index[place] = value, i
    chain = [tail_index[-1]]
    while parent[chain[-1]] >= 0:
        chain.append(int(parent[chain[-1]]))
    return np.array(chain[::-1], dtype=np.int64)


def _sorted(said: _Sentences, t: Array, values: Values) -> tuple[IntArray, Array, list[Problem]]:
    """Rows (index and times) in which whatever is still out of order is a flaw of single rows."""
    every = np.arange(t.size)
    if np.count_nonzero(~longest_increasing(t[np.append(True, np.diff(t) != 0.0)])) <= _tolerated(t.size):
        return _sort_swapped(said, t)
    order = np.argsort(t, kind="stable")
    if _is_one_recording(t[order], order, values):
        moved = int(np.count_nonzero(order != every))
        return order, t[order], said.that("reordered", f"{counted(moved, 'row')} out of order; sorted by time", moved)
    piece = parts_between_restarts(t)
    rows = every[piece == np.argmax(np.bincount(piece))]
    reason = "from before or after a restart of the clock, outside the longest part"
    return rows, t[rows], said.dropped("clock_restart", t.size - rows.size, reason)


def _sort_swapped(said: _Sentences, t: Array) -> tuple[IntArray, Array, list[Problem]]:
    """Rows (index and times) in which single rows that were written a few rows too late or too early are sorted in.

    The sorted position of such a row is a hole of the others: it is at least half a usual step away from each of them.
    A stamp that is damaged points between two rows that lack nothing, or far away; it stays out of order.
    """
    kept, every = longest_increasing(t), np.arange(t.size)
    if kept.all() or np.count_nonzero(kept) < 2:
        return every, t, []
    time, half_step = t[kept], 0.5 * float(np.median(np.diff(t[kept])))
    rank = np.empty(t.size, dtype=np.int64)
    rank[np.argsort(t, kind="stable")] = every
    after = np.searchsorted(time, t)
    beside = np.minimum(np.abs(t - time[np.maximum(after - 1, 0)]), np.abs(time[np.minimum(after, time.size - 1)] - t))
    swapped = ~kept & (np.abs(rank - every) <= SHUFFLE_DISTANCE) & (beside >= half_step)
    free = np.flatnonzero(kept | swapped)  # the others keep their positions in the file, and are dropped
    rows = every.copy()
    rows[free] = free[np.argsort(t[free], kind="stable")]
    count = int(np.count_nonzero(swapped))
    return rows, t[rows], said.that("reordered", f"{counted(count, 'row')} out of order; sorted by time", count)


def _tolerated(rows: int) -> float:
    """How many of so many rows may be out of order one by one."""
    return max(GLITCH_ROWS, GLITCH_SHARE * rows)


def _is_one_recording(t: Array, order: IntArray, values: Values) -> bool:
    """Whether rows in this order are one recording: times t (N,) s mostly go on by one step, rows of one time are the
    same row, and what was written in one piece joins without a hole.

    After a restart of the clock times come again with other rows, or two recordings mix, or there is time between them.
    """
    again = np.diff(t) == 0.0
    if np.count_nonzero(again & _differ(order, values)) > GLITCH_SHARE * np.count_nonzero(again):
        return False
    kept = np.append(True, ~again)
    step, block = np.diff(t[kept]), np.cumsum(np.diff(t[np.argsort(order)], prepend=t[0]) < 0.0)[order]
    joins = np.diff(block[kept]) != 0
    usual = float(np.median(step)) if step.size else 0.0
    holes = np.count_nonzero(step[joins] > max(RESTART_STEP, 4.0 * usual))
    is_even = np.mean(np.abs(step - usual) < UNEVEN * usual) >= MOSTLY if step.size else False
    return bool(usual > 0.0 and is_even and holes <= GLITCH_SHARE * np.count_nonzero(joins))


def _is_calm(t: Array) -> BoolArray:
    """Mask (N,) of the rows that are not single stray stamps between two in order."""
    calm = np.ones(t.size, dtype=np.bool_)
    calm[1:-1] = ~((t[2:] > t[:-2]) & ((t[1:-1] > t[2:]) | (t[1:-1] < t[:-2])))
    return calm


def _differ(order: IntArray, values: Values) -> BoolArray:
    """Mask (N - 1,) of the rows, in this order, that are unlike the one before; all of them without values."""
    differs = np.full(order.size - 1, fill_value=not values)
    for value in values:
        pairs = value[order[1:]], value[order[:-1]]
        same = (pairs[0] == pairs[1]) | (np.isnan(pairs[0]) & np.isnan(pairs[1]))
        differs |= ~(same if same.ndim == 1 else np.all(same, axis=1))
    return differs


def parts_between_restarts(t: Array) -> IntArray:
    """Number (N,) of the part that each row of times t (N,) s is in, cut where the clock was set back for good.

    A row without a time is in the part of the row before it.
    """
    part = np.zeros(t.size, dtype=np.int64)
    known = np.flatnonzero(np.isfinite(t))
    calm = known[_is_calm(t[known])]
    part[calm[1:]] = np.diff(t[calm]) < -RESTART_STEP
    return np.cumsum(part)


def _stray_ends(t: Array) -> BoolArray:
    """Mask of a few rows at either end that stand farther away than the whole rest lasts, or than a day.

    A single wrong stamp at the end of a file is in order, yet would stretch the recording without bound. A few rows
    between two long parts, of a logger that was switched on for a moment, stretch nothing and are no end.
    """
    stray = np.zeros(t.size, dtype=np.bool_)
    cuts = np.flatnonzero(np.diff(t) > STRAY_GAP) + 1
    if cuts.size == 0:
        return stray
    bounds = np.concatenate([[0], cuts, [t.size]])
    begin, end, sizes = t[bounds[:-1]], t[bounds[1:] - 1], np.diff(bounds)
    long = np.append(np.flatnonzero(sizes > _tolerated(t.size)), np.argmax(sizes))
    first, last = int(long.min()), int(long.max())
    while first > 0 and begin[first] - end[first - 1] <= min(LONGEST_GAP, end[last] - begin[first]):
        first -= 1
    while last + 1 < sizes.size and begin[last + 1] - end[last] <= min(LONGEST_GAP, end[last] - begin[first]):
        last += 1
    stray[: bounds[first]] = stray[bounds[last + 1] :] = True
    return stray


def taken(values: Array, index: IntArray) -> Array:
    """Rows `index` of values (N, ...), read-only: `values` itself if they are all of them, to spare a long recording
    the copy. The caller gives `values` away.
    """
    rows = values if is_all(index, len(values)) else values[index]
    rows.flags.writeable = False
    return rows
