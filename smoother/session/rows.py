"""Choosing the rows of a stream that can be used, and counting the others. Knows times, not files or units."""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, BoolArray, IntArray, is_increasing
from smoother.disc import pieces, release, roomy
from smoother.samples import Problem
from smoother.session.clock_steps import find_step_back
from smoother.units import DAY
from smoother.words import counted

MICROSECOND_WRAP = 2.0**32 * 1e-6  # s; Arduino's micros() starts again after 71.6 minutes
MILLISECOND_WRAP = 2.0**32 * 1e-3  # s; millis() after 49.7 days
WRAP_TOLERANCE = 60.0  # s; longest silence across a wrap that is still recognised as one
GLITCH_SHARE = 0.01  # up to this share of rows out of order is flaws; more has a cause of its own
GLITCH_ROWS = 10
COARSE_STEP = 1.5  # units of the last decimal from stamp to stamp; more is no want of decimals
MOSTLY = 0.95  # share; single stamps may be damaged
HASTE = 0.1  # of the mean time between rows; rows that are nearer come from one reading of the sensor
SAMPLED_APART = 1e-3  # s; no sensor of a logger takes samples nearer to one another
LONGEST_WAIT = 1.0  # s from one reading to the next; a longer one is a pause
MOST_TOGETHER = 256  # rows of one reading; sensors store fewer
ENOUGH = 100_000  # rows that show how all are read out
UNEVEN = 0.6  # share by which time from reading to reading may differ from what its rows take: two in place of three
MANY = 8  # rows; a tick of a sixtieth of a second holds as many only beyond 480 Hz
COARSE_UNSURE = 0.5  # steps of stamps that are cut off, or rounded, or of the last row that was read out by then
COARSE_SHARE = 0.05  # of rows that share a stamp: above it the stamps are too coarse, below they are flaws
RESTLESS = 0.3  # share of steps that fall: no clock starts again as often, but rows are in no order at all
RESTART_STEP = 1.0  # s; a clock that falls back further, for good, was started again
GOES_ON = 0.8  # share of the rows that go on in time around blocks of another recording; less may be two drives
MOST_PIECES = 4000  # that are compared with one another
SHUFFLE_DISTANCE = 64  # rows; a stream written in small shuffled batches is sorted, not thinned
MOST_TURNS = 4  # from one run of rows to another for every fall, twice what batches in no order at all have
STRAY_GAP = 600.0  # s; see _stray_ends
LATEST = 1e10  # s; even seconds since 1970 are fewer
LONGEST_GAP = 86400.0  # s; a few rows further from the others are of no recording


@dataclass
class RowFilter:
    """The rows of one file still in use, and what was said about the others.

    file : name for the sentences. prefix : start of the problem codes. keep : (N,) bool, changed only by `drop`.
    stamp_sigma s : of when rows were taken, where stamps are too coarse to say. is_alone : nothing else is stamped by
    the clock of this file, which may be mended.
    """

    file: str
    prefix: str
    keep: BoolArray
    problems: list[Problem] = field(default_factory=list)
    stamp_sigma: float = 0.0
    is_alone: bool = False

    def drop(self, bad: BoolArray, code: str, reason: str) -> None:
        """Stop using the rows of mask `bad` (N,); `reason` completes '<file>: <n> rows ...'."""
        count = int(np.count_nonzero(bad & self.keep))
        if count:
            self.keep = self.keep & ~bad
            self.say(code, f"{counted(count, 'row')} {reason}; dropped", count)

    def say(self, code: str, sentence: str, count: int) -> None:
        """Report without dropping."""
        self.problems.append(Problem(f"{self.prefix}_{code}", f"{self.file}: {sentence}", count))


