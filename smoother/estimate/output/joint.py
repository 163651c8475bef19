"""Joint covariance of the errors of the antenna's position at several times, of one chain and of windows.

The graph assumes independent Doppler velocities. Their slow errors add up: of two modules in one car each wanders by
0.35 m from the other's course in a minute, where 0.1 m would be expected (`benchmarks/twins.py`). No session shows that
by itself, so the usual one of receivers is added to the covariance of a chain (:class:`WithUnseen`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, median
from smoother.disc import Shelf, release
from smoother.estimate.factors.gnss import arm_axes
from smoother.estimate.factors.rows import Between, no_jacobian
from smoother.estimate.fixes.slow_errors import DOPPLER, SlowErrors
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, State
from smoother.estimate.solvers.covariance import Chain
from smoother.trajectory import JointPosition

THINNED = 4  # one keyframe of so many is kept of a window: in 0.8 s a position's error is still a straight line
ALWAYS = 1e6  # s
CHANGES = 20  # pairs of times for the usual change of a position
POSITION_TAU = 300.0  # s, time constant of the correction of a position by fixes


@dataclass(frozen=True, eq=False)
class WithUnseen:
    """The JointPosition of a session, with the errors that it cannot show.

    unseen (3,) m^2: variance of the constant part of the slow error of the fixes. variance m^2: the usual one of a
    position along one level direction of a path that follows Doppler velocities; None without Doppler. errors: slow
    ones, where laps show them. The slow error of Doppler reduces the correlation of two positions, not their variances:
    by :meth:`changed`, bounded by the variance. (A product with a correlation stays a covariance: Schur.)
    """

    joint: JointPosition
    unseen: Array
    variance: float | None
    errors: SlowErrors | None = None

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        P = self.joint.covariance(t, direction_n) + (direction_n * self.unseen) @ direction_n.T
        if self.variance is None:
            return P
        most = 0.5 * float(self.changed(np.array(ALWAYS)))
        lost = 0.5 * self.changed(np.abs(t[:, None] - t[None, :])) / (self.variance + most)
        return np.asarray(P * (1.0 - lost))

    def changed(self, interval: Array) -> Array:
        """Variance (N,) m^2 of the change of a position over `interval` (N,) s by the slow error of Doppler."""
        return wander(interval) if self.errors is None else self.errors.parted(interval)


def wander(interval: Array | float) -> Array:
    """Variance, m^2 per axis, of the change of a position over `interval` s by the slow error of Doppler velocities.

    Velocity forgets with rate c, position with rate a: p' = -a p + b, two first-order lags in a row (Gelb 1974, 3.8).
    """
    c, a = 1.0 / DOPPLER.tau, 1.0 / POSITION_TAU
    scale = DOPPLER.sigma**2 * c / (c**2 - a**2)
    return np.asarray(
        2.0 * scale * (-np.expm1(-a * np.asarray(interval)) / a + np.expm1(-c * np.asarray(interval)) / c)
    )


def usual_change(joint: JointPosition, start: float, end: float, interval: float) -> float:
    """Return the usual variance per level axis, m^2, of a change over `interval` s between start and end, s.

    The median, since over an outage it is many times that. Zero where the time is too short.
    """
    if end - start <= interval:
        return 0.0
    at = np.repeat(np.linspace(start, end - interval, CHANGES), 2)
    direction_n = np.tile(np.eye(3)[:2], (CHANGES, 1))
    P = joint.covariance(np.concatenate([at, at + interval]), np.concatenate([direction_n, direction_n]))
    n = len(at)
    return median(np.diag(P)[:n] + np.diag(P)[n:] - 2.0 * np.diagonal(P, n))


@dataclass(frozen=True, eq=False)
class ChainPositions:
    """The JointPosition of a solved chain; state: that it was linearised at."""

    state: State
    chain: Chain

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        between = Between.at(self.state, t)
        left, right = no_jacobian(len(t), 3)
        between.put_value(left, right, between.of_position())
        axes = arm_axes(between)
        if not self.state.geometry.is_steered:
            between.put_turn(left, right, -so3.skew(axes @ self.state.constants["lever_arm"]))
        by_left, by_right, by_arm = (np.einsum("qi,qij->qj", direction_n, J) for J in (left, right, axes))
        constants = np.zeros((len(t), CONSTANTS_SIZE))
        constants[:, COLUMNS["lever_arm"]] = by_arm
        return self.chain.joint(between.interval, by_left, by_right, constants)


@dataclass(frozen=True, eq=False)
class WindowPositions(ChainPositions):
    """That of a window, which counts from time `first` to `last`, s, and knows positions over all times of `state`."""

    first: float
    last: float

    def room(self, t: Array) -> Array:
        """Time (m,) s from t (m,) to the nearer end of the window, negative outside."""
        return np.asarray(np.minimum(t - self.state.t[0], self.state.t[-1] - t))


def window_positions(first: float, last: float, state: State, chain: Chain) -> WindowPositions:
    """Return what is worth keeping of a window that counts from time `first` to `last`: arrays on the disc."""
    thin = chain.thinned(THINNED)
    shelf = Shelf(thin.gain.size + thin.influence.size + thin.root.size, large=1 << 20)
    kept = Chain(shelf.keep(thin.gain), shelf.keep(thin.influence), shelf.keep(thin.root), thin.constants)
    return WindowPositions(state.part(slice(None, None, THINNED)), kept, first, last)


@dataclass(frozen=True, eq=False)
class WindowsJoint:
    """The JointPosition of a session in windows.

    Two times in one window, as those of a lap, have the joint covariance of it; others are independent. The variance of
    a single time is that of the window it counts in.
    """

    windows: Sequence[WindowPositions]

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        own, change, room = np.zeros(len(t)), np.zeros((len(t), len(t))), np.full((len(t), len(t)), -np.inf)
        for i, window in enumerate(self.windows):
            inside = np.flatnonzero((window.room(t) >= 0.0) | self._counts(i, t))
            if inside.size == 0:
                continue
            P = window.covariance(t[inside], direction_n[inside])
            release(window)  # all of a day's are most of a gigabyte
            variance, here = np.diag(P), np.ix_(inside, inside)
            counts = self._counts(i, t[inside])
            own[inside[counts]] = variance[counts]
            both = np.minimum.outer(window.room(t[inside]), window.room(t[inside]))
            better = both > room[here]
            change[here] = np.where(better, variance[:, None] + variance - 2.0 * P, change[here])
            room[here] = np.where(better, both, room[here])
        together = 0.5 * (own[:, None] + own - change)
        P = np.where(room > -np.inf, together, 0.0)
        np.fill_diagonal(P, own)
        return P

    def _counts(self, i: int, t: Array) -> BoolArray:
        """Whether times t (m,) are those of window i; the ends of the session count to its first and last one."""
        after = (t >= self.windows[i].first) | (i == 0)
        return np.asarray(after & ((t < self.windows[i].last) | (i + 1 == len(self.windows))))
