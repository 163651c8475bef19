"""Magnetic heading: the field is calibrated against the attitude of a first solution, and accepted or rejected.

In a kart the magnetometer sits among iron and currents, and the kart stays nearly level, so that laps show only a part
of a calibration: field_s = A R_sn B_n + h, with a prior that A is a multiple of one. The graph then uses the heading of
the corrected field with an unknown offset of its own, so that it cannot contradict the course. Only a field that needs
no correction also shows north. A field that disagrees with the gyroscope is rejected.
"""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.model.state import State
from smoother.fit.correlation import correlation_growth
from smoother.fit.magnetic_model import field_n as magnetic_field_n
from smoother.frames import wrap_angle
from smoother.samples import MagSamples

NEEDS_NO_FIT = np.radians(4.0)  # rms and mean of the heading error of a field that was calibrated before
CALIBRATED_OFFSET = np.radians(0.7)  # of such a field: 0.36 of the World Magnetic Model, and iron
UNKNOWN_OFFSET = np.pi / 4.0
USELESS = np.radians(20.0)  # rms of the heading beyond which the field is rejected
FLOOR = np.radians(2.0)  # currents of the engine and iron of the track
REPEATING = np.radians(0.7)  # error of iron and fit in each direction, the same in every lap
DIRECTIONS = 4.0  # cosine and sine of the heading and of its double: hard and soft iron
FEWEST = 20  # headings
SPACING = 1.0  # s between heading factors: the errors of the field last
LONGEST_MEMORY = 30  # headings
# Priors in parts of the strength of the field: soft iron, in each entry, and hard iron
ANY_IRON, ANY_HARD_IRON = 0.15, 2.0
# Least second eigenvalue of the covariance of the field's direction in s: laps have 0.05 where the field is steep, a
# parked kart less than 0.0001
TURNED = 0.005
COMMON_LEAN = np.radians(1.0)  # common error of all attitudes by biases of force
RIDGE = 0.003  # weight of the prior on the matrix, relative to the data


@dataclass(frozen=True, eq=False)
class FieldFit:
    """measured = matrix @ field_s + iron, both in the unit of the readings: (3, 3), (3,); field_s is a unit vector.

    matrix_sigma (3, 3), iron_sigma (3,): their sigmas. turned: see :data:`TURNED`.
    """

    matrix: Array
    iron: Array
    matrix_sigma: Array
    iron_sigma: Array
    turned: float

    @property
    def is_reported(self) -> bool:
        """Whether the kart turned enough to separate iron from the field."""
        return self.turned > TURNED

    @property
    def strength(self) -> float:
        """Strength of the field in the unit of the readings: the mean size of the matrix."""
        return float(abs(np.linalg.det(self.matrix)) ** (1.0 / 3.0))

    @property
    def soft_iron(self) -> Array:
        """Matrix (3, 3) from readings without `iron` to a field of their strength, as in a calibration."""
        return np.asarray(self.strength * np.linalg.inv(self.matrix))

    @property
    def soft_iron_sigma(self) -> Array:
        """Sigma (3, 3) of each of its values, by those of the matrix: d(A^-1) = -A^-1 dA A^-1."""
        inverse = np.linalg.inv(self.matrix)
        return np.asarray(self.strength * np.sqrt(inverse**2 @ self.matrix_sigma**2 @ inverse**2))


@dataclass(frozen=True, eq=False)
class Heading:
    """Heading measurements at the left keyframe of intervals (N,): corrected field_s (N, 3), any unit.

    field_yaw rad: direction of the horizontal field in n; sigma rad: of each, or of all; offset_sigma rad: of their
    common error, which is in field_yaw already without has_offset. fit: their correction, None of a calibrated field.
    """

    interval: IntArray
    field_s: Array
    field_yaw: float
    sigma: float | Array
    offset_sigma: float
    has_offset: bool = True
    fit: FieldFit | None = None


