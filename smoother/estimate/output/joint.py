"""How the errors of the antenna's position at several times hang together, of one chain and of windows of one.

A graph takes Doppler velocities for independent of one another. They nearly are, but what is left adds up: of two
modules in one car each wanders by 0.35 m from the other's course in a minute, where 0.1 m would be expected
(`benchmarks/twins.py`). No session shows that by itself, since neither fixes nor samples judge it; so what receivers
are known to do is added to what a chain says (:class:`Wandering`).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import Shelf, release
from smoother.estimate.graph.chain import ChainFactor
from smoother.estimate.graph.rows import antenna_jacobian
from smoother.estimate.graph.state import CONSTANTS_SIZE, ROW_CONSTANTS_SIZE, ChainState
from smoother.estimate.slow_doppler import DOPPLER
from smoother.trajectory import JointPosition

COARSER = 2  # times that every second keyframe is left out: at 0.8 s a position's error is still a straight line


PLACE_TAU = 300.0  # s after which fixes have taken out of the place what it had added up to


@dataclass(frozen=True, eq=False)
class Wandering:
    """The JointPosition of a path that followed Doppler velocities, whose slow error makes it wander.

    variance m^2: the usual one of a place along one level direction. A place is neither surer nor less sure for
    wandering, but shares less of its error with another one: where they share all, what changes between them is
    :func:`wander`, less by what that is at most against the variance (a place known to 0.2 m wanders by no more); where
    nothing, nothing is changed. (A product with a correlation stays a covariance: Schur.)
    """

    joint: JointPosition
    variance: float

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        most = 0.5 * float(wander(np.inf))
        lost = 0.5 * wander(np.abs(t[:, None] - t[None, :])) / (self.variance + most)
        return np.asarray(self.joint.covariance(t, direction_n) * (1.0 - lost))


def wander(apart: Array | float) -> Array:
    """Variance, m^2 per axis, of the change of a place over `apart` s by the slow error of Doppler velocities.

    Velocity forgets with rate c and place with rate a: p' = -a p + b, two first-order lags in a row (Gelb 1974, 3.8).
    """
    c, a = 1.0 / DOPPLER.tau, 1.0 / PLACE_TAU
    scale = DOPPLER.sigma**2 * c / (c**2 - a**2)
    return np.asarray(2.0 * scale * (-np.expm1(-a * np.asarray(apart)) / a + np.expm1(-c * np.asarray(apart)) / c))


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """The JointPosition of a chain.

    unseen (3,) m^2: variance of the GPS offset that a session cannot show, the same at all its times.
    """

    state: ChainState
    factor: ChainFactor
    unseen: Array

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        return _of_chain(self.state, self.factor, t, direction_n) + (direction_n * self.unseen) @ direction_n.T


@dataclass(frozen=True, eq=False)
class WindowFactor:
    """A solved window for later questions: every fourth of its keyframes, its covariances on the disc.

    It counts from time `first` to `last`, s, and knows positions over the whole time of `state`.
    """

    first: float
    last: float
    state: ChainState
    factor: ChainFactor

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """Covariance (m, m) m^2 of positions at t (m,) along direction_n (m, 3), all inside."""
        return _of_chain(self.state, self.factor, t, direction_n)

    def room(self, t: Array) -> Array:
        """Time (m,) s from t (m,) to the nearer end of the window, negative outside."""
        return np.asarray(np.minimum(t - self.state.t[0], self.state.t[-1] - t))


def window_factor(first: float, last: float, state: ChainState, factor: ChainFactor) -> WindowFactor:
    """Return what is worth keeping of a window that counts from time `first` to `last`."""
    every = slice(None, None, 2 ** factor.thinnable(COARSER))
    names = ("t", "R_ns", "position_n", "velocity_n", "accel_bias_s", "gyro_bias_s", "offset_n")
    thinned = ChainState(constants=state.constants, **{name: getattr(state, name)[every].copy() for name in names})
    sizes: list[int] = []

    def counted(values: Array) -> Array:
        sizes.append(values.size)
        return values

    factor.thinned(COARSER, counted)
    shelf = Shelf(sum(sizes), large=1 << 20)
    return WindowFactor(first, last, thinned, factor.thinned(COARSER, shelf.keep))


@dataclass(frozen=True, eq=False)
class WindowsJoint:
    """The JointPosition of a session in windows.

    Two times that one window holds, as those of a lap do, are as far apart in error as it says; others are independent
    but for the offset that no session can show. Which window is asked does not change the error of a single time, which
    is that of the window it counts in: a difference of large numbers from two windows would tell of neither.
    """

    windows: Sequence[WindowFactor]
    unseen: Array

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        own, apart, room = np.zeros(len(t)), np.zeros((len(t), len(t))), np.full((len(t), len(t)), -np.inf)
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
            apart[here] = np.where(better, variance[:, None] + variance - 2.0 * P, apart[here])
            room[here] = np.where(better, both, room[here])
        together = 0.5 * (own[:, None] + own - apart)
        P = np.where(room > -np.inf, together, 0.0)
        np.fill_diagonal(P, own)
        return P + (direction_n * self.unseen) @ direction_n.T

    def _counts(self, i: int, t: Array) -> BoolArray:
        """Whether times t (m,) are those of window i; the ends of the session count to its first and last one."""
        after = (t >= self.windows[i].first) | (i == 0)
        return np.asarray(after & ((t < self.windows[i].last) | (i + 1 == len(self.windows))))


def _of_chain(state: ChainState, factor: ChainFactor, t: Array, direction_n: Array) -> Array:
    interval, *jacobians = antenna_jacobian(state, t)
    left, right, by_row_constants = (np.einsum("qi,qij->qj", direction_n, J) for J in jacobians)
    constants = np.zeros((len(t), CONSTANTS_SIZE))
    constants[:, :ROW_CONSTANTS_SIZE] = by_row_constants
    return factor.covariance(interval, left, right, constants)
