"""The inertial part of the graph: GTSAM's CombinedImuFactor over every interval, linearised into the chain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import B, V, X

from smoother.arrays import Array, BoolArray
from smoother.estimate.graph.chain import ChainSolution, ChainSystem
from smoother.estimate.graph.state import (
    ACCEL_BIAS,
    ACCEL_ERROR,
    CONSTANTS_SIZE,
    GYRO_BIAS,
    GYRO_ERROR,
    KEYFRAME_SIZE,
    ROTATION,
    TRANSLATION,
    VELOCITY,
    ChainState,
)

# Columns of a linearised CombinedImuFactor, whose keys are X V X V B B, and where they go in a keyframe's block.
_LEFT = np.r_[0:6, 6:9, 18:24]
_RIGHT = np.r_[9:15, 15:18, 24:30]
_INERTIAL = slice(0, 15)
_ERRORS = slice(ACCEL_ERROR.start, GYRO_ERROR.stop)


def inertial_graph(measured: Sequence[gtsam.PreintegratedCombinedMeasurements]) -> gtsam.NonlinearFactorGraph:
    """Return a CombinedImuFactor for each interval between keyframes 0, 1, 2, ..."""
    graph = gtsam.NonlinearFactorGraph()
    for k, preintegrated in enumerate(measured):
        graph.add(gtsam.CombinedImuFactor(X(k), V(k), X(k + 1), V(k + 1), B(k), B(k + 1), preintegrated))
    return graph


class ValuesFactory:
    """Turn chain states into GTSAM values. Keeps a set of zero biases, because inserting a bias is slow in Python."""

    def __init__(self, n_keyframes: int) -> None:
        self._zero_biases = gtsam.Values()
        zero = gtsam.imuBias.ConstantBias()
        for k in range(n_keyframes):
            self._zero_biases.insert(B(k), zero)

    def values(self, state: ChainState) -> gtsam.Values:
        """Poses T_ns, velocities and biases of all keyframes."""
        delta = gtsam.VectorValues()
        for k, bias in enumerate(np.concatenate([state.accel_bias_s, state.gyro_bias_s], axis=1)):
            delta.insert(B(k), bias)
        values = self._zero_biases.retract(delta)
        for k, (R, p, v) in enumerate(zip(state.R_ns, state.position_n, state.velocity_n, strict=True)):
            values.insert(X(k), gtsam.Pose3(gtsam.Rot3(R), p))
            values.insert(V(k), v)
        return values


@dataclass(frozen=True, eq=False)
class LinearInertial:
    """Whitened Jacobians left, right (K-1, 15, 15) by the inertial part of the ends, errors (K-1, 15, 18) by the
    errors of scale and misalignment, and residual (K-1, 15).
    """

    left: Array
    right: Array
    errors: Array
    residual: Array


def linearize_inertial(
    graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, mean_force: Array, mean_rate: Array
) -> LinearInertial:
    """Linearise the graph by GTSAM. Rows: rotation, position, velocity, bias of force, bias of rate; whitened.

    mean_force, mean_rate (K-1, 3) in s are what errors of scale act on: an error E acts like a bias E @ mean. (The
    Jacobian by the left bias contains its walk; that by the right one is the walk alone, so their sum is the motion's.)
    """
    linear = graph.linearize(values)
    blocks = np.array([linear.at(k).augmentedJacobian() for k in range(linear.size())])
    left, right = blocks[:, :, _LEFT], blocks[:, :, _RIGHT]
    by_bias = left[:, :, 9:15] + right[:, :, 9:15]
    shape = (len(blocks), 15, 9)
    by_force = (by_bias[:, :, 0:3, None] * mean_force[:, None, None, :]).reshape(shape)
    by_rate = (by_bias[:, :, 3:6, None] * mean_rate[:, None, None, :]).reshape(shape)
    return LinearInertial(left, right, np.concatenate([by_force, by_rate], axis=2), -blocks[:, :, -1])


def inertial_after_errors(linear: LinearInertial, constants_step: Array) -> LinearInertial:
    """Return the factors with the residual for sensor errors that differ by `constants_step` (27,)."""
    return replace(linear, residual=linear.residual + linear.errors @ constants_step[_ERRORS])


def inertial_after_step(linear: LinearInertial, step: Array, constants_step: Array) -> LinearInertial:
    """Return the factors with the residual that the linear model predicts after a step (K, 18) and (27,)."""
    moved = np.einsum("kri,ki->kr", linear.left, step[:-1, _INERTIAL])
    moved += np.einsum("kri,ki->kr", linear.right, step[1:, _INERTIAL])
    return inertial_after_errors(replace(linear, residual=linear.residual + moved), constants_step)


def add_inertial(system: ChainSystem, linear: LinearInertial) -> None:
    """Add the normal equations of the inertial factors to the system, in place."""
    left_t, right_t = linear.left.transpose(0, 2, 1), linear.right.transpose(0, 2, 1)
    residual = linear.residual[:, :, None]
    system.diagonal[:-1, _INERTIAL, _INERTIAL] += left_t @ linear.left
    system.diagonal[1:, _INERTIAL, _INERTIAL] += right_t @ linear.right
    system.upper[:, _INERTIAL, _INERTIAL] += left_t @ linear.right
    system.rhs[:-1, _INERTIAL] -= (left_t @ residual)[:, :, 0]
    system.rhs[1:, _INERTIAL] -= (right_t @ residual)[:, :, 0]
    flat = linear.errors.reshape(-1, linear.errors.shape[2])
    system.border[:-1, _INERTIAL, _ERRORS] += left_t @ linear.errors
    system.border[1:, _INERTIAL, _ERRORS] += right_t @ linear.errors
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


@dataclass(frozen=True)
class VarianceComponent:
    """Weighted squared residuals that one source of noise answers for, and how many independent ones they amount to."""

    squares: float
    redundancy: float
    count: int


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
    root, e = _root_information(state, linear)[use], linear.residual[use]
    C = _posterior_covariance(linear, solution)[use]
    W = root @ _force_covariance(accel[use], state.interval) @ root.transpose(0, 2, 1)
    squares, redundancy = np.einsum("ki,kij,kj->", e, W, e), np.einsum("kij,kji->", W, np.eye(15) - C)
    force = VarianceComponent(float(squares), float(redundancy), 3 * len(e))
    unwhiten = np.linalg.inv(root)[:, ROTATION, :]
    variance = (gyro[use] ** 2 * state.interval)[:, None]
    turned = np.einsum("kij,kj->ki", unwhiten, e)
    left = np.einsum("kri,kri->kr", unwhiten @ C, unwhiten)
    rate = VarianceComponent(float(np.sum(turned**2 / variance)), float(np.sum(1.0 - left / variance)), 3 * len(e))
    return force, rate


def _root_information(state: ChainState, linear: LinearInertial) -> Array:
    """Square root (K-1, 15, 15) of the information of each factor.

    A row block of the factor before whitening is Jr^-1 for rotation, R_i^T R_j for translation, R_i^T for velocity and
    one for the biases; the whitened Jacobian divided by it is the root itself.
    """
    R_i, R_j = state.R_ns[:-1], state.R_ns[1:]
    relative = R_i.transpose(0, 2, 1) @ R_j
    root = np.empty_like(linear.right)
    root[:, :, ROTATION] = linear.right[:, :, ROTATION]  # Jr^-1 is one to first order in the residual
    root[:, :, TRANSLATION] = linear.right[:, :, TRANSLATION] @ relative.transpose(0, 2, 1)
    root[:, :, VELOCITY] = linear.right[:, :, VELOCITY] @ R_i
    root[:, :, ACCEL_BIAS] = linear.right[:, :, ACCEL_BIAS]
    root[:, :, GYRO_BIAS] = linear.right[:, :, GYRO_BIAS]
    return root


def _force_covariance(accel: Array, T: float) -> Array:
    """Covariance (K, 15, 15) of a factor from white force alone, densities accel (K,), over T s."""
    q, eye = accel[:, None, None] ** 2, np.eye(3)
    V = np.zeros((len(accel), 15, 15))
    V[:, TRANSLATION, TRANSLATION] = q * (T**3 / 3.0) * eye
    V[:, TRANSLATION, VELOCITY] = V[:, VELOCITY, TRANSLATION] = q * (T**2 / 2.0) * eye
    V[:, VELOCITY, VELOCITY] = q * T * eye
    return V


def _posterior_covariance(linear: LinearInertial, solution: ChainSolution) -> Array:
    """Covariance (K-1, 15, 15) that the solution leaves in the whitened residuals."""
    left, right, errors = linear.left, linear.right, linear.errors
    P, cross = solution.covariance[:, _INERTIAL, _INERTIAL], solution.cross[:, _INERTIAL, _INERTIAL]
    S, C = solution.constants_covariance[_ERRORS, _ERRORS], solution.constants_cross[:, _INERTIAL, _ERRORS]
    right_t, errors_t = right.transpose(0, 2, 1), errors.transpose(0, 2, 1)
    mixed = left @ cross @ right_t + (left @ C[:-1] + right @ C[1:]) @ errors_t
    own = left @ P[:-1] @ left.transpose(0, 2, 1) + right @ P[1:] @ right_t + errors @ S @ errors_t
    return np.asarray(own + mixed + mixed.transpose(0, 2, 1))
