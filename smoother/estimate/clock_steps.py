"""Stamps that jump: from some moment on, fixes are late behind the samples by more, or by less, than before.

A logger that loses samples and counts on, a stall, two files joined, or a phone whose radio takes longer from then on,
leave a delay that is one value before and another one after. Each value explains each fix well or badly; where two of
them explain clearly more than one does, the delay may have stepped. It is believed to where forward force, left force
and yaw rate say the same of it, beside a drift that may be there too, and every stretch on either side agrees with its
own side: slip, spins, filters and receivers that coast change the delay for a while, gradually, or of one axis.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import PurePath

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.estimate.averages import WINDOW, averages_of
from smoother.estimate.delays import Felt, Said, common, said
from smoother.estimate.initial.align import Alignment
from smoother.estimate.path_motion import PathMotion, path_axes, sampled_at_speed, thinned
from smoother.samples import Problem, Session
from smoother.trajectory import ClockMove, Identified

SIDE = 25.0  # s of driving before and after; a receiver settles, and a spin is over, in less
FEWEST, FEW, ENOUGH = 100, 400, 4000  # fixes, evenly taken
# s about the delay of the whole session, that are tried: finely where most delays are
NEAR, NEARLY, FAR, FARTHER = 0.6, 0.05, 2.2, 0.1
# Of the cost of a fix, that a step saves on average. Of 580 sessions without one 0.03 at most is saved by what passes
# for a step otherwise, and with one of 0.15 s 0.06 to 0.7.
LEAST_SAVED = 0.05
ROUNDS = 3  # of reweighting
MOVES, SETTLED = 6, 0.002  # of Gauss-Newton, and s by which the last may move
PLACED = 0.3  # s, by which the moment still moves when it is found
SIGNIFICANT = 5.0  # sigmas
UNLIKE = 0.25  # of the step, by which axes may differ unless by their own sigmas
UNEVEN = 0.3  # of the step, by which a stretch of one side may be off; never more than AWAY
AWAY = 0.5
STRETCH, MOST_STRETCHES = 20.0, 4  # s of a side that are looked at each for itself
DRIFTS = 0.75  # of the step, that a drift beside it may make up over the session
SMALLEST = 0.06  # s
# s, of fixes more than QUICK s apart, or whose velocities are those of positions: the path is less well known
SMALLEST_OF_FEW, QUICK = 0.3, 0.3
# s between fixes: in more a kart goes round a bend. Of a real one, with a fix in 2 s, steps of 0.5 and 0.7 s were found
SLOWEST = 1.5
UNSURE_OF_FEW = 0.1  # s likewise, by which sizes were off, by more than their sigmas
EVIDENCE = 4.0  # of the cost of independent fixes, by which a moment is as good as the best
LASTS = (8.0, 16.0, 32.0, 64.0, 128.0)  # s, for which a delay may change that does not step
# s; where the moment is known no better, nothing is taken out: an outage as long costs less than a step
UNPLACED = 20.0
TRACE = 0.05  # s, by which what stamps leave out may differ from the step
LEAST_GAIN = 0.5  # of 1, at which most axes tell what was felt on both sides; a box that was turned round has less
LARGEST = 2.1  # s
DIFFERENCE = np.array([-1.0, 1.0, 0.0])  # after less before, of what axes say of before, after, and drift
BEFORE, AFTER, DRIFT = np.eye(3)
ONE = np.ones(1)
DELAYS = ("gps_position_latency", "gps_velocity_latency")


@dataclass(frozen=True)
class ClockStep:
    """From `t` s on, by the clock of the fixes, they are late behind the samples by `size` s more than `lag`.

    It was between `first` and `last` s. move: what takes it out.
    """

    t: float
    size: float
    sigma: float
    lag: float
    first: float
    last: float
    move: ClockMove

    @property
    def is_placed(self) -> bool:
        """Whether the moment is known well enough to take the step out."""
        return self.last - self.first <= UNPLACED


def clock_steps(imu_t: Array, fixes_t: Array, felt: Felt, path: PathMotion, use: IntArray) -> tuple[ClockStep, ...]:
    """Find steps in the delay of a path behind what was felt; see the module's text.

    imu_t, fixes_t: stamps s of samples and fixes. use: fixes of the path at speed that have samples around them.
    """
    every = median(np.diff(path.t)) if len(path.t) > 1 else math.inf
    if use.size < FEWEST or every > SLOWEST or float(path.t[use[-1]] - path.t[use[0]]) < 2.0 * SIDE:
        return ()
    axes, rows = path_axes(path), thinned(use, FEW)
    seams, lags = _segments(felt, path.t[rows], axes[rows])
    if not len(seams):
        return ()
    tells_much = path.is_measured and every <= QUICK
    smallest, unsure = (SMALLEST, 0.0) if tells_much else (SMALLEST_OF_FEW, UNSURE_OF_FEW)
    ends = np.concatenate([[-np.inf], seams, [np.inf]])
    found = []
    for k, seam in enumerate(seams):
        beside = thinned(use[(path.t[use] > ends[k]) & (path.t[use] <= ends[k + 2])], ENOUGH)
        step = _judged(_Sides(felt, path.t[beside], axes[beside], seam, lags[k], lags[k + 1]), smallest)
        if step is None:  # what else changes the delay may be what the others are, too
            return ()
        found.append(_traced(replace(step, sigma=max(step.sigma, unsure)), imu_t, fixes_t))
    return tuple(found)


def session_steps(session: Session, path: PathMotion, alignment: Alignment) -> tuple[ClockStep, ...]:
    """Find the steps of a session; `alignment` is that of all of it with the path."""
    assert session.imu is not None
    felt, use = Felt(averages_of(session.imu), alignment), sampled_at_speed(session.imu, path)
    return clock_steps(session.imu.t, session.gnss.t, felt, path, use)


def moves_of(steps: tuple[ClockStep, ...]) -> tuple[ClockMove, ...]:
    """What takes steps out; those that are not placed stay."""
    return tuple(step.move for step in steps if step.is_placed)


def beside_steps(session: Session, steps: tuple[ClockStep, ...]) -> BoolArray:
    """Mask (N,) of the fixes of which nobody knows whether they came before or after a step, of a session as given."""
    out = np.zeros(len(session.gnss), dtype=np.bool_)
    for step in steps:
        out |= step.is_placed & (session.gnss.t > step.first) & (session.gnss.t < step.last)
    return out


def step_problems(steps: tuple[ClockStep, ...], session: Session) -> tuple[Problem, ...]:
    """Say what stepped, when, and by how much, and what was done."""
    return tuple(Problem("clock_step", _text(step, session)) for step in steps)


def of_both_sides(identified: dict[str, Identified], steps: tuple[ClockStep, ...]) -> dict[str, Identified]:
    """What was identified, with delays as unsure as of a session put together of parts with steps known so well.

    Of a step that was not taken out the delay is half of it off on either side.
    """
    off = 0.5 * math.sqrt(sum(step.sigma**2 if step.is_placed else step.size**2 for step in steps))
    return identified | {name: _less_sure(identified[name], off) for name in DELAYS if name in identified}


def _less_sure(value: Identified, off: float) -> Identified:
    return replace(value, sigma=math.hypot(value.sigma, off)) if isinstance(value.sigma, float) else value


def _text(step: ClockStep, session: Session) -> str:
    file, of_it = ("gps.csv", "fixes") if step.move.moves_fixes else ("imu.csv", "samples")
    named = f"{file}: " if any(PurePath(name).name == file for name in session.inputs) else ""
    text = (
        f"{named}{step.t - float(session.gnss.t[0]):.1f} s after the first fix stamps step: from there on fixes come "
        f"{abs(step.size):.2f} ± {step.sigma:.2f} s {'later' if step.size > 0.0 else 'earlier'} behind the samples"
    )
    if step.is_placed:
        return f"{text}; taken out of the times of the {of_it}. With columns of your own, stamp both by one clock"
    lasts = step.last - step.first
    return f"{text}, sometime in {lasts:.0f} s, so it is not taken out. Smooth what is before and after each for itself"


# Where the delay changes for good


def _segments(felt: Felt, t: Array, told: Array) -> tuple[Array, list[float]]:
    """Times of the seams between stretches of fixes at t (N,) s, told (N, 3), and the lag, s, of each stretch."""
    near, far = np.arange(-NEAR, NEAR + 1e-9, NEARLY), np.arange(NEAR + FARTHER, FAR + 1e-9, FARTHER)
    lags = felt.alignment.lag + np.concatenate([-far[::-1], near, far])
    here = felt.at(t - lags[:, None])
    driven = np.cumsum(np.minimum(np.diff(t, prepend=t[0]), 3.0 * float(np.median(np.diff(t)))))
    best, seams = np.full(len(t), int(np.argmin(np.abs(lags - felt.alignment.lag)))), list[int]()
    for least in (0.0, LEAST_SAVED, LEAST_SAVED):  # what the best step leaves tells what fixes scatter by
        cost = _cost(here, told, best)
        seams = _seams(cost, driven, least * len(t), is_one=least == 0.0)
        if not seams:
            return np.empty(0), []
        ends = [0, *seams, len(t)]
        of_each = [int(np.argmin(cost[:, i:j].sum(axis=1))) for i, j in pairwise(ends)]
        best = np.repeat(of_each, np.diff(ends))
    return 0.5 * (t[np.array(seams) - 1] + t[seams]), lags[of_each].tolist()


def _cost(here: Array, told: Array, best: IntArray) -> Array:
    """Cost (L, N) of each fix, told (N, 3), at each lag, where `here` (3, L, N) is felt; Cauchy's, of all axes.

    best (N,): lags by which gain, offset and scatter of each axis are known.
    """
    cost, column = np.zeros(here.shape[1:]), np.arange(len(told))
    for i in range(3):
        cost += _beside(_line(here[i, best, column], told[:, i]), here[i], told[:, i])
    return cost


def _beside(line: tuple[float, float, float], here: Array, told: Array) -> Array:
    """Cauchy's cost (..., N) of told (N,) beside a line over here (..., N): its gain, offset and scatter."""
    gain, offset, scatter = line
    return np.asarray(np.log1p(((told - gain * here - offset) / (2.0 * scatter)) ** 2))


