"""Rows that an exporter put between measurements: to the last digit on the line between the rows beside them.

Taken for fixes they would make a result far too sure of itself, as each would count as measured on its own.
"""

from collections.abc import Sequence

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, runs_of

DIGITS = 1.05  # of the last digit: rounding moves a row by half of one, and the line beside it by as much
MANTISSA = 1e-15  # share; as finely as a float is written
MILLISECOND, MICROSECOND = 1e-3, 1e-6  # s
FEWEST_KNOTS = 20  # that show how often they come
SHORT_STEP = 10.0  # per cent of the steps between knots, that are no longer than to the next one
REGULAR = 0.2  # of the period, by which a knot may be early or late
ROUNDING = 1e-3  # likewise, by the digits of stamps
MOSTLY = 0.9  # of the knots come regularly; what bends by chance does not
MORE_ROWS = 1.04  # rows for every knot; fewer are those of a receiver that missed some
# s, rows and m of a straight line that is no kart's way: noise bends that of the fixes of any receiver
LONGEST_LINE, MOST_ON_LINE, LONG_WAY = 2.0, 8, 20.0
FEW_ON_LINE = 0.1  # share of the other fixes in motion that may be on the line beside them, where lines show anything
FEW_BETWEEN = 0.05  # share of samples that may lie between others by chance


@np.errstate(over="ignore", invalid="ignore", divide="ignore")  # absurd steps are off any chord, or unknown
def on_chord(t: Array, channels: Sequence[Array]) -> BoolArray:
    """Mask (N,) of the rows that are, within rounding, on the line between their neighbours in all of channels (N,).

    t (N,) s, increasing. The first and the last row are on none; where a channel is unknown, the others decide.
    """
    on = np.zeros(t.size, dtype=np.bool_)
    if t.size < 3:
        return on
    on[1:-1] = True
    in_milliseconds = np.max(np.abs(t / MILLISECOND - np.round(t / MILLISECOND))) < 2.0 * MICROSECOND / MILLISECOND
    early, late = np.percentile(np.diff(t), (5.0, 95.0))
    stamp = 0.5 * MILLISECOND if in_milliseconds and late - early > 2.0 * MICROSECOND else MICROSECOND
    before, after = np.diff(t)[:-1], np.diff(t)[1:]
    for values in channels:
        if (digit := _digit(values)) > 0.0:
            rise, next_rise = np.diff(values)[:-1], np.diff(values)[1:]
            by = np.abs(rise * after - next_rise * before) / (before + after)
            rounding = DIGITS * digit + stamp * (np.abs(rise) / before + np.abs(next_rise) / after)
            on[1:-1] &= ~(by > rounding)
    return on


def _digit(values: Array) -> float:
    """Worth of the last digit that values (N,) are written with, 0 where they never change.

    By the values, their steps and how these change, which are so many digits too: on a road that leads elsewhere no
    value comes near another, and the shortest step would pass for a digit.
    """
    known = values[np.isfinite(values)]
    fine = MANTISSA * float(np.max(np.abs(known), initial=0.0))
    gaps = np.concatenate([np.diff(np.unique(np.diff(known, order))) for order in range(3)])
    return max(float(np.min(gaps[gaps > fine], initial=np.inf)), 4.0 * fine) if np.any(gaps > fine) else 0.0


def rows_at_knots(t: Array, seen: Array) -> IntArray | None:
    """Rows (K,) of t (N,) s nearest to knots, some of which were `seen` (M,) s; None unless they come regularly and
    with rows between them.
    """
    seen = np.unique(seen)
    gaps = np.diff(seen)
    if gaps.size < FEWEST_KNOTS:
        return None
    period = float(np.median(gaps[gaps < 1.5 * np.percentile(gaps, SHORT_STEP)]))
    between = np.diff(np.searchsorted(t, seen))
    with np.errstate(over="ignore"):
        count = np.clip(np.round(gaps / period), 1.0, between + 1.0)  # in a pause there is nothing to fill
    if np.mean(np.abs(gaps - count * period) < REGULAR * period) < MOSTLY:
        return None
    alone = between[count == 1.0]
    if np.sum(alone) <= MORE_ROWS * alone.size:
        return None
    place = np.concatenate([[0.0], np.cumsum(count)])
    knots = np.interp(np.arange(place[-1] + 1.0), place, seen)
    ends = (knots[0] - t[0], t[-1] - knots[-1])
    most = (np.searchsorted(t, knots[0]), t.size - np.searchsorted(t, knots[-1]))
    early, late = (min(float(n), np.floor(end / period + ROUNDING)) for end, n in zip(ends, most, strict=True))
    before, after = knots[0] - period * np.arange(early, 0.0, -1.0), knots[-1] + period * np.arange(1.0, late + 1.0)
    knots = np.concatenate([before, knots, after])
    rows = _nearest(t, knots)
    return np.unique(rows[np.abs(t[rows] - knots) <= 0.5 * period])


def _nearest(t: Array, at: Array) -> IntArray:
    right = np.clip(np.searchsorted(t, at), 1, t.size - 1)
    return np.where(at - t[right - 1] <= t[right] - at, right - 1, right)


def between_samples(t: Array, channels: Sequence[Array]) -> BoolArray:
    """Mask (N,) of the rows that are on the line between their neighbours in each of the channels (N,), and change.

    t (N,) s, increasing. Noise keeps measured rows of several channels from it; a sensor that stands still is none.
    """
    change = np.any([np.diff(values) != 0.0 for values in channels], axis=0)
    changing = np.append(False, change) & np.append(change, False)
    return np.asarray(changing & on_chord(t, channels))


def on_drawn_lines(t: Array, channels: Sequence[Array], way: Array) -> BoolArray:
    """Mask (N,) of fixes that an exporter which interpolates put on the straight line over an outage.

    t (N,) s, increasing. channels (N,) : what of them is interpolated. way (N,) m : from the fix before. Fixes at rest
    are on a line too, and stay.
    """
    on = on_chord(t, channels)
    drawn = np.zeros(t.size, dtype=np.bool_)
    for first, end in zip(*runs_of(on), strict=True):  # end : the next that is on no line
        is_long = t[end] - t[first - 1] >= LONGEST_LINE and end - first >= MOST_ON_LINE
        drawn[first:end] = is_long and np.sum(way[first : end + 1]) >= LONG_WAY
    others = ~drawn & (way > 0.0)
    is_clear = np.count_nonzero(others) >= FEWEST_KNOTS and np.mean(on[others]) <= FEW_ON_LINE
    return drawn if is_clear else np.zeros(t.size, dtype=np.bool_)
