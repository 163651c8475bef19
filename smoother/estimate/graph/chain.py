"""Solve and invert a bordered block-tridiagonal system: a chain of keyframes plus a few constants of the session.

The normal equations of a smoothed session couple each keyframe to its neighbours only, and every keyframe to the
constants (latencies, lever arm). Cyclic reduction eliminates every second keyframe at a time, so that all work is done
on stacks of small matrices; going back up gives the solution and the blocks of the covariance next to the diagonal,
which is all that sigmas, noise estimation and output need, at a cost linear in the number of keyframes.

Source: Golub & Van Loan, Matrix Computations, 4th ed., 4.5.4 (cyclic reduction); Takahashi et al. 1973 (selected
inverse from the factors). Owns no model: it sees matrices only.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray


class NotPositiveDefiniteError(ArithmeticError):
    """The system does not determine every unknown."""


@dataclass(frozen=True, eq=False)
class ChainSystem:
    """Normal equations `H x = g`: K keyframes of n unknowns each, m constants.

    diagonal (K, n, n); upper (K-1, n, n), block (k, k+1); border (K, n, m), block (k, constants); corner (m, m);
    rhs (K, n); rhs_constants (m,).
    """

    diagonal: Array
    upper: Array
    border: Array
    corner: Array
    rhs: Array
    rhs_constants: Array


@dataclass(frozen=True, eq=False)
class ChainSolution:
    """Solution and selected covariance of a ChainSystem.

    x (K, n), constants (m,); covariance (K, n, n) of each keyframe, cross (K-1, n, n) of neighbours (k, k+1),
    constants_covariance (m, m), constants_cross (K, n, m); log_determinant of H.
    """

    x: Array
    constants: Array
    covariance: Array
    cross: Array
    constants_covariance: Array
    constants_cross: Array
    log_determinant: float
    factor: "ChainFactor | None" = None  # of the system, where the covariance was asked for


@dataclass(frozen=True, eq=False)
class _Level:
    """What eliminating the odd nodes left behind: gains towards both even neighbours, and their own inverse."""

    inverse: Array  # (M, n, n)
    to_left: Array  # (M, n, n): D^-1 A(odd, left)
    to_right: Array  # (M, n, n), zero where there is no right neighbour
    n_nodes: int


@dataclass(frozen=True, eq=False)
class ChainFactor:
    """A factored ChainSystem, which knows the covariance of any two of its keyframes."""

    _levels: list[_Level]
    _last: Array  # (n, n) inverse of the node that is left
    _scale: Array  # (K, n) of the unknowns
    _influence: Array  # (K, n, m) of the constants, scaled
    _constants_covariance: Array

    def covariance(self, first: IntArray, left: Array, right: Array, constants: Array) -> Array:
        """Covariance (q, q) of q linear functions of keyframes `first` and `first + 1` (q,) and of the constants.

        left, right (q, n), constants (q, m): their coefficients. The forward half of cyclic reduction is followed for
        each function: it lives in two neighbouring nodes at every level, of which one is eliminated.
        """
        left, right = left * self._scale[first], right * self._scale[first + 1]
        by_constants = constants - np.einsum("qi,qim->qm", left, self._influence[first])
        by_constants -= np.einsum("qi,qim->qm", right, self._influence[first + 1])
        out = by_constants @ self._constants_covariance @ by_constants.T
        node = first
        for level in self._levels:
            is_odd = (node % 2 == 1)[:, None]
            odd = np.minimum(node // 2, len(level.inverse) - 1)  # beyond the end there is nothing to eliminate
            gone = np.where(is_odd, left, right)
            weighted = np.einsum("qij,qj->qi", level.inverse[odd], gone)
            out += (odd[:, None] == odd[None, :]) * (gone @ weighted.T)
            to_left = -np.einsum("qij,qi->qj", level.to_left[odd], gone)
            to_right = -np.einsum("qij,qi->qj", level.to_right[odd], gone)
            left, right = np.where(is_odd, to_left, to_left + left), np.where(is_odd, to_right + right, to_right)
            node = node // 2
        return np.asarray(out + left @ self._last @ left.T)


def solve_chain(system: ChainSystem, *, with_covariance: bool = True, held: Array | None = None) -> ChainSolution:
    """Solve `system`, and unless told otherwise invert it at and beside the diagonal.

    held (m, m): covariance of constants that are known from elsewhere; they do not move.
    Raises NotPositiveDefiniteError when a pivot block is not positive definite or a number not finite.
    """
    if not all(np.isfinite(np.sum(part)) for part in vars(system).values()):
        raise NotPositiveDefiniteError("the system holds a number that is not finite")
    information = np.einsum("kii->ki", system.diagonal)
    if not np.all(information > 0.0):
        raise NotPositiveDefiniteError("an unknown has no information at all")
    scale = 1.0 / np.sqrt(information)
    square, beside = scale[:, :, None] * scale[:, None, :], scale[:-1, :, None] * scale[1:, None, :]
    rhs = np.concatenate([system.border, system.rhs[:, :, None]], axis=2) * scale[:, :, None]

    levels, offsets, root, log_determinant = _reduce(system.diagonal * square, system.upper * beside, rhs)
    x = _substitute(levels, offsets, root[1])
    K, n, m = system.border.shape
    inner = rhs.reshape(K * n, m + 1)[:, :m].T @ x.reshape(K * n, m + 1)
    influence, solution = np.ascontiguousarray(x[:, :, :m]), x[:, :, m].copy()
    del rhs, x, offsets  # a long session needs the room for its covariance
    constants_covariance, constants = np.zeros((m, m)), np.zeros(m)
    if held is not None:
        constants_covariance = held
    elif m:
        factor = _cholesky((system.corner - inner[:, :m])[None])[0]
        constants_covariance = _inverse_from_cholesky(factor[None])[0]
        constants = constants_covariance @ (system.rhs_constants - inner[:, m])
        log_determinant += 2.0 * float(np.sum(np.log(np.diag(factor))))
        solution = solution - influence @ constants
    log_determinant -= 2.0 * float(np.sum(np.log(scale)))

    if with_covariance:
        covariance, cross = _selected_inverse(levels, root[0])
        weighted = (influence.reshape(K * n, m) @ constants_covariance).reshape(K, n, m)
        influence_t = influence.transpose(0, 2, 1)
        covariance += weighted @ influence_t
        cross += weighted[:-1] @ influence_t[1:]
        constants_cross = -weighted * scale[:, :, None]
        covariance *= square
        cross *= beside
    else:
        covariance, cross, constants_cross = np.empty((0, 0, 0)), np.empty((0, 0, 0)), np.empty((0, 0, 0))
    return ChainSolution(
        solution * scale,
        constants,
        covariance,
        cross,
        constants_covariance,
        constants_cross,
        log_determinant,
        ChainFactor(levels, root[0][0], scale, influence, constants_covariance) if with_covariance else None,
    )


def _reduce(diagonal: Array, upper: Array, rhs: Array) -> tuple[list[_Level], list[Array], tuple[Array, Array], float]:
    """Eliminate odd nodes until one is left.

    Returns the levels, D^-1 rhs (M, n, m + 1) of each, (inverse, solution) of the last node, and log det.
    """
    levels: list[_Level] = []
    offsets: list[Array] = []
    log_determinant = 0.0
    while diagonal.shape[0] > 1:
        n_nodes = diagonal.shape[0]
        odd = diagonal[1::2]
        n_odd = odd.shape[0]
        left = upper[0::2].transpose(0, 2, 1)  # A(odd, left even)
        right = np.zeros_like(odd)
        right[: upper[1::2].shape[0]] = upper[1::2]  # A(odd, right even)

        factor = _cholesky(odd)
        log_determinant += 2.0 * float(np.sum(np.log(np.einsum("kii->ki", factor))))
        inverse = _inverse_from_cholesky(factor)
        to_left, to_right, offset = inverse @ left, inverse @ right, inverse @ rhs[1::2]
        levels.append(_Level(inverse, to_left, to_right, n_nodes))
        offsets.append(offset)

        next_diagonal, next_rhs = diagonal[0::2].copy(), rhs[0::2].copy()
        n_right = next_diagonal.shape[0] - 1  # odd nodes that have a right neighbour
        left_t, right_t = left.transpose(0, 2, 1), right[:n_right].transpose(0, 2, 1)
        next_diagonal[:n_odd] -= left_t @ to_left
        next_rhs[:n_odd] -= left_t @ offset
        next_diagonal[1:] -= right_t @ to_right[:n_right]
        next_rhs[1:] -= right_t @ offset[:n_right]
        diagonal, rhs, upper = next_diagonal, next_rhs, -(left_t[:n_right] @ to_right[:n_right])
    factor = _cholesky(diagonal)
    log_determinant += 2.0 * float(np.sum(np.log(np.einsum("kii->ki", factor))))
    inverse = _inverse_from_cholesky(factor)
    return levels, offsets, (inverse, inverse @ rhs), log_determinant


def _substitute(levels: list[_Level], offsets: list[Array], root: Array) -> Array:
    x = root
    for level, offset in zip(reversed(levels), reversed(offsets), strict=True):
        n_odd = level.inverse.shape[0]
        right = _right_neighbours(x, n_odd)
        fine = np.empty((level.n_nodes, *x.shape[1:]))
        fine[0::2] = x
        fine[1::2] = offset - level.to_left @ x[:n_odd] - level.to_right @ right
        x = fine
    return x


def _selected_inverse(levels: list[_Level], root: Array) -> tuple[Array, Array]:
    P, cross = root, np.empty((0, *root.shape[1:]))
    for level in reversed(levels):
        n_odd = level.inverse.shape[0]
        P_left, P_right, P_left_right = P[:n_odd], _right_neighbours(P, n_odd), np.zeros((n_odd, *P.shape[1:]))
        P_left_right[: cross.shape[0]] = cross
        odd_left = -(level.to_left @ P_left + level.to_right @ P_left_right.transpose(0, 2, 1))
        odd_right = -(level.to_left @ P_left_right + level.to_right @ P_right)
        odd = (
            level.inverse - odd_left @ level.to_left.transpose(0, 2, 1) - odd_right @ level.to_right.transpose(0, 2, 1)
        )
        fine, fine_cross = np.empty((level.n_nodes, *P.shape[1:])), np.empty((level.n_nodes - 1, *P.shape[1:]))
        fine[0::2], fine[1::2] = P, 0.5 * (odd + odd.transpose(0, 2, 1))
        fine_cross[0::2] = odd_left.transpose(0, 2, 1)
        fine_cross[1::2] = odd_right[: fine_cross[1::2].shape[0]]
        P, cross = fine, fine_cross
    return P, cross


def _right_neighbours(x: Array, n_odd: int) -> Array:
    right = np.zeros((n_odd, *x.shape[1:]))
    right[: x.shape[0] - 1] = x[1 : n_odd + 1]
    return right


def _cholesky(blocks: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(blocks), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise NotPositiveDefiniteError("the data does not determine every unknown") from error


def _inverse_from_cholesky(factor: Array) -> Array:
    """Inverse of `factor @ factor.T`, by forward substitution over the whole stack at once."""
    n = factor.shape[-1]
    inverse = np.zeros_like(factor)
    for i in range(n):
        row = -(factor[:, i, None, :i] @ inverse[:, :i, :])[:, 0, :]
        row[:, i] += 1.0
        inverse[:, i] = row / factor[:, i, i, None]
    return np.asarray(inverse.transpose(0, 2, 1) @ inverse)
