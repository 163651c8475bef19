"""How the errors of the antenna's position at several times hang together, of one chain and of windows of one."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import Shelf, release
from smoother.estimate.graph.chain import ChainFactor
from smoother.estimate.graph.rows import antenna_jacobian
from smoother.estimate.graph.state import CONSTANTS_SIZE, ROW_CONSTANTS_SIZE, ChainState

COARSER = 2  # times that every second keyframe is left out: at 0.8 s a position's error is still a straight line


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
