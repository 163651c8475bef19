"""Inertial samples between keyframes: rate reduction, and the dense path they describe.

The samples are averaged into equal bins, because GTSAM costs microseconds per sample from Python. The force is resolved
in the axes of the start of its bin (sculling), and the rates include coning, so that the bins integrate to the same
motion as the samples: GTSAM's first-order step is then exact to second order. Axes are s: the graph estimates the
attitude of the sensor, R_ns.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release, roomy
from smoother.estimate.model.state import State
from smoother.fit.running import gaussian_mean
from smoother.frames import GRAVITY_N
from smoother.samples import BESIDE, ImuSamples, usual_steps

GAP_FACTOR = 3.5  # a step longer than this many usual ones is a gap: nothing was measured in it
MOSTLY_MISSING = 0.5  # share of an interval without samples, above which its attitude is interpolated
SLOW = 0.3  # s; vibration is quicker
NEARBY = 0.2  # s over which vibration is averaged
IN_CACHE = 200  # intervals whose samples stay in the processor's cache: 40 s
TOGETHER = 1 << 13  # intervals whose samples are worked on together; half an hour


@dataclass(frozen=True, eq=False)
class BinnedImu:
    """Inertial measurements averaged into equal bins, n_bins to each of K-1 intervals between keyframes.

    t (K,) s of the keyframes; dt, s, of a bin; specific_force_s, angular_rate_s (K-1, n_bins, 3), force in the axes of
    its bin's start; missing (K-1,), fraction of the interval without samples; rough (K-1, 2), power of the vibration of
    force and rate in the interval over its mean in the session, None where it is not known.
    """

    t: Array
    dt: float
    specific_force_s: Array
    angular_rate_s: Array
    missing: Array
    rough: Array | None = None

    @property
    def n_bins(self) -> int:
        """Bins in one interval between keyframes."""
        return int(self.specific_force_s.shape[1])

    @property
    def edges(self) -> Array:
        """Times of all bin edges, ((K-1) n_bins + 1,) s."""
        return np.asarray(self.t[0] + self.dt * np.arange(self.specific_force_s.shape[0] * self.n_bins + 1))

    def between(self, first: int, last: int) -> "BinnedImu":
        """Return the bins between the keyframes first to last, exclusive."""
        intervals = slice(first, last - 1)
        return BinnedImu(
            self.t[first:last],
            self.dt,
            self.specific_force_s[intervals],
            self.angular_rate_s[intervals],
            self.missing[intervals],
            None if self.rough is None else self.rough[intervals],
        )


def corrected(binned: BinnedImu, state: State) -> BinnedImu:
    """Return the bins with the scale and misalignment of `state` removed, to first order."""
    level, up = np.split(state.geometry.level_axes_s, [2])
    accel_error = state.constants["accel_scale"].reshape(3, 2) @ level
    gyro_error = np.outer(state.constants["gyro_scale"], up[0])
    return replace(
        binned,
        specific_force_s=binned.specific_force_s - binned.specific_force_s @ accel_error.T,
        angular_rate_s=binned.angular_rate_s - binned.angular_rate_s @ gyro_error.T,
    )


def bin_imu(imu: ImuSamples, t: Array, n_bins: int, accel_bias: Array, gyro_bias: Array) -> BinnedImu:
    """Average `imu` into n_bins equal bins per interval of the equally spaced keyframe times t (K,).

    The biases (3,), m/s^2 and rad/s, are removed for the rotations inside a bin and added again, so that the bins are
    measurements like the samples. Missing samples are interpolated.
    Source: Savage 1998, coning and sculling, second order.
    """
    n_intervals = len(t) - 1
    dt, nominal = (t[-1] - t[0]) / (n_intervals * n_bins), imu.interval
    out = BinnedImu(
        t,
        float(dt),
        roomy((n_intervals, n_bins, 3)),
        roomy((n_intervals, n_bins, 3)),
        np.empty(n_intervals),
        np.empty((n_intervals, 2)),
    )
    assert out.rough is not None
    for part in pieces(n_intervals, TOGETHER):
        for few in pieces(part.stop - part.start, IN_CACHE):
            here = slice(part.start + few.start, part.start + few.stop)
            edges = t[0] + dt * np.arange(here.start * n_bins, here.stop * n_bins + 1)
            some = _samples_around(imu, edges[0], edges[-1])
            force, rate, missing = _bin_some(some, edges, dt, nominal, (accel_bias, gyro_bias))
            shape = (here.stop - here.start, n_bins)
            out.specific_force_s[here], out.angular_rate_s[here] = force.reshape(*shape, 3), rate.reshape(*shape, 3)
            out.missing[here] = missing.reshape(shape).sum(axis=1) / (n_bins * dt)
        for column, values in enumerate((out.specific_force_s[part], out.angular_rate_s[part])):
            rough = vibration(values.reshape(-1, 3), dt).reshape(-1, n_bins)
            out.rough[part, column] = rough.mean(axis=1)
        release(imu, out)
    out.rough[...] = _over_mean(out.rough, out.missing)
    return out


def _over_mean(power: Array, missing: Array) -> Array:
    """Each column of power (N, c) over its mean in sampled intervals; 1 where there is none.

    missing (N,): share of each interval without samples.
    """
    usual = power if np.all(telling := mostly_sampled(missing)) else power[telling]
    with np.errstate(all="ignore"):
        share = power / usual.mean(axis=0)
    return np.where(np.isfinite(share), share, 1.0)


def mostly_sampled(missing: Array) -> BoolArray:
    """Mask of the intervals with samples; all where few have none. missing (N,): shares without samples."""
    sampled = missing < 1.0
    return sampled if 0.0 < np.mean(sampled) < 1.0 - FEW else np.ones_like(sampled)


def vibration(values: Array, dt: float) -> Array:
    """Power (B,) of vibration around each of the bins `values` (B, 3), which are dt s long."""
    with np.errstate(all="ignore"):  # damaged samples
        quick = values - gaussian_mean(values, SLOW / dt)
        return gaussian_mean(np.mean(quick**2, axis=1), NEARBY / dt)


def _samples_around(imu: ImuSamples, start: float, end: float) -> ImuSamples:
    """The samples from the last one before start to the first one after end, and some beside them for their rate."""
    first = max(int(np.searchsorted(imu.t, start)) - 1 - BESIDE, 0)
    last = int(np.searchsorted(imu.t, end, side="right")) + 1 + BESIDE
    return ImuSamples(
        imu.t[first:last],
        imu.specific_force_s[first:last],
        imu.angular_rate_s[first:last],
        imu.accel_full_scale,
        imu.gyro_full_scale,
    )


def _bin_some(
    imu: ImuSamples,
    edges: Array,
    dt: float,
    nominal: float,
    biases: tuple[Array, Array],
) -> tuple[Array, Array, Array]:
    """Mean force and rate (B, 3) of the bins between edges (B + 1,), and the time (B,) s without samples in them.

    nominal s: the usual step of the samples; biases of force and rate, (3,) each.
    """
    accel_bias, gyro_bias = biases
    n_bins = len(edges) - 1
    inside = imu.t[(imu.t > edges[0]) & (imu.t < edges[-1])]
    knots = np.union1d(inside, edges)
    duration = np.diff(knots)
    middle = knots[:-1] + 0.5 * duration
    force, rate, missing = _piecewise_constant(imu, middle, nominal)
    bin_of = np.minimum(((middle - edges[0]) / dt).astype(np.int64), n_bins - 1)

    # from here on in rows of x, y and z, which lie in one piece each
    force_xyz, rate_xyz = np.ascontiguousarray(force.T), np.subtract(rate.T, gyro_bias[:, None], order="C")
    step = rate_xyz * duration
    turned = np.cumsum(step, axis=1) - step
    first = np.searchsorted(bin_of, np.arange(n_bins))
    start = turned - turned[:, first][:, bin_of]  # rotation vector since the start of the bin, first order
    half = start + 0.5 * step
    turned_force = _cross(half, force_xyz - accel_bias[:, None])
    resolved = force_xyz + turned_force + 0.5 * _cross(half, turned_force)
    coned = step + 0.5 * _cross(start, step)

    mean_force = np.add.reduceat(resolved * duration, first, axis=1).T / dt
    mean_rate = np.add.reduceat(coned, first, axis=1).T / dt + gyro_bias
    return mean_force, mean_rate, np.add.reduceat(missing * duration, first)


def _cross(a: Array, b: Array) -> Array:
    """Cross products (3, N) of the columns of a and b (3, N)."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def _piecewise_constant(imu: ImuSamples, t: Array, nominal: float) -> tuple[Array, Array, BoolArray]:
    """Force and rate (M, 3) at t, and which of them (M,) were not measured."""
    after = np.clip(np.searchsorted(imu.t, t), 0, len(imu.t) - 1)
    before = np.maximum(after - 1, 0)
    span = imu.t[after] - imu.t[before]
    local = np.append(nominal, usual_steps(np.diff(imu.t), nominal))[after]
    missing = (span > GAP_FACTOR * local) & (t < imu.t[after] - local)
    missing |= (t > imu.t[-1]) | (t < imu.t[0] - nominal)
    force, rate = np.take(imu.specific_force_s, after, axis=0), np.take(imu.angular_rate_s, after, axis=0)
    if np.any(missing):
        share = np.clip((t - imu.t[before]) / np.where(span > 0.0, span, 1.0), 0.0, 1.0)[missing, None]
        a, b = before[missing], after[missing]
        force[missing] = (1.0 - share) * imu.specific_force_s[a] + share * imu.specific_force_s[b]
        rate[missing] = (1.0 - share) * imu.angular_rate_s[a] + share * imu.angular_rate_s[b]
    return force, rate, missing