def _line(here: Array, told: Array) -> tuple[float, float, float]:
    """Gain and offset of told (N,) over here (N,), with Cauchy weights, and the median distance from that line."""
    design, weight = np.stack([here, np.ones_like(here)]), np.ones_like(here)
    for _ in range(ROUNDS):
        weighted = design * weight
        line = np.linalg.lstsq(weighted @ design.T, weighted @ told, rcond=1e-12)[0]
        rest = np.abs(told - line @ design)
        scatter = median(rest) + 1e-9
        weight = 1.0 / (1.0 + (rest / (3.0 * scatter)) ** 2)
    return float(line[0]), float(line[1]), scatter


def _seams(cost: Array, driven: Array, least: float, *, is_one: bool = False) -> list[int]:
    """First rows of all stretches but the first, each of which saves `least`, of fixes with cost (L, N).

    driven (N,): s that they have driven. is_one: whether only the best is asked for.
    """
    before = np.cumsum(cost, axis=1)
    after = before[:, -1:] - before
    both = np.min(before, axis=0) + np.min(after, axis=0)
    both[(driven - driven[0] < SIDE) | (driven[-1] - driven < SIDE)] = np.inf
    k = int(np.argmin(both))
    if not float(np.min(before[:, -1])) - both[k] > least:
        return []
    middle = k + 1
    if is_one:
        return [middle]
    earlier = _seams(cost[:, :middle], driven[:middle], least)
    later = _seams(cost[:, middle:], driven[middle:], least)
    return [*earlier, middle, *(middle + row for row in later)]


