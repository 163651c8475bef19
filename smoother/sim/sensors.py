"""From truth to samples: inertial unit, receiver and magnetometer, each with its errors.

Times inside this module are true times, s since the start of the session; what leaves it is stamped with the
session's clock. Every function draws from its own generator, so that changing one sensor leaves the others as they
were.
"""

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np
from pygeomag import GeoMag, calculate_decimal_year
from scipy.interpolate import BSpline
from scipy.signal import butter, lfilter

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.frames import Origin, nwu_to_geodetic
from smoother.samples import GnssFixes, RawImu, RawMag, WheelSpeed
from smoother.sim.scenario import GnssErrors, ImuErrors, Interval, MagErrors, WheelErrors
from smoother.sim.truth import Truth
from smoother.units import KNOT

TICKS_PER_SECOND = 1e6  # of the logger's clock
_SATELLITES, _HDOP = 10, 0.9


@dataclass(frozen=True, eq=False)
class SimulatedImu:
    """Samples and the true values behind them: biases (N, 3) m/s^2 and rad/s in s, true_time (N,) s of each sample."""

    raw: RawImu
    true_time: Array
    accel_bias_s: Array
    gyro_bias_s: Array


@dataclass(frozen=True, eq=False)
class SimulatedGnss:
    """Fixes and the true values behind them, one row per fix.

    position_time, velocity_time (N,) s: session times at which position and velocity were true; offset_n (N, 3) m,
    the Gauss-Markov error; jump_n (N, 3) m.
    """

    fixes: GnssFixes
    position_time: Array
    velocity_time: Array
    offset_n: Array
    jump_n: Array


@dataclass(frozen=True, eq=False)
class Wheel:
    """A steering wheel with the logger on it: angle, a spline over true time (rad over s), about axis_b (3,), unit."""

    angle: BSpline
    axis_b: Array

    def on_it(self, time: Array, force_b: Array, rate_b: Array) -> tuple[Array, Array]:
        """Force and rate, each (N, 3), at true times (N,) s in axes that are turned with the wheel."""
        R = so3.exp(self.angle(time)[:, None] * self.axis_b)
        own = self.angle(time, nu=1)[:, None] * self.axis_b
        return np.einsum("nji,nj->ni", R, force_b), np.einsum("nji,nj->ni", R, rate_b) + own


def simulate_imu(
    truth: Truth,
    errors: ImuErrors,
    R_bs: Array,
    duration: float,
    rng: np.random.Generator,
    wheel: Wheel | None = None,
) -> SimulatedImu:
    """Return inertial samples: means over the interval that ends at the (true) time of each.

    Noise has the standard deviation density * sqrt(rate), which is its density within the band that sampling leaves.
    Vibration is a tone sampled at that time, after gain and phase of the anti-alias filter, so it folds as it must.
    R_bs is the mounting of a logger that does not turn, or turns with `wheel`, whose angle is 0.
    """
    noise_rng, walk_rng, tone_rng, clock_rng = rng.spawn(4)
    time = np.arange(1, int(np.floor(duration * errors.rate + 1e-9)) + 1) / errors.rate
    at, interval = time - errors.latency, 1.0 / errors.rate
    accel_s, gyro_s = (mean_b @ R_bs for mean_b in mean_motion(truth, at, interval, wheel))
    if errors.accel_delay != 0.0:
        accel_s = mean_motion(truth, at - errors.accel_delay, interval, wheel)[0] @ R_bs
    accel_bias = errors.accel_bias + _walk(errors.accel_bias_walk, errors.rate, len(time), walk_rng)
    gyro_bias = errors.gyro_bias + _walk(errors.gyro_bias_walk, errors.rate, len(time), walk_rng)
    vibration = _vibration(truth, errors, time - errors.latency, tone_rng)
    noise = np.sqrt(errors.rate) * noise_rng.standard_normal((len(time), 6))
    accel = accel_s @ errors.accel_matrix.T + accel_bias + vibration[:, :3] + errors.accel_noise * noise[:, :3]
    gyro = gyro_s @ errors.gyro_matrix.T + gyro_bias + vibration[:, 3:] + errors.gyro_noise * noise[:, 3:]
    kept = ~_inside(time, errors.gaps)
    stamps = _stamps(truth.clock.to_session(time), errors.jitter, clock_rng)[kept]
    accel_counts, accel_scale = converted(accel[kept], errors.accel_range, errors.bits)
    gyro_counts, gyro_scale = converted(gyro[kept], errors.gyro_range, errors.bits)
    raw = RawImu(stamps, accel_counts, gyro_counts, accel_scale, gyro_scale, errors.accel_range, errors.gyro_range)
    return SimulatedImu(raw, time[kept], accel_bias[kept], gyro_bias[kept])


