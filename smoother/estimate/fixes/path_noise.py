"""Noise of the fixes from the fixes: how far off each one is, what weight it keeps, and the variance components.

Sources: Förstner 1979 (variance components: squared residuals over redundancy); Yang et al. 2002 (IGG III weights).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.rows import Rows
from smoother.estimate.fixes.path_graph import ACCELERATION, KINDS, LEVEL, UP, VELOCITY, Solution
from smoother.estimate.solvers.variance_components import posterior_variance
from smoother.fit.noise_spread import ANY_NOISE, BY_JERK, Residuals, of_positions, of_velocities
from smoother.samples import GnssFixes

# By kind (position, height, velocity, climb): m, m, m/s, m/s.
START_SIGMA = np.array([1.0, 2.0, 0.4, 0.6])  # wide, so that a rough start rejects nothing true
REPORTED_SHARE = 0.2  # of the reported accuracy: white noise of positions to start from
# Prior where the data do not determine it. Positions of receivers that filter scatter by 0.01-0.03 m from one to the
# next, those of others by 0.2 and more: between both, neither line nor offset is far off.
USUAL_SIGMA = np.array([0.1, 0.175, 0.2, 0.3])
LEAST_SIGMA = np.array([0.02, 0.03, 0.02, 0.02])  # below it a receiver repeats its own filter, not the truth
# Level and up.
START_JERK = np.array([6.0, 0.5])  # m/s^3/sqrt(Hz): a kart's cornering; hardly any up and down
LEAST_JERK = np.array([0.2, 0.1])
START_VEHICLE = np.array([[10.0, 5.0], [1.5, 1.0]])  # m/s, m/s^2
LEAST_VEHICLE = np.array([[1.0, 0.5], [0.3, 0.2]])
DOPPLER_SHARE = 0.5  # share of the fixes with a velocity
LEAST_WANDER = 0.02  # of the usual slow error
START_WANDER = np.array([1.0, 1.0, 30.0])  # of the slow errors, in parts of the usual
SLOW_GROUPS = LEVEL, UP, slice(3, 4)  # of the slow errors: offset, latency
WORST_REPORTED = 1e6  # times the usual; damaged files have more, of which squares would overflow
PRIOR_COUNT = 6.0  # measurements that the usual values are worth
KEEP, DROP = 3.0, 7.0  # normalised residuals: full weight up to the one, none from the other
# No outlier, m and m/s, added to sigma when weighing. Receivers wander and converge again by metres within seconds;
# without Doppler that cannot be distinguished from driving, so the path stays with the fixes.
UNREMARKABLE = np.array([0.5, 3.0, 0.3, 0.3])
UNREMARKABLE_ALONE = 1.0  # m, level position of a fix without Doppler
IN = 0.5  # weight from which a measurement counts as accepted
BULK, BULK_SIZE = 0.75, (1.665, 1.150, 1.665, 1.150)  # a quantile, and that of the length of 2 or 1 standard normals


@dataclass(frozen=True, eq=False)
class PathNoise:
    """sigma (4,) by kind, m or m/s; jerk (2,) m/s^3/sqrt(Hz); vehicle (2, 2) usual velocity and acceleration.

    spread (4,): sigma of the logarithm of each sigma. wander (3,): sigmas of the offset, level and up,
    and of the change of the latency, over the usual ones.
    """

    sigma: Array
    jerk: Array
    vehicle: Array
    spread: Array = field(default_factory=lambda: np.full(len(KINDS), ANY_NOISE))
    wander: Array = field(default_factory=lambda: START_WANDER)


def first_noise(reported: float) -> PathNoise:
    """Return the noise to start from; reported m: accuracy by the receiver.

    It comes down to what the fixes show. From below, the path would follow bad positions, and Doppler would seem bad.
    """
    sigma = np.array([*np.maximum(START_SIGMA[:2], REPORTED_SHARE * reported), *START_SIGMA[2:]])
    return PathNoise(sigma, START_JERK, START_VEHICLE)


def relative_sigmas(fixes: GnssFixes) -> Array:
    """Sigma of each fix over the session's usual, (M, 4) by kind, never below 1.

    Reported accuracies are wrong by a factor of the session, but right in that a fix is worse than others.
    """
    assert fixes.sigma_horizontal is not None and fixes.sigma_up is not None
    assert fixes.sigma_velocity is not None and fixes.hdop is not None
    level = _relative(fixes.sigma_horizontal if np.isfinite(fixes.sigma_horizontal).any() else fixes.hdop)
    up = _relative(fixes.sigma_up) if np.isfinite(fixes.sigma_up).any() else level
    velocity = _relative(fixes.sigma_velocity)
    return np.stack([level, up, velocity, velocity], axis=1)


def _relative(reported: Array) -> Array:
    known = np.isfinite(reported)
    if not known.any():
        return np.ones_like(reported)
    with np.errstate(over="ignore"):
        ratio = reported / np.median(reported[known])
    return np.where(known, np.clip(ratio, 1.0, WORST_REPORTED), 1.0)


@dataclass(frozen=True, eq=False)
class Judged:
    """Rows of one kind after a step: residual, variance and what the path leaves of it, (M, r); weight (M,)."""

    residual: Array
    variance: Array
    left: Array
    weight: Array

    @staticmethod
    def of(before: Rows, after: Rows, solution: Solution) -> "Judged":
        """before: rows that the step was made with; after: the same, linearised after it."""
        return Judged(after.residual, before.sigma**2, posterior_variance(before, solution.covariances), before.weight)

    @property
    def leverage(self) -> Array:
        """Share (M, r) that a measurement has in its own prediction; 0 where nothing was measured."""
        return self.weight[:, None] * self.left / self.variance


def normalised_sizes(judged: Sequence[Judged]) -> Array:
    """Normalised residual (M, 4) of each fix by kind as if it had been left out, both level axes together.

    Where even the bulk of a kind exceeds what its sigma allows, the model is wrong and not the data: the whole kind is
    then scaled to what is usual in it. NaN where not measured.
    """
    alone = ~np.isfinite(judged[KINDS.index("velocity")].variance[:, 0])
    sizes = []
    for kind, (name, it) in enumerate(zip(KINDS, judged, strict=True)):
        measured = np.isfinite(it.variance)
        slack = np.where(alone & (name == "position"), UNREMARKABLE_ALONE, UNREMARKABLE[kind])[:, None]
        share = np.minimum(it.leverage, 0.999)
        expected = np.where(measured, it.variance, 1.0) + slack**2 + it.left / (1.0 - share)
        squares = np.sum(np.where(measured, (it.residual / (1.0 - share)) ** 2 / expected, 0.0), axis=1)
        size = np.where(measured.any(axis=1), np.sqrt(squares), np.nan)
        if measured.any():
            size /= max(float(np.nanquantile(size, BULK)) / BULK_SIZE[kind], 1.0)
        sizes.append(size)
    return np.stack(sizes, axis=1)


def robust_weights(size: Array, before: Array, graduation: float) -> Array:
    """IGG III weights (M, 4) of normalised residuals, thresholds widened by `graduation`; 1 where nothing is measured.

    A position that was out comes back only beside one that was in (weights `before`), so that a run of rejected fixes
    must prove its ends first: in the middle of the run the path knows little and would believe anything.
    """
    position = KINDS.index("position")
    alone = np.isnan(size[:, KINDS.index("velocity")])
    size = np.nan_to_num(size, nan=0.0) / graduation
    taper = np.clip((DROP - size) / (DROP - KEEP), 0.0, 1.0)
    taper[alone & (before[:, position] > 0.0), position] = 1.0
    weight = np.where(size <= KEEP, 1.0, KEEP / np.maximum(size, KEEP) * taper**2)
    found, earlier = weight[:, position], before[:, position]
    beside = earlier >= IN
    if graduation <= 1.0:
        beside[1:] |= earlier[:-1] >= IN
        beside[:-1] |= earlier[1:] >= IN
    weight[:, position] = np.where(beside, found, np.minimum(found, earlier))
    return weight


def identify(
    judged: Sequence[Judged], scale: Array, solution: Solution, driven: Sequence[Judged], now: PathNoise
) -> PathNoise:
    """Return the noise that one round of solving shows.

    scale (M, 4): of each fix; driven: rows of the jerk, level and up, and of the slow errors.
    """
    velocity = np.isfinite(judged[KINDS.index("velocity")].variance[:, 0])
    has_doppler = float(np.mean(velocity)) > DOPPLER_SHARE
    return replace(
        now,
        sigma=np.array([_sigma(it, scale[:, kind], kind, has_doppler=has_doppler) for kind, it in enumerate(judged)]),
        jerk=np.array([_jerk(it, now.jerk[i], i) for i, it in enumerate(driven[:2])]),
        wander=_wander(driven[2], now.wander) if has_doppler else np.ones(3),
        vehicle=_vehicle(solution, now.vehicle, bool(np.isfinite(judged[KINDS.index("height")].variance).any())),
        spread=np.array([_spread(it, name) for name, it in zip(KINDS, judged, strict=True)]),
    )


def _sigma(it: Judged, scale: Array, kind: int, *, has_doppler: bool) -> float:
    """Squared residuals over redundancy; the less the measurements check one another, the more the usual counts.

    With velocities, positions show both their noise and their slow error.
    """
    measured = np.isfinite(it.variance)
    weight = np.where(measured, it.weight[:, None], 0.0)
    count, checked = float(np.sum(weight)), float(np.sum(weight * (1.0 - it.leverage)))
    prior = 0.0 if has_doppler and KINDS[kind] in ("position", "height") else count
    count_of_prior = PRIOR_COUNT + prior * (1.0 - checked / max(count, 1.0)) ** 3
    squares = float(np.sum(weight * (it.residual / scale[:, None]) ** 2))
    sigma = np.sqrt((squares + count_of_prior * USUAL_SIGMA[kind] ** 2) / (checked + count_of_prior))
    return float(max(sigma, LEAST_SIGMA[kind]))


def _spread(it: Judged, name: str) -> float:
    """Sigma of the logarithm of the sigma, by what is left of it in the residuals."""
    use = np.isfinite(it.variance) & (it.weight[:, None] > 0.0)
    if not use.any():
        return ANY_NOISE
    weight = np.broadcast_to(it.weight[:, None], use.shape)[use]
    squares, expected = weight * it.residual[use] ** 2 / it.variance[use], weight * (1.0 - it.leverage[use])
    residuals = Residuals(squares, np.maximum(expected, 0.0), float(np.count_nonzero(use)))
    return of_positions(residuals) if name in ("position", "height") else of_velocities(residuals, BY_JERK)


def _jerk(it: Judged, now: float, axis: int) -> float:
    squares, redundancy = float(np.sum(it.residual**2)), float(np.sum(1.0 - it.leverage))
    found = (now**2 * squares + PRIOR_COUNT * START_JERK[axis] ** 2) / (max(redundancy, 0.0) + PRIOR_COUNT)
    return float(max(np.sqrt(found), LEAST_JERK[axis]))


def _wander(it: Judged, now: Array) -> Array:
    squares, redundancy = it.residual**2 / it.variance, np.maximum(1.0 - it.leverage, 0.0)
    parts = [(float(squares[:, axes].sum()), float(redundancy[:, axes].sum())) for axes in SLOW_GROUPS]
    found = [(now[i] ** 2 * s + PRIOR_COUNT) / (r + PRIOR_COUNT) for i, (s, r) in enumerate(parts)]
    return np.asarray(np.maximum(np.sqrt(found), LEAST_WANDER))


def _vehicle(solution: Solution, now: Array, has_height: bool) -> Array:
    """Usual velocity and acceleration (2, 2), level per axis and up: of the path, and of what it does not know."""
    unknown = np.einsum("kii->ki", solution.covariances.keyframes)
    square = np.mean(solution.nodes.x**2 + unknown, axis=0)
    both = np.stack([square[VELOCITY], square[ACCELERATION]], axis=1)
    up = both[2] if has_height else now[1] ** 2
    return np.asarray(np.maximum(np.sqrt(np.stack([both[:2].mean(axis=0), up])), LEAST_VEHICLE))
