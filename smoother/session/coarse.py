"""Stamps that are too coarse for the rate of their rows, or are those of when several rows were read out together."""

from typing import NamedTuple

import numpy as np

from smoother.arrays import Array, IntArray, is_increasing
from smoother.samples import Problem
from smoother.words import counted

COARSE_STEP = 1.5  # units of the last decimal from stamp to stamp; more is no want of decimals
MOSTLY = 0.95  # share; single stamps may be damaged
MANY = 8  # rows; a tick of a sixtieth of a second holds as many only beyond 480 Hz
COARSE_UNSURE = 0.5  # steps of stamps that are cut off, or rounded, or of the last row that was read out by then
COARSE_SHARE = 0.05  # of rows that share a stamp: above it the stamps are too coarse, below they are flaws


class Spread(NamedTuple):
    """Times (N,) s, the sigma s of when rows were taken where stamps are too coarse to say, and what to say of it."""

    t: Array
    sigma: float = 0.0
    problems: tuple[Problem, ...] = ()


def spread_coarse_times(t: Array, *values: Array, file: str, prefix: str) -> Spread:
    """Times t (N,) s in which rows that share a stamp but not their values, each (N, M), are spread evenly.

    Where the stamps have too few decimals for the rate, rows with the same stamp are different samples; dropping them
    as repeated would thin the recording. They lie between their stamp and the next one, if stamps are cut off; if they
    are rounded, half a step earlier, and if rows are read out at such times, a whole one. Where the stamps have
    decimals enough, rows that share one were read out of the sensor together, at the time of the last of them. A few
    equal stamps are left to be dropped.
    """
    if is_increasing(t):
        return Spread(t)
    shares = np.diff(t) == 0.0
    equal = np.flatnonzero(shares)
    shares[equal] = np.any([np.any(value[equal + 1] != value[equal], axis=1) for value in values], axis=0)
    if equal.size == 0 or np.count_nonzero(shares) < COARSE_SHARE * t.size:
        return Spread(t)
    group = np.cumsum(np.append(True, ~shares)) - 1
    first = np.flatnonzero(np.append(True, ~shares))
    size = np.diff(np.append(first, t.size))
    steps = np.diff(t[first])
    typical = float(np.median(steps[steps > 0.0])) if np.any(steps > 0.0) else 0.0
    place, count, sigma = np.arange(t.size) - first[group], int(np.count_nonzero(shares)), 0.0
    said = f"{counted(count, 'row')} with the time of the row before; "
    if _are_read_together(t[first], size, typical):
        room = np.append(typical, steps)
        place = place - (size - 1)[group]
        said += "read out together, spread evenly up to it"
    else:
        room = np.append(steps, typical)
        sigma = COARSE_UNSURE * typical
        said += f"spread evenly; if stamps are rounded, all are {1e3 * sigma:.3g} ms earlier, "
        said += "if read out together, twice that"
    spread = t + place * (np.clip(room, 0.0, typical) / size)[group]
    return Spread(spread, sigma, (Problem(f"{prefix}_coarse_time", f"{file}: {said}", count),))


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