# Whether it is a step


@dataclass(frozen=True, eq=False)
class _Sides:
    """Fixes at t (N,) s, told (N, 3), late by `before` s until `moment` and by `after` s from there, and `drift`."""

    felt: Felt
    t: Array
    told: Array
    moment: float
    before: float
    after: float
    drift: float = 0.0

    @property
    def size(self) -> float:
        """By how much the delay steps, s."""
        return self.after - self.before

    @property
    def is_later(self) -> BoolArray:
        """Mask (N,) of the fixes after the moment."""
        return np.asarray(self.t > self.moment)

    def at(self, before: float, after: float) -> Array:
        """When what is told was felt, (N,) s, with these delays."""
        return np.asarray(self.t - np.where(self.is_later, after, before) - self.drift * (self.t - self.moment))

    def said(self) -> list[Said]:
        """What each axis says of before, after and drift."""
        here, change = self.felt.with_change(self.at(self.before, self.after))
        since, later = self.t - self.moment, self.is_later
        parts = np.stack([~later * 1.0, later * 1.0, since])
        return [said(self.told[:, i], here[i], -change[i] * parts, since, DIFFERENCE) for i in range(3)]

    def fitted(self) -> tuple["_Sides", list[Said]]:
        """The same with the delays that explain most, and what the axes say of them."""
        sides = self
        for _ in range(MOVES):
            axes = sides.said()
            before, after, drift = (common(axes, part).mean for part in (BEFORE, AFTER, DRIFT))
            moved = sides.before + before, sides.after + after, sides.drift + drift
            sides = replace(sides, before=moved[0], after=moved[1], drift=moved[2])
            if not max(abs(before), abs(after)) > SETTLED:
                break
        return sides, axes

    def costs(self, *delays: Array) -> list[Array]:
        """Cost (N,) of each fix with each of some delays (N,) s in place of these."""
        late = self.drift * (self.t - self.moment)
        here = self.felt.at(self.at(self.before, self.after))
        felt = [self.felt.at(self.t - delay - late) for delay in delays]
        costs = [np.zeros(len(self.t)) for _ in delays]
        for i in range(3):
            line = _line(here[i], self.told[:, i])
            for cost, other in zip(costs, felt, strict=True):
                cost += _beside(line, other[i], self.told[:, i])
        return costs

    @property
    def evidence(self) -> float:
        """Cost by which one explanation is better than another; fixes within WINDOW say the same."""
        return EVIDENCE * max(1.0, WINDOW / max(float(np.median(np.diff(self.t))), 1e-3))


