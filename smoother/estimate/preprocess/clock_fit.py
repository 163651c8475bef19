"""The clock that the lags of the stretches ask for: a line with steps, each of which has to be significant.

Each axis has a lag of its own, which slip and lean make; what changes, changes for all three alike. A drift or a step
stays where it is SIGNIFICANT, where no axis contradicts it, and where nothing gradual explains a step as well.
"""

import math
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from smoother.arrays import Array, median
from smoother.estimate.averages import WINDOW
from smoother.estimate.path_motion import PathMotion, path_axes
from smoother.estimate.preprocess.clock import ClockStep
from smoother.estimate.preprocess.streams import FEWEST_STRETCHES, Measured, Streams
from smoother.trajectory import ClockMove

SIGNIFICANT = 5.0  # sigmas of a drift or a step
SIDE, MOST_STEPS = 25.0, 2  # s of driving on either side of a step; a receiver settles, and a spin is over, in less
BLOCKS = 10  # of a session, which err independently
ALIKE = 0.25  # of a drift or step, by which axes may differ unless by their own sigmas; a real kart's slip makes 0.33
ROUNDS, ROBUST = 6, 3.0  # of reweighting; sigmas
LARGEST_DRIFT = 0.03  # more is no clock
LASTS, GRADUAL = (
    (30.0, 40.0, 60.0, 90.0, 120.0, 240.0),
    16.0,
)  # s, for which a change may last; squared sigmas that tell it
CHOSEN = 9.0  # squared sigmas that the choice of a moment makes up for a step
# s rms of what the lags of the three axes have in common beside their usual ones, and its part of the spacing of fixes:
# simulated karts have 0.002 to 0.006, real karts and cars 0.002 to 0.017, at 1 Hz 0.02
LEAST, LEAST_OF_SPACING = 0.03, 0.1
ALIKE_LEFT = 0.75  # correlation between any two axes; 0.8 and more where the lag changes, 0.7 and less by chance
KNOWN = 0.3  # of the stretches, at least, that show all three lags
EVIDENCE = 4.0  # of the cost of independent fixes, by which a moment is as good as the best
TRACE = 0.05  # s, by which a hole in the stamps may differ from the step
TINY = 1e-12


@dataclass(frozen=True, eq=False)
class Change:
    """How much, s, lags change by a drift over the session or by a step: of all axes, and of each (3,)."""

    value: float
    sigma: float
    by_axis: Array
    sigma_by_axis: Array

    @property
    def is_sure(self) -> bool:
        """Whether it is significant, and no axis contradicts it."""
        allowed = np.maximum(3.0 * self.sigma_by_axis, ALIKE * abs(self.value))
        return abs(self.value) > SIGNIFICANT * self.sigma and bool(np.all(np.abs(self.by_axis - self.value) < allowed))


@dataclass(frozen=True, eq=False)
class LagFit:
    """Lags of stretches as a clock makes them: steps (K,) s, and changes, K of steps, then the drift if `is_line`.

    usual (B, 3) s: lags by this; rest (B, 3) s: what is left of them, 0 where nothing shows; cost: robust sum of its
    squares in sigmas.
    """

    steps: tuple[float, ...]
    is_line: bool
    changes: tuple[Change, ...]
    usual: Array
    rest: Array
    cost: float

    @property
    def drift(self) -> Change | None:
        """How much the lag grows from the first to the last stretch, s; None where that was not fitted."""
        return self.changes[-1] if self.is_line else None


