"""Noise of the fixes from the fixes: how far off each one is, what weight it keeps, and the variance components.

Sources: Förstner 1979 (variance components: squared residuals over redundancy); Yang et al. 2002 (IGG III weights).
"""

from dataclasses import dataclass, field, replace

import numpy as np

from smoother.arrays import Array
from smoother.estimate import gnss_system as system
from smoother.estimate.chain import ChainSolution
from smoother.fit.noise_spread import ANY_NOISE, BY_JERK, Residuals, of_positions, of_velocities
from smoother.samples import GnssFixes

# By group of gnss_system (horizontal and up position, horizontal and up velocity): m, m, m/s, m/s.
START_SIGMA = np.array([1.0, 2.0, 0.4, 0.6])  # wide, so that a rough start rejects nothing true
# What is leant on where the data cannot tell. Positions of receivers that filter scatter by 0.01-0.03 m from one to the
# next, those of others by 0.2 and more: between both, neither line nor offset is far off.
USUAL_SIGMA = np.array([0.1, 0.175, 0.2, 0.3])
LEAST_SIGMA = np.array([0.02, 0.03, 0.02, 0.02])  # below it a receiver repeats its own filter, not the truth
# Horizontal and up.
START_JERK = np.array([6.0, 0.5])  # m/s^3/sqrt(Hz): a kart's cornering; hardly any up and down
LEAST_JERK = np.array([0.2, 0.1])
START_VEHICLE = np.array([[10.0, 5.0], [1.5, 1.0]])  # m/s, m/s^2
LEAST_VEHICLE = np.array([[1.0, 0.5], [0.3, 0.2]])
WORST_REPORTED = 1e6  # times the usual; damaged files say more, of which squares would overflow
PRIOR_COUNT = 6.0  # measurements that the usual values are worth
KEEP, DROP = 3.0, 7.0  # normalised residuals: full weight up to the one, none from the other
# What nobody need call an outlier, m and m/s, added to sigma when weighing. Receivers wander and converge again by
# metres within seconds; without Doppler as a witness nothing tells that from driving, so the path stays with fixes.
UNREMARKABLE = np.array([0.5, 3.0, 0.3, 0.3])
UNREMARKABLE_ALONE = 1.0  # m, horizontal position of a fix without Doppler
POSITIONS = (system.HORIZONTAL_POSITION, system.UP_POSITION)
IN = 0.5  # weight from which a measurement counts as accepted
BULK, BULK_SIZE = 0.75, (1.665, 1.150, 1.665, 1.150)  # a quantile, and that of the length of 2 or 1 standard normals


@dataclass(frozen=True, eq=False)
class FixNoise:
    """sigma (4,) per group, m or m/s; jerk (2,) m/s^3/sqrt(Hz); vehicle (2, 2) usual velocity and acceleration.

    spread (4,): sigma of the logarithm of each sigma.
    """

    sigma: Array
    jerk: Array
    vehicle: Array
    spread: Array = field(default_factory=lambda: np.full(system.GROUPS, ANY_NOISE))


@dataclass(frozen=True, eq=False)
class Round:
    """What one solve leaves to judge the noise by: rows with residual, weight, variance and leverage, each (R,)."""

    rows: system.FixRows
    residual: Array
    weight: Array
    variance: Array
    leverage: Array


def first_noise() -> FixNoise:
    """Return the noise to start from."""
    return FixNoise(START_SIGMA, START_JERK, START_VEHICLE)


def relative_sigmas(fixes: GnssFixes) -> tuple[Array, Array]:
    """Sigma of each fix over the session's usual, (M, 3) for position and velocity, never below 1.

    What receivers report is off by a factor of its own in each session, but says when a fix is worse than others.
    """
    assert fixes.sigma_horizontal is not None and fixes.sigma_up is not None
    assert fixes.sigma_velocity is not None and fixes.hdop is not None
    horizontal = _relative(fixes.sigma_horizontal if np.isfinite(fixes.sigma_horizontal).any() else fixes.hdop)
    up = _relative(fixes.sigma_up) if np.isfinite(fixes.sigma_up).any() else horizontal
    velocity = _relative(fixes.sigma_velocity)
    return np.stack([horizontal, horizontal, up], axis=1), np.stack([velocity] * 3, axis=1)


def _relative(reported: Array) -> Array:
    known = np.isfinite(reported)
    if not known.any():
        return np.ones_like(reported)
    with np.errstate(over="ignore"):
        ratio = reported / np.median(reported[known])
    return np.where(known, np.clip(ratio, 1.0, WORST_REPORTED), 1.0)


def normalised_sizes(done: Round, n_fixes: int) -> Array:
    """Normalised residual (M, 4) of each fix and group as if it had been left out, both horizontal axes together.

    Where even the bulk of a group exceeds what its sigma allows, the model is wrong and not the data: the whole
    group is then scaled to what is usual in it. NaN where not measured.
    """
    rows = done.rows
    is_measured = np.zeros((n_fixes, system.GROUPS), dtype=np.bool_)
    is_measured[rows.fix, rows.group] = True
    alone = ~is_measured[rows.fix, system.HORIZONTAL_VELOCITY] & (rows.group == system.HORIZONTAL_POSITION)
    slack = np.where(alone, UNREMARKABLE_ALONE, UNREMARKABLE[rows.group])
    share = np.minimum(done.weight * done.leverage / done.variance, 0.999)
    expected = done.variance + slack**2 + done.leverage / (1.0 - share)
    left_out = (done.residual / (1.0 - share)) ** 2 / expected
    squared = np.bincount(rows.fix * system.GROUPS + rows.group, left_out, is_measured.size)
    size = np.where(is_measured, np.sqrt(squared.reshape(is_measured.shape)), np.nan)
    for group in np.flatnonzero(is_measured.any(axis=0)):
        size[:, group] /= max(float(np.nanquantile(size[:, group], BULK)) / BULK_SIZE[group], 1.0)
    return np.asarray(size)


