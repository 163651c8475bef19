"""Jumps beside outages: runs of fixes there that are displaced together, and that robust weights cannot see.

In the middle of a drive the fixes around a jump and the samples speak against it. Beside an outage only one side does:
on the other the path is free to bend, and twenty displaced fixes in a row draw it to themselves and keep full weight.
So the fixes beside outages are predicted from all others, and a run of them has jumped together that leaves the
prediction with a step. How far off the path across the outage is has no say: right fixes after an outage are far from
it as a rule, but not from what follows them.

Source: Willsky & Jones 1976 (generalised likelihood ratio of a jump).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.gnss_screen import most_say_velocity
from smoother.estimate.graph.batch import Batch, Solved
from smoother.estimate.graph.chain import NotPositiveDefiniteError
from smoother.estimate.graph.coarse import EVERY, thinned
from smoother.estimate.graph.inputs import Noise
from smoother.estimate.graph.parts import stretch
from smoother.estimate.graph.start import Start
from smoother.estimate.graph.state import CONSTANTS_SIZE, ROW_CONSTANTS_SIZE

OUTAGE = 2.5  # s; across a shorter one the samples tell where the path goes on
PREDICTED = 6.0  # s beside an outage that are predicted, at most a third of the time to the next one
AT_OUTAGE = 0.02  # rad, rms, that the step before the one that predicts moves attitudes by: outages stretch the rest
LONGEST_JUMP = 0.5  # of that time; of a longer run it cannot be told whether it or what lies beside it is displaced
LEAST_JUMP = 5.0  # m; receivers wander by less within seconds, and karts slide by less
SURE = 30.0  # squared size of a jump over its variance, of two components; 5 sigmas leave 3e-7
WELL_PREDICTED = 4.0  # mean squared innovation over its variance, beyond which the prediction is no judge
MOST_RUNS = 4  # beside one outage; of a receiver that jumps more often nobody knows what is right
AROUND = 45.0  # s to either side of an outage that predict the fixes beside it; the offset lasts as long
LONGEST_WINDOW = 1200.0  # s; more at once would take the memory of long sessions


@dataclass(frozen=True, eq=False)
class Innovations:
    """Innovations of m fixes, m, north and west in turns (2 m,), with their covariance (2 m, 2 m)."""

    values: Array
    covariance: Array

    @property
    def mean_square(self) -> float:
        """Mean square over its expectation, 1 where the prediction keeps what it promises."""
        return float(self.values @ np.linalg.solve(self.covariance, self.values)) / len(self.values)

    def without(self, fixes: IntArray) -> "Innovations":
        """Return those of all other fixes."""
        keep = np.delete(np.arange(len(self.values)).reshape(-1, 2), fixes, axis=0).ravel()
        return Innovations(self.values[keep], self.covariance[np.ix_(keep, keep)])


@dataclass(frozen=True, eq=False)
class Run:
    """Fixes in a row that a common displacement of `size` m explains; certainty: its square over its variance."""

    fixes: IntArray
    size: float
    certainty: float


def jumped_beside_outages(start: Start, noise: Noise, iterations: int, *, with_doppler: bool = True) -> Array:
    """Return the times (J,) s of the fixes that jumped beside an outage.

    with_doppler: also of fixes with Doppler, most of which the first look at them has seen already (gnss_screen).
    One keyframe in EVERY predicts well enough, after `iterations` Gauss-Newton steps at most. A prediction that fails
    finds nothing.
    """
    found = [np.empty(0)]
    for part in _windows(start):
        t = part.data.t
        known = np.flatnonzero(np.isfinite(part.data.position_n[:, 0]))
        beside = [known[fixes] for fixes in beside_outages(t[known])]
        beside = [fixes for fixes in beside if with_doppler or not most_say_velocity(part.data.velocity_n[fixes])]
        if beside:
            try:
                solved = _predicted(thinned(part, EVERY), np.concatenate(beside), noise, iterations)
            except NotPositiveDefiniteError:
                continue
            found += [t[fixes[jumped(t[fixes], _innovations(solved, fixes))]] for fixes in beside]
    return np.unique(np.concatenate(found))


def _windows(start: Start) -> Iterator[Start]:
    """Yield the stretches around the outages, those that overlap together, up to some length."""
    known = start.data.t[np.isfinite(start.data.position_n[:, 0])]
    before = np.flatnonzero(np.diff(known) > OUTAGE)
    reaches: list[tuple[float, float]] = []
    for begin, end in zip(known[before] - AROUND, known[before + 1] + AROUND, strict=True):
        if reaches and begin < reaches[-1][1] and end - reaches[-1][0] < LONGEST_WINDOW:
            reaches[-1] = reaches[-1][0], end
        else:
            reaches.append((begin, end))
    t = start.state.t
    for begin, end in reaches:
        first, last = np.searchsorted(t, [begin, end])
        yield stretch(start, int(first), min(int(last), len(t) - 1))


def beside_outages(t: Array) -> Iterator[IntArray]:
    """Yield the fixes of t (N,) s on either side of each outage, where enough others are left to predict them."""
    runs = np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > OUTAGE) + 1)
    for i, run in enumerate(runs):
        if len(run) < 2:
            continue
        reach = min(PREDICTED, float(t[run[-1]] - t[run[0]]) / 3.0)
        after, before = run[t[run] < t[run[0]] + reach], run[t[run] > t[run[-1]] - reach]
        if i > 0 and len(after) > 1:
            yield after
        if i + 1 < len(runs) and len(before) > 1:
            yield before


def _predicted(start: Start, beside: IntArray, noise: Noise, iterations: int) -> Solved:
    """Solve without the positions of the fixes `beside`: their residuals are innovations then."""
    doubted = np.zeros(len(start.data.t), dtype=np.bool_)
    doubted[beside] = True
    batch = Batch(replace(start.data, doubted=doubted), start.binned, start.priors)
    graph = batch.graph(start.state, noise)
    return batch.step(graph, batch.approach(graph, start.state, noise, AT_OUTAGE, iterations), noise)


def _innovations(solved: Solved, fixes: IntArray) -> Innovations:
    rows, factor = solved.rows["gps_position"], solved.solution.factor
    assert factor is not None
    n = 2 * len(fixes)
    constants = np.zeros((n, CONSTANTS_SIZE))
    constants[:, :ROW_CONSTANTS_SIZE] = rows.constants[fixes, :2].reshape(n, -1)
    left, right = (J[fixes, :2].reshape(n, -1) for J in (rows.left, rows.right))
    P = factor.covariance(np.repeat(rows.interval[fixes], 2), left, right, constants)
    return Innovations(rows.residual[fixes, :2].ravel(), P + np.diag(rows.sigma[fixes, :2].ravel() ** 2))


def jumped(t: Array, innovations: Innovations) -> IntArray:
    """Return which of the fixes at t (m,) s have jumped, run by run, the most certain one first.

    All runs or none: what remains must be as near to the prediction as it should be, or something else is wrong.
    """
    longest, runs = LONGEST_JUMP * float(t[-1] - t[0]), [np.empty(0, dtype=np.int64)]
    index, least = np.arange(len(t)), np.inf
    for _ in range(MOST_RUNS):
        run = best_run(t[index], innovations, longest)
        if run.certainty < SURE or run.size < LEAST_JUMP or len(run.fixes) == len(index):
            break
        runs.append(index[run.fixes])
        least = min(least, run.certainty)
        innovations, index = innovations.without(run.fixes), np.delete(index, run.fixes)
    left = innovations.mean_square
    return np.concatenate(runs if left < WELL_PREDICTED and least > SURE * max(left, 1.0) else runs[:1])


def best_run(t: Array, innovations: Innovations, longest: float) -> Run:
    """Return the run of fixes at t (m,) s, from first to last no longer than `longest` s, that is the most certain.

    The common displacement d of fixes a to b, with innovations r of covariance C and E that repeats d for each of them,
    is (E' C^-1 E)^-1 E' C^-1 r, and its certainty d' (E' C^-1 E) d: differences of cumulative sums for all a and b.
    """
    m = len(t)
    weight = np.linalg.inv(innovations.covariance)
    pull, information = np.zeros((m + 1, 2)), np.zeros((m + 1, m + 1, 2, 2))
    pull[1:] = np.cumsum((weight @ innovations.values).reshape(m, 2), axis=0)
    blocks = weight.reshape(m, 2, m, 2).transpose(0, 2, 1, 3)
    information[1:, 1:] = np.cumsum(np.cumsum(blocks, axis=0), axis=1)
    first, last = np.nonzero(np.triu(t[None, :] - t[:, None] <= longest))
    end = last + 1
    of_run = information[end, end] - information[first, end] - information[end, first] + information[first, first]
    of_pull = pull[end] - pull[first]
    size = np.linalg.solve(of_run, of_pull[:, :, None])[:, :, 0]
    certainty = np.sum(size * of_pull, axis=1)
    best = int(np.argmax(certainty))
    return Run(np.arange(first[best], end[best]), float(np.hypot(*size[best])), float(certainty[best]))
