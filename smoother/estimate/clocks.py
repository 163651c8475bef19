"""Samples and fixes whose clocks run at different speeds: the samples are taken to the clock of the fixes.

One box stamps both by one clock. Others count samples at their nominal rate, which a sensor's own oscillator keeps to a
per cent, or stamp fixes by the receiver's UTC; then the delay of the fixes grows from the first lap to the last. The
forward and left acceleration and the yaw rate of the path through the fixes, beside what the box felt of each, tell the
delay at every time; its slope over a session is the drift. Slip, lean and a box that turns with the wheel shift single
delays by tens of milliseconds, but not the three alike and more and more: where they do not say the same, nothing is
said.
"""

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from smoother.arrays import Array, median
from smoother.estimate.averages import averages_of
from smoother.estimate.delays import Felt, Said, common, said
from smoother.estimate.initial.align import Alignment, align
from smoother.estimate.path_motion import PathMotion, path_axes, sampled_at_speed, thinned
from smoother.estimate.retimed import with_samples_at
from smoother.samples import ImuSamples, Problem, Session
from smoother.trajectory import Identified

SHORTEST = 60.0  # s of session; in less, a drift is no more than a delay
FIRST = 120.0  # s, the stretch that is looked at first
WIDER = 4.0  # times as long is each further one: its ends are foretold to within a fraction of WINDOW
FEWEST, ENOUGH, ENOUGH_AT_FIRST = 50, 4000, 1000  # fixes, evenly taken
EXPLAINED = 0.8  # share of rate and force, from which on the alignment of the whole session is good enough
# Drifts that are tried where it is not, at most so many either way: they change the delay by STEP s after the start,
# when clocks still agree, and so little over the stretch that corners meet.
MOST_DRIFT, STEP, MOST_TRIED, COARSEST = 0.015, 0.4, 50, 0.003
STEPS, SETTLED = 6, 0.005  # of Gauss-Newton over each stretch, at most, and s at its ends by which the last may move
BESIDE = 3.0  # s of samples on either side of a stretch of fixes
UNLIKE = 0.25  # of the drift, by which no axis may differ from it, unless by its own sigmas; a real kart's slip: 0.33
STRETCHES = 8  # of a session, each of which tells a delay
# Of what delays of stretches leave beside a step, the most that they may leave beside a line, where halves put a drift
# in doubt: two that are true left 0.06 and 0.16, and none of 234 simulated steps less than 0.7
BESIDE_LINE = 0.2
SIGNIFICANT = 5.0  # sigmas
# Sigmas by which blocks of so many s have to fit better with a drift than without: true ones of 0.03 s over a session
# have 2.3 and more, false ones of slow karts 1.9 and less
CLOSER, BLOCK = 2.2, 5.0
SMALLEST = 0.02  # s from end to end of the session; what slip does over a session comes up to half of that
# s likewise of a session of less than LONG s: a spin or two is as much of it
SMALLEST_OF_SHORT, LONG = 0.1, 150.0
# s likewise where velocities are those of positions, whose wander along the track is a delay that changes, or fixes are
# more than QUICK s apart: of 1 Hz, what is between them is not known as well
SMALLEST_OF_FEW, QUICK = 1.0, 0.3
LARGEST = 0.03  # more is no clock
LAG, DRIFT = np.array([1.0, 0.0]), np.array([0.0, 1.0])  # of what axes say
ONE = np.ones(1)  # likewise of the delay alone
TINY = 1e-12  # s^2

USUAL_DRIFT = 5e-5  # of a quartz against GPS, beforehand


@dataclass(frozen=True)
class ClockDrift:
    """drift: seconds that the samples' clock gains on that of the fixes in one of theirs.

    is_found: whether it is to be taken out; infinite sigma where nothing tells.
    """

    drift: float
    sigma: float
    is_found: bool


UNSEEN_DRIFT = ClockDrift(0.0, math.inf, False)