def robust_weights(size: Array, before: Array, graduation: float) -> Array:
    """IGG III weights (M, 4) of normalised residuals, thresholds widened by `graduation`; 1 where nothing is measured.

    A position that was out comes back only beside one that was in (weights `before`), so that a run of rejected fixes
    must prove its ends first: in the middle of the run the path knows little and would believe anything.
    """
    alone = np.isnan(size[:, system.HORIZONTAL_VELOCITY])
    size = np.nan_to_num(size, nan=0.0) / graduation
    taper = np.clip((DROP - size) / (DROP - KEEP), 0.0, 1.0)
    taper[alone & (before[:, system.HORIZONTAL_POSITION] > 0.0), system.HORIZONTAL_POSITION] = 1.0
    weight = np.where(size <= KEEP, 1.0, KEEP / np.maximum(size, KEEP) * taper**2)
    position, earlier = weight[:, system.HORIZONTAL_POSITION], before[:, system.HORIZONTAL_POSITION]
    beside = earlier >= IN
    if graduation <= 1.0:
        beside[1:] |= earlier[:-1] >= IN
        beside[:-1] |= earlier[1:] >= IN
    weight[:, system.HORIZONTAL_POSITION] = np.where(beside, position, np.minimum(position, earlier))
    return weight


def identify(done: Round, between: system.Transitions, x: Array, solution: ChainSolution, now: FixNoise) -> FixNoise:
    """Return the noise that one round of solving shows, x (A, K, 4) being its result."""
    jerk = _jerk(done, between, x, solution, now.jerk)
    return replace(now, sigma=_sigma(done), jerk=jerk, vehicle=_vehicle(x, solution, now.vehicle), spread=_spread(done))


def _sigma(done: Round) -> Array:
    """Squared residuals over redundancy; the less the measurements check one another, the more the usual counts."""
    rows, weight = done.rows, done.weight
    count = np.bincount(rows.group, weight, system.GROUPS)
    checked = np.bincount(rows.group, weight * (1.0 - weight * done.leverage / done.variance), system.GROUPS)
    leaning = PRIOR_COUNT + count * (1.0 - checked / np.maximum(count, 1.0)) ** 3
    squares = np.bincount(rows.group, weight * (done.residual / rows.scale) ** 2, system.GROUPS)
    sigma = np.sqrt((squares + leaning * USUAL_SIGMA**2) / (checked + leaning))
    return np.asarray(np.maximum(sigma, LEAST_SIGMA))


def _spread(done: Round) -> Array:
    """Sigma (4,) of the logarithm of the sigma of each group, by what is left of it in the residuals."""
    rows, weight = done.rows, done.weight
    squares = weight * done.residual**2 / done.variance
    expected = weight * (1.0 - weight * done.leverage / done.variance)
    out = np.full(system.GROUPS, ANY_NOISE)
    for group in np.unique(rows.group).tolist():
        at = np.flatnonzero((rows.group == group) & (weight > 0.0))
        at = at[np.argsort(rows.fix[at], kind="stable")]
        residuals = Residuals(squares[at], np.maximum(expected[at], 0.0), float(len(at)))
        out[group] = of_positions(residuals) if group in POSITIONS else of_velocities(residuals, BY_JERK)
    return out


def _jerk(done: Round, between: system.Transitions, x: Array, solution: ChainSolution, now: Array) -> Array:
    """Jerk densities (2,). What the measurements determine and neither offset nor start takes up, the jerk does.

    (Its redundancy taken from its own covariance would be a small difference of large numbers.)
    """
    driven = system.prior_residuals(between, x)[..., :3]
    squares = np.einsum("aki,aki->a", driven, (between.information[..., :3, :3] @ driven[..., None])[..., 0])
    P = solution.covariance.reshape(*x.shape, system.N_STATE)
    cross = np.append(solution.cross[:, 3, 3], 0.0).reshape(x.shape[:2])[:, :-1]
    keep = between.step[..., 3, 3]
    offset = P[:, 1:, 3, 3] - 2.0 * keep * cross + keep**2 * P[:, :-1, 3, 3]
    by_offset = np.sum(1.0 - offset * between.information[..., 3, 3], axis=1)
    by_start = system.N_STATE - np.einsum("aij,aji->a", between.first, P[:, 0])
    determined = np.bincount(done.rows.axis, done.weight * done.leverage / done.variance, x.shape[0])
    redundancy = np.maximum(determined - by_offset - by_start, 0.0)
    kind = np.asarray(system.PRIOR_OF_AXIS[: x.shape[0]])
    found = now**2 * np.bincount(kind, squares, 2) + PRIOR_COUNT * START_JERK**2
    jerk = np.sqrt(found / (np.bincount(kind, redundancy, 2) + PRIOR_COUNT))
    return np.asarray(np.maximum(jerk, LEAST_JERK))


def _vehicle(x: Array, solution: ChainSolution, now: Array) -> Array:
    """Usual velocity and acceleration (2, 2), horizontal per axis and up: of the path, and of what it does not know."""
    unknown = np.einsum("kii->ki", solution.covariance)[:, 1:3].reshape(*x.shape[:2], 2)
    square = np.mean(x[..., 1:3] ** 2 + unknown, axis=1)
    up = square[2] if square.shape[0] > 2 else now[1] ** 2
    return np.asarray(np.maximum(np.sqrt(np.stack([square[:2].mean(axis=0), up])), LEAST_VEHICLE))