@dataclass(frozen=True, eq=False)
class DensePath:
    """Motion at every bin edge, consistent with the keyframes. t (M,); R_ns (M, 3, 3); position_n, velocity_n (M, 3).

    angular_rate_s (M-1, 3) rad/s and acceleration_n (M-1, 3) m/s^2 are means over the bins, biases removed.
    """

    t: Array
    R_ns: Array
    position_n: Array
    velocity_n: Array
    angular_rate_s: Array
    acceleration_n: Array


def dense_path(
    binned: BinnedImu, R_ns: Array, position_n: Array, velocity_n: Array, accel_bias: Array, gyro_bias: Array
) -> DensePath:
    """Propagate the bins from each keyframe and spread the mismatch at the next one over the interval.

    R_ns (K, 3, 3), position_n, velocity_n (K, 3), biases (K, 3). The mismatch in position and velocity is spread by
    cubic Hermite polynomials and that in attitude linearly: the mean of the path given both ends.
    """
    n, dt = binned.n_bins, binned.dt
    T = n * dt
    force = _ahead(binned.specific_force_s - accel_bias[:-1, None, :])
    rate = binned.angular_rate_s - gyro_bias[:-1, None, :]
    steps, gravity = _ahead(so3.exp(rate * dt)), GRAVITY_N[:, None]
    R, p, v = np.empty((n + 1, 3, 3, len(rate))), np.empty((n + 1, 3, len(rate))), np.empty((n + 1, 3, len(rate)))
    R[0], p[0], v[0] = R_ns[:-1].transpose(1, 2, 0), position_n[:-1].T, velocity_n[:-1].T
    for j in range(n):
        acceleration = np.einsum("ijk,jk->ik", R[j], force[j]) + gravity
        p[j + 1] = p[j] + v[j] * dt + 0.5 * acceleration * dt**2
        v[j + 1] = v[j] + acceleration * dt
        np.einsum("ijk,jlk->ilk", R[j], steps[j], out=R[j + 1])

    turn = so3.log(R[n].transpose(2, 1, 0) @ R_ns[1:])
    miss_p, miss_v = position_n[1:].T - p[n], velocity_n[1:].T - v[n]
    share = np.arange(n + 1)[:, None, None] / n
    p += share**2 * (3.0 - 2.0 * share) * miss_p + T * share**2 * (share - 1.0) * miss_v
    v += 6.0 * share * (1.0 - share) / T * miss_p + share * (3.0 * share - 2.0) * miss_v
    spread = _ahead(so3.exp(share[1:-1, 0] * turn[:, None]))
    R[1:n] = np.einsum("nijk,njlk->nilk", R[1:n], spread)
    return DensePath(
        binned.edges,
        np.concatenate([_behind(R[:n]), R_ns[-1:]]),
        np.concatenate([_behind(p[:n]), position_n[-1:]]),
        np.concatenate([_behind(v[:n]), velocity_n[-1:]]),
        (rate + (turn / T)[:, None, :]).reshape(-1, 3),
        _behind(np.diff(v, axis=0) / dt),
    )


