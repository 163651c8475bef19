"""Attitude to start from: for any mounting of the sensor, with or without a standstill.

While a kart drives, it points nearly along its path and is nearly level. So, in axes of the path (forward, left, up),
rate and specific force are known from the fixes: the rate is the course's rate about up, the force is the path's
acceleration plus g upwards. Both are linear in the measurements,

    angular_rate_s   = R_sb (0, 0, yaw_rate)          + gyro_bias,
    specific_force_s = R_sb (a_forward, a_left, g)    + accel_bias,

and a least-squares fit over the whole session averages vibration. The slopes are directions of the kart's axes in s:
together they give the mounting by Wahba's problem; the intercept of the first line is the gyro bias. The fit at shifted
times gives the lag of the fixes. Without enough motion gravity alone levels the sensor. Gains of a known unit convert a
gyroscope; with any other factor the sensor is not used.
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother import so3
from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces, release, roomy
from smoother.estimate.fixes.screen import has_velocities
from smoother.estimate.initial.align_rare import RareAlignment, align_rare, are_rare
from smoother.estimate.preprocess.gains import Gains
from smoother.estimate.preprocess.streams import (
    LAGS,
    MIN_SPEED,
    WINDOW,
    PathMotion,
    averages_of,
    in_gap,
    path_axes,
    peak,
    sampled_at_speed,
    steps,
    thinned,
)
from smoother.frames import rotation_from_euler, wrap_angle
from smoother.samples import GnssFixes, ImuSamples, Problem, RawImu, RawSession
from smoother.units import DEG, STANDARD_GRAVITY

# fixes at speed that determine the mounting; and more than the noise of a parked kart gives
FEWEST_AT_SPEED, SOME_AT_SPEED = 30, 10
STUCK = 1e-4  # m/s^2 or rad/s of scatter, less than the last digit of a sensor on a moving kart
ROUNDS = 6  # of reweighting
UNKNOWN = 1e-15  # share of the largest eigenvalue below which one is rounding
FINER_LAGS = np.array([-0.05, 0.0, 0.05])  # s about the best of them
# fixes, evenly taken, for a rough lag and for the fit: with a kart's vibration 4000 give the mounting to 0.1 deg
ENOUGH_FOR_LAG, ENOUGH = 500, 4000
SETTLED = 10.0  # s of driving over which the sideslip is averaged; a spin takes 1 to 2 s
SPUN = np.pi / 4.0  # rad off that mean, before and after, of a spin
BESIDE_SPIN = 1.0  # s
MOST_SPUN = 0.4  # share of the fixes; beyond it the gyroscope is wrong


@dataclass(frozen=True, eq=False)
class Alignment:
    """R_bs (3, 3) rough mounting; gyro_bias_s (3,) rad/s; lag, s, of the fixes behind the IMU.

    share_explained: part (0..1) of rate and force that the fixes explain. is_level_only: the heading of the sensor in
    the kart is unknown, for want of fixes at speed. accel_noise m/s^2/sqrt(Hz), gyro_noise rad/s/sqrt(Hz): densities of
    white noise that would explain the rest, upper bounds. problems: axes of the sensor that no rotation explains.
    gains: see `preprocess.gains`; None without fixes at speed. by_changes: fixes are rare; share_explained is that of
    turns and of changes of velocity from one fix to the next, whichever is less.
    """

    R_bs: Array
    gyro_bias_s: Array
    lag: float
    share_explained: float
    is_level_only: bool
    accel_noise: float = 0.0
    gyro_noise: float = 0.0
    problems: tuple[Problem, ...] = ()
    gains: Gains | None = None
    by_changes: bool = False

    @property
    def is_misnamed(self) -> bool:
        """Whether axes are wrong on a steering wheel, too."""
        return self.gains is not None and self.gains.is_beyond_wheel


def align(imu: ImuSamples, path: PathMotion) -> Alignment:
    """Fit mounting, gyro bias and lag to a whole session; see the module's text."""
    if path.is_measured and are_rare(path.t) and (rare := align_rare(imu, path)) is not None:
        return _of_rare(rare)
    use = sampled_at_speed(imu, path)
    if use.size < FEWEST_AT_SPEED:
        return _level_only(imu, use.size)
    averages, axes = averages_of(imu), path_axes(path)

    def best(tried: Array, rows: IntArray) -> float:
        force, rate = averages.around(path.t[rows] - tried[:, None], WINDOW)
        return peak(tried, _fit_lines(axes[rows, :2], force).share + _fit_lines(axes[rows, 2:], rate).share)

    few, use = thinned(use, ENOUGH_FOR_LAG), thinned(use, ENOUGH)
    lag = best(best(LAGS, few) + FINER_LAGS, use)
    return _fit(axes[use], *averages.around(path.t[use] - lag, WINDOW), lag)


