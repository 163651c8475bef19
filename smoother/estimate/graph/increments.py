"""Residuals and Jacobians of GTSAM's CombinedImuFactor for all intervals at once.

What the samples of an interval add up to, and how that changes with the biases, is found once. The residual at any
state is then a few products of small matrices: for whole sessions cheaper than the way of every single factor and value
through Python into GTSAM and back, and the same numbers.

Source: GTSAM, TangentPreintegration and CombinedImuFactor; Barfoot 2017, 7.1.5 and 7.3 for the Jacobians.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.imu import BinnedImu
from smoother.estimate.graph.state import ACCEL_BIAS, GYRO_BIAS, ROTATION, TRANSLATION, VELOCITY, ChainState
from smoother.frames import GRAVITY_N

_MOTION, _BIASES = slice(ROTATION.start, VELOCITY.stop), slice(ACCEL_BIAS.start, GYRO_BIAS.stop)


@dataclass(frozen=True, eq=False)
class Increments:
    """What the bins of N intervals of T s, less the biases accel_bias, gyro_bias (3,), add up to.

    turn (N, 3): rotation vector from the left to the right keyframe; shift (N, 2, 3): position m and velocity m/s
    gained, gravity apart, in the axes of the left one; by_bias (N, 3, 3, 6): slopes of turn, position and velocity.
    """

    T: float
    accel_bias: Array
    gyro_bias: Array
    turn: Array
    shift: Array
    by_bias: Array


# what damaged files hold turns by more than a float has digits for; the solver says so when it meets the numbers
_quietly = np.errstate(over="ignore", invalid="ignore")


@_quietly
def increments(binned: BinnedImu, accel_bias: Array, gyro_bias: Array) -> Increments:
    """Add up the bins about the biases (3,), m/s^2 and rad/s."""
    n, n_bins, _ = binned.specific_force_s.shape
    dt = binned.dt
    turn, position, velocity = np.zeros((3, 3, n))
    of_turn, of_position, of_velocity = np.zeros((3, 3, 6, n))
    forces, rates = _ahead(binned.specific_force_s - accel_bias), _ahead(binned.angular_rate_s - gyro_bias)
    for force, rate in zip(forces, rates, strict=True):
        R, inverse = _ahead(so3.exp(turn.T)), _ahead(left_jacobian_inverse(-turn.T))
        pushed, turned = _times(R, force), _times(inverse, rate)
        leant = _times(_ahead(so3.skew(force.T)), _ahead(right_jacobian(turn.T)))
        of_pushed = -_times(_times(R, leant), of_turn)
        of_pushed[:, 0:3] -= R
        of_position += dt * of_velocity + 0.5 * dt**2 * of_pushed
        of_velocity += dt * of_pushed
        of_turn -= dt * _times(_ahead(slope_of_inverse(-turn.T, rate.T)), of_turn)
        of_turn[:, 3:6] -= dt * inverse
        position += dt * velocity + 0.5 * dt**2 * pushed
        velocity += dt * pushed
        turn += dt * turned
    shift, slopes = np.stack([position, velocity]), np.stack([of_turn, of_position, of_velocity])
    return Increments(n_bins * dt, accel_bias, gyro_bias, *(_behind(values) for values in (turn, shift, slopes)))


def _ahead(values: Array) -> Array:
    """(N, ...) -> (..., N): intervals side by side, in which products of small matrices are many at once."""
    return np.ascontiguousarray(np.moveaxis(values, 0, -1))


def _behind(values: Array) -> Array:
    """(..., N) -> (N, ...)."""
    return np.ascontiguousarray(np.moveaxis(values, -1, 0))


def _times(one: Array, other: Array) -> Array:
    """Products of matrices (3, 3, N) with matrices (3, m, N) or vectors (3, N)."""
    return np.asarray(np.einsum("ijk,j...k->i...k", one, other))


def in_left_axes(done: Increments, root: Array, part: slice) -> Array:
    """Whitening matrices (n, 15, 15) for residuals of the intervals `part`, from those of the increments, `root`.

    A residual is in the axes of the right keyframe and of opposite sign in the biases; the covariance of the increments
    is that of the rotation vector and in the axes of the left one.
    """
    dR, out = so3.exp(done.turn[part]), root.copy()
    out[:, :, ROTATION] = root[:, :, ROTATION] @ left_jacobian_inverse(done.turn[part]).transpose(0, 2, 1)
    for columns in (TRANSLATION, VELOCITY):
        out[:, :, columns] = root[:, :, columns] @ dR
    out[:, :, _BIASES] *= -1.0
    return np.asarray(out)


@dataclass(frozen=True, eq=False)
class LinearIncrements:
    """Residuals (N, 15) of all intervals, not whitened, and the parts of their Jacobians by left and right keyframe.

    The residual is the logarithm of the predicted keyframe as seen from the right one, and the biases of left minus
    right one. Slopes of its turn, position and velocity: by_rotation_left, by_rotation_right (N, 3, 3, 3), by_biases
    (N, 3, 3, 6); of position and velocity by those of the right keyframe, in its axes, the negative of inverse
    (N, 3, 3), and by what is seen in axes of the left one and of n, by_left, by_n (N, 3, 3).
    """

    T: float
    residual: Array
    by_rotation_left: Array
    by_rotation_right: Array
    by_biases: Array
    inverse: Array
    by_left: Array
    by_n: Array

    def put(self, J: Array, part: slice) -> None:
        """Fill in Jacobians (n, 15, 30) of the intervals `part`, where they are not always zero."""
        left, right, n = J[:, :, :15], J[:, :, 15:], len(J)
        left[:, _MOTION, ROTATION] = self.by_rotation_left[part].reshape(n, 9, 3)
        right[:, _MOTION, ROTATION] = self.by_rotation_right[part].reshape(n, 9, 3)
        left[:, _MOTION, _BIASES] = self.by_biases[part].reshape(n, 9, 6)
        left[:, TRANSLATION, TRANSLATION] = self.by_left[part]
        np.negative(self.inverse[part], out=right[:, TRANSLATION, TRANSLATION])
        left[:, VELOCITY, VELOCITY] = by_n = self.by_n[part]
        np.multiply(self.T, by_n, out=left[:, TRANSLATION, VELOCITY])
        np.negative(by_n, out=right[:, VELOCITY, VELOCITY])
        left[:, _BIASES, _BIASES], right[:, _BIASES, _BIASES] = np.eye(6), -np.eye(6)


@_quietly
def linearize_increments(done: Increments, state: ChainState) -> LinearIncrements:
    """Linearise all intervals at `state`."""
    R_i, R_j, T = state.R_ns[:-1], state.R_ns[1:], done.T
    position_n, velocity_n = state.position_n, state.velocity_n
    biases = np.concatenate([state.accel_bias_s, state.gyro_bias_s], axis=1)
    change = (done.by_bias @ (biases[:-1] - np.r_[done.accel_bias, done.gyro_bias])[:, None, :, None])[..., 0]
    turn, shift = done.turn + change[:, 0], done.shift + change[:, 1:]
    ahead = np.empty_like(shift)  # of the right keyframe, by gravity and the left one's velocity
    ahead[:, 0] = position_n[:-1] + T * velocity_n[:-1] + 0.5 * T**2 * GRAVITY_N - position_n[1:]
    ahead[:, 1] = velocity_n[:-1] + T * GRAVITY_N - velocity_n[1:]
    R_jn, dR = R_j.transpose(0, 2, 1), so3.exp(turn)
    R_ji = R_jn @ R_i
    apart = ahead @ R_j + shift @ R_ji.transpose(0, 2, 1)
    angle = so3.log(R_ji @ dR)
    inverse, bent = left_jacobian_inverse(angle), slope_of_inverse(angle[:, None], apart)
    by_left, moved = inverse @ R_ji, apart @ inverse.transpose(0, 2, 1)

    by_left_rotation, by_right_rotation, by_biases = (np.empty((len(R_i), 3, 3, n)) for n in (3, 3, 6))
    by_left_rotation[:, 0] = rotated = (dR @ inverse).transpose(0, 2, 1)
    by_left_rotation[:, 1:] = bent @ rotated[:, None] - by_left[:, None] @ so3.skew(shift)
    by_right_rotation[:, 0] = -inverse
    by_right_rotation[:, 1:] = inverse[:, None] @ so3.skew(apart) - bent @ inverse[:, None]
    by_biases[:, 0] = turned = inverse.transpose(0, 2, 1) @ right_jacobian(turn) @ done.by_bias[:, 0]
    by_biases[:, 1:] = bent @ turned[:, None] + by_left[:, None] @ done.by_bias[:, 1:]
    residual = np.concatenate([angle, moved.reshape(-1, 6), biases[:-1] - biases[1:]], axis=1)
    return LinearIncrements(
        T, residual, by_left_rotation, by_right_rotation, by_biases, inverse, by_left, inverse @ R_jn
    )


@_quietly
def as_expected(linear: LinearIncrements, state: ChainState, acceleration_n: Array) -> LinearIncrements:
    """Return `linear` with attitudes that turn the force of a kart which accelerates as expected.

    acceleration_n (N, 3) m/s^2: expected means over the intervals. Keyframes move by that and by noise of the samples,
    which goes with itself whichever way the sensor points: in slow karts, whose motion is no more than it, it would
    pass for most of what is known of yaw, and hold every step back by as much. (Errors in variables; Fuller 1987. The
    most probable motion is no part of what it misses; Berkson 1950.)

    Up and down too. Fixes hardly tell how a kart moves there: keyframes have it from the samples, noise and all. By as
    little as that noise goes together with what is left in the residuals ahead and to the side, or is taken to do so by
    a noise that was not quite identified, an attitude would be pulled, the same way everywhere: the kart seems tilted
    by degrees, with a bias in front of it and a crooked gyroscope to make up for that. But nor may the hills be left
    out. What they add to the force turns with a tilt, and on an oval goes with the push of the bends, lap after lap:
    then scale and misalignment, which have that push, answer for what the tilt does not own up to, each making the
    other greater, and delays go with them by tenths of a second while the fit gets worse.
    """
    T, p, v = linear.T, state.position_n, state.velocity_n
    faster = v[1:] - v[:-1] - T * acceleration_n
    farther = p[1:] - p[:-1] - T * v[:-1] - 0.5 * T**2 * acceleration_n
    beyond_s = np.stack([farther, faster], axis=1) @ state.R_ns[:-1]  # in axes of the left keyframe
    by_rotation = linear.by_rotation_left.copy()
    by_rotation[:, 1:] += linear.by_left[:, None] @ so3.skew(beyond_s)
    return replace(linear, by_rotation_left=by_rotation)


@_quietly
def felt_by(state: ChainState) -> tuple[Array, Array]:
    """Mean specific force, m/s^2, and rate, rad/s, in s between the keyframes, by their motion; each (K-1, 3)."""
    T, R_left = state.interval, state.R_ns[:-1]
    turn = so3.log(R_left.transpose(0, 2, 1) @ state.R_ns[1:])
    force_n = np.diff(state.velocity_n, axis=0) / T - GRAVITY_N
    R_middle = R_left @ so3.exp(0.5 * turn)
    return np.einsum("kji,kj->ki", R_middle, force_n), turn / T


def right_jacobian(turn: Array) -> Array:
    """Right Jacobian J (..., 3, 3) at turn (..., 3): exp(turn + d) is exp(turn) exp(J d) for small d."""
    angle2 = so3.squared(turn)
    small = angle2 < 1e-4  # the series is exact to 1e-13 below this
    safe = np.where(small, 1.0, angle2)
    angle = np.sqrt(safe)
    a = np.where(small, 0.5 - angle2 / 24.0 + angle2**2 / 720.0, (1.0 - np.cos(angle)) / safe)
    b = np.where(small, 1.0 / 6.0 - angle2 / 120.0 + angle2**2 / 5040.0, (1.0 - np.sin(angle) / angle) / safe)
    return so3.axial(turn, 1.0 - b * angle2, -a, b)


def left_jacobian_inverse(turn: Array) -> Array:
    """Inverse (..., 3, 3) of the left Jacobian at turn (..., 3), that of the right one transposed."""
    angle2 = so3.squared(turn)
    c, _ = _of_square(angle2)
    return so3.axial(turn, 1.0 - c * angle2, np.full_like(c, -0.5), c)


def slope_of_inverse(turn: Array, vector: Array) -> Array:
    """Slope (..., 3, 3) by the turn (..., 3) of `left_jacobian_inverse(turn) @ vector`, both vectors (..., 3)."""
    angle2, along = np.sum(turn**2, axis=-1), np.sum(turn * vector, axis=-1)
    c, slope = (value[..., None] for value in _of_square(angle2))
    outward = turn * along[..., None] - vector * angle2[..., None]
    scaled = c * vector
    out = 0.5 * so3.skew(vector) + turn[..., :, None] * scaled[..., None, :]
    out += (slope * outward - 2.0 * scaled)[..., :, None] * turn[..., None, :]
    return np.asarray(out + (c * along[..., None])[..., None] * np.eye(3))


def _of_square(angle2: Array) -> tuple[Array, Array]:
    """Factor of W W in the inverse of the left Jacobian, and its slope by the angle over the angle, of its square."""
    small = angle2 < 0.01  # the series are exact to 1e-13 below this
    s = np.where(small, angle2, 0.0)
    c = 1.0 / 12.0 + s / 720.0 + s**2 / 30240.0 + s**3 / 1209600.0
    slope = 1.0 / 360.0 + s / 7560.0 + s**2 / 201600.0
    if np.all(small):
        return c, slope
    square = np.where(small, 1.0, angle2)
    half = 0.5 * np.sqrt(square)
    exact = 1.0 - half / np.tan(half)
    bend = (0.5 * half / np.sin(half) ** 2 - 0.5 / np.tan(half)) / (2.0 * half)
    return np.where(small, c, exact / square), np.where(small, slope, bend / square - 2.0 * exact / square**2)
