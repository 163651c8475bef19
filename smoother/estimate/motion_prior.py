"""The prior for how a vehicle moves along one axis: white jerk, damped so that gaps stay bounded.

State per axis: position, velocity, acceleration. Over tenths of a second the prior is white jerk; over seconds the
acceleration and then the velocity return to zero, as they do on a closed track. Undamped white jerk would carry the
curvature at the edge of a 60 s outage hundreds of metres off the track.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from smoother.arrays import Array

N_MOTION = 3  # position, velocity, acceleration
_TERMS = 30  # of the power series; steps below 1 s and decays below 5/s leave a remainder under 1e-9


@dataclass(frozen=True)
class MotionPrior:
    """Stationary velocity process `v'' + decay v' + stiffness v = white jerk` of one axis.

    jerk_density m/s^3/sqrt(Hz); velocity_sigma m/s and acceleration_sigma m/s^2, the stationary standard deviations.
    Source: Jwo 2001 and any text on second-order Gauss-Markov processes: var(a) = S / (2 decay),
    var(v) = var(a) / stiffness with S the squared density.
    """

    jerk_density: float
    velocity_sigma: float
    acceleration_sigma: float

    @property
    def decay(self) -> float:
        """Rate at which acceleration is forgotten, 1/s, held where the power series is exact."""
        return float(np.clip(0.5 * (self.jerk_density / self.acceleration_sigma) ** 2, 0.05, 5.0))

    @property
    def stiffness(self) -> float:
        """Squared angular frequency at which velocity returns to zero, 1/s^2."""
        return float(np.clip((self.acceleration_sigma / self.velocity_sigma) ** 2, 1e-4, 6.0))

    def transition(self, dt: Array) -> Array:
        """Transition of the state over steps dt (K,) s below 1 s. Returns (K, 3, 3)."""
        terms, power = [], np.eye(N_MOTION)
        for k in range(_TERMS):
            terms.append(power / factorial(k))
            power = power @ self._rates()
        return _series(dt, terms)

    def covariance(self, dt: Array) -> Array:
        """Covariance of the state after steps dt (K,) s from a known state. Returns (K, 3, 3)."""
        terms, moment = [np.zeros((N_MOTION, N_MOTION))], np.zeros((N_MOTION, N_MOTION))
        moment[2, 2] = self.jerk_density**2
        for k in range(1, _TERMS):
            terms.append(moment / factorial(k))
            moment = self._rates() @ moment + moment @ self._rates().T
        return _series(dt, terms)

    def information(self, dt: Array) -> Array:
        """Inverse of :meth:`covariance`, (K, 3, 3), computed at the scale of each step because it spans dt^5 to dt."""
        scale = dt[:, None] ** np.array([-2.5, -1.5, -0.5])
        scaled = self.covariance(dt) * scale[:, :, None] * scale[:, None, :]
        inverse = np.linalg.solve(scaled, np.broadcast_to(np.eye(N_MOTION), scaled.shape))
        return np.asarray(inverse * scale[:, :, None] * scale[:, None, :])

    def _rates(self) -> Array:
        return np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -self.stiffness, -self.decay]])


def quintic_basis(fraction: Array, step: Array) -> tuple[Array, Array]:
    """Weights of the states at both ends of an interval for what lies between: the conditional mean of white jerk.

    fraction (N,) 0..1 of the interval, step (N,) s. Returns two (N, 3, 3), [i, j] the weight of component j (position,
    velocity, acceleration) of the left and of the right end for component i at the time between.
    Source: quintic Hermite interpolation; Barfoot, State Estimation for Robotics, 2nd ed., 11.1.4 (white jerk).
    """
    zero = np.zeros((N_MOTION, N_MOTION, 6))
    left, right = zero.copy(), zero.copy()
    left[0] = np.array([[1.0, 0, 0, -10, 15, -6], [0, 1, 0, -6, 8, -3], [0, 0, 0.5, -1.5, 1.5, -0.5]])
    right[0] = np.array([[0.0, 0, 0, 10, -15, 6], [0, 0, 0, -4, 7, -3], [0, 0, 0, 0.5, -1, 0.5]])
    for coefficients in (left, right):
        for i in (1, 2):
            coefficients[i, :, :-1] = coefficients[i - 1, :, 1:] * np.arange(1, 6)
    powers = fraction[:, None] ** np.arange(6)
    safe = np.where(step > 0.0, step, 1.0)[:, None, None]
    unit = safe ** (np.arange(N_MOTION)[None, None, :] - np.arange(N_MOTION)[None, :, None])
    return np.einsum("ijp,np->nij", left, powers) * unit, np.einsum("ijp,np->nij", right, powers) * unit


def _series(dt: Array, terms: list[Array]) -> Array:
    powers = dt[:, None] ** np.arange(len(terms))
    return np.asarray((powers @ np.stack(terms).reshape(len(terms), -1)).reshape(-1, *terms[0].shape))