def fit_clock(streams: Streams) -> LagFit:
    """Return the lags with as few changes as they ask for, without any if these leave lags that change all the same."""
    edges = 0.5 * (streams.last[:-1] + streams.first[1:])
    driven = np.cumsum(streams.last - streams.first)[:-1]
    best = fit_lags(streams)
    while True:
        options = [] if best.is_line else [fit_lags(streams, best.steps, is_line=True)]
        taken = [0.0, *(driven[np.searchsorted(edges, step)] for step in best.steps), float(driven[-1]) + SIDE / 2.5]
        far = np.min(np.abs(np.subtract.outer(driven, taken)), axis=1) > SIDE
        if len(best.steps) < MOST_STEPS:
            for edge in edges[far].tolist():
                options.append(fit_lags(streams, (*best.steps, edge), is_line=best.is_line))
        better = min(options, key=lambda option: option.cost + CHOSEN * len(option.steps), default=best)
        if not best.cost - better.cost > SIGNIFICANT**2:
            break
        best = better
    best = _without_doubtful(streams, best)
    for at in best.steps:
        streams = _without_transition(streams, best, at)
    return best if common_change(streams, best) is None else fit_lags(streams)


def fit_lags(
    streams: Streams, steps: tuple[float, ...] = (), *, is_line: bool = False, lasting: dict[float, float] | None = None
) -> LagFit:
    """Fit lags by steps (K,) s, each of which may be `lasting` so many s, and a line."""
    t, known = streams.t, streams.is_known
    steps = tuple(sorted(steps))
    columns = [np.clip((t - at) / max((lasting or {}).get(at, 0.0), TINY) + 0.5, 0.0, 1.0) for at in steps]
    columns += [(t - t[0]) / max(float(np.ptp(t)), TINY)] if is_line else []
    design = np.stack(columns, axis=1) if columns else np.zeros((len(t), 0))
    sigma = np.where(known, streams.sigma, 1.0)
    lag, weight = np.where(known, streams.lag, 0.0), known / sigma**2
    start = np.array([np.median(own[some]) if some.any() else 0.0 for own, some in zip(lag.T, known.T, strict=True)])
    system, rest = None, np.where(known, lag - start, 0.0)
    for _ in range(ROUNDS):
        system = _System.of(design, lag, weight / (1.0 + (rest / (ROBUST * sigma)) ** 2))
        rest = np.where(known, system.rest(system.solution), 0.0)
    assert system is not None
    cost = float(np.sum(known * ROBUST**2 * np.log1p((rest / (ROBUST * sigma)) ** 2)))
    usual = lag - system.rest(system.solution)
    return LagFit(steps, is_line, system.changes(), usual, rest, cost)


