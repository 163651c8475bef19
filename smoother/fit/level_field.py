"""Magnetometer calibration from driving alone: the field while a box turns about the vertical and hardly tilts.

Then the readings lie on an ellipse, not on an ellipsoid. In axes h whose third one is up, with a symmetric matrix

    W = [E + g k k', -g k; -g k', g],      W (reading - hard_iron) = unit field,

the ellipse shows E (2 x 2, its shape across the vertical), k (by how much its plane is tilted by soft iron) and its
centre: seven figures. It does not show the gain g along the vertical, nor, apart from it, the hard iron along the
vertical: only how both together place the centre, because the vertical field never changes. g is taken to be the mean
gain across. A constant turn of the heading cannot be seen either; a symmetric matrix is the assumption that it is none.

For the heading all that matters is what is seen: the vertical part drops out of it as long as the kart stays level.
"""

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import least_squares

from smoother import so3
from smoother.arrays import MAD_TO_SIGMA, Array
from smoother.fit.ellipsoid import FitError

FEWEST_READINGS = 100
SECTORS = 16
LEAST_SECTORS = 13  # of the 16; with fewer the ellipse is guessed
BLOCK = 5.0  # s; what disturbs the field (engine, kerbs, iron beside the track) lasts
SMOOTHING = 0.3  # s over which the angular rate is averaged
LEAST_TURNING = 0.1  # rad/s rms about the vertical
AVERAGED = 1.0  # s over which white noise is averaged out of the radius
DISTURBANCE_MEAN = 2.0  # engine currents go with the throttle: their mean, which no fit sees, per scatter of the radius
UPRIGHT = 3.0  # least ratio of turning about the vertical to turning about any other axis
LARGEST_SCATTER = 0.35  # of single readings, relative to the radius; a cloud of noise gives 0.4 and more
FARTHEST = 1e9  # of the readings' unit; a trial step may pass a degenerate ellipse
LARGEST_RMS = 0.3  # of the radius; beyond, engine or iron outweigh the Earth


@dataclass(frozen=True, eq=False)
class LevelField:
    """hard_iron (3,) in the unit of the readings; matrix (3, 3) symmetric, to the unit field; up (3,), all in s.

    centre_sigma (2,): of the hard iron along the two level axes `level` (3, 2), with an allowance for what the engine
    adds to it on average; shape_sigma: relative, of the radius in any direction; rms: of the radius over a second,
    relative; sectors: share of headings seen, 0..1. `assumed` says in words what was not observable.
    """

    hard_iron: Array
    matrix: Array
    up: Array
    level: Array
    centre_sigma: Array
    shape_sigma: float
    rms: float
    sectors: float
    assumed: tuple[str, ...]


ASSUMED = (
    "soft iron along the vertical (taken as the mean of the level axes)",
    "hard iron along the vertical (follows from that and the inclination)",
    "a constant turn of the heading (taken as zero)",
)


def up_from_turning(t: Array, specific_force: Array, angular_rate: Array) -> Array:
    """Direction of up (3,) in s of a vehicle that turns about the vertical: t (N,), force and rate (N, 3), axes s.

    The mean force will not do: laps in one direction have a mean lateral acceleration. The axis of the slow part of the
    angular rate is the vertical; the force only says which end of it is up.
    Raises FitError when the rate shows no such axis.
    """
    window = max(1, round(SMOOTHING / float(np.median(np.diff(t)))))
    slow = uniform_filter1d(angular_rate, window, axis=0)
    slow = slow - np.median(slow, axis=0)
    size = np.linalg.norm(slow, axis=1)
    slow = slow * np.minimum(1.0, np.percentile(size, 95.0) / np.maximum(size, 1e-12))[:, None]
    variance, axes = np.linalg.eigh(slow.T @ slow / len(slow))
    if np.sqrt(variance[2]) < LEAST_TURNING or variance[2] < UPRIGHT**2 * variance[1]:
        raise FitError("the gyroscope shows no turning about one axis, so nothing says where up is; drive some laps")
    axis = axes[:, 2]
    return np.asarray(axis * np.sign(axis @ np.mean(specific_force, axis=0)))


