"""The inertial part of the graph: GTSAM's CombinedImuFactor over every interval, linearised into the chain."""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.state import (
    ACCEL_ERROR,
    RECTIFICATION,
)

_INERTIAL = slice(0, 15)
_ERRORS = slice(ACCEL_ERROR.start, RECTIFICATION.stop)
_LEFT, _RIGHT, _BY_ERRORS = slice(0, 15), slice(15, 30), slice(30, 45)  # columns of a factor's Jacobian,
_RESIDUAL = 45  # and of its residual beside it
_WIDTH = _RESIDUAL + 1
PIECE = 128  # intervals whose matrices stay in the processor's cache


@dataclass(frozen=True, eq=False)
class LinearInertial:
    """Whitened factors (K-1, 15, 46): jacobian (K-1, 15, 45), of which left and right are by the inertial part of the
    ends and errors by scale, misalignment and rectification, and beside it residual (K-1, 15).
    """

    whitened: Array

    @property
    def jacobian(self) -> Array:
        """Jacobian (K-1, 15, 45) by left, right and errors."""
        return self.whitened[:, :, : _BY_ERRORS.stop]

    @property
    def residual(self) -> Array:
        """Residuals (K-1, 15)."""
        return self.whitened[:, :, _RESIDUAL]

    @property
    def left(self) -> Array:
        """Jacobian (K-1, 15, 15) by the left keyframes."""
        return self.jacobian[:, :, _LEFT]

    @property
    def right(self) -> Array:
        """Jacobian (K-1, 15, 15) by the right keyframes."""
        return self.jacobian[:, :, _RIGHT]

    @property
    def errors(self) -> Array:
        """Jacobian (K-1, 15, 15) by scale, misalignment and rectification."""
        return self.jacobian[:, :, _BY_ERRORS]


def inertial_after_step(linear: LinearInertial, at: IntArray, solution: ChainSolution) -> Array:
    """Residuals (N, 15) of the factors `at` (N,) that the linear model predicts after the step of `solution`."""
    moved = np.ones((len(at), _WIDTH))  # the last one takes the residual as it was
    moved[:, _LEFT], moved[:, _RIGHT] = solution.x[at, _INERTIAL], solution.x[at + 1, _INERTIAL]
    moved[:, _BY_ERRORS] = solution.constants[_ERRORS]
    return np.asarray((linear.whitened[at] @ moved[:, :, None])[:, :, 0])


@dataclass(frozen=True, eq=False)
class VarianceComponent:
    """Weighted squared residuals that one source of noise answers for, and how many independent ones they amount to.

    Of each of N intervals (N,), three residuals in each; and of all of them by direction (3, 3), whitened with the
    shape that the noise was given: squares_in over redundancy_in is what it lacks, their traces are the sums.
    """

    squares_of: Array
    redundancy_of: Array
    squares_in: Array
    redundancy_in: Array

    @property
    def squares(self) -> float:
        """Of all intervals together."""
        return float(np.sum(self.squares_of))

    @property
    def redundancy(self) -> float:
        """Of all intervals together."""
        return float(np.sum(self.redundancy_of))
