"""Measurements of a fix as linear rows over a chain of nodes, and the normal equations they make with the prior.

The axes (north, west, and up if anything measures it) are chains laid end to end, uncoupled; each node holds position,
velocity, acceleration and the slow GPS offset. The constants of the session are the lag of Doppler velocity behind
position and the bias of Doppler along each axis. All unknowns are solved as corrections of the current values, which
keeps rounding out of the small differences between neighbouring nodes.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.chain import ChainSolution
from smoother.estimate.gnss_chains import Chains, solve_chains
from smoother.estimate.motion_prior import N_MOTION, MotionPrior, quintic_basis

N_STATE = 4  # position, velocity, acceleration, offset
AXES = 3
HORIZONTAL_POSITION, UP_POSITION, HORIZONTAL_VELOCITY, UP_VELOCITY = range(4)
GROUPS = 4
N_CONSTANTS = 1 + AXES  # lag of Doppler, bias of Doppler per axis
NANOSECOND_DIGITS = 9
PRIOR_OF_AXIS = (0, 0, 1)  # north and west move alike, up does not


@dataclass(frozen=True, eq=False)
class FixRows:
    """Scalar measurements (R,): of which fix, axis 0..2, group (a constant of this module), value, relative sigma."""

    fix: IntArray
    axis: IntArray
    group: IntArray
    value: Array
    scale: Array

    @property
    def n_axes(self) -> int:
        """3, or 2 where nothing measures height: an axis without information would have no solution."""
        return int(max(self.axis.max(), 1)) + 1

    @property
    def is_velocity(self) -> BoolArray:
        """Which rows measure velocity, (R,)."""
        return self.group >= HORIZONTAL_VELOCITY


@dataclass(frozen=True, eq=False)
class Unknowns:
    """Values of all unknowns: x (A, K, 4) per axis and node, constants (4,): lag s, biases m/s."""

    x: Array
    constants: Array


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
    """Everything assumed about the unknowns: motion (horizontal, up), offset per axis, the start, the constants.

    offset_sigma m, offset_tau s; start_sigma (3,) m about start (3,) m; constants (4,): lag s, biases m/s, with
    constants_sigma, zero where the value is known.
    """

    motion: tuple[MotionPrior, MotionPrior]
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
    """The prior between neighbouring nodes: step (A, K-1, 4, 4) and its information (A, K-1, 4, 4); first (A, 4, 4)."""

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


def transitions(t: Array, prior: PathPrior, n_axes: int) -> Transitions:
    """The prior between the nodes at t (K,) s, for the first `n_axes` axes."""
    dt = np.diff(t)
    step = np.zeros((n_axes, dt.size, N_STATE, N_STATE))
    information, first = np.zeros_like(step), np.zeros((n_axes, N_STATE, N_STATE))
    step[..., 3, 3] = np.exp(-dt / prior.offset_tau)
    forgotten = -np.expm1(-2.0 * dt / prior.offset_tau)
    some, which = np.unique(np.round(dt, NANOSECOND_DIGITS), return_inverse=True)  # receivers are punctual: hardly any
    moved = [(motion.transition(some)[which], motion.information(some)[which]) for motion in prior.motion]
    for axis, kind in enumerate(PRIOR_OF_AXIS[:n_axes]):
        step[axis, :, :N_MOTION, :N_MOTION], information[axis, :, :N_MOTION, :N_MOTION] = moved[kind]
        information[axis, :, 3, 3] = 1.0 / (prior.offset_sigma[axis] ** 2 * forgotten)
        motion = prior.motion[kind]
        sigma = [prior.start_sigma[axis], motion.velocity_sigma, motion.acceleration_sigma, prior.offset_sigma[axis]]
        first[axis] = np.diag(np.asarray(sigma) ** -2.0)
    return Transitions(step, information, first)


def design(rows: FixRows, t: Array, fix_times: Array, at: Unknowns) -> Design:
    """Express rows through the nodes at t (K,) s, linearised at the given unknowns.

    fix_times (M,) s, when the positions of the fixes were true; their velocities were true earlier by the lag.
    """
    m = fix_times.size
    times = np.concatenate([fix_times, fix_times - at.constants[0]])
    k = np.clip(np.searchsorted(t, times, side="right") - 1, 0, t.size - 2)
    step = t[k + 1] - t[k]
    fraction = np.clip((times - t[k]) / step, 0.0, 1.0)
    left, right = np.zeros((2 * m, N_STATE)), np.zeros((2 * m, N_STATE))
    for side, basis in zip((left, right), quintic_basis(fraction[:m], step[:m], (0,)), strict=True):
        side[:m, :N_MOTION] = basis[:, 0]
    bends = quintic_basis(fraction[m:], step[m:], (1, 2))
    for side, basis in zip((left, right), bends, strict=True):
        side[m:, :N_MOTION] = basis[:, 0]
    left[:m, 3], right[:m, 3] = 1.0 - fraction[:m], fraction[:m]

    chosen = rows.fix + m * rows.is_velocity
    k, left, right = k[chosen], left[chosen], right[chosen]
    node, x = rows.axis * t.size + k, at.x.reshape(-1, N_STATE)
    here, after = x[node], x[node + 1]
    prediction = _dot(left, here) + _dot(right, after)
    moving = np.flatnonzero(rows.is_velocity)
    fix, axis = rows.fix[moving], rows.axis[moving]
    by_constant = np.zeros((rows.fix.size, N_CONSTANTS))
    by_constant[moving, 0] -= _dot(bends[0][fix, 1], here[moving, :N_MOTION])
    by_constant[moving, 0] -= _dot(bends[1][fix, 1], after[moving, :N_MOTION])
    by_constant[moving, 1 + axis] = 1.0
    prediction[moving] += at.constants[1 + axis]
    return Design(node, left, right, by_constant, prediction - rows.value)


def solve(rows: Design, information: Array, between: Transitions, prior: PathPrior, at: Unknowns) -> ChainSolution:
    """Corrections of the unknowns. information (R,): one over the variance of each row.

    The solution counts nodes as laid out, axis by axis. Raises NotPositiveDefiniteError for unusable numbers.
    """
    like = _alike(rows, information, between)
    diagonal, upper = _matrices(rows, information, between, like)
    rhs = _right_hand_side(rows, information, between, prior, at.x)
    border, corner, rhs_constants = _constants(rows, information, prior, at.constants, at.x.shape[:2])
    return solve_chains(Chains(like, diagonal, upper, border, corner, rhs, rhs_constants))


def leverage(rows: Design, prior: PathPrior, solution: ChainSolution) -> Array:
    """Variance of each row's prediction under the solution's covariance, (R,)."""
    k, left, right = rows.node, np.ascontiguousarray(rows.left.T), np.ascontiguousarray(rows.right.T)
    value = _form(left, solution.covariance, k, left) + _form(right, solution.covariance, k + 1, right)
    value += 2.0 * _form(left, solution.cross, k, right)
    some = np.flatnonzero(rows.by_constant.any(axis=1))
    k, by_constant = k[some], rows.by_constant[some][:, prior.is_free]
    mixed = (rows.left[some, None, :] @ solution.constants_cross[k])[:, 0]
    mixed += (rows.right[some, None, :] @ solution.constants_cross[k + 1])[:, 0]
    value[some] += _dot(by_constant, 2.0 * mixed + by_constant @ solution.constants_covariance)
    return np.asarray(np.maximum(value, 0.0))


def _form(left: Array, matrices: Array, k: IntArray, right: Array) -> Array:
    """`left @ matrices[k] @ right` (R,) of left, right (4, R) and matrices (K, 4, 4), all rows at once."""
    of_row = np.take(np.ascontiguousarray(matrices.reshape(len(matrices), -1).T), k, axis=1)
    by_right = np.einsum("ijr,jr->ir", of_row.reshape(N_STATE, N_STATE, -1), right)
    return np.asarray(np.einsum("ir,ir->r", left, by_right))


def prior_residuals(between: Transitions, x: Array) -> Array:
    """What drives the nodes of x (A, K, 4) from one to the next, (A, K-1, 4): state minus its prediction."""
    return np.asarray(x[:, 1:] - (between.step @ x[:, :-1, :, None])[..., 0])


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ri,ri->r", a, b))


def _alike(rows: Design, information: Array, between: Transitions) -> tuple[int, ...]:
    """Which of the matrices is whose, (A,): north and west share one where they are measured alike, as they mostly are.

    An equal one, not an approximate one: the derivatives of their rows do not depend on where the path is.
    """
    A, K = between.first.shape[0], between.step.shape[1] + 1
    north, west = np.flatnonzero(rows.node < K), np.flatnonzero((rows.node >= K) & (rows.node < 2 * K))
    is_alike = np.array_equal(rows.node[north] + K, rows.node[west])
    for values in (rows.left, rows.right, information) if is_alike else ():
        is_alike = is_alike and np.array_equal(values[north], values[west])
    for values in (between.first, between.information):
        is_alike = is_alike and np.array_equal(values[0], values[1])
    return (0, 0, 1)[:A] if is_alike else (0, 1, 2)[:A]


def _matrices(rows: Design, information: Array, between: Transitions, like: tuple[int, ...]) -> tuple[Array, Array]:
    """Diagonal (C, K, 4, 4) and upper blocks (C, K-1, 4, 4) of the C different matrices of the axes."""
    K, own = between.step.shape[1] + 1, [like.index(c) for c in range(max(like) + 1)]
    axis = rows.node // K
    use = np.flatnonzero(np.isin(axis, own))
    node = rows.node[use] + K * (np.asarray(like) - np.arange(len(like)))[axis[use]]
    left, right = np.ascontiguousarray(rows.left[use].T), np.ascontiguousarray(rows.right[use].T)
    weighted_left, weighted_right = left * information[use], right * information[use]
    total = len(own) * K
    diagonal, upper = np.empty((total, N_STATE, N_STATE)), np.empty((total, N_STATE, N_STATE))
    for i in range(N_STATE):
        for j in range(N_STATE):
            upper[:, i, j] = np.bincount(node, weighted_left[i] * right[j], total)
            if j >= i:
                entry = np.bincount(node, weighted_left[i] * left[j], total)
                entry[1:] += np.bincount(node, weighted_right[i] * right[j], total)[:-1]
                diagonal[:, i, j] = diagonal[:, j, i] = entry
    shape = (len(own), K, N_STATE, N_STATE)
    diagonal, upper = diagonal.reshape(shape), upper.reshape(shape)[:, :-1]
    back = between.step[own].swapaxes(-1, -2) @ between.information[own]
    diagonal[:, 1:] += between.information[own]
    diagonal[:, :-1] += back @ between.step[own]
    diagonal[:, 0] += between.first[own]
    return diagonal, upper - back


def _right_hand_side(rows: Design, information: Array, between: Transitions, prior: PathPrior, x: Array) -> Array:
    """What pulls each node of x (A, K, 4), likewise (A, K, 4)."""
    pull, total = information * rows.residual, x.shape[0] * x.shape[1]
    rhs = np.empty((total, N_STATE))
    for i in range(N_STATE):
        entry = np.bincount(rows.node, pull * rows.left[:, i], total)
        entry[1:] += np.bincount(rows.node, pull * rows.right[:, i], total)[:-1]
        rhs[:, i] = -entry
    rhs = rhs.reshape(x.shape)
    driven = between.information @ prior_residuals(between, x)[..., None]
    rhs[:, 1:] -= driven[..., 0]
    rhs[:, :-1] += (between.step.swapaxes(-1, -2) @ driven)[..., 0]
    start = np.zeros((x.shape[0], N_STATE))
    start[:, 0] = prior.start[: x.shape[0]]
    rhs[:, 0] -= (between.first @ (x[:, 0] - start)[..., None])[..., 0]
    return rhs


def _constants(
    rows: Design, information: Array, prior: PathPrior, constants: Array, shape: tuple[int, ...]
) -> tuple[Array, Array, Array]:
    """Border (A, K, 4, m), corner (m, m) and right-hand side (m,) of the m free constants. shape: (A, K)."""
    free = prior.is_free
    by_constant = rows.by_constant[:, free]
    weighted = by_constant * information[:, None]
    total = shape[0] * shape[1]
    border = np.zeros((total, N_STATE, by_constant.shape[1]))
    for m in range(by_constant.shape[1]):
        some = np.flatnonzero(by_constant[:, m])
        node, weight = rows.node[some], weighted[some, m]
        for i in range(N_STATE):
            border[:, i, m] = np.bincount(node, weight * rows.left[some, i], total)
            border[1:, i, m] += np.bincount(node, weight * rows.right[some, i], total)[:-1]
    own = prior.constants_sigma[free] ** -2.0
    corner = weighted.T @ by_constant + np.diag(own)
    return (
        border.reshape(*shape, N_STATE, -1),
        corner,
        -(weighted.T @ rows.residual) - own * (constants - prior.constants)[free],
    )
