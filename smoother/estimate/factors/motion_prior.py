"""Motion prior of an interval without inertial samples, in place of the IMU factor.

The kart follows the path of the fixes with white noise of acceleration and turn rate, the smaller the closer the fixes
are. Tilt and slip relative to the course are Gauss-Markov processes, and the biases are random walks. Source: Barfoot
2017, State Estimation for Robotics, 3.4.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.motion import course_of
from smoother.estimate.model.state import ACCEL_BIAS, GYRO_BIAS, ROTATION, TRANSLATION, VELOCITY, State
from smoother.frames import UP_N, wrap_angle

MOSTLY = 0.5  # share without samples, above which an interval has the motion prior
# densities per axis of n: a kart brakes and corners with 5 m/s^2 rms for about a second, and turns with 0.5 rad/s
ACCELERATION = np.array([6.0, 6.0, 1.0])  # m/s^2/sqrt(Hz)
TURN_RATE = 0.5  # rad/s/sqrt(Hz), about up
LASTING = 1.0  # s, time constant of tilt and slip
MOVING = 4.0  # m/s, above which a course is defined
SLIP = 0.05  # rad between the kart and its course
TILT = 0.06  # rad: slopes, lean in bends, and the error of the alignment


@dataclass(frozen=True, eq=False)
class Unsampled:
    """Intervals `at` (M,) without samples, and how they pass along the path of the fixes.

    turn (M,) rad about up; gain_n (M, 3) m/s of velocity; loose (M,): relative uncertainty of both, 1 far from any fix:
    the error of linear interpolation grows with the square of the time. follows (M,): whether the first level axis
    points along the course, and the course is defined there.
    """

    at: IntArray
    turn: Array
    gain_n: Array
    loose: Array
    follows: BoolArray

    @staticmethod
    def of(missing: Array, path: State, fixes: Array, *, follows: bool) -> "Unsampled":
        """missing (K-1,): shares without samples; path: keyframes along the fixes; fixes (N,) s: times of these.
        follows: whether the first level axis points along the course.
        """
        at = np.flatnonzero(missing >= MOSTLY)
        gain_n, turn = np.diff(path.velocity_n, axis=0)[at], np.diff(course_of(path))[at]
        beyond = np.concatenate([[-np.inf], fixes, [np.inf]])
        after = np.searchsorted(beyond, 0.5 * (path.t[at] + path.t[at + 1]))
        loose = np.minimum(((beyond[after] - beyond[after - 1]) / LASTING) ** 2, 1.0)
        drives = np.minimum(_speed(path)[at], _speed(path)[at + 1]) > MOVING
        return Unsampled(at, turn, gain_n, loose, follows & drives & (loose < 1.0))

    def between(self, first: int, last: int) -> "Unsampled":
        """Of the keyframes first to last, exclusive, counted from the first."""
        use: BoolArray = (self.at >= first) & (self.at < last - 1)
        return Unsampled(self.at[use] - first, self.turn[use], self.gain_n[use], self.loose[use], self.follows[use])


def motion_prior_rows(state: State, unsampled: Unsampled, accel_walk: float, gyro_walk: float) -> Rows:
    """Rows of 15 for intervals without samples: steps of the Gauss-Markov processes of tilt, two, and slip, rad;
    change of position minus that of the mean velocity, m, of velocity, m/s, of both biases. accel_walk
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
    course, by_rotation, by_velocity = _course(state)
    slips = wrap_angle(course[two] - phi * wrap_angle(course[one]))
    follows = unsampled.follows
    turned = np.where(follows, slips, np.einsum("kj,kj->k", R[:, 2], turn) - unsampled.turn)
    residual = np.hstack([tilt[1] - phi * tilt[0], turned[:, None], sway, gain, *walk])
    loose, new = unsampled.loose[:, None], math.sqrt(1.0 - phi**2)
    tilts = np.full((len(at), 2), TILT * new)
    turns = np.where(follows, SLIP * new, unsampled.loose * math.sqrt(T) * TURN_RATE)[:, None]
    walks = np.broadcast_to(np.repeat(math.sqrt(T) * np.array([accel_walk, gyro_walk]), 3), (len(at), 6))
    sway_sigma, gain_sigma = math.sqrt(T**3 / 12.0) * ACCELERATION, math.sqrt(T) * ACCELERATION
    sigma = np.hstack([tilts, turns, loose * sway_sigma, loose * gain_sigma, walks])
    left, right = no_jacobian(len(at), 15)
    half, square = 0.5 * so3.skew(turn), so3.skew(turn) @ so3.skew(turn) / 12.0  # inverse Jacobians of SO(3), in series
    inverse = np.einsum("kj,kji->ki", R[:, 2], eye + half + square)
    left[:, 2, ROTATION] = np.where(follows[:, None], -phi * by_rotation[one], -inverse)
    right[:, 2, ROTATION] = np.where(follows[:, None], by_rotation[two], inverse)
    left[:, 2, VELOCITY], right[:, 2, VELOCITY] = -phi * by_velocity[one], by_velocity[two]
    left[~follows, 2, VELOCITY] = right[~follows, 2, VELOCITY] = 0.0
    across = so3.skew(up_s)
    left[:, 0:2, ROTATION], right[:, 0:2, ROTATION] = phi * R[:, :2] @ across, -state.R_ns[two][:, :2] @ across
    left[:, 3:6, TRANSLATION], right[:, 3:6, TRANSLATION] = -R, state.R_ns[two]
    left[:, 3:6, VELOCITY] = right[:, 3:6, VELOCITY] = -0.5 * T * eye
    for rows, columns in ((slice(6, 9), VELOCITY), (slice(9, 12), ACCEL_BIAS), (slice(12, 15), GYRO_BIAS)):
        left[:, rows, columns], right[:, rows, columns] = -eye, eye
    return rows_of("motion_prior", at, residual, sigma, left, right)


def _speed(state: State) -> Array:
    return np.hypot(state.velocity_n[:, 0], state.velocity_n[:, 1])


def _course(state: State) -> tuple[Array, Array, Array]:
    """Angle (K,) rad from the first level axis to the course, and its slopes by rotation and velocity, (K, 3) each."""
    v, ahead_s = state.velocity_n, state.geometry.level_axes_s[0]
    ahead_n, turned_n = state.R_ns @ ahead_s, -state.R_ns @ so3.skew(ahead_s)
    yaw = (ahead_n[:, 0, None] * turned_n[:, 1] - ahead_n[:, 1, None] * turned_n[:, 0]) / np.sum(
        ahead_n[:, :2] ** 2, axis=1, keepdims=True
    )
    angle = np.arctan2(v[:, 1], v[:, 0]) - np.arctan2(ahead_n[:, 1], ahead_n[:, 0])
    across_n = np.cross(UP_N, v) / np.maximum(_speed(state), MOVING)[:, None] ** 2
    return wrap_angle(angle), -yaw, across_n