def _judged(sides: _Sides, smallest: float) -> ClockStep | None:
    """The step between two stretches; None where it is none, or not known well."""
    first = last = sides.moment
    axes: list[Said] = []
    for _ in range(ROUNDS):
        sides, axes = sides.fitted()
        if not abs(sides.size) < 2.0 * FAR:
            return None
        moment, first, last = _moment(sides)
        is_there = abs(moment - sides.moment) < PLACED
        sides = replace(sides, moment=moment)
        if is_there:
            break
    told, size = common(axes, DIFFERENCE), sides.size
    lasts = float(sides.t[-1] - sides.t[0])
    if not abs(size) > max(SIGNIFICANT * told.sure, smallest) or not told.are_alike(UNLIKE * abs(size)):
        return None
    uneven = _unevenness(sides)
    if abs(size) > LARGEST or abs(sides.drift) * lasts > DRIFTS * abs(size) or uneven is None:
        return None
    if not (_is_felt(sides) and _is_abrupt(sides, last - first)):
        return None
    return ClockStep(sides.moment, size, max(told.sure, uneven), sides.before, first, last, _hole_made(sides))


def _moment(sides: _Sides) -> tuple[float, float, float]:
    """When the step was that explains most, and between which times it explains nearly as much."""
    t = sides.t
    early, late = sides.costs(*(np.full(len(t), lag) for lag in (sides.before, sides.after)))
    cost = np.cumsum(early - late)
    best = int(np.argmin(cost[:-1]))
    near = np.flatnonzero(cost[:-1] <= cost[best] + sides.evidence)
    return 0.5 * float(t[best] + t[best + 1]), float(t[near[0]]), float(t[near[-1] + 1])


