"""Residuals and Jacobians of everything that is not inertial, on the whole session at once.

A measurement may fall anywhere between two keyframes, whose cubic Hermite curve it reads. So it touches the two
keyframes around it and the session's constants, and a latency is only a shift of the time at which the curve is read.

Residuals are prediction minus measurement, in the unit of the measurement; `sigma` whitens them.
"""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.graph.arm import arm_axes
from smoother.estimate.graph.state import (
    KEYFRAME_SIZE,
    LEVER_ARM,
    ROTATION,
    ROW_CONSTANTS_SIZE,
    TRANSLATION,
    VELOCITY,
    ChainState,
)


@dataclass(frozen=True, eq=False)
class Rows:
    """N measurements of r components between keyframes `interval` (N,) and `interval + 1`.

    residual, sigma (N, r); left, right (N, r, 18) Jacobians by the keyframes; constants (N, r, 16). A component that
    was not measured has infinite sigma. `name` labels statistics; weight (N,) is the robust weight, 1 where none is.
    """

    name: str
    interval: np.ndarray
    residual: Array
    sigma: Array
    left: Array
    right: Array
    constants: Array
    weight: Array

    @property
    def information(self) -> Array:
        """Weight of each component, (N, r): robust weight over variance."""
        return self.weight[:, None] / self.sigma**2

    @property
    def are_alike(self) -> bool:
        """Whether Jacobians and sigmas are broadcast, one for all, and all weigh the same."""
        one_for_all = (values.strides[0] == 0 for values in (self.left, self.right, self.constants, self.sigma))
        return all(one_for_all) and bool(np.all(self.weight == 1.0))


@dataclass(frozen=True, eq=False)
class Bracket:
    """Where times fall in the chain: interval (N,), share (N,) of it gone by, and its length T, s."""

    interval: np.ndarray
    share: Array
    length: float


def bracket(state: ChainState, t: Array) -> Bracket:
    """Return the intervals that hold the times t (N,); times beyond the chain count to its first or last interval."""
    T = state.interval
    u = (t - state.t[0]) / T
    interval = np.clip(np.floor(u).astype(np.int64), 0, len(state.t) - 2)
    return Bracket(interval, np.clip(u - interval, 0.0, 1.0), T)


def hermite_position(b: Bracket) -> tuple[Array, Array, Array, Array]:
    """Weights (N,) of left position, left velocity, right position, right velocity in the position between."""
    s, T = b.share, b.length
    h01 = s**2 * (3.0 - 2.0 * s)
    return 1.0 - h01, T * s * (1.0 - s) ** 2, h01, -T * s**2 * (1.0 - s)


def antenna_jacobian(state: ChainState, t: Array) -> tuple[IntArray, Array, Array, Array]:
    """How the antenna's position in n at times t (N,) depends on the keyframes around them and on the constants.

    Returns interval (N,), and Jacobians (N, 3, 18) by its left and right keyframe and (N, 3, 16) by the row constants.
    """
    b = bracket(state, t)
    R_left, R_right = state.R_ns[b.interval], state.R_ns[b.interval + 1]
    R_ns = R_left @ so3.exp(b.share[:, None] * so3.log(R_left.transpose(0, 2, 1) @ R_right))
    left, right, constants = empty_jacobians(len(t), 3)
    _put_curve(left, right, state, b, hermite_position(b))
    if state.constants.is_steered:
        axes = arm_axes(state)
        constants[:, :, LEVER_ARM] = _between(b, axes.reshape(-1, 9)).reshape(-1, 3, 3)
    else:
        _put_turn(left, right, state, b, -so3.skew(R_ns @ state.constants.lever_arm_s))
        constants[:, :, LEVER_ARM] = R_ns
    return b.interval, left, right, constants


def empty_jacobians(n: int, r: int) -> tuple[Array, Array, Array]:
    """Zeros for the Jacobians of n rows of r components by left and right keyframe and by the row constants."""
    return np.zeros((n, r, KEYFRAME_SIZE)), np.zeros((n, r, KEYFRAME_SIZE)), np.zeros((n, r, ROW_CONSTANTS_SIZE))


def _between(b: Bracket, values: Array) -> Array:
    share = b.share[:, None]
    return np.asarray((1.0 - share) * values[b.interval] + share * values[b.interval + 1])


def _put_curve(left: Array, right: Array, state: ChainState, b: Bracket, weights: tuple[Array, ...]) -> None:
    left_p, left_v, right_p, right_v = (w[:, None, None] for w in weights)
    left[:, :, TRANSLATION] = left_p * state.R_ns[b.interval]
    right[:, :, TRANSLATION] = right_p * state.R_ns[b.interval + 1]
    left[:, :, VELOCITY] = left_v * np.eye(3)
    right[:, :, VELOCITY] = right_v * np.eye(3)


def _put_turn(left: Array, right: Array, state: ChainState, b: Bracket, by_turn_n: Array) -> None:
    """Jacobian (N, r, 3) by a small turn in n, shared between the ends in proportion to time."""
    left[:, :, ROTATION] = (1.0 - b.share)[:, None, None] * (by_turn_n @ state.R_ns[b.interval])
    right[:, :, ROTATION] = b.share[:, None, None] * (by_turn_n @ state.R_ns[b.interval + 1])
