"""What a graph is given beside the state it is linearised at: its noise, what is known beforehand, measurements."""

import math
from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array
from smoother.estimate.graph.slip import (
    SlipNoise,
)
from smoother.estimate.graph.state import (
    ACCEL_ERROR,
    GYRO_ERROR,
    RECTIFICATION,
)
from smoother.estimate.model.inertial_noise import InertialNoise
from smoother.fit.noise_spread import ANY_NOISE

SENSOR_ERRORS = (ACCEL_ERROR, GYRO_ERROR, RECTIFICATION)


@dataclass(frozen=True, eq=False)
class Told:
    """How well a session tells its noise: sigmas of the logarithms of densities of force and rate, and per axis of the
    sigmas of position and velocity, (3,).

    wandered (3,) m^2: what the offset of the fixes adds to their white noise by going its way between keyframes, beside
    the straight line that is taken for it there. hidden (3,) m: how far it may go unseen beneath that noise.
    """

    accel: float = ANY_NOISE
    gyro: float = ANY_NOISE
    position: Array = field(default_factory=lambda: np.full(3, ANY_NOISE))
    velocity: Array = field(default_factory=lambda: np.full(3, ANY_NOISE))
    wandered: Array = field(default_factory=lambda: np.zeros(3))
    hidden: Array = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, eq=False)
class Noise:
    """Everything the graph assumes about noise. Arrays (3,) are sigmas per axis of n.

    inertial: densities of the samples' noise, and walks of the biases.
    position, velocity (3,) m, m/s: white noise of fixes; where velocities' errors last, level ones count with `counted`
        times that (lasting.py).
    offset_sigma (3,) m, offset_tau s: the Gauss-Markov error of the fixes. offset_tau_spread: sigma of the logarithm of
        offset_tau where the session tells it, infinite where it is the population's.
    offset_most (3,) m: what offset_sigma may be found to be at most, of a receiver that fixes carrier phases.
    sensor_error (3,): spread of the entries of accel_error and gyro_error (scale and misalignment, no unit) and of
        rectification, m/s^2.
    slip: of the wheels, None where they are not asked. told: how well it is known.
    """

    inertial: InertialNoise
    position: Array
    velocity: Array
    offset_sigma: Array
    offset_tau: float
    sensor_error: Array
    offset_tau_spread: float = math.inf
    slip: SlipNoise | None = None
    offset_most: Array = field(default_factory=lambda: np.full(3, np.inf))
    counted: float = 1.0
    told: Told = field(default_factory=Told)

    @property
    def of_velocities(self) -> Array:
        """Sigma (3,) m/s with which a velocity counts."""
        return np.asarray(self.velocity * [self.counted, self.counted, 1.0])


@dataclass(frozen=True, eq=False)
class Priors:
    """What is known beforehand.

    accel_bias m/s^2, gyro_bias rad/s: sigmas of the biases, whose means are zero and gyro_bias_mean (3,) rad/s.
    constants, constants_sigma (31,): mean and sigma of the constants of the session, in the order of state.py.
    holds_height: the lever arm's height stays at its mean. A kart leans by few degrees, and how far is hardly better
        known than that: a height fitted to it is drawn to zero and seems to be known.
    has_height: some fix has a height.
    drives: the kart went at a speed that tells the constants; what they fit at rest is noise, and its covariance too.
    """

    accel_bias: float
    gyro_bias: float
    gyro_bias_mean: Array
    constants: Array
    constants_sigma: Array
    holds_height: bool = False
    has_height: bool = True
    drives: bool = True


def constants_sigma(priors: Priors, noise: Noise) -> Array:
    """Prior sigma (31,) of all constants."""
    sigma = priors.constants_sigma.copy()
    for part, spread in zip(SENSOR_ERRORS, noise.sensor_error, strict=True):
        sigma[part] = spread
    return sigma
