"""The chain solver against a dense inverse."""

from dataclasses import replace

import numpy as np
import pytest

from chain import ChainSystem, NotPositiveDefiniteError, solve_chain

SIZES = [(1, 1, 0), (1, 3, 2), (2, 2, 0), (2, 3, 1), (3, 1, 1), (3, 4, 2), (4, 2, 3), (5, 3, 0), (7, 2, 2), (8, 3, 6)]
SIZES += [(K, 4, 3) for K in (9, 15, 16, 17, 31, 33)] + [(40, 18, 24)]


def random_system(K: int, n: int, m: int, seed: int = 0, spread: float = 0.0) -> ChainSystem:
    """Normal equations of random rows, each on two neighbours and the constants.

    spread: decades over which the units of the unknowns differ, so that H is badly scaled as rad, m and s are.
    """
    rng = np.random.default_rng(seed)
    A = np.zeros((0, K * n + m))
    for k in range(max(K - 1, 1)):
        row = np.zeros((2 * n + m, K * n + m))
        row[:, k * n : min(k + 2, K) * n] = rng.normal(size=(2 * n + m, min(2, K) * n))
        row[:, K * n :] = rng.normal(size=(2 * n + m, m))
        A = np.concatenate([A, row])
    A = A * 10.0 ** rng.uniform(-0.5 * spread, 0.5 * spread, A.shape[1])
    return from_dense(A.T @ A, A.T @ rng.normal(size=len(A)), K, n, m)


def from_dense(H: np.ndarray, g: np.ndarray, K: int, n: int, m: int) -> ChainSystem:
    c = K * n
    blocks = H[:c, :c].reshape(K, n, K, n).transpose(0, 2, 1, 3)
    k = np.arange(K)
    return ChainSystem(
        blocks[k, k], blocks[k[:-1], k[1:]], H[:c, c:].reshape(K, n, m), H[c:, c:], g[:c].reshape(K, n), g[c:]
    )


def dense(system: ChainSystem) -> tuple[np.ndarray, np.ndarray]:
    K, n, m = system.border.shape
    H = np.zeros((K * n + m, K * n + m))
    for k in range(K):
        own = slice(k * n, (k + 1) * n)
        H[own, own] = system.diagonal[k]
        H[own, K * n :], H[K * n :, own] = system.border[k], system.border[k].T
        if k + 1 < K:
            following = slice((k + 1) * n, (k + 2) * n)
            H[own, following], H[following, own] = system.upper[k], system.upper[k].T
    H[K * n :, K * n :] = system.corner
    return H, np.concatenate([system.rhs.ravel(), system.rhs_constants])


def assert_close(actual: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    scale = np.max(np.abs(expected), initial=1e-300)
    np.testing.assert_allclose(actual / scale, expected / scale, rtol=0.0, atol=tolerance)


@pytest.mark.parametrize(("K", "n", "m"), SIZES)
def test_solution_and_covariance_are_those_of_the_dense_system(K: int, n: int, m: int) -> None:
    system = random_system(K, n, m)
    H, g = dense(system)
    P, x = np.linalg.inv(H), np.linalg.solve(H, g)
    found = solve_chain(system)

    c = K * n
    blocks, k = P[:c, :c].reshape(K, n, K, n).transpose(0, 2, 1, 3), np.arange(K)
    tolerance = 1e-15 * np.linalg.cond(H) + 1e-12  # rounding, as far as the system passes it on
    assert_close(found.x, x[:c].reshape(K, n), tolerance)
    assert_close(found.constants, x[c:], tolerance)
    assert_close(found.covariance, blocks[k, k], tolerance)
    assert_close(found.cross, blocks[k[:-1], k[1:]], tolerance)
    assert_close(found.constants_covariance, P[c:, c:], tolerance)
    assert_close(found.constants_cross, P[:c, c:].reshape(K, n, m), tolerance)


def test_units_that_differ_by_six_decades_cost_no_digits() -> None:
    system = random_system(12, 5, 3, seed=1, spread=6.0)
    H, g = dense(system)
    unit = 1.0 / np.sqrt(np.diag(H))
    scaled = np.linalg.inv(H * unit[:, None] * unit)
    assert np.linalg.cond(H) > 1e8 * np.linalg.cond(H * unit[:, None] * unit)
    P = scaled * unit[:, None] * unit
    found, blocks = solve_chain(system), P[:60, :60].reshape(12, 5, 12, 5)
    for k in range(12):
        np.testing.assert_allclose(found.covariance[k], blocks[k, :, k], rtol=1e-7)
    np.testing.assert_allclose(found.constants_covariance, P[60:, 60:], rtol=1e-7)
    np.testing.assert_allclose(found.x.ravel(), (P @ g)[:60], rtol=1e-6)


def test_covariance_is_symmetric_and_positive() -> None:
    found = solve_chain(random_system(33, 6, 4, seed=2))
    np.testing.assert_allclose(found.covariance, found.covariance.transpose(0, 2, 1), rtol=1e-9, atol=1e-14)
    assert np.all(np.linalg.eigvalsh(found.covariance) > 0.0)


def test_solving_leaves_the_system_as_it_was() -> None:
    system = random_system(6, 3, 2, seed=4)
    before = {name: value.copy() for name, value in vars(system).items()}
    solve_chain(system)
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(system, name), value)