def put_in_time_order(rows: RowFilter, t: Array, *values: npt.NDArray[Any]) -> tuple[Array, IntArray]:
    """Choose the rows in use that form one strictly increasing time axis.

    t : (N,) s as written; values : each (N,) or (N, M), by which rows written twice are told from others of that time.
    Returns the times (K,) s, unwrapped, and the indices (K,) of their rows in the file.
    Rows out of order or repeated are dropped (the first of a repeated time stays); a stray far-future stamp costs
    itself, not what follows it. A stream shuffled over short distances is sorted instead, because dropping would
    cost a large part of it, and so are blocks that were written twice or in another order. Rows in place of which older
    ones stand again are a gap, and so are those in place of which another recording stands. After a restart of the
    clock only the longest piece is kept. A clock that was set back by a moment is mended where it has no other to keep
    to.
    """
    if _is_flawless(rows, t):
        time = t.view()
        time.flags.writeable = False
        return time, _all_of(t.size)
    with np.errstate(invalid="ignore"):
        rows.drop(np.abs(t) > LATEST, "absurd_time", "with a time beyond any clock")
    index = np.flatnonzero(rows.keep)
    if index.size == 0:
        return t[index], index
    time, wraps = unwrap(t[index])
    if wraps:
        rows.say("clock_wrapped", f"its clock wrapped {wraps} times (32 bits, or midnight); unwrapped", wraps)
    time = _over_step_back(rows, time, [value[index] for value in values])
    index, time = _resolve_disorder(rows, index, time, values)
    keep = longest_increasing(time)
    _drop_disorder(rows, index, time, keep)
    index, time = index[keep], time[keep]
    stray = _stray_ends(time)
    rows.drop(_mask(rows, index[stray]), "stray_time", "far outside the time of the recording")
    return time[~stray], index[~stray]


@np.errstate(over="ignore", invalid="ignore")  # absurd times are dropped later, with their reason
def _is_flawless(rows: RowFilter, t: Array) -> bool:
    """Whether all rows are in use and stand in time order without a long gap; a day is looked at bit by bit."""
    if t.size == 0 or not np.all(rows.keep) or not (abs(t[0]) <= LATEST and abs(t[-1]) <= LATEST):
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


def spread_coarse_times(rows: RowFilter, t: Array, *values: Array) -> Array:
    """Times (N,) s in which rows that share a stamp but not their values, each (N, M), are spread evenly.

    Where the stamps have too few decimals for the rate, rows with the same stamp are different samples; dropping them
    as repeated would thin the recording. They lie between their stamp and the next one, if stamps are cut off; if they
    are rounded, half a step earlier, and if rows are read out at such times, a whole one. Where the stamps have
    decimals enough, rows that share one were read out of the sensor together, at the time of the last of them; so were
    rows that follow one another far quicker than they come. A few equal stamps are left to be dropped.
    """
    together = _step_within_reading(t)
    if np.all(rows.keep) and is_increasing(t) and not together:
        return t
    index = np.flatnonzero(rows.keep)
    time = _when_read_out(t[index], together) if together else t[index]
    shares = np.diff(time) == 0.0
    equal = np.flatnonzero(shares)
    here, before = index[equal + 1], index[equal]
    shares[equal] = np.any([np.any(value[here] != value[before], axis=1) for value in values], axis=0)
    if equal.size == 0 or np.count_nonzero(shares) < COARSE_SHARE * index.size:
        return t
    group = np.cumsum(np.append(True, ~shares)) - 1
    first = np.flatnonzero(np.append(True, ~shares))
    size = np.diff(np.append(first, index.size))
    steps = np.diff(time[first])
    typical = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    place, count = np.arange(index.size) - first[group], int(np.count_nonzero(shares))
    said = f"{counted(count, 'row')} {'right behind' if together else 'with the time of'} the row before; "
    if together or _are_read_together(time[first], size, typical):
        room = np.append(typical, steps)
        place = place - (size - 1)[group]
        rows.say("coarse_time", f"{said}read out together, spread evenly up to it", count)
    else:
        room = np.append(steps, typical)
        rows.stamp_sigma = COARSE_UNSURE * typical
        earlier = f"if stamps are rounded, all are {1e3 * rows.stamp_sigma:.3g} ms earlier"
        rows.say("coarse_time", f"{said}spread evenly; {earlier}, if read out together, twice that", count)
    room = _room_of_reading(room, size) if together else np.clip(room, 0.0, typical)
    spread = t.copy()
    spread[index] = time + place * (room / size)[group]
    return spread


def _step_within_reading(t: Array) -> float:
    """What rows at t (N,) s, each stamped as it was read out, are less apart than within one reading, s; 0 if not so.

    Most rows then follow the one before in a fraction of a millisecond, and the time from one reading to the next goes
    with how many rows were waiting. Pauses between readings are no part of either.
    """
    if len(t) > ENOUGH and not _step_within_reading(t[:ENOUGH]):  # a day's steps would take a gigabyte
        return 0.0
    steps = np.diff(t)
    going_on = steps[(steps >= 0.0) & (steps < LONGEST_WAIT)]
    shortest = min(HASTE * float(np.mean(going_on)), SAMPLED_APART) if going_on.size else 0.0
    if not np.count_nonzero((steps > 0.0) & (steps < shortest)) > 0.5 * len(t):
        return 0.0
    begins = np.flatnonzero(np.append(True, (steps < 0.0) | (steps >= shortest)))
    size, wait = np.diff(np.append(begins, len(t)))[1:], np.diff(t[begins])  # those that had come in the wait before
    waited = (wait > 0.0) & (wait < LONGEST_WAIT)
    if size.size < MANY or np.max(size) > MOST_TOGETHER or not waited.any():
        return 0.0
    each = wait[waited] / size[waited]
    is_even = np.abs(each / np.median(each) - 1.0) < UNEVEN
    return shortest if np.mean(is_even) > MOSTLY else 0.0


