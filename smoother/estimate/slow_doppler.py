"""The slow error of Doppler velocities, which adds up to a wander of the path that follows them."""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array


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