def _ahead(values: Array) -> Array:
    """(K-1, n, ...) -> (n, ..., K-1): intervals side by side, in which products of small matrices are many at once."""
    return np.ascontiguousarray(values.transpose(*range(1, values.ndim), 0))


def _behind(values: Array) -> Array:
    """(n, ..., K-1) -> ((K-1) n, ...)."""
    last = values.ndim - 1
    return np.asarray(values.transpose(last, *range(last)).reshape(-1, *values.shape[1:last]))


def at_times(path: DensePath, values: Array, t: Array) -> Array:
    """Interpolate values (M, c) given at the edges of the path at t (N,). Returns (N, c)."""
    return np.stack([np.interp(t, path.t, values[:, i]) for i in range(values.shape[1])], axis=1)


def are_observed(missing: Array) -> BoolArray:
    """Mask (K,) of the keyframes with samples on one side at least; attitudes of others are interpolated.

    missing (K-1,): share of each interval without samples.
    """
    sampled = np.concatenate([[False], missing < MOSTLY_MISSING, [False]])
    return np.asarray(sampled[1:] | sampled[:-1])


def motion_at(path: DensePath, t: Array) -> tuple[Array, Array, Array]:
    """Attitude R_ns (N, 3, 3), position_n m and velocity_n m/s (N, 3) at t (N,) s; beyond the ends at even velocity.

    Position is cubic within a bin, so that it is consistent with the velocities at both of its edges.
    """
    dt = float(path.t[1] - path.t[0])
    i = np.clip(((t - path.t[0]) / dt).astype(np.int64), 0, len(path.t) - 2)
    since = (t - path.t[i])[:, None]
    inside = np.clip(since, 0.0, dt)
    s, velocity_n = inside / dt, path.velocity_n[i] + inside * path.acceleration_n[i]
    h = s**2 * (3.0 - 2.0 * s)
    cubic = (1.0 - h) * path.position_n[i] + h * path.position_n[i + 1]
    cubic += dt * (s * (1.0 - s) ** 2 * path.velocity_n[i] - s**2 * (1.0 - s) * path.velocity_n[i + 1])
    R_ns = path.R_ns[i] @ so3.exp(inside * path.angular_rate_s[i])
    return R_ns, cubic + (since - inside) * velocity_n, velocity_n