def _room_of_reading(wait: Array, size: IntArray) -> Array:
    """The time (G,) s in which the rows of each group, of `size` (G,), gathered: `wait` (G,) s since the one before.

    A pause before a group, and what was before the first, is no part of it.
    """
    each = float(np.median((wait / size)[1:]))
    is_pause = (wait > (1.0 + UNEVEN) * each * size) | (np.arange(size.size) == 0)
    return np.asarray(np.where(is_pause, each * size, np.maximum(wait, 0.0)))


def _when_read_out(t: Array, shortest: float) -> Array:
    """The time (N,) s of the first of rows at t (N,) s that were read out together: the last had just been taken."""
    step = np.diff(t)
    begins = np.append(True, (step < 0.0) | (step >= shortest))
    return np.asarray(t[np.flatnonzero(begins)][np.cumsum(begins) - 1])


def _are_read_together(stamps: Array, size: IntArray, step: float) -> bool:
    """Whether groups of `size` (G,) rows with these stamps (G,) s, usually `step` s apart, were read out together.

    A clock that is too coarse goes on by the same step, to the last of its decimals, whatever the rows do: what reads a
    sensor out is late now more, now less, or waits for the same number of rows.
    """
    decimals = 10.0 ** -np.arange(7)
    whole = [np.mean(np.abs(stamps / unit - np.round(stamps / unit)) < 1e-3) >= MOSTLY for unit in decimals]
    unit = float(decimals[int(np.argmax(whole))]) if any(whole) else float(decimals[-1])
    steps = np.diff(stamps)
    usual = steps[steps < 1.5 * step]
    if not usual.size:
        return False
    if np.mean(np.abs(usual - step) < 1.01 * unit) < MOSTLY:
        return True
    counted_out = np.median(size)
    return bool(step > COARSE_STEP * unit and counted_out >= MANY and np.mean(size == counted_out) >= MOSTLY)


def unwrap(t: Array) -> tuple[Array, int]:
    """Undo wraps of 32-bit microseconds or milliseconds, or of times of day, in t (N,) s; return times and number."""
    total, wraps = t.copy(), 0
    if np.all(t[1:] >= t[:-1]):
        return total, wraps
    for period in (MICROSECOND_WRAP, MILLISECOND_WRAP, DAY):
        step = np.diff(total, prepend=total[:1])
        wrapped = (step < 0.0) & (step + period >= 0.0) & (step + period < WRAP_TOLERANCE)
        wrapped &= persists(total, wrapped)
        wraps += int(np.count_nonzero(wrapped))
        total = total + period * np.cumsum(wrapped)
    return total, wraps


def persists(t: Array, fell: BoolArray) -> BoolArray:
    """Return whether the row after each fall stays below the one before the fall: a wrap, not one stray stamp."""
    after = np.append(t[1:], t[-1:])
    before = np.append(t[:1], t[:-1])
    return fell & (after < before)


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


