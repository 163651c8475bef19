"""The samples' clock against that of the fixes, by the lags of the stretches: a drift is corrected, a step is detected.

One logger stamps both by one clock. Others count samples at their nominal rate, which a sensor's own oscillator keeps
to a per cent, or stamp fixes by the receiver's UTC. Such a clock shifts the lags of forward force, left force and yaw
rate alike, evenly over the session. What shifts one or two of them is slip, lean, or a steering wheel.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces, release, roomy
from smoother.estimate.preprocess.streams import Streams
from smoother.samples import GnssFixes, Problem, Session
from smoother.trajectory import Identified, JointPosition, Trajectory
from smoother.utc_clock import UtcClock

Change = Callable[[Array], Array]

USUAL_DRIFT = 5e-5  # of a quartz against GPS, beforehand
LARGEST_DRIFT = 0.03  # s per s
SIGNIFICANT = 5.0  # sigmas of a drift
ALIKE = 0.25  # of a drift, by which axes may differ unless by their own sigmas; a real kart's slip makes 0.33
ROUNDS, ROBUST = 6, 3.0  # of reweighting; sigmas
LEAST_BESIDE = 3  # stretches before a step, and after it
BLOCKS = 10  # of a session, whose errors are independent
TINY = 1e-12


@dataclass(frozen=True)
class Drift:
    """Drift of the samples' clock, s per s, and its sigma; is_sure: significant, axes and halves agree."""

    value: float
    sigma: float
    is_sure: bool


@dataclass(frozen=True)
class Step:
    """The samples' clock is ahead by `value` s more from about `at` s on. is_sure: significant, and the axes agree."""

    at: float
    value: float
    is_sure: bool


@dataclass(frozen=True)
class Clock:
    """The samples' clock gains `drift` s per s on that of the fixes from `zero` s on, where it `drifts`."""

    drift: float = 0.0
    drift_sigma: float = math.inf
    drifts: bool = False
    zero: float = 0.0

    def and_beyond(self, beyond: Drift, zero: float) -> "Clock":
        """Return this clock with the drift that a session shows which it has corrected; zero s: of a first one."""
        both = (1.0 + self.drift * self.drifts) * (1.0 + beyond.value) - 1.0
        return replace(self, drift=both, drift_sigma=beyond.sigma, drifts=True, zero=self.zero if self.drifts else zero)

    def without_more(self, beyond: Drift) -> "Clock":
        """Return this clock where what a session shows beyond it is not corrected."""
        return replace(self, drift=self.drift if self.drifts else beyond.value, drift_sigma=beyond.sigma)

    def corrected(self, session: Session) -> Session:
        """Return the session with its samples on the clock of its fixes."""
        if not self.drifts:
            return session
        return with_samples_at(session, lambda t: np.asarray(self.zero + (t - self.zero) / (1.0 + self.drift)))

    def identified(self) -> Identified:
        """What to report of the drift, ppm: the corrected one; else 0, with how large it may be."""
        if self.drifts:
            return Identified(1e6 * self.drift, 1e6 * self.drift_sigma, "ppm", True, "identified")
        shown = math.hypot(self.drift, self.drift_sigma)
        sigma = 1.0 / math.hypot(1.0 / shown, 1.0 / USUAL_DRIFT) if shown > 0.0 else USUAL_DRIFT
        return Identified(0.0, 1e6 * sigma, "ppm", False, "default")

    def problems(self, lasts: float) -> tuple[Problem, ...]:
        """Report a drift that was corrected in a session of `lasts` s."""
        if not self.drifts:
            return ()
        text = (
            f"the samples' clock runs {1e6 * abs(self.drift):.0f} ppm {'fast' if self.drift > 0.0 else 'slow'} against "
            f"that of the fixes, {abs(self.drift) * lasts:.2f} s over the session; corrected"
        )
        return (Problem("clock_drift", text),)


ONE_CLOCK = Clock()


