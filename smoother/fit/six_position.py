"""Accelerometer offset, scale and misalignment from resting positions.

At rest the calibrated force has the length of gravity, whatever the direction: `|matrix (force - offset)| = g`. As for
the ellipsoid, a rotation of all axes together cannot be seen, so the matrix is the symmetric root. Nine unknowns need
nine positions; with six, the logger on each of its faces, the misalignments stay at the prior of a data sheet.
Sources: Tedaldi et al. 2014 (the model); Kelley and Frosio 2009 (gravity's length as the only reference).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from smoother.arrays import Array, BoolArray, freeze
from smoother.fit.ellipsoid import COLUMNS, ROWS, FitError
from smoother.fit.resting import RestingPosition, distinct_directions
from smoother.units import STANDARD_GRAVITY
from smoother.words import counted

PRIOR_SCALE = 0.1
PRIOR_MISALIGNMENT = 0.02  # cross-axis sensitivity of consumer parts, MPU-9250 data sheet
LARGEST_OFFSET_SIGMA = 0.1  # m/s^2; positions that leave more do not calibrate
LARGEST_SCALE_SIGMA = 0.02
OUTLIER_CHANCE = 1e-4


@dataclass(frozen=True, eq=False)
class AccelFit:
    """offset (3,) m/s^2; matrix (3, 3) symmetric; covariance (9, 9) of offset and of xx, xy, xz, yy, yz, zz.

    residual (K,) m/s^2: calibrated length less gravity; is_used (K,) positions; scatter: factor by which the residuals
    exceed their sigmas (1 unless the data contradict them), already in the covariance; observed (6,): which entries
    the positions determined, not the prior.
    """

    offset: Array
    matrix: Array
    covariance: Array
    residual: Array
    is_used: BoolArray
    scatter: float
    observed: BoolArray

    def __post_init__(self) -> None:
        freeze(self, offset=(3,), matrix=(3, 3), covariance=(9, 9))

    @property
    def offset_sigma(self) -> Array:
        """One standard deviation (3,) m/s^2 of the offset."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)[:3]))

    @property
    def matrix_sigma(self) -> Array:
        """One standard deviation (3, 3) of the entries of the matrix."""
        return _symmetric(np.sqrt(np.diagonal(self.covariance)[3:]))

    def apply(self, force: Array) -> Array:
        """Calibrated force (N, 3) m/s^2."""
        return np.asarray((force - self.offset) @ self.matrix)


def fit_accelerometer(positions: Sequence[RestingPosition]) -> AccelFit:
    """Fit offset, scale and misalignment to resting positions; a position that contradicts the others is left out.

    Gravity is that of the navigation frame (`frames.GRAVITY_N`), not the place's: an estimator that assumes the one
    must be given samples scaled by it. Raises FitError when the positions do not determine offset and scale.
    """
    gravity, force = STANDARD_GRAVITY, np.array([p.force for p in positions]).reshape(-1, 3)
    if not np.all(np.isfinite(force)):
        raise FitError("some mean forces are not finite numbers; drop those readings first")
    noise = np.array([p.force_covariance for p in positions]).reshape(-1, 3, 3)
    directions = distinct_directions(force - _middle(force)) if len(force) else force
    if len(directions) < 6:
        raise FitError(
            f"{counted(len(directions), 'resting position')} in different directions: too few for the accelerometer; "
            "lay the logger on each of its six faces, and better also on edges, ten seconds each"
        )
    used = np.ones(len(force), dtype=np.bool_)
    parameters, covariance, z = _least_squares(force, noise, used, gravity)
    while used.sum() > 9 and np.max(np.abs(z[used])) > _limit(int(used.sum())):
        worst = int(np.argmax(np.where(used, np.abs(z), 0.0)))
        trial = used.copy()
        trial[worst] = False
        again = _least_squares(force, noise, trial, gravity)
        if np.sum(again[2][trial] ** 2) > 0.25 * np.sum(z[used] ** 2):
            break  # leaving it out mends nothing: all of them scatter
        used, (parameters, covariance, z) = trial, again
    return _checked_fit(parameters, covariance, z, force, used, gravity)


