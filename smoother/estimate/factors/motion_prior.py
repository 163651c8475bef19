"""Motion prior: what a kart may do in an interval without inertial samples; it stands where the IMU factor would.

It goes on along the path of the fixes, give or take white noise of acceleration and of turn rate: the less, the closer
fixes are around it. The kart is level but for a tilt that is a Gauss-Markov process, it turns with its course, and the
biases walk on. Source: Barfoot 2017, State Estimation for Robotics, 3.4.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.factors.antenna import course_of
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.state import ACCEL_BIAS, GYRO_BIAS, ROTATION, TRANSLATION, VELOCITY, State

MOSTLY = 0.5  # share without samples from which on an interval counts as one without
# densities per axis of n: a kart brakes and corners with 5 m/s^2 rms for about a second, and turns with 0.5 rad/s
ACCELERATION = np.array([6.0, 6.0, 1.0])  # m/s^2/sqrt(Hz)
TURN_RATE = 0.5  # rad/s/sqrt(Hz), about up
LASTING = 1.0  # s for which it does so, and is tilted alike
TILT = 0.06  # rad: slopes, lean in bends, and how well an alignment knows level


@dataclass(frozen=True, eq=False)
class Unsampled:
    """Intervals `at` (M,) without samples, and how they pass along the path of the fixes: turn (M,) rad about up and
    gain_n (M, 3) m/s of velocity; loose (M,): how uncertain that is, 1 where no fix is
    near: what acceleration changes by between fixes, in proportion to the time, lasts for the root of it.
    """

    at: IntArray
    turn: Array
    gain_n: Array
    loose: Array

    @staticmethod
    def of(missing: Array, path: State, fixes: Array) -> "Unsampled":
        """missing (K-1,): shares without samples; path: keyframes along the fixes; fixes (N,) s: times of these."""
        at = np.flatnonzero(missing >= MOSTLY)
        gain_n, turn = np.diff(path.velocity_n, axis=0)[at], np.diff(course_of(path))[at]
        beyond = np.concatenate([[-np.inf], fixes, [np.inf]])
        after = np.searchsorted(beyond, 0.5 * (path.t[at] + path.t[at + 1]))
        return Unsampled(at, turn, gain_n, np.minimum(((beyond[after] - beyond[after - 1]) / LASTING) ** 1.5, 1.0))

    def between(self, first: int, last: int) -> "Unsampled":
        """Of the keyframes first to last, exclusive, counted from the first."""
        use: BoolArray = (self.at >= first) & (self.at < last - 1)
        return Unsampled(self.at[use] - first, self.turn[use], self.gain_n[use], self.loose[use])


def motion_prior_rows(state: State, unsampled: Unsampled, accel_walk: float, gyro_walk: float) -> Rows:
    """Rows of 15 for intervals without samples: tilt beyond what is left of the last one, two, and turn about up, rad;
    change of position beyond that of the mean velocity, m, of velocity, m/s, of both biases. accel_walk
    m/s^2/sqrt(s), gyro_walk rad/s/sqrt(s): densities of the biases' walks.
    """
    at = unsampled.at
    T, R, one, two = state.interval, state.R_ns[at], at, at + 1
    turn = so3.log(R.transpose(0, 2, 1) @ state.R_ns[two])
    sway = state.position_n[two] - state.position_n[one] - 0.5 * T * (state.velocity_n[one] + state.velocity_n[two])
    gain, eye = state.velocity_n[two] - state.velocity_n[one] - unsampled.gain_n, np.eye(3)
    walk = [getattr(state, name)[two] - getattr(state, name)[one] for name in ("accel_bias_s", "gyro_bias_s")]
    up_s, phi = state.geometry.level_axes_s[2], math.exp(-T / LASTING)
    tilt = [R_ns[:, :2] @ up_s for R_ns in (R, state.R_ns[two])]
    turned = np.einsum("kj,kj->k", R[:, 2], turn)[:, None] - unsampled.turn[:, None]
    residual = np.hstack([tilt[1] - phi * tilt[0], turned, sway, gain, *walk])
    own = np.concatenate(
        [[math.sqrt(T) * TURN_RATE], math.sqrt(T**3 / 12.0) * ACCELERATION, math.sqrt(T) * ACCELERATION]
    )
    tilts = np.full((len(at), 2), TILT * math.sqrt(1.0 - phi**2))
    walks = np.broadcast_to(np.repeat(math.sqrt(T) * np.array([accel_walk, gyro_walk]), 3), (len(at), 6))
    sigma = np.hstack([tilts, unsampled.loose[:, None] * own, walks])
    left, right = no_jacobian(len(at), 15)
    half, square = 0.5 * so3.skew(turn), so3.skew(turn) @ so3.skew(turn) / 12.0  # inverse Jacobians of SO(3), in series
    left[:, 2, ROTATION] = np.einsum("kj,kji->ki", R[:, 2], -(eye + half + square))
    right[:, 2, ROTATION] = np.einsum("kj,kji->ki", R[:, 2], eye + half + square)
    across = so3.skew(up_s)
    left[:, 0:2, ROTATION], right[:, 0:2, ROTATION] = phi * R[:, :2] @ across, -state.R_ns[two][:, :2] @ across
    left[:, 3:6, TRANSLATION], right[:, 3:6, TRANSLATION] = -R, state.R_ns[two]
    left[:, 3:6, VELOCITY] = right[:, 3:6, VELOCITY] = -0.5 * T * eye
    for rows, columns in ((slice(6, 9), VELOCITY), (slice(9, 12), ACCEL_BIAS), (slice(12, 15), GYRO_BIAS)):
        left[:, rows, columns], right[:, rows, columns] = -eye, eye
    return rows_of("motion_prior", at, residual, sigma, left, right)
