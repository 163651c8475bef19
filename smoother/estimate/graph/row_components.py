"""What a solution leaves of measurements: squared residuals beside what is expected of them."""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.normal_equations import used_columns
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.state import ROW_CONSTANTS_SIZE

TOGETHER = 256  # rows whose covariances are worked on together


def posterior_variance(rows: Rows, solution: ChainSolution) -> Array:
    """Variance (N, r) that the solution leaves in the prediction of `rows`."""
    out = np.empty(rows.residual.shape)
    of_left, of_right = used_columns(rows.left), used_columns(rows.right)
    own = slice(0, ROW_CONSTANTS_SIZE)
    P, S, cross = solution.covariance, solution.constants_covariance[own, own], solution.constants_cross
    for part in pieces(len(out), TOGETHER):
        k, constants = rows.interval[part], rows.constants[part]
        left, right = rows.left[part, :, of_left], rows.right[part, :, of_right]
        by_left = left @ P[k, of_left, of_left]
        by_right = right @ P[k + 1, of_right, of_right] + 2.0 * (left @ solution.cross[k, of_left, of_right])
        by_constants = left @ cross[k, of_left, own] + right @ cross[k + 1, of_right, own]
        by_constants = 2.0 * by_constants + constants @ S
        out[part] = _dot(by_left, left) + _dot(by_right, right) + _dot(by_constants, constants)
    return out


def _dot(one: Array, two: Array) -> Array:
    return np.asarray(np.einsum("nri,nri->nr", one, two))


@dataclass(frozen=True, eq=False)
class RowComponent:
    """Squared residuals of rows over their variances, and what is expected of them, each (N, r); 0 where unknown."""

    squares: Array
    expected: Array

    @classmethod
    def of(cls, rows: Rows, solution: ChainSolution) -> "RowComponent":
        """Of `rows` after the step of `solution`."""
        information = rows.information
        left = rows.weight[:, None] - posterior_variance(rows, solution) * information
        return cls(rows.residual**2 * information, np.where(information > 0.0, np.maximum(left, 0.0), 0.0))

    def only(self, chosen: BoolArray) -> "RowComponent":
        """The component of the rows (N,) that are chosen; nothing of the others."""
        return RowComponent(self.squares * chosen[:, None], self.expected * chosen[:, None])