def _middle(force: Array) -> Array:
    """Rough offset (3,), so that directions are those of gravity even with a large one."""
    low, high = force.min(axis=0), force.max(axis=0)
    return np.where(np.all(high - low > STANDARD_GRAVITY), 0.5 * (low + high), 0.0)


def _limit(count: int) -> float:
    return float(np.sqrt(2.0 * np.log(count / OUTLIER_CHANCE)))


def _least_squares(force: Array, noise: Array, used: BoolArray, gravity: float) -> tuple[Array, Array, Array]:
    """Parameters (9,), covariance (9, 9) and whitened residuals (K,), by Gauss-Newton with the prior."""
    parameters = np.concatenate([np.zeros(3), np.eye(3)[ROWS, COLUMNS]])
    prior_mean = parameters.copy()
    # m/s^2; ten times the worst data sheet
    prior = np.array([2.0] * 3 + [PRIOR_SCALE if i == j else PRIOR_MISALIGNMENT for i, j in _ENTRIES])
    for _ in range(30):
        residual, jacobian, sigma = _lengths(force, noise, parameters, gravity)
        J, r = (jacobian / sigma[:, None])[used], (residual / sigma)[used]
        information = J.T @ J + np.diag(prior**-2.0)
        step = np.linalg.solve(information, -J.T @ r - (parameters - prior_mean) / prior**2)
        parameters = parameters + step
        if np.max(np.abs(step) / prior) < 1e-10:
            break
    residual, jacobian, sigma = _lengths(force, noise, parameters, gravity)
    root = np.linalg.solve(np.linalg.cholesky(information), np.eye(9))
    return parameters, root.T @ root, residual / sigma


_ENTRIES = tuple(zip(ROWS.tolist(), COLUMNS.tolist(), strict=True))


def _symmetric(entries: Array) -> Array:
    A = np.empty((3, 3))
    A[ROWS, COLUMNS] = A[COLUMNS, ROWS] = entries
    return A


def _lengths(force: Array, noise: Array, parameters: Array, gravity: float) -> tuple[Array, Array, Array]:
    """Residual (K,), its Jacobian (K, 9) and sigma (K,)."""
    A, centred = _symmetric(parameters[3:]), force - parameters[:3]
    calibrated = centred @ A
    length = np.linalg.norm(calibrated, axis=1)
    unit = calibrated / length[:, None]
    along = unit @ A
    jacobian = np.empty((len(force), 9))
    jacobian[:, :3] = -along
    for k, (i, j) in enumerate(_ENTRIES):
        jacobian[:, 3 + k] = unit[:, i] * centred[:, j] + (unit[:, j] * centred[:, i] if i != j else 0.0)
    sigma = np.sqrt(np.einsum("ki,kij,kj->k", along, noise, along))
    return length - gravity, jacobian, np.maximum(sigma, 1e-9 * gravity)


def _checked_fit(
    parameters: Array, covariance: Array, z: Array, force: Array, used: BoolArray, gravity: float
) -> AccelFit:
    scatter = excess_scatter(float(np.sum(z[used] ** 2)), int(used.sum()) - 9)
    covariance = covariance * scatter**2
    sigma = np.sqrt(np.diagonal(covariance))
    prior = np.where(np.equal(ROWS, COLUMNS), PRIOR_SCALE, PRIOR_MISALIGNMENT)
    if np.max(sigma[:3]) > LARGEST_OFFSET_SIGMA or np.max(sigma[3:][ROWS == COLUMNS]) > LARGEST_SCALE_SIGMA:
        raise FitError("the resting positions are too much alike to separate offset and scale; use all six faces")
    matrix = _symmetric(parameters[3:])
    residual = np.linalg.norm((force - parameters[:3]) @ matrix, axis=1) - gravity
    observed = sigma[3:] < 0.5 * prior  # of the prior sigma; a misalignment less sure than this was not seen
    return AccelFit(parameters[:3], matrix, covariance, residual, used, scatter, observed)


def excess_scatter(chi_square: float, freedom: int) -> float:
    """Factor on all sigmas: one, unless the residuals are larger than chance allows."""
    if freedom < 1 or chi2.sf(chi_square, freedom) > 1e-3:
        return 1.0
    return float(np.sqrt(chi_square / freedom))
