"""Normal equations of rows against those of the dense Jacobian."""

from dataclasses import replace

import numpy as np

from smoother.estimate.graph.inertial import empty_system
from smoother.estimate.graph.normal_equations import add_constants_prior, add_rows
from smoother.estimate.graph.rows import Rows, after_step, offset_rows
from smoother.estimate.graph.state import CONSTANTS_SIZE, KEYFRAME_SIZE, ROW_CONSTANTS_SIZE

from .test_rows import K, random_state


def random_rows(count: int, seed: int, components: int = 3) -> Rows:
    """Several rows in one interval, none in another."""
    rng = np.random.default_rng(seed)
    interval = rng.choice([0, 2, 2, 3, 5], count)
    sigma = rng.uniform(0.5, 2.0, (count, components))
    sigma[0, 1] = np.inf
    return Rows(
        "random",
        interval,
        rng.normal(size=(count, components)),
        sigma,
        rng.normal(size=(count, components, KEYFRAME_SIZE)),
        rng.normal(size=(count, components, KEYFRAME_SIZE)),
        rng.normal(size=(count, components, ROW_CONSTANTS_SIZE)),
        rng.uniform(0.1, 1.0, count),
    )


def dense_jacobian(rows: Rows) -> np.ndarray:
    """The whole Jacobian, (N, r, K * 18 + all constants)."""
    n = KEYFRAME_SIZE
    J = np.zeros((*rows.residual.shape, K * n + CONSTANTS_SIZE))
    for row, k in enumerate(rows.interval):
        J[row, :, k * n : (k + 1) * n] = rows.left[row]
        J[row, :, (k + 1) * n : (k + 2) * n] = rows.right[row]
        J[row, :, K * n : K * n + ROW_CONSTANTS_SIZE] = rows.constants[row]
    return J


def test_normal_equations_are_those_of_the_dense_jacobian_also_with_many_rows_in_one_interval() -> None:
    system, H, g = empty_system(K), 0.0, 0.0
    for seed, count in enumerate((1, 12, 40)):
        rows = random_rows(count, seed)
        add_rows(system, [rows])
        J, weight = dense_jacobian(rows), rows.weight[:, None] / rows.sigma**2
        H = H + np.einsum("nri,nr,nrj->ij", J, weight, J)
        g = g - np.einsum("nri,nr,nr->i", J, weight, rows.residual)
    n, c = KEYFRAME_SIZE, K * KEYFRAME_SIZE
    blocks, k = H[:c, :c].reshape(K, n, K, n).transpose(0, 2, 1, 3), np.arange(K)
    np.testing.assert_allclose(system.diagonal, blocks[k, k], atol=1e-10)
    np.testing.assert_allclose(system.upper, blocks[k[:-1], k[1:]], atol=1e-10)
    np.testing.assert_allclose(system.border, H[:c, c:].reshape(K, n, -1), atol=1e-10)
    np.testing.assert_allclose(system.corner, H[c:, c:], atol=1e-10)
    np.testing.assert_allclose(system.rhs, g[:c].reshape(K, n), atol=1e-10)
    np.testing.assert_allclose(system.rhs_constants, g[c:], atol=1e-10)


def test_rows_with_one_jacobian_for_all_add_what_they_would_add_one_by_one() -> None:
    state, _ = random_state(2, turning=0.1)
    _, steps = offset_rows(state, np.array([1.0, 2.0, 3.0]), 5.0)
    assert steps.are_alike
    one_by_one = replace(steps, left=steps.left.copy(), right=steps.right.copy())
    assert not one_by_one.are_alike
    system, want = empty_system(K), empty_system(K)
    add_rows(system, [steps])
    add_rows(want, [one_by_one])
    for name, values in vars(want).items():
        np.testing.assert_allclose(getattr(system, name), values, atol=1e-12, err_msg=name)
    assert np.any(system.upper)


def test_no_rows_add_nothing() -> None:
    system, rows = empty_system(K), random_rows(3, 0)
    empty = replace(rows, **{name: getattr(rows, name)[:0] for name in vars(rows) if name != "name"})
    add_rows(system, [empty])
    assert not any(np.any(part) for part in vars(system).values())


def test_a_prior_on_the_constants_is_a_row_on_each() -> None:
    system, rng = empty_system(K), np.random.default_rng(0)
    residual, sigma = rng.normal(size=CONSTANTS_SIZE), rng.uniform(0.1, 2.0, CONSTANTS_SIZE)
    add_constants_prior(system, residual, sigma)
    np.testing.assert_allclose(system.corner, np.diag(1.0 / sigma**2))
    np.testing.assert_allclose(np.linalg.solve(system.corner, system.rhs_constants), -residual)


def test_residuals_after_a_step_are_those_the_linear_model_predicts() -> None:
    rows, rng = random_rows(12, 0), np.random.default_rng(1)
    step, constants = rng.normal(size=(K, KEYFRAME_SIZE)), rng.normal(size=CONSTANTS_SIZE)
    moved = after_step(rows, step, constants)
    want = rows.residual + dense_jacobian(rows) @ np.concatenate([step.ravel(), constants])
    np.testing.assert_allclose(moved.residual, want, atol=1e-12)
    assert moved.left is rows.left
