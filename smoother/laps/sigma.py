"""Sigmas of times: the covariance of crossing times from that of positions.

At a crossing the error of the position along the direction of travel becomes one of time, dt = -(n . dp) / (n . v). Two
crossings share most of the slow GPS error, so their difference is more accurate than either; the joint covariance
quantifies this. It comes from the estimator ("joint"), from the drift of the position error stored with results
("stored"), or else from a model of the receiver's slow error ("model").
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from smoother.arrays import Array, BoolArray, freeze, require_increasing
from smoother.laps.results import SigmaSource
from smoother.trajectory import JointPosition, Trajectory

OFFSET_SIGMA, OFFSET_TAU = 2.0, 60.0  # m, s: of receivers in general, unless identified
TRACK_TAU = 1.0  # s, time constant of the fast part of the position error: some fixes
SLOWEST = 1.0  # m/s; slower crossings have no accurate time
LAGS = (0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0, 60.0, 90.0, 150.0, 300.0, 600.0)  # s at which drift is stored
SAMPLES = 40  # pairs of positions per lag
SIGNIFICANT_SIGMAS = 2.0  # of one difference that is real
FALSE_DISCOVERY_RATE = 0.05  # among many differences that are called real
TOGETHER = 240  # positions whose covariance is computed in one call


def least_significant(sigma: float | Array) -> float | Array:
    """Return the least significant size of a single difference with this sigma."""
    return SIGNIFICANT_SIGMAS * sigma


def significance_threshold(difference: Array, sigma: Array) -> float:
    """Return the number of sigmas above which differences of one table, of any shape, are real: SIGNIFICANT_SIGMAS or
    more.

    Of many comparisons some exceed two sigmas by chance, and those of one table share the error of the reference lap.
    The false discovery rate is limited under any dependency. Source: Benjamini and Yekutieli, The control of the false
    discovery rate in multiple testing under dependency, 2001. A difference without a positive sigma is ignored.
    """
    known = np.isfinite(difference) & np.isfinite(sigma) & (sigma > 0.0)
    ratio = np.sort(np.abs(difference[known] / sigma[known]))[::-1]
    if not ratio.size:
        return SIGNIFICANT_SIGMAS
    rank = np.arange(1, len(ratio) + 1)
    share = FALSE_DISCOVERY_RATE * rank / (len(ratio) * np.sum(1.0 / rank))
    needed = np.array([-NormalDist().inv_cdf(0.5 * p) for p in share.tolist()])
    passing = np.flatnonzero(ratio >= needed)
    return max(SIGNIFICANT_SIGMAS, float(needed[passing[-1] if passing.size else 0]))


def are_real(difference: Array, sigma: Array, threshold: float) -> BoolArray:
    """Mask of differences beyond `threshold` sigmas; False without a positive sigma."""
    with np.errstate(invalid="ignore"):
        return np.asarray((np.abs(difference) >= threshold * sigma) & np.isfinite(sigma) & (sigma > 0.0))


@dataclass(frozen=True, eq=False)
class OffsetModel:
    """Position error as a first-order Gauss-Markov offset (sigma m, tau s) plus a fast part of `track` (N,) m at t (N,)
    s. Source: autocorrelation of receivers carried beside RTK; see docs/laps.md.

    walk m^2/s: where speed was measured and used, the change of the position error is also bounded by the random walk
    of its integrated noise; infinite where the speed was not measured.
    """

    t: Array
    track: Array
    sigma: float
    tau: float
    walk: float = np.inf

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        lag = np.abs(t[:, None] - t[None, :])
        fast = np.interp(t, self.t, self.track)
        change = 2.0 * self.sigma**2 * (1.0 - np.exp(-lag / self.tau))
        if np.isfinite(self.walk):
            walk_change = self.walk * lag
            change = change * walk_change / np.maximum(change + walk_change, 1e-300)
        offset = self.sigma**2 - 0.5 * change
        decay = np.exp(-lag / TRACK_TAU)
        return np.asarray((direction_n @ direction_n.T) * (offset + fast[:, None] * fast[None, :] * decay))


@dataclass(frozen=True, eq=False)
class Drift:
    """How a position error changes: lag (K,) s from 0 on, change (K,) m, sigma of the change along one direction over
    that time; absolute m, sigma of the error itself. The same at all times and in all directions."""

    lag: Array
    change: Array
    absolute: float

    def __post_init__(self) -> None:
        freeze(self, lag=(None,), change=(len(self.lag),))
        require_increasing(self.lag, "Drift.lag")

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        changed = np.interp(np.abs(t[:, None] - t[None, :]), self.lag, self.change**2)
        return np.asarray((direction_n @ direction_n.T) * (self.absolute**2 - 0.5 * changed))


def position_errors(
    trajectory: Trajectory, fix_interval: float, stored: Drift | None = None
) -> tuple[JointPosition | None, SigmaSource]:
    """Return the source of the covariance of positions at several times, and its kind; None without any sigma.

    fix_interval s: usual time between fixes.
    """
    if trajectory.joint is not None:
        return trajectory.joint, "joint"
    if stored is not None:
        return stored, "stored"
    if trajectory.sigmas is None or not np.isfinite(trajectory.sigmas.track).any():
        return None, "none"
    sigma, tau = (_identified(trajectory, name) for name in ("gps_offset_sigma", "gps_offset_tau"))
    known = np.isfinite(trajectory.sigmas.track)
    return (
        OffsetModel(
            trajectory.t[known],
            trajectory.sigmas.track[known],
            OFFSET_SIGMA if sigma is None else sigma,
            OFFSET_TAU if tau is None else tau,
            _walk(trajectory, fix_interval),
        ),
        "model",
    )


def _walk(trajectory: Trajectory, fix_interval: float) -> float:
    """Variance (m^2/s) of the integrated independent errors of the speed at the fixes."""
    noise = _identified(trajectory, "gps_velocity_noise")
    if trajectory.report.mode != "full" or noise is None or not np.isfinite(fix_interval):
        return np.inf
    return noise**2 * fix_interval


def _identified(trajectory: Trajectory, name: str) -> float | None:
    """An identified value, of three the horizontal one."""
    identified = trajectory.report.identified.get(name)
    if identified is None:
        return None
    value = float(np.ravel(np.asarray(identified.value, dtype=np.float64))[0])
    return value if np.isfinite(value) and value >= 0.0 else None


@dataclass(frozen=True, eq=False)
class Crossed:
    """Crossings whose times are compared: t (m,) s, forward normals (m, 2) of the lines, velocity (m, 2) m/s."""

    t: Array
    normal_n: Array
    velocity_n: Array

    @property
    def closing(self) -> Array:
        """Speed (m,) m/s over the line."""
        return np.asarray(np.maximum(np.sum(self.normal_n * self.velocity_n, axis=1), SLOWEST))


def time_covariance(errors: JointPosition, crossed: Crossed) -> Array:
    """Covariance (m, m) s^2 of crossing times."""
    return time_covariances(errors, [crossed])[0]


def time_covariances(errors: JointPosition, groups: Sequence[Crossed]) -> list[Array]:
    """Covariance (m, m) s^2 of the crossing times of each group."""
    directions = [np.concatenate([g.normal_n, np.zeros((len(g.t), 1))], axis=1) for g in groups]
    along = covariances(errors, [g.t for g in groups], directions)
    return [c / (speed[:, None] * speed[None, :]) for c, speed in zip(along, (g.closing for g in groups), strict=True)]


def covariances(errors: JointPosition, t: Sequence[Array], direction_n: Sequence[Array]) -> Iterator[Array]:
    """Yield the covariance (m, m) m^2 of positions at t (m,) s along direction_n (m, 3), for each of several groups.

    Groups are computed together, because a call costs more than its size; positions that several of them contain, as
    the crossings of the reference lap, are computed once.
    """
    ends = np.cumsum([len(group) for group in t])
    last = 0
    while last < len(t):
        first, before = last, ends[last] - len(t[last])
        last = max(first + 1, int(np.searchsorted(ends, before + TOGETHER, side="right")))
        asked = np.column_stack([np.concatenate(t[first:last]), np.concatenate(direction_n[first:last])])
        once, place = np.unique(asked, axis=0, return_inverse=True)
        whole = errors.covariance(once[:, 0], once[:, 1:])
        for of_group in np.split(place, (ends[first : last - 1] - before)):
            yield whole[np.ix_(of_group, of_group)]


def sigma_of(covariance: Array, weights: Array) -> Array:
    """Sigma (K,) of `weights` (K, m) times a vector with this covariance (m, m)."""
    return np.asarray(np.sqrt(np.maximum(np.einsum("ki,ij,kj->k", weights, covariance, weights, optimize=True), 0.0)))


def drift_of(errors: JointPosition, start: float, end: float) -> Drift:
    """Return how the position error changes with time, averaged over the session and over directions."""
    lags = np.array([lag for lag in LAGS if lag < 0.8 * (end - start)])
    squared, absolute = [0.0], []
    for lag in lags:
        at = np.linspace(start, end - lag, SAMPLES)
        angle = np.pi * np.arange(SAMPLES) * 0.618  # golden angle: all directions, incommensurate with the laps
        direction = np.stack([np.cos(angle), np.sin(angle), np.zeros(SAMPLES)], axis=1)
        covariance = errors.covariance(np.concatenate([at, at + lag]), np.concatenate([direction, direction]))
        own = np.diag(covariance)
        between = np.diagonal(covariance, SAMPLES)
        squared.append(float(np.mean(own[:SAMPLES] + own[SAMPLES:] - 2.0 * between)))
        absolute.append(float(np.mean(own)))
    change = np.sqrt(np.maximum.accumulate(np.maximum(squared, 0.0)))
    total = float(np.mean(absolute)) if absolute else 0.0
    return Drift(np.concatenate([[0.0], lags]), change, float(np.sqrt(max(total, 0.5 * change[-1] ** 2))))
