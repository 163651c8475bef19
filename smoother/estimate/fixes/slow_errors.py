"""The slow errors of a receiver, separated by laps: of its positions, and of the Doppler that a path follows.

Fixes wander beside such a path by the difference of both. Laps show how far the positions themselves change from lap to
lap (`smoother.fit.lap_registration`). What the difference changes by from lap to lap beyond that, and beyond what the
solution knows of its own path, is the slow error of Doppler, added up. Whatever a receiver does in every braking zone
or bend is the same in all laps, and counts in neither.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.fit.lap_registration import USUAL_SIGMA, USUAL_TAU, LapRegistration


@dataclass(frozen=True)
class SlowVelocity:
    """The slow error of Doppler velocities: first-order Gauss-Markov, sigma m/s per axis, forgotten after tau s;
    one that is never forgotten is a bias."""

    sigma: float
    tau: float = math.inf

    def kept(self, h: float) -> float:
        """Share of it that is left after h s."""
        return math.exp(-h / self.tau)

    def gone(self, h: float) -> float:
        """Way, s, that a unit of it adds up to in h s."""
        return h if math.isinf(self.tau) else -self.tau * math.expm1(-h / self.tau)

    def way(self, h: Array) -> Array:
        """Variance, m^2, of the way that it adds up to in h s, stationary from the start (Gelb 1974, 3.8)."""
        if math.isinf(self.tau):
            return np.asarray((self.sigma * h) ** 2)
        return np.asarray(2.0 * self.sigma**2 * self.tau * (h + self.tau * np.expm1(-h / self.tau)))

    def way_covariance(self, one: Array, two: Array) -> Array:
        """Covariance, m^2, of the ways until two times, s, from a common start: the double integral of its own."""

        def left(t: Array) -> Array:
            return np.asarray(np.exp(-t / self.tau))

        ends = left(one) + left(two) - 1.0 - left(np.abs(one - two))
        return np.asarray(self.sigma**2 * self.tau * (2.0 * np.minimum(one, two) + self.tau * ends))

    def noise(self, h: float) -> tuple[float, float, float]:
        """Of what comes anew in h s: variance m^2 of the way, covariance m^2/s with the velocity, its variance m^2/s^2.

        Source: integral of a first-order Gauss-Markov process (Gelb 1974, 3.8).
        """
        if math.isinf(self.tau):
            return 0.0, 0.0, 0.0
        u = h / self.tau
        new, variance = -math.expm1(-u), self.sigma**2
        # the way's variance is a difference that goes with u^3, of terms that go with u
        way = 2.0 * u**3 / 3.0 * (1.0 - 0.75 * u) if u < 1e-3 else 2.0 * u - 2.0 * new - new**2
        return variance * self.tau**2 * way, variance * self.tau * new**2, variance * -math.expm1(-2.0 * u)


# Two modules in one car have 0.0065 m/s and 30 s, a better receiver beside RTK too little to be seen; in between.
DOPPLER = SlowVelocity(0.005, 30.0)

MOST_LAPS = 60  # that are compared; more add little
WITHIN = 6  # times of a lap that stand for all of it
LOOSE = 100.0  # m, of an uninformative prior
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

    def parted(self, lag: Array) -> Array:
        """Variance (N,) m^2 of the change over `lag` (N,) s of what is attributed to the one and belongs to the other.

        Of a sum of two independent normals with variances V and W, either is known to V W / (V + W).
        """
        own = -2.0 * self.sigma**2 * np.expm1(-lag / self.tau)
        way = self.doppler.way(lag)
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
