"""Accelerometer from resting positions."""

import numpy as np
import pytest

from smoother import so3
from smoother.fit.ellipsoid import COLUMNS, ROWS, FitError
from smoother.fit.resting import RestingPosition
from smoother.fit.six_position import _lengths, excess_scatter, fit_accelerometer
from smoother.units import STANDARD_GRAVITY

FACES = np.concatenate([np.eye(3), -np.eye(3)])
EDGES = np.array([(1, 1, 0), (1, -1, 0), (1, 0, 1), (1, 0, -1), (0, 1, 1), (0, 1, -1), (-1, -1, 0), (-1, 0, 1)])
OFFSET = np.array([0.3, -0.2, 0.5])
MATRIX = np.eye(3) + np.array([[0.01, 0.004, -0.006], [0.004, -0.008, 0.003], [-0.006, 0.003, 0.015]])


def positions(directions, rng, sigma=0.002, offset=OFFSET, matrix=MATRIX):
    found = []
    for k, direction in enumerate(directions):
        up = direction / np.linalg.norm(direction)
        force = np.linalg.solve(matrix, STANDARD_GRAVITY * up) + offset + sigma * rng.standard_normal(3)
        noise = max(sigma, 1e-6) ** 2 * np.eye(3)
        found.append(RestingPosition(10.0 * k, 10.0 * k + 8.0, force, np.zeros(3), noise, noise, 800))
    return found


def tilted(directions, rng):
    return [so3.exp(0.1 * rng.standard_normal(3)) @ (d / np.linalg.norm(d)) for d in directions]


def parameters(offset, matrix):
    return np.concatenate([offset, matrix[ROWS, COLUMNS]])


def test_exact_positions_give_offset_scale_and_misalignment_back():
    rng = np.random.default_rng(1)
    fit = fit_accelerometer(positions(tilted(np.vstack([FACES, EDGES]), rng), rng, sigma=0.0))
    np.testing.assert_allclose(fit.offset, OFFSET, atol=1e-5)
    np.testing.assert_allclose(fit.matrix, MATRIX, atol=1e-6)
    assert np.all(fit.observed)
    assert fit.scatter == 1.0


def test_nees_of_all_nine_is_that_of_nine():
    rng = np.random.default_rng(2)
    nees = []
    for _ in range(60):
        offset, A = rng.normal(0.0, 0.3, 3), rng.normal(0.0, 0.01, (3, 3))
        matrix = np.eye(3) + 0.5 * (A + A.T)
        fit = fit_accelerometer(positions(tilted(np.vstack([FACES, EDGES]), rng), rng, 0.003, offset, matrix))
        error = parameters(fit.offset - offset, fit.matrix - matrix)
        nees.append(error @ np.linalg.solve(fit.covariance, error))
    assert 7.2 < np.mean(nees) < 11.0  # 99.9 % of the mean of 60 chi-squares of 9


def test_six_faces_tell_offset_and_scale_and_leave_misalignment_at_the_prior():
    rng = np.random.default_rng(3)
    fit = fit_accelerometer(positions(FACES, rng))
    assert np.all(np.abs(fit.offset - OFFSET) < 5.0 * fit.offset_sigma)
    assert np.all(fit.observed[ROWS == COLUMNS])
    assert not np.any(fit.observed[ROWS != COLUMNS])
    np.testing.assert_allclose(fit.matrix_sigma[0, 1], 0.02, rtol=0.05)


def test_a_touched_position_is_left_out():
    rng = np.random.default_rng(4)
    good = positions(tilted(np.vstack([FACES, EDGES]), rng), rng)
    bad = RestingPosition(200.0, 208.0, 1.05 * good[3].force, np.zeros(3), good[3].force_covariance, np.eye(3), 800)
    fit = fit_accelerometer([*good, bad])
    assert not fit.is_used[-1]
    assert np.all(fit.is_used[:-1])
    assert np.all(np.abs(fit.offset - OFFSET) < 5.0 * fit.offset_sigma)


def test_positions_that_all_scatter_make_the_sigmas_larger():
    rng = np.random.default_rng(5)
    noisy = positions(tilted(np.vstack([FACES, EDGES, -EDGES]), rng), rng, 0.05)
    claimed = [RestingPosition(p.start, p.end, p.force, p.rate, 1e-6 * np.eye(3), p.rate_covariance, 8) for p in noisy]
    fit = fit_accelerometer(claimed)
    assert 20.0 < fit.scatter < 100.0
    assert np.all(np.abs(fit.offset - OFFSET) < 5.0 * fit.offset_sigma)
    # what twenty-two lengths tell beside nine values, in sigmas of a millimetre per second squared, as claimed
    assert fit.scatter == pytest.approx(np.sqrt(np.sum((fit.residual / 1e-3) ** 2) / (22 - 9)), rel=0.03)


def test_the_jacobian_of_the_lengths_is_the_numerical_one():
    rng = np.random.default_rng(6)
    force, noise = rng.normal(0.0, 6.0, (8, 3)), np.tile(np.eye(3), (8, 1, 1))
    at = parameters(OFFSET, MATRIX)
    _, jacobian, _ = _lengths(force, noise, at, 9.8)
    numerical = so3.numerical_jacobian(lambda x: _lengths(force, noise, x, 9.8)[0], at)
    np.testing.assert_allclose(jacobian, numerical, atol=1e-6)


def test_scatter_is_one_unless_chance_is_ruled_out():
    assert excess_scatter(10.0, 9) == 1.0
    assert excess_scatter(900.0, 9) == pytest.approx(10.0)
    assert excess_scatter(900.0, 0) == 1.0


@pytest.mark.parametrize(
    ("directions", "says"),
    [
        ([], "^0 resting positions in different directions"),
        (FACES[:3], "^3 resting positions in different directions"),
        (np.tile(FACES[:1], (20, 1)), "^1 resting position in different directions"),
        (np.array([(np.cos(a), np.sin(a), 0.0) for a in np.linspace(0.0, 6.0, 12)]), "too much alike"),
    ],
    ids=["none", "three", "one often", "one plane"],
)
def test_positions_that_tell_too_little_are_refused_in_one_sentence(directions, says):
    with pytest.raises(FitError, match=says) as error:
        fit_accelerometer(positions(directions, np.random.default_rng(7)))
    assert "\n" not in str(error.value)


def test_nan_is_refused():
    good = positions(FACES, np.random.default_rng(8))
    bad = RestingPosition(0.0, 8.0, np.full(3, np.nan), np.zeros(3), np.eye(3), np.eye(3), 8)
    with pytest.raises(FitError, match="not finite"):
        fit_accelerometer([*good, bad])
