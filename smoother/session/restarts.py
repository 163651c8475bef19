"""A clock that started again while it recorded: tables are cut where it did, and the parts of one run belong together.

Where the UTC of the fixes tells how long it was off, the parts are joined. Else those two are kept that ran together
longest: samples of one run beside fixes of another would make a drive that never was.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.samples import Problem
from smoother.session.rows import RESTART_STEP, parts_between_restarts
from smoother.units import DAY
from smoother.words import counted, listed

MOST_PARTS = 20  # of a clock that starts again; more is a mixture of other kinds


@dataclass(frozen=True, eq=False)
class Restarts:
    """Seconds to be added to each part of the samples (K,) and of the fixes (L,), NaN where it is left out."""

    samples: Array
    fixes: Array
    problem: Problem
    runs: "list[_Part]"  # the K parts of the samples

    def of_compass(self, t: Array) -> Array | None:
        """Seconds to be added to each part (M,) of a compass beside the samples, at t (N,) s; None where it has others.

        It may be missing in a run, or in a part of one; a clock that went on when that of the samples did not is none
        of theirs.
        """
        parts = _parts_of(t, np.full(t.size, np.nan))
        if len(parts) > len(self.runs):
            return None
        pairs = _in_order(np.array([[part.likeness_within(run) for run in self.runs] for part in parts]))
        shifts = np.full(len(parts), np.nan)
        shifts[[i for i, _ in pairs]] = self.samples[[j for _, j in pairs]]
        return shifts if len(pairs) == len(parts) else None


@dataclass(frozen=True)
class _Part:
    """From where to where times of a part run, s, its rows, and the UTC at its zero, NaN where unknown."""

    begin: float
    end: float
    rows: int
    unix_at_zero: float

    def shared(self, other: "_Part") -> float:
        """How long both run, s."""
        return max(0.0, min(self.end, other.end) - max(self.begin, other.begin))

    def likeness(self, other: "_Part") -> float:
        """How much of the time in which either runs both do, 0 to 1: parts of one run begin and end together."""
        return self.shared(other) / max(max(self.end, other.end) - min(self.begin, other.begin), 1e-9)

    def likeness_within(self, run: "_Part") -> float:
        """The same, 0 for a part that goes on after the run has ended."""
        return self.likeness(run) if self.end < run.end + RESTART_STEP else 0.0


def pair_parts(samples_t: Array, fixes_t: Array, unix_s: Array, files: str) -> Restarts | None:
    """Which parts of samples (N,) s belong to which of fixes (M,) s, by their order; None where one has one part only.

    unix_s (M,) s : UTC of the fixes, NaN where unknown. files : their names, for the sentence.
    """
    samples, fixes = _parts_of(samples_t, np.full(samples_t.size, np.nan)), _parts_of(fixes_t, unix_s)
    if not (1 < len(samples) <= MOST_PARTS and 1 < len(fixes) <= MOST_PARTS):
        return None
    shared = np.array([[part.shared(other) for other in fixes] for part in samples])
    pairs = _in_order(np.array([[part.likeness(other) for other in fixes] for part in samples]))
    if not pairs:
        return None
    shifts = _by_utc([(samples[i], fixes[j]) for i, j in pairs])
    if shifts is None:
        pairs, shifts = [max(pairs, key=lambda pair: shared[pair])], [0.0]
    of_samples, of_fixes = np.full(len(samples), np.nan), np.full(len(fixes), np.nan)
    of_samples[[i for i, _ in pairs]] = of_fixes[[j for _, j in pairs]] = shifts
    lost = sum(part.rows for part, shift in zip(samples, of_samples, strict=True) if np.isnan(shift))
    lost += sum(part.rows for part, shift in zip(fixes, of_fixes, strict=True) if np.isnan(shift))
    problem = _said(samples, [i for i, _ in pairs], shifts, lost, files)
    return Restarts(of_samples, of_fixes, problem, samples)


def _said(samples: list[_Part], used: list[int], shifts: list[float], lost: int, files: str) -> Problem:
    if len(used) > 1:
        at = listed([f"{samples[i].end + shift:.0f} s" for i, shift in zip(used[:-1], shifts[:-1], strict=True)])
        rest = f"; {counted(lost, 'row')} left out, of parts that only one file has" if lost else ""
        return Problem("clock_joined", f"{files}: the clock started again at {at}; joined by UTC{rest}", len(used) - 1)
    part = samples[used[0]]
    text = (
        f"{files}: the clock started again; of {len(samples)} parts number {used[0] + 1} is used ({part.begin:.0f} to "
        f"{part.end:.0f} s), in which both ran together longest, {counted(lost, 'row')} left out; for the others split "
        "both files there, or write UTC beside the fixes"
    )
    return Problem("clock_restart", text, lost)


def over_restarts(t: Array, shifts: Array) -> tuple[Array, BoolArray]:
    """Times (N,) s with the shift of their part added, and the mask (N,) of the rows whose part is used."""
    shifted = t + shifts[parts_between_restarts(t)]
    return shifted, np.isfinite(shifted) | ~np.isfinite(t)


def number_of_parts(t: Array) -> int:
    """Into how many parts the restarts of its clock cut times (N,) s, N > 0."""
    return int(parts_between_restarts(t)[-1]) + 1


def _parts_of(t: Array, unix_s: Array) -> list[_Part]:
    part, parts = parts_between_restarts(t), []
    for number in range(min(number_of_parts(t), MOST_PARTS + 1)):
        inside = (part == number) & np.isfinite(t)
        times, at_zero = t[inside], (unix_s - t)[inside]
        times = times[np.abs(times - np.percentile(times, 50, method="nearest")) < DAY]  # without stray stamps
        known = at_zero[np.isfinite(at_zero)]
        parts.append(_Part(times[0], times[-1], times.size, float(np.median(known)) if known.size else np.nan))
    return parts


def _in_order(shared: Array) -> list[tuple[int, int]]:
    """Pairs of parts that run together, (K, L) s long: each with that of its number, or where some are missing in one
    file, those in order that share most."""
    k, count = shared.shape
    if k == count:
        return [(i, i) for i in range(k)]
    best: list[list[tuple[float, list[tuple[int, int]]]]] = [[(0.0, [])] * (count + 1) for _ in range(k + 1)]
    for i in range(k):
        for j in range(count):
            time, pairs = best[i][j]
            options = (best[i][j + 1], best[i + 1][j], (time + float(shared[i, j]), [*pairs, (i, j)]))
            best[i + 1][j + 1] = max(options, key=lambda option: option[0])
    return best[k][count][1]


def _by_utc(pairs: list[tuple[_Part, _Part]]) -> list[float] | None:
    """Shift of each pair, s, so that all run on the clock of the first; None where UTC does not tell, or goes back."""
    shifts = [0.0, *(fixes.unix_at_zero - pairs[0][1].unix_at_zero for _, fixes in pairs[1:])]
    begins = [min(part.begin for part in pair) + shift for pair, shift in zip(pairs, shifts, strict=True)]
    ends = [max(part.end for part in pair) + shift for pair, shift in zip(pairs, shifts, strict=True)]
    goes_on = [begin > end for begin, end in zip(begins[1:], ends[:-1], strict=True)]  # never where UTC is unknown
    return shifts if all(goes_on) else None
