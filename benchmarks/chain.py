"""Solve and invert a bordered block-tridiagonal system: a chain of keyframes plus a few constants of the session.

The normal equations of a smoothed session couple each keyframe to its neighbours only, and every keyframe to the
constants (latencies, lever arm). Cyclic reduction eliminates every second keyframe at a time, so that all work is done
on stacks of small matrices; going back up gives the solution and the blocks of the covariance next to the diagonal,
which is all that sigmas, noise estimation and output need, at a cost linear in the number of keyframes.

Source: Golub & Van Loan, Matrix Computations, 4th ed., 4.5.4 (cyclic reduction); Takahashi et al. 1973 (selected
inverse from the factors). Owns no model: it sees matrices only.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray

PIECE = 128  # nodes whose matrices stay in the processor's cache


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
    constants_covariance (m, m), constants_cross (K, n, m).
    """

    x: Array
    constants: Array
    covariance: Array
    cross: Array
    constants_covariance: Array
    constants_cross: Array
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
    _influence: Array  # (K, n, m) of the constants
    _constants_covariance: Array

    def covariance(self, first: IntArray, left: Array, right: Array, constants: Array) -> Array:
        """Covariance (q, q) of q linear functions of keyframes `first` and `first + 1` (q,) and of the constants.

        left, right (q, n), constants (q, m): their coefficients. The forward half of cyclic reduction is followed for
        each function: it lives in two neighbouring nodes at every level, of which one is eliminated.
        """
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

    def thinnable(self, times: int) -> int:
        """How often, up to `times`, every second keyframe can be left out."""
        return min(times, len(self._levels))

    def thinned(self, times: int, keep: Callable[[Array], Array]) -> "ChainFactor":
        """Return the factor of the first, third .. keyframes alone, `times` over; `keep` copies the arrays it needs."""
        n = self.thinnable(times)
        levels = [
            _Level(keep(level.inverse), keep(level.to_left), keep(level.to_right), level.n_nodes)
            for level in self._levels[n:]
        ]
        return ChainFactor(levels, self._last, keep(self._influence[:: 2**n]), self._constants_covariance)


@np.errstate(invalid="ignore", over="ignore")  # numbers that are not finite are reported in the end
def solve_chain(system: ChainSystem) -> ChainSolution:
    """Solve `system`, and invert it at and beside the diagonal.

    Raises NotPositiveDefiniteError when a pivot block is not positive definite or a number not finite.
    """
    _check(system)
    rhs = np.concatenate([system.border, system.rhs[:, :, None]], axis=2)

    levels, offsets, (root, last), inner = _reduce(system.diagonal, system.upper, rhs)
    del rhs
    m = system.border.shape[2]
    constants_covariance, constants = np.zeros((m, m)), np.zeros(m)
    own, pull = system.corner - inner[:m, :m], system.rhs_constants - inner[:m, m]
    if m:
        constants_covariance = _inverse_from_cholesky(_cholesky(own[None]))[0]
        constants = constants_covariance @ pull
    x = _substitute(levels, offsets, last)
    del offsets, last  # a long session needs the room for its covariance
    solution = x[:, :, -1] - x[:, :, :-1] @ constants
    if not np.isfinite(np.sum(solution)):
        raise NotPositiveDefiniteError("the system holds a number that is not finite")

    influence = x[:, :, :m]
    covariance, cross = _selected_inverse(levels, root)
    constants_cross = _add_constants(covariance, cross, influence, constants_covariance)
    factor = ChainFactor(levels, root[0], influence, constants_covariance)
    return ChainSolution(solution, constants, covariance, cross, constants_covariance, constants_cross, factor)


def _check(system: ChainSystem) -> None:
    """Raise NotPositiveDefiniteError for what elimination might not see; all else leaves no pivot or no solution."""
    own = np.einsum("kii->ki", system.diagonal)
    if not all(np.isfinite(np.sum(part)) for part in (own, system.corner, system.rhs, system.rhs_constants)):
        raise NotPositiveDefiniteError("the system holds a number that is not finite")
    if not np.all(own > 0.0):
        raise NotPositiveDefiniteError("an unknown has no information at all")


