"""Solve and invert the normal equations of a few uncoupled chains of small nodes that share some constants.

The axes of a path through fixes do not touch one another, and north and west mostly have the same matrices, so that one
factor serves both. It is that of a band matrix, once from the front and once from the back: what the front has
eliminated and what the back has eliminated add up to the information of each node, and the inverse of that is its
covariance. Cheaper than cyclic reduction (`graph/chain.py`) where the blocks are small.

Source: Golub & Van Loan, Matrix Computations, 4th ed., 4.3.5 (band Cholesky); Rauch, Tung & Striebel 1965 and Fraser &
Potter 1969 (smoothing as two filters). Owns no model: it sees matrices only.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

from smoother.arrays import Array
from smoother.estimate.graph.chain import ChainSolution, NotPositiveDefiniteError


@dataclass(frozen=True, eq=False)
class Chains:
    """Normal equations of A chains of K nodes of n unknowns, and m constants.

    like: for each chain which of the C matrices is its own. diagonal (C, K, n, n); upper (C, K-1, n, n), block
    (k, k+1); border (A, K, n, m), block (k, constants); corner (m, m); rhs (A, K, n); rhs_constants (m,).
    """

    like: tuple[int, ...]
    diagonal: Array
    upper: Array
    border: Array
    corner: Array
    rhs: Array
    rhs_constants: Array


@dataclass(frozen=True, eq=False)
class _Inverse:
    """Selected inverse of one matrix: covariance (K, n, n) of its nodes, cross (K-1, n, n) of neighbours."""

    covariance: Array
    cross: Array


def solve_chains(chains: Chains) -> ChainSolution:
    """Return solution and selected covariance, nodes counted chain by chain; chains meet in `cross` by constants only.

    Raises NotPositiveDefiniteError when a matrix is not positive definite or a number not finite.
    """
    A, K, n, m = chains.border.shape
    right = np.concatenate([chains.border, chains.rhs[..., None]], axis=3)
    if not (np.isfinite(np.sum(right)) and np.isfinite(np.sum(chains.corner) + np.sum(chains.rhs_constants))):
        raise NotPositiveDefiniteError("the system holds a number that is not finite")
    x, inverses = np.zeros_like(right), []
    log_determinant = 0.0
    for c, (diagonal, upper) in enumerate(zip(chains.diagonal, chains.upper, strict=True)):
        front, back = _factor(diagonal, upper), _factor(diagonal[::-1], upper[::-1].transpose(0, 2, 1))
        for a in (a for a, like in enumerate(chains.like) if like == c):
            some = np.flatnonzero(right[a].any(axis=(0, 1)))  # a constant of another chain does not touch this one
            x[a][..., some] = _substituted(front, right[a][..., some])
        inverses.append(_selected_inverse(diagonal, front, back))
        log_determinant += 2.0 * chains.like.count(c) * float(np.sum(np.log(front[:, :, 0])))
    covariance, cross = np.empty((A, K, n, n)), np.zeros((A, K, n, n))
    for a, like in enumerate(chains.like):
        covariance[a], cross[a, :-1] = inverses[like].covariance, inverses[like].cross

    influence, solution = x[..., :m].reshape(A * K, n, m), x[..., m].reshape(A * K, n)
    inner = right.reshape(A * K * n, m + 1)[:, :m].T @ x.reshape(A * K * n, m + 1)
    constants_covariance = np.zeros((m, m))
    if m:
        root, inverse_root = _roots((chains.corner - inner[:, :m])[:, :, None])
        constants_covariance = inverse_root[:, :, 0].T @ inverse_root[:, :, 0]
        log_determinant += 2.0 * float(np.sum(np.log(np.diag(root[:, :, 0]))))
    constants = constants_covariance @ (chains.rhs_constants - inner[:, m])
    weighted = influence @ constants_covariance
    transposed = influence.transpose(0, 2, 1)
    flat_cross = cross.reshape(A * K, n, n)[:-1]
    flat_cross += weighted[:-1] @ transposed[1:]
    return ChainSolution(
        solution - influence @ constants,
        constants,
        covariance.reshape(A * K, n, n) + weighted @ transposed,
        flat_cross,
        constants_covariance,
        -weighted,
        log_determinant,
    )


def _factor(diagonal: Array, upper: Array) -> Array:
    """Cholesky factor of a chain of blocks (K, n, n), (K-1, n, n): its columns from the diagonal down, (K, n, 2 n)."""
    K, n, _ = diagonal.shape
    columns = np.zeros((K, n, 2 * n))
    for i in range(n):
        columns[:, i, : n - i] = diagonal[:, i:, i]
        columns[:-1, i, n - i : 2 * n - i] = upper[:, i]
    if not np.isfinite(np.sum(columns)):
        raise NotPositiveDefiniteError("the system holds a number that is not finite")
    factor, failed = lapack.dpbtrf(columns.reshape(K * n, 2 * n).T, lower=1, overwrite_ab=1)
    if failed:
        raise NotPositiveDefiniteError("the data does not determine every unknown")
    return np.asarray(factor.T.reshape(K, n, 2 * n))


def _substituted(factor: Array, right: Array) -> Array:
    """Solution (K, n, q) of a factored chain for right-hand sides (K, n, q)."""
    K, n, q = right.shape
    x, _ = lapack.dpbtrs(factor.reshape(K * n, 2 * n).T, np.asfortranarray(right.reshape(K * n, q)), lower=1)
    return np.asarray(x.reshape(K, n, q))


def _selected_inverse(diagonal: Array, front: Array, back: Array) -> _Inverse:
    """Covariance of each node and of neighbours, from the factors from the front and from the back."""
    n = diagonal.shape[1]
    after, before = _blocks(front), _blocks(back)[:, :, ::-1]
    information = _product(after) + _product(before) - diagonal.transpose(1, 2, 0)
    _, inverse_root = _roots(information)
    P = np.einsum("kim,kjm->mij", inverse_root, inverse_root, optimize=False)
    below = np.empty((len(diagonal) - 1, n, n))  # of the factor: block (k+1, k)
    for i in range(n):
        below[:, :, i] = front[:-1, i, n - i : 2 * n - i]
    own = _inverse_triangle(after).transpose(2, 0, 1)[:-1]
    gain = (below @ own).transpose(0, 2, 1)
    return _Inverse(P, -gain @ P[1:])


def _blocks(factor: Array) -> Array:
    """Lower triangles on the diagonal of a factor, (n, n, K)."""
    K, n, _ = factor.shape
    blocks = np.zeros((n, n, K))
    for i in range(n):
        blocks[i:, i] = factor[:, i, : n - i].T
    return blocks


def _product(lower: Array) -> Array:
    """Lower triangles (n, n, K) times their transposes, (n, n, K)."""
    out = np.empty_like(lower)
    for i in range(len(lower)):
        for j in range(i + 1):
            out[i, j] = out[j, i] = np.sum(lower[i, : j + 1] * lower[j, : j + 1], axis=0)
    return out


def _roots(matrices: Array) -> tuple[Array, Array]:
    """Cholesky factors of matrices (n, n, K), and the inverses of these."""
    lower = np.zeros_like(matrices)
    for j in range(len(matrices)):
        rest = matrices[j:, j] - np.sum(lower[j:, :j] * lower[j, :j], axis=1)
        if not np.all(rest[0] > 0.0):
            raise NotPositiveDefiniteError("the data does not determine every unknown")
        lower[j:, j] = rest / np.sqrt(rest[0])
    return lower, _inverse_triangle(lower)


def _inverse_triangle(lower: Array) -> Array:
    """Inverses of lower triangles (n, n, K)."""
    inverse = np.zeros_like(lower)
    for j in range(len(lower)):
        inverse[j, j] = 1.0 / lower[j, j]
        for i in range(j + 1, len(lower)):
            inverse[i, j] = -np.sum(lower[i, j:i] * inverse[j:i, j], axis=0) / lower[i, i]
    return inverse
