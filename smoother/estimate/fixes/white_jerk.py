"""How a vehicle moves along one axis: white jerk, damped so that gaps stay bounded.

Over tenths of a second the process is white jerk; over seconds the acceleration and then the velocity return to zero,
as they do on a closed track. Undamped, it would carry the curvature at the edge of a 60 s outage far off the track.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from smoother.arrays import Array

ORDER = 3  # position, velocity, acceleration
TERMS = 26  # of the power series, which hold to 1e-9 for steps up to 0.6 s
# 1/s, 1/s^2: where the series hold and the chain stays well conditioned
DECAYS, STIFFNESSES = (0.3, 5.0), (0.01, 6.0)
NANOSECOND_DIGITS = 9


@dataclass(frozen=True)
class WhiteJerk:
    """Stationary velocity process `v'' + decay v' + stiffness v = white jerk` of one axis.

    density m/s^3/sqrt(Hz); velocity m/s and acceleration m/s^2, the stationary standard deviations: var(a) =
    S / (2 decay) and var(v) = var(a) / stiffness, with S the squared density (harmonic oscillator in white noise, e.g.
    Särkkä & Solin 2019, 4.3 and 6.2).
    """

    density: float
    velocity: float
    acceleration: float

    def discrete(self, dt: Array) -> tuple[Array, Array]:
        """Transition of the state over steps dt (K,) s, and its covariance from a known state, (K, 3, 3) each.

        Both come out of one matrix exponential. Source: Van Loan 1978.
        """
        decay = float(np.clip(0.5 * (self.density / self.acceleration) ** 2, *DECAYS))
        stiffness = float(np.clip((self.acceleration / self.velocity) ** 2, *STIFFNESSES))
        rates = np.zeros((2 * ORDER, 2 * ORDER))
        rates[ORDER:, ORDER:] = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, -stiffness, -decay]]).T
        rates[:ORDER, :ORDER] = -rates[ORDER:, ORDER:].T
        rates[2, 5] = self.density**2
        terms, power = [], np.eye(2 * ORDER)
        for k in range(TERMS):
            terms.append(power / factorial(k))
            power = power @ rates
        series = np.vander(dt, TERMS, increasing=True) @ np.reshape(terms, (TERMS, -1))
        both = series.reshape(-1, 2 * ORDER, 2 * ORDER)
        transition = both[:, ORDER:, ORDER:].transpose(0, 2, 1)
        return transition, np.asarray(transition @ both[:, :ORDER, ORDER:])

    def whitened(self, dt: Array) -> tuple[Array, Array]:
        """Transition (K, 3, 3) and root W (K, 3, 3) of its information, W'W, taken at the scale of each step, because
        the covariance spans dt^5 to dt.
        """
        some, which = np.unique(np.round(dt, NANOSECOND_DIGITS), return_inverse=True)  # receivers are punctual
        transition, covariance = self.discrete(some)
        scale = some[:, None] ** np.array([-2.5, -1.5, -0.5])
        root: Array = np.asarray(np.linalg.inv(np.linalg.cholesky(covariance * scale[:, :, None] * scale[:, None, :])))
        return transition[which], (root * scale[:, None, :])[which]


def quintic_basis(fraction: Array, step: Array, components: tuple[int, ...] = (0, 1, 2)) -> tuple[Array, Array]:
    """Weights of the states at both ends of an interval for what lies between: the conditional mean of white jerk.

    fraction (N,) 0..1 of the interval, step (N,) s; components of what is wanted, n of position, velocity and
    acceleration. Returns two (N, n, 3), [i, j] the weight of component j of the left and of the right end.
    Source: quintic Hermite interpolation; Barfoot, State Estimation for Robotics, 2nd ed., 11.1.4 (white jerk).
    """
    left, right = np.zeros((ORDER, ORDER, 6)), np.zeros((ORDER, ORDER, 6))
    left[0] = np.array([[1.0, 0, 0, -10, 15, -6], [0, 1, 0, -6, 8, -3], [0, 0, 0.5, -1.5, 1.5, -0.5]])
    right[0] = np.array([[0.0, 0, 0, 10, -15, 6], [0, 0, 0, -4, 7, -3], [0, 0, 0, 0.5, -1, 0.5]])
    for coefficients in (left, right):
        for i in (1, 2):
            coefficients[i, :, :-1] = coefficients[i - 1, :, 1:] * np.arange(1, 6)
    wanted = np.asarray(components)
    exponent = np.arange(ORDER)[None, :] - wanted[:, None]
    unit = np.where(step > 0.0, step, 1.0)[:, None, None] ** exponent
    powers = np.vander(fraction, 6, increasing=True)
    shape = (fraction.size, wanted.size, ORDER)
    return tuple((powers @ c[wanted].reshape(-1, 6).T).reshape(shape) * unit for c in (left, right))