def _reduce(diagonal: Array, upper: Array, rhs: Array) -> tuple[list[_Level], list[Array], tuple[Array, Array], Array]:
    """Eliminate odd nodes until one is left.

    Returns the levels, D^-1 rhs (M, n, m + 1) of each, (inverse, solution) of the last node, and rhs' H^-1 rhs
    (m + 1, m + 1) of the whole system H.
    """
    levels: list[_Level] = []
    offsets: list[Array] = []
    inner = np.zeros((rhs.shape[2], rhs.shape[2]))
    while diagonal.shape[0] > 1:
        level, offset, (diagonal, upper, rhs) = _eliminate_odd(diagonal, upper, rhs, inner)
        levels.append(level)
        offsets.append(offset)
    inverse = _inverse_from_cholesky(_cholesky(diagonal))
    last = inverse @ rhs
    return levels, offsets, (inverse, last), inner + rhs[0].T @ last[0]


def _eliminate_odd(
    diagonal: Array, upper: Array, rhs: Array, inner: Array
) -> tuple[_Level, Array, tuple[Array, Array, Array]]:
    """Eliminate every second node. Returns what is left behind, D^-1 rhs, and the system of the even nodes.

    What it takes out of rhs' H^-1 rhs is added to `inner` (m + 1, m + 1), in place.
    In pieces whose matrices stay in the processor's cache, and in the same memory: each odd node takes part in a dozen
    small products, and fresh memory for them would cost as much as they do.
    """
    (n_nodes, n), n_odd, n_right = diagonal.shape[:2], len(diagonal) // 2, (len(diagonal) - 1) // 2
    level = _Level(np.empty((n_odd, n, n)), np.empty((n_odd, n, n)), np.empty((n_odd, n, n)), n_nodes)
    offset = np.empty((n_odd, *rhs.shape[1:]))
    n_even = n_nodes - n_odd
    even_diagonal, even_upper, even_rhs = (
        np.empty((n_even, n, n)),
        np.empty((n_right, n, n)),
        np.empty_like(rhs[:n_even]),
    )
    even_diagonal[0], even_rhs[0] = diagonal[0], rhs[0]
    square, wide = np.empty((2, min(PIECE, n_odd), n, n)), np.empty((min(PIECE, n_odd), *rhs.shape[1:]))
    for here, beside in _pieces(level):
        n_here, n_beside, after = here.stop - here.start, beside.stop - beside.start, _next(beside)
        even_diagonal[after], even_rhs[after] = diagonal[0::2][after], rhs[0::2][after]
        left, right = upper[0::2][here], upper[1::2][beside]  # A(left even, odd), A(odd, right even)
        inverse = _inverse_from_cholesky(_cholesky(diagonal[1::2][here]), level.inverse[here], square[0, :n_here])
        to_left = np.matmul(inverse, left.transpose(0, 2, 1), out=level.to_left[here])
        to_right = np.matmul(inverse[:n_beside], right, out=level.to_right[beside])
        np.copyto(wide[:n_here], rhs[1::2][here])
        solved = np.matmul(inverse, wide[:n_here], out=offset[here])
        inner += wide[:n_here].reshape(n_here * n, -1).T @ solved.reshape(n_here * n, -1)
        even_diagonal[here] -= np.matmul(left, to_left, out=square[0, :n_here])
        even_rhs[here] -= np.matmul(left, solved, out=wide[:n_here])
        across = np.matmul(left[:n_beside], to_right, out=even_upper[beside])
        np.negative(across, out=across)
        right_t = right.transpose(0, 2, 1)
        even_diagonal[after] -= np.matmul(right_t, to_right, out=square[1, :n_beside])
        even_rhs[after] -= np.matmul(right_t, solved[:n_beside], out=wide[:n_beside])
    level.to_right[n_right:] = 0.0
    return level, offset, (even_diagonal, even_upper, even_rhs)


def _substitute(levels: list[_Level], offsets: list[Array], root: Array) -> Array:
    x = root
    for level, offset in zip(reversed(levels), reversed(offsets), strict=True):
        fine = np.empty((level.n_nodes, *x.shape[1:]))
        fine[0::2] = x
        wide = np.empty((min(PIECE, len(offset)), *x.shape[1:]))
        for here, beside in _pieces(level):
            by_left = np.matmul(level.to_left[here], x[here], out=wide[: here.stop - here.start])
            odd = np.subtract(offset[here], by_left, out=fine[1::2][here])
            n_beside = beside.stop - beside.start
            odd[:n_beside] -= np.matmul(level.to_right[beside], x[_next(beside)], out=wide[:n_beside])
        x = fine
    return x