def heading_from_field(
    mag: MagSamples, state: State, declination: float, inclination: float, still: IntArray | None = None
) -> Heading | None:
    """Return the usable headings, or None when the field disagrees with the attitude of `state`.

    declination (east positive), inclination (down positive) rad. still (S,): intervals at rest.
    """
    inside = (mag.t > state.t[0]) & (mag.t < state.t[-1])
    if np.count_nonzero(inside) < FEWEST:
        return None
    t, measured = mag.t[inside], mag.field_s[inside]
    R_ns = _attitude(state, t)
    expected = np.einsum("kji,j->ki", R_ns, magnetic_field_n(declination, inclination))
    matrix, iron, of_fit = _fit(expected, measured)
    if np.linalg.cond(matrix) > 20.0:
        return None
    corrected = np.asarray(np.linalg.solve(matrix, (measured - iron).T).T, dtype=np.float64)
    step = max(1, round(SPACING / state.interval))
    at, (before, after, weight) = _averages(state, step, t, R_ns, (measured, corrected), of_fit)
    if len(at) < FEWEST:
        return None
    offset_sigma, field_s, fitted = CALIBRATED_OFFSET, before, False
    error = _heading_error(state.R_ns[at], field_s, declination)
    if np.sqrt(np.median(error**2)) > 0.7 * NEEDS_NO_FIT or abs(float(np.median(error))) > 0.5 * NEEDS_NO_FIT:
        offset_sigma, field_s, fitted = UNKNOWN_OFFSET, after, True
        error = _heading_error(state.R_ns[at], field_s, declination)
    rms = float(np.sqrt(np.average(error**2, weights=weight)))
    keep = np.abs(error) < 3.0 * max(rms, FLOOR)
    if rms > USELESS or np.count_nonzero(keep) < 0.5 * len(at):
        return None
    beyond = max(rms**2 - FLOOR**2, 0.0) * _memory(error[keep])
    alike = 1.0 if still is None else _of_stand(at[keep], still, step)
    independent = np.count_nonzero(keep) * float(np.mean(1.0 / alike))
    sigma = np.sqrt(alike * (FLOOR**2 + beyond + (repeating(independent) if fitted else 0.0)))
    fit = _with_sigmas(matrix, iron, expected, measured, of_fit) if fitted else None
    return Heading(at[keep], field_s[keep], -declination, sigma, offset_sigma, fit=fit)


def _of_stand(at: IntArray, still: IntArray, step: int) -> Array:
    """Number (N,) of headings at keyframes `at`, one in `step`, of the same stop, which share one error; else 1."""
    count = np.ones(len(at))
    resting = np.flatnonzero(np.isin(at, still))
    for stand in np.split(resting, np.flatnonzero(np.diff(at[resting]) > 2 * step) + 1):
        count[stand] = len(stand)
    return count


def repeating(count: float) -> float:
    """Variance rad^2 of each of `count` headings of a fitted field by the error of iron, which every lap repeats.

    All of a direction together are known to REPEATING.
    """
    return float(REPEATING**2 * count / DIRECTIONS)


def _memory(error: Array) -> float:
    """Number of successive errors (N,) that count as one; at least 1.

    Source: the sum of autocorrelations up to the first that is not positive (Geyer 1992).
    """
    centred = error - error.mean()
    power = float(centred @ centred)
    total = 1.0
    for lag in range(1, min(LONGEST_MEMORY, len(error) - 1) + 1):
        correlation = float(centred[lag:] @ centred[:-lag]) / max(power, 1e-300)
        if correlation <= 0.0:
            break
        total += 2.0 * correlation
    return total


def _attitude(state: State, t: Array) -> Array:
    """Attitude R_ns (N, 3, 3) at times t (N,) within the chain."""
    i = np.clip(np.searchsorted(state.t, t) - 1, 0, len(state.t) - 2)
    turn = so3.log(state.R_ns[i].transpose(0, 2, 1) @ state.R_ns[i + 1])
    return state.R_ns[i] @ so3.exp(((t - state.t[i]) / state.interval)[:, None] * turn)


