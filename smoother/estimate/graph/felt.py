"""What box and antenna felt between the keyframes, as the rows tell it, and how unsure that makes the antenna's motion.

Rates are noisier than anything else: on an arm of a metre, a gyro on a kart swings the antenna by 0.1 m/s that are not
there. So rows have the rates and accelerations that are the most probable given the whole session, as the
graph has them where it reads Doppler, and the velocity of the antenna is as unsure as these are.
"""

from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.expected import DopplerNoise, expected_motion, expected_tilting
from smoother.estimate.model.imu import DensePath, at_times
from smoother.estimate.model.inertial_noise import InertialNoise
from smoother.frames import UP_N


@dataclass(frozen=True, eq=False)
class Felt:
    """acceleration_n (M, 3) m/s^2 and rate_n (M, 3) rad/s at the edges t (M,) s of a path.

    tilting, turning: variances, (rad/s)^2, of the errors of rates about level axes and about up. is_steered: the box
    tilts on the steering wheel, and the kart that the arm keeps to does not.
    """

    path: DensePath
    acceleration_n: Array
    rate_n: Array
    tilting: float
    turning: float
    is_steered: bool = False

    def acceleration_at(self, t: Array) -> Array:
        """Acceleration (N, 3) m/s^2 in n at t (N,) s."""
        return at_times(self.path, self.acceleration_n, t)

    def rate_at(self, t: Array) -> Array:
        """Angular rate (N, 3) rad/s in n at t (N,) s."""
        return at_times(self.path, self.rate_n, t)

    def swing_at(self, t: Array) -> Array:
        """Angular rate (N, 3) rad/s in n, at t (N,) s, with which the arm swings the antenna."""
        rate_n = self.rate_at(t)
        return rate_n * UP_N if self.is_steered else rate_n


def felt_on(
    path: DensePath,
    level_axes_s: Array,
    noise: InertialNoise,
    doppler: DopplerNoise | None,
    interval: float,
    upwards: DopplerNoise | None = None,
    *,
    is_steered: bool = False,
) -> Felt:
    """Return what is most probable given `path`; arguments as for :func:`expected.expected_motion`."""
    expected = expected_motion(
        path, level_axes_s, noise, doppler, interval, upwards, is_steered=is_steered, with_slopes=False
    )
    tilt_rates, tilting = expected_tilting(path, level_axes_s, noise)
    rates_b = np.column_stack([tilt_rates, expected.turn_rate])
    rate_n = np.einsum("kij,kj->ki", path.R_ns @ level_axes_s.T, rates_b)
    rate_n[:, 2] = expected.turn_rate
    return Felt(path, expected.acceleration_n, rate_n, tilting, expected.turn_variance, is_steered)


def swing_covariance(felt: Felt, arm_n: Array) -> Array:
    """Covariance (N, 3, 3) m^2/s^2 of what the rates swing the antenna by on the arms arm_n (N, 3), by their errors."""
    by_rate = so3.skew(arm_n)
    return np.asarray((by_rate * [felt.tilting, felt.tilting, felt.turning]) @ by_rate.transpose(0, 2, 1))
