"""What each stretch of driving says by itself: how late its fixes are, and whether samples and fixes are of one motion.

A drift and a step between two clocks are found and taken out. What comes and goes, or changes within a minute, is
neither: a buffer that fills, a radio that is busy, a clock that is set and set back, samples that are lost and counted
on. One delay for all of the session is then wrong by as much, and no residual shows it, since speeds and places agree
with one another. Forward force, left force and yaw rate, each by itself, say how late the path is in every stretch;
slip, lean and wheels shift one of them or two, clocks all three alike. Where none of the three has to do with the path
at all, one of the two files holds something else there: samples that are counted at another rate than they were taken,
blocks in the wrong place, a box that fell off.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, are_near, median, runs_of
from smoother.estimate.averages import averages_of, in_gap
from smoother.estimate.clock_steps import QUICK, SLOWEST
from smoother.estimate.delays import Felt, common, said
from smoother.estimate.initial.align import Alignment
from smoother.estimate.left_out import tell_motion
from smoother.estimate.path_motion import PathMotion, path_axes, sampled_at_speed
from smoother.estimate.pauses import Pauses
from smoother.samples import Problem, Session
from smoother.trajectory import DELAY_CHANGES, MOTION_UNLIKE

STRETCH = 20.0  # s of driving; a bend or two to either side, and a straight
FEWEST_STRETCHES, MOST_STRETCHES = 5, 200
FEWEST, ENOUGH = 15, 400  # fixes of a stretch
MOVES, FARTHEST, SETTLED = 5, 0.2, 0.02  # of Gauss-Newton, s that each may move, and below which one is as good as more
# s rms of what the three axes have in common about their usual delay. Simulated karts that have one delay come out at
# 0.002 to 0.015, real karts and cars at 0.012 to 0.026 (the latter a box on the wheel)
LEAST = 0.05
LEAST_OF_FEW = 0.1  # s likewise of fixes more than QUICK s apart: a car at 1 Hz has 0.08
# correlation between any two axes; of the same 0.1 to 0.9, the higher ones of karts where all of it is noise
ALIKE = 0.8
# Correlation of what is told and felt by the axis that has most of it: 0.69 and more in every stretch of real karts and
# cars, 0.98 of simulated ones, and what it is in many stretches of a session that tells at all
UNLIKE, TELLS = 0.5, 0.85
SURELY_LIKE, QUIET = 0.75, 0.5  # likewise at a first look, and a part of the least change
MANY = 75.0  # per cent of the stretches may be worse than those
# And of those that are alike, few are less alike than that: 0.95 and more on real karts and cars. Of a slow kart that
# is shaken much they scatter from 0.6 to 0.9, and some are at 0 by chance
FEW, SURELY = 25.0, 0.85
LIVELY = 0.5  # of what an axis usually does; less says nothing of whether it was felt
STANDS = 1.0  # m/s, below which fixes stand
BESIDE_STAND = 0.3  # s to either side, in which they begin and cease to, or seem to move
# Correlation of force to the left and yaw rate, which go together by the speed: of a box that drives, and no other
DRIVES = 0.7
ONE = np.ones(1)  # of what axes say: the delay alone


@dataclass(frozen=True, eq=False)
class Stretches:
    """Stretches from first (B,) to last (B,) s: delay (B, 3) s of the path behind what was felt, by each axis.

    likeness (B,): the largest correlation of an axis; NaN where nothing goes on. least: s rms of what axes have in
    common, from which on it is a change.
    """

    first: Array
    last: Array
    delay: Array
    likeness: Array
    least: float = LEAST

    @property
    def are_unlike(self) -> BoolArray:
        """Mask (B,) of the stretches in which samples and fixes are not of one motion, of a session that tells."""
        known = self.likeness[np.isfinite(self.likeness)]
        if known.size < FEWEST_STRETCHES or not np.percentile(known, MANY) > TELLS:
            return np.zeros(len(self.likeness), dtype=np.bool_)
        is_sure = np.percentile(known[known >= UNLIKE], FEW) > SURELY
        return np.asarray((self.likeness < UNLIKE) & is_sure)

    @property
    def change(self) -> Array:
        """By how much all axes alike say that each stretch is later than usual, (B,) s: the least, 0 if at odds."""
        tell = self.likeness > UNLIKE
        if np.count_nonzero(tell) < FEWEST_STRETCHES:
            return np.zeros(len(tell))
        off = self.delay - np.median(self.delay[tell], axis=0)
        sign = np.sign(off[:, 0])
        alike = np.all(np.sign(off) == sign[:, None], axis=1)
        return np.where(alike & tell, sign * np.min(np.abs(off), axis=1), 0.0)

    @property
    def is_quiet(self) -> bool:
        """Whether all is so far from any alarm that a closer look would find none."""
        known = self.likeness[np.isfinite(self.likeness)]
        size = float(np.sqrt(np.mean(self.change**2)))
        return bool(np.all(known > SURELY_LIKE)) and size < QUIET * self.least

    @property
    def changes(self) -> bool:
        """Whether the delay changes: by more than anything but clocks makes it, and of all axes alike."""
        tell = self.likeness > UNLIKE
        if np.count_nonzero(tell) < FEWEST_STRETCHES or float(np.sqrt(np.mean(self.change[tell] ** 2))) < self.least:
            return False
        alike = np.asarray(np.corrcoef(self.delay[tell].T))
        return all(alike[i, j] > ALIKE for i, j in combinations(range(3), 2))


def stretches_of(felt: Felt, path: PathMotion, use: IntArray) -> Stretches | None:
    """Return what stretches of fixes in use, at speed, say; None where these can not be cut into some.

    All at once by least squares first; only where that may say something, each with weights and to the end.
    """
    every, told, t = median(np.diff(path.t)), path_axes(path)[use], path.t[use]
    driven = np.cumsum(np.minimum(np.diff(t, prepend=t[0]), SLOWEST))
    length = max(STRETCH, float(driven[-1]) / MOST_STRETCHES)
    parts = np.split(np.arange(len(t)), np.flatnonzero(np.diff(driven // length)) + 1)
    parts = [rows[:: -(-len(rows) // ENOUGH)] for rows in parts if len(rows) >= FEWEST]
    if len(parts) < FEWEST_STRETCHES:
        return None
    ends, least = np.array([(t[rows[0]], t[rows[-1]]) for rows in parts]), LEAST if every <= QUICK else LEAST_OF_FEW
    usual = np.sqrt(np.mean([np.var(told[rows], axis=0) for rows in parts], axis=0))  # most of a drag race is noise
    delays, by_axis = _roughly_said(felt, t, told, parts, usual)
    roughly = Stretches(ends[:, 0], ends[:, 1], delays, _of_axes_that_tell(by_axis), least)
    if roughly.is_quiet:
        return roughly
    said_of = [_said_of(felt, t[rows], told[rows], usual) for rows in parts]
    delays, by_axis = (np.array(values) for values in zip(*said_of, strict=True))
    return Stretches(ends[:, 0], ends[:, 1], delays, _of_axes_that_tell(by_axis), least)


def _of_axes_that_tell(by_axis: Array) -> Array:
    """The largest correlation (B,) of an axis, of by_axis (B, 3), NaN where nothing goes on.

    An axis that is noise in most stretches, as forward force at an even speed, does not tell by being so in one more.
    """
    known = np.isfinite(by_axis)
    tells = [bool(here.any()) and median(values[here]) > TELLS for values, here in zip(by_axis.T, known.T, strict=True)]
    most = np.max(np.where(known & tells if any(tells) else known, by_axis, -np.inf), axis=1)
    return np.where(most > -np.inf, most, np.nan)


def stretch_problems(session: Session, path: PathMotion, alignment: Alignment, pauses: Pauses) -> tuple[Problem, ...]:
    """Say so where the delay changes or samples are of another motion, of a session of which `pauses` are cut out."""
    assert session.imu is not None
    use = sampled_at_speed(session.imu, path)
    use = use[tell_motion(session, by_velocity=path.is_measured)[use]]  # no line across fixes that were left out
    if _tell_nothing(path, alignment, use):
        return ()
    found = stretches_of(Felt(averages_of(session.imu), alignment), path, use)
    return tuple(_problems_of_stretches(found, pauses, float(pauses.opened(session.gnss.t[:1])[0])))


def false_stands(
    session: Session, path: PathMotion, alignment: Alignment, pauses: Pauses
) -> tuple[BoolArray, tuple[Problem, ...]]:
    """Mask (N,) of the fixes that stand while the kart drives on, and what to say; of a session without `pauses`."""
    assert session.imu is not None
    out, use = np.zeros(len(path.t), dtype=np.bool_), sampled_at_speed(session.imu, path)
    if _tell_nothing(path, alignment, use):
        return out, ()
    stood = driven_stands(Felt(averages_of(session.imu), alignment), session.imu.t, path, use)
    for begin, end in zip(*runs_of(are_near(path.t, path.t[path.speed < STANDS], BESIDE_STAND)), strict=True):
        out[begin:end] = np.any((stood[:, 0] <= path.t[end - 1]) & (stood[:, 1] >= path.t[begin]))
    return out, tuple(_problems_of_stands(stood, pauses, float(pauses.opened(session.gnss.t[:1])[0])))


def _tell_nothing(path: PathMotion, alignment: Alignment, use: IntArray) -> bool:
    """Whether the fixes in use are too few or too rare to tell one stretch from others, or no axis is known."""
    return alignment.is_level_only or use.size < FEWEST * FEWEST_STRETCHES or median(np.diff(path.t)) > SLOWEST


def driven_stands(felt: Felt, sampled: Array, path: PathMotion, use: IntArray) -> Array:
    """Return from when to when, (K, 2) s, fixes stand while what is felt goes on as at speed, at fixes in use.

    sampled (M,) s: times of the samples.
    """
    usual = np.std(felt.at(path.t[use[:: -(-len(use) // ENOUGH)]] - felt.alignment.lag), axis=1)
    stands = (path.speed < STANDS) & (path.t > sampled[0] + 1.0) & (path.t < sampled[-1] - 1.0)
    found = []
    for first, behind in zip(*runs_of(stands & ~in_gap(sampled, path.t)), strict=True):
        parts = max(1, int((path.t[behind - 1] - path.t[first]) // STRETCH))
        for rows in np.array_split(np.arange(first, behind), parts):
            t = path.t[rows]
            if len(rows) < FEWEST or t[-1] - t[0] < 0.9 * STRETCH:
                continue
            here = felt.at(t[:: -(-len(t) // ENOUGH)] - felt.alignment.lag)
            if np.all(np.std(here, axis=1) > LIVELY * usual) and _correlation(here[1], here[2]) > DRIVES:
                found.append((float(t[0]), float(t[-1])))
    return np.array(found).reshape(-1, 2)


def _problems_of_stands(stood: Array, pauses: Pauses, begun: float) -> Iterator[Problem]:
    """What to say of stands (K, 2) s on the closed time, of a session whose first fix is at `begun` s."""
    if not len(stood):
        return
    first, last = pauses.opened(stood[[0, -1], [0, 1]]) - begun
    text = (
        f"between {first:.0f} and {last:.0f} s after the first fix the fixes stand still for "
        f"{np.sum(stood[:, 1] - stood[:, 0]):.0f} s while the samples drive on: they were left out, and the result "
        "is not to be trusted there. "
        "Did the antenna come off, or the receiver hold a place? Smooth the rest by itself"
    )
    yield Problem(MOTION_UNLIKE, text)


def _problems_of_stretches(found: Stretches | None, pauses: Pauses, begun: float) -> Iterator[Problem]:
    """What to say of stretches on the closed time, of a session whose first fix is at `begun` s."""
    if found is None:
        return
    first, last = pauses.opened(found.first) - begun, pauses.opened(found.last) - begun
    if np.any(found.are_unlike):
        rows = np.flatnonzero(found.are_unlike)
        text = (
            f"between {first[rows[0]]:.0f} and {last[rows[-1]]:.0f} s after the first fix samples and fixes are not of "
            f"one motion, in {len(rows)} of {len(first)} stretches of driving: the result is not to be trusted there. "
            "Did the rate of the samples change, or the box come off? Smooth the rest by itself"
        )
        yield Problem(MOTION_UNLIKE, text)
    if found.changes:
        early, late = int(np.argmin(found.change)), int(np.argmax(found.change))
        text = (
            f"fixes come {found.change[late] - found.change[early]:.2f} s later behind the samples about "
            f"{first[late]:.0f} s after the first fix than about {first[early]:.0f} s after it: places and speeds are "
            "off by up to as much. Stamp samples and fixes by one clock, as they come in"
        )
        yield Problem(DELAY_CHANGES, text)


def _roughly_said(felt: Felt, t: Array, told: Array, parts: list[IntArray], usual: Array) -> tuple[Array, Array]:
    """What :func:`_said_of` says of each of the parts (B,), by one step of least squares: both (B, 3)."""
    rows, count = np.concatenate(parts), np.array([len(part) for part in parts])
    first = np.concatenate([[0], np.cumsum(count)[:-1]])

    def sums(values: Array) -> Array:
        return np.asarray(np.add.reduceat(values, first, axis=-1))

    def centred(values: Array) -> Array:
        return np.asarray(values - np.repeat(sums(values) / count, count, axis=-1))

    here, change = felt.with_change(t[rows] - felt.alignment.lag)
    x, y = centred(np.stack([here, -change], axis=1)), centred(told[rows].T)
    normal, pull, square = sums(x[:, :, None] * x[:, None]), sums(x * y[:, None]), sums(y * y)
    determinant = normal[:, 0, 0] * normal[:, 1, 1] - normal[:, 0, 1] ** 2
    gain, shifted = (
        normal[:, 1 - i, 1 - i] * pull[:, i] - normal[:, 0, 1] * pull[:, 1 - i] for i in (0, 1)
    )  # times the determinant
    with np.errstate(divide="ignore", invalid="ignore"):
        off = np.where((gain != 0.0) & (determinant > 0.0), shifted / gain, np.inf)
        likeness = pull[:, 0] / np.sqrt(normal[:, 0, 0] * square)
    lively = (square / count > (LIVELY * usual[:, None]) ** 2) & np.isfinite(likeness)
    return felt.alignment.lag + off.T, np.where(lively, likeness, np.nan).T


def _said_of(felt: Felt, t: Array, told: Array, usual: Array) -> tuple[Array, Array]:
    """Delay (3,) s by each axis of fixes at t (N,) s, told (N, 3), and its correlation with what was felt, NaN where it
    is not lively; usual (3,): how much axes usually scatter."""
    late = felt.alignment.lag
    for _ in range(MOVES):
        here, change = felt.with_change(t - late)
        axes = [said(told[:, i], here[i], -change[None, i], t, ONE) for i in range(3)]
        delays = late + np.array([float(axis.off[0]) for axis in axes])
        step = float(np.clip(common(axes, ONE).mean, -FARTHEST, FARTHEST))
        if abs(step) < SETTLED:
            break
        late += step
    lively = (np.std(told, axis=0) > LIVELY * usual) & (np.std(here, axis=1) > 0.0)
    return np.asarray(delays), np.array([_correlation(told[:, i], here[i]) if lively[i] else np.nan for i in range(3)])


def _correlation(one: Array, other: Array) -> float:
    """Pearson's of two (N,) that both scatter."""
    return float(np.asarray(np.corrcoef(one, other))[0, 1])
