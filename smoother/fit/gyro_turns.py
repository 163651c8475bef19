"""Gyroscope scale and misalignment from the turns between resting positions.

From one position to the next the gyroscope has to turn the direction of gravity as the accelerometer saw it before and
after (Tedaldi et al. 2014). The matrix is full: it leads from the gyroscope's own axes into those of the calibrated
accelerometer. A turn about the vertical shows nothing, so positions on all faces are needed.

Neighbouring turns share a position and the bias measured there; the fit is generalised least squares with the
covariance that follows.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from smoother import so3
from smoother.arrays import Array, freeze
from smoother.fit.ellipsoid import FitError
from smoother.fit.resting import RestingPosition
from smoother.fit.six_position import AccelFit, excess_scatter
from smoother.words import counted

FEWEST_TURNS = 8
PRIOR = 0.1  # sigma of each entry about one and zero; ten times a poor data sheet


@dataclass(frozen=True, eq=False)
class GyroMatrixFit:
    """matrix (3, 3) from (rate - bias) to the axes of the calibrated accelerometer; covariance (9, 9), entries by rows.

    count of turns; scatter: factor by which residuals exceed their sigmas, already in the covariance; rms_before,
    rms_after: angle (rad) by which the turned gravity misses, with the bias alone and with the matrix.
    """

    matrix: Array
    covariance: Array
    count: int
    scatter: float
    rms_before: float
    rms_after: float

    def __post_init__(self) -> None:
        freeze(self, matrix=(3, 3), covariance=(9, 9))

    @property
    def sigma(self) -> Array:
        """One standard deviation (3, 3) of each entry."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)).reshape(3, 3))


@dataclass(frozen=True, eq=False)
class _Turn:
    """From position `first` to the next: increments (n, 3) rad without bias, over steps (n,) s."""

    first: int
    increments: Array
    steps: Array


@dataclass(frozen=True, eq=False)
class _Rows:
    """Residual (2,) of a turn, its Jacobian (2, 9), and what the errors of forces and biases (6 K,) do to it."""

    residual: Array
    jacobian: Array
    sources: Array


def fit_gyro_matrix(
    t: Array, rate: Array, positions: Sequence[RestingPosition], accel: AccelFit, noise_density: float
) -> GyroMatrixFit:
    """Fit the matrix to the turns between neighbouring resting positions.

    t (N,) s, rate (N, 3) rad/s; noise_density rad/s/sqrt(Hz) of the gyroscope at rest. The bias of a turn is the mean
    of those at its two rests. Raises FitError with too few turns, or turns about too few axes.
    """
    up = _directions(positions, accel)
    turns = _turns(t, rate, positions, up)
    if len(turns) < FEWEST_TURNS:
        raise FitError(
            f"{counted(len(turns), 'turn')} between resting positions: too few for the gyroscope's scale, which needs "
            f"{FEWEST_TURNS}; lay the logger on more faces and edges"
        )
    matrix = np.eye(3)
    for _ in range(10):
        step, covariance, chi_square = _gauss_newton(turns, positions, up, accel, matrix, noise_density)
        matrix = matrix + step
        if np.max(np.abs(step)) < 1e-10:
            break
    scatter = excess_scatter(chi_square, 2 * len(turns) - 9)
    covariance = covariance * scatter**2
    if np.sqrt(np.max(np.diagonal(covariance))) > 0.01:
        raise FitError("the turns between resting positions do not tell the gyroscope's scale on every axis")
    before, after = (_rms_miss(turns, up, accel, M, len(positions)) for M in (np.eye(3), matrix))
    return GyroMatrixFit(matrix, covariance, len(turns), scatter, before, after)


def _rms_miss(turns: list[_Turn], up: Array, accel: AccelFit, matrix: Array, count: int) -> float:
    misses = [_rows(turn, up, accel, matrix, count).residual for turn in turns]
    return float(np.sqrt(np.mean(np.sum(np.square(misses), axis=1))))


def _directions(positions: Sequence[RestingPosition], accel: AccelFit) -> Array:
    calibrated = accel.apply(np.array([p.force for p in positions]).reshape(-1, 3))
    return np.asarray(calibrated / np.linalg.norm(calibrated, axis=1, keepdims=True))


