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
LONGEST_STEP = 0.6  # s; the power series below hold to 1e-9 for it
_TERMS = 26
_DECAYS, _STIFFNESSES = (
    (0.3, 5.0),
    (0.01, 6.0),
)  # 1/s, 1/s^2: where the series hold and the chain stays well conditioned


@dataclass(frozen=True)
class MotionPrior:
    """Stationary velocity process `v'' + decay v' + stiffness v = white jerk` of one axis.

    jerk_density m/s^3/sqrt(Hz); velocity_sigma m/s and acceleration_sigma m/s^2, the stationary standard deviations:
    var(a) = S / (2 decay) and var(v) = var(a) / stiffness, with S the squared density (harmonic oscillator in white
    noise, e.g. Särkkä & Solin 2019, 4.3 and 6.2).
    """

    jerk_density: float
    velocity_sigma: float
    acceleration_sigma: float

    @property
    def decay(self) -> float:
        """Rate at which acceleration is forgotten, 1/s."""
        return float(np.clip(0.5 * (self.jerk_density / self.acceleration_sigma) ** 2, *_DECAYS))

    @property
    def stiffness(self) -> float:
        """Squared angular frequency at which velocity returns to zero, 1/s^2."""
        return float(np.clip((self.acceleration_sigma / self.velocity_sigma) ** 2, *_STIFFNESSES))

    def transition(self, dt: Array) -> Array:
        """Transition of the state over steps dt (K,) s up to LONGEST_STEP. Returns (K, 3, 3)."""
        terms, power, rates = [], np.eye(N_MOTION), self._rates()
        for k in range(_TERMS):
            terms.append(power / factorial(k))
            power = power @ rates
        return _series(dt, terms)

    def covariance(self, dt: Array) -> Array:
        """Covariance of the state after steps dt (K,) s from a known state. Returns (K, 3, 3)."""
        terms, moment, rates = [np.zeros((N_MOTION, N_MOTION))], np.zeros((N_MOTION, N_MOTION)), self._rates()
        moment[2, 2] = self.jerk_density**2
        for k in range(1, _TERMS):
            terms.append(moment / factorial(k))
            moment = rates @ moment + moment @ rates.T
        return _series(dt, terms)

    def information(self, dt: Array) -> Array:
        """Inverse of :meth:`covariance`, (K, 3, 3), computed at the scale of each step because it spans dt^5 to dt."""
        scale = dt[:, None] ** np.array([-2.5, -1.5, -0.5])
        scaled = self.covariance(dt) * scale[:, :, None] * scale[:, None, :]
        return np.asarray(_inverse_symmetric(scaled) * scale[:, :, None] * scale[:, None, :])

    def _rates(self) -> Array:
        return np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -self.stiffness, -self.decay]])


def quintic_basis(fraction: Array, step: Array, components: tuple[int, ...] = (0, 1, 2)) -> tuple[Array, Array]:
    """Weights of the states at both ends of an interval for what lies between: the conditional mean of white jerk.

    fraction (N,) 0..1 of the interval, step (N,) s; components of what is wanted, n of position, velocity and
    acceleration. Returns two (N, n, 3), [i, j] the weight of component j of the left and of the right end.
    Source: quintic Hermite interpolation; Barfoot, State Estimation for Robotics, 2nd ed., 11.1.4 (white jerk).
    """
    left, right = np.zeros((N_MOTION, N_MOTION, 6)), np.zeros((N_MOTION, N_MOTION, 6))
    left[0] = np.array([[1.0, 0, 0, -10, 15, -6], [0, 1, 0, -6, 8, -3], [0, 0, 0.5, -1.5, 1.5, -0.5]])
    right[0] = np.array([[0.0, 0, 0, 10, -15, 6], [0, 0, 0, -4, 7, -3], [0, 0, 0, 0.5, -1, 0.5]])
    for coefficients in (left, right):
        for i in (1, 2):
            coefficients[i, :, :-1] = coefficients[i - 1, :, 1:] * np.arange(1, 6)
    wanted = np.asarray(components)
    exponent = np.arange(N_MOTION)[None, :] - wanted[:, None]
    unit = np.where(step > 0.0, step, 1.0)[:, None, None] ** exponent
    powers = _powers(fraction, 6)
    shape = (fraction.size, wanted.size, N_MOTION)
    return tuple((powers @ c[wanted].reshape(-1, 6).T).reshape(shape) * unit for c in (left, right))


def _powers(values: Array, count: int) -> Array:
    powers = np.ones((values.size, count))
    powers[:, 1:] = values[:, None]
    return np.asarray(np.cumprod(powers, axis=1))


def _series(dt: Array, terms: list[Array]) -> Array:
    coefficients = np.stack(terms).reshape(len(terms), -1)
    return np.asarray((_powers(dt, len(terms)) @ coefficients).reshape(-1, *terms[0].shape))


def _inverse_symmetric(m: Array) -> Array:
    """Inverse of well-scaled symmetric matrices (K, 3, 3) by cofactors; twenty times faster than a stacked solve."""
    a, b, c, d, e, f = m[:, 0, 0], m[:, 0, 1], m[:, 0, 2], m[:, 1, 1], m[:, 1, 2], m[:, 2, 2]
    A, B, C, D, E, F = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    determinant = a * A + b * B + c * C
    rows = [np.stack([A, B, C], axis=-1), np.stack([B, D, E], axis=-1), np.stack([C, E, F], axis=-1)]
    return np.asarray(np.stack(rows, axis=-2) / determinant[:, None, None])