def _is_abrupt(sides: _Sides, unsure: float) -> bool:
    """Whether the delay steps; not where it explains more that it changes within seconds, or a minute or two.

    unsure: s, between which nothing tells when the step was; what changes meanwhile need not be told from it.
    """
    widths = (1e-6, *LASTS)
    changed = [np.clip((sides.t - sides.moment) / width + 0.5, 0.0, 1.0) for width in widths]
    costs = [float(cost.sum()) for cost in sides.costs(*(sides.before + sides.size * c for c in changed))]
    allowed = [sides.evidence if width <= unsure else 0.0 for width in widths]
    return all(costs[0] < cost + more for cost, more in zip(costs[1:], allowed[1:], strict=True))


def _is_felt(sides: _Sides) -> bool:
    """Whether what is told is what was felt, not its opposite, by most axes on both sides."""
    here = sides.felt.at(sides.at(sides.before, sides.after))
    for side in (~sides.is_later, sides.is_later):
        if np.median([_line(here[i, side], sides.told[side, i])[0] for i in range(3)]) < LEAST_GAIN:
            return False
    return True


def _unevenness(sides: _Sides) -> float | None:
    """How unsure, s, stretches of either side that are not as late as their side make the step.

    None where one is too far off: what comes and goes is no step.
    """
    here, change = sides.felt.with_change(sides.at(sides.before, sides.after))
    size, variance = abs(sides.size), 0.0
    for side in (~sides.is_later, sides.is_later):
        rows = np.flatnonzero(side)
        if len(rows) < FEWEST // 4:
            return None
        count = int(np.clip((sides.t[rows[-1]] - sides.t[rows[0]]) // STRETCH, 2, MOST_STRETCHES))
        for part in np.array_split(rows, count):
            axes = (sides.told.T[:, part], here[:, part], -change[:, None, part])
            each = [said(*axis, sides.t[part], ONE) for axis in zip(*axes, strict=True)]
            off = common(each, ONE)
            if not abs(off.mean) < min(max(3.0 * off.sigma, UNEVEN * size), AWAY * size):
                return None
            variance += off.mean**2 / (count * (count - 1))
    return math.sqrt(variance)


# What is moved for it


def _traced(step: ClockStep, samples: Array, fixes: Array) -> ClockStep:
    """The step with what is moved for it, and its moment where stamps left a trace of it.

    What leaves a hole of its own size in the stamps of one is moved up to close it. What leaves none has lost rows and
    counted on, or its stamps went back over rows that were left out: then what follows is moved off, and makes a hole.
    """
    t, size = fixes if step.size > 0.0 else samples + step.lag, abs(step.size)
    hole = _hole(t, step.first, step.last, size)
    if hole is None:
        return step
    by = -min(size, float(t[hole + 1] - t[hole]) - 0.5 * float(np.median(np.diff(t))))
    moves_fixes = step.size > 0.0
    move = ClockMove(moves_fixes, float((fixes if moves_fixes else samples)[hole]), by)
    at = float(t[hole + 1] if moves_fixes else t[hole])
    return replace(step, t=at, first=at, last=at, move=move)


def _hole_made(sides: _Sides) -> ClockMove:
    """The move that makes a hole at the moment: of the samples where fixes come later from there on, else of fixes.

    Fixes that came while samples were lost tell neither side; the moment was found amid them.
    """
    if sides.size > 0.0:
        return ClockMove(False, sides.moment - sides.before - 0.5 * sides.size, sides.size)
    return ClockMove(True, sides.moment, -sides.size)


def _hole(t: Array, first: float, last: float, size: float) -> int | None:
    """Row of t (N,) s, from about `first` to `last`, after which `size` s more than usual are missing; None if none."""
    rows = np.flatnonzero((t[:-1] > first - WINDOW - size) & (t[1:] < last + WINDOW + size))
    if not rows.size:
        return None
    usual = float(np.median(np.diff(t)))
    off = np.abs(t[rows + 1] - t[rows] - usual - size)
    best = int(np.argmin(off))
    return int(rows[best]) if off[best] < max(TRACE, 0.2 * size) and size > 0.3 * usual else None
