"""Residuals of a solved graph: statistics of each kind of factor, and how well they determine the noise.

Rows have residuals in their own units. Those of the IMU factors, whose errors of rotation, position and velocity are
correlated, are whitened. For the uncertainty of the noise see `smoother.fit.noise_spread`."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.graph import TABLE
from smoother.estimate.factors.rows import Rows
from smoother.estimate.factors.wheels import SLIP_TIME, slip_of
from smoother.estimate.fixes.reported_noise import hidden_wander
from smoother.estimate.model.motion import LowPassedMotion
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import OFFSET
from smoother.estimate.solvers.identify import Solution
from smoother.estimate.solvers.variance_components import SLIP_COUNT, RowComponent, SampleComponent
from smoother.fit.noise_spread import Residuals, of_force, of_positions, of_rate, of_velocities
from smoother.trajectory import WHITENED, ResidualStatistics
from smoother.units import DEG

# sigma of the sigma of the sideslip: in parts of it, by how much corners differ, and rad. 90 simulated karts had 0.7 of
# that
SLIP_DIFFERS, SLIP_LATE = 0.5, 5e-3
ANY_SLIP = 2.0 * DEG  # prior of its variation from corner to corner
DIFFERENT = 12.0  # corners of a track
ROUND_IT, OUT_OF_IT = 0.6, 0.3  # of a hard corner's lateral acceleration, between which one corner becomes another
FIT_SIGMA = 1.0 * DEG  # of a keyframe's sideslip about its constants


@dataclass(frozen=True, eq=False)
class NoiseUncertainty:
    """Sigmas of the logarithms of densities of force and rate, and (3,) of the sigmas of position and velocity.

    wandered (3,) m^2: variance of the slow error of the fixes about a straight line between keyframes. hidden (3,) m:
    slow error that the noise may hide. slip rad: sigma of the sigma of the sideslip; wheels_heading rad^2: variance of
    the heading by errors of the slip that every lap repeats; None without wheels.
    """

    accel: float
    gyro: float
    position: Array
    velocity: Array
    wandered: Array
    hidden: Array
    slip: float | None = None
    wheels_heading: float | None = None


def noise_uncertainty(solution: Solution, slip_prior: Array) -> NoiseUncertainty:
    """Return how well the noise of a solution is known by its residuals; slip_prior (4,): sigmas of the constants."""
    found, noise, state = solution.components, solution.noise, solution.state
    if found is None:
        raise ValueError("the noise was given, not identified")
    rows, lasts = solution.step.rows["gps_position"], float(state.t[-1] - state.t[0])
    return NoiseUncertainty(
        of_force(_in_time(found.force), has_doppler=_have_doppler(found.position, found.velocity)),
        of_rate(_in_time(found.rate)),
        _per_axis(found.position, of_positions),
        _per_axis(found.velocity, of_velocities),
        _wandered(rows, noise, state.interval),
        hidden_wander(noise.position, noise.velocity, lasts / max(len(rows.residual), 1), lasts, noise.offset_tau),
        *_of_slip(solution, slip_prior),
    )


def _in_time(component: SampleComponent) -> Residuals:
    return Residuals(component.squares_of, component.redundancy_of, 3.0 * len(component.squares_of))


def _per_axis(component: RowComponent, spread: Callable[[Residuals], float]) -> Array:
    """Sigma (3,) of the logarithm of the sigma of rows per axis, horizontal ones in common."""
    level, up = (_of_axes(component, axes) for axes in (slice(0, 2), slice(2, 3)))
    return np.array([spread(level)] * 2 + [spread(up)])


def _of_axes(component: RowComponent, axes: slice) -> Residuals:
    squares, expected = component.squares[:, axes], component.expected[:, axes]
    return Residuals(squares.sum(axis=1), expected.sum(axis=1), float(np.count_nonzero(expected)))


def _have_doppler(positions: RowComponent, velocities: RowComponent) -> bool:
    """Whether most fixes have a velocity."""
    counts = (np.count_nonzero(component.expected[:, 0]) for component in (velocities, positions))
    return bool(next(counts) > 0.5 * next(counts))


def _wandered(positions: Rows, noise: Noise, interval: float) -> Array:
    """Variance (3,) m^2, in the mean over `positions`, of the slow error about the line from keyframe to keyframe.

    A Gauss-Markov process is a random walk over an `interval`, s, that is much shorter than its time: between both ends
    it is away from the line between them by walk * interval * share * (1 - share), share being the part gone by.
    Source: the bridge of a Wiener process.
    """
    between = np.mean(positions.left[:, 0, OFFSET.start] * positions.right[:, 0, OFFSET.start])
    return np.asarray(2.0 * noise.offset_sigma**2 / noise.offset_tau * interval * between)


def _of_slip(solution: Solution, prior: Array) -> tuple[float | None, float | None]:
    """Sigma, rad, of the sigma of the sideslip, and variance, rad^2, of the heading by its constants.

    Tyres are not linear: errors of the constants repeat lap after lap, so that laps are not independent. The difference
    of the heading by the mean of all slip and by its process is included.
    """
    sigma, rolls = solution.noise.slip, solution.graph.measured.rolls
    if sigma is None or rolls is None:
        return None, None
    k = np.flatnonzero(rolls)
    slip = slip_of(
        solution.state, LowPassedMotion(solution.state, solution.noise.inertial.accel, solution.noise.inertial.gyro)
    )
    by = slip.by_constants[k]
    shift = np.linalg.solve(by.T @ by + np.diag((FIT_SIGMA / prior) ** 2), by.T @ slip.value[k])[0]
    independent = len(k) * solution.state.interval / (2.0 * SLIP_TIME)
    different = min(DIFFERENT, independent, corners(by[:, 1] / by[:, 0]))
    information = different * by.T @ by / len(k) / sigma**2 + np.diag(prior**-2.0)
    guessed = SLIP_COUNT / (SLIP_COUNT + independent) * ANY_SLIP
    of_heading = float(np.linalg.inv(information)[0, 0] + shift**2)
    return math.hypot(SLIP_DIFFERS * sigma, SLIP_LATE, guessed), of_heading


def corners(lateral: Array) -> int:
    """Number of corners, by lateral accelerations (N,) m/s^2; a steady circle is one."""
    part = lateral / max(float(np.percentile(np.abs(lateral), 90)), 1e-9)
    turns = np.where(np.abs(part) > ROUND_IT, np.sign(part), 0.0)
    turns = turns[(turns != 0.0) | (np.abs(part) < OUT_OF_IT)]
    return max(1, int(np.count_nonzero((np.diff(turns, prepend=0.0) != 0.0) & (turns != 0.0))))


INERTIAL = {"inertial": slice(0, 9), "bias_walk": slice(9, 15)}  # rotation, position and velocity; biases
REJECTED_WEIGHT = 0.1  # a fix whose robust weight is below this counts as rejected


def row_statistics(rows: Mapping[str, Rows]) -> dict[str, ResidualStatistics]:
    """Return what is left of the kinds of rows that were measured, by their names."""
    return {name: _of_rows(rows[name], unit) for factor in TABLE for name, unit in factor.units.items() if name in rows}


def inertial_statistics(rows: Rows, intervals: slice) -> dict[str, ResidualStatistics]:
    """Return what is left of the IMU factors of some intervals, whitened rows of 15, by the names of INERTIAL."""
    first, end = intervals.start or 0, np.inf if intervals.stop is None else intervals.stop
    use = (rows.interval >= first) & (rows.interval < end)
    return {name: _whitened(rows.residual[use, part]) for name, part in INERTIAL.items()}


def joined(parts: Sequence[Mapping[str, ResidualStatistics]]) -> dict[str, ResidualStatistics]:
    """Return what is left of the IMU factors of several parts of a session."""
    out = {}
    for name in INERTIAL:
        own = [part[name] for part in parts if name in part]
        counts = np.array([one.count for one in own])
        if counts.sum():
            mean = float(np.average([one.mean for one in own], weights=counts))
            rms = float(np.sqrt(np.average([one.rms**2 for one in own], weights=counts)))
            out[name] = ResidualStatistics(WHITENED, int(counts.sum()), mean, rms, rms, 0)
    return out


def _whitened(residual: Array) -> ResidualStatistics:
    """Of residuals (n, r) in sigmas; none of them is rejected."""
    if residual.size == 0:
        return ResidualStatistics(WHITENED, 0, 0.0, 0.0, 0.0, 0)
    rms = float(np.sqrt(np.mean(residual**2)))
    return ResidualStatistics(WHITENED, len(residual), float(np.mean(residual)), rms, rms, 0)


def _of_rows(rows: Rows, unit: str) -> ResidualStatistics:
    known = np.isfinite(rows.sigma)
    residual = rows.residual[known]
    if residual.size == 0:
        return ResidualStatistics(unit, 0, 0.0, 0.0, 0.0, 0)
    weight = np.broadcast_to(rows.weight[:, None], known.shape)[known]
    normalised = residual / rows.sigma[known] * np.sqrt(weight)
    return ResidualStatistics(
        unit,
        int(np.count_nonzero(np.any(known, axis=1))),
        float(np.average(residual, weights=weight)),
        float(np.sqrt(np.average(residual**2, weights=weight))),
        float(np.sqrt(np.mean(normalised**2))),
        int(np.count_nonzero(rows.weight < REJECTED_WEIGHT)),
    )