def fit_drift(streams: Streams) -> Drift:
    """Fit a line to the lags of all axes, with an intercept of each axis, by robust least squares.

    An error of the path along the track is common to all axes: the sigma is at least that of the best one, and of their
    differences. A step is no drift: its halves have other slopes than the whole.
    """
    known, t = streams.is_known, streams.t - streams.t[0]
    sigma, lag = np.where(known, streams.sigma, 1.0), np.where(known, streams.lag, 0.0)
    middle = [np.median(own[some]) if some.any() else 0.0 for own, some in zip(lag.T, known.T, strict=True)]
    rest = np.where(known, lag - middle, 0.0)
    for _ in range(ROUNDS):
        weight = known / sigma**2 / (1.0 + (rest / (ROBUST * sigma)) ** 2)
        slope, uncertainty, rest = _line(t, lag, weight)
    half = len(t) // 2
    axes = np.array([_line(t, lag[:, [i]], weight[:, [i]])[:2] for i in range(3)])
    halves = np.array([_line(t[part], lag[part], weight[part])[:2] for part in (slice(half), slice(half, None))])
    at_odds = math.sqrt(float(np.sum(((axes[:, 0] - slope) / axes[:, 1]) ** 2)) / 2.0)
    uncertainty = max(uncertainty * max(1.0, at_odds), float(np.min(axes[:, 1])))
    parts = np.concatenate([axes, halves])
    agree = np.abs(parts[:, 0] - slope) < np.maximum(3.0 * parts[:, 1], ALIKE * abs(slope))
    return Drift(-slope, uncertainty, SIGNIFICANT * uncertainty < abs(slope) < LARGEST_DRIFT and bool(np.all(agree)))


def fit_step(streams: Streams) -> Step | None:
    """Fit one step to the lags of all axes, between the two stretches where it explains most; None with few stretches.

    Means before and after it are robust, by axis; differences of the axes increase its sigma.
    """
    known, n = streams.is_known, len(streams.t)
    if n < 2 * LEAST_BESIDE:
        return None
    weight = np.where(known, 1.0 / np.where(known, streams.sigma, 1.0) ** 2, 0.0)
    lag = np.where(known, streams.lag, 0.0)
    best = max(
        (_step_after(lag, weight, k) for k in range(LEAST_BESIDE, n - LEAST_BESIDE + 1)), key=lambda found: found[0]
    )
    size, value, is_sure, k = best
    return Step(float(0.5 * (streams.last[k - 1] + streams.first[k])), -value, is_sure and size > SIGNIFICANT)


def _step_after(lag: Array, weight: Array, k: int) -> tuple[float, float, bool, int]:
    """Size in sigmas, value s, whether the axes agree, and k, of a step of lags (B, 3) s from stretch k on."""
    before, after = (_robust_mean(lag[part], weight[part]) for part in (slice(k), slice(k, None)))
    steps, sigmas = after[0] - before[0], np.hypot(before[1], after[1])
    shown = np.isfinite(sigmas)
    if not shown.any():
        return 0.0, 0.0, False, k
    information = np.where(shown, 1.0 / np.where(shown, sigmas, 1.0) ** 2, 0.0)
    total = float(np.sum(information))
    value = float(information @ steps) / total
    at_odds = float(information @ (steps - value) ** 2) / max(int(np.count_nonzero(shown)) - 1, 1)
    sigma = max(float(np.min(sigmas[shown])), math.sqrt(at_odds / total))
    agree = np.abs(steps - value)[shown] < np.maximum(3.0 * sigmas[shown], ALIKE * abs(value))
    return abs(value) / sigma, value, bool(np.all(agree) and np.count_nonzero(shown) > 1), k