def fit_level_field(t: Array, field: Array, up: Array, inclination: float) -> LevelField:
    """Fit the ellipse of readings (N, 3) at t (N,) s, taken while driving level; up (3,) in s, inclination rad.

    Raises FitError when readings are few, headings are missing, or the readings do not lie near an ellipse.
    """
    if len(field) < FEWEST_READINGS or not np.all(np.isfinite(field)):
        raise FitError(
            f"{len(field)} readings while driving are too few (or not numbers) for a magnetometer calibration"
        )
    frame = _frame_with(up)
    across, along = field @ frame[:, :2], field @ up
    parameters = _ellipse(across)
    A, centre = _shape(parameters), parameters[:2]
    unit = (across - centre) @ A
    sectors = _sectors(unit)
    if sectors * SECTORS < LEAST_SECTORS:
        raise FitError("the laps do not show all headings to the magnetometer; drive some circles in both directions")
    off = np.linalg.norm(unit, axis=1) - 1.0
    rms = _slow_rms(t, off)
    if MAD_TO_SIGMA * float(np.median(np.abs(off))) > LARGEST_SCATTER or rms > LARGEST_RMS:
        raise FitError("the readings do not lie near an ellipse: engine or iron outweigh the Earth's field")
    covariance = _covariance(t, across, parameters)
    slope, height = _plane(across - centre, along)
    matrix, iron = _assembled(A, slope, inclination)
    hard_iron = frame[:, :2] @ centre + up * height + frame @ iron
    hidden = DISTURBANCE_MEAN * rms / np.sqrt(np.linalg.det(A))
    gains = np.linalg.eigvalsh(A)
    return LevelField(
        hard_iron=hard_iron,
        matrix=frame @ matrix @ frame.T,
        up=up,
        level=frame[:, :2],
        centre_sigma=np.sqrt(np.diagonal(covariance)[:2] + hidden**2),
        shape_sigma=float(np.sqrt(np.max(np.linalg.eigvalsh(covariance[2:, 2:]))) / gains[0]),
        rms=rms,
        sectors=sectors,
        assumed=ASSUMED,
    )


def _slow_rms(t: Array, residual: Array) -> float:
    """Robust rms of the residuals (N,) over means of AVERAGED seconds."""
    block = np.unique(np.floor((t - t[0]) / AVERAGED).astype(np.int64), return_inverse=True)[1]
    mean = np.bincount(block, residual) / np.bincount(block)
    return MAD_TO_SIGMA * float(np.median(np.abs(mean - np.median(mean))))


def _frame_with(up: Array) -> Array:
    """Right-handed axes (3, 3), columns in s, the third one up."""
    first = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    first = first / np.linalg.norm(first)
    return np.stack([first, np.cross(up, first), up], axis=1)


def _shape(parameters: Array) -> Array:
    return np.array([[parameters[2], parameters[3]], [parameters[3], parameters[4]]])


def _distance(parameters: Array, points: Array) -> Array:
    """First-order distance (N,) of points (N, 2) from the ellipse, outside positive (Sampson 1982)."""
    A = _shape(parameters)
    unit = (points - parameters[:2]) @ A
    radius = np.maximum(np.linalg.norm(unit, axis=1), 1e-12)
    distance = (radius - 1.0) * radius / np.maximum(np.linalg.norm(unit @ A, axis=1), 1e-300)
    return np.asarray(np.clip(distance, -FARTHEST, FARTHEST))


