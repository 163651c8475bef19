"""Batch solution of the graph: Gauss-Newton with robust weights, and the noise of the session estimated on the way.

GTSAM preintegrates the inertial samples; increments.py and rows.py linearise; chain.py solves the whole chain and
returns the covariance of every keyframe in the same sweep.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces
from smoother.estimate.graph import rows as rw
from smoother.estimate.graph.chain import ChainSolution, ChainSystem, solve_chain
from smoother.estimate.graph.expected import DopplerNoise, expected_motion
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.imu import (
    BinnedImu,
    DensePath,
    InertialNoise,
    Shape,
    corrected,
    dense_path,
    interval_noise,
)
from smoother.estimate.graph.inertial import (
    InertialGraph,
    LinearInertial,
    VarianceComponent,
    add_inertial,
    empty_system,
    inertial_components,
)
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    ACCEL_ERROR,
    CONSTANTS_SIZE,
    GYRO_BIAS,
    GYRO_ERROR,
    LEVER_ARM,
    POSITION_LATENCY,
    RECTIFICATION,
    ROTATION,
    ROW_CONSTANTS_SIZE,
    TRANSLATION,
    VELOCITY,
    VELOCITY_LATENCY,
    ChainState,
)

ROBUST_LIMIT = 3.0  # residuals beyond this many sigmas lose weight as (limit / distance)^2: redescending
CONVERGED = ((ROTATION, 5e-4), (TRANSLATION, 5e-3), (VELOCITY, 5e-3))  # rad, m, m/s: far below any sigma
SENSOR_ERRORS = (ACCEL_ERROR, GYRO_ERROR, RECTIFICATION)
# bounds of scale and misalignment, of which the data sheet allows 3 % at the worst, and of rectification, m/s^2
SENSOR_ERROR = (np.array([1e-3, 1e-3, 1e-2]), np.array([1.5e-2, 1.5e-2, 1.0]))
SMALLEST_POSITION = 0.02  # m; a digit of latitude is worth about this
SMALLEST_VELOCITY = 0.02  # m/s, likewise of speed and course
UNFILTERED = 1.0  # m of white noise, more than any filtered fix shows
HASTE = 1.4  # power of a step's ratio; single steps approach the fixed point from one side, more slowly than needed
OWN_SCATTER = 0.3  # of the scatter between bins: the noise that moves the path is not far below what is seen
ENOUGH_INTERVALS = 1000  # spread evenly; from three components of each a density is known to 2 %
SHAPE_COUNT = 20.0  # residuals in each direction that say that noise is the same in all of them
FLATTEST = 0.02  # of the largest variance: the least that any direction has
SHARE_COUNT = 10.0  # residuals that say that noise does not depend on vibration
LARGEST_SHARE = 0.95  # something is left where nothing shakes
SCATTER_COUNT = 10.0  # residuals; a minute of driving with Doppler tells more
# Squared residual of a fix over what is expected of it, beyond which more does not say how much fixes scatter, but that
# this one was off. On real karts the median is 0.4-0.65 of a Gaussian one's, and the last hundredth up to 1.7.
LARGEST_SQUARE = 1.0
USUAL_POSITION_COUNT = 1.0  # residuals; receivers show a fifth to a half of USUAL_POSITION, others more
USUAL_VELOCITY_COUNT = 20.0  # Doppler differs by less
HELD = 1e-4  # m; what is held does not move by a digit
TOGETHER = 256  # rows whose covariances are worked on together
# m that one fix scatters against the next. Receivers filter: four walked beside RTK and two on karts show 0.01-0.03,
# and all else of the 0.2-0.5 m that is faster than 20 s goes on from fix to fix. Others may not.
USUAL_POSITION = np.array([0.05, 0.05, 0.1])
USUAL_VELOCITY = np.array([0.15, 0.15, 0.3])  # m/s; Doppler of the same
STILL_SPEED = 0.02  # m/s; a chassis on its tyres with the engine idling
STILL_TURN = 3e-4  # rad between keyframes, likewise


@dataclass(frozen=True, eq=False)
class Noise:
    """Everything the graph assumes about noise. Sigmas per axis of n (3,): m for positions, m/s for velocities.

    offset_sigma (3,) m and offset_tau s describe the Gauss-Markov error of the fixes; sensor_error (3,) is the spread
    of the entries of accel_error and gyro_error, scale and misalignment, and of rectification, m/s^2.
    offset_tau_spread is the sigma of offset_tau's logarithm where the session tells it, infinite where it is the
    population's.
    """

    inertial: InertialNoise
    position: Array
    velocity: Array
    offset_sigma: Array
    offset_tau: float
    sensor_error: Array
    offset_tau_spread: float = math.inf

    def change(self, other: "Noise") -> float:
        """Largest relative difference of any sigma or density to those of `other`."""
        return float(np.max(np.abs(np.log(self._levels() / other._levels()))))

    def _levels(self) -> Array:
        densities = [self.inertial.accel, self.inertial.gyro, *self.inertial.calm]
        return np.concatenate([densities, self.position, self.velocity, self.offset_sigma])


@dataclass(frozen=True)
class Scatter:
    """Densities that the scatter of neighbouring inertial samples shows: what estimates lean on and are bounded by."""

    accel: float
    gyro: float


@dataclass(frozen=True, eq=False)
class Priors:
    """What is known beforehand: sigmas of the biases, m/s^2 and rad/s, mean (3,) of the gyro's; constants (25,).

    holds_height: the lever arm's height stays at its mean. A kart leans by few degrees, and how far is hardly better
    known than that: a height fitted to it is drawn to zero and seems to be known.
    """

    accel_bias: float
    gyro_bias: float
    gyro_bias_mean: Array
    constants: Array
    constants_sigma: Array
    holds_height: bool = False


@dataclass(frozen=True, eq=False)
class Data:
    """Measurements on the IMU clock. t (N,) stamps of the fixes; position_n, velocity_n (N, 3), NaN where unknown.

    position_scale, velocity_scale (N,) multiply the session's sigmas; still (S,) intervals at rest.
    """

    t: Array
    position_n: Array
    velocity_n: Array
    position_scale: Array
    velocity_scale: Array
    still: np.ndarray
    heading: Heading | None = None


@dataclass(frozen=True, eq=False)
class Solved:
    """A linearised, solved graph at `state`: the state itself, its covariances and the rows they came from.

    Residuals of rows are those after the step, those of inertial before it: only some are asked for.
    """

    state: ChainState
    solution: ChainSolution
    inertial: LinearInertial
    rows: dict[str, rw.Rows]


class Batch:
    """One session's graph. Data and inertial bins are fixed; states and noise go in and come out."""

    def __init__(self, data: Data, binned: BinnedImu, priors: Priors) -> None:
        self._data = data
        self._binned = binned
        self._priors = priors

    def graph(self, state: ChainState, noise: Noise) -> InertialGraph:
        """Preintegrate the inertial samples about the mean biases and the sensor errors of `state`."""
        biases = state.accel_bias_s.mean(axis=0), state.gyro_bias_s.mean(axis=0)
        return InertialGraph(self.bins(state), noise.inertial, *biases, state.constants)

    def bins(self, state: ChainState) -> BinnedImu:
        """Inertial bins with the state's errors of scale and misalignment and rectified vibration taken out."""
        return corrected(self._binned, state.constants)

    def converge(self, graph: InertialGraph, state: ChainState, noise: Noise, iterations: int) -> ChainState:
        """Gauss-Newton from `state`, at most `iterations` steps, each shortened where the constants swing back."""
        before = np.zeros(CONSTANTS_SIZE)
        for _ in range(iterations):
            system, _, _ = self._linearize(graph, state, noise)
            step = solve_chain(system, with_covariance=False)
            share = swing_share(step.constants, before)
            before = share * step.constants
            state = state.retract(share * step.x, before)
            if converged(step.x):
                break
        return state

    def approach(
        self, graph: InertialGraph, state: ChainState, noise: Noise, near: float, iterations: int
    ) -> ChainState:
        """Gauss-Newton of the keyframes alone, the constants held, until no attitude moves by `near` rad.

        At most `iterations`. While attitudes are off by degrees, steps of the constants lead astray, and coming back
        takes more steps.
        """
        for _ in range(iterations):
            system, _, _ = self._linearize(graph, state, noise)
            step = solve_chain(_of_keyframes(system), with_covariance=False)
            state = state.retract(step.x, np.zeros(CONSTANTS_SIZE))
            if float(np.max(np.abs(step.x[:, ROTATION]))) < near:
                break
        return state

    def step(
        self,
        graph: InertialGraph,
        state: ChainState,
        noise: Noise,
        before: Array | None = None,
        held: Array | None = None,
    ) -> Solved:
        """One Gauss-Newton step with its covariance; residuals as :class:`Solved` says.

        before (25,) is the previous step of the constants: where they swing back the state goes only half the way.
        held (25, 25) is the covariance of constants that are to stay where they are.
        """
        system, inertial, rows = self._linearize(graph, state, noise)
        solution = solve_chain(system, held=held)
        share = 1.0 if before is None else swing_share(solution.constants, before)
        return Solved(
            state.retract(share * solution.x, share * solution.constants),
            solution,
            inertial,
            {name: rw.after_step(r, solution.x, solution.constants) for name, r in rows.items()},
        )

    def path(self, state: ChainState) -> DensePath:
        """Dense path through the keyframes of `state`."""
        return dense_path(
            self.bins(state), state.R_ns, state.position_n, state.velocity_n, state.accel_bias_s, state.gyro_bias_s
        )

    def _linearize(
        self, graph: InertialGraph, state: ChainState, noise: Noise
    ) -> tuple[ChainSystem, LinearInertial, dict[str, rw.Rows]]:
        inertial = graph.linearize(state, noise.inertial)
        rows = {r.name: r for r in self._rows(state, noise)}
        system = empty_system(len(state.t))
        add_inertial(system, inertial)
        rw.add_rows(system, list(rows.values()))
        prior = self._priors
        difference = state.constants.as_vector() - prior.constants
        rw.add_constants_prior(system, difference, constants_sigma(prior, noise))
        if prior.holds_height:
            up_s = state.constants.level_axes_s[2]
            system.corner[LEVER_ARM, LEVER_ARM] += np.outer(up_s, up_s) / HELD**2
        return system, inertial, rows

    def _rows(self, state: ChainState, noise: Noise) -> list[rw.Rows]:
        return session_rows(self._data, self._binned, self._priors, self.path(state), state, noise)


