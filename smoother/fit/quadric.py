"""The algebraic and robust start of the ellipsoid fit. Finds a rough ellipsoid among outliers; refines nothing.

A quadric is normalised by its trace, so that it does not depend on where the origin lies or how the axes turn:

    |x|^2 + e1 (x^2 - z^2) + e2 (y^2 - z^2) + 2 e3 xy + 2 e4 xz + 2 e5 yz + b.x + k = 0

Nine unknowns, linear in the data. Source: Petrov's form, Li and Griffiths 2004 for the normalisation.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray

TRIALS = 512  # with 10 points each: 14 clean draws at 30 % outliers, 3 at 40 %
POINTS_PER_TRIAL = 10
MAX_CHOSEN = 3000
GOLDEN = 0.6180339887498949  # the additive sequence of this step fills [0, 1) most evenly
CONCENTRATED, CONCENTRATIONS = 8, 3  # candidates that are improved, and how often


@dataclass(frozen=True, eq=False)
class RoughEllipsoids:
    """Candidates `|matrix @ (x - centre)| = 1`: centre (K, 3), matrix (K, 3, 3) symmetric positive, is_valid (K,)."""

    centre: Array
    matrix: Array
    is_valid: np.ndarray


def evenly_chosen(points: Array) -> Array:
    """Return at most MAX_CHOSEN of points (N, 3), evenly from first to last."""
    return points[np.linspace(0, len(points) - 1, min(len(points), MAX_CHOSEN)).astype(np.int64)]


def one_per_voxel(points: Array) -> Array:
    """Return one point per occupied voxel, (M, 3) of points (N, 3).

    A logger that lay still for half of the recording must not outweigh the half in which it was turned.
    """
    low, high = np.percentile(points, [10.0, 90.0], axis=0)
    size = max(float(np.max(high - low)), 1e-300) / 40  # ten thousand on a sphere, so only points at rest share one
    cell = np.clip((points - low) / size, -500.0, 500.0).astype(np.int64) + 512
    key = (cell[:, 0] << 20) + (cell[:, 1] << 10) + cell[:, 2]
    _, first = np.unique(key, return_index=True)
    return points[first]


def fit_quadrics(samples: Array) -> RoughEllipsoids:
    """Least-squares quadric through each set of points. samples (K, M, 3), M >= 9. Returns K candidates."""
    x, y, z = samples[..., 0], samples[..., 1], samples[..., 2]
    one = np.ones_like(x)
    columns = [x * x - z * z, y * y - z * z, 2 * x * y, 2 * x * z, 2 * y * z, x, y, z, one]
    design = np.stack(columns, axis=-1)
    target = -(x * x + y * y + z * z)
    unknown = (np.linalg.pinv(design) @ target[..., None])[..., 0]
    return _ellipsoids(unknown)


def _ellipsoids(unknown: Array) -> RoughEllipsoids:
    e, linear, constant = unknown[:, :5], unknown[:, 5:8], unknown[:, 8]
    Q = np.zeros((len(unknown), 3, 3))
    Q[:, 0, 0], Q[:, 1, 1], Q[:, 2, 2] = 1.0 + e[:, 0], 1.0 + e[:, 1], 1.0 - e[:, 0] - e[:, 1]
    Q[:, 0, 1] = Q[:, 1, 0] = e[:, 2]
    Q[:, 0, 2] = Q[:, 2, 0] = e[:, 3]
    Q[:, 1, 2] = Q[:, 2, 1] = e[:, 4]
    value, vector = np.linalg.eigh(Q)
    is_ellipsoid = value[:, 0] > 1e-6
    value = np.where(is_ellipsoid[:, None], value, 1.0)
    rotated = np.einsum("kji,kj->ki", vector, linear)
    centre = -0.5 * np.einsum("kij,kj->ki", vector, rotated / value)
    radius2 = np.sum(rotated**2 / value, axis=-1) / 4.0 - constant
    is_valid = is_ellipsoid & (radius2 > 0.0)
    scale = np.where(is_valid, radius2, 1.0)
    root = np.sqrt(value / scale[:, None])
    matrix = np.einsum("kij,kj,klj->kil", vector, root, vector)
    return RoughEllipsoids(centre, matrix, is_valid)


def first_order_distance(points: Array, centre: Array, matrix: Array) -> Array:
    """Distance from the ellipsoid to first order, outside positive. points (N, 3). Returns (N,), unit of the points.

    Stacks are carried through: centre (..., 3) and matrix (..., 3, 3) give (..., N). Source: Sampson 1982.
    """
    unit = (points - centre[..., None, :]) @ matrix
    radius = np.maximum(np.sqrt(np.einsum("...i,...i->...", unit, unit)), 1e-12)
    gradient = unit @ matrix
    slope = np.maximum(np.sqrt(np.einsum("...i,...i->...", gradient, gradient)), 1e-300)
    return np.asarray((radius - 1.0) * radius / slope)


def robust_start(points: Array) -> tuple[Array, Array] | None:
    """Centre (3,) and matrix (3, 3) of the candidate with the least median distance, or None if none is an ellipsoid.

    points (N, 3), thinned. Candidates are the quadric through all points and those through small sets chosen by an
    additive sequence: as good as random draws, and the same every time. The best are concentrated: refitted to the half
    of the points nearest to them. Source: Rousseeuw and Van Driessen 2006 (FAST-LTS).
    """
    candidates = _ranked(points, fit_quadrics(points[_draws(len(points))]))[:CONCENTRATED]
    candidates += _ranked(points, fit_quadrics(points[None]))
    for _ in range(CONCENTRATIONS):
        candidates += [
            better for _, *rough in candidates[-CONCENTRATED - 1 :] for better in _concentrated(points, *rough)
        ]
    if not candidates:
        return None
    _, centre, matrix = min(candidates, key=lambda candidate: candidate[0])
    return centre, matrix


def _ranked(points: Array, rough: RoughEllipsoids) -> list[tuple[float, Array, Array]]:
    """Median distance, centre and matrix of the valid candidates within three extents of the points, best first."""
    extent = 3.0 * float(np.max(np.percentile(points, 95.0, axis=0) - np.percentile(points, 5.0, axis=0)))
    centre, matrix = rough.centre[rough.is_valid], rough.matrix[rough.is_valid]
    small = extent * np.linalg.eigvalsh(matrix)[:, 0] > 1.0
    centre, matrix = centre[small], matrix[small]
    # points by which the many candidates are compared
    judges = points[:: max(len(points) // 400, 1)] if len(centre) > 1 else points
    score = np.median(np.abs(first_order_distance(judges, centre, matrix)), axis=-1)
    return [(float(score[k]), centre[k], matrix[k]) for k in np.argsort(score)]


def _concentrated(points: Array, centre: Array, matrix: Array) -> list[tuple[float, Array, Array]]:
    distance = np.abs(first_order_distance(points, centre, matrix))
    nearest = points[distance <= np.median(distance)]
    return _ranked(points, fit_quadrics(nearest[None]))


def _draws(count: int) -> IntArray:
    place = np.mod(np.arange(TRIALS * POINTS_PER_TRIAL) * GOLDEN, 1.0) * count
    return np.asarray(place.astype(np.int64).reshape(TRIALS, POINTS_PER_TRIAL))