@dataclass(frozen=True, eq=False)
class _System:
    """Weighted least squares of lags by columns that all axes have in common, and an intercept of each.

    design (B, 3, K) and lag (B, 3) less their means of each axis; weight (B, 3).
    """

    design: Array
    lag: Array
    weight: Array

    @classmethod
    def of(cls, design: Array, lag: Array, weight: Array) -> "_System":
        """Of a design (B, K), lags (B, 3) s and their weights (B, 3)."""
        total = np.maximum(weight.sum(axis=0), TINY)
        mean = (weight.T @ design) / total[:, None]
        return cls(design[:, None] - mean, lag - np.sum(weight * lag, axis=0) / total, weight)

    @property
    def solution(self) -> Array:
        """The changes (K,) s of all axes."""
        return self._solved(slice(None))[0]

    def rest(self, solution: Array) -> Array:
        """What changes (K,) leave of the lags, (B, 3) s."""
        return np.asarray(self.lag - self.design @ solution)

    def changes(self) -> tuple[Change, ...]:
        """The changes with their sigmas, by all axes and by each for itself.

        An error of the path along the track is one of all axes: together they know no better than the best does, and
        than what they contradict one another by.
        """
        value, covariance = self._solved(slice(None))
        each = [self._solved(slice(i, i + 1)) for i in range(3)]
        own = np.array([one[0] for one in each])
        own_sigma = np.sqrt(np.array([np.diag(one[1]) for one in each]))
        out = []
        for k in range(len(value)):
            at_odds = math.sqrt(float(np.sum(((own[:, k] - value[k]) / np.maximum(own_sigma[:, k], TINY)) ** 2)) / 2.0)
            sigma = max(math.sqrt(covariance[k, k]) * max(1.0, at_odds), float(np.min(own_sigma[:, k])))
            out.append(Change(float(value[k]), sigma, own[:, k], own_sigma[:, k]))
        return tuple(out)

    def _solved(self, axes: slice) -> tuple[Array, Array]:
        """Changes (K,) s by some axes, and their variances: by weights, or by the scatter between blocks if larger.

        Source: White 1980, of clusters.
        """
        design, lag, weight = self.design[:, axes], self.lag[:, axes], self.weight[:, axes]
        inverse = np.linalg.pinv(np.einsum("bi,bik,bil->kl", weight, design, design))
        solution = inverse @ np.einsum("bi,bik,bi->k", weight, design, lag)
        scores = np.einsum("bi,bik,bi->bk", weight, design, lag - design @ solution)
        blocks = np.add.reduceat(scores, np.unique(np.arange(BLOCKS) * len(lag) // BLOCKS), axis=0)
        if not np.all(np.diag(inverse) > 0.0):
            return solution, np.full_like(inverse, np.inf)
        covariance = inverse @ (blocks.T @ blocks) @ inverse
        larger = np.sqrt(np.maximum(np.diag(covariance), np.diag(inverse)))
        return solution, np.diag(larger**2)


def _without_doubtful(streams: Streams, fit: LagFit) -> LagFit:
    """The fit without changes that are not sure, or steps that are gradual; the least sure is left out first."""
    while fit.changes:
        doubtful = [k for k in range(len(fit.changes)) if not _is_believed(streams, fit, k)]
        if not doubtful:
            break
        out = min(doubtful, key=lambda k: abs(fit.changes[k].value) / fit.changes[k].sigma)
        is_line = fit.is_line and out < len(fit.steps)
        fit = fit_lags(streams, tuple(step for k, step in enumerate(fit.steps) if k != out), is_line=is_line)
    return fit


def _is_believed(streams: Streams, fit: LagFit, k: int) -> bool:
    """Whether the change k is sure, and abrupt if it is a step, or slow enough for a clock if it is the drift."""
    change = fit.changes[k]
    if not change.is_sure:
        return False
    if k == len(fit.steps):
        return abs(change.value) < LARGEST_DRIFT * float(np.ptp(streams.t))
    at, others = fit.steps[k], [step for step in fit.steps if step != fit.steps[k]]
    streams = _without_transition(streams, fit, at)
    abrupt = fit_lags(streams, fit.steps, is_line=fit.is_line).cost
    gradual = [
        fit_lags(streams, (*others, at + late * seconds), is_line=fit.is_line, lasting={at + late * seconds: seconds})
        for seconds in LASTS
        for late in (-0.25, 0.0, 0.25)
    ]
    return abrupt < min(other.cost for other in gradual) + GRADUAL


def _without_transition(streams: Streams, fit: LagFit, at: float) -> Streams:
    """The streams without the stretch beside a step that fits worse: the step may be in the midst of it."""
    after = int(np.searchsorted(streams.t, at))
    rest = np.linalg.norm(fit.rest[after - 1 : after + 1], axis=1)
    sigma = streams.sigma.copy()
    sigma[after - 1 + int(np.argmax(rest))] = np.inf
    return replace(streams, sigma=sigma)


def common_change(streams: Streams, fit: LagFit) -> Array | None:
    """By how much, (B,) s, all axes alike are later than a fit says, the least of them; None where it is by chance."""
    rest, known = fit.rest, np.asarray(streams.is_known.all(axis=1))
    if np.count_nonzero(known) < max(FEWEST_STRETCHES, KNOWN * len(known)):
        return None
    alike = np.asarray(np.corrcoef(rest[known].T))
    if not all(alike[i, j] > ALIKE_LEFT for i, j in combinations(range(3), 2)):
        return None
    sign = np.sign(rest)
    change = np.where(known & (np.abs(sign.sum(axis=1)) == 3.0), sign[:, 0] * np.min(np.abs(rest), axis=1), 0.0)
    least = max(LEAST, LEAST_OF_SPACING * streams.spacing)
    return change if float(np.sqrt(np.mean(change[known] ** 2))) > least else None


def place_step(
    streams: Streams, fit: LagFit, k: int, measured: Measured, path: PathMotion, stamps: tuple[Array, Array]
) -> ClockStep:
    """Return the step k of a fit: when it was by the fixes around it, and what takes it out of the stamps.

    stamps: of the samples (M,) s and of the fixes (N,) s.
    """
    at, size = fit.steps[k], fit.changes[k].value
    k_before = int(np.searchsorted(streams.t, at)) - 1
    before = fit.usual[k_before]
    beside = slice(max(k_before - 2, 0), k_before + 4)
    around = streams.first[beside][0], streams.last[beside][-1]
    rows = np.flatnonzero(path.moves & (path.t >= around[0]) & (path.t <= around[1]))
    first, moment, last = _moment(measured, path.t[rows], path_axes(path)[rows], before, before + size)
    samples, fixes = stamps
    lag = median(before)
    step = ClockStep(moment, size, fit.changes[k].sigma, first, last, _hole_made(moment, lag, size))
    return _traced(step, lag, samples, fixes)


def _moment(measured: Measured, t: Array, axes: Array, before: Array, after: Array) -> tuple[float, float, float]:
    """When lags (3,) s change from `before` to `after`, by fixes at t (N,) s with axes (N, 3) of the path.

    Since when, when most likely, and until when.
    """
    costs = np.zeros((2, len(t)))
    for i in range(3):
        here = np.stack([measured.at(t - lag[i])[i] for lag in (before, after)])
        rest = np.abs(here - axes[:, i] - np.median(here - axes[:, i]))
        scatter = median(np.min(rest, axis=0)) + 1e-9
        costs += np.log1p((rest / (2.0 * scatter)) ** 2)
    cost = np.cumsum(costs[0] - costs[1])[:-1]
    best = int(np.argmin(cost))
    near = np.flatnonzero(cost <= cost[best] + EVIDENCE * max(1.0, WINDOW / max(median(np.diff(t)), 1e-3)))
    return float(t[near[0]]), 0.5 * float(t[best] + t[best + 1]), float(t[near[-1] + 1])


def _hole_made(moment: float, lag: float, size: float) -> ClockMove:
    """The move that makes a hole at the moment: of the samples where fixes come later from there on, else of fixes.

    Fixes that came while samples were lost tell neither side; the moment was found amid them.
    """
    return ClockMove(False, moment - lag - 0.5 * size, size) if size > 0.0 else ClockMove(True, moment, -size)


def _traced(step: ClockStep, lag: float, samples: Array, fixes: Array) -> ClockStep:
    """The step with what is moved for it, and its moment where stamps left a trace of it.

    What leaves a hole of its own size in the stamps of one is moved up to close it. What leaves none has lost rows and
    counted on, or its stamps went back over rows that were left out: then what follows is moved off, and makes a hole.
    """
    t, size = fixes if step.size > 0.0 else samples + lag, abs(step.size)
    hole = _hole(t, step.first, step.last, size)
    if hole is None:
        return step
    by = -min(size, float(t[hole + 1] - t[hole]) - 0.5 * float(np.median(np.diff(t))))
    moves_fixes = step.size > 0.0
    move = ClockMove(moves_fixes, float((fixes if moves_fixes else samples)[hole]), by)
    at = float(t[hole + 1] if moves_fixes else t[hole])
    return replace(step, t=at, first=at, last=at, move=move)


def _hole(t: Array, first: float, last: float, size: float) -> int | None:
    """Row of t (N,) s, from about `first` to `last`, after which `size` s more than usual are missing; None if none."""
    rows = np.flatnonzero((t[:-1] > first - WINDOW - size) & (t[1:] < last + WINDOW + size))
    if not rows.size:
        return None
    usual = float(np.median(np.diff(t)))
    off = np.abs(t[rows + 1] - t[rows] - usual - size)
    best = int(np.argmin(off))
    return int(rows[best]) if off[best] < max(TRACE, 0.2 * size) and size > 0.3 * usual else None