def _doppler(d: Data, noise: Noise) -> DopplerNoise | None:
    """What the session's velocities tell, None where there are none."""
    read = d.t[np.isfinite(d.velocity_n[:, 0])]
    return DopplerNoise(float(noise.velocity[0]), float(np.ptp(read)) / (len(read) - 1)) if len(read) > 1 else None


def session_rows(
    d: Data, binned: BinnedImu, prior: Priors, path: DensePath, state: ChainState, noise: Noise
) -> list[rw.Rows]:
    """Everything that is not inertial, linearised at `state`, whose dense path is `path`; fixes with robust weights."""
    felt = expected_motion(path, state.constants.level_axes_s, noise.inertial, _doppler(d, noise), state.interval)
    position = rw.position_rows(
        state, path, felt, d.t, d.position_n, d.position_scale[:, None] * noise.position, prior.constants[0]
    )
    velocity = rw.velocity_rows(state, path, felt, d.t, d.velocity_n, d.velocity_scale[:, None] * noise.velocity)
    out = [_robust(position), _robust(velocity), *rw.offset_rows(state, noise.offset_sigma, noise.offset_tau)]
    bias = np.concatenate([state.accel_bias_s[0], state.gyro_bias_s[0] - prior.gyro_bias_mean])
    sigma = np.repeat([prior.accel_bias, prior.gyro_bias], 3)
    out.append(rw.prior_row("bias_prior", bias, sigma, slice(ACCEL_BIAS.start, GYRO_BIAS.stop)))
    out.append(rw.prior_row("pose_prior", np.zeros(9), np.repeat([3.0, 1e4, 1e3], 3), slice(0, 9)))
    if len(d.still):
        out.append(rw.standstill_rows(state, d.still, STILL_SPEED, STILL_TURN))
    if d.heading is not None:
        out.append(rw.heading_rows(state, d.heading))
    return out