def _selected_inverse(levels: list[_Level], root: Array) -> tuple[Array, Array]:
    P, cross = root, np.empty((0, *root.shape[1:]))
    for level in reversed(levels):
        fine, fine_cross = np.empty((level.n_nodes, *P.shape[1:])), np.empty((level.n_nodes - 1, *P.shape[1:]))
        fine[0::2] = P
        square = np.empty((2, min(PIECE, len(level.inverse)), *P.shape[1:]))
        for here, beside in _pieces(level):
            n_here, n_beside = here.stop - here.start, beside.stop - beside.start
            some, product = square[0, :n_here], square[1, :n_here]
            to_left, to_right = level.to_left[here], level.to_right[beside]
            to_left_t, to_right_t = to_left.transpose(0, 2, 1), to_right.transpose(0, 2, 1)
            np.matmul(P[here], to_left_t, out=some)
            some[:n_beside] += np.matmul(cross[beside], to_right_t, out=product[:n_beside])
            left_odd = np.negative(some, out=fine_cross[0::2][here])
            np.matmul(to_left[:n_beside], cross[beside], out=some[:n_beside])
            some[:n_beside] += np.matmul(to_right, P[_next(beside)], out=product[:n_beside])
            odd_right = np.negative(some[:n_beside], out=fine_cross[1::2][beside])
            odd = np.matmul(to_left, left_odd, out=some)
            odd[:n_beside] += np.matmul(to_right, odd_right.transpose(0, 2, 1), out=product[:n_beside])
            np.subtract(level.inverse[here], odd, out=product)
            np.add(product, product.transpose(0, 2, 1), out=odd)
            np.multiply(odd, 0.5, out=fine[1::2][here])
        P, cross = fine, fine_cross
    return P, cross


def _add_constants(covariance: Array, cross: Array, influence: Array, constants_covariance: Array) -> Array:
    """Add to the covariances what the constants bring into them, in place. Returns those with the constants."""
    (K, n, m), influence_t = influence.shape, influence.transpose(0, 2, 1)
    with_constants, square = np.empty_like(influence), np.empty((min(PIECE, K), n, n))
    for first in range(0, K, PIECE):
        here = slice(first, min(first + PIECE, K))
        beside = slice(first, min(here.stop, K - 1))
        some = with_constants[here]
        flat = (len(some) * n, m)
        np.matmul(influence[here].reshape(flat), -constants_covariance, out=some.reshape(flat, copy=False))
        covariance[here] -= np.matmul(some, influence_t[here], out=square[: len(some)])
        some = some[: beside.stop - first]
        cross[beside] -= np.matmul(some, influence_t[_next(beside)], out=square[: len(some)])
    return with_constants


def _pieces(level: _Level) -> Iterator[tuple[slice, slice]]:
    """Odd nodes of a level, a piece at a time, and those among them that have a right neighbour."""
    n_odd, n_right = level.n_nodes // 2, (level.n_nodes - 1) // 2
    for first in range(0, n_odd, PIECE):
        last = min(first + PIECE, n_odd)
        yield slice(first, last), slice(first, min(last, n_right))


def _next(nodes: slice) -> slice:
    return slice(nodes.start + 1, nodes.stop + 1)


def _cholesky(blocks: Array) -> Array:
    try:
        return np.asarray(np.linalg.cholesky(blocks), dtype=np.float64)
    except np.linalg.LinAlgError as error:
        raise NotPositiveDefiniteError("the data does not determine every unknown") from error


def inverse_of_lower(factor: Array, out: Array | None = None) -> Array:
    """Inverses of lower triangular matrices (K, n, n), by forward substitution over the whole stack at once."""
    inverse = np.empty_like(factor) if out is None else out
    inverse[...] = 0.0
    for i in range(factor.shape[-1]):
        scale = 1.0 / factor[:, i, i]
        inverse[:, i, i] = scale
        if i:
            row = factor[:, i, None, :i] @ inverse[:, :i, :i]
            np.multiply(row[:, 0], -scale[:, None], out=inverse[:, i, :i])
    return inverse


def _inverse_from_cholesky(factor: Array, out: Array | None = None, of_factor: Array | None = None) -> Array:
    """Inverse of `factor @ factor.T`; out, of_factor: memory (K, n, n) for it and for that of the factor."""
    inverse = inverse_of_lower(factor, of_factor)
    return np.matmul(inverse.transpose(0, 2, 1), inverse, out=out)