def clock_drift(imu: ImuSamples, path: PathMotion, alignment: Alignment) -> ClockDrift:
    """Return how the clock of samples drifts against that of the fixes; `alignment` is that of the whole session.

    The drift is found on a stretch that grows to the whole session, since a delay is only found to within a corner.
    """
    use = sampled_at_speed(imu, path)
    lasts = float(path.t[-1] - path.t[0])
    if use.size < FEWEST or lasts < SHORTEST or alignment.by_changes:  # rare fixes know too little of forces
        return UNSEEN_DRIFT
    axes = path_axes(path)
    if alignment.share_explained < EXPLAINED:
        alignment, clock = _first_clock(imu, path, _first_driven(path.t[use]))
    else:
        clock = _Clock(_liveliest(path.t[use], axes[use]), alignment.lag, 0.0)
    reach = 0.5 * FIRST
    felt = Felt(averages_of(imu), alignment)
    while True:
        within = use[np.abs(path.t[use] - clock.middle) <= reach]
        is_all = within.size == use.size
        rows = thinned(within, ENOUGH if is_all else ENOUGH_AT_FIRST)
        if rows.size < FEWEST:
            return UNSEEN_DRIFT
        slopes, clock = _fitted(felt, path.t[rows], axes[rows], clock, reach)
        if not (math.isfinite(clock.drift) and abs(clock.drift) < LARGEST):
            return UNSEEN_DRIFT
        if is_all:
            smallest = _smallest(lasts, path.is_measured and median(np.diff(path.t)) <= QUICK)
            found = _judged(slopes, clock, smallest / lasts)
            of_all = felt, path.t[rows], axes[rows], clock
            return replace(found, is_found=found.is_found and _is_even(*of_all) and _fits_better(*of_all))
        reach *= WIDER


def on_clock_of_fixes(session: Session, found: ClockDrift) -> Session:
    """Return the session with the times of its samples on the clock of the fixes; both agree where it begins."""
    return with_samples_at(session, partial(_retimed, drift=found.drift, zero=float(session.gnss.t[0])))


def identified_drift(found: ClockDrift) -> Identified:
    """What to report, in ppm: the drift taken out; 0 where there is none, and how far off that may be."""
    if found.is_found:
        return Identified(1e6 * found.drift, 1e6 * found.sigma, "ppm", True, "identified")
    told = math.hypot(found.drift, found.sigma)
    sigma = 1.0 / math.hypot(1.0 / told, 1.0 / USUAL_DRIFT) if told > 0.0 else USUAL_DRIFT
    return Identified(0.0, 1e6 * sigma, "ppm", False, "default")


def drift_problems(found: ClockDrift, session: Session) -> tuple[Problem, ...]:
    """Say so where a drift was taken out."""
    if not found.is_found:
        return ()
    runs = "fast" if found.drift > 0.0 else "slow"
    apart = abs(found.drift) * float(session.gnss.t[-1] - session.gnss.t[0])
    text = (
        f"the samples' clock runs {1e6 * abs(found.drift):.0f} ppm {runs} against that of the fixes, "
        f"{apart:.2f} s over the session; taken out"
    )
    return (Problem("clock_drift", text),)


@dataclass(frozen=True)
class _Clock:
    """The fixes are late behind the samples by `lag` s at `middle` s, and by `drift` less each second after."""

    middle: float
    lag: float
    drift: float

    def of_samples(self, t: Array) -> Array:
        """When, by the clock of the samples, what was told at t (N,) s was felt."""
        return np.asarray(t - self.lag + self.drift * (t - self.middle))


def _smallest(lasts: float, tells_much: bool) -> float:
    """What clocks must part by in a session of `lasts` s, s, for it to be more than what else changes a delay."""
    if not tells_much:
        return SMALLEST_OF_FEW
    return SMALLEST if lasts > LONG else SMALLEST_OF_SHORT