def converged(step: Array) -> bool:
    """Whether a step (K, 18) is too small to matter."""
    return all(float(np.max(np.abs(step[:, part]))) < limit for part, limit in CONVERGED)


def moved(solution: ChainSolution) -> float:
    """Root mean square of a step of attitude and velocity, each over its sigma."""
    sigma2 = np.einsum("kii->ki", solution.covariance)
    return max(math.sqrt(float(np.mean(solution.x[:, part] ** 2 / sigma2[:, part]))) for part in (ROTATION, VELOCITY))


def constants_moved(solution: ChainSolution) -> float:
    """Root mean square of a step of latencies and lever arm, each over its sigma."""
    part = slice(POSITION_LATENCY.start, LEVER_ARM.stop)
    sigma2 = np.diag(solution.constants_covariance)[part]
    return math.sqrt(float(np.mean(solution.constants[part] ** 2 / sigma2)))


def _of_keyframes(system: ChainSystem) -> ChainSystem:
    """Return the system without the constants: they stay where they are."""
    n_keyframes, n = system.rhs.shape
    none = np.empty((n_keyframes, n, 0))
    return replace(system, border=none, corner=np.empty((0, 0)), rhs_constants=np.empty(0))


def swing_share(step: Array, before: Array) -> float:
    """Share of a step to be gone: half, when the latencies turn back by nearly as much as they went before.

    With few fixes the inertial samples bend the error function enough for full steps to jump to and fro over the
    minimum.
    """
    latencies = slice(POSITION_LATENCY.start, VELOCITY_LATENCY.stop)
    back = -float(step[latencies] @ before[latencies])
    return 0.5 if back > 0.3 * float(before[latencies] @ before[latencies]) > 0.0 else 1.0


