"""The noise of a session from the residuals of its solution: variance components.

The ratio of the squared residuals of each source to their expectation corrects its variance. The fixed point is the
restricted maximum-likelihood estimate. The initial value of a source has the weight of a few residuals, so that short
sessions do not underestimate it.
Source: Foerstner 1979 (the estimator); Harville 1977 (scoring of two components at once).
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.factors.graph import Graph
from smoother.estimate.factors.rows import Rows, after_step
from smoother.estimate.factors.wheels import SLIP_TIME
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.model.noise import InertialNoise, Noise, Shape, shared_densities
from smoother.estimate.model.state import COLUMNS, ROTATION
from smoother.estimate.solvers.batch import Step
from smoother.estimate.solvers.covariance import Covariances

USUAL_POSITION, SMALLEST_POSITION = np.array([0.05, 0.05, 0.1]), 0.02  # m; receivers filter, and a digit is 0.02
USUAL_VELOCITY, SMALLEST_VELOCITY = np.array([0.15, 0.15, 0.3]), 0.02  # m/s
POSITION_COUNT, UPWARDS_COUNT, OFFSET_COUNT, SLIP_COUNT = 1.0, 20.0, 1.0, 5.0  # residuals
SCATTER_COUNT, SHAPE_COUNT, SHARE_COUNT, ROWS_COUNT = 10.0, 20.0, 10.0, 1.0
USUAL_SLIP = math.radians(0.6)
USUAL_SPREAD = 1.4  # of the logarithm of a velocity's variance among receivers
OWN_SCATTER = 0.3  # least density, in parts of the scatter between samples
LARGEST_SQUARE = 1.0  # bound of a squared position residual over its expectation, against outliers
FLATTEST, LARGEST_SHARE = 0.02, 0.95
MOST_STEP = 3.0  # ratio of a sigma to the one before
HASTE = 1.4  # power of a ratio: steps approach the fixed point from one side
ENOUGH = 1000  # intervals, spread evenly, for a density to 2 %
FEWEST_DRIVEN = 25  # intervals
SENSOR_SCALE = ("accel_scale", "gyro_scale")
LEAST_SCALE, LARGEST_SCALE = 1e-3, 1.5e-2  # bounds of the spread of scale and misalignment


@dataclass(frozen=True, eq=False)
class Scatter:
    """Densities that the scatter of neighbouring samples shows."""

    accel: float
    gyro: float


@dataclass(frozen=True, eq=False)
class RowComponent:
    """Squared residuals of rows over their variances after the step, and what is expected of them, (N, r) each."""

    squares: Array
    expected: Array

    @staticmethod
    def of(rows: Rows, step: Step, covariances: Covariances) -> "RowComponent":
        """Of rows that the graph was linearised with."""
        after, information = after_step(rows, step.keyframes, step.constants), rows.information
        left = rows.weight[:, None] - posterior_variance(rows, covariances) * information
        return RowComponent(after.residual**2 * information, np.where(information > 0.0, np.maximum(left, 0.0), 0.0))

    def only(self, use: BoolArray) -> "RowComponent":
        """Nothing of rows (N,) that are not used."""
        return RowComponent(self.squares * use[:, None], self.expected * use[:, None])


def posterior_variance(rows: Rows, covariances: Covariances) -> Array:
    """Variance (N, r) that the solution leaves in the prediction of rows."""
    return np.asarray(np.einsum("nii->ni", posterior_covariance(rows.jacobian(), rows.interval, covariances)))


def posterior_covariance(J: Array, k: IntArray, c: Covariances) -> Array:
    """Covariance (N, r, r) that the solution leaves in J (N, r, 36 + C) times keyframes k, k + 1 and the constants."""
    used, size = np.any(J, axis=(0, 1)), c.keyframes.shape[1]
    of_left, of_right, of_constants = (np.flatnonzero(part) for part in np.split(used, [size, 2 * size]))
    left, right = J[:, :, :size][:, :, of_left], J[:, :, size : 2 * size][:, :, of_right]
    by_constants = J[:, :, 2 * size :][:, :, of_constants]

    def product(a: Array, block: Array, at: IntArray, rows: IntArray, columns: IntArray, b: Array) -> Array:
        return a @ block[np.ix_(at, rows, columns)] @ b.transpose(0, 2, 1) if a.size and b.size else np.zeros(1)

    mixed = product(left, c.neighbours, k, of_left, of_right, right)
    mixed = mixed + product(left, c.with_constants, k, of_left, of_constants, by_constants)
    mixed = mixed + product(right, c.with_constants, k + 1, of_right, of_constants, by_constants)
    own = product(left, c.keyframes, k, of_left, of_left, left)
    own = own + product(right, c.keyframes, k + 1, of_right, of_right, right)
    own = own + by_constants @ c.constants[np.ix_(of_constants, of_constants)] @ by_constants.transpose(0, 2, 1)
    return np.asarray(own + mixed + np.swapaxes(mixed, -1, -2) if mixed.ndim == 3 else own)


@dataclass(frozen=True, eq=False)
class SampleComponent:
    """Squares and redundancies of white noise in the samples: of intervals (N,), and by direction (3, 3)."""

    squares_of: Array
    redundancy_of: Array
    squares_in: Array
    redundancy_in: Array

    @staticmethod
    def of(squares: Array, redundancy: Array) -> "SampleComponent":
        """From those of each interval by direction, (N, 3, 3)."""
        of_each = np.einsum("nii->n", squares), np.einsum("nii->n", redundancy)
        return SampleComponent(*of_each, squares.sum(axis=0), redundancy.sum(axis=0))


def sample_components(
    graph: Graph, step: Step, covariances: Covariances, at: IntArray, density: tuple[Array, Array]
) -> tuple[SampleComponent, SampleComponent]:
    """Noise of force and of rate in the IMU factors `at` (N,), which were given density (N,) each and the shapes.

    White force of a density moves velocity and position by a known covariance V, a part only of a factor's. With S its
    square-root information, force weighs the whitened residual e by W = S V S': it answers for e' W e, of which
    tr(W (1 - C)) is expected, C being what the solution leaves. Only white rate turns: its part is the rotation.
    """
    T = step.state.interval
    covariance = np.array([graph.preintegrated[k].preintMeasCov() for k in at]).reshape(-1, 15, 15)
    root = np.linalg.cholesky(np.linalg.inv(covariance)).transpose(0, 2, 1)
    noise = graph.noise.inertial
    force, rate = (np.linalg.cholesky(np.array(shape)) for shape in (noise.accel_shape, noise.gyro_shape))
    by_motion = force.T @ root[:, :, 3:9].reshape(-1, 15, 2, 3).transpose(0, 2, 3, 1)
    turn = np.linalg.solve(root.transpose(0, 2, 1), np.linalg.solve(rate, np.eye(15)[ROTATION]).T)
    of = np.concatenate([by_motion.reshape(-1, 6, 15), turn.transpose(0, 2, 1)], axis=1)
    rows = after_step(step.rows["imu"].take(np.searchsorted(graph.sampled, at)), step.keyframes, step.constants)
    left, residual = posterior_covariance(of @ rows.jacobian(), at, covariances), rows.residual
    weighed = np.einsum("nri,ni->nr", of, residual)
    moved, turned = weighed[:, :6].reshape(-1, 2, 3), weighed[:, 6:] / (density[1] * math.sqrt(T))[:, None]
    V = density[0][:, None, None] ** 2 * np.array([[T**3 / 3.0, T**2 / 2.0], [T**2 / 2.0, T]])
    expected = np.einsum("nab,naim,nbjm->nij", V, by_motion, by_motion)
    expected -= np.einsum("nab,naibj->nij", V, left[:, :6, :6].reshape(-1, 2, 3, 2, 3))
    of_turn = np.eye(3) - left[:, 6:, 6:] / (density[1] ** 2 * T)[:, None, None]
    squares = np.einsum("nab,nai,nbj->nij", V, moved, moved)
    return SampleComponent.of(squares, expected), SampleComponent.of(turned[:, :, None] * turned[:, None, :], of_turn)


@dataclass(frozen=True, eq=False)
class Components:
    """Components of each source of noise; chosen: the intervals of force and rate."""

    force: SampleComponent
    rate: SampleComponent
    position: RowComponent
    velocity: RowComponent
    chosen: IntArray


def components_of(graph: Graph, step: Step, covariances: Covariances, binned: BinnedImu) -> Components:
    """Residuals while the kart drives: at rest there is no vibration, and receivers may hold position and speed."""
    driven = np.ones(len(binned.missing), dtype=np.bool_)
    driven[graph.measured.still] = False
    if np.count_nonzero(driven) < FEWEST_DRIVEN:
        driven[:] = True
    good = np.flatnonzero(driven & (binned.missing == 0.0))
    at = good[:: max(1, len(good) // ENOUGH)]
    accel, gyro = (values[at] for values in shared_densities(binned, graph.noise.inertial))
    force, rate = sample_components(graph, step, covariances, at, (accel, gyro))
    position, velocity = (
        RowComponent.of(step.rows[name], step, covariances).only(driven[step.rows[name].interval])
        for name in ("gps_position", "gps_velocity")
    )
    return Components(force, rate, position, velocity, at)


def update_noise(
    graph: Graph,
    step: Step,
    covariances: Covariances,
    binned: BinnedImu,
    scatter: Scatter,
    usual: Noise,
    stated: set[str],
) -> tuple[Noise, Components]:
    """Return the noise one step on, and its components.

    usual: noise before any residual. stated: names of densities that the settings state (accel_noise, gyro_noise),
    which are kept.
    """
    noise, now = graph.noise, graph.noise.inertial
    found = components_of(graph, step, covariances, binned)
    position = _row_sigma(found.position, noise.position, USUAL_POSITION, POSITION_COUNT, LARGEST_SQUARE)
    velocity = _row_sigma(found.velocity, noise.velocity, USUAL_VELOCITY, UPWARDS_COUNT)
    accel = _density(found.force, now.accel, scatter.accel)
    every = _velocity_interval(step.rows["gps_velocity"])
    if every is not None:
        velocity[:2], accel = _velocity_and_force(found, noise, scatter, every, "accel_noise" not in stated)
    rough = None if binned.rough is None else binned.rough[found.chosen]
    inertial = replace(now, accel=accel, gyro=_density(found.rate, now.gyro, scatter.gyro))
    inertial = _spread_out(inertial, found, rough)
    inertial = replace(inertial, **{_FIELDS[name]: getattr(usual.inertial, _FIELDS[name]) for name in stated})
    better = replace(
        noise,
        inertial=inertial,
        position=np.maximum(position, SMALLEST_POSITION),
        velocity=np.maximum(velocity, SMALLEST_VELOCITY),
        offset_sigma=_offset_sigma(step, covariances, noise),
        constants={
            name: _scale_sigma(name, sigma, step, covariances) if name in step.unknown else sigma
            for name, sigma in noise.constants.items()
        },
        sigmas=_sigmas_of_factors(graph, step, covariances),
    )
    return better, found


_FIELDS = {"accel_noise": "accel", "gyro_noise": "gyro"}


def _ratio(squares: float, expected: float, count: float, usual: float = 1.0, most: float = MOST_STEP) -> float:
    """Ratio of a sigma to the one it was given; `usual`, in parts of that, counts as `count` residuals."""
    ratio = math.sqrt((squares + count * usual**2) / (max(expected, 0.0) + count))
    return float(np.clip(ratio, 1.0 / most, most))


def _density(component: SampleComponent, density: float, scatter: float) -> float:
    squares, expected = float(np.sum(component.squares_of)), float(np.sum(component.redundancy_of))
    ratio = _ratio(squares, expected, SCATTER_COUNT, scatter / density) ** HASTE
    return max(density * float(np.clip(ratio, 1.0 / 2.5, 2.5)), OWN_SCATTER * scatter)


def _row_sigma(component: RowComponent, sigma: Array, usual: Array, count: float, largest: float = math.inf) -> Array:
    """Sigma (3,) per axis, horizontal ones in common. largest: bound of a square over its expectation, whose effect on
    Gaussian noise is compensated (Huber 1981, 5.2)."""
    out = sigma.copy()
    for axes in ([0, 1], [2]):
        squares, expected = component.squares[:, axes].sum(axis=1), component.expected[:, axes].sum(axis=1)
        if np.any(expected > 0.0):
            if math.isfinite(largest):
                squares = np.minimum(squares, largest * expected) / _bounded_mean(len(axes), largest)
            first = axes[0]
            ratio = _ratio(float(np.sum(squares)), float(np.sum(expected)), count, usual[first] / sigma[first])
            out[axes] = sigma[first] * ratio
    return out


def _bounded_mean(n: int, largest: float) -> float:
    """Expected min(x, largest) of the mean square x of n standard normals, n 1 or 2: integrals of chi-squared."""
    if n == 2:
        return 1.0 - math.exp(-largest)
    inside, density = math.erf(math.sqrt(0.5 * largest)), math.exp(-0.5 * largest) / math.sqrt(2.0 * math.pi)
    return inside - 2.0 * math.sqrt(largest) * density + largest * (1.0 - inside)


def _velocity_interval(rows: Rows) -> float | None:
    """Mean time between velocities in intervals of keyframes; None without any."""
    known = rows.interval[np.isfinite(rows.sigma[:, 0])]
    return float(np.ptp(known)) / (len(known) - 1) if len(known) > 1 and np.ptp(known) > 0 else None


def _velocity_and_force(
    found: Components, noise: Noise, scatter: Scatter, every: float, together: bool
) -> tuple[float, float]:
    """Sigma of level velocities, m/s, and density of force by a step of Fisher scoring of both.

    Where samples are much noisier than velocities, these are fitted nearly exactly, and ratio by ratio would take
    dozens of turns. Velocities that measure a random walk leave, at angle theta of the spectrum, their noise and the
    walk's as 4 share sin^2(theta / 2) to 1, share being the variance of a velocity over that of the walk between two of
    them; the information on both variances is the mean of the products, in closed form. Two of the three directions of
    force are such a walk. every s: between velocities.
    """
    sigma, accel = float(noise.velocity[0]), noise.inertial.accel
    squares, expected = float(np.sum(found.velocity.squares[:, :2])), float(np.sum(found.velocity.expected[:, :2]))
    of_velocity = math.sqrt(max(squares, 1e-6) / max(expected, 1e-6))
    force = float(np.sum(found.force.squares_of)), float(np.sum(found.force.redundancy_of))
    of_force = _ratio(*force, SCATTER_COUNT, scatter.accel / accel, 10.0) if together else 1.0
    count = max(1.0, float(np.count_nonzero(found.velocity.expected[:, 0])))
    share = (sigma / accel) ** 2 / every
    walk = 1.0 / math.sqrt(1.0 + 4.0 * share)
    square = (1.0 + 2.0 * share) * walk**3
    both, own = walk - square, 1.0 - 2.0 * walk + square
    white = np.array([2.0 * (1.0 - walk), 2.0 * walk + 1.0])
    information = np.array([[2.0 * own, 2.0 * both], [2.0 * both, 2.0 * square + 1.0]])
    if not together:
        information[0, 1] = information[1, 0] = 0.0
    known = np.array([2.0 / (count * USUAL_SPREAD**2), 0.0])
    slope = white * 2.0 * np.log([of_velocity, of_force]) + known * 2.0 * math.log(USUAL_VELOCITY[0] / sigma)
    step = np.clip(np.linalg.solve(information + np.diag(known), slope), -0.8, 0.8)
    by_velocity, by_force = np.exp(0.5 * step).tolist()
    return sigma * by_velocity, max(accel * by_force, OWN_SCATTER * scatter.accel)


def _spread_out(noise: InertialNoise, found: Components, rough: Array | None) -> InertialNoise:
    """Spread the noise anew over directions and over vibration, rough (N, 2) of the chosen intervals."""
    accel, gyro = _shape(found.force, noise.accel_shape), _shape(found.rate, noise.gyro_shape)
    new = replace(noise, accel_shape=accel, gyro_shape=gyro)
    if rough is None:
        return new
    return replace(
        new,
        accel_share=_share(found.force, rough[:, 0], noise.accel_share),
        gyro_share=_share(found.rate, rough[:, 1], noise.gyro_share),
    )


def _shape(component: SampleComponent, shape: Shape) -> Shape:
    """Shape of the noise over directions; SHAPE_COUNT residuals in each say that it is round."""
    root = np.linalg.cholesky(np.array(shape))
    white = np.linalg.inv(root)
    squares = component.squares_in + SHAPE_COUNT * white @ white.T
    redundancy, axes = np.linalg.eigh(component.redundancy_in)
    to_one = (axes / np.sqrt(np.maximum(redundancy, 0.0) + SHAPE_COUNT)) @ axes.T
    variance, axes = np.linalg.eigh(root @ to_one @ squares @ to_one @ root.T)
    covariance = (axes * np.maximum(variance, FLATTEST * variance[-1])) @ axes.T
    a, b, c = (covariance * (3.0 / np.trace(covariance))).tolist()
    return tuple(a), tuple(b), tuple(c)


def _share(component: SampleComponent, rough: Array, share: float) -> float:
    """Share of the variance that goes with vibration: a line through variances over roughness (N,)."""
    level = 1.0 + share * (rough - 1.0)
    design = np.stack([np.ones_like(rough), rough], axis=1) / level[:, None]
    normal = (design * np.maximum(component.redundancy_of, 0.0)[:, None]).T @ design
    right = design.T @ component.squares_of
    prior = np.array([[1.0, 0.0], [1.0, 2.0]])  # no vibration and twice the mean are equally noisy
    normal += 0.5 * SHARE_COUNT * prior.T @ prior
    right += 0.5 * SHARE_COUNT * prior.sum(axis=0)
    constant, slope = np.linalg.solve(normal, right)
    return float(np.clip(slope / max(constant + slope, 1e-9), 0.0, LARGEST_SHARE))


def _sigmas_of_factors(graph: Graph, step: Step, covariances: Covariances) -> dict[str, float]:
    """Sigmas of the rows of factors that have a usual one, by their residuals."""
    out = {}
    for factor in graph.table:
        if factor.usual is not None and factor.name in step.rows:
            sigma = graph.noise.sigmas.get(factor.name, factor.usual)
            component = RowComponent.of(step.rows[factor.name], step, covariances)
            squares, expected = float(np.sum(component.squares)), float(np.sum(component.expected))
            out[factor.name] = sigma * _ratio(squares, expected, ROWS_COUNT, factor.usual / sigma)
    return out


def _offset_sigma(step: Step, covariances: Covariances, noise: Noise) -> Array:
    squares, expected = np.zeros(3), np.zeros(3)
    for name in ("gps_offset_start", "gps_offset"):
        component = RowComponent.of(step.rows[name], step, covariances)
        squares += component.squares.sum(axis=0)
        expected += component.expected.sum(axis=0)
    squares[:2], expected[:2] = squares[:2].mean(), expected[:2].mean()
    ratio = np.array([_ratio(s, e, OFFSET_COUNT) for s, e in zip(squares.tolist(), expected.tolist(), strict=True)])
    if np.mean(np.isfinite(step.rows["gps_position"].sigma[:, 2])) < 0.5:
        ratio[2] = 1.0
    return np.asarray(noise.offset_sigma * ratio)


def slip_sigma(step: Step, covariances: Covariances, sigma: float) -> float:
    """Sigma of the slip's process, halfway (geometric mean) from `sigma` to that of the residuals.

    Its start and its steps share their variance with bumps.
    """
    squares, expected = 0.0, 0.0
    of_step = 1.0 - math.exp(-2.0 * step.state.interval / SLIP_TIME)
    for name, own in (("slip_start", sigma**2), ("slip", of_step * sigma**2)):
        rows = step.rows.get(name)
        if rows is not None:
            component, share = RowComponent.of(rows, step, covariances), own / rows.sigma**2
            squares += float(np.sum(share * component.squares))
            expected += float(np.sum(share * component.expected))
    ratio = _ratio(squares, expected, SLIP_COUNT, USUAL_SLIP / sigma, 2.5)
    return float(sigma * math.sqrt(ratio))


def _scale_sigma(name: str, sigma: Array, step: Step, covariances: Covariances) -> Array:
    """Spread of the entries of a constant of the sensors, which are drawn from one."""
    columns = COLUMNS[name]
    value = step.state.constants[name] + step.constants[columns]
    squares = float(np.sum((value / sigma) ** 2))
    expected = float(np.sum(1.0 - np.diag(covariances.constants)[columns] / sigma**2))
    return np.asarray(np.clip(sigma * _ratio(squares, expected, 1.0), LEAST_SCALE, LARGEST_SCALE))
