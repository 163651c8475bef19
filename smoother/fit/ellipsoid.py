"""Ellipsoid through the readings of a magnetometer (or accelerometer at rest) that was turned in every direction.

The model is `measured = centre + inverse(to_unit_sphere) @ unit_vector + white noise`, the noise alike on each axis. A
rotation of the unit vectors cannot be seen in such data, so `to_unit_sphere` is the symmetric positive definite root
(polar convention): it stretches and does not turn. Whether the sensor's axes are also turned against another sensor's
must come from elsewhere.

The thesis' eq. 2.13-2.16 print M once as the matrix from the sphere to the ellipsoid and once, in 2.16, as its inverse;
here the matrix always leads from the readings to the unit sphere.

Steps: thin, least median of quadrics (:mod:`smoother.fit.quadric`), then orthogonal distances by Gauss-Newton, points
beyond `OUTLIER_SIGMAS` left out, and the bias of orthogonal distances taken off (a noisy point on a curved surface lies
outside it on average, by half the noise variance times the sum of the principal curvatures).
Sources: Ahn et al. 2002 (orthogonal distance fitting); Eberly, "Distance from a point to an ellipsoid" (foot point).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, freeze
from smoother.errors import SmootherError
from smoother.fit import quadric

MIN_POINTS = 12  # three more than there are unknowns
OUTLIER_SIGMAS = 5.0  # of the noise; cuts off one good point in two million
MIN_THICKNESS = 0.05  # of the largest extent; below this it is a plane
MAX_RELATIVE_SIGMA = 0.2  # of a semi-axis; above this the points do not say how long it is
MAX_RELATIVE_SIZE = 10.0  # of half the points' extent; a larger ellipsoid is a plane with a name
MAX_RELATIVE_RMS = 0.25  # of the shortest semi-axis; a cloud of noise gives 0.4 and more
COVERAGE_BANDS, COVERAGE_SECTORS = 6, 10  # 60 cells of equal area, 0.21 sr each
CONVERGED = 1e-4  # last step, in standard deviations of the result
ROWS, COLUMNS = np.array([0, 0, 0, 1, 1, 2]), np.array([0, 1, 2, 1, 2, 2])  # the upper triangle, row by row


class FitError(SmootherError):
    """The data do not determine what was to be fitted. The text says why, in one sentence."""


@dataclass(frozen=True, eq=False)
class Ellipsoid:
    """The ellipsoid `|to_unit_sphere @ (x - centre)| = 1`, in the unit of the points.

    centre (3,); to_unit_sphere (3, 3), symmetric positive definite, per unit of the points; covariance (9, 9) of centre
    and of the upper triangle xx, xy, xz, yy, yz, zz of to_unit_sphere; rms: root mean square orthogonal distance of the
    points used; coverage: share of the sphere's directions that hold points, 0..1; semi_axes (3,) longest first, with
    semi_axes_sigma (3,) and their directions in the columns of axes (3, 3); is_used (N,), False for outliers.
    """

    centre: Array
    to_unit_sphere: Array
    covariance: Array
    rms: float
    coverage: float
    semi_axes: Array
    semi_axes_sigma: Array
    axes: Array
    is_used: BoolArray

    def __post_init__(self) -> None:
        freeze(self, centre=(3,), to_unit_sphere=(3, 3), covariance=(9, 9))
        freeze(self, semi_axes=(3,), semi_axes_sigma=(3,), axes=(3, 3))

    def apply(self, points: Array) -> Array:
        """Return points (N, 3) carried to the unit sphere, (N, 3)."""
        return np.asarray((points - self.centre) @ self.to_unit_sphere)


def fit_ellipsoid(points: Array) -> Ellipsoid:
    """Fit an ellipsoid to points (N, 3) of any unit.

    Raises FitError when the points hold NaN, are too few, constant, saturated, in a plane, or too one-sided to tell.
    """
    points = _checked(np.asarray(points, dtype=np.float64))
    some = quadric.evenly_chosen(points)
    thinned = quadric.one_per_voxel(some)
    if len(thinned) < MIN_POINTS:
        raise FitError(f"only {len(thinned)} readings differ from each other; turn the sensor in every direction")
    _refuse_plane(thinned)
    _refuse_saturated(points)
    try:
        return _fit_from(thinned, points)
    except FitError:
        # Very wild outliers make the voxels so large that good points share theirs, and outnumber them.
        return _fit_from(some, points)


def _fit_from(some: Array, points: Array) -> Ellipsoid:
    """Fit to all points (N, 3), starting from some of them, in coordinates of about one."""
    low, high = np.percentile(some, [5.0, 95.0], axis=0)
    middle, scale = (low + high) / 2.0, float(np.max(high - low)) / 2.0
    normal, some = (points - middle) / scale, (some - middle) / scale
    try:
        parameters, used = _refined(normal, some, _start(some))
        surface = _Surface.at(normal[used], parameters)
        covariance = _covariance(surface)
    except np.linalg.LinAlgError as error:
        raise FitError("the points do not determine an ellipsoid; turn the sensor in every direction") from error
    return _ellipsoid(parameters, covariance, surface, normal, used, middle, scale)


# ---- input ----------------------------------------------------------------------------------------------------------


def _checked(points: Array) -> Array:
    if points.ndim != 2 or points.shape[1] != 3:
        raise FitError(f"an ellipsoid needs points in three columns, not an array of shape {points.shape}")
    if not np.all(np.isfinite(points)):
        bad = int(np.sum(~np.all(np.isfinite(points), axis=1)))
        raise FitError(f"{bad} of {len(points)} points are not finite numbers; drop those rows before the fit")
    if len(points) < MIN_POINTS:
        raise FitError(f"{len(points)} points are too few for an ellipsoid, which needs at least {MIN_POINTS}")
    if float(np.max(np.percentile(points, 95.0, axis=0) - np.percentile(points, 5.0, axis=0))) == 0.0:
        raise FitError("the points are constant; the sensor was not turned or did not answer")
    return points


def _refuse_saturated(points: Array) -> None:
    for axis, letter in enumerate("xyz"):
        if _is_saturated(points, axis, np.max) or _is_saturated(points, axis, np.min):
            raise FitError(f"the {letter} axis is saturated: many readings share its extreme value; use a wider range")


def _is_saturated(points: Array, axis: int, extreme: Callable[[Array], float]) -> bool:
    """Whether far more readings share the extreme value of an axis than the ten next values, and differ elsewhere."""
    values = points[:, axis]
    end = extreme(values)
    pile = values == end
    count = int(np.sum(pile))
    if count < 5:
        return False
    levels, counts = np.unique(values, return_counts=True)
    neighbours = counts[-11:-1] if end == levels[-1] else counts[1:11]
    others = np.delete(points, axis, axis=1)
    spread = np.percentile(others[pile], 90.0, axis=0) - np.percentile(others[pile], 10.0, axis=0)
    is_wide = float(np.max(spread)) > 0.1 * float(np.max(np.ptp(others, axis=0)))
    return is_wide and (neighbours.size == 0 or count > 5.0 * float(np.mean(neighbours)) + 5.0)


def _refuse_plane(points: Array) -> None:
    centred = points - np.median(points, axis=0)
    _, _, directions = np.linalg.svd(centred, full_matrices=False)
    along = centred @ directions.T
    extent = np.percentile(along, 95.0, axis=0) - np.percentile(along, 5.0, axis=0)
    if np.min(extent) < MIN_THICKNESS * np.max(extent):
        raise FitError("the points lie in one plane or on a line; turn the sensor about more than one axis")


# ---- orthogonal distances -------------------------------------------------------------------------------------------


def _matrix(parameters: Array) -> Array:
    A = np.empty((3, 3))
    A[ROWS, COLUMNS] = A[COLUMNS, ROWS] = parameters[3:]
    return A


def _foot_points(y: Array, A: Array) -> Array:
    """Nearest points (N, 3) of the surface |A x| = 1 to y (N, 3).

    The multiplier l of `x = s^2 y / (s^2 + l)` is the root of a convex falling function, reached from its left side,
    where the secular form 1/sqrt of it is almost a straight line: three steps near the surface, never a divergence.
    """
    inverse_axes, directions = np.linalg.eigh(A)
    s = (1.0 / inverse_axes)[:, None]
    s2 = s * s
    z = directions.T @ y.T  # rows are axes: sums over the first index run at memory speed
    z = np.where(np.abs(z) < 1e-9 * s, 1e-9 * s, z)  # on a principal plane inside, the foot point is not unique
    weighted = (s * z) ** 2
    multiplier = np.max(s * np.abs(z) - s2, axis=0)
    for _ in range(30):
        inverse = 1.0 / (s2 + multiplier)
        term = weighted * inverse * inverse
        f, slope = np.sum(term, axis=0), -2.0 * np.sum(term * inverse, axis=0)
        step = 2.0 * f * (1.0 - np.sqrt(f)) / slope
        multiplier = multiplier + step
        if np.max(np.abs(step)) < 1e-8 * s2[-1, 0]:  # quadratic convergence: the next one would be below 1e-15
            break
    return np.asarray((s2 * z / (s2 + multiplier)).T @ directions.T)


@dataclass(frozen=True, eq=False)
class _Surface:
    """Points seen from an ellipsoid: distance (N,), outside positive; its jacobian (N, 9); sum of curvatures (N,)."""

    distance: Array
    jacobian: Array
    curvature: Array

    @staticmethod
    def at(points: Array, parameters: Array) -> "_Surface":
        A = _matrix(parameters)
        Q = A @ A
        y = points - parameters[:3]
        x = _foot_points(y, A)
        gradient = x @ Q
        length = np.sqrt(_dot(gradient, gradient))
        normal = gradient / length[:, None]
        unit = x @ A
        # d(|A x|^2 / 2) / dA_ij = (A x)_i x_j, both triangles; the foot point's own motion drops out
        jacobian = np.empty((len(points), 9))
        jacobian[:, :3] = -normal
        for k, (i, j) in enumerate(zip(ROWS, COLUMNS, strict=True)):
            both = unit[:, i] * x[:, j] if i == j else unit[:, i] * x[:, j] + unit[:, j] * x[:, i]
            jacobian[:, 3 + k] = both / length
        curvature = (np.trace(Q) - _dot(normal @ Q, normal)) / length
        return _Surface(_dot(y - x, normal), jacobian, curvature)

    def residual(self, noise_variance: float) -> Array:
        """Distance less what noise adds to it on average, (N,)."""
        return self.distance - 0.5 * noise_variance * self.curvature


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))


# ---- the fit, in normalised coordinates -----------------------------------------------------------------------------


def _start(thinned: Array) -> Array:
    start = quadric.robust_start(thinned)
    if start is None:
        raise FitError(
            "the points do not lie on an ellipsoid; turn the sensor slowly in every direction, away from iron"
        )
    parameters = np.concatenate([start[0], start[1][ROWS, COLUMNS]])
    for _ in range(3):
        distance = np.abs(quadric.first_order_distance(thinned, parameters[:3], _matrix(parameters)))
        near = thinned[distance <= 4.0 * MAD_TO_SIGMA * np.median(distance) + 1e-9]
        _refuse_plane(near)
        parameters = _gauss_newton(near, parameters, 5)
    return parameters


def _refined(points: Array, thinned: Array, parameters: Array) -> tuple[Array, BoolArray]:
    """Parameters (9,) by orthogonal distances of the points within OUTLIER_SIGMAS of the noise of the thinned points,
    and which points these are (N,)."""
    used = np.zeros(len(points), dtype=np.bool_)
    for _ in range(10):
        centre, matrix = parameters[:3], _matrix(parameters)
        noise = MAD_TO_SIGMA * float(np.median(np.abs(quadric.first_order_distance(thinned, centre, matrix))))
        now = np.abs(quadric.first_order_distance(points, centre, matrix)) <= OUTLIER_SIGMAS * noise + 1e-9
        if np.sum(now) < MIN_POINTS:
            raise FitError("too few points agree on one ellipsoid; turn the sensor slowly, away from iron and cables")
        if np.array_equal(now, used):
            break
        used = now
        parameters = _gauss_newton(points[used], parameters, 20)
    return parameters, used


def _gauss_newton(points: Array, parameters: Array, iterations: int) -> Array:
    surface = _Surface.at(points, parameters)
    for _ in range(iterations):
        variance = float(np.sum(surface.distance**2)) / max(len(points) - 9, 1)
        residual = surface.residual(variance)
        J = surface.jacobian
        step: Array = np.asarray(np.linalg.solve(J.T @ J, -J.T @ residual))
        accepted = _shortened(points, parameters, step, variance, float(residual @ residual))
        if accepted is None:
            break
        moved = J @ (accepted[0] - parameters)
        parameters, surface = accepted
        if float(moved @ moved) < (CONVERGED * CONVERGED) * variance:
            break
    return parameters


def _shortened(
    points: Array, parameters: Array, step: Array, variance: float, cost: float
) -> tuple[Array, _Surface] | None:
    """Parameters and surface after the longest halving of `step` that does not raise the cost, or None."""
    for _ in range(10):
        trial = parameters + step
        if np.linalg.eigvalsh(_matrix(trial))[0] > 0.0:
            surface = _Surface.at(points, trial)
            if float(np.sum(surface.residual(variance) ** 2)) <= cost * (1.0 + 1e-9) + 1e-24:
                return trial, surface
        step = 0.5 * step
    return None


def _covariance(surface: _Surface) -> Array:
    freedom = len(surface.distance) - 9
    variance = float(np.sum(surface.distance**2)) / freedom
    variance = float(np.sum(surface.residual(variance) ** 2)) / freedom
    # By way of Cholesky factors it stays positive, and points that determine too little raise LinAlgError.
    root = np.linalg.solve(np.linalg.cholesky(surface.jacobian.T @ surface.jacobian), np.eye(9))
    return np.asarray(variance * (root.T @ root))


def _ellipsoid(
    parameters: Array, covariance: Array, surface: _Surface, normal: Array, used: BoolArray, middle: Array, scale: float
) -> Ellipsoid:
    """Check the fit and return it in the unit of the points, from coordinates `(points - middle) / scale`."""
    A = _matrix(parameters)
    inverse_axes, axes = np.linalg.eigh(A)
    if inverse_axes[0] <= 0.0:
        raise FitError("the points do not determine an ellipsoid; turn the sensor in every direction")
    semi_axes = 1.0 / inverse_axes
    by_entry = axes[ROWS] * axes[COLUMNS] * np.where(ROWS == COLUMNS, 1.0, 2.0)[:, None]  # d(1 / s_i) / dA
    gradient = -(semi_axes**2) * by_entry
    sigma = np.sqrt(np.einsum("ai,ab,bi->i", gradient, covariance[3:, 3:], gradient))
    rms = float(np.sqrt(np.mean(surface.distance**2)))
    if semi_axes[0] > MAX_RELATIVE_SIZE or np.any(sigma > MAX_RELATIVE_SIGMA * semi_axes):
        raise FitError("the points cover too little of the sphere; turn the sensor in every direction")
    if rms > MAX_RELATIVE_RMS * semi_axes[-1]:
        raise FitError("the points fill a cloud instead of lying on an ellipsoid; turn the sensor, away from iron")
    unit = np.concatenate([np.full(3, scale), np.full(6, 1.0 / scale)])
    return Ellipsoid(
        centre=parameters[:3] * scale + middle,
        to_unit_sphere=A / scale,
        covariance=covariance * unit[:, None] * unit,
        rms=rms * scale,
        coverage=_coverage((normal[used] - parameters[:3]) @ A),
        semi_axes=semi_axes * scale,
        semi_axes_sigma=sigma * scale,
        axes=axes,
        is_used=used,
    )


def _coverage(unit: Array) -> float:
    """Share of 60 cells of equal area that hold at least one direction of unit (N, 3)."""
    z = unit[:, 2] / np.linalg.norm(unit, axis=1)
    band = np.clip((z + 1.0) / 2.0 * COVERAGE_BANDS, 0, COVERAGE_BANDS - 1).astype(np.int64)
    turn = (np.arctan2(unit[:, 1], unit[:, 0]) / (2.0 * np.pi)) % 1.0
    sector = np.clip(turn * COVERAGE_SECTORS, 0, COVERAGE_SECTORS - 1).astype(np.int64)
    return len(np.unique(band * COVERAGE_SECTORS + sector)) / (COVERAGE_BANDS * COVERAGE_SECTORS)