def mean_motion(truth: Truth, end: Array, interval: float, wheel: Wheel | None = None) -> tuple[Array, Array]:
    """Mean specific force and angular rate in b, each (N, 3), over `interval` s before the true times end (N,).

    On a wheel, in axes that are b where its angle is 0.
    """
    pieces = int(np.ceil(interval / 0.005))  # s; two Gauss points on it average motion of up to 25 Hz to 1e-4 of itself
    half = 0.5 * interval / pieces
    middles = -interval + half * (2.0 * np.arange(pieces) + 1.0)
    nodes = (middles[:, None] + half * np.array([-1.0, 1.0]) / np.sqrt(3.0)).ravel()  # two-point Gauss-Legendre
    force, rate = np.empty((len(end), 3)), np.empty((len(end), 3))
    rows = max(1, 50_000 // len(nodes))  # quadrature points evaluated at once: bounds the memory of sessions of hours
    for i in range(0, len(end), rows):
        chunk = end[i : i + rows, None] + nodes
        states = truth.at(truth.clock.to_session(chunk.ravel()))
        values = states.specific_force_b, states.angular_rate_b
        if wheel is not None:
            values = wheel.on_it(chunk.ravel(), *values)
        for out, value in zip((force, rate), values, strict=True):
            out[i : i + rows] = value.reshape(*chunk.shape, 3).mean(axis=1)
    return force, rate


def _walk(density: float, rate: float, count: int, rng: np.random.Generator) -> Array:
    steps = rng.standard_normal((count, 3))
    return np.asarray(density / np.sqrt(rate) * np.cumsum(steps, axis=0))


def filter_response(frequency: Array, cutoff_hz: float | None) -> np.ndarray:
    """Complex gain (N,) at frequency (N,) Hz of the second-order Butterworth filter before the sampling; 1 without."""
    if cutoff_hz is None:
        return np.ones(np.shape(frequency), dtype=np.complex128)
    numerator, denominator = butter(2, 2.0 * np.pi * cutoff_hz, analog=True)
    s = 2j * np.pi * np.asarray(frequency)
    return np.asarray(np.polyval(numerator, s) / np.polyval(denominator, s))


def _vibration(truth: Truth, errors: ImuErrors, time: Array, rng: np.random.Generator) -> Array:
    """Engine tone and its harmonics as sampled, (N, 6): accel m/s^2, gyro rad/s."""
    amplitude = np.repeat([errors.accel_tone, errors.gyro_tone], 3)
    phase = rng.uniform(0.0, 2.0 * np.pi, (len(errors.harmonics), 6))
    total = np.zeros((len(time), 6))
    if not np.any(amplitude):
        return total
    session_time = truth.clock.to_session(time)
    revolutions, rpm = truth.engine_revolutions(session_time), truth.engine_rpm(session_time)
    for order, (relative, shift) in enumerate(zip(errors.harmonics, phase, strict=True), start=1):
        response = filter_response(order * rpm / 60.0, errors.anti_alias_hz)
        angle = 2.0 * np.pi * order * revolutions + np.angle(response)
        total += relative * np.abs(response)[:, None] * np.sin(angle[:, None] + shift)
    return np.asarray(total * amplitude * truth.running(session_time)[:, None])


def _inside(time: Array, intervals: tuple[Interval, ...]) -> BoolArray:
    mask = np.zeros(len(time), dtype=np.bool_)
    for interval in intervals:
        mask |= (time >= interval.start) & (time < interval.start + interval.duration)
    return mask


def _stamps(time: Array, jitter: float, rng: np.random.Generator) -> Array:
    """Stamps (N,) s with jitter, in order: a logger's clock never runs backwards, however late it reads the sensor."""
    return _in_ticks(np.sort(time + jitter * rng.standard_normal(len(time))))


def _in_ticks(time: Array) -> Array:
    """Times (N,) s, in order, rounded to the clock's ticks, no two on the same one."""
    index = np.arange(len(time))
    ticks = np.maximum.accumulate(np.round(time * TICKS_PER_SECOND).astype(np.int64) - index) + index
    return np.asarray(ticks / TICKS_PER_SECOND)  # the nearest float64 to the decimal, as a file gives it back


def converted(values: Array, full_scale: float | None, bits: int | None) -> tuple[Array, float]:
    """Return counts (N, 3) of values (N, 3), clipped and rounded as by the converter, and the scale of one count."""
    if full_scale is None:
        return values, 1.0
    if bits is None:
        return np.clip(values, -full_scale, full_scale), 1.0
    half = 2.0 ** (bits - 1)
    scale = full_scale / half
    return np.clip(np.round(values / scale), -half, half - 1.0), scale


def simulate_gnss(
    truth: Truth, errors: GnssErrors, lever_arm_b: Array, duration: float, start_unix: float, rng: np.random.Generator
) -> SimulatedGnss:
    """Return the fixes received during the session. Epochs are whole multiples of 1/rate of true time, as in UTC."""
    white_rng, offset_rng, velocity_rng, stamp_rng = rng.spawn(4)
    epoch = np.arange(0, int(np.floor(duration * errors.rate + 1e-9)) + 1) / errors.rate
    n = len(epoch)
    sigma = np.array([errors.white_horizontal, errors.white_horizontal, errors.white_up])
    offset = _gauss_markov(n, errors.rate, errors.offset_tau, offset_rng)
    offset = offset * np.array([errors.offset_horizontal, errors.offset_horizontal, errors.offset_up])
    jump = _jumps(errors, epoch)
    at_epoch = truth.clock.to_session(epoch)
    velocity_time = at_epoch - (errors.velocity_latency - errors.position_latency)
    position = truth.antenna_position_n(at_epoch, lever_arm_b) + offset + jump
    position = position + sigma * white_rng.standard_normal((n, 3))
    velocity = truth.antenna_velocity_n(velocity_time, lever_arm_b)
    velocity = velocity + errors.velocity_sigma * velocity_rng.standard_normal((n, 3))
    if errors.velocity_lasting > 0.0:
        lasting = _gauss_markov(n, errors.rate, errors.velocity_tau, velocity_rng)
        velocity = velocity + errors.velocity_lasting * lasting
    stamps = at_epoch + errors.position_latency + errors.receive_jitter * stamp_rng.standard_exponential(n)
    stamps = _in_ticks(np.maximum.accumulate(stamps))  # sentences cannot overtake each other
    # what arrives after the end is not recorded
    kept = ~_inside(epoch, errors.outages) & (stamps <= truth.clock.to_session(np.asarray(duration)))
    fixes = _fixes(stamps, position, velocity, start_unix + epoch, truth.origin, errors)
    return SimulatedGnss(fixes.select(kept), at_epoch[kept], velocity_time[kept], offset[kept], jump[kept])


def _gauss_markov(count: int, rate: float, tau: float, rng: np.random.Generator) -> Array:
    """First-order Gauss-Markov process (N, 3) of variance one, stationary from the start, discretised exactly."""
    drive = rng.standard_normal((count, 3))
    memory = np.exp(-1.0 / (rate * tau))
    drive[1:] *= np.sqrt(1.0 - memory**2)
    return np.asarray(lfilter([1.0], [1.0, -memory], drive, axis=0))


def _jumps(errors: GnssErrors, epoch: Array) -> Array:
    total = np.zeros((len(epoch), 3))
    for jump in errors.jumps:
        total[_inside(epoch, (Interval(jump.start, jump.duration),))] += jump.offset_n
    return total


def _fixes(
    stamps: Array, position_n: Array, velocity_n: Array, unix_s: Array, origin: Origin, errors: GnssErrors
) -> GnssFixes:
    lat, lon, alt = nwu_to_geodetic(position_n, origin)
    speed = np.hypot(velocity_n[:, 0], velocity_n[:, 1])
    course = np.mod(np.degrees(np.arctan2(-velocity_n[:, 1], velocity_n[:, 0])), 360.0)
    if errors.rounding:
        steps = (1e-5 / 60.0, 1e-5 / 60.0, 0.1, 1e-3 * KNOT, 1e-2)  # of a NEO-6M
        values = zip((lat, lon, alt, speed, course), steps, strict=True)
        lat, lon, alt, speed, course = (np.round(value / step) * step for value, step in values)
        course = np.mod(course, 360.0)
    n = len(stamps)
    if not errors.velocity:
        speed, course = np.full(n, np.nan), np.full(n, np.nan)
    up = velocity_n[:, 2] if errors.velocity and errors.has_vertical_velocity else np.full(n, np.nan)
    angle = np.radians(course)
    sigma_horizontal = np.hypot(errors.white_horizontal, errors.offset_horizontal)
    sigma_up = np.hypot(errors.white_up, errors.offset_up)
    sigma_velocity = float(np.hypot(errors.velocity_sigma, errors.velocity_lasting))
    return GnssFixes(
        t=stamps,
        lat_deg=lat,
        lon_deg=lon,
        alt_m=alt,
        velocity_n=np.stack([speed * np.cos(angle), -speed * np.sin(angle), up], axis=-1),
        speed=speed,
        course_deg=course,
        sigma_horizontal=_reported(sigma_horizontal, errors.hacc_factor, n),
        sigma_up=_reported(sigma_up, errors.hacc_factor, n),
        sigma_velocity=_reported(sigma_velocity, errors.sacc_factor if errors.velocity else None, n),
        hdop=np.full(n, _HDOP),
        unix_s=unix_s,
        num_sv=np.full(n, _SATELLITES),
        fix=np.ones(n),
    )


def _reported(sigma: float, factor: float | None, count: int) -> Array:
    return np.full(count, np.nan if factor is None else factor * sigma)


def earth_field_n(origin: Origin, unix_s: float) -> Array:
    """Magnetic field (3,) uT in n at a place and time, from the World Magnetic Model."""
    year = calculate_decimal_year(datetime.fromtimestamp(unix_s, UTC))
    field = GeoMag().calculate(glat=origin.lat_deg, glon=origin.lon_deg, alt=origin.alt_m / 1000.0, time=year)
    return np.array([field.x, -field.y, -field.z]) / 1000.0  # nT north, east, down


def simulate_mag(
    truth: Truth,
    errors: MagErrors,
    field_n: Array,
    R_bs: Array,
    duration: float,
    rng: np.random.Generator,
    wheel: Wheel | None = None,
) -> RawMag:
    """Return readings in microtesla; they are instantaneous and stamped without delay."""
    time = np.arange(1, int(np.floor(duration * errors.rate + 1e-9)) + 1) / errors.rate
    session_time = truth.clock.to_session(time)
    strength = float(np.linalg.norm(field_n))
    field_b = truth.at(session_time).R_nb.swapaxes(1, 2) @ field_n
    field_s = (field_b if wheel is None else wheel.on_it(time, field_b, field_b)[0]) @ R_bs
    # current follows throttle and rpm; 0..1 over the session
    load = truth.running(session_time) * truth.throttle(session_time) * truth.engine_rpm(session_time)
    load = load / max(float(np.max(load)), 1e-9)
    engine = errors.engine_disturbance * strength * load[:, None] * errors.engine_direction_s
    return RawMag(_in_ticks(session_time), mag_reading(field_s + engine, errors, strength, rng))


def simulate_wheel_speed(truth: Truth, errors: WheelErrors, duration: float, rng: np.random.Generator) -> WheelSpeed:
    """Return the speed of a wheel; one that turns backwards reads as zero."""
    time = np.arange(1, int(np.floor(duration * errors.rate + 1e-9)) + 1) / errors.rate
    session_time = truth.clock.to_session(time)
    states = truth.at(session_time - errors.latency)
    forward_n, turn_rate = states.R_nb[:, :, 0], states.angular_rate_b[:, 2]
    speed, acceleration = (np.sum(x * forward_n, axis=1) for x in (states.velocity_n, states.acceleration_n))
    of_wheel = (speed - errors.side * turn_rate) * (1.0 + errors.scale + errors.slip * acceleration)
    error = errors.noise * rng.standard_normal(len(time))
    error += errors.lasting * _gauss_markov(len(time), errors.rate, errors.lasting_tau, rng)[:, 0]
    return WheelSpeed(_in_ticks(session_time), np.where(speed > 0.0, np.maximum(of_wheel + error, 0.0), 0.0))


def simulate_mag_calibration(errors: MagErrors, field_n: Array, rng: np.random.Generator) -> Array | None:
    """Readings (K, 3) uT while the logger is turned in all directions, engine off; None if there are to be none."""
    if errors.calibration_points == 0:
        return None
    direction = rng.standard_normal((errors.calibration_points, 3))
    strength = float(np.linalg.norm(field_n))
    field_s = strength * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    return mag_reading(field_s, errors, strength, rng)


def mag_reading(field_s: Array, errors: MagErrors, strength: float, rng: np.random.Generator) -> Array:
    """Return readings (N, 3) uT of a field (N, 3) uT in axes s; strength uT is that of the field of the Earth."""
    noise = errors.noise * strength * rng.standard_normal(field_s.shape)
    reading = field_s @ errors.soft_iron.T + errors.hard_iron_s + noise
    if errors.resolution is None:
        return np.asarray(reading)
    return np.asarray(np.round(reading / errors.resolution) * errors.resolution)
