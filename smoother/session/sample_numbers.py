"""Which periods of its clock samples were taken in, where some are lost and their stamps jitter by a good part of one.

Stamps modulo the period crowd around a phase, whichever of the samples were lost. Told the phase, single lost samples
are seen through jitter that hides them from who looks for steps: a late sample is followed by one that is not.
"""

import math
from typing import NamedTuple

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, IntArray, median

COARSEST = 0.3  # periods; stamps that are coarser crowd by other periods than that of the samples
MOST_WINDOWS = 128  # that are looked at for the period
SHORT_WINDOW = 64  # samples of each, at first ...
FINER = (1, 4, 16)  # ... and times as many, to make it exact
SHORTEST, LONGEST, TRIAL = 0.65, 1.1, 0.25  # of the period as first measured; from trial to trial, over the window
LEAST_CROWDED = 0.15  # length of the mean of stamps as points on a circle; normal jitter of 0.3 periods
SIGMAS_CROWDED = 6.0  # by which the square of that length is more than by chance, in as many windows as there are
FEW, AS_CROWDED = 16, 0.8  # samples that crowd hardly more than a window of them: a phase does not wander, a sum does
PHASE_WINDOWS = (32, 256)  # samples whose mean is the phase ...
PHASE_SAMPLES = 16.0  # ... and this over the square of that length
HELD_UP = 32  # samples that may arrive together, held up; a power of two
FEW_LOST = 1e-3  # share of the samples; so few are steps of the lag, or change nothing
LONG_HOLE = 5.0  # periods; the clock of what follows may have another phase
FEWEST_LOSSES, BY_CHANCE = 6, 0.5  # spread of how far losses are apart over their mean; in a pattern it is less
LEAST_SIGMA = 0.05  # periods
SIGMAS_LINEAR = 1.5  # beyond them the cost of jitter only grows linearly: some samples are late by far
COST_OF_LOSS = 3.0  # -log of how likely it is that samples were lost before one; 2 to 6 do as well
EARLIEST, LATEST = -1, 2  # periods by which samples may be later than the nearest number says
OVERLAP = 64  # samples; who begins so many earlier, and goes on so many longer, finds the same numbers


class SampleNumbers(NamedTuple):
    """Number (N,) of the period that each sample was taken in, from 0 on; the period, s; mask (N,) of the samples
    before which there is a long hole."""

    number: Array
    period: float
    after_hole: BoolArray


def number_samples(t: Array, period: float) -> SampleNumbers | None:
    """Number samples of a steady clock at stamps t (N,) s, about `period` s apart or, where some are lost, less.

    None where none is lost, where the stamps do not crowd around a phase, because of jitter or since there is no such
    clock, and where samples were not lost by chance: rather fewer are taken than there are ticks of the clock that
    stamps them.
    """
    t = t - t[0]
    if _holds_all(t, period):
        return None
    if _tick(t) > COARSEST * period or (found := _period_by_phase(t, period)) is None:
        return None
    period, crowded = found
    count = np.arange(t.size)
    holes = np.flatnonzero(np.diff(_least_ahead(t / period - count)) > LONG_HOLE - 1.0) + 1
    window = int(np.clip(PHASE_SAMPLES / crowded**2, *PHASE_WINDOWS))
    number = _likeliest_numbers(t / period - _phase(t / period, holes, window))
    if not _are_lost_by_chance(np.diff(number) > 1.0):
        return None
    return SampleNumbers(number - number[0], period, np.diff(number, prepend=number[0]) > LONG_HOLE)


def _holds_all(t: Array, period: float) -> bool:
    """Whether there are as many samples at t (N,) s, from 0 on, as periods, and they keep the phase of that period.

    Asked first: it takes a hundredth of what finding another period does.
    """
    if t[-1] / period - (t.size - 1) > 0.5 + FEW_LOST * t.size:
        return False
    one = np.array([period])
    short, long = (_crowded(t, one, min(times * SHORT_WINDOW, t.size))[0] for times in (FINER[0], FINER[-1]))
    return bool(long > max(AS_CROWDED * short, LEAST_CROWDED))


def _least_ahead(lag: Array) -> Array:
    """The least of each lag (N,) and the HELD_UP behind it: samples that were held up arrive with later ones."""
    least, reach = lag.copy(), 1
    while reach < HELD_UP:
        np.minimum(least[:-reach], least[reach:], out=least[:-reach])
        reach *= 2
    return least


def _tick(t: Array) -> float:
    """The step of the clock that wrote stamps t (N,) s, as intervals between them tell; about a period if none vary."""
    lengths = np.unique(np.round(np.diff(t), 6))
    return median(np.diff(lengths)) if lengths.size > 1 else math.inf


def _are_lost_by_chance(lost: BoolArray) -> bool:
    """Whether samples, before those of the mask (N,), were lost now sooner, now later."""
    apart = np.diff(np.flatnonzero(lost))
    return apart.size < FEWEST_LOSSES or bool(np.std(apart) > BY_CHANCE * np.mean(apart))


