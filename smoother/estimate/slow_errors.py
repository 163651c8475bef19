"""The slow errors of a receiver, told apart by laps: of its positions, and of the Doppler that a path follows.

Fixes wander beside such a path by the difference of both. Laps show how far the positions themselves change from lap to
lap (`smoother.fit.lap_registration`). What the difference changes by from lap to lap beyond that, and beyond what the
solution knows of its own path, is the slow error of Doppler, added up. Whatever a receiver does in every braking zone
or bend is the same in all laps, and counts in neither.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.estimate.slow_doppler import DOPPLER, SlowVelocity
from smoother.fit.lap_registration import USUAL_SIGMA, USUAL_TAU, LapRegistration

MOST_LAPS = 60  # that are looked at together: more say hardly more
WITHIN = 6  # times of a lap that stand for all of it
LOOSE = 100.0  # m, of a prior that says nothing
LEAST = 0.01  # m, of a mean of the drift over a lap
# Candidates: logarithms of sigma m and tau s of positions, and of sigma m/s of Doppler; what is usual of the latter.
SIGMAS, TAUS = np.log(np.geomspace(0.02, 6.0, 16)), np.log(np.geomspace(20.0, 600.0, 6))
VELOCITIES, USUAL_VELOCITY = np.log(np.geomspace(1e-3, 0.15, 12)), (math.log(DOPPLER.sigma), 1.2)


@dataclass(frozen=True)
class SlowErrors:
    """Gauss-Markov processes per level axis: of positions, sigma m and tau s; doppler: of velocities."""

    sigma: float
    tau: float
    doppler: SlowVelocity

    def beyond(self, sigma: float) -> float:
        """Sigma, m, of a prior of positions that with one of `sigma` m, which a solution has had, makes this one."""
        left = 1.0 / self.sigma**2 - 1.0 / sigma**2
        return min(1.0 / math.sqrt(max(left, 1e-12)), LOOSE)

    def parted(self, apart: Array) -> Array:
        """Variance (N,) m^2 of the change over `apart` (N,) s of what is given to the one and is the other's.

        Of a sum of two independent normals with variances V and W, either is known to V W / (V + W).
        """
        own = -2.0 * self.sigma**2 * np.expm1(-apart / self.tau)
        way = self.doppler.way(apart)
        return np.asarray(own * way / np.maximum(own + way, 1e-300))


def slow_errors(laps: LapRegistration, t: Array, drift: Array, known: float) -> SlowErrors:
    """Return what laps, and the drift (B, 2) m of fixes beside a path at times t (B,) s, show of both errors.

    known m^2: variance per axis of what the path changes by over a lap, as the solution knows it. Of each lap there are
    its translation, which has the error of positions and the driver in it, and the mean drift, which has both errors.
    Posterior means on a grid; the time of the error of Doppler is the usual one, which laps hardly show.
    """
    crossed = laps.crossing_time[:MOST_LAPS]
    n = len(crossed)
    at = np.stack([np.interp(crossed, t, axis) for axis in drift.T], axis=2)
    means = np.nanmean(np.where(np.isfinite(crossed)[:, :, None], at, np.nan), axis=1)
    contrasts = np.linalg.svd(np.eye(n) - 1.0 / n)[0][:, : n - 1]  # free of the line and of where the path began
    seen = np.concatenate([contrasts.T @ laps.translation_n[:MOST_LAPS], contrasts.T @ means])
    within = np.nanquantile(crossed, (np.arange(WITHIN) + 0.5) / WITHIN, axis=1).T - np.nanmin(crossed)

    def contrasted(covariance: Array) -> Array:
        """Covariance of contrasts of means over laps, from that of times (n, WITHIN, n, WITHIN)."""
        return np.asarray(contrasts.T @ covariance.mean(axis=(1, 3)) @ contrasts)

    one, two = within[:, :, None, None], within[None, None]
    way = contrasted(SlowVelocity(1.0, DOPPLER.tau).way_covariance(one, two))
    walk = contrasted(np.minimum(one, two)) * (known / laps.time_of_lap) + LEAST**2 * np.eye(n - 1)
    driver = laps.noise**2 * np.eye(n - 1)
    found = np.empty((len(SIGMAS), len(TAUS), len(VELOCITIES)))
    for j, log_tau in enumerate(TAUS):
        own = np.exp(2.0 * SIGMAS)[:, None, None] * contrasted(np.exp(-np.abs(one - two) / math.exp(log_tau)))
        for k, log_velocity in enumerate(VELOCITIES):
            beside = own + walk + math.exp(2.0 * log_velocity) * way
            found[:, j, k] = _log_likelihood(np.block([[own + driver, own], [own, beside]]), seen)
    grid = np.meshgrid(SIGMAS, TAUS, VELOCITIES, indexing="ij")
    for values, (mean, spread) in zip(grid, (USUAL_SIGMA, USUAL_TAU, USUAL_VELOCITY), strict=True):
        found -= 0.5 * ((values - mean) / spread) ** 2
    weight = np.exp(found - found.max())
    sigma, tau, velocity = (math.exp(float(np.sum(weight * values) / np.sum(weight))) for values in grid)
    return SlowErrors(sigma, tau, SlowVelocity(velocity, DOPPLER.tau))


def _log_likelihood(covariance: Array, seen: Array) -> Array:
    """Log likelihood (S,) of what was `seen` (m, 2) of two independent axes, for each covariance (S, m, m)."""
    root = np.linalg.cholesky(covariance)
    white = np.linalg.solve(root, np.broadcast_to(seen, (len(root), *seen.shape)))
    logs = np.log(np.einsum("sii->si", root)).sum(axis=1)
    return np.asarray(-2.0 * logs - 0.5 * np.sum(white**2, axis=(1, 2)))
