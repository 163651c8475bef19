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

from smoother.arrays import Array
from smoother.estimate.chain import ChainSolution, NotPositiveDefiniteError
from smoother.estimate.lapack import lapack_routines

lapack = lapack_routines()


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


def solve_chains(chains: Chains) -> ChainSolution:
    """Return solution and selected covariance, nodes counted chain by chain; chains meet in `cross` by constants only.

    Raises NotPositiveDefiniteError when a matrix is not positive definite or a number not finite.
    """
    A, K, n, m = chains.border.shape
    like = list(chains.like)
    right = np.concatenate([chains.border, chains.rhs[..., None]], axis=3)
    if not (np.isfinite(np.sum(right)) and np.isfinite(np.sum(chains.corner) + np.sum(chains.rhs_constants))):
        raise NotPositiveDefiniteError("the system holds a number that is not finite")
    factor, covariance, cross = _inverted(chains.diagonal, chains.upper)
    x = np.zeros_like(right)
    for a, c in enumerate(like):
        some = np.flatnonzero(right[a].any(axis=(0, 1)))  # a constant of another chain does not touch this one
        x[a][..., some] = substituted(factor[c], right[a][..., some])

    influence, solution = x[..., :m].reshape(A * K, n, m), x[..., m].reshape(A * K, n)
    inner = right.reshape(A * K * n, m + 1)[:, :m].T @ x.reshape(A * K * n, m + 1)
    _, root = _roots((chains.corner - inner[:, :m])[:, :, None])
    constants_covariance = root[:, :, 0].T @ root[:, :, 0]
    constants = constants_covariance @ (chains.rhs_constants - inner[:, m])
    weighted = (influence.reshape(A * K * n, m) @ constants_covariance).reshape(A * K, n, m)
    transposed = influence.transpose(0, 2, 1)
    return ChainSolution(
        solution - (influence.reshape(A * K * n, m) @ constants).reshape(A * K, n),
        constants,
        weighted @ transposed + covariance[like].reshape(A * K, n, n),
        weighted[:-1] @ transposed[1:] + cross[like].reshape(A * K, n, n)[:-1],
        constants_covariance,
        -weighted,
    )


def _inverted(diagonal: Array, upper: Array) -> tuple[Array, Array, Array]:
    """Factor (C, K, n, 2 n), covariance of each node (C, K, n, n), and of neighbours (C, K, n, n), at the ends zero."""
    C, K, n, _ = diagonal.shape
    diagonal, beside = diagonal.reshape(C * K, n, n), np.zeros((C, K, n, n))
    beside[:, :-1] = upper
    upper = beside.reshape(C * K, n, n)[:-1]
    front, back = factor_chain(diagonal, upper), factor_chain(diagonal[::-1], upper[::-1].transpose(0, 2, 1))
    after, before = _blocks(front), _blocks(back)[:, :, ::-1]
    _, root = _roots(_product(after) + _product(before) - diagonal.transpose(1, 2, 0))
    covariance = np.einsum("kim,kjm->mij", root, root)
    below = np.empty((C * K - 1, n, n))  # of the factor: block (k+1, k)
    for i in range(n):
        below[:, :, i] = front[:-1, i, n - i : 2 * n - i]
    gain = below @ _inverse_triangle(-after).transpose(2, 0, 1)[:-1]
    cross = np.zeros((C * K, n, n))
    np.matmul(gain.transpose(0, 2, 1), covariance[1:], out=cross[:-1])
    return front.reshape(C, K, n, 2 * n), covariance.reshape(C, K, n, n), cross.reshape(C, K, n, n)


def factor_chain(diagonal: Array, upper: Array) -> Array:
    """Cholesky factor of a chain of blocks (K, n, n), (K-1, n, n): its columns from the diagonal down, (K, n, 2 n).

    upper: blocks (k, k+1). Raises NotPositiveDefiniteError as :func:`solve_chains` does.
    """
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


def substituted(factor: Array, right: Array) -> Array:
    """Solution (K, n, q) of a factored chain for right-hand sides (K, n, q)."""
    K, n, q = right.shape
    x, _ = lapack.dpbtrs(factor.reshape(K * n, 2 * n).T, np.asfortranarray(right.reshape(K * n, q)), lower=1)
    return np.asarray(x.reshape(K, n, q))


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
            out[i, j] = out[j, i] = np.einsum("kn,kn->n", lower[i, : j + 1], lower[j, : j + 1])
    return out


def _roots(matrices: Array) -> tuple[Array, Array]:
    """Cholesky factors of matrices (n, n, K), and the inverses of these."""
    lower = np.zeros_like(matrices)
    for j in range(len(matrices)):
        rest = matrices[j:, j] - np.einsum("ikn,kn->in", lower[j:, :j], lower[j, :j])
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
            inverse[i, j] = -np.einsum("kn,kn->n", lower[i, j:i], inverse[j:i, j]) / lower[i, i]
    return inverse
