"""Measurements of a fix as linear rows over a chain of nodes, and the normal equations they make with the prior.

The three axes are three chains laid end to end (no coupling at the joints), each node holding position, velocity,
acceleration and the slow GPS offset. The constants of the session are the lag of Doppler velocity behind position and
the bias of Doppler along each axis. All unknowns are solved as corrections of the current values, which keeps rounding
out of the small differences between neighbouring nodes.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.graph.chain import ChainSolution, ChainSystem, solve_chain
from smoother.estimate.motion_prior import N_MOTION, MotionPrior, quintic_basis

N_STATE = 4  # position, velocity, acceleration, offset
AXES = 3
HORIZONTAL_POSITION, UP_POSITION, HORIZONTAL_VELOCITY, UP_VELOCITY = range(4)
GROUPS = 4
N_CONSTANTS = 1 + AXES  # lag of Doppler, bias of Doppler per axis


@dataclass(frozen=True, eq=False)
class FixRows:
    """Scalar measurements (R,): of which fix, axis 0..2, group (a constant of this module), value, relative sigma."""

    fix: IntArray
    axis: IntArray
    group: IntArray
    value: Array
    scale: Array

    @property
    def is_velocity(self) -> BoolArray:
        """Which rows measure velocity, (R,)."""
        return self.group >= HORIZONTAL_VELOCITY


@dataclass(frozen=True, eq=False)
class Design:
    """Rows against the current unknowns. node (R,) in the laid-out chain.

    left, right (R, 4) derivative to that node and the next; by_constant (R, 4) derivative to the constants;
    residual (R,) prediction - measurement.
    """

    node: IntArray
    left: Array
    right: Array
    by_constant: Array
    residual: Array


@dataclass(frozen=True, eq=False)
class PathPrior:
    """Everything assumed about the unknowns: motion and offset per axis, the start, and the constants.

    offset_sigma m, offset_tau s; start_sigma (3,) m about start (3,) m; constants (4,): lag s, biases m/s, with
    constants_sigma, zero where the value is known.
    """

    motion: tuple[MotionPrior, MotionPrior, MotionPrior]
    offset_sigma: tuple[float, float, float]
    offset_tau: float
    start: Array
    start_sigma: Array
    constants: Array
    constants_sigma: Array

    @property
    def is_free(self) -> BoolArray:
        """Which constants are unknown, (4,)."""
        return self.constants_sigma > 0.0


@dataclass(frozen=True, eq=False)
class Transitions:
    """The prior between neighbouring nodes: step (3, K-1, 4, 4) and its information (3, K-1, 4, 4); first (3, 4, 4)."""

    step: Array
    information: Array
    first: Array


def fix_rows(position_n: Array, velocity_n: Array, position_scale: Array, velocity_scale: Array) -> FixRows:
    """Rows of what is known of M fixes. position_n, velocity_n (M, 3); scales (M, 3), sigma relative to the usual."""
    parts = []
    for values, scales, groups in (
        (position_n, position_scale, (HORIZONTAL_POSITION, HORIZONTAL_POSITION, UP_POSITION)),
        (velocity_n, velocity_scale, (HORIZONTAL_VELOCITY, HORIZONTAL_VELOCITY, UP_VELOCITY)),
    ):
        fix, axis = np.nonzero(np.isfinite(values))
        parts.append((fix, axis, np.asarray(groups)[axis], values[fix, axis], scales[fix, axis]))
    return FixRows(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def transitions(t: Array, prior: PathPrior) -> Transitions:
    """The prior between the nodes at t (K,) s."""
    dt = np.diff(t)
    step = np.zeros((AXES, dt.size, N_STATE, N_STATE))
    information, first = np.zeros_like(step), np.zeros((AXES, N_STATE, N_STATE))
    keep = np.exp(-dt / prior.offset_tau)
    for axis in range(AXES):
        motion, offset_variance = prior.motion[axis], prior.offset_sigma[axis] ** 2
        step[axis, :, :N_MOTION, :N_MOTION] = motion.transition(dt)
        step[axis, :, 3, 3] = keep
        information[axis, :, :N_MOTION, :N_MOTION] = motion.information(dt)
        information[axis, :, 3, 3] = 1.0 / (offset_variance * -np.expm1(-2.0 * dt / prior.offset_tau))
        sigma = [prior.start_sigma[axis], motion.velocity_sigma, motion.acceleration_sigma, prior.offset_sigma[axis]]
        first[axis] = np.diag(np.asarray(sigma) ** -2.0)
    return Transitions(step, information, first)


def design(rows: FixRows, t: Array, fix_times: Array, x: Array, constants: Array) -> Design:
    """Express rows through the nodes at t (K,) s with unknowns x (3, K, 4) and constants (4,).

    fix_times (M,) s, when the positions of the fixes were true; their velocities were true earlier by the lag.
    """
    row_times = fix_times[rows.fix] - np.where(rows.is_velocity, constants[0], 0.0)
    k = np.clip(np.searchsorted(t, row_times, side="right") - 1, 0, t.size - 2)
    step = t[k + 1] - t[k]
    fraction = np.clip((row_times - t[k]) / step, 0.0, 1.0)
    basis_left, basis_right = quintic_basis(fraction, step)
    kind = np.where(rows.is_velocity, 1, 0)
    every = np.arange(kind.size)
    left, right = np.zeros((kind.size, N_STATE)), np.zeros((kind.size, N_STATE))
    left[:, :N_MOTION], right[:, :N_MOTION] = basis_left[every, kind], basis_right[every, kind]
    left[:, 3] = np.where(rows.is_velocity, 0.0, 1.0 - fraction)
    right[:, 3] = np.where(rows.is_velocity, 0.0, fraction)
    x_left, x_right = x[rows.axis, k], x[rows.axis, k + 1]
    prediction = np.einsum("ri,ri->r", left, x_left) + np.einsum("ri,ri->r", right, x_right)
    acceleration = np.einsum("ri,ri->r", basis_left[:, 2], x_left[:, :N_MOTION])
    acceleration += np.einsum("ri,ri->r", basis_right[:, 2], x_right[:, :N_MOTION])
    by_constant = np.zeros((kind.size, N_CONSTANTS))
    by_constant[:, 0] = np.where(rows.is_velocity, -acceleration, 0.0)
    by_constant[every, 1 + rows.axis] = np.where(rows.is_velocity, 1.0, 0.0)
    prediction += np.where(rows.is_velocity, constants[1 + rows.axis], 0.0)
    return Design(rows.axis * t.size + k, left, right, by_constant, prediction - rows.value)


def solve(
    rows: Design, information: Array, between: Transitions, prior: PathPrior, x: Array, constants: Array
) -> ChainSolution:
    """Corrections of x (3, K, 4) and of the free constants. information (R,): one over the variance of each row.

    The solution counts nodes as laid out, axis by axis. Raises NotPositiveDefiniteError for unusable numbers.
    """
    total = AXES * x.shape[1]
    diagonal, rhs = np.zeros((total, N_STATE, N_STATE)), np.zeros((total, N_STATE))
    upper = np.zeros((total, N_STATE, N_STATE))
    _add_rows(rows, information, diagonal, upper, rhs)
    _add_prior(between, prior, x, diagonal, upper, rhs)
    border, corner, rhs_constants = _constants(rows, information, prior, constants, total)
    return solve_chain(ChainSystem(diagonal, upper[:-1], border, corner, rhs, rhs_constants))


def leverage(rows: Design, prior: PathPrior, solution: ChainSolution) -> Array:
    """Variance of each row's prediction under the solution's covariance, (R,)."""
    k = rows.node
    value = np.einsum("ri,rij,rj->r", rows.left, solution.covariance[k], rows.left)
    value += np.einsum("ri,rij,rj->r", rows.right, solution.covariance[k + 1], rows.right)
    value += 2.0 * np.einsum("ri,rij,rj->r", rows.left, solution.cross[k], rows.right)
    by_constant = rows.by_constant[:, prior.is_free]
    mixed = np.einsum("ri,rim->rm", rows.left, solution.constants_cross[k])
    mixed += np.einsum("ri,rim->rm", rows.right, solution.constants_cross[k + 1])
    value += np.einsum("rm,rm->r", by_constant, 2.0 * mixed + by_constant @ solution.constants_covariance)
    return np.asarray(np.maximum(value, 0.0))


def prior_residuals(between: Transitions, x: Array) -> Array:
    """What drives the nodes of x (3, K, 4) from one to the next, (3, K-1, 4): state minus its prediction."""
    return np.asarray(x[:, 1:] - np.einsum("akij,akj->aki", between.step, x[:, :-1]))


def _add_rows(rows: Design, information: Array, diagonal: Array, upper: Array, rhs: Array) -> None:
    weighted_left, weighted_right = rows.left * information[:, None], rows.right * information[:, None]
    total = rhs.shape[0]
    for i in range(N_STATE):
        rhs[:, i] -= np.bincount(rows.node, weighted_left[:, i] * rows.residual, total)
        rhs[:, i] -= np.bincount(rows.node + 1, weighted_right[:, i] * rows.residual, total)
        for j in range(N_STATE):
            upper[:, i, j] += np.bincount(rows.node, weighted_left[:, i] * rows.right[:, j], total)
            if j >= i:
                entry = np.bincount(rows.node, weighted_left[:, i] * rows.left[:, j], total)
                entry += np.bincount(rows.node + 1, weighted_right[:, i] * rows.right[:, j], total)
                diagonal[:, i, j] += entry
                diagonal[:, j, i] = diagonal[:, i, j]


def _add_prior(between: Transitions, prior: PathPrior, x: Array, diagonal: Array, upper: Array, rhs: Array) -> None:
    n_nodes = x.shape[1]
    shape = (AXES, n_nodes, N_STATE)
    diagonal_of, upper_of, rhs_of = (
        diagonal.reshape(*shape, N_STATE),
        upper.reshape(*shape, N_STATE),
        rhs.reshape(shape),
    )
    back = between.step.swapaxes(-1, -2) @ between.information
    driven = prior_residuals(between, x)
    diagonal_of[:, 1:] += between.information
    diagonal_of[:, :-1] += back @ between.step
    upper_of[:, :-1] -= back
    rhs_of[:, 1:] -= np.einsum("akij,akj->aki", between.information, driven)
    rhs_of[:, :-1] += np.einsum("akij,akj->aki", back, driven)
    start = np.zeros((AXES, N_STATE))
    start[:, 0] = prior.start
    diagonal_of[:, 0] += between.first
    rhs_of[:, 0] -= np.einsum("aij,aj->ai", between.first, x[:, 0] - start)


def _constants(
    rows: Design, information: Array, prior: PathPrior, constants: Array, total: int
) -> tuple[Array, Array, Array]:
    """Border (total, 4, m), corner (m, m) and right-hand side (m,) of the m free constants."""
    free = prior.is_free
    by_constant = rows.by_constant[:, free]
    weighted = by_constant * information[:, None]
    border = np.zeros((total, N_STATE, by_constant.shape[1]))
    for m in range(by_constant.shape[1]):
        some = np.flatnonzero(by_constant[:, m])
        for i in range(N_STATE):
            entry = np.bincount(rows.node[some], weighted[some, m] * rows.left[some, i], total)
            border[:, i, m] = entry + np.bincount(rows.node[some] + 1, weighted[some, m] * rows.right[some, i], total)
    own = prior.constants_sigma[free] ** -2.0
    corner = weighted.T @ by_constant + np.diag(own)
    return border, corner, -(weighted.T @ rows.residual) - own * (constants - prior.constants)[free]