def test_a_chain_without_measurements_between_is_so_many_single_nodes() -> None:
    system = replace(random_system(5, 2, 0, seed=5), upper=np.zeros((4, 2, 2)))
    found = solve_chain(system)
    np.testing.assert_allclose(found.covariance, np.linalg.inv(system.diagonal), rtol=1e-10)
    np.testing.assert_array_equal(found.cross, np.zeros((4, 2, 2)))


@pytest.mark.parametrize("K", [1, 2, 5, 8])
def test_an_unknown_without_information_is_reported(K: int) -> None:
    system = random_system(K, 3, 2)
    diagonal, upper, border = system.diagonal.copy(), system.upper.copy(), system.border.copy()
    diagonal[-1, 1, :], diagonal[-1, :, 1], upper[-1:, :, 1], border[-1, 1] = 0.0, 0.0, 0.0, 0.0
    with pytest.raises(NotPositiveDefiniteError, match="no information"):
        solve_chain(replace(system, diagonal=diagonal, upper=upper, border=border))


@pytest.mark.parametrize("node", [0, 1, 3, 4])
def test_a_pivot_that_is_not_positive_is_reported_wherever_it_is(node: int) -> None:
    system = random_system(5, 3, 2)
    diagonal = system.diagonal.copy()
    diagonal[node] -= 1.5 * np.linalg.eigvalsh(diagonal[node])[0] * np.eye(3)
    with pytest.raises(NotPositiveDefiniteError):
        solve_chain(replace(system, diagonal=diagonal))


def test_constants_the_data_does_not_tell_apart_are_reported() -> None:
    system = random_system(6, 3, 2, seed=6)
    border, corner = system.border.copy(), system.corner.copy()
    border[:, :, 1] = border[:, :, 0]  # the second constant does what the first does
    corner[1, :], corner[:, 1] = corner[0, 0], corner[0, 0]
    corner[1, 1] -= 1e-6 * corner[0, 0]
    with pytest.raises(NotPositiveDefiniteError):
        solve_chain(replace(system, border=border, corner=corner))


@pytest.mark.parametrize("name", ["diagonal", "upper", "border", "corner", "rhs"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_number_that_is_not_finite_never_passes_as_a_solution(name: str, value: float) -> None:
    system = random_system(6, 3, 2, seed=7)
    broken = getattr(system, name).copy()
    broken[tuple(size // 2 for size in broken.shape)] = value
    with pytest.raises(NotPositiveDefiniteError):
        solve_chain(replace(system, **{name: broken}))


def test_cost_grows_in_proportion_to_the_length() -> None:
    """An hour of 0.2 s keyframes is solved, not a tenth of it: memory and work are linear."""
    found = solve_chain(random_chain_of_length(18_000))
    assert np.all(np.isfinite(found.covariance))
    # far from the ends every node of a uniform chain has the same covariance
    np.testing.assert_allclose(found.covariance[5000:5010], np.broadcast_to(found.covariance[9000], (10, 6, 6)))


def random_chain_of_length(K: int) -> ChainSystem:
    n, m = 6, 2
    one = random_system(2, n, m, seed=8)
    diagonal = np.zeros((K, n, n))
    diagonal[:-1] += one.diagonal[0]
    diagonal[1:] += one.diagonal[1]
    border = np.zeros((K, n, m))
    border[:-1] += one.border[0]
    border[1:] += one.border[1]
    rhs = np.ones((K, n))
    return ChainSystem(diagonal, np.tile(one.upper, (K - 1, 1, 1)), border, one.corner * (K - 1), rhs, np.ones(m))


@pytest.mark.parametrize(("K", "n", "m"), [size for size in SIZES if size[0] > 1])
def test_functions_of_any_two_neighbours_covary_as_in_the_dense_inverse(K: int, n: int, m: int) -> None:
    system, rng, q = random_system(K, n, m), np.random.default_rng(1), 12
    first = np.concatenate([[0, K - 2], rng.integers(0, K - 1, q - 2)])
    left, right, constants = (rng.normal(size=(q, size)) for size in (n, n, m))
    J = np.zeros((q, K * n + m))
    for i, k in enumerate(first):
        J[i, k * n : (k + 2) * n], J[i, K * n :] = np.concatenate([left[i], right[i]]), constants[i]
    factor = solve_chain(system).factor
    assert factor is not None
    want = J @ np.linalg.inv(dense(system)[0]) @ J.T
    assert_close(factor.covariance(first, left, right, constants), want, 1e-8)
