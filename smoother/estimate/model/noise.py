"""How noisy the sensors of a session are, as its graph takes it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from smoother.arrays import Array
from smoother.estimate.model.inertial_noise import InertialNoise


@dataclass(frozen=True, eq=False)
class Noise:
    """inertial: densities of the samples and walks of the biases. position m, velocity m/s (3,): white noise of fixes,
    per axis of n. offset_sigma (3,) m, offset_tau s: the slow error of the fixes, a Gauss-Markov process; offset_most
    (3,) m: what its sigma may be found to be at most. slip rad: sideslip in a hard corner, None without wheels.
    constants: prior sigmas by name that are found with the noise. sigmas: of the rows of factors whose sigma is found
    from their residuals alone, by the factor's name. offset_tau_spread: sigma of the logarithm of
    offset_tau where the session shows it, infinite where it is the population's.
    """

    inertial: InertialNoise
    position: Array
    velocity: Array
    offset_sigma: Array
    offset_tau: float
    slip: float | None = None
    constants: Mapping[str, Array] = field(default_factory=dict)
    offset_most: Array = field(default_factory=lambda: np.full(3, np.inf))
    offset_tau_spread: float = math.inf
    sigmas: Mapping[str, float] = field(default_factory=dict)