# Which times of a session the inertial samples cover, where that is not all of it: a sensor starts late or pauses.

HOLE = 2.0  # s without samples; shorter gaps are interpolated accurately
FEW = 0.05  # share of a session without samples that changes no figure of the others


def sampled_spans(t: Array) -> Array:
    """Return first and last times (S, 2) s of the stretches of samples at t (N,) s, N > 0, that have no hole."""
    before = np.flatnonzero(np.diff(t) > HOLE)
    return np.column_stack([t[np.append(0, before + 1)], t[np.append(before, len(t) - 1)]])


def has_hole(spans: Array, first: float, last: float) -> bool:
    """Whether there is a hole between the spans (S, 2) s, or before or after all of them, from time first to last s."""
    inside = spans[(spans[:, 1] > first) & (spans[:, 0] < last)]
    return len(inside) != 1 or inside[0, 0] - first > HOLE or last - inside[0, 1] > HOLE


def are_sampled(spans: Array, since: Array, until: Array) -> BoolArray:
    """Whether all of each time from since to until (N,) s, the two in order, is within one of the spans (S, 2) s."""
    latest = np.searchsorted(spans[:, 0], since, side="right") - 1
    return np.asarray((latest >= 0) & (until <= spans[np.maximum(latest, 0), 1]))
