"""Measurements as rows of a linearised factor: residual and Jacobian of all of a session at once.

Each factor has one function that returns Rows. factors/gaussian.py passes them to GTSAM; residuals are computed nowhere
else. Residuals are prediction minus measurement, in the unit of the measurement.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, KEYFRAME_SIZE, State

ROBUST_LIMIT = (
    4.5  # mean squared normalised residual of a row, beyond which it loses weight: three sigmas of two components
)
SLOWEST = 2.0  # m/s; a slower speed without direction has no weight


@dataclass(frozen=True, eq=False)
class Rows:
    """N measurements of r components between keyframes `interval` (N,) and `interval + 1`.

    residual, sigma (N, r); a component that was not measured has an infinite sigma and no residual. left, right
    (N, r, 18): Jacobians by the two keyframes (12 columns where the unknowns are those of a path, fixes/path_graph.py);
    constants: by constant, each (N, r, size). weight (N,): robust weight.
    """

    name: str
    interval: IntArray
    residual: Array
    sigma: Array
    left: Array
    right: Array
    constants: Mapping[str, Array]
    weight: Array

    @property
    def information(self) -> Array:
        """Weight of each component, (N, r): robust weight over variance, 0 where it was not measured."""
        return self.weight[:, None] / self.sigma**2

    def jacobian(self) -> Array:
        """Jacobian (N, r, 36 + C) by left keyframe, right keyframe and all constants."""
        n, r, size = self.left.shape
        J = np.zeros((n, r, 2 * size + CONSTANTS_SIZE))
        J[:, :, :size], J[:, :, size : 2 * size] = self.left, self.right
        by_constants = J[:, :, 2 * size :]
        for name, block in self.constants.items():
            by_constants[:, :, COLUMNS[name]] = block
        return J

    def take(self, at: IntArray | slice) -> "Rows":
        """Some of the measurements."""
        parts = {name: getattr(self, name)[at] for name in ("interval", "residual", "sigma", "left", "right", "weight")}
        return replace(self, **parts, constants={name: block[at] for name, block in self.constants.items()})

    def whitened(self, starts: Mapping[str, int], width: int) -> Array:
        """Jacobian and, as last column, minus the residual, each over its sigma: (N r, width).

        starts: first columns of the constants that are unknown; those of the keyframes are first.
        """
        out, size = np.zeros((*self.residual.shape, width)), self.left.shape[2]
        out[:, :, :size], out[:, :, size : 2 * size] = self.left, self.right
        for name in self.constants.keys() & starts.keys():
            J = self.constants[name]
            out[:, :, starts[name] : starts[name] + J.shape[2]] = J
        out[:, :, -1] = -self.residual
        out *= (np.sqrt(self.weight)[:, None] / self.sigma)[:, :, None]
        return out.reshape(-1, width)


def rows_of(
    name: str,
    interval: IntArray,
    residual: Array,
    sigma: Array | float,
    left: Array,
    right: Array,
    constants: Mapping[str, Array] | None = None,
) -> Rows:
    """Return Rows of full weight; a residual (N, r) that is not finite was not measured. sigma broadcasts to (N, r)."""
    known = np.isfinite(residual)
    sigma = np.where(known, np.broadcast_to(sigma, residual.shape), np.inf)
    residual = np.where(known, residual, 0.0)
    return Rows(name, interval, residual, sigma, left, right, constants or {}, np.ones(len(residual)))


def no_jacobian(n: int, r: int) -> tuple[Array, Array]:
    """Jacobians (n, r, 18) of zeros by the left and the right keyframe."""
    return np.zeros((n, r, KEYFRAME_SIZE)), np.zeros((n, r, KEYFRAME_SIZE))


def with_sigma(rows: Rows, sigma: float) -> Rows:
    """Return the rows with another sigma of all measured components; an infinite one removes them."""
    known = np.isfinite(rows.sigma) & np.isfinite(sigma)
    return replace(rows, sigma=np.where(known, sigma, np.inf), residual=np.where(known, rows.residual, 0.0))


def robust(rows: Rows) -> Rows:
    """Return the rows with robust weights: min(1, limit / mean squared normalised residual), which redescends."""
    known = np.isfinite(rows.sigma)
    squares = np.sum((rows.residual / rows.sigma) ** 2, axis=1)
    limit = ROBUST_LIMIT * np.maximum(known.sum(axis=1), 1)
    return replace(rows, weight=rows.weight * np.minimum(1.0, limit / np.maximum(squares, 1e-12)))


def after_step(rows: Rows, step: Array, constants: Array) -> Rows:
    """The rows with the residual that the linear model predicts after a step (K, 18) and (C,) of all constants."""
    k = rows.interval
    moved = np.einsum("nri,ni->nr", rows.left, step[k]) + np.einsum("nri,ni->nr", rows.right, step[k + 1])
    for name, block in rows.constants.items():
        moved += block @ constants[COLUMNS[name]]
    return replace(rows, residual=np.where(np.isfinite(rows.sigma), rows.residual + moved, 0.0))


def along_direction(rows: Rows, only: BoolArray, measured: Array) -> Rows:
    """Return rows of velocities of which some are known by their size alone.

    only (N,): which; measured (N,): that size. rows: of all velocities, with nothing measured of these: residual is the
    prediction, of 2 or 3 components of n. Their first component becomes the size of the level velocity, whose slope is
    the direction of travel; the others are not measured.
    """
    if not np.any(only):
        return rows
    level = rows.residual[only, :2]
    predicted = np.hypot(level[:, 0], level[:, 1])
    direction = level / np.maximum(predicted, SLOWEST)[:, None]

    def turned(block: Array) -> Array:
        out = block.copy()
        out[only] = 0.0
        out[only, 0] = np.einsum("na,na...->n...", direction, block[only, :2])
        return out

    residual, sigma = rows.residual.copy(), rows.sigma.copy()
    residual[only] = 0.0
    residual[only, 0] = predicted - measured[only]
    sigma[only, 1:] = np.inf
    constants = {name: turned(block) for name, block in rows.constants.items()}
    return replace(
        rows, residual=residual, sigma=sigma, left=turned(rows.left), right=turned(rows.right), constants=constants
    )


def speeds_alone(velocity_n: Array, speed: Array | None) -> BoolArray:
    """Mask (N,) of the fixes of which nothing but the speed (N,) m/s is known, and that move: velocity_n (N, 3) m/s."""
    if speed is None:
        return np.zeros(len(velocity_n), dtype=np.bool_)
    with np.errstate(invalid="ignore"):
        return np.asarray(~np.isfinite(velocity_n[:, :2]).all(axis=1) & (speed > SLOWEST))


Weights = tuple[Array, Array, Array, Array]


@dataclass(frozen=True, eq=False)
class Between:
    """The motion of a state at times between its keyframes: a cubic Hermite curve, attitudes at an even rate.

    interval (N,); share (N,) of it that has passed; R_ns (N, 3, 3).
    """

    state: State
    interval: IntArray
    share: Array
    R_ns: Array

    @staticmethod
    def at(state: State, t: Array) -> "Between":
        """At t (N,) s; times beyond the keyframes count as the first or the last one."""
        u = (t - state.t[0]) / state.interval
        k = np.clip(np.floor(u).astype(np.int64), 0, len(state.t) - 2)
        share = np.clip(u - k, 0.0, 1.0)
        left, right = state.R_ns[k], state.R_ns[k + 1]
        turn = so3.log(left.transpose(0, 2, 1) @ right)
        return Between(state, k, share, left @ so3.exp(share[:, None] * turn))

    def of_position(self) -> Weights:
        """Weights (N,) of left position, left velocity, right position, right velocity in the position."""
        s, T = self.share, self.state.interval
        h = s**2 * (3.0 - 2.0 * s)
        return 1.0 - h, T * s * (1.0 - s) ** 2, h, -T * s**2 * (1.0 - s)

    def of_velocity(self) -> Weights:
        """Weights (N,) of the same in the velocity."""
        s, T = self.share, self.state.interval
        d = 6.0 * s * (1.0 - s) / T
        return -d, 1.0 - 4.0 * s + 3.0 * s**2, d, s * (3.0 * s - 2.0)

    def value(self, weights: Weights) -> Array:
        """Position m or velocity m/s (N, 3) of the IMU in n."""
        x, k = self.state, self.interval
        parts = (x.position_n[k], x.velocity_n[k], x.position_n[k + 1], x.velocity_n[k + 1])
        return np.asarray(sum(w[:, None] * part for w, part in zip(weights, parts, strict=True)))

    def linear(self, values: Array) -> Array:
        """Values (K, c) of the keyframes, linearly between them, (N, c)."""
        s = self.share[:, None]
        return np.asarray((1.0 - s) * values[self.interval] + s * values[self.interval + 1])

    def put_value(self, left: Array, right: Array, weights: Weights) -> None:
        """Write the Jacobian of :meth:`value` into left and right (N, 3, 18)."""
        for J, k, by_position, by_velocity in (
            (left, self.interval, *weights[:2]),
            (right, self.interval + 1, *weights[2:]),
        ):
            J[:, :, 3:6] = by_position[:, None, None] * self.state.R_ns[k]
            J[:, :, 6:9] = by_velocity[:, None, None] * np.eye(3)

    def put_turn(self, left: Array, right: Array, by_turn: Array) -> None:
        """Write the Jacobian by attitude: by_turn (N, r, 3) by a turn in n, which the two keyframes share."""
        s = self.share[:, None, None]
        left[:, :, 0:3] = (1.0 - s) * by_turn @ self.state.R_ns[self.interval]
        right[:, :, 0:3] = s * by_turn @ self.state.R_ns[self.interval + 1]