def _resolve_disorder(
    rows: RowFilter, index: IntArray, t: Array, values: Sequence[npt.NDArray[Any]]
) -> tuple[IntArray, Array]:
    """Give back rows (indices and times) in which whatever is still out of order is a flaw of single rows."""
    tolerated = _tolerated(t.size)
    if np.count_nonzero(~longest_increasing(_without_repeats(t))) <= tolerated:
        return _sort_swapped(rows, index, t)
    order = np.argsort(t, kind="stable")
    if np.max(np.abs(order - np.arange(t.size))) <= SHUFFLE_DISTANCE and not _mixes(order, t):
        moved = int(np.count_nonzero(order != np.arange(t.size)))
        rows.say("reordered", f"{counted(moved, 'row')} slightly out of order; sorted by time", moved)
        return index[order], t[order]
    back = int(np.count_nonzero(np.diff(t) < 0.0))
    if back >= (1.0 - GLITCH_SHARE) * (t.size - 1):
        rows.say(
            "blocks_moved",
            f"{counted(back + 1, 'row')} written from the newest to the oldest; sorted by time",
            back + 1,
        )
        return index[order], t[order]
    if back > RESTLESS * t.size and is_even(t[order]):
        rows.say("reordered", f"{counted(t.size, 'row')} in no order; sorted by time", t.size)
        return index[order], t[order]
    calm = _is_calm(t)
    if _are_moved_blocks(t[calm], [value[index[calm]] for value in values]):
        falls = int(np.count_nonzero(np.diff(t[calm]) < 0.0))
        rows.say(
            "blocks_moved", f"{counted(falls, 'step')} back in time, of rows in another order; sorted by time", falls
        )
        rows.drop(_mask(rows, index[~calm]), "out_of_order", "out of time order")
        order = np.argsort(t[calm], kind="stable")
        return index[calm][order], t[calm][order]
    for copies in _copies(t, [value[index] for value in values]):
        if np.count_nonzero(~longest_increasing(t[~copies])) <= tolerated:
            rows.drop(_mask(rows, index[copies]), "written_again", "that stand elsewhere too, in place of others")
            return index[~copies], t[~copies]
    if (astray := blocks_astray(t)) is not None:
        reason = "with times far from those around them, of another recording or damaged"
        rows.drop(_mask(rows, index[astray]), "astray", reason)
        return index[~astray], t[~astray]
    return _longest_piece(rows, index, t)


def _sort_swapped(rows: RowFilter, index: IntArray, t: Array) -> tuple[IntArray, Array]:
    """Rows (indices and times) in which single rows that were written a few rows too late or too early are sorted in.

    The sorted position of such a row is a hole of the others: it is at least half a usual step away from each of them.
    A stamp that is damaged points between two rows that lack nothing, or far away; it stays out of order.
    """
    kept = longest_increasing(t)
    if kept.all() or np.count_nonzero(kept) < 2:
        return index, t
    time, half_step = t[kept], 0.5 * float(np.median(np.diff(t[kept])))
    order = np.argsort(t, kind="stable")
    rank = np.empty_like(order)
    rank[order] = np.arange(t.size)
    after = np.searchsorted(time, t)
    beside = np.minimum(np.abs(t - time[np.maximum(after - 1, 0)]), np.abs(time[np.minimum(after, time.size - 1)] - t))
    is_near = np.abs(rank - np.arange(t.size)) <= SHUFFLE_DISTANCE
    swapped = ~kept & is_near & (beside >= half_step)
    if not np.any(swapped):
        return index, t
    count = int(np.count_nonzero(swapped))
    rows.say("reordered", f"{counted(count, 'row')} out of order; sorted by time", count)
    free = np.flatnonzero(kept | swapped)  # the others keep their positions in the file, and are dropped
    sorted_rows = np.arange(t.size)
    sorted_rows[free] = free[np.argsort(t[free], kind="stable")]
    return index[sorted_rows], t[sorted_rows]


def _over_step_back(rows: RowFilter, t: Array, values: Sequence[npt.NDArray[Any]]) -> Array:
    """Times (N,) s that go on where the clock was set back by a moment, if it can be mended; that it was, is said."""
    step = find_step_back(t, values)
    if step is None:
        return t
    if step.by >= RESTART_STEP and np.count_nonzero(t[: step.row] >= t[step.row]) > _tolerated(t.size):
        return t  # it was started again
    said = f"its clock was set back by {step.by:.2f} s at {t[step.row - 1]:.0f} s"
    if not (rows.is_alone and step.is_even):
        rows.say("clock_behind", f"{said}; what follows stands so much too early, beside what was before", 1)
        return t
    rows.say("clock_behind", f"{said}, while rows went on evenly; what follows is joined to what was before", 1)
    return np.concatenate([t[: step.row], t[step.row :] + step.by])


def _tolerated(rows: int) -> float:
    """How many of so many rows may be out of order one by one."""
    return max(GLITCH_ROWS, GLITCH_SHARE * rows)


def _mixes(order: IntArray, t: Array) -> bool:
    """Whether this order, of times t (N,), takes rows by turns from before and after few falls of them.

    A clock that was set back by seconds has two places for each of them, and a kart in both by turns drives nowhere.
    Rows that were written in small shuffled batches have a fall for every few that change places.
    """
    block = np.cumsum(np.diff(t, prepend=t[:1]) < 0.0)
    return bool(np.count_nonzero(np.diff(block[order])) > MOST_TURNS * (int(block[-1]) + 1))


