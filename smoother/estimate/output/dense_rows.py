"""Rows of the trajectory between keyframes: motion, accelerations and sigmas at any times, a part at a time."""

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.disc import even_pieces, roomy
from smoother.estimate.factors.gnss import arm_axes
from smoother.estimate.factors.rows import Between
from smoother.estimate.model.imu import BinnedImu, DensePath, at_times, corrected, dense_path, motion_at
from smoother.estimate.model.motion import course_of
from smoother.estimate.model.noise import InertialNoise, interval_noise
from smoother.estimate.model.state import State
from smoother.estimate.output.estimated import Estimated
from smoother.estimate.output.mounting import FittedMounting
from smoother.estimate.preprocess.pauses import Pauses
from smoother.fit.running import running_mean
from smoother.frames import UP_N, euler_jacobian
from smoother.trajectory import (
    EstimateReport,
    JointPosition,
    Keyframes,
    Sigmas,
    Trajectory,
)
from smoother.units import ANY_ANGLE

MARGIN = 20.0  # s of the path around the rows that are made together: longer than the filter reaches
TOGETHER = 1 << 15  # rows or keyframes that are worked on together
LEAST_BETWEEN = 0.25  # least variance between two keyframes, in parts of the smaller of theirs


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a session: keyframes `keys` with their state and bins, and the path of the samples through them.

    At the edges of its bins: acceleration_n (M, 3) m/s^2 and rate_n (M, 3) rad/s of the kart, without noise;
    rate_variance (3,) (rad/s)^2: of its errors, about two level axes and up.
    """

    keys: slice
    state: State
    binned: BinnedImu
    path: DensePath
    acceleration_n: Array
    rate_n: Array
    rate_variance: Array

    def swing_at(self, t: Array) -> Array:
        """Angular rate (N, 3) rad/s in n, at t (N,) s, with which the arm swings the antenna."""
        rate_n = at_times(self.path, self.rate_n, t)
        return rate_n * UP_N if self.state.geometry.is_steered else rate_n

    def swing_covariance(self, arm_n: Array) -> Array:
        """Covariance (N, 3, 3) m^2/s^2 of the velocity of arms arm_n (N, 3) by errors of the rates."""
        by_rate = so3.skew(arm_n)
        return np.asarray((by_rate * self.rate_variance) @ by_rate.transpose(0, 2, 1))


@dataclass(frozen=True, eq=False)
class DenseSource:
    """Source of dense rows: a solved chain, its samples, and their noise.

    pauses: where time is cut out of the session; no path goes through them.
    """

    state: State
    binned: BinnedImu
    noise: InertialNoise
    pauses: Pauses
    _last: dict[tuple[int, int], Stretch] = field(default_factory=dict)

    def around(self, t: Array) -> Stretch:
        """Return the path around times t (n,) s that their rows need. No pause is in t."""
        keys = _around(self.state, t, self.pauses)
        known = self._last.pop((keys.start, keys.stop), None)
        self._last.clear()  # of a day, two do not fit
        self._last[keys.start, keys.stop] = found = self._stretch(keys) if known is None else known
        return found

    def _stretch(self, keys: slice) -> Stretch:
        state, bins, noise = self.state.part(keys), self.binned.between(keys.start, keys.stop), self.noise
        biases = state.accel_bias_s, state.gyro_bias_s
        path = dense_path(corrected(bins, state), state.R_ns, state.position_n, state.velocity_n, *biases)
        axes, dt = state.geometry.level_axes_s, bins.dt
        R_nb = path.R_ns[:-1] @ axes.T
        shapes = np.array([noise.accel_shape, noise.gyro_shape])
        variances = np.einsum("ij,sjk,ik->si", axes, shapes, axes) / dt
        acceleration_b = np.einsum("kji,kj->ki", R_nb, path.acceleration_n)
        acceleration_b, _ = without_noise(acceleration_b, noise.accel**2 * variances[0], dt, np.array([1, 1, 0]) > 0)
        rate_b, left = without_noise(
            path.angular_rate_s @ axes.T, noise.gyro**2 * variances[1], dt, np.ones(3, dtype=np.bool_)
        )
        acceleration_n, rate_n = (_at_edges(np.einsum("kij,kj->ki", R_nb, x)) for x in (acceleration_b, rate_b))
        if state.geometry.is_steered:  # the kart turns with its course
            rate_n[:, 2] = np.interp(path.t, state.t, np.gradient(course_of(state), state.interval))
        left[:2] = left[:2].mean()  # about any level axis
        return Stretch(keys, state, bins, path, acceleration_n, rate_n, left)


def _at_edges(values: Array) -> Array:
    """Values of bins (M-1, 3) at their edges, (M, 3)."""
    return np.concatenate([values[:1], 0.5 * (values[1:] + values[:-1]), values[-1:]])


@dataclass(frozen=True, eq=False)
class DenseRows:
    """Rows of the trajectory, which are made a part at a time: those of a day do not fit into memory.

    position_n m, velocity_n m/s (N, 3) of the antenna; R_nb (N, 3, 3), acceleration_b m/s^2 without gravity and
    angular_rate_b rad/s (N, 3) of the kart; sigmas: fields of :class:`Sigmas`.
    """

    position_n: Array
    velocity_n: Array
    R_nb: Array
    acceleration_b: Array
    angular_rate_b: Array
    sigmas: dict[str, Array]

    @staticmethod
    def empty(n: int) -> "DenseRows":
        """Return room for n rows, on the disc where they are many."""
        sigmas = {name: roomy((n, 3)) for name in ("position_n", "velocity_n", "attitude")}
        sigmas |= {name: roomy(n) for name in ("speed", "track")}
        return DenseRows(roomy((n, 3)), roomy((n, 3)), roomy((n, 3, 3)), roomy((n, 3)), roomy((n, 3)), sigmas)

    def fill(
        self,
        part: slice,
        t: Array,
        found: Estimated,
        mounting: FittedMounting,
        source: DenseSource,
        keyframes: Keyframes,
    ) -> None:
        """Make the rows `part` at times t (n,) s, from the keyframes around them."""
        near = source.around(t)
        (R_ns, position_n, velocity_n), rate_n = motion_at(near.path, t), at_times(near.path, near.rate_n, t)
        state = near.state
        R_arm = arm_axes(Between.at(state, t)) if state.geometry.is_steered else R_ns
        arm_n, R_nb = R_arm @ state.constants["lever_arm"], R_ns @ mounting.R_bs.T
        self.position_n[part] = position_n + arm_n
        self.velocity_n[part] = velocity_n + np.cross(near.swing_at(t), arm_n)
        self.R_nb[part] = R_nb
        self.acceleration_b[part] = np.einsum("nji,nj->ni", R_nb, at_times(near.path, near.acceleration_n, t))
        self.angular_rate_b[part] = np.einsum("nji,nj->ni", R_nb, rate_n)
        known, keys = found.uncertainty, near.keys
        bend = known.bend[keys] + _between_samples(near.binned, source.noise, state.R_ns)
        covariance, track = keyframes.covariance[keys], known.track[keys]
        for name, values in _sigmas(t, state.t, covariance, track, bend, R_nb, velocity_n).items():
            self.sigmas[name][part] = values

    def add_time_uncertainty(self, part: slice, sigma: float, of_attitude: float = 0.0) -> None:
        """Add the motion in `sigma` s to the sigmas of position, velocity and speed of `part`.

        of_attitude s: likewise for attitude.
        """
        velocity_n, R_nb = self.velocity_n[part], self.R_nb[part]
        acceleration_n = np.einsum("nij,nj->ni", R_nb, self.acceleration_b[part])
        pace = np.maximum(np.hypot(velocity_n[:, 0], velocity_n[:, 1]), 1e-12)
        faster = np.sum(velocity_n[:, :2] * acceleration_n[:, :2], axis=1) / pace
        for name, change in (("position_n", velocity_n), ("velocity_n", acceleration_n), ("speed", faster)):
            self.sigmas[name][part] = np.hypot(self.sigmas[name][part], sigma * change)
        if of_attitude > 0.0:
            turned = np.einsum("nij,nj->ni", euler_jacobian(R_nb), self.angular_rate_b[part])
            unsure = np.hypot(self.sigmas["attitude"][part], of_attitude * turned)
            self.sigmas["attitude"][part] = np.minimum(unsure, ANY_ANGLE)

    def trajectory(self, t: Array, report: EstimateReport, joint: JointPosition | None) -> Trajectory:
        """Return the rows, all of which are filled."""
        columns = {name: getattr(self, name) for name in vars(self) if name != "sigmas"}
        for values in (*columns.values(), *self.sigmas.values()):
            values.flags.writeable = False
        return Trajectory(t=t, **columns, sigmas=Sigmas(**self.sigmas), report=report, joint=joint)


def _around(state: State, t: Array, pauses: Pauses) -> slice:
    """Keyframes around times t (n,) s that the path there needs, from pause to pause."""
    stretch = pauses.stretches(state.t)[int(np.searchsorted(pauses.cuts, t[0], side="right"))]
    first = max(int(np.searchsorted(state.t, t[0] - MARGIN)) - 1, stretch.start)
    return slice(first, min(int(np.searchsorted(state.t, t[-1] + MARGIN)) + 1, stretch.stop))


def parts_of(t: Array, pauses: Pauses) -> Iterator[slice]:
    """Slices of t (n,) s that are worked on together, none across a pause."""
    for stretch in pauses.stretches(t):
        for part in even_pieces(stretch.stop - stretch.start, TOGETHER):
            if part.stop > part.start:
                yield slice(stretch.start + part.start, stretch.start + part.stop)


def _sigmas(
    t: Array, at: Array, covariance: Array, track: Array, bend: Array, R_nb: Array, velocity_n: Array
) -> dict[str, Array]:
    """Sigmas at t (n,), fields of :class:`Sigmas`, between keyframes at `at` (K,), which are closer than these change.

    covariance (K, 9, 9) of the keyframes; track (K, 2) m^2, see :func:`track_variance`; bend (K, 3, 3) m^2/s^2: added
    to the covariance of velocity halfway to the next keyframe; R_nb (n, 3, 3) and velocity_n (n, 3) at t.
    """
    i = np.clip(np.searchsorted(at, t) - 1, 0, len(at) - 2)
    later = (t - at[i]) / (at[i + 1] - at[i])

    def between(values: Array) -> Array:
        """Values (n, ...) at t of values (K, ...) at the keyframes."""
        before = values[i]
        share = later.reshape(-1, *[1] * (before.ndim - 1))
        return np.asarray(before + share * (values[i + 1] - before))

    bent = 4.0 * later * (1.0 - later)
    diagonal = between(np.einsum("kii->ki", covariance)[:, 3:9])
    diagonal[:, 0:3] += bent[:, None] * np.einsum("kii->ki", bend)[i]
    ends = np.einsum("kii->ki", covariance)[:, 3:9]
    diagonal = np.maximum(diagonal, LEAST_BETWEEN * np.minimum(ends[i], ends[i + 1]))
    by_turn = euler_jacobian(R_nb) @ R_nb.transpose(0, 2, 1)
    attitude = np.einsum("nri,nri->nr", by_turn @ between(covariance[:, 0:3, 0:3]), by_turn)
    x, y = (velocity_n[:, :2] / np.maximum(np.linalg.norm(velocity_n[:, :2], axis=1), 1e-12)[:, None]).T
    speed = (
        x**2 * diagonal[:, 0]
        + y**2 * diagonal[:, 1]
        + 2.0 * x * y * (between(covariance[:, 3, 4]) + bent * bend[i, 0, 1])
    )
    alone = (1.0 - later) ** 2 * track[i, 0] + later**2 * track[i + 1, 0]
    variance = alone + 2.0 * later * (1.0 - later) * track[i, 1]
    return {
        "position_n": np.sqrt(diagonal[:, 3:6]),
        "velocity_n": np.sqrt(diagonal[:, 0:3]),
        "speed": np.sqrt(np.maximum(speed, 0.0)),
        "attitude": np.sqrt(np.clip(attitude, 0.0, ANY_ANGLE**2)),
        "track": np.sqrt(np.maximum(variance, 0.0)),
    }


def _between_samples(binned: BinnedImu, noise: InertialNoise, R_ns: Array) -> Array:
    """Covariance (K, 3, 3) m^2/s^2 of velocity halfway to the next keyframe, given position and velocity of both.

    White force of density q between two ends that are known leaves q^2 T / 16. Source: the conditional covariance of
    integrated white noise, Q(T/2) - Q(T/2) Phi' Q(T)^-1 Phi Q(T/2).
    """
    density, _ = interval_noise(binned, noise)
    variance = density**2 * np.diff(binned.t) / 16.0
    shape_n = R_ns[:-1] @ np.array(noise.accel_shape) @ R_ns[:-1].transpose(0, 2, 1)
    inside = variance[:, None, None] * shape_n
    return np.concatenate([inside, inside[-1:]])


# Accelerations and angular rates of the rows without the noise of the samples: a Wiener filter without phase.

SMOOTHED = 0.8  # Hz; of 0.1 to 3.2 the one with the least errors of accelerations on simulated karts
BEYOND = 10.0  # s by which both ends are mirrored


def without_noise(values: Array, noise: Array, dt: float, falling: BoolArray) -> tuple[Array, Array]:
    """Return values (N, c), dt s apart, without white noise of variance `noise` (c,), and the variances (c,) left.

    falling (c,): signals whose power falls with frequency beyond its peak; their kept share never rises again, so that
    aliased vibration does not pass. (A kart bounces on its tyres.)
    """
    n = len(values)
    beyond = min(n - 1, round(BEYOND / dt))
    unit = 1 << max((n + 2 * beyond).bit_length() - 5, 0)  # a length of few factors is quick to transform
    mirrored = np.pad(values, ((beyond, beyond + -(n + 2 * beyond) % unit), (0, 0)), "reflect")
    spectrum = np.fft.rfft(mirrored, axis=0)
    width = 2 * max(1, round(0.5 * SMOOTHED * dt * len(mirrored)))
    power = running_mean(np.abs(spectrum) ** 2 / len(mirrored), width)
    share = np.maximum(1.0 - noise / np.maximum(power, 1e-300), 0.0)
    for i in np.flatnonzero(falling):
        beyond_peak = share[int(np.argmax(power[:, i])) :, i]
        np.minimum.accumulate(beyond_peak, out=beyond_peak)
    kept = np.fft.irfft(spectrum * share, len(mirrored), axis=0)[beyond : beyond + n]
    return kept, np.asarray(noise * share.mean(axis=0))