def _averages(
    state: State, step: int, t: Array, R_ns: Array, fields_s: tuple[Array, Array], weight: Array
) -> tuple[IntArray, tuple[Array, Array, Array]]:
    """Keyframes (M,), one in `step`, and the means around each of two fields (M, 3) and of the weight (M,).

    Readings at t (N,) with weights (N,) are averaged in n.
    """
    at = np.arange(0, len(state.t) - 1, step)
    nearest = np.clip(np.round((t - state.t[0]) / (step * state.interval)).astype(np.int64), 0, len(at) - 1)
    count, total = np.bincount(nearest, minlength=len(at)), np.bincount(nearest, weight, len(at))
    some = count > 0

    def mean(values: Array) -> Array:
        return np.asarray(np.bincount(nearest, weight * values, len(at))[some] / total[some])

    means = []
    for field_s in fields_s:
        field_n = np.einsum("nij,nj->ni", R_ns, field_s)
        mean_n = np.stack([mean(field_n[:, i]) for i in range(3)], axis=1)
        means.append(np.einsum("nji,nj->ni", state.R_ns[at[some]], mean_n))
    return at[some], (means[0], means[1], total[some] / count[some])


def _heading_error(R_ns: Array, field_s: Array, declination: float) -> Array:
    """Yaw (N,) rad by which the field's direction in n differs from magnetic north."""
    turned = np.einsum("kij,kj->ki", R_ns, field_s)
    return wrap_angle(np.arctan2(turned[:, 1], turned[:, 0]) + declination)


def _fit(expected: Array, measured: Array) -> tuple[Array, Array, Array]:
    """Robust ridge fit of measured = A expected + h. Returns A (3, 3), h (3,), weights (N,)."""
    centred = measured - np.median(measured, axis=0)
    scale = float(np.linalg.norm(centred)) / max(float(np.linalg.norm(expected - expected.mean(axis=0))), 1e-9)
    design = np.concatenate([expected, np.ones((len(expected), 1))], axis=1)
    weight = np.ones(len(design))
    prior = np.diag([RIDGE, RIDGE, RIDGE, 0.0]) * len(design)
    towards = np.concatenate([scale * np.eye(3), np.zeros((1, 3))])
    for _ in range(8):
        normal = (design * weight[:, None]).T @ design + prior
        solution = np.linalg.solve(normal, (design * weight[:, None]).T @ measured + prior @ towards)
        distance = np.linalg.norm(measured - design @ solution, axis=1)
        weight = 1.0 / (1.0 + (distance / (2.0 * np.median(distance) + 1e-12)) ** 2)
    return solution[:3].T, solution[3], weight


def _with_sigmas(matrix: Array, iron: Array, expected: Array, measured: Array, weight: Array) -> FieldFit:
    """The fit of `expected` (N, 3) to `measured` (N, 3), weights (N,), with sigmas from its residuals.

    Source: Hoerl & Kennard 1970 (covariance of a ridge estimate). The residuals repeat in every lap, so that their
    variance is added whole.
    """
    design = np.concatenate([expected, np.ones((len(expected), 1))], axis=1)
    residual = measured - expected @ matrix.T - iron
    information, sigma = (design * weight[:, None]).T @ design, np.empty((3, 4))
    scale = float(abs(np.linalg.det(matrix)) ** (1.0 / 3.0))
    drawn = RIDGE * len(design) * np.diag([1.0, 1.0, 1.0, 0.0])
    inverse, by_iron = np.linalg.inv(information + drawn), (ANY_IRON * scale * drawn) ** 2
    for axis in range(3):
        variance = float(np.average(residual[:, axis] ** 2, weights=weight))
        alike = correlation_growth(residual[:, axis] * np.sqrt(weight)) ** 2
        of_fit = inverse @ (variance * alike * information + by_iron) @ inverse
        sigma[axis] = np.sqrt(np.diag(of_fit))
    left = np.average(np.mean(residual**2, axis=1), weights=weight)
    sigma = np.sqrt(sigma**2 + (COMMON_LEAN * scale) ** 2 + left)
    turned = float(np.linalg.eigvalsh(np.cov(expected.T, aweights=weight))[1])
    return FieldFit(matrix, iron, sigma[:, :3], sigma[:, 3], turned)