def _turns(t: Array, rate: Array, positions: Sequence[RestingPosition], up: Array) -> list[_Turn]:
    found = []
    steps = np.diff(t)
    typical = float(np.median(steps))
    for k, (a, b) in enumerate(pairwise(positions)):
        i, j = np.searchsorted(t, [a.end, b.start])
        inside = steps[i:j]
        # s; beyond, the noise has outgrown what the turn shows
        if b.start - a.end > 30.0 or up[k] @ up[k + 1] > np.cos(0.2):  # rad by which gravity's direction changes
            continue
        if inside.size and np.max(inside) < 3.0 * typical:  # lost samples would be lost turn
            bias = 0.5 * (a.rate + b.rate)
            found.append(_Turn(k, (rate[i + 1 : j + 1] - bias) * inside[:, None], inside))
    return found


def _gauss_newton(
    turns: list[_Turn], positions: Sequence[RestingPosition], up: Array, accel: AccelFit, matrix: Array, density: float
) -> tuple[Array, Array, float]:
    """Step (3, 3), covariance (9, 9) and chi-square before the step."""
    rows = [_rows(turn, up, accel, matrix, len(positions)) for turn in turns]
    D = np.concatenate([row.sources for row in rows])
    noise = np.zeros((D.shape[1], D.shape[1]))
    for k, position in enumerate(positions):
        noise[6 * k : 6 * k + 3, 6 * k : 6 * k + 3] = position.force_covariance
        noise[6 * k + 3 : 6 * k + 6, 6 * k + 3 : 6 * k + 6] = position.rate_covariance
    own = np.repeat([density**2 * np.sum(turn.steps) for turn in turns], 2)
    covariance = D @ noise @ D.T + np.diag(own + 1e-14)  # a microradian: simulations without noise stay solvable
    root = np.linalg.cholesky(covariance)
    J = np.linalg.solve(root, np.concatenate([row.jacobian for row in rows]))
    r = np.linalg.solve(root, np.concatenate([row.residual for row in rows]))
    information = J.T @ J + np.eye(9) / PRIOR**2
    step = np.linalg.solve(information, -J.T @ r - (matrix - np.eye(3)).ravel() / PRIOR**2)
    return np.asarray(step.reshape(3, 3)), np.asarray(np.linalg.inv(information)), float(r @ r)


def _rows(turn: _Turn, up: Array, accel: AccelFit, matrix: Array, count: int) -> _Rows:
    k = turn.first
    after = _to_the_end(so3.exp(turn.increments @ matrix.T))  # of each increment, the turn that still follows it
    whole = so3.exp(turn.increments[0] @ matrix.T) @ after[0]
    predicted = whole.T @ up[k]
    across = _perpendicular(predicted)
    tilt = across.T @ so3.skew(predicted)  # what a small rotation at the end does to the residual
    by_entry = np.einsum("kai,kb->iab", after, turn.increments).reshape(3, 9)
    by_bias = -np.einsum("kai,ab,k->ib", after, matrix, turn.steps)
    sources = np.zeros((2, 6 * count))
    sources[:, 6 * k : 6 * k + 3] = across.T @ whole.T @ _direction_by_force(up[k], accel)
    sources[:, 6 * k + 6 : 6 * k + 9] = -across.T @ _direction_by_force(up[k + 1], accel)
    sources[:, 6 * k + 3 : 6 * k + 6] = sources[:, 6 * k + 9 : 6 * k + 12] = 0.5 * tilt @ by_bias
    return _Rows(across.T @ (predicted - up[k + 1]), tilt @ by_entry, sources)


def _to_the_end(steps: Array) -> Array:
    """Product of all rotations after each of steps (n, 3, 3), (n, 3, 3), by doubling."""
    product = np.concatenate([steps[1:], np.eye(3)[None]])
    reach = 1
    while reach < len(product):
        product[:-reach] = product[:-reach] @ product[reach:]
        reach *= 2
    return product


def _direction_by_force(up: Array, accel: AccelFit) -> Array:
    length = 9.8  # m/s^2, of gravity; its third digit is nothing to a covariance
    return np.asarray((np.eye(3) - np.outer(up, up)) @ accel.matrix / length)


def _perpendicular(unit: Array) -> Array:
    """Two unit vectors at right angles to unit (3,) and each other, the columns of (3, 2)."""
    _, _, rows = np.linalg.svd(unit[None])
    return np.asarray(rows[1:].T)