def is_even(t: Array) -> bool:
    """Whether times (N,) s, sorted, mostly go on by one step, as those of one recording do and of two mixed do not."""
    step = np.diff(t)
    usual = float(np.median(step))
    return bool(usual > 0.0 and np.mean(np.abs(step - usual) < UNEVEN * usual) >= MOSTLY)


def _is_calm(t: Array) -> BoolArray:
    """Mask (N,) of the rows that are not single stray stamps between two in order."""
    calm = np.ones(t.size, dtype=np.bool_)
    calm[1:-1] = ~((t[2:] > t[:-2]) & ((t[1:-1] > t[2:]) | (t[1:-1] < t[:-2])))
    return calm


def _are_moved_blocks(t: Array, values: Sequence[npt.NDArray[Any]]) -> bool:
    """Whether sorting makes one recording of t (N,): rows of one time are the same row, and blocks join without a hole.

    After a restart of the clock times come again with other rows, or two recordings mix, or there is time between them.
    """
    order = np.argsort(t, kind="stable")
    again = np.diff(t[order]) == 0.0
    if np.count_nonzero(again & _differ(order, values)) > GLITCH_SHARE * np.count_nonzero(again):
        return False
    block = np.cumsum(np.diff(t, prepend=t[:1]) < 0.0)
    kept = order[np.append(True, ~again)]
    step, joins = np.diff(t[kept]), np.diff(block[kept]) != 0
    longest = max(RESTART_STEP, 4.0 * float(np.median(step))) if step.size else 0.0
    holes, joined = np.count_nonzero(step[joins] > longest), np.count_nonzero(joins)
    return bool(joined <= 2 * (int(block[-1]) + 1) and holes <= GLITCH_SHARE * joined)


def _copies(t: Array, values: Sequence[npt.NDArray[Any]]) -> Iterator[BoolArray]:
    """Masks (N,) of the rows that are the same as an earlier one, and of those that are as a later one, if any are."""
    order = np.argsort(t, kind="stable")
    same = (np.diff(t[order]) == 0.0) & ~_differ(order, values)
    if np.any(same):
        for which in (order[1:], order[:-1]):
            mask = np.zeros(t.size, dtype=np.bool_)
            mask[which[same]] = True
            yield mask


def _differ(order: IntArray, values: Sequence[npt.NDArray[Any]]) -> BoolArray:
    """Mask (N - 1,) of the rows, in this order, that are unlike the one before; all of them where nothing tells."""
    differs = np.full(order.size - 1, fill_value=not values)
    for value in values:
        pairs = value[order[1:]], value[order[:-1]]
        same = (pairs[0] == pairs[1]) | (np.isnan(pairs[0]) & np.isnan(pairs[1]))
        differs |= ~(same if same.ndim == 1 else np.all(same, axis=1))
    return differs


def _without_repeats(t: Array) -> Array:
    return np.delete(t, np.flatnonzero(np.diff(t) == 0.0) + 1)


def parts_between_restarts(t: Array) -> IntArray:
    """Number (N,) of the part that each row of times t (N,) s is in, cut where the clock was set back for good.

    A row without a time is in the part of the row before it.
    """
    part = np.zeros(t.size, dtype=np.int64)
    known = np.flatnonzero(np.isfinite(t))
    calm = known[_is_calm(t[known])]
    part[calm[1:]] = np.diff(t[calm]) < -RESTART_STEP
    return np.cumsum(part)


def blocks_astray(t: Array) -> BoolArray | None:
    """Mask (N,) of the few rows of t (N,) s between which all others go on in time; None where there are none such.

    A cluster of the card that was lost holds what an older recording left there: the clock falls back, or leaps ahead,
    and is right again after it. One that started again never is, and cuts a recording in parts of which none is small
    against what goes on: these are not joined, since that would mix two drives.
    """
    step = np.diff(t)
    usual = np.abs(step[step != 0.0])
    longest = max(RESTART_STEP, 4.0 * float(np.median(usual))) if usual.size else RESTART_STEP
    bounds = np.concatenate([[0], np.flatnonzero((step < -RESTART_STEP) | (step > longest)) + 1, [t.size]])
    if not 2 < bounds.size - 1 <= MOST_PIECES:
        return None
    goes_on = _heaviest_chain(t[bounds[:-1]], t[bounds[1:] - 1], np.diff(bounds))
    between = ~goes_on
    ends = np.flatnonzero(goes_on)[[0, -1]]
    between[: ends[0]] = between[ends[1] :] = False
    kept = np.repeat(goes_on, np.diff(bounds))
    if not between.any() or np.mean(kept) < GOES_ON:
        return None
    return ~kept