def _ellipse(points: Array) -> Array:
    """Centre and upper triangle of the root (5,), robustly: the engine pulls at some of the readings."""
    low, high = np.percentile(points, [2.0, 98.0], axis=0)
    radius = 0.5 * (high - low)
    if np.min(radius) < 0.05 * np.max(radius) or not np.all(radius > 0.0):
        raise FitError("the magnetometer's readings hardly change across the vertical; did the kart drive a lap?")
    start = np.concatenate([0.5 * (low + high), [1.0 / radius[0], 0.0, 1.0 / radius[1]]])
    scale = np.concatenate([radius, 0.3 / radius[[0, 0, 1]]])
    thinned = points[:: max(1, len(points) // 5000)]
    spread = 0.1 * float(np.mean(radius))
    for _ in range(3):
        found = least_squares(
            _distance, start, loss="cauchy", f_scale=spread, x_scale=scale, args=(thinned,), max_nfev=100
        )
        start = found.x
        spread = 2.0 * max(float(np.median(np.abs(_distance(start, thinned)))), 1e-6 * float(np.mean(radius)))
    if np.min(np.linalg.eigvalsh(_shape(start))) <= 0.0:
        raise FitError(
            "the magnetometer's readings do not lie on an ellipse; engine or iron outweigh the Earth's field"
        )
    return np.asarray(start)


def _covariance(t: Array, points: Array, parameters: Array) -> Array:
    """Covariance (5, 5) from the scores summed over blocks of time (sandwich), because disturbances last."""
    unit = np.concatenate([np.full(2, 1.0 / np.max(parameters[2:])), np.full(3, np.max(parameters[2:]))])  # of each
    J = so3.numerical_jacobian(lambda x: _distance(x * unit, points), parameters / unit, 1e-6) / unit
    residual = _distance(parameters, points)
    exact = 1e-6 / float(np.max(parameters[2:]))  # of the radius; data without noise have no scatter to go by
    limit = 4.0 * MAD_TO_SIGMA * max(float(np.median(np.abs(residual))), exact)
    weight = 1.0 / (1.0 + (2.0 * residual / limit) ** 2)
    block = np.floor((t - t[0]) / BLOCK).astype(np.int64)
    score = np.stack([np.bincount(block, J[:, i] * weight * residual) for i in range(5)], axis=1)
    normal = np.linalg.inv((J * weight[:, None]).T @ J)
    return np.asarray(normal @ (score.T @ score) @ normal)


def _plane(across: Array, along: Array) -> tuple[Array, float]:
    """Slope k (2,) and height of the plane in which the ellipse lies: along = height + k . across, by the median."""
    design = np.concatenate([across, np.ones((len(across), 1))], axis=1)
    weight = np.ones(len(along))
    for _ in range(10):
        solution = np.linalg.lstsq(design * weight[:, None], along * weight, rcond=None)[0]
        residual = np.abs(along - design @ solution)
        weight = 1.0 / np.sqrt(1.0 + (residual / (3.0 * np.median(residual) + 1e-12)) ** 2)
    return np.asarray(solution[:2]), float(solution[2])


def _assembled(A: Array, slope: Array, inclination: float) -> tuple[Array, Array]:
    """W (3, 3) and the hard iron (3,) from the ellipse's centre, in axes h."""
    E = np.cos(inclination) * A
    gain = float(np.sqrt(np.linalg.det(E)))
    W = np.empty((3, 3))
    W[:2, :2] = E + gain * np.outer(slope, slope)
    W[:2, 2] = W[2, :2] = -gain * slope
    W[2, 2] = gain
    vertical = np.array([0.0, 0.0, -np.sin(inclination)])  # of the unit field: it points down in the north
    return W, np.asarray(-np.linalg.solve(W, vertical))


def _sectors(unit: Array) -> float:
    sector = np.floor(np.arctan2(unit[:, 1], unit[:, 0]) / (2.0 * np.pi) * SECTORS).astype(np.int64) % SECTORS
    count = np.bincount(sector, minlength=SECTORS)
    return float(np.mean(count >= 3))