def _robust_mean(lag: Array, weight: Array) -> tuple[Array, Array]:
    """Mean (3,) s of lags (B, 3) s and its sigma by their scatter, infinite where too few show."""
    total = np.maximum(weight.sum(axis=0), TINY)
    mean = np.sum(weight * lag, axis=0) / total
    for _ in range(ROUNDS):
        used = weight / (1.0 + weight * ((lag - mean) / ROBUST) ** 2)
        mean = np.sum(used * lag, axis=0) / np.maximum(used.sum(axis=0), TINY)
    count = np.count_nonzero(weight, axis=0)
    scatter = np.sum(used * (lag - mean) ** 2, axis=0) / np.maximum(count - 1, 1)
    sigma = np.sqrt(np.maximum(scatter, 1.0) / np.maximum(used.sum(axis=0), TINY))
    return mean, np.where(count >= LEAST_BESIDE, sigma, np.inf)


def _line(t: Array, lag: Array, weight: Array) -> tuple[float, float, Array]:
    """Common slope of lags (B, axes) s at t (B,) s, its sigma, and the rest (B, axes), 0 without weight.

    Sigma is that of the weights, or of the scatter between blocks if larger (White 1980, of clusters).
    """
    total = np.maximum(weight.sum(axis=0), TINY)
    x, y = t[:, None] - weight.T @ t / total, lag - np.sum(weight * lag, axis=0) / total
    information = float(np.sum(weight * x**2))
    slope = float(np.sum(weight * x * y)) / max(information, TINY)
    rest = np.where(weight > 0.0, y - slope * x, 0.0)
    if information < TINY:
        return 0.0, 1.0, rest
    blocks = np.add.reduceat(np.sum(weight * x * rest, axis=1), np.unique(np.arange(BLOCKS) * len(t) // BLOCKS))
    return slope, math.sqrt(max(float(blocks @ blocks) / information, 1.0) / information), rest


def with_samples_at(session: Session, change: Change) -> Session:
    """Return the session with the times of its inertial samples and of its other sensors changed; fixes stay."""
    imu, mag, wheel = session.imu, session.mag, session.wheel_speed
    return replace(
        session,
        imu=None if imu is None else replace(imu, t=_changed(imu.t, change)),
        mag=None if mag is None else replace(mag, t=_changed(mag.t, change)),
        wheel_speed=None if wheel is None else replace(wheel, t=_changed(wheel.t, change)),
        channels=tuple(replace(channel, t=_changed(channel.t, change)) for channel in session.channels),
    )


def _changed(t: Array, change: Change) -> Array:
    """Times (N,) s changed, a piece at a time: those of a day are in a file."""
    out = roomy(t.shape)
    for part in pieces(len(t)):
        out[part] = change(t[part])
        release(t, out)
    return out


@dataclass(frozen=True, eq=False)
class Retimed:
    """A JointPosition for times of another clock; `own` converts them to those of the joint."""

    joint: JointPosition
    own: Change

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        return self.joint.covariance(self.own(t), direction_n)


# Sessions whose clock is off by more than any crystal: estimated in true seconds, reported in their own.

CRYSTAL = 2e-3  # a crystal drifts less, which is not corrected
LARGEST_SCALE = 0.1  # error of a clock
FEWEST_FIXES, SHORTEST = 50, 20.0  # s
ENOUGH = 200  # fixes, evenly taken
STEADY = 0.05  # s; how far typical fixes may lie off the line
REPORTED = 3e-4  # 16 ms of a lap of 53 s, the uncertainty of a lap time
READABLE = 0.06  # s over a session, which stamps with a jitter of some ms show


def clock_scale(session: Session) -> float:
    """Return the seconds of the session in a true one; 1 where its clock is good, or unknown."""
    slope, _ = _against_utc(session)
    return slope if CRYSTAL < abs(slope - 1.0) < LARGEST_SCALE else 1.0


def utc_clock(session: Session, smoothed: Trajectory) -> UtcClock | None:
    """UTC of the motion, from the first row on, which is to the millisecond as results store it.

    None where it is unknown. Every time of day is computed from here. A receiver reports when a fix was true, and the
    clock of the session stamps it when it arrives: later by the latency, where that is observable.
    """
    if (stamped := clock_of_fixes(session)) is None:
        return None
    start, late = float(smoothed.t[0]), 0.0
    latency = smoothed.report.identified.get("gps_position_latency")
    if latency is not None and latency.observable and isinstance(latency.value, float) and _has_utc(session.gnss):
        late = latency.value
    return UtcClock(start, round(stamped.at(start) + late, 3), stamped.rate)


def clock_of_fixes(session: Session) -> UtcClock | None:
    """UTC at which fixes were true, by their stamps; None where it is unknown."""
    unix_s, t = session.gnss.unix_s, session.gnss.t
    if unix_s is None or not _has_utc(session.gnss):
        return None if session.unix_at_zero is None else UtcClock(0.0, session.unix_at_zero)
    slope, _ = _against_utc(session)
    rate = 1.0 / slope if abs(slope - 1.0) < LARGEST_SCALE else 1.0
    return UtcClock(float(t[0]), float(np.nanmedian(unix_s - rate * (t - t[0]))), rate)


def _has_utc(fixes: GnssFixes) -> bool:
    """Whether fixes have UTC."""
    return fixes.unix_s is not None and bool(np.isfinite(fixes.unix_s).any())


def clock_problems(session: Session) -> tuple[Problem, ...]:
    """Report a clock that changes lap times."""
    slope, lasts = _against_utc(session)
    off = abs(slope - 1.0)
    if not max(REPORTED, READABLE / lasts) < off < LARGEST_SCALE:
        return ()
    runs = f"{100.0 * off:.2g} % {'fast' if slope > 1.0 else 'slow'}"
    mended = "; corrected in speeds and positions" if off > CRYSTAL else ""
    text = f"the recording's clock runs {runs} against the receiver's UTC{mended}; t_s and lap times are in its seconds"
    return (Problem("clock_scale", f"{text}, of which a minute has {60.0 * slope:.2f}"),)


def _against_utc(session: Session) -> tuple[float, float]:
    """Seconds of the session in one of UTC, and its duration in UTC, s; (1, infinite) where it is unknown."""
    unix_s, t = session.gnss.unix_s, session.gnss.t
    if unix_s is None:
        return 1.0, np.inf
    known = np.flatnonzero(np.isfinite(unix_s))
    if known.size < FEWEST_FIXES or abs(unix_s[known[-1]] - unix_s[known[0]]) < SHORTEST:
        return 1.0, np.inf
    some = known[:: -(-known.size // ENOUGH)]
    utc, t = unix_s[some] - unix_s[some[0]], t[some]
    slope = _slope(utc, t)
    rest = t - slope * utc
    scatter = float(np.median(np.abs(rest - np.median(rest))))
    return (slope, float(abs(utc[-1]))) if scatter < STEADY else (1.0, np.inf)


def _slope(x: Array, y: Array) -> float:
    """Median slope of all pairs of points with different x. Source: Sen 1968."""
    i, j = np.triu_indices(x.size, 1)
    distinct = np.abs(x[j] - x[i]) > 1.0
    return float(np.median((y[j] - y[i])[distinct] / (x[j] - x[i])[distinct])) if distinct.any() else 1.0


def in_true_time(session: Session, scale: float) -> Session:
    """Return the session with its times in true seconds since its zero."""
    change = partial(np.multiply, 1.0 / scale)
    return replace(with_samples_at(session, change), gnss=replace(session.gnss, t=change(session.gnss.t)))


def in_session_time(trajectory: Trajectory, scale: float) -> Trajectory:
    """Return the trajectory with its times on the clock of the session; all else stays in true seconds."""
    report, joint = trajectory.report, trajectory.joint
    if report.keyframes is not None:
        report = replace(report, keyframes=replace(report.keyframes, t=report.keyframes.t * scale))
    if joint is not None:
        joint = Retimed(joint, partial(np.multiply, 1.0 / scale))
    return replace(trajectory, t=trajectory.t * scale, report=report, joint=joint)
