"""Chains beside one another against dense algebra and against cyclic reduction, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.chain import ChainSystem, NotPositiveDefiniteError, solve_chain
from smoother.estimate.gnss_chains import Chains, solve_chains

K, N = 9, 4


def random_chains(like: tuple[int, ...], m: int, seed: int = 1) -> Chains:
    """Well determined chains, the first constant common to all, each of the others to one."""
    rng = np.random.default_rng(seed)
    C, A = max(like) + 1, len(like)
    rows = rng.normal(size=(C, K - 1, 2 * N, 2 * N))
    products = rows.swapaxes(-1, -2) @ rows
    diagonal = np.tile(0.5 * np.eye(N), (C, K, 1, 1))
    diagonal[:, :-1] += products[..., :N, :N]
    diagonal[:, 1:] += products[..., N:, N:]
    border = 0.3 * rng.normal(size=(A, K, N, m))
    for a in range(A):
        border[a, :, :, 1 : 1 + a] = border[a, :, :, 2 + a :] = 0.0
    corner = np.eye(m) * 400.0
    return Chains(like, diagonal, products[..., :N, N:], border, corner, rng.normal(size=(A, K, N)), rng.normal(size=m))


def laid_out(chains: Chains) -> ChainSystem:
    """The same, as one long chain."""
    A, m = len(chains.like), chains.border.shape[3]
    like = list(chains.like)
    upper = np.zeros((A, K, N, N))
    upper[:, :-1] = chains.upper[like]
    return ChainSystem(
        chains.diagonal[like].reshape(A * K, N, N),
        upper.reshape(A * K, N, N)[:-1],
        chains.border.reshape(A * K, N, m),
        chains.corner,
        chains.rhs.reshape(A * K, N),
        chains.rhs_constants,
    )


def dense(system: ChainSystem) -> tuple[Array, Array]:
    nodes, _, m = system.border.shape
    H = np.zeros((nodes * N + m, nodes * N + m))
    for k in range(nodes):
        own, after = slice(k * N, k * N + N), slice(k * N + N, k * N + 2 * N)
        H[own, own] = system.diagonal[k]
        if k + 1 < nodes:
            H[own, after], H[after, own] = system.upper[k], system.upper[k].T
        H[own, nodes * N :], H[nodes * N :, own] = system.border[k], system.border[k].T
    H[nodes * N :, nodes * N :] = system.corner
    return H, np.concatenate([system.rhs.ravel(), system.rhs_constants])


@pytest.mark.parametrize("like", [(0,), (0, 1), (0, 0, 1), (0, 1, 2)])
@pytest.mark.parametrize("m", [0, 4])
def test_solution_and_covariance_are_those_of_dense_algebra(like: tuple[int, ...], m: int) -> None:
    chains = random_chains(like, m)
    found, nodes = solve_chains(chains), len(like) * K
    H, g = dense(laid_out(chains))
    P = np.linalg.inv(H)
    x, own = P @ g, P[: nodes * N, : nodes * N].reshape(nodes, N, nodes, N)
    np.testing.assert_allclose(np.concatenate([found.x.ravel(), found.constants]), x, rtol=1e-9, atol=1e-11)
    for k in range(nodes):
        np.testing.assert_allclose(found.covariance[k], own[k, :, k], rtol=1e-9, atol=1e-11)
        np.testing.assert_allclose(found.constants_cross[k].ravel(), P[k * N : k * N + N, nodes * N :].ravel())
        if k + 1 < nodes:
            np.testing.assert_allclose(found.cross[k], own[k, :, k + 1], rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(found.constants_covariance, P[nodes * N :, nodes * N :])


def test_it_says_what_cyclic_reduction_says() -> None:
    chains = random_chains((0, 0, 1), 4, seed=3)
    found, other = solve_chains(chains), solve_chain(laid_out(chains))
    for name in ("x", "constants", "covariance", "cross", "constants_covariance", "constants_cross"):
        np.testing.assert_allclose(getattr(found, name), getattr(other, name), rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("name", ["diagonal", "corner"])
def test_what_is_not_determined_is_refused(name: str) -> None:
    chains = random_chains((0, 1), 3)
    with pytest.raises(NotPositiveDefiniteError):
        solve_chains(replace(chains, **{name: -getattr(chains, name)}))


@pytest.mark.parametrize("name", ["diagonal", "upper", "border", "corner", "rhs", "rhs_constants"])
def test_a_number_that_is_not_finite_is_refused(name: str) -> None:
    chains = random_chains((0, 1), 3)
    broken = getattr(chains, name).copy()
    broken.flat[-1] = np.nan
    with pytest.raises(NotPositiveDefiniteError, match="finite"):
        solve_chains(replace(chains, **{name: broken}))
