"""Trajectories at other times: position by cubic Hermite, attitude along the shortest rotation, the rest linearly."""

from dataclasses import dataclass, replace

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Bracket:
    """Where times lie between rows: `before` and `after` (N,) row numbers, fraction (N,) 0..1 between, step (N,) s."""

    before: IntArray
    after: IntArray
    fraction: Array
    step: Array


def resample(trajectory: Trajectory, t: Array, longest_gap: float = np.inf) -> Trajectory:
    """Return the trajectory at times t (N,) inside its span, NaN between rows farther apart than `longest_gap` s.

    Position by cubic Hermite with the velocities at both ends, by a straight line where a velocity is unknown;
    attitude along the shortest rotation; the rest linearly. Raises ValueError outside the span.
    """
    if t.size and (t[0] < trajectory.t[0] - 1e-9 or t[-1] > trajectory.t[-1] + 1e-9):
        raise ValueError("resample needs times inside the trajectory's span")
    place = bracket(trajectory.t, t)
    blank = (place.step > longest_gap) & (place.fraction > 0.0) & (place.fraction < 1.0)

    def linear(values: Array) -> Array:
        return _hidden(between_rows(values, place), blank)

    sigmas = trajectory.sigmas
    return Trajectory(
        t=t,
        position_n=_hidden(hermite(trajectory.position_n, trajectory.velocity_n, place), blank),
        velocity_n=linear(trajectory.velocity_n),
        R_nb=_hidden(_slerp(trajectory.R_nb, place), blank),
        acceleration_b=linear(trajectory.acceleration_b),
        angular_rate_b=linear(trajectory.angular_rate_b),
        sigmas=None if sigmas is None else replace(sigmas, **{k: linear(v) for k, v in vars(sigmas).items()}),
        report=trajectory.report,
    )


def position_at(trajectory: Trajectory, t: Array) -> Array:
    """Position in n, (N, 3) m, at times t (N,) inside the span, as :func:`resample` gives it."""
    return hermite(trajectory.position_n, trajectory.velocity_n, bracket(trajectory.t, t))


def bracket(rows: Array, t: Array) -> Bracket:
    """Find times t (N,) among the increasing times `rows` (M,); a single row is before and after everything."""
    before = np.clip(np.searchsorted(rows, t, side="right") - 1, 0, max(len(rows) - 2, 0)).astype(np.int64)
    after = np.minimum(before + 1, len(rows) - 1)
    step = rows[after] - rows[before]
    fraction = np.clip((t - rows[before]) / np.where(step > 0.0, step, 1.0), 0.0, 1.0)
    return Bracket(before, after, fraction, step)


def between_rows(values: Array, place: Bracket) -> Array:
    """Interpolate values (M, ...) linearly; a row that is met exactly is not spoilt by an unknown neighbour."""
    u = place.fraction.reshape(-1, *[1] * (values.ndim - 1))
    first, second = values[place.before], values[place.after]
    return np.where(u <= 0.0, first, np.where(u >= 1.0, second, (1.0 - u) * first + u * second))


def known_rotation(R: Array) -> Array:
    """R (N, 3, 3) with the identity in place of unknown ones, so that its logarithm stays defined."""
    return np.where(is_known(R)[:, None, None], R, np.eye(3))


def is_known(values: Array) -> BoolArray:
    """Whether all numbers of each row (N, ...) are finite, (N,)."""
    return np.asarray(np.isfinite(values).all(axis=tuple(range(1, values.ndim))))


def hermite(p: Array, v: Array, place: Bracket) -> Array:
    """Cubic (N, c) through rows p (M, c) with slopes v (M, c), straight where a slope is unknown."""
    i, j, u, dt = place.before, place.after, place.fraction[:, None], place.step[:, None]
    curved = (
        (1 + 2 * u) * (1 - u) ** 2 * p[i]
        + u * (1 - u) ** 2 * dt * v[i]
        + u**2 * (3 - 2 * u) * p[j]
        + u**2 * (u - 1) * dt * v[j]
    )
    return np.where(np.isfinite(curved), curved, between_rows(p, place))


def hermite_slope(p: Array, v: Array, place: Bracket) -> Array:
    """Slope (N, c) of the cubic of :func:`hermite`, of rows at different times with known slopes."""
    i, j, u, dt = place.before, place.after, place.fraction[:, None], place.step[:, None]
    return np.asarray(6 * u * (1 - u) * (p[j] - p[i]) / dt + (1 - u) * (1 - 3 * u) * v[i] + u * (3 * u - 2) * v[j])


def _slerp(R: Array, place: Bracket) -> Array:
    first, second = R[place.before], R[place.after]
    turn = so3.log(known_rotation(np.swapaxes(first, 1, 2) @ second))
    turned = first @ so3.exp(place.fraction[:, None] * turn)
    return np.where((is_known(first) & is_known(second))[:, None, None], turned, np.nan)


def _hidden(values: Array, rows: BoolArray) -> Array:
    return np.where(rows.reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)
