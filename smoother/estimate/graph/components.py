"""The noise of a session from its residuals: variance components, one step towards the restricted likelihood's maximum.

Each source of noise answers for a part of the squared residuals, of which a certain number is expected: the ratio says
by how much it was taken too small or too large. Two that the residuals hardly tell apart are brought there together.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.estimate.gnss_offset import OffsetModel, unseen_variance
from smoother.estimate.graph.batch import Solved
from smoother.estimate.graph.expected import DopplerNoise
from smoother.estimate.graph.imu import BinnedImu
from smoother.estimate.graph.inertial import VarianceComponent, inertial_components
from smoother.estimate.graph.inertial_noise import InertialNoise, LocalLevel, Shape, interval_noise
from smoother.estimate.graph.inputs import SENSOR_ERRORS, Noise
from smoother.estimate.graph.response import PassedNoise, passed_noise
from smoother.estimate.graph.row_components import RowComponent, posterior_variance
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.slip import FIRST, SLIP_COUNT, SlipNoise, remembered
from smoother.estimate.graph.state import ACCEL_BIAS, EVENNESS, GYRO_BIAS, VELOCITY_RESPONSE
from smoother.estimate.graph.told import told_by
from smoother.fit.running import running_mean

# bounds of scale and misalignment, of which the data sheet allows 3 % at the worst, and of rectification, m/s^2
SENSOR_ERROR = (np.array([1e-3, 1e-3, 1e-2]), np.array([1.5e-2, 1.5e-2, 1.0]))
SMALLEST_POSITION = 0.02  # m; a digit of latitude is worth about this
SMALLEST_VELOCITY = 0.02  # m/s, likewise of speed and course
# m that one fix scatters against the next. Receivers filter: four walked beside RTK and two on karts show 0.01-0.03,
# and all else of the 0.2-0.5 m that is faster than 20 s goes on from fix to fix. Others may not.
USUAL_POSITION = np.array([0.05, 0.05, 0.1])
USUAL_VELOCITY = np.array([0.15, 0.15, 0.3])  # m/s; Doppler of the same
USUAL_POSITION_COUNT = 1.0  # residuals; receivers show a fifth to a half of USUAL_POSITION, others more
USUAL_VELOCITY_COUNT = 20.0  # upwards; few receivers report it
USUAL_SPREAD = 1.4  # of the logarithm of a variance: receivers show a third to twice of USUAL_VELOCITY
MOST_SCORED = 0.8  # of the logarithm of a variance, in a step
SCORED_FROM = 1e-6  # residuals; with fewer the logarithm of their ratio is none
HASTE = 1.4  # power of a step's ratio; single steps approach the fixed point from one side, more slowly than needed
OWN_SCATTER = 0.3  # of the scatter between bins: the noise that moves the path is not far below what is seen
SCATTER_COUNT = 10.0  # residuals; a minute of driving with Doppler tells more
FEWEST_DRIVEN = 25  # intervals, that tell more of noise than all those at rest
ENOUGH_INTERVALS = 1000  # spread evenly; from three components of each a density is known to 2 %
SHAPE_COUNT = 20.0  # residuals in each direction that say that noise is the same in all of them
FLATTEST = 0.02  # of the largest variance: the least that any direction has
SHARE_COUNT = 10.0  # residuals that say that noise does not depend on vibration
LARGEST_SHARE = 0.95  # something is left where nothing shakes
# Squared residual of a fix over what is expected of it, beyond which more does not say how much fixes scatter, but that
# this one was off. On real karts the median is 0.4-0.65 of a Gaussian one's, and the last hundredth up to 1.7.
LARGEST_SQUARE = 1.0
# Logarithm of a step of the heights' white noise, beyond which their wander waits: beside ten times too much of it they
# do not seem to wander, and come back from that by some per cent in a turn
NEAR_WHITE = 0.25
MOST_HEIGHTS = 0.5  # share of the fixes that have one, from which on they tell how it wanders
LOCAL = 2.0  # s of residuals that tell how noisy force is in their midst
LOCAL_EVERY = 0.4  # s from one interval that tells it to the next
LOCAL_COUNT = 10.0  # residuals, of about 6 to an interval, that say that it is as everywhere
LOCAL_BOUNDS = 0.25, 4.0  # of the variance
WALK_COUNT = 2.0  # residuals that say that biases walk as those of such sensors do


@dataclass(frozen=True)
class Scatter:
    """Densities that the scatter of neighbouring inertial samples shows: what estimates lean on and are bounded by."""

    accel: float
    gyro: float


def update_noise(
    solved: Solved,
    noise: Noise,
    binned: BinnedImu,
    scatter: Scatter,
    doppler: DopplerNoise | None = None,
    *,
    force_is_stated: bool = False,
    by_place: bool = False,
) -> Noise:
    """One step of variance component estimation: each variance becomes squared residuals over redundancy.

    doppler: of the velocities, None where there are none; their noise and the force's density are brought to their
    places together, or their noise alone where that density is stated. by_place: also where force is noisier than
    elsewhere (:func:`local_level`).
    Source: Foerstner 1979; the fixed point is the restricted maximum-likelihood estimate.
    """
    state, solution = solved.state, solved.solution
    now = noise.inertial
    driven = _driven(solved, binned.missing.size)
    good = (binned.missing == 0.0) & driven
    some = np.zeros_like(good)
    every = max(1, np.count_nonzero(good) // ENOUGH_INTERVALS)
    if by_place:
        every = min(every, max(1, round(LOCAL_EVERY / state.interval)))
    some[np.flatnonzero(good)[::every]] = True
    density, shape = interval_noise(binned, now), (now.accel_shape, now.gyro_shape)
    force, rate = inertial_components(state, solved.inertial, solution, density, shape, some)
    positions, velocities = (_component_of(solved, f"gps_{name}", driven) for name in ("position", "velocity"))
    white = _row_sigma(positions, noise.position, USUAL_POSITION, USUAL_POSITION_COUNT, LARGEST_SQUARE)
    velocity = _row_sigma(velocities, noise.velocity, USUAL_VELOCITY, USUAL_VELOCITY_COUNT)
    if doppler is None:
        accel = _density(force, now.accel, scatter.accel)
    else:
        together = not force_is_stated
        variance = np.diag(solution.constants_covariance)
        unsure = float(np.sqrt(variance[VELOCITY_RESPONSE][0])), float(np.sqrt(variance[EVENNESS][0]))
        passed = passed_noise(state.constants, unsure, doppler.every)
        if passed is not None:
            velocities = _of_means(velocities, solved.rows["gps_velocity"], passed.several)
        velocity[:2], accel = _velocity_and_force(velocities, force, noise, scatter, doppler, passed, together=together)
    gyro = _density(rate, now.gyro, scatter.gyro)
    rough = None if binned.rough is None else binned.rough[some]
    inertial = _spread_out(replace(now, accel=accel, gyro=gyro), force, rate, rough)
    return replace(
        noise,
        told=told_by(solved, noise, (force, rate), (positions, velocities)),
        inertial=replace(inertial, local=local_level(force, some, binned.t, now)) if by_place else inertial,
        position=np.maximum(white, SMALLEST_POSITION),
        velocity=np.maximum(velocity, SMALLEST_VELOCITY),
        offset_sigma=np.minimum(noise.offset_sigma * _offset_ratio(solved, white, noise), noise.offset_most),
        sensor_error=np.clip(noise.sensor_error * _error_ratio(solved, noise), *SENSOR_ERROR),
    )


def local_level(force: VarianceComponent, chosen: BoolArray, t: Array, noise: InertialNoise) -> LocalLevel:
    """Return how much noisier force is here and there, by :func:`local_ratio` of the residuals of driving.

    A bumpy stretch, kerbs and slides put samples farther off the motion than the vibration in them says. force: of the
    intervals chosen (K-1,) between keyframes at t (K,) s, given `noise`.
    """
    squares, redundancy, middle = np.zeros(len(chosen)), np.zeros(len(chosen)), 0.5 * (t[1:] + t[:-1])
    squares[chosen], redundancy[chosen] = force.squares_of, np.maximum(force.redundancy_of, 0.0)
    if noise.local is not None:  # what they were given
        squares *= noise.local.at(middle)
    return LocalLevel(middle, local_ratio(squares, redundancy, float(t[1] - t[0])))


def local_ratio(squares: Array, redundancy: Array, interval: float) -> Array:
    """Variance (K-1,) around each interval over that of all, from what each adds to squares and redundancy (K-1,).

    The squared residuals of LOCAL around it over what was expected of them; LOCAL_COUNT residuals say that it is as
    everywhere. interval s, between keyframes. Source: Foerstner 1979, of groups of the residuals.
    """
    around = np.ones(min(max(1, round(LOCAL / interval)), len(squares)))
    found, expected = (np.convolve(values, around, "same") for values in (squares, redundancy))
    return np.clip((found + LOCAL_COUNT) / (expected + LOCAL_COUNT), *LOCAL_BOUNDS)


def _driven(solved: Solved, n_intervals: int) -> BoolArray:
    """Mask (K-1,) of the intervals whose residuals say how noisy driving is; all where hardly any was driven.

    Standstills would say most about the noise, but of a box that neither engine nor road shakes, and of a receiver that
    may hold its last place and speed.
    """
    driven = np.ones(n_intervals, dtype=np.bool_)
    if "standstill" in solved.rows:
        driven[solved.rows["standstill"].interval] = False
    if np.count_nonzero(driven) < FEWEST_DRIVEN:
        driven[:] = True  # then there is nothing else that tells
    return driven


def _spread_out(
    noise: InertialNoise, force: VarianceComponent, rate: VarianceComponent, rough: Array | None
) -> InertialNoise:
    """The noise spread anew over directions, and over intervals of roughness (N, 2) where that is known."""
    new = replace(noise, accel_shape=_shape(force, noise.accel_shape), gyro_shape=_shape(rate, noise.gyro_shape))
    if rough is None:
        return new
    return replace(
        new,
        accel_share=_share(force, rough[:, 0], noise.accel_share),
        gyro_share=_share(rate, rough[:, 1], noise.gyro_share),
    )


def _component_of(solved: Solved, name: str, counts: BoolArray) -> RowComponent:
    """Of the rows `name`, those in the intervals that count (K-1,)."""
    rows = solved.rows[name]
    return RowComponent.of(rows, solved.solution).only(counts[rows.interval])


def unseen_offset(noise: Noise, population: Array, n_fixes: int, hidden: float = 0.0) -> Array:
    """Variance (3,) m^2 of the GPS offset beyond what the session shows, see :func:`unseen_variance`."""
    offset = OffsetModel(noise.offset_sigma, noise.offset_tau, noise.offset_tau_spread)
    return unseen_variance(offset, float(noise.position[0]), population, n_fixes, hidden)


def _of_means(component: RowComponent, rows: Rows, several: int) -> RowComponent:
    """The component with squares of the means of `several` level residuals in turn in place of those of each."""
    squares = component.squares.copy()
    squares[:, :2] = running_mean(np.copysign(np.sqrt(squares), rows.residual)[:, :2], several) ** 2
    return RowComponent(squares, component.expected)


def _density(component: VarianceComponent, density: float, scatter: float) -> float:
    """Density estimated from residuals that were given `density`."""
    ratio = _density_ratio(component, density, scatter) ** HASTE
    return max(density * float(np.clip(ratio, 1.0 / 2.5, 2.5)), OWN_SCATTER * scatter)


def _density_ratio(component: VarianceComponent, density: float, scatter: float) -> float:
    """Ratio of the density that residuals show to the one that they were given.

    The scatter of the samples counts as much as SCATTER_COUNT residuals: where fixes alone would have to judge good
    samples, they can not, and the estimate would wander off.
    """
    squares = component.squares + SCATTER_COUNT * (scatter / density) ** 2
    return math.sqrt(squares / (max(component.redundancy, 0.0) + SCATTER_COUNT))


def _velocity_and_force(
    velocities: RowComponent,
    force: VarianceComponent,
    noise: Noise,
    scatter: Scatter,
    doppler: DopplerNoise,
    passed: PassedNoise | None,
    *,
    together: bool,
) -> tuple[float, float]:
    """Sigma of level velocities, m/s, and density of force, m/s^2/sqrt(Hz), by a step of Fisher scoring.

    together: of both (:func:`scored`); without, force stays. passed: see there.
    """
    sigma, accel = float(noise.velocity[0]), noise.inertial.accel
    squares, expected = float(np.sum(velocities.squares[:, :2])), float(np.sum(velocities.expected[:, :2]))
    of_rows = math.sqrt(max(squares, SCORED_FROM) / max(expected, SCORED_FROM))
    ratio = np.array([of_rows, _density_ratio(force, accel, scatter.accel) if together else 1.0])
    count = max(1.0, float(np.count_nonzero(velocities.expected[:, 0])))
    share, usual = (sigma / accel) ** 2 / doppler.every, float(USUAL_VELOCITY[0]) / sigma
    of_velocity, of_force = scored(ratio, share, count, usual, passed, together=together)
    if together and accel * of_force < OWN_SCATTER * scatter.accel:  # it stays there: velocities must not count on more
        of_velocity, _ = scored(np.array([of_rows, 1.0]), share, count, usual, passed, together=False)
    return sigma * of_velocity, max(accel * of_force, OWN_SCATTER * scatter.accel)


def scored(
    ratio: Array, share: float, count: float, usual: float, passed: PassedNoise | None = None, *, together: bool = True
) -> tuple[float, float]:
    """Ratios by which the sigma of level velocities and the density of force are to change.

    ratio (2,): of each, what the residuals show to what they were given. share: variance of a velocity over that of the
    change from it to the next, as the samples tell it. count: of velocities, at least 1; usual: the sigma that
    receivers have over the one that was given, known up to USUAL_SPREAD. passed: by a receiver that filters; then the
    residuals of velocities are means of passed.several. together: both change; without, force stays.

    Where samples are much the noisier, velocities are fitted nearly exactly: some per cent of their noise is left in
    the residuals, and of what is too much in these, some per cent only are theirs. Ratio by ratio that takes dozens of
    turns. Velocities that measure a random walk leave, in the part of angle theta of the spectrum, their noise and the
    walk's as 4 share sin^2(theta/2) to 1; the information on both variances is the mean over theta of the products.
    Two of the three directions of force are such a walk, the third is left to itself.

    What is slow in the noise of a receiver that filters is as large as without its filter, and tells how much
    velocities are worth; what is quick is missing. Taken for white it would be a fifth of that behind a mean of five,
    and the force as noisy as the rest. So sigma is that of white noise before the filter, whose slow part shows in
    means of residuals: there filters of one response are alike, which in quick noise they are not.
    Source: Foerstner 1979; scoring: Harville 1977; the means are elementary integrals.
    """
    walk = 1.0 / math.sqrt(1.0 + 4.0 * share)  # mean part that is the walk's, and the mean of its square
    square = (1.0 + 2.0 * share) * walk**3
    both, own = walk - square, 1.0 - 2.0 * walk + square
    white = np.array([2.0 * (1.0 - walk), 2.0 * walk + 1.0])  # expected of both residuals, in halves of `count`
    information = np.array([[2.0 * own, 2.0 * both], [2.0 * both, 2.0 * square + 1.0]])
    expected = white
    if passed is not None:
        part, means = 1.0 / (1.0 + 4.0 * share * np.sin(0.5 * passed.angle) ** 2), passed.of_means()
        left = passed.power * (1.0 - part)
        information[:, 0] = 2.0 * np.mean(left * (1.0 - part) * means), 2.0 * np.mean(left * part)
        information[0, 1] = 2.0 * np.mean(part * (1.0 - part) * means)
        expected = information.sum(axis=1)
        ratio = ratio * np.sqrt(white / expected)
    if not together:
        information[0, 1] = information[1, 0] = 0.0
    known = np.array([2.0 / (count * USUAL_SPREAD**2), 0.0])  # in the same unit, half of `count`
    slope = expected * 2.0 * np.log(ratio) + known * 2.0 * math.log(usual)
    step = np.linalg.solve(information + np.diag(known), slope)
    of_velocity, of_force = np.exp(0.5 * np.clip(step, -MOST_SCORED, MOST_SCORED)).tolist()
    return of_velocity, of_force


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


def _row_sigma(component: RowComponent, sigma: Array, usual: Array, count: float, largest: float = math.inf) -> Array:
    """Sigma (3,) per axis, horizontal ones in common, estimated from rows that were given `sigma`.

    What is usual for receivers, (3,), counts as much as `count` residuals, lest a handful of fixes look perfect.
    largest: bound of a row's squared residual over what is expected of it; what Gaussian noise itself loses by that is
    put back. Source: Huber 1981, 5.2 (scale, Proposal 2).
    """
    out = sigma.copy()
    for group in ([0, 1], [2]):
        squares, expected = component.squares[:, group].sum(axis=1), component.expected[:, group].sum(axis=1)
        if np.any(expected > 0.0):
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


def _offset_ratio(solved: Solved, white: Array, noise: Noise) -> Array:
    """Ratio (3,) for the sigma of the GPS offset: few of its steps stand out of the white noise, so it moves slowly.

    That of heights waits until their noise, given in `noise`, is near `white` (3,) m, where it is going. That of level
    fixes does not: thinned real ones are then nearer to the path, and level velocities do not hang on it.
    """
    start, steps = solved.rows["gps_offset_start"], solved.rows["gps_offset"]
    chi2, redundancy = np.zeros(3), np.zeros(3)
    for rows in (start, steps):
        chi2 += np.sum(rows.residual**2 * rows.information, axis=0)
        redundancy += np.sum(1.0 - posterior_variance(rows, solved.solution) * rows.information, axis=0)
    chi2[:2], redundancy[:2] = chi2[:2].mean(), redundancy[:2].mean()
    ratio = np.clip(np.sqrt((chi2 + 1.0) / (np.maximum(redundancy, 0.0) + 1.0)), 1.0 / 3.0, 3.0)
    has_height = np.isfinite(solved.rows["gps_position"].sigma[:, 2])
    is_on_its_way = abs(math.log(max(float(white[2]), SMALLEST_POSITION) / float(noise.position[2]))) > NEAR_WHITE
    if is_on_its_way or np.mean(has_height) < MOST_HEIGHTS:  # level ground has none, and says nothing of the receiver's
        ratio[2] = 1.0
    return ratio


def bias_walks(solved: Solved, noise: InertialNoise, usual: InertialNoise, duration: Array) -> InertialNoise:
    """Return the noise with the walks of the biases one step on; WALK_COUNT residuals say that they are as `usual`.

    A sensor that warms up drifts by more than such sensors do on average. None is taken to walk by less: two modules in
    one car seem to, but lean apart by more than they say if that is believed. duration (K-1,) s: for which biases walk
    in each interval, with the pause that may be cut out of it.
    """
    solution, found = solved.solution, []
    of_biases = (ACCEL_BIAS, solved.state.accel_bias_s), (GYRO_BIAS, solved.state.gyro_bias_s)
    for (part, bias), walk, expected in zip(of_biases, noise.walks, usual.walks, strict=True):
        own, cross = (np.einsum("kii->ki", block)[:, part] for block in (solution.covariance, solution.cross))
        given = walk**2 * duration[:, None]
        squares = float(np.sum(np.diff(bias, axis=0) ** 2 / given))
        redundancy = float(np.sum(1.0 - (own[1:] + own[:-1] - 2.0 * cross) / given))
        ratio = (squares + WALK_COUNT * (expected / walk) ** 2) / (max(redundancy, 0.0) + WALK_COUNT)
        found.append(max(walk * float(np.clip(math.sqrt(ratio) ** HASTE, 1.0 / 3.0, 3.0)), expected))
    return replace(noise, accel_bias_walk=found[0], gyro_bias_walk=found[1])


def slip_update(solved: Solved, noise: SlipNoise) -> SlipNoise:
    """Return the slip's noise one step on, by its start and its steps, of which a part is not the process's."""
    sigma = noise.sigma
    squares, expected = SLIP_COUNT * (FIRST / sigma) ** 2, SLIP_COUNT
    step = 1.0 - remembered(solved.state.interval) ** 2
    for name, variance in (("slip_start", sigma**2), ("slip", step * sigma**2)):
        rows = solved.rows[name]
        component, share = RowComponent.of(rows, solved.solution), variance / rows.sigma**2
        squares += float(np.sum(share * component.squares))
        expected += float(np.sum(share * component.expected))
    ratio = float(np.clip(math.sqrt(squares / expected) ** HASTE, 1.0 / 2.5, 2.5))
    return replace(noise, sigma=max(noise.least, sigma * ratio), shown=max(expected - SLIP_COUNT, 0.0))


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