def constants_sigma(priors: Priors, noise: Noise) -> Array:
    """Prior sigma (25,) of all constants."""
    sigma = priors.constants_sigma.copy()
    for part, spread in zip(SENSOR_ERRORS, noise.sensor_error, strict=True):
        sigma[part] = spread
    return sigma


def _robust(rows: rw.Rows) -> rw.Rows:
    finite = np.isfinite(rows.sigma)
    squared = np.where(finite, (rows.residual / np.where(finite, rows.sigma, 1.0)) ** 2, 0.0)
    dimension = np.maximum(finite.sum(axis=1), 1)
    distance = np.sqrt(squared.sum(axis=1) / dimension * 2.0)  # as if of two components
    weight = np.minimum(1.0, (ROBUST_LIMIT / np.maximum(distance, 1e-9)) ** 2)
    return replace(rows, weight=weight)


def posterior_variance(rows: rw.Rows, solution: ChainSolution) -> Array:
    """Variance (N, r) that the solution leaves in the prediction of `rows`."""
    out = np.empty(rows.residual.shape)
    of_left, of_right = rw.used_columns(rows.left), rw.used_columns(rows.right)
    own = slice(0, ROW_CONSTANTS_SIZE)
    P, S, cross = solution.covariance, solution.constants_covariance[own, own], solution.constants_cross
    for part in pieces(len(out), TOGETHER):
        k, constants = rows.interval[part], rows.constants[part]
        left, right = rows.left[part, :, of_left], rows.right[part, :, of_right]
        by_left = left @ P[k, of_left, of_left]
        by_right = right @ P[k + 1, of_right, of_right] + 2.0 * (left @ solution.cross[k, of_left, of_right])
        by_constants = left @ cross[k, of_left, own] + right @ cross[k + 1, of_right, own]
        by_constants = 2.0 * by_constants + constants @ S
        out[part] = _dot(by_left, left) + _dot(by_right, right) + _dot(by_constants, constants)
    return out


def _dot(one: Array, two: Array) -> Array:
    return np.asarray(np.einsum("nri,nri->nr", one, two))


