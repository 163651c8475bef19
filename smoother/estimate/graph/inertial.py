"""The inertial part of the graph: GTSAM's CombinedImuFactor over every interval, linearised into the chain."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.graph.chain import ChainSolution, ChainSystem
from smoother.estimate.graph.imu import BinnedImu, InertialNoise, preintegrate, shared_densities
from smoother.estimate.graph.state import (
    ACCEL_ERROR,
    CONSTANTS_SIZE,
    GYRO_ERROR,
    KEYFRAME_SIZE,
    ROTATION,
    TRANSLATION,
    VELOCITY,
    ChainState,
    Constants,
)

# Columns of a linearised CombinedImuFactor, whose keys are X V X V B B, and where they go in a keyframe's block.
_LEFT = np.r_[0:6, 6:9, 18:24]
_RIGHT = np.r_[9:15, 15:18, 24:30]
_INERTIAL = slice(0, 15)
_ERRORS = slice(ACCEL_ERROR.start, GYRO_ERROR.stop)
PIECE = 128  # intervals that share a set of values
CLOSE = 1.3  # ratio of densities up to which covariances are scaled; further off the samples are preintegrated again


def inertial_factors(measured: Sequence[gtsam.PreintegratedCombinedMeasurements]) -> gtsam.NonlinearFactorGraph:
    """Return a CombinedImuFactor for each interval between keyframes 0, 1, 2, ..."""
    graph = gtsam.NonlinearFactorGraph()
    x, v, b = X(0), V(0), B(0)
    for k, preintegrated in enumerate(measured):
        graph.add(gtsam.CombinedImuFactor(x + k, v + k, x + k + 1, v + k + 1, b + k, b + k + 1, preintegrated))
    return graph


@dataclass(frozen=True, eq=False)
class LinearInertial:
    """Whitened Jacobians left, right (K-1, 15, 15) by the inertial part of the ends, errors (K-1, 15, 9) by the
    errors of scale and misalignment, and residual (K-1, 15).
    """

    left: Array
    right: Array
    errors: Array
    residual: Array


class InertialGraph:
    """CombinedImuFactors of all intervals, preintegrated once about one pair of biases, linearised by GTSAM.

    They are kept in pieces of equal keys, so that one small set of values at rest is made once: putting biases into
    GTSAM's values costs more from Python than everything that is done with them.

    binned with sensor errors as in `constants` taken out; biases (3,) m/s^2 and rad/s to preintegrate about.
    """

    def __init__(
        self, binned: BinnedImu, noise: InertialNoise, accel_bias: Array, gyro_bias: Array, constants: Constants
    ) -> None:
        measured = preintegrate(binned, noise, accel_bias, gyro_bias)
        self.constants = constants
        self.noise = noise
        self._binned = binned
        self._pieces = [inertial_factors(measured[k : k + PIECE]) for k in range(0, len(measured), PIECE)]
        self._at_rest = _values_at_rest(min(PIECE, len(measured)) + 1)
        self._covariance = np.array([m.preintMeasCov() for m in measured])
        self._unwhiten = _upper_root(self._covariance)
        self._force, self._rate = binned.specific_force_s.mean(axis=1), binned.angular_rate_s.mean(axis=1)
        self._accel_bias = accel_bias

    def serves(self, noise: InertialNoise) -> bool:
        """Whether `noise` is so close to what was preintegrated with that scaling the covariances will do."""
        ratios = [noise.accel / self.noise.accel, noise.gyro / self.noise.gyro]
        ratios += [one / two for one, two in zip(noise.calm, self.noise.calm, strict=True)]
        return all(1.0 / CLOSE < ratio < CLOSE for ratio in ratios)

    def linearize(self, state: ChainState, noise: InertialNoise) -> LinearInertial:
        """Linearise by GTSAM. Rows: rotation, position, velocity, bias of force, bias of rate; whitened with `noise`.

        Errors of scale act like a bias in proportion to the mean force and rate of the interval. (The Jacobian by the
        left bias contains its walk; that by the right one is the walk alone: their sum is the motion's.)
        """
        blocks = np.array([factor.augmentedJacobian() for factor in self._linear_factors(state)])
        if noise != self.noise:
            blocks = self._whitening(noise) @ blocks
        left, right = blocks[:, :, _LEFT], blocks[:, :, _RIGHT]
        by_bias = left[:, :, 9:15] + right[:, :, 9:15]
        axes = state.constants.level_axes_s
        force = (self._force - state.accel_bias_s[:-1]) @ axes[:2].T
        rate = (self._rate - state.gyro_bias_s[:-1]) @ axes[2]
        by_force = (by_bias[:, :, 0:3, None] * force[:, None, None, :]).reshape(len(blocks), 15, 6)
        by_rate = by_bias[:, :, 3:6] * rate[:, None, None]
        linear = LinearInertial(left, right, np.concatenate([by_force, by_rate], axis=2), -blocks[:, :, -1])
        return inertial_after_errors(linear, state.constants.as_vector() - self.constants.as_vector())

    def _whitening(self, noise: InertialNoise) -> Array:
        """Matrices (K-1, 15, 15) that take what GTSAM whitened to whitened with `noise`."""
        try:
            root = np.linalg.cholesky(self._scaled_covariance(noise))
        except np.linalg.LinAlgError:  # scaling is an approximation, and some covariances have little to spare
            change = min(noise.accel / self.noise.accel, noise.gyro / self.noise.gyro)
            root = change * np.linalg.cholesky(self._covariance)
        return np.asarray(np.linalg.solve(root, self._unwhiten))

    def _linear_factors(self, state: ChainState) -> Iterator[gtsam.GaussianFactor]:
        tangents = _tangents_from_rest(state)
        for piece, first in zip(self._pieces, range(0, len(state.t), PIECE), strict=False):
            linear = piece.linearize(_moved(self._at_rest, [part[first : first + PIECE + 1] for part in tangents]))
            yield from (linear.at(k) for k in range(linear.size()))

    def _scaled_covariance(self, noise: InertialNoise) -> Array:
        """Covariance (K-1, 15, 15) of the factors for densities that are not far from those preintegrated with."""
        T = self._binned.n_bins * self._binned.dt
        accel, gyro = shared_densities(self._binned, noise)
        accel_was, gyro_was = shared_densities(self._binned, self.noise)
        by_force, by_rate = _force_covariance(np.ones(1), T), _rate_covariance(self._force - self._accel_bias, T)
        change = (accel**2 - accel_was**2)[:, None, None] * by_force
        return np.asarray(self._covariance + change + (gyro**2 - gyro_was**2)[:, None, None] * by_rate)


def _upper_root(covariance: Array) -> Array:
    """Upper triangular U (K, n, n) with U @ U.T = covariance (K, n, n): the inverse of what GTSAM whitens with."""
    return np.asarray(np.linalg.cholesky(covariance[:, ::-1, ::-1])[:, ::-1, ::-1])


def _values_at_rest(n_keyframes: int) -> gtsam.Values:
    values = gtsam.Values()
    pose, velocity, bias = gtsam.Pose3(), np.zeros(3), gtsam.imuBias.ConstantBias()
    for k in range(n_keyframes):
        values.insert(X(k), pose)
        values.insert(V(k), velocity)
        values.insert(B(k), bias)
    return values


def _tangents_from_rest(state: ChainState) -> tuple[Array, Array, Array]:
    """Tangents by which GTSAM's retraction leads from rest at the origin to `state`: (K, 6), (K, 3) and (K, 6)."""
    turn = so3.log(state.R_ns)
    angle2 = np.sum(turn**2, axis=1)
    half = 0.5 * np.sqrt(angle2)
    small = half < 1e-4
    share = np.where(
        small, 1.0 / 12.0, (1.0 - half / np.tan(np.where(small, 1.0, half))) / np.where(small, 1.0, angle2)
    )
    sideways = np.cross(turn, state.position_n)
    # inverse of the left Jacobian of SO(3); Barfoot 2017, eq. 7.76
    shift = state.position_n - 0.5 * sideways + share[:, None] * np.cross(turn, sideways)
    biases = np.concatenate([state.accel_bias_s, state.gyro_bias_s], axis=1)
    return np.concatenate([turn, shift], axis=1), state.velocity_n, biases


def _moved(at_rest: gtsam.Values, tangents: Sequence[Array]) -> gtsam.Values:
    delta = gtsam.VectorValues()
    for first, part in zip((X(0), V(0), B(0)), tangents, strict=True):
        for key, tangent in enumerate(part, first):
            delta.insert(key, tangent)
    return at_rest.retract(delta)


def inertial_after_errors(linear: LinearInertial, constants_step: Array) -> LinearInertial:
    """Return the factors with the residual for sensor errors that differ by `constants_step` (18,)."""
    return replace(linear, residual=linear.residual + linear.errors @ constants_step[_ERRORS])


def inertial_after_step(linear: LinearInertial, step: Array, constants_step: Array) -> LinearInertial:
    """Return the factors with the residual that the linear model predicts after a step (K, 18) and (18,)."""
    moved = np.einsum("kri,ki->kr", linear.left, step[:-1, _INERTIAL])
    moved += np.einsum("kri,ki->kr", linear.right, step[1:, _INERTIAL])
    return inertial_after_errors(replace(linear, residual=linear.residual + moved), constants_step)


def add_inertial(system: ChainSystem, linear: LinearInertial) -> None:
    """Add the normal equations of the inertial factors to the system, in place."""
    flat = linear.errors.reshape(-1, linear.errors.shape[2])
    for first in range(0, len(linear.left), PIECE):
        here = slice(first, min(first + PIECE, len(linear.left)))
        after = slice(first + 1, here.stop + 1)
        left, right, errors = linear.left[here], linear.right[here], linear.errors[here]
        whitened = np.concatenate([left, right, errors, linear.residual[here, :, None]], axis=2)
        normal = whitened.transpose(0, 2, 1) @ whitened
        system.diagonal[here, _INERTIAL, _INERTIAL] += normal[:, 0:15, 0:15]
        system.diagonal[after, _INERTIAL, _INERTIAL] += normal[:, 15:30, 15:30]
        system.upper[here, _INERTIAL, _INERTIAL] += normal[:, 0:15, 15:30]
        system.border[here, _INERTIAL, _ERRORS] += normal[:, 0:15, 30:39]
        system.border[after, _INERTIAL, _ERRORS] += normal[:, 15:30, 30:39]
        system.rhs[here, _INERTIAL] -= normal[:, 0:15, 39]
        system.rhs[after, _INERTIAL] -= normal[:, 15:30, 39]
    system.corner[_ERRORS, _ERRORS] += flat.T @ flat
    system.rhs_constants[_ERRORS] -= flat.T @ linear.residual.ravel()


def empty_system(n_keyframes: int) -> ChainSystem:
    """Return normal equations without any factor."""
    n, m = KEYFRAME_SIZE, CONSTANTS_SIZE
    return ChainSystem(
        np.zeros((n_keyframes, n, n)),
        np.zeros((n_keyframes - 1, n, n)),
        np.zeros((n_keyframes, n, m)),
        np.zeros((m, m)),
        np.zeros((n_keyframes, n)),
        np.zeros(m),
    )


@dataclass(frozen=True, eq=False)
class VarianceComponent:
    """Weighted squared residuals that one source of noise answers for, and how many independent ones they amount to.

    Of each of N intervals (N,), three residuals in each.
    """

    squares_of: Array
    redundancy_of: Array

    @property
    def squares(self) -> float:
        """Of all intervals together."""
        return float(np.sum(self.squares_of))

    @property
    def redundancy(self) -> float:
        """Of all intervals together."""
        return float(np.sum(self.redundancy_of))


def inertial_components(
    state: ChainState, linear: LinearInertial, solution: ChainSolution, accel: Array, gyro: Array, use: BoolArray
) -> tuple[VarianceComponent, VarianceComponent]:
    """Split the inertial residuals between the noise of force and that of rate, over the intervals `use` (K-1,).

    White force of density accel (K-1,) moves velocity and position in a known way, V, which is only a part of a
    factor's covariance: a turn by white rate turns the force and moves as well. With S the square-root information over
    the whole covariance, force weighs the whitened residual e by W = S V S': it answers for e' W e, of which
    tr(W (1 - C)) is expected, C being the covariance that the solution leaves in e. Only white rate, of density gyro
    (K-1,), turns: its part is the rotation alone. Source: Foerstner 1979.
    """
    at = np.flatnonzero(use)
    root, e = _root_information(state, linear, at), linear.residual[at]
    C = _posterior_covariance(linear, solution, at)
    W = root @ _force_covariance(accel[at], state.interval) @ root.transpose(0, 2, 1)
    force = VarianceComponent(np.einsum("ki,kij,kj->k", e, W, e), np.einsum("kij,kji->k", W, np.eye(15) - C))
    unwhiten = np.linalg.inv(root)[:, ROTATION, :]
    variance = (gyro[at] ** 2 * state.interval)[:, None]
    turned = np.einsum("kij,kj->ki", unwhiten, e)
    left = np.einsum("kri,kri->kr", unwhiten @ C, unwhiten)
    rate = VarianceComponent(np.sum(turned**2 / variance, axis=1), np.sum(1.0 - left / variance, axis=1))
    return force, rate


def _root_information(state: ChainState, linear: LinearInertial, at: IntArray) -> Array:
    """Square root (N, 15, 15) of the information of the factors `at` (N,).

    A row block of the factor before whitening is Jr^-1 for rotation, R_i^T R_j for translation, R_i^T for velocity and
    one for the biases; the whitened Jacobian divided by it is the root itself.
    """
    R_i, R_j = state.R_ns[at], state.R_ns[at + 1]
    relative = R_i.transpose(0, 2, 1) @ R_j
    root = linear.right[at]  # Jr^-1 is one to first order in the residual
    root[:, :, TRANSLATION] = root[:, :, TRANSLATION] @ relative.transpose(0, 2, 1)
    root[:, :, VELOCITY] = root[:, :, VELOCITY] @ R_i
    return root


def _force_covariance(accel: Array, T: float) -> Array:
    """Covariance (K, 15, 15) of a factor from white force alone, densities accel (K,), over T s."""
    q, eye = accel[:, None, None] ** 2, np.eye(3)
    V = np.zeros((len(accel), 15, 15))
    V[:, TRANSLATION, TRANSLATION] = q * (T**3 / 3.0) * eye
    V[:, TRANSLATION, VELOCITY] = V[:, VELOCITY, TRANSLATION] = q * (T**2 / 2.0) * eye
    V[:, VELOCITY, VELOCITY] = q * T * eye
    return V


def _rate_covariance(force: Array, T: float) -> Array:
    """Covariance (K, 15, 15) of a factor from white rate of density one over T s, at a mean force (K, 3).

    A turn e leans the force, which accelerates by -[f]x e.
    """
    lean, eye = -so3.skew(force), np.eye(3)
    square = lean @ lean.transpose(0, 2, 1)
    V = np.zeros((len(force), 15, 15))
    V[:, ROTATION, ROTATION] = T * eye
    V[:, VELOCITY, ROTATION], V[:, TRANSLATION, ROTATION] = (T**2 / 2.0) * lean, (T**3 / 6.0) * lean
    V[:, ROTATION, VELOCITY], V[:, ROTATION, TRANSLATION] = -V[:, VELOCITY, ROTATION], -V[:, TRANSLATION, ROTATION]
    V[:, VELOCITY, VELOCITY], V[:, TRANSLATION, TRANSLATION] = (T**3 / 3.0) * square, (T**5 / 20.0) * square
    V[:, TRANSLATION, VELOCITY] = V[:, VELOCITY, TRANSLATION] = (T**4 / 8.0) * square
    return V


def _posterior_covariance(linear: LinearInertial, solution: ChainSolution, at: IntArray) -> Array:
    """Covariance (N, 15, 15) that the solution leaves in the whitened residuals of the factors `at` (N,)."""
    left, right, errors = linear.left[at], linear.right[at], linear.errors[at]
    S, C = solution.constants_covariance[_ERRORS, _ERRORS], solution.constants_cross[:, _INERTIAL, _ERRORS]
    P_left, P_right, cross = (
        block[:, _INERTIAL, _INERTIAL]
        for block in (solution.covariance[at], solution.covariance[at + 1], solution.cross[at])
    )
    right_t, errors_t = right.transpose(0, 2, 1), errors.transpose(0, 2, 1)
    mixed = left @ cross @ right_t + (left @ C[at] + right @ C[at + 1]) @ errors_t
    own = left @ P_left @ left.transpose(0, 2, 1) + right @ P_right @ right_t + errors @ S @ errors_t
    return np.asarray(own + mixed + mixed.transpose(0, 2, 1))
