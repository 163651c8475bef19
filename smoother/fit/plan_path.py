"""The driven path in plan: position and velocity at any time, and the distance driven."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from smoother.arrays import Array, IntArray, freeze

STANDING = 1.0  # m/s; below, distance is the wander of the GPS and not counted


@dataclass(frozen=True, eq=False)
class PlanPath:
    """Rows of a trajectory seen from above. t (N,) s; position_n, velocity_n (N, 2) north and west; up (N,) m."""

    t: Array
    position_n: Array
    velocity_n: Array
    up: Array

    def __post_init__(self) -> None:
        n = len(self.t)
        freeze(self, t=(n,), position_n=(n, 2), velocity_n=(n, 2), up=(n,))

    @cached_property
    def speed(self) -> Array:
        """Horizontal speed, (N,) m/s."""
        return np.asarray(np.hypot(self.velocity_n[:, 0], self.velocity_n[:, 1]))

    @cached_property
    def driven(self) -> Array:
        """Distance driven since the first row, (N,) m, not counting what happens at walking pace."""
        moving = np.where(self.speed > STANDING, self.speed, 0.0)
        return np.concatenate([[0.0], np.cumsum(0.5 * (moving[1:] + moving[:-1]) * np.diff(self.t))])

    def at(self, t: Array) -> tuple[Array, Array]:
        """Position (K, 2) m and velocity (K, 2) m/s at times t (K,), by cubic Hermite between rows."""
        k = self.row_before(t)
        h = (self.t[k + 1] - self.t[k])[:, None]
        u = (np.asarray(t)[:, None] - self.t[k][:, None]) / h
        p0, p1, v0, v1 = self.position_n[k], self.position_n[k + 1], self.velocity_n[k], self.velocity_n[k + 1]
        rise = 3.0 * u**2 - 2.0 * u**3
        position = (1.0 - rise) * p0 + rise * p1 + h * u * (1.0 - u) * ((1.0 - u) * v0 - u * v1)
        slope = 6.0 * u * (1.0 - u) * (p1 - p0) / h
        velocity = slope + (1.0 - 4.0 * u + 3.0 * u**2) * v0 + (3.0 * u**2 - 2.0 * u) * v1
        return np.asarray(position), np.asarray(velocity)

    def rows_between(self, start: float, end: float) -> IntArray:
        """Indices (K,) of the rows with start <= t <= end, s."""
        return np.arange(np.searchsorted(self.t, start), np.searchsorted(self.t, end, side="right"))

    def row_before(self, t: Array) -> IntArray:
        """Index (K,) of the last row at or before t (K,), so that there is one after it."""
        return np.asarray(np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2), dtype=np.int64)