def _is_even(felt: Felt, t: Array, told: Array, clock: _Clock) -> bool:
    """Whether fixes at t (N,) s drift all the time as the whole does: a step between clocks is no drift.

    Both halves do, or the delays of shorter stretches lie along a line and by far not along a step: what axes
    contradict one another by makes the slope of a half less sure than it seems.
    """
    at, middle = clock.of_samples(t), len(t) // 2
    here, change = felt.with_change(at)
    for half in (slice(None, middle), slice(middle, None)):
        since = t[half] - float(np.mean(t[half]))
        slopes = [_slope(told[half, i], here[i, half], change[i, half], since) for i in range(3)]
        told_here = common(slopes, DRIFT)
        if not abs(told_here.mean) < max(3.0 * told_here.sigma, UNLIKE * abs(clock.drift)):
            return _is_line(t, told, here, change, clock)
    return True


def _fits_better(felt: Felt, t: Array, told: Array, clock: _Clock) -> bool:
    """Whether fixes at t (N,) s told (N, 3) what was felt by a clock that drifts rather than by one that does not.

    Where what is felt is mostly noise, as of a slow kart, its change is noise as well: a fit by that moves by a
    fraction of what it should, ends where it began, and takes itself for sure.
    """
    even = replace(clock, lag=clock.lag - clock.drift * (float(np.mean(t)) - clock.middle), drift=0.0)
    closer = np.zeros(len(t))
    for axis, here, flat in zip(
        told.T, *(felt.with_change(one.of_samples(t))[0] for one in (clock, even)), strict=True
    ):
        y, x, z = (values - np.mean(values) for values in (axis, here, flat))
        gain = float(y @ x) / max(float(x @ x), TINY)
        rest = (y - gain * x) ** 2
        closer += ((y - gain * z) ** 2 - rest) / max(float(np.mean(rest)), TINY)
    of_blocks = np.add.reduceat(closer, np.flatnonzero(np.diff((t - t[0]) // BLOCK, prepend=-1.0)))
    scatter = float(np.std(of_blocks, ddof=1)) * math.sqrt(of_blocks.size) if of_blocks.size > 1 else math.inf
    return float(np.sum(of_blocks)) > CLOSER * scatter


def _is_line(t: Array, told: Array, here: Array, change: Array, clock: _Clock) -> bool:
    """Whether delays of STRETCHES of fixes at t (N,) s, told (N, 3), lie along the drift rather than along a step.

    here, change (3, N): what was felt by the clock, and how it changes. An axis counts by what it is sure to in the
    mean of stretches: in a single one chance makes it far surer, or less.
    """
    parts = np.array_split(np.arange(len(t)), STRETCHES)
    axes = [
        [said(told[part, i], here[i, part], -change[None, i, part], t[part], ONE) for part in parts] for i in range(3)
    ]
    late = np.array([[float(each.off[0]) for each in axis] for axis in axes])
    variance = np.array([np.mean([each.covariance[0, 0] for each in axis]) for axis in axes])
    weight = 1.0 / np.maximum(variance, TINY)
    if not weight.sum() > 0.0:
        return False
    since = np.array([float(np.mean(t[part])) for part in parts]) - clock.middle
    delay = weight @ (late - np.mean(late, axis=1, keepdims=True)) / weight.sum() - clock.drift * since
    beside_line = _squares(delay - np.polyval(np.polyfit(since, delay, 1), since))
    beside_step = min(_squares(delay[:k]) + _squares(delay[k:]) for k in range(1, STRETCHES))
    return beside_line < BESIDE_LINE * beside_step


def _squares(values: Array) -> float:
    """Sum of the squares of values (N,) about their mean."""
    return float(np.sum((values - np.mean(values)) ** 2))


def _first_driven(t: Array) -> float:
    """When the first stretch begins in which the kart mostly drives, by the times t (N,) s of fixes at speed."""
    count = np.searchsorted(t, t + FIRST) - np.arange(len(t))
    return float(t[int(np.argmax(2 * count > np.max(count)))])


def _liveliest(t: Array, axes: Array) -> float:
    """Middle of the FIRST s in which most is felt along the axes (N, 3) of fixes at t (N,) s."""
    power = np.concatenate([[0.0], np.cumsum(np.sum((axes / (np.std(axes, axis=0) + 1e-9)) ** 2, axis=1))])
    last = np.searchsorted(t, t + FIRST)
    first = int(np.argmax(power[last] - power[:-1]))
    return 0.5 * float(t[first] + t[last[first] - 1])


def _first_clock(imu: ImuSamples, path: PathMotion, begin: float) -> tuple[Alignment, _Clock]:
    """Return the alignment of the first stretch, from `begin` s on, and the clock for which it explains most.

    Both clocks are taken to have begun together, as those of files do.
    """
    middle, zero = begin + 0.5 * FIRST, float(path.t[0])
    count = min(math.ceil(MOST_DRIFT / min(STEP / (middle - zero), COARSEST)), MOST_TRIED)
    fixes = slice(*np.searchsorted(path.t, [begin, begin + FIRST]).tolist())
    driven, tried = PathMotion(path.t[fixes], path.velocity_n[fixes], path.is_measured), []
    for drift in np.linspace(-MOST_DRIFT, MOST_DRIFT, 2 * count + 1).tolist():
        clock = _Clock(zero, 0.0, drift)
        first, last = clock.of_samples(driven.t[[0, -1]]).tolist()
        samples = slice(*np.searchsorted(imu.t, [first - BESIDE, last + BESIDE]).tolist())
        if samples.stop - samples.start < FEWEST:
            continue
        t, force, rate = _retimed(imu.t[samples], drift, zero), imu.specific_force_s, imu.angular_rate_s
        part = replace(imu, t=t, specific_force_s=force[samples], angular_rate_s=rate[samples])
        tried.append((align(part, driven), drift))
    if not tried:
        return align(imu, path), _Clock(middle, 0.0, 0.0)
    best, drift = max(tried, key=lambda each: each[0].share_explained)
    return best, _Clock(middle, best.lag - drift * (middle - zero), drift)


def _fitted(felt: Felt, t: Array, told: Array, clock: _Clock, reach: float) -> tuple[list[Said], _Clock]:
    """Return the clock for which fixes at t (N,) s, at most `reach` s from its middle, told (N, 3) what was felt.

    Each axis has a lag of its own; the drift is common. With it what each axis says of the last step.
    """
    slopes: list[Said] = []
    for _ in range(STEPS):
        at = clock.of_samples(t)
        here, change = felt.with_change(at)
        slopes = [_slope(told[:, i], here[i], change[i], t - clock.middle) for i in range(3)]
        late, drift = common(slopes, LAG).mean, common(slopes, DRIFT).mean
        clock = _Clock(clock.middle, clock.lag + late, clock.drift - drift)
        if not abs(late) + abs(drift) * reach > SETTLED:
            break
    return slopes, clock


def _slope(told: Array, here: Array, change: Array, since: Array) -> Said:
    """What an axis that told (N,) says of lag and drift at `since` (N,) s, where `here` was felt, and its `change`."""
    return said(told, here, np.stack([-change, -change * since]), since, DRIFT)


def _judged(slopes: list[Said], clock: _Clock, smallest: float) -> ClockDrift:
    """Whether the drift is one: the same by all three axes, well known, and not below `smallest`."""
    told = common(slopes, DRIFT)
    is_found = abs(clock.drift) > max(SIGNIFICANT * told.sure, smallest)
    return ClockDrift(clock.drift, told.sure, is_found and told.are_alike(UNLIKE * abs(clock.drift)))


def _retimed(t: Array, drift: float, zero: float) -> Array:
    """Times t (N,) s of a clock that drifts, on the one it drifts against; at `zero` s both show the same."""
    return np.asarray(zero + (t - zero) / (1.0 + drift))
