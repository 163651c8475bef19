"""The chain of nodes against dense least squares, and its derivatives against differences."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.factors.rows import Rows
from smoother.estimate.fixes import path_graph
from smoother.estimate.fixes.path_graph import BIAS, LAG, NODE_SIZE, Measured, Nodes, PathPrior, WhiteJerk
from smoother.estimate.model.state import COLUMNS
from smoother.estimate.solvers.variance_components import posterior_variance

FIX_TIMES = np.array([0.0, 0.3, 0.5, 0.9, 1.4])
NODES = np.array([-0.3, 0.0, 0.2, 0.5, 0.8, 1.0, 1.2, 1.5])
LATE = 0.04  # s
LAG_AT, BIAS_AT = 0.12, np.array([0.03, -0.02, 0.01])
PRIOR = PathPrior(
    motion=(WhiteJerk(3.0, 5.0, 4.0), WhiteJerk(1.0, 1.0, 1.0)),
    slow_sigma=np.array([2.0, 2.0, 3.0, 0.1]),
    slow_tau=np.array([20.0, 20.0, 20.0, 5.0]),
    start=np.array([0.5, -0.5, 1.0]),
    start_sigma=np.array([10.0, 10.0, 5.0]),
    lag=(0.05, 0.1),
    bias_sigma=0.05,
)
SIZE = len(NODES) * NODE_SIZE


def problem() -> tuple[Nodes, Measured]:
    rng = np.random.default_rng(5)
    position, velocity = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    position[2, 2] = velocity[1] = np.nan
    x = rng.normal(size=(len(NODES), NODE_SIZE))
    x[:, path_graph.LATENCY] *= 0.02  # time does not run backwards
    nodes = Nodes(NODES, x, LAG_AT, BIAS_AT)
    return nodes, Measured(FIX_TIMES, position, velocity)


def dense(rows: Rows) -> Array:
    """Jacobian (N r, all unknowns): nodes, lag, bias."""
    n, r = rows.residual.shape
    J = np.zeros((n, r, SIZE + 4))
    for i, k in enumerate(rows.interval.tolist()):
        J[i, :, NODE_SIZE * k : NODE_SIZE * (k + 1)] += rows.left[i]
        J[i, :, NODE_SIZE * (k + 1) : NODE_SIZE * (k + 2)] += rows.right[i]
        if rows.constants:
            J[i, :, SIZE : SIZE + 1], J[i, :, SIZE + 1 :] = rows.constants[LAG][i], rows.constants[BIAS][i]
    return J.reshape(n * r, -1)


def test_derivatives_of_all_rows_match_differences() -> None:
    nodes, measured = problem()
    step = 1e-5

    def rows_of(nodes: Nodes) -> list[Rows]:
        return [*path_graph.fix_rows(nodes, measured), *path_graph.prior_rows(nodes, PRIOR)]

    def residuals(i: int, change: float) -> Array:
        moved = np.zeros(SIZE + 4)
        moved[i] = change
        x = nodes.x + moved[:SIZE].reshape(nodes.x.shape)
        other = Nodes(NODES, x, nodes.lag + moved[SIZE], nodes.bias + moved[SIZE + 1 :])
        return np.concatenate([rows.residual.ravel() for rows in rows_of(other)])

    J = np.concatenate([np.where(np.isfinite(r.sigma).reshape(-1, 1), dense(r), 0.0) for r in rows_of(nodes)])
    for i in range(J.shape[1]):
        difference = (residuals(i, step) - residuals(i, -step)) / (2.0 * step)
        np.testing.assert_allclose(difference, J[:, i], rtol=1e-5, atol=1e-5 * max(1.0, np.abs(J[:, i]).max()))


def test_a_step_and_its_covariances_are_those_of_dense_least_squares() -> None:
    nodes, measured = problem()
    fixes = [replace(rows, sigma=0.3 * rows.sigma) for rows in path_graph.fix_rows(nodes, measured)]
    prior = path_graph.prior_rows(nodes, PRIOR)
    found = path_graph.solve(nodes, fixes, prior, PRIOR.unknown)

    J = np.concatenate([dense(rows) / rows.sigma.reshape(-1, 1) for rows in [*prior, *fixes]])
    r = np.concatenate([(rows.residual / rows.sigma).ravel() for rows in [*prior, *fixes]])
    Q, R = np.linalg.qr(J)
    dx, root = -np.linalg.solve(R, Q.T @ r), np.linalg.inv(R)
    P = root @ root.T

    np.testing.assert_allclose((found.nodes.x - nodes.x).ravel(), dx[:SIZE], rtol=1e-5, atol=1e-5)
    assert found.nodes.lag - nodes.lag == pytest.approx(dx[SIZE], rel=1e-5)
    np.testing.assert_allclose(found.nodes.bias - nodes.bias, dx[SIZE + 1 :], rtol=1e-5, atol=1e-7)
    assert found.lag_sigma == pytest.approx(np.sqrt(P[SIZE, SIZE]), rel=1e-5)
    for k in range(len(NODES)):
        own = slice(NODE_SIZE * k, NODE_SIZE * (k + 1))
        np.testing.assert_allclose(found.covariances.keyframes[k], P[own, own], rtol=1e-4, atol=1e-6)
    for rows in fixes:
        expected = np.einsum("ri,ij,rj->r", dense(rows), P, dense(rows)).reshape(rows.residual.shape)
        np.testing.assert_allclose(posterior_variance(rows, found.covariances), expected, rtol=1e-4)


def test_a_lag_that_is_known_stays() -> None:
    nodes, measured = problem()
    known = replace(PRIOR, lag=(LAG_AT, 0.0))
    rows = path_graph.fix_rows(nodes, measured), path_graph.prior_rows(nodes, known)
    found = path_graph.solve(nodes, *rows, known.unknown)
    assert (found.nodes.lag, found.lag_sigma) == (LAG_AT, 0.0)
    assert np.all(found.nodes.bias != nodes.bias)


def test_residuals_are_prediction_minus_measurement_zero_on_the_true_path() -> None:
    """A path of constant acceleration; fixes have an offset and a latency, velocities a lag and a bias."""
    start, speed, pull = np.array([1.0, -2.0, 0.5]), np.array([10.0, 3.0, -1.0]), np.array([-2.0, 4.0, 0.3])
    offset = np.array([0.7, -0.4, 0.2])

    def motion(t: Array) -> tuple[Array, Array]:
        seconds = t[:, None]
        return start + speed * seconds + 0.5 * pull * seconds**2, speed + pull * seconds

    position, velocity = motion(NODES)
    x = np.hstack([position, velocity, np.tile(pull, (len(NODES), 1)), np.tile([*offset, LATE], (len(NODES), 1))])
    fixes, speeds = motion(FIX_TIMES - LATE)[0] + offset, motion(FIX_TIMES - LAG_AT)[1] + BIAS_AT
    for more in (0.0, 0.25):
        measured = Measured(FIX_TIMES, fixes + more, speeds + more)
        for rows in path_graph.fix_rows(Nodes(NODES, x, LAG_AT, BIAS_AT), measured):
            np.testing.assert_allclose(rows.residual, -more, atol=1e-12)


def test_slow_errors_are_stationary_gauss_markov_processes() -> None:
    nodes, _ = problem()
    slow = {rows.name: rows for rows in path_graph.prior_rows(nodes, PRIOR)}["slow_errors"]
    kept = -np.einsum("nii->ni", slow.left[:, :, path_graph.SLOW])
    np.testing.assert_allclose(kept, np.exp(-np.diff(NODES)[:, None] / PRIOR.slow_tau))
    scatter = kept**2 * PRIOR.slow_sigma**2 + slow.sigma**2
    np.testing.assert_allclose(scatter, np.broadcast_to(PRIOR.slow_sigma**2, scatter.shape))


def test_the_constants_are_those_of_a_session() -> None:
    assert COLUMNS[LAG].stop - COLUMNS[LAG].start == 1
    assert COLUMNS[BIAS].stop - COLUMNS[BIAS].start == 3