def _period_by_phase(t: Array, period: float) -> tuple[float, float] | None:
    """The period by which stamps t (N,) s crowd most, and how much they do, 0 to 1; None where they hardly do."""
    window = min(SHORT_WINDOW, t.size)
    trials = period * np.arange(SHORTEST, LONGEST, TRIAL / window)
    crowded = _crowded(t, trials, window)
    period, length = float(trials[int(np.argmax(crowded))]), float(np.max(crowded))
    by_chance = SIGMAS_CROWDED / window / math.sqrt(min(MOST_WINDOWS, t.size / window))
    if length**2 < max(LEAST_CROWDED**2, by_chance):
        return None
    for times in FINER:
        if times * window <= t.size:
            trials = period * (1.0 + np.linspace(-1.0, 1.0, 9) * TRIAL / (times * window))
            period = float(trials[int(np.argmax(_crowded(t, trials, times * window)))])
    one = np.array([period])
    if _crowded(t, one, window)[0] < AS_CROWDED * _crowded(t, one, FEW)[0]:
        return None
    return period, length


def _crowded(t: Array, periods: Array, window: int) -> Array:
    """How much windows of stamps t (N,) s crowd by each of periods (M,) s, 0 to 1: rms of the length of their mean."""
    starts = np.unique(np.linspace(0, t.size - window, MOST_WINDOWS * SHORT_WINDOW // window + 1).astype(np.int64))
    some = t[starts[:, None] + np.arange(window)]
    some = some - some[:, :1]
    square = [np.mean(np.abs(np.mean(np.exp(2j * np.pi / period * some), axis=1)) ** 2) for period in periods.tolist()]
    by_chance = 1.0 / window
    return np.asarray(np.sqrt(np.maximum(np.array(square) - by_chance, 0.0) / (1.0 - by_chance)))


def _phase(place: Array, holes: IntArray, window: int) -> Array:
    """Phase (N,) of the clock, periods, from the stamps (N,) in periods: mean of neighbours between the same holes."""
    total = np.append(0.0, np.cumsum(np.exp(2j * np.pi * place)))
    bounds = np.concatenate([[0], holes, [place.size]])
    stretch, number = np.repeat(np.arange(bounds.size - 1), np.diff(bounds)), np.arange(place.size)
    first = np.maximum(bounds[stretch], number - window // 2)
    behind = np.minimum(bounds[stretch + 1], number + window // 2 + 1)
    return np.asarray(np.unwrap(np.angle(total[behind] - total[first])) / (2.0 * math.pi))


def _likeliest_numbers(place: Array) -> Array:
    """Whole numbers (N,), increasing, near places (N,) in periods: jitter that is likely, and few losses.

    Source: Viterbi 1967. Blocks that overlap are gone through side by side, so that millions take no longer than arrays
    do.
    """
    count, nearest = np.arange(place.size), np.round(place)
    sigma = max(LEAST_SIGMA, MAD_TO_SIGMA * median(np.abs(place - nearest)))
    nearest = count + _least_ahead(nearest - count)
    length = max(4 * OVERLAP, math.isqrt(place.size))
    begins = np.arange(0, place.size, length)
    index = begins + np.arange(-OVERLAP, length + OVERLAP)[:, None]
    index = np.clip(index, 0, place.size - 1, out=index)
    late = _likeliest_late(nearest, (place - nearest) / sigma, 1.0 / sigma, index)
    return np.asarray(nearest - late[OVERLAP:-OVERLAP].T.ravel()[: place.size])


def _likeliest_late(nearest: Array, off: Array, period: float, index: IntArray) -> IntArray:
    """By how many periods the samples of each block, `index` (L, B), are later than the nearest whole number says.

    off (N,) : what they are off that number. off, period : in standard deviations of jitter.
    """
    late = np.arange(EARLIEST, LATEST + 1)
    came = np.empty((len(index), late.size, index.shape[1]), dtype=np.int8)
    cost = _cost(off[index[0]] + period * late[:, None])
    for k in range(1, len(index)):
        on = np.where(index[k] > index[k - 1], nearest[index[k]] - nearest[index[k - 1]], 1.0)  # the ends are repeated
        goes_on = on + late[:, None] - late[:, None, None]  # by so many from each (second) to each (first)
        total = cost + np.where(goes_on > 1.0, COST_OF_LOSS, np.where(goes_on < 1.0, np.inf, 0.0))
        came[k] = np.argmin(total, axis=1)
        cost = np.min(total, axis=1) + _cost(off[index[k]] + period * late[:, None])
    which = np.empty(index.shape, dtype=np.int64)
    which[-1] = np.argmin(cost, axis=0)
    for k in range(len(index) - 1, 0, -1):
        which[k - 1] = came[k][which[k], np.arange(index.shape[1])]
    return np.asarray(late[which])


def _cost(off: Array) -> Array:
    """-log of how likely jitter of so many standard deviations is."""
    size = np.abs(off)
    return np.where(size < SIGMAS_LINEAR, 0.5 * size**2, SIGMAS_LINEAR * (size - 0.5 * SIGMAS_LINEAR))