def update_noise(solved: Solved, noise: Noise, binned: BinnedImu, scatter: Scatter) -> Noise:
    """One step of variance component estimation: each variance becomes squared residuals over redundancy.

    Source: Foerstner 1979; the fixed point is the restricted maximum-likelihood estimate.
    """
    state, solution = solved.state, solved.solution
    now = noise.inertial
    good = binned.missing == 0.0
    if "standstill" in solved.rows:  # would say most about the noise, but of a box that neither engine nor road shakes
        good[solved.rows["standstill"].interval] = False
    some = np.zeros_like(good)
    some[np.flatnonzero(good)[:: max(1, np.count_nonzero(good) // ENOUGH_INTERVALS)]] = True
    density, shape = interval_noise(binned, now), (now.accel_shape, now.gyro_shape)
    force, rate = inertial_components(state, solved.inertial, solution, density, shape, some)
    new = replace(
        now,
        accel=_density(force, now.accel, scatter.accel),
        gyro=_density(rate, now.gyro, scatter.gyro),
        accel_shape=_shape(force, now.accel_shape),
        gyro_shape=_shape(rate, now.gyro_shape),
    )
    if binned.rough is not None:
        rough = binned.rough[some]
        new = replace(
            new,
            accel_share=_share(force, rough[:, 0], now.accel_share),
            gyro_share=_share(rate, rough[:, 1], now.gyro_share),
        )
    white = _row_sigma(
        solved.rows["gps_position"], solution, noise.position, USUAL_POSITION, USUAL_POSITION_COUNT, LARGEST_SQUARE
    )
    velocity = _row_sigma(solved.rows["gps_velocity"], solution, noise.velocity, USUAL_VELOCITY, USUAL_VELOCITY_COUNT)
    return replace(
        noise,
        inertial=new,
        position=np.maximum(white, SMALLEST_POSITION),
        velocity=np.maximum(velocity, SMALLEST_VELOCITY),
        offset_sigma=noise.offset_sigma * _offset_ratio(solved),
        sensor_error=np.clip(noise.sensor_error * _error_ratio(solved, noise), *SENSOR_ERROR),
    )


def unseen_offset(noise: Noise, population: Array) -> Array:
    """Variance (3,) m^2 of the GPS offset beyond what the session shows, to be added to absolute positions.

    A receiver with little white noise has filtered its fixes. They wander slowly, by more than a drive can show, since
    neither integrated Doppler nor the inertial samples are judges of minutes: what is seen is a lower bound, and the
    population (3,) m says the rest. With white noise beyond a metre the fixes are not filtered, and the data may find
    that there is no offset at all. A session that lasts for many times the time over which its offset is forgotten is
    its own judge.
    """
    if noise.position[0] > UNFILTERED or math.isfinite(noise.offset_tau_spread):
        return np.zeros(3)
    return np.maximum(population**2 - noise.offset_sigma**2, 0.0)


def _density(component: VarianceComponent, density: float, scatter: float) -> float:
    """Density estimated from residuals that were given `density`.

    The scatter of the samples counts as much as SCATTER_COUNT residuals: where fixes alone would have to judge good
    samples, they can not, and the estimate would wander off.
    """
    squares = component.squares + SCATTER_COUNT * (scatter / density) ** 2
    ratio = math.sqrt(squares / (max(component.redundancy, 0.0) + SCATTER_COUNT)) ** HASTE
    return max(density * float(np.clip(ratio, 1.0 / 2.5, 2.5)), OWN_SCATTER * scatter)


def _shape(component: VarianceComponent, shape: Shape) -> Shape:
    """Shape of the noise from residuals that were given `shape`; SHAPE_COUNT residuals in each direction say round.

    The matrix that takes what was expected of the residuals to what they are, in the axes in which `shape` is round.
    """
    root = np.linalg.cholesky(np.array(shape))
    white = np.linalg.inv(root)
    squares = component.squares_in + SHAPE_COUNT * white @ white.T
    redundancy, axes = np.linalg.eigh(component.redundancy_in)
    to_one = (axes / np.sqrt(np.maximum(redundancy, 0.0) + SHAPE_COUNT)) @ axes.T
    found = root @ to_one @ squares @ to_one @ root.T
    variance, axes = np.linalg.eigh(found)
    found = (axes * np.maximum(variance, FLATTEST * variance[-1])) @ axes.T
    a, b, c = (found * (3.0 / np.trace(found))).tolist()
    return tuple(a), tuple(b), tuple(c)


def _share(component: VarianceComponent, rough: Array, share: float) -> float:
    """Share of the variance that goes with vibration, from residuals of intervals of roughness (N,) given `share`.

    Variances are fitted by a line over the roughness, each with the weight of its own variance: variance components.
    Source: Foerstner 1979.
    """
    level = 1.0 + share * (rough - 1.0)
    design = np.stack([np.ones_like(rough), rough], axis=1) / level[:, None]
    normal = (design * np.maximum(component.redundancy_of, 0.0)[:, None]).T @ design
    right = design.T @ component.squares_of
    prior = np.array([[1.0, 0.0], [1.0, 2.0]])  # no vibration and twice the mean are equally noisy
    normal += 0.5 * SHARE_COUNT * prior.T @ prior
    right += 0.5 * SHARE_COUNT * prior.sum(axis=0)
    constant, slope = np.linalg.solve(normal, right)
    return float(np.clip(slope / max(constant + slope, 1e-9), 0.0, LARGEST_SHARE))


def _row_sigma(
    rows: rw.Rows, solution: ChainSolution, sigma: Array, usual: Array, count: float, largest: float = math.inf
) -> Array:
    """Sigma (3,) per axis, horizontal ones in common, estimated from rows that were given `sigma`.

    What is usual for receivers, (3,), counts as much as `count` residuals, lest a handful of fixes look perfect.
    largest: bound of a row's squared residual over what is expected of it; what Gaussian noise itself loses by that is
    put back. Source: Huber 1981, 5.2 (scale, Proposal 2).
    """
    information = rows.information
    left = rows.weight[:, None] - posterior_variance(rows, solution) * information
    known = information > 0.0
    out = sigma.copy()
    for group in ([0, 1], [2]):
        use = np.flatnonzero(np.any(known[:, group], axis=1))
        if use.size:
            squares = np.sum((rows.residual[use] ** 2 * information[use])[:, group], axis=1)
            expected = np.sum(np.where(known[use], np.maximum(left[use], 0.0), 0.0)[:, group], axis=1)
            if math.isfinite(largest):
                squares = np.minimum(squares, largest * expected) / bounded_mean(len(group), largest)
            first = group[0]
            found = sigma[first] ** 2 * float(np.sum(squares))
            variance = (found + count * usual[first] ** 2) / (float(np.sum(expected)) + count)
            out[group] = np.clip(np.sqrt(variance), sigma[first] / 3.0, 3.0 * sigma[first])
    return out


def bounded_mean(n: int, largest: float) -> float:
    """Expected value of min(x, largest), x the mean square of n standard normals; n is 1 or 2.

    Source: integrals of the chi-squared density of one and of two degrees of freedom.
    """
    if n == 2:
        return 1.0 - math.exp(-largest)
    inside, density = math.erf(math.sqrt(0.5 * largest)), math.exp(-0.5 * largest) / math.sqrt(2.0 * math.pi)
    return inside - 2.0 * math.sqrt(largest) * density + largest * (1.0 - inside)


def _offset_ratio(solved: Solved) -> Array:
    """Ratio (3,) for the sigma of the GPS offset: few of its steps stand out of the white noise, so it moves slowly."""
    start, steps = solved.rows["gps_offset_start"], solved.rows["gps_offset"]
    chi2, redundancy = np.zeros(3), np.zeros(3)
    for rows in (start, steps):
        chi2 += np.sum(rows.residual**2 * rows.information, axis=0)
        redundancy += np.sum(1.0 - posterior_variance(rows, solved.solution) * rows.information, axis=0)
    chi2[:2], redundancy[:2] = chi2[:2].mean(), redundancy[:2].mean()
    return np.clip(np.sqrt((chi2 + 1.0) / (np.maximum(redundancy, 0.0) + 1.0)), 1.0 / 3.0, 3.0)


def _error_ratio(solved: Solved, noise: Noise) -> Array:
    """Ratio (3,) for the spread of scale and misalignment, six values of force and three of rate; of rectification."""
    out = []
    for part, sigma in zip(SENSOR_ERRORS, noise.sensor_error, strict=True):
        chi2 = float(np.sum((solved.state.constants.as_vector()[part] / sigma) ** 2))
        redundancy = (
            part.stop - part.start - float(np.trace(solved.solution.constants_covariance[part, part])) / sigma**2
        )
        out.append(np.clip(np.sqrt((chi2 + 1.0) / (max(redundancy, 0.0) + 1.0)), 1.0 / 3.0, 3.0))
    return np.array(out)
