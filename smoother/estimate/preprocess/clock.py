"""The samples' clock against that of the fixes: a drift, which the lags of the stretches show.

One logger stamps both by one clock. Others count samples at their nominal rate, which a sensor's own oscillator keeps
to a per cent, or stamp fixes by the receiver's UTC. Such a clock shifts the lags of forward force, left force and yaw
rate alike, evenly over the session. What shifts one or two of them is slip, lean, or a steering wheel.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces, release, roomy
from smoother.estimate.preprocess.streams import Streams
from smoother.samples import Problem, Session
from smoother.trajectory import Identified, JointPosition

Change = Callable[[Array], Array]

USUAL_DRIFT = 5e-5  # of a quartz against GPS, beforehand
LARGEST_DRIFT = 0.03  # more is no clock
SIGNIFICANT = 5.0  # sigmas of a drift
ALIKE = 0.25  # of a drift, by which axes may differ unless by their own sigmas; a real kart's slip makes 0.33
ROUNDS, ROBUST = 6, 3.0  # of reweighting; sigmas
BLOCKS = 10  # of a session, whose errors are independent
TINY = 1e-12


@dataclass(frozen=True)
class Drift:
    """Drift of the samples' clock, s per s, and its sigma; is_sure: significant, axes and halves agree."""

    value: float
    sigma: float
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
        return Clock(both, beyond.sigma, True, self.zero if self.drifts else zero)

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

    An error of the path along the track is common to all axes: together they are no better known than the best one,
    nor than by what they contradict one another. A step is no drift: its halves have other slopes than the whole.
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
