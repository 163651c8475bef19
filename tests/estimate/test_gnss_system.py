"""The chain of nodes against dense least squares, and its derivatives against differences."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate import gnss_system as system
from smoother.estimate.motion_prior import MotionPrior

FIX_TIMES = np.array([0.0, 0.3, 0.5, 0.9, 1.4])
NODES = np.array([-0.3, 0.0, 0.2, 0.5, 0.8, 1.0, 1.2, 1.5])
AT_LAG = np.array([0.12, 0.03, -0.02, 0.01])


def problem(*, is_alike: bool = False) -> tuple[system.FixRows, system.PathPrior, system.Unknowns]:
    rng = np.random.default_rng(5)
    position, velocity = rng.normal(size=(5, 3)), rng.normal(size=(5, 3))
    position[2, 2] = velocity[1] = np.nan
    scale = rng.uniform(1.0, 3.0, (5, 3))
    if is_alike:  # north and west are
        scale[:, 1] = scale[:, 0]
    prior = system.PathPrior(
        motion=(MotionPrior(3.0, 5.0, 4.0), MotionPrior(1.0, 1.0, 1.0)),
        offset_sigma=(2.0, 2.0, 3.0),
        offset_tau=20.0,
        start=np.array([0.5, -0.5, 1.0]),
        start_sigma=np.array([10.0, 10.0, 5.0]),
        constants=np.array([0.05, 0.0, 0.0, 0.0]),
        constants_sigma=np.array([0.1, 0.05, 0.05, 0.05]),
    )
    return (
        system.fix_rows(position, velocity, scale, scale),
        prior,
        system.Unknowns(rng.normal(size=(3, NODES.size, system.N_STATE)), AT_LAG),
    )


def dense_rows(design: system.Design, total: int) -> Array:
    J = np.zeros((design.node.size, total * system.N_STATE + system.N_CONSTANTS))
    for r, k in enumerate(design.node):
        J[r, 4 * k : 4 * k + 4] += design.left[r]
        J[r, 4 * k + 4 : 4 * k + 8] += design.right[r]
    J[:, -system.N_CONSTANTS :] = design.by_constant
    return J


def test_derivatives_of_the_rows_match_differences() -> None:
    rows, _, at = problem()
    design = system.design(rows, NODES, FIX_TIMES, at)
    J = dense_rows(design, 3 * NODES.size)
    step = 1e-5

    def residual(i: int, change: float) -> Array:
        x, constants = at.x.copy(), at.constants.copy()
        if i < at.x.size:
            x.reshape(-1)[i] += change
        else:
            constants[i - at.x.size] += change
        return system.design(rows, NODES, FIX_TIMES, system.Unknowns(x, constants)).residual

    for i in range(J.shape[1]):
        difference = (residual(i, step) - residual(i, -step)) / (2.0 * step)
        np.testing.assert_allclose(difference, J[:, i], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("is_alike", [False, True])
def test_solution_covariance_and_leverage_are_those_of_dense_least_squares(is_alike: bool) -> None:
    rows, prior, at = problem(is_alike=is_alike)
    design, between = system.design(rows, NODES, FIX_TIMES, at), system.transitions(NODES, prior, 3)
    information = 1.0 / (0.3 * rows.scale) ** 2
    solution = system.solve(design, information, between, prior, at)

    K, n = NODES.size, system.N_STATE
    J, r, W = [dense_rows(design, 3 * K)], [design.residual], [np.diag(information)]
    for axis in range(3):
        for k in range(K):
            block = np.zeros((n, J[0].shape[1]))
            own = slice(n * (axis * K + k), n * (axis * K + k) + n)
            block[:, own] = np.eye(n)
            value = at.x[axis, k].copy()
            if k == 0:
                value[0] -= prior.start[axis]
                W.append(between.first[axis])
            else:
                step = between.step[axis, k - 1]
                block[:, own.start - n : own.start] = -step
                value -= step @ at.x[axis, k - 1]
                W.append(between.information[axis, k - 1])
            J.append(block)
            r.append(value)
    J.append(np.eye(J[0].shape[1])[-system.N_CONSTANTS :])
    r.append(at.constants - prior.constants)
    W.append(np.diag(prior.constants_sigma**-2.0))
    roots = [np.linalg.cholesky(w).T for w in W]
    Q, R = np.linalg.qr(np.concatenate([root @ a for root, a in zip(roots, J, strict=True)]))
    dx = -np.linalg.solve(R, Q.T @ np.concatenate([root @ b for root, b in zip(roots, r, strict=True)]))
    root_P = np.linalg.inv(R)
    P = root_P @ root_P.T

    # the chain works on the normal equations: it has half the digits of the QR decomposition, 1e-8 x condition
    found = np.concatenate([solution.x.reshape(-1), solution.constants])
    np.testing.assert_allclose(found, dx, rtol=1e-4, atol=1e-4)
    for k in (5, K + 5, 2 * K + 5):
        own = slice(4 * k, 4 * k + 4)
        np.testing.assert_allclose(solution.covariance[k], P[own, own], rtol=1e-4, atol=1e-6)
    expected = np.einsum("ri,ij,rj->r", J[0], P, J[0])
    np.testing.assert_allclose(system.leverage(design, prior, solution), expected, rtol=1e-4)


def test_an_axis_that_nothing_measures_is_left_out() -> None:
    position = np.array([[0.0, 1.0, np.nan], [2.0, 1.0, np.nan]])
    unknown, scale = np.full((2, 3), np.nan), np.ones((2, 3))
    assert system.fix_rows(position, unknown, scale, scale).n_axes == 2
    assert system.fix_rows(np.nan_to_num(position), unknown, scale, scale).n_axes == 3


def test_residuals_are_prediction_minus_measurement_zero_on_the_true_path() -> None:
    """A path of constant acceleration, whose fixes are an offset off and whose speeds lag and are biased."""
    start, speed, pull = np.array([1.0, -2.0, 0.5]), np.array([10.0, 3.0, -1.0]), np.array([-2.0, 4.0, 0.3])
    offset, lag, bias = np.array([0.7, -0.4, 0.2]), float(AT_LAG[0]), AT_LAG[1:]

    def motion(t: Array) -> tuple[Array, Array]:
        seconds = t[:, None]
        return start + speed * seconds + 0.5 * pull * seconds**2, speed + pull * seconds

    position, velocity = motion(NODES)
    columns = (position, velocity, np.tile(pull, (NODES.size, 1)), np.tile(offset, (NODES.size, 1)))
    at = system.Unknowns(np.stack(columns, axis=-1).transpose(1, 0, 2), AT_LAG)
    fixes, speeds = motion(FIX_TIMES)[0] + offset, motion(FIX_TIMES - lag)[1] + bias
    ones = np.ones(fixes.shape)
    for more in (0.0, 0.25):
        rows = system.fix_rows(fixes + more, speeds + more, ones, ones)
        np.testing.assert_allclose(system.design(rows, NODES, FIX_TIMES, at).residual, -more, atol=1e-12)


def test_the_offset_is_forgotten_as_a_gauss_markov_process_is() -> None:
    _, prior, _ = problem()
    between, dt = system.transitions(NODES, prior, 3), np.diff(NODES)
    for axis, sigma in enumerate(prior.offset_sigma):
        keeps, added = between.step[axis, :, 3, 3], 1.0 / between.information[axis, :, 3, 3]
        np.testing.assert_allclose(keeps, np.exp(-dt / prior.offset_tau))
        np.testing.assert_allclose(keeps**2 * sigma**2 + added, sigma**2)  # it scatters as much at all times
        assert between.first[axis, 3, 3] == pytest.approx(sigma**-2.0)