def _heaviest_chain(begin: Array, end: Array, size: IntArray) -> BoolArray:
    """Mask (N,) of the pieces from `begin` to `end` (N,) s that follow one another in time and hold most rows."""
    rows, before = size.astype(np.int64), np.full(size.size, -1)
    for i in range(1, size.size):
        earlier = np.where(end[:i] < begin[i], rows[:i], 0)
        best = int(np.argmax(earlier))
        if earlier[best] > 0:
            rows[i] += earlier[best]
            before[i] = best
    chain, piece = np.zeros(size.size, dtype=np.bool_), int(np.argmax(rows))
    while piece >= 0:
        chain[piece] = True
        piece = int(before[piece])
    return chain


def _longest_piece(rows: RowFilter, index: IntArray, t: Array) -> tuple[IntArray, Array]:
    """Cut where the clock was set back for good; keep the piece with most rows."""
    piece = parts_between_restarts(t)
    chosen = piece == np.argmax(np.bincount(piece))
    rows.drop(
        _mask(rows, index[~chosen]),
        "clock_restart",
        "from before or after a restart of the clock, outside the longest part",
    )
    return index[chosen], t[chosen]


def _drop_disorder(rows: RowFilter, index: IntArray, t: Array, keep: BoolArray) -> None:
    if keep.all():
        return
    repeated = ~keep & np.isin(t, t[keep])
    rows.drop(_mask(rows, index[repeated]), "repeated_time", "repeating the time of another row")
    rows.drop(_mask(rows, index[~keep & ~repeated]), "out_of_order", "out of time order")


def _stray_ends(t: Array) -> BoolArray:
    """Mask of a few rows at either end that stand farther away than the whole rest lasts, or than a day.

    A single wrong stamp at the end of a file is in order, yet would stretch the recording without bound. A few rows
    between two long parts, of a logger that was switched on for a moment, stretch nothing and are no end. Nor is a long
    part, however far away: which of two drives is used is for whoever sees samples and fixes.
    """
    stray = np.zeros(t.size, dtype=np.bool_)
    cuts = np.flatnonzero(np.diff(t) > STRAY_GAP) + 1
    if cuts.size == 0:
        return stray
    bounds = np.concatenate([[0], cuts, [t.size]])
    main = int(np.argmax(np.diff(bounds)))
    first, last = _grow(t, bounds, main)
    stray[: bounds[first]] = True
    stray[bounds[last + 1] :] = True
    return stray


def _grow(t: Array, bounds: IntArray, main: int) -> tuple[int, int]:
    """First and last of the parts joined to `main`: all long ones, and others that are near for the duration so far."""
    first = last = main
    few = max(GLITCH_ROWS, GLITCH_SHARE * t.size)

    def next_long(part: int, step: int) -> int:
        """The first part from `part` on that has many rows, -1 or the number of parts if none has."""
        while 0 <= part < bounds.size - 1 and bounds[part + 1] - bounds[part] <= few:
            part += step
        return part

    def belongs(gap: float) -> bool:
        return bool(gap <= min(LONGEST_GAP, t[bounds[last + 1] - 1] - t[bounds[first]]))

    while first > 0:
        part = next_long(first - 1, -1)
        if part >= 0:
            first = part
        elif belongs(t[bounds[first]] - t[bounds[first] - 1]):
            first -= 1
        else:
            break
    while last < bounds.size - 2:
        part = next_long(last + 1, 1)
        if part < bounds.size - 1:
            last = part
        elif belongs(t[bounds[last + 1]] - t[bounds[last + 1] - 1]):
            last += 1
        else:
            break
    return first, last


def taken(values: Array, index: IntArray) -> Array:
    """Rows `index` of values (N, ...), read-only: `values` itself if they are all of them, to spare a long recording
    the copy. The caller gives `values` away.
    """
    rows = values if is_all(index, len(values)) else values[index]
    rows.flags.writeable = False
    return rows


def _mask(rows: RowFilter, index: IntArray) -> BoolArray:
    mask = np.zeros(rows.keep.size, dtype=np.bool_)
    mask[index] = True
    return mask
