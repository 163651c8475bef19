"""Fixes of a receiver that has lost its satellites for a second or two and goes straight on: dead reckoning of its own.

Under a bridge, beside a stand or upside down a receiver may send on the velocity it had last, and places along it, as
if they were measured. Place and Doppler agree with one another and with their neighbours, and both are wrong. The
samples tell: they feel the kart turn or brake while the receiver says straight on. Where the velocity that was sent
changes far less than the samples say, by more than they ever are off else, and catches up with them afterwards, what
was sent at that velocity is left out. A hill is felt as braking too, but nothing is to be caught up with there. A fine
velocity that stays the same to the last digit was not measured: it needs to part from what is felt, and no more.

Others slow down meanwhile, and jump to what is true at the end. No kart can make such a jump, and samples feel none:
what was sent before it, as long as it is off from what they felt on the way there, is left out. One that begins with a
jump ends with another.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.estimate.averages import averages_of, in_gap
from smoother.estimate.fixes.screen import MEDIAN_TO_SIGMA, says_velocity
from smoother.estimate.initial.align import Alignment, gyro_yaw, initial_attitude
from smoother.estimate.path_motion import LAGS, PathMotion
from smoother.samples import ImuSamples, Problem, Session
from smoother.words import counted

COASTING = "gps_coasting"  # code of the problem that says so
WINDOW = 0.6  # s, over which velocity must change as is felt
QUICK = 0.3  # s between fixes; of slower ones single fixes are wrong, and lose against their neighbours
SIGMAS = 4.5  # beyond the usual scatter; without coasting 4 is not reached, in hairpins 5 once
# the same where the path explains less of what is felt: a box that turns with the wheel reaches 8 once
SIGMAS_OF_LOOSE, LOOSE = 9.0, 0.92
LEAST_FELT = 1.0  # m/s of such a change; where little is felt cars' receivers seemed to go straight on at 0.8
STRAIGHT = 0.25  # of the change that is felt is what was sent at most
# s: vibration that sampling without a filter folds to 0 Hz pushes for as long as its phase stands still, where the
# engine's frequency changes by 5 Hz/s
STANDING_TONE = 0.3
AROUND = 2.0  # s to either side of a window, in which vibration is as strong as where it is folded to 0 Hz and unseen
UNLIKE = 0.5  # of what is told or felt is off, where the two have little in common
SELDOM_UNLIKE = 1  # window like that within REACH, where the receiver does not go straight; more, and samples are wrong
OFTEN_UNLIKE = 0.02  # of all windows, beyond which they are wrong anywhere; of coasting receivers 0.005 are
MIN_SPEED = 5.0  # m/s; nobody who crawls goes straight on
ALIKE = 0.6  # m/s by which velocities of one coasting differ, their noise included
SHORTEST, REACH = 0.8, 10.0  # s of one coasting, at least, and to either side of where it is felt, at most
CAUGHT_UP = 0.7  # of what it was off is left, WINDOW after the first fix with which it has its satellites again
MISSING = 5.0  # s without fixes before that, at most
HELD = 0.7  # s in which velocity stays the same to the last digit
SELDOM = 0.02  # of the fixes that are less long the same as those before: more, and the receiver is coarse
OFTEN = 0.3  # of the fixes that are held: more, and it renews its velocity less often than its places
SIGMAS_OF_HELD = 3.0  # beyond the usual scatter, which grows as the root of the time: such turns may be gentle
# m/s from one fix to the next, at most QUICK s later, that no kart makes; s of driving to each of them at least, on
# average: receivers that renew their velocity once a second make one in every corner. s before such a stretch that
# hardly differ and belong to it
JUMP, JUMPS_EVERY, FADES_IN = 4.0, 10.0, 0.3
SETTLES = 5.0  # s behind a jump, by the middle of which the nose is back on the course
STEP = 0.05  # s, over which felt force is summed up
LONGEST = 6 * 3600.0  # s of a session that is looked at
FEWEST = 100  # windows that tell what is usual


def coasting(session: Session, alignment: Alignment, path: PathMotion) -> BoolArray:
    """Mask (N,) of the fixes of a receiver that went straight on; none without Doppler or at less than 4 Hz.

    alignment, path: of the session, as it begins.
    """
    gnss, imu = session.gnss, session.imu
    out = np.zeros(len(gnss), dtype=np.bool_)
    rows = np.flatnonzero(says_velocity(gnss.velocity_n))
    if imu is None or rows.size < FEWEST or alignment.is_level_only or np.ptp(gnss.t) > LONGEST:
        return out
    t, velocity = gnss.t[rows], gnss.velocity_n[rows, :2]
    felt_at = t - alignment.lag
    if median(np.diff(t)) > QUICK or alignment.lag > LAGS[-1]:
        return out
    first, last = _windows(t, felt_at, imu)
    if first.size < FEWEST:
        return out
    summed = _summed_up(imu, path, alignment, felt_at)
    apart = velocity - summed
    looseness = 1.0 if alignment.share_explained > LOOSE else SIGMAS_OF_LOOSE / SIGMAS
    parting = _Parting.of(apart[last] - apart[first], _shaken(imu, felt_at[first], felt_at[last]), looseness)
    told, felt = velocity[last] - velocity[first], summed[last] - summed[first]
    goes_straight = _goes_straight(parting, told, felt)
    goes_straight &= parting.off > STANDING_TONE * _quick(imu, felt_at[first], felt_at[last])
    is_fast = np.hypot(*velocity.T) > MIN_SPEED
    ended: dict[int, bool] = {}
    runs: list[slice] = []
    for k in np.flatnonzero(goes_straight & is_fast[first]).tolist():
        alike = _alike(t, velocity, int(first[k]), int(last[k]))
        if alike.stop not in ended:  # the first window of several that see the same
            ended[alike.stop] = _catches_up(t, apart, int(first[k]), alike.stop - 1)
        if ended[alike.stop] and t[alike.stop - 1] - t[alike.start] > SHORTEST:
            runs.append(alike)
    for run in _trusted(t, runs, (t[first], t[last]), parting.is_unlike(told, felt)):
        out[rows[run]] = True
    jumps = _jumps(t, velocity, summed)
    if jumps.size:  # hardly ever
        for run in _until_jumps(t, velocity, summed, _off_gyro(imu, path, alignment, felt_at), parting, jumps):
            out[rows[run]] = True
    begin, end = _held(t, velocity, is_fast)
    sampled = _are_sampled(imu, felt_at[begin], felt_at[end])
    for one, other in zip(begin[sampled].tolist(), end[sampled].tolist(), strict=True):
        run = slice(one, other + 1)
        if parting.is_beyond(t[run] - t[one], apart[run] - apart[one]).any():
            out[rows[run]] = True
    return out


@dataclass(frozen=True)
class _Parting:
    """How velocity that is told and felt part in WINDOW s: off (W, 2) m/s, but for what is steady.

    off (W,) m/s: by how much. beyond (W,): that in usual scatters. drift (2,) m/s: what is steady. usual: scatter, m/s.
    """

    off: Array
    beyond: Array
    drift: Array
    usual: float

    @classmethod
    def of(cls, parted: Array, shaken: Array, looseness: float) -> "_Parting":
        """Of what is parted (W, 2) m/s in windows; shaken (W,) m^2/s^2, of :func:`_shaken`: what is beyond the usual
        of it adds to the usual scatter, which counts `looseness` times.
        """
        drift = np.median(parted, axis=0)
        off = np.hypot(*(parted - drift).T)
        usual = max(MEDIAN_TO_SIGMA * median(off), 1e-3)
        return cls(
            off,
            off / np.sqrt(usual**2 + np.maximum(shaken - median(shaken), 0.0)) / looseness,
            drift,
            usual * looseness,
        )

    def is_unlike(self, told: Array, felt: Array) -> BoolArray:
        """Mask (W,) of the windows in which what is told and felt (W, 2) m/s is off beyond chance, and unlike.

        Of a quick corner a part may be off by times that are not known yet.
        """
        most = np.maximum(np.hypot(*told.T), np.hypot(*felt.T))
        return np.asarray((self.beyond > SIGMAS) & (self.off > UNLIKE * most))

    def is_beyond(self, lasts: Array, parted: Array) -> BoolArray:
        """Mask (H,) of what is parted (H, 2) m/s in (H,) s by more than chance does, where velocity is held."""
        windows = lasts / WINDOW
        off = np.hypot(*(parted - windows[:, None] * self.drift).T)
        return np.asarray(off > np.maximum(SIGMAS_OF_HELD * self.usual * np.sqrt(windows), LEAST_FELT))


def _goes_straight(parting: _Parting, told: Array, felt: Array) -> BoolArray:
    """Mask (W,) of the windows in which velocity is told to change (W, 2) m/s far less than is felt (W, 2) m/s."""
    size = np.hypot(*felt.T)
    return np.asarray((parting.beyond > SIGMAS) & (np.hypot(*told.T) < STRAIGHT * size) & (size > LEAST_FELT))


def _jumps(t: Array, velocity: Array, summed: Array) -> IntArray:
    """The fixes (J,) at t (M,) s after which velocity (M, 2) m/s jumps, and what is felt, summed (M, 2) m/s, does not.

    None where jumps are usual, or velocities are not renewed with every fix.
    """
    told, felt = np.diff(velocity, axis=0), np.diff(summed, axis=0)
    is_jump = (np.hypot(*(told - felt).T) > JUMP) & (np.hypot(*felt.T) < STRAIGHT * np.hypot(*told.T))
    jumps = np.flatnonzero(is_jump & (np.diff(t) < QUICK))
    is_renewed = np.any(told != 0.0, axis=1)
    if jumps.size * JUMPS_EVERY > np.ptp(t) or np.mean(is_renewed) < 1.0 - OFTEN:
        return jumps[:0]
    return jumps


def _until_jumps(
    t: Array, velocity: Array, summed: Array, off_gyro: Array, parting: _Parting, jumps: IntArray
) -> list[slice]:
    """The fixes at t (M,) s before jumps of velocity (M, 2) m/s that are off from what is felt on the way there.

    summed (M, 2) m/s: what is felt makes of the velocity, whose nose is off_gyro (M,) rad ahead of the gyroscope's: it
    went by the course that was sent, and on the way to a jump the gyroscope alone is right, unless its bias was found
    from such fixes. jumps (J,): the fixes after which it jumps.
    """
    runs = []
    for last in jumps.tolist():
        before, behind = np.searchsorted(t, [t[last] - REACH, t[last + 1] + SETTLES])
        near = slice(int(before), int(behind))
        nose = np.median(off_gyro[last + 1 : near.stop])
        by_gyro = velocity[near] - _turned_by(nose - off_gyro[near], summed[near])
        by_course = velocity[near] - summed[near]
        firsts = (_parts(t[near], apart, last - near.start, parting) for apart in (by_gyro, by_course))
        first = next((k for k in firsts if k is not None), None)
        if first is not None:
            runs.append(slice(int(np.searchsorted(t, t[near][first] - FADES_IN)), last + 1))
    return runs


def _parts(t: Array, apart: Array, last: int, parting: _Parting) -> int | None:
    """From which fix to `last`, after which it jumps, velocities sent and felt, apart (N, 2) m/s, are off from what
    they are right behind it; None where from the beginning."""
    behind = slice(last + 1, int(np.searchsorted(t, t[last + 1] + WINDOW)))
    parted = np.median(apart[behind], axis=0) - apart[: last + 1]
    agrees = np.flatnonzero(~parting.is_beyond(t[last + 1] - t[: last + 1], parted))
    return int(agrees[-1]) + 1 if agrees.size and agrees[-1] < last else None


def _turned_by(angle: Array, summed: Array) -> Array:
    """Sums (N, 2) of steps, each of which is turned by the angle (N,) rad at its end."""
    steps = np.diff(summed, axis=0, prepend=summed[:1])
    cos, sin = np.cos(angle), np.sin(angle)
    return np.cumsum(
        np.stack([cos * steps[:, 0] - sin * steps[:, 1], sin * steps[:, 0] + cos * steps[:, 1]], axis=1), axis=0
    )


def _off_gyro(imu: ImuSamples, path: PathMotion, alignment: Alignment, t: Array) -> Array:
    """By how much the nose at t (N,) s, which goes by the course, is ahead of what the gyroscope adds up to, rad."""
    R_nb = initial_attitude(t, imu, path, alignment) @ alignment.R_bs.T
    off = np.arctan2(R_nb[:, 1, 0], R_nb[:, 0, 0]) - np.interp(t, imu.t, gyro_yaw(imu, alignment))
    return np.asarray(np.unwrap(off))


def _held(t: Array, velocity: Array, is_fast: BoolArray) -> tuple[IntArray, IntArray]:
    """First and last fix (H,) each of the runs at t (M,) s, at speed, in which velocity (M, 2) m/s is one for HELD s.

    None has a hole. A measured velocity is never held like that; where it often is, it is coarse, or seldom renewed.
    """
    breaks = np.any(np.diff(velocity, axis=0) != 0.0, axis=1) | (np.diff(t) > 2.0 * QUICK)
    begin = np.flatnonzero(np.append(True, breaks))
    end = np.append(begin[1:] - 1, len(t) - 1)
    repeats, at_speed = end - begin, is_fast[begin]
    is_held = (t[end] - t[begin] >= HELD) & at_speed
    most = np.count_nonzero(is_fast)
    is_coarse = np.sum(repeats[at_speed & ~is_held]) > SELDOM * most
    if is_coarse or np.sum(repeats[is_held]) > OFTEN * most:
        return begin[:0], end[:0]
    return begin[is_held], end[is_held]


def _shaken(imu: ImuSamples, begin: Array, end: Array) -> Array:
    """Variance (W,) m^2/s^2 of what is summed up from begin to end (W,) s, were all change between samples noise.

    Vibration grows with the revolutions: what is usual of a whole session is not, at full throttle.
    """
    steps = np.diff(imu.t)
    squared = np.sum(np.diff(imu.specific_force_s, axis=0) ** 2, axis=1) / 6.0 * steps**2  # (m/s)^2 per axis
    total = np.concatenate([[0.0], np.cumsum(squared)])
    return np.asarray(total[np.searchsorted(imu.t, end) - 1] - total[np.searchsorted(imu.t, begin) - 1])


def _quick(imu: ImuSamples, begin: Array, end: Array) -> Array:
    """Rms (W,) m/s^2 of what changes from sample to sample around the spans from begin to end (W,) s."""
    squared = 0.5 * np.sum(np.diff(imu.specific_force_s, axis=0) ** 2, axis=1)
    total = np.concatenate([[0.0], np.cumsum(squared)])
    low = np.searchsorted(imu.t, begin - AROUND)
    high = np.maximum(np.searchsorted(imu.t, end + AROUND) - 1, low + 1)
    return np.asarray(np.sqrt((total[high] - total[low]) / (high - low)))


def _trusted(t: Array, runs: list[slice], windows: tuple[Array, Array], unlike: BoolArray) -> list[slice]:
    """Those of the runs of fixes at t (M,) s near which the samples are right while the receiver turns and brakes; none
    where they are often wrong.

    windows: begin and end (W,) s; unlike (W,): what is told and felt in them has little in common.
    """
    begin, end = windows
    beside = np.ones(len(begin), dtype=np.bool_)
    for run in runs:
        beside &= (end < t[run.start] - WINDOW) | (begin > t[run.stop - 1] + WINDOW)
    unlike = beside & unlike
    if np.mean(unlike) > OFTEN_UNLIKE:
        return []
    at = begin[unlike]
    return [
        run for run in runs if np.sum((at > t[run.start] - REACH) & (at < t[run.stop - 1] + REACH)) <= SELDOM_UNLIKE
    ]


def _catches_up(t: Array, apart: Array, first: int, end: int) -> bool:
    """Whether velocities sent and felt, apart (M, 2) m/s at t (M,) s, come together again once it does not go straight.

    From fix `first` to fix `end` they part. A road that climbs is felt as braking too, but there they stay apart.
    """
    if end + 1 == len(t) or t[end + 1] - t[end] > MISSING:
        return False
    after = slice(end + 1, int(np.searchsorted(t, t[end + 1] + WINDOW)))
    left = np.min(np.hypot(*(apart[after] - apart[first]).T))
    return bool(left < CAUGHT_UP * np.hypot(*(apart[end] - apart[first])))


def coasting_problems(out: BoolArray) -> tuple[Problem, ...]:
    """Say so where fixes were left out."""
    count, times = int(np.count_nonzero(out)), int(np.count_nonzero(np.diff(out.astype(np.int8), prepend=0) > 0))
    if not count:
        return ()
    text = (
        f"{counted(times, 'time')} the receiver went on by itself while the kart turned or braked, as without "
        f"satellites; {counted(count, 'fix')} left out. Give the antenna a free view of the sky"
    )
    return (Problem(COASTING, text, count),)


def _windows(t: Array, felt_at: Array, imu: ImuSamples) -> tuple[IntArray, IntArray]:
    """First and last fix (W,) of the windows about WINDOW s long, with samples all the way."""
    last = np.searchsorted(t, t + WINDOW - 1e-6)
    first = np.flatnonzero(last < len(t))
    last = last[first]
    keep = _are_sampled(imu, felt_at[first], felt_at[last]) & (t[last] - t[first] < 1.6 * WINDOW)
    return first[keep], last[keep]


def _are_sampled(imu: ImuSamples, begin: Array, end: Array) -> BoolArray:
    """Mask (W,) of the spans from begin to end (W,) s that have samples all the way, and beside them."""
    holes = imu.t[np.flatnonzero(np.diff(imu.t) > STEP)]
    unbroken = np.searchsorted(holes, begin) == np.searchsorted(holes, end)
    beside = in_gap(imu.t, begin) | in_gap(imu.t, end)  # where samples are missing so is the attitude beside them
    return np.asarray((begin > imu.t[0]) & (end < imu.t[-1]) & unbroken & ~beside)


def _summed_up(imu: ImuSamples, path: PathMotion, alignment: Alignment, t: Array) -> Array:
    """What the force felt makes of the horizontal velocity until t (N,) s, (N, 2) m/s, up to a steady drift."""
    grid = np.arange(imu.t[0] + STEP, imu.t[-1] - STEP, STEP)
    force, _ = averages_of(imu).around(grid, STEP)
    force_n = np.einsum("nij,nj->ni", initial_attitude(grid, imu, path, alignment)[:, :2], force)
    velocity = np.concatenate([np.zeros((1, 2)), np.cumsum(0.5 * STEP * (force_n[1:] + force_n[:-1]), axis=0)])
    return np.stack([np.interp(t, grid, velocity[:, i]) for i in range(2)], axis=1)


def _alike(t: Array, velocity: Array, first: int, last: int) -> slice:
    """The fixes around those from first to last whose velocity is that of these, without a hole."""
    usual = np.median(velocity[first : last + 1], axis=0)
    reach = np.hypot(*(velocity - usual).T) < ALIKE
    reach[1:] &= np.diff(t) < 2.0 * QUICK
    reach &= (t > t[first] - REACH) & (t < t[last] + REACH)
    begin, end = first, last
    while begin > 0 and reach[begin - 1] and reach[begin]:
        begin -= 1
    while end + 1 < len(t) and reach[end + 1]:
        end += 1
    return slice(begin, end + 1)
