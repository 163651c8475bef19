"""Motion prior: what a kart may do in an interval without inertial samples; it stands where the IMU factor would.

White noise of acceleration and of turn rate: positions and velocities of neighbours belong together, attitudes stay
about what they are, and the biases walk on. Source: Barfoot 2017, State Estimation for Robotics, 3.4.
"""

import math

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.state import ACCEL_BIAS, GYRO_BIAS, ROTATION, TRANSLATION, VELOCITY, State

# densities per axis of n: a kart brakes and corners with 5 m/s^2 rms for about a second, and turns with 0.5 rad/s
ACCELERATION = np.array([6.0, 6.0, 1.0])  # m/s^2/sqrt(Hz)
TURN_RATE = np.array([0.05, 0.05, 0.5])  # rad/s/sqrt(Hz)


def motion_prior_rows(state: State, at: IntArray, accel_walk: float, gyro_walk: float) -> Rows:
    """Rows of 15 for the intervals `at` (M,): turn in n, rad; change of position beyond that of the mean velocity, m;
    of velocity, m/s; of both biases. accel_walk m/s^2/sqrt(s), gyro_walk rad/s/sqrt(s): densities of the biases' walks.
    """
    T, R, one, two = state.interval, state.R_ns[at], at, at + 1
    turn = so3.log(R.transpose(0, 2, 1) @ state.R_ns[two])
    sway = state.position_n[two] - state.position_n[one] - 0.5 * T * (state.velocity_n[one] + state.velocity_n[two])
    pull, eye = state.velocity_n[two] - state.velocity_n[one], np.eye(3)
    walk = [getattr(state, name)[two] - getattr(state, name)[one] for name in ("accel_bias_s", "gyro_bias_s")]
    residual = np.hstack([np.einsum("kij,kj->ki", R, turn), sway, pull, *walk])
    sigma = np.concatenate(
        [
            math.sqrt(T) * TURN_RATE,
            math.sqrt(T**3 / 12.0) * ACCELERATION,
            math.sqrt(T) * ACCELERATION,
            np.repeat(math.sqrt(T) * np.array([accel_walk, gyro_walk]), 3),
        ]
    )
    left, right = no_jacobian(len(at), 15)
    half, square = 0.5 * so3.skew(turn), so3.skew(turn) @ so3.skew(turn) / 12.0  # inverse Jacobians of SO(3), in series
    left[:, 0:3, ROTATION], right[:, 0:3, ROTATION] = -R @ (eye + half + square), R @ (eye + half + square)
    left[:, 3:6, TRANSLATION], right[:, 3:6, TRANSLATION] = -R, state.R_ns[two]
    left[:, 3:6, VELOCITY] = right[:, 3:6, VELOCITY] = -0.5 * T * eye
    for rows, columns in ((slice(6, 9), VELOCITY), (slice(9, 12), ACCEL_BIAS), (slice(12, 15), GYRO_BIAS)):
        left[:, rows, columns], right[:, rows, columns] = -eye, eye
    return rows_of("motion_prior", at, residual, sigma, left, right)


def unsampled(missing: Array) -> IntArray:
    """Intervals of missing (K-1,), the shares without samples, whose motion no sample shows."""
    return np.flatnonzero(missing >= MOSTLY)


MOSTLY = 0.5