def _unsampled(sampled: Array, t: Array) -> BoolArray:
    """Mask (N,) of times t s in or beside a stretch without samples, also before the first and after the last one."""
    return np.asarray(in_gap(sampled, t) | (t < sampled[0]) | (t > sampled[-1]))


def _of_rare(found: RareAlignment) -> Alignment:
    share = max(min(found.turned, found.moved), 0.0)
    noise = found.accel_noise, found.gyro_noise
    return Alignment(found.R_bs, found.gyro_bias_s, found.lag, share, False, *noise, by_changes=True)


def _fit(axes: Array, force: Array, rate: Array, lag: float) -> Alignment:
    """Mounting and biases from motion along the path's axes (N, 3) and what the IMU measured, each (N, 3)."""
    rate_fit, force_fit = _fit_lines(axes[:, 2:], rate), _fit_lines(axes[:, :2], force)
    # each slope is a direction of the kart's axis in the sensor; gravity's is the intercept of the force
    gains = Gains.of(force_fit.lines, rate_fit.lines, float(force_fit.share), float(rate_fit.share))
    directions_s = np.concatenate([gains.force.T, gains.turn[None]])
    directions_b = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0, 0, 1.0]])
    forward, left, yaw_rate = np.std(axes, axis=0)
    weights = np.array([forward, left, STANDARD_GRAVITY, 10.0 * yaw_rate])
    turned = np.einsum("i,ij,ik->ijk", weights, directions_b, directions_s)
    share, root = 0.5 * float(rate_fit.share + force_fit.share), float(np.sqrt(WINDOW))
    return Alignment(
        so3.normalized(turned.sum(axis=0)),
        rate_fit.lines[1],
        lag,
        share,
        False,
        float(force_fit.rest) * root,
        float(rate_fit.rest) * root,
        gains.problems(),
        gains,
    )


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines (..., p + 1, 3): slopes, then intercept; share explained (...); robust rms per axis of the rest (...)."""

    lines: Array
    share: Array
    rest: Array


def _fit_lines(known: Array, measured: Array) -> _Lines:
    """Lines through measured (..., N, 3) over known (N, p), by least squares with Cauchy weights."""
    design = np.concatenate([known.T, np.ones((1, len(known)))])
    values = np.ascontiguousarray(np.moveaxis(measured, -1, -2))  # (..., 3, N): what is long comes last, for speed
    weight = np.ones(measured.shape[:-1])
    for _ in range(ROUNDS):
        weighted = weight[..., None, :] * design
        lines = _least(weighted @ design.T, weighted @ measured)
        squared = _squared_length(values - np.moveaxis(lines, -1, -2) @ design)
        median = np.median(np.sqrt(squared), axis=-1, keepdims=True)
        weight = 1.0 / (1.0 + squared / (2.0 * (median + 1e-9)) ** 2)
    total = np.sum(weight, axis=-1)
    mean = (values @ weight[..., None]) / total[..., None, None]
    unexplained = np.sum(weight * squared, axis=-1) / total
    spread = np.sum(weight * _squared_length(values - mean), axis=-1) / total
    # a sensor that always reads the same has nothing to be explained
    share = np.where(spread > STUCK**2, 1.0 - unexplained / np.maximum(spread, STUCK**2), 0.0)
    return _Lines(lines, share, median[..., 0] / 1.538)  # median of chi(3)


def _least(normal: Array, right: Array) -> Array:
    """Smallest solution (..., p, 3) of normal equations (..., p, p): a kart that never turns leaves a slope open."""
    values, vectors = np.linalg.eigh(normal)
    is_known = values > UNKNOWN * values[..., -1:]
    inverse = np.where(is_known, 1.0 / np.where(is_known, values, 1.0), 0.0)
    return np.asarray((vectors * inverse[..., None, :]) @ (np.moveaxis(vectors, -1, -2) @ right))


def _squared_length(vectors: Array) -> Array:
    """Squared length (..., N) of vectors (..., 3, N)."""
    return np.asarray(np.einsum("...in,...in->...n", vectors, vectors))


def _level_only(imu: ImuSamples, at_speed: int) -> Alignment:
    up_s = np.median(imu.specific_force_s, axis=0)
    up_s = up_s / max(float(np.linalg.norm(up_s)), 1e-9)
    problems: tuple[Problem, ...] = ()
    if at_speed >= SOME_AT_SPEED:
        text = (
            f"only {at_speed} fixes at more than {MIN_SPEED:.0f} m/s (at least {FEWEST_AT_SPEED}): the heading of the "
            "logger in the kart is unknown, and yaw with it"
        )
        problems = (Problem("heading_unknown", text),)
    gyro_bias_s = np.median(imu.angular_rate_s, axis=0)
    return Alignment(so3.rotation_to_up(up_s), gyro_bias_s, 0.0, 0.0, True, problems=problems)


def initial_attitude(t: Array, imu: ImuSamples, path: PathMotion, alignment: Alignment) -> Array:
    """Attitude R_ns (K, 3, 3) at t (K,): level, yaw from the course while moving, from the gyro in between.

    The difference of course and integrated rate, smoothed over seconds, is added to the latter, and held at stops. In a
    spin yaw is that of the gyroscope alone, else the rotation would be lost. Where samples are missing, yaw is the
    course.
    """
    of_gyro = gyro_yaw(imu, alignment)
    moving = path.moves
    if alignment.is_level_only or not np.any(moving):
        yaw = np.interp(t, imu.t, of_gyro)
    else:
        times, course = path.t[moving] - alignment.lag, path.yaw[moving]
        seen = ~_unsampled(imu.t, times)
        if not np.any(seen):
            seen[:] = True
        difference = course[seen] - np.interp(times[seen], imu.t, of_gyro)
        straight = ~_spinning(times[seen], difference)
        known = times[seen][straight], _unwrapped(times[seen][straight], difference[straight])
        yaw = np.interp(t, imu.t, of_gyro) + _smoothed(t, *known, 3.0)
        yaw = np.where(_unsampled(imu.t, t), np.interp(t, times, np.unwrap(course)), yaw)
    level = np.zeros(len(t))
    return rotation_from_euler(level, level, yaw) @ alignment.R_bs


def _unwrapped(t: Array, angle: Array) -> Array:
    """Angles (N,) rad at t (N,) s, N at least 1, without steps of a whole turn, after a steady drift is removed."""
    if len(t) < 2:
        return angle
    drift = float(np.median(np.diff(np.unwrap(angle)) / np.diff(t))) * t
    return np.asarray(np.unwrap(angle - drift) + drift)


def _spinning(t: Array, difference: Array) -> BoolArray:
    """Mask (N,) of fixes t s in or BESIDE_SPIN of a spin: far off the mean of SETTLED before and after.

    difference (N,) rad: course less the integrated rate.
    """
    n = len(t)
    count = max(1, round(SETTLED / max(float(np.median(np.diff(t))), 1e-3))) if n > 1 else 1
    sums = np.concatenate([[0.0], np.cumsum(np.exp(1j * difference))])
    k = np.arange(n)
    spinning = np.ones(n, dtype=np.bool_)
    for first, last in ((np.maximum(k - count, 0), k + 1), (k, np.minimum(k + count + 1, n))):
        off = np.abs(wrap_angle(difference - np.angle(sums[last] - sums[first])))
        spinning &= (off > SPUN) | (last - first < count // 2)
    spun = np.concatenate([[-np.inf], t[spinning], [np.inf]])
    after = np.clip(np.searchsorted(spun, t), 1, len(spun) - 1)
    beside = np.minimum(spun[after] - t, t - spun[after - 1]) < BESIDE_SPIN
    return np.asarray(beside & (np.mean(beside) < MOST_SPUN))


def gyro_yaw(imu: ImuSamples, alignment: Alignment) -> Array:
    """Turn about up since the first sample, (N,) rad; of a gap half a second counts."""
    yaw, before = roomy(len(imu.t)), 0.0
    for part in pieces(len(imu.t)):
        rate_up = (imu.angular_rate_s[part] - alignment.gyro_bias_s) @ alignment.R_bs[2]
        yaw[part] = before + np.cumsum(rate_up * np.clip(steps(imu.t, part), 0.0, 0.5))
        before = float(yaw[part.stop - 1])
        release(imu, yaw)
    return yaw


def _smoothed(t: Array, times: Array, values: Array, width: float) -> Array:
    """Mean of `values` over `width` seconds around t, the nearest ones where none fall into the window."""
    cumulative = np.concatenate([[0.0], np.cumsum(values)])
    i = np.searchsorted(times, t - 0.5 * width)
    j = np.searchsorted(times, t + 0.5 * width)
    empty = i >= j
    mean = (cumulative[j] - cumulative[i]) / np.maximum(j - i, 1)
    return np.where(empty, np.interp(t, times, values), mean)


ENOUGH_SAMPLES = 1 << 20  # samples from the beginning, an hour and a half at 200 Hz
LIKELY_TURN = (0.5, 2.0)  # of the course; boxes of karts and cars have 0.85 to 1.02
LIKELY_FORCE = (0.75, 1.4)  # of gravity; likewise 0.95 to 1.07
SAME_UNIT = 0.2  # share; the nearest two units are many times apart
TURN_UNITS = {  # how many times too fast
    "with deg/s where rad/s belong": 1.0 / DEG,
    "with rad/s where deg/s belong": DEG,
    "with thousandths of a rad/s": 1e3,
}


def in_known_units(raw: RawSession) -> RawSession:
    """Return the session with a gyroscope in rad/s, or without a motion sensor that is off by another factor."""
    found = None if raw.imu is None else aligned(raw.imu, raw.gnss)
    if raw.imu is None or found is None or found.gains is None:
        return raw
    force, turn = found.gains.force_scale, found.gains.turn_scale
    if force < LIKELY_FORCE[0] or force > LIKELY_FORCE[1]:
        return _without_imu(raw, f"the sensor measures {force:.3g} times gravity; are ax, ay, az in m/s^2?")
    if not (turn < LIKELY_TURN[0] or turn > LIKELY_TURN[1]):  # NaN: not explained
        return raw
    text = f"the turn rates are {turn:.3g} times that of the course of the fixes"
    unit = next((name for name, size in TURN_UNITS.items() if abs(turn / size - 1.0) < SAME_UNIT), None)
    if unit is None:
        return _without_imu(raw, f"{text}; are gx, gy, gz in rad/s?")
    slower = _turning_slower(raw.imu, TURN_UNITS[unit])
    return replace(raw, imu=slower, problems=(*raw.problems, Problem("imu_gyro_unit", f"{text}, as {unit}; converted")))


def aligned(imu: RawImu, fixes: GnssFixes) -> Alignment | None:
    """Return the alignment by the first ENOUGH_SAMPLES samples, None without velocities."""
    driven = has_velocities(fixes.velocity_n)
    if len(imu.t) < 2 or not driven.any():
        return None
    return align(beginning(imu), PathMotion(fixes.t[driven], fixes.velocity_n[driven]))


def beginning(imu: RawImu, most: int = ENOUGH_SAMPLES) -> ImuSamples:
    """Return the first samples, `most` of them, as if calibrated."""
    return ImuSamples(imu.t[:most], imu.accel[:most] * imu.accel_scale, imu.gyro[:most] * imu.gyro_scale)


def _turning_slower(imu: RawImu, times: float) -> RawImu:
    full_scale = None if imu.gyro_full_scale is None else imu.gyro_full_scale / times
    return replace(imu, gyro_scale=imu.gyro_scale / times, gyro_full_scale=full_scale)


def _without_imu(raw: RawSession, reason: str) -> RawSession:
    problem = Problem("imu_implausible", f"{reason}: smoothed from GPS alone")
    return replace(raw, imu=None, problems=(*raw.problems, problem))
