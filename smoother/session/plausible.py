"""Whether inertial samples are in m/s^2 and rad/s, by the usual size of force and rate."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.disc import thinned
from smoother.samples import Problem, RawImu
from smoother.units import DEG, STANDARD_GRAVITY

ENOUGH_SAMPLES = 20_000  # evenly taken, to know the usual size of force and rate
PLAUSIBLE_FORCE = (4.0, 40.0)  # m/s^2, median: outside, the unit is wrong (g, mg) or the sensor dead
STEADY_PARTS, STEADY_TIME = 8, 10.0  # of a recording, at most, and s of each at least: each of them has gravity
LEAST_STEADY, LEAST_STEADY_SHARE = 2.5, 0.5  # m/s^2 and of the usual force, that is always there: gravity is
LEAST_MOTION = 0.5  # m/s^2; less is a dead sensor
PLAUSIBLE_RATE = (0.0, 8.0)  # rad/s, median of 460 deg/s: degrees were written for radians
FEWEST_LEFT = 100  # samples
LARGEST = 1e6  # of what is written for a sample, in whatever unit: milli-g and counts of 16 bits are less
GRAVITY_IN_G = (0.7, 1.5)  # what stays of samples in g: gravity, and the mean force of bends all to one side
MILLI = 1e-3  # of mg and mdeg/s, which tools of sensor makers write together


@dataclass(frozen=True)
class _Sensor:
    """Samples of one sensor and what is usual of them, SI; `said` completes what is said of another size.

    has_gravity: vibration may be larger than what is usual, but in its mean gravity is left.
    """

    values: Array
    scale: float
    usual: tuple[float, float]
    said: str
    has_gravity: bool = False

    def sizes(self, values: Array) -> Array:
        """Length (...) of samples (..., 3), SI."""
        return np.asarray(np.linalg.norm(values, axis=-1) * self.scale)

    def typical(self, values: Array) -> Array:
        """Median length (K,) of each of (K, N, 3) samples; where vibration makes it large, that of their mean, SI."""
        median_size = np.median(self.sizes(values), axis=-1)
        if not self.has_gravity:
            return np.asarray(median_size)
        low, high = self.usual
        steady = np.maximum(self.sizes(np.mean(values, axis=-2)), low)
        return np.asarray(np.where(median_size > high, steady, median_size))

    def is_off(self, size: Array | float) -> BoolArray:
        low, high = self.usual
        return np.asarray((size < low) | (size > high))

    def reason(self, size: float) -> str:
        return self.said.format(size)


def _sensors(imu: RawImu) -> tuple[_Sensor, _Sensor]:
    force = "typically {:.2g} m/s^2, where gravity alone gives 9.8; are ax, ay, az in m/s^2?"
    rate = "typically {:.0f} rad/s, which no kart turns; are gx, gy, gz in rad/s?"
    return (
        _Sensor(imu.accel, imu.accel_scale, PLAUSIBLE_FORCE, force, has_gravity=True),
        _Sensor(imu.gyro, imu.gyro_scale, PLAUSIBLE_RATE, rate),
    )


def _are_measured(some: Array) -> BoolArray:
    """Mask (N,) of the samples (N, 3) that a sensor can have read: one damaged number would be the mean of many."""
    return np.asarray(np.all(np.abs(some) < LARGEST, axis=1))


def turned_to_radians(gyro: Array, file: str, *, is_milli: bool = False) -> list[Problem]:
    """Turn rates (N, 3), which the caller gives away, into rad/s where they are as large as of a kart in deg/s only.

    is_milli: in mdeg/s only, beside accelerations in mg; alone they may be counts of the sensor. Where they are neither
    after all, the course of the fixes tells. Says what it did; `file` is the name for that.
    """
    some = thinned(gyro, max(1, len(gyro) // ENOUGH_SAMPLES))
    known = np.linalg.norm(some[_are_measured(some)], axis=1)
    size, most = median(known) if known.size else 0.0, PLAUSIBLE_RATE[1]
    units = [("deg/s", DEG), ("mdeg/s", MILLI * DEG)]
    for name, unit in units if is_milli else units[:1]:
        if known.size >= FEWEST_LEFT and most < size <= most / unit:
            gyro *= unit
            text = f"typically {size:.0f} rad/s, which no kart turns, as with {name} where rad/s belong; taken so"
            return [Problem("imu_gyro_unit", f"{file}: {text}")]
    return []


def are_in_milli_g(accel: Array, t: Array) -> bool:
    """Whether what stays of accelerations (N, 3) at t (N,) s, as written, is gravity in mg."""
    some, lasts = _written(accel, t)
    return len(some) >= FEWEST_LEFT and _is_gravity(some * MILLI, lasts)


def turned_to_metres(accel: Array, t: Array, file: str) -> list[Problem]:
    """Turn accelerations (N, 3), which the caller gives away, into m/s^2 where gravity in g or mg stays of them.

    t (N,) s, as written. In m/s^2 forces as small
    are those without gravity, which change with every bend, and stay as they are. Says what it did; `file` is the name
    for that.
    """
    some, lasts = _written(accel, t)
    if len(some) < FEWEST_LEFT:
        return []
    for name, unit in (("g", 1.0), ("mg", MILLI)):
        if _is_gravity(some * unit, lasts):
            with np.errstate(over="ignore"):  # what no sensor writes is left out later
                accel *= unit * STANDARD_GRAVITY
            size = median(np.linalg.norm(some, axis=1))
            text = f"typically {size:.2g} m/s^2, where gravity alone gives 9.8, as with {name} where m/s^2 belong"
            return [Problem("imu_accel_unit", f"{file}: {text}; taken so")]
    return []


def _written(accel: Array, t: Array) -> tuple[Array, float]:
    """Samples (M, 3) that a sensor can have read, evenly taken from (N, 3) at t (N,) s, and how long they last, s."""
    step = max(1, len(accel) // ENOUGH_SAMPLES)
    some, times = thinned(accel, step), thinned(t, step)
    known = _are_measured(some) & np.isfinite(times)
    times = times[known]
    return some[known], float(times[-1] - times[0]) if len(times) else 0.0


def _is_gravity(some: Array, lasts: float) -> bool:
    """Whether what stays of forces (M, 3) in g, evenly taken from `lasts` s, is gravity."""
    (low, high), size, steady = GRAVITY_IN_G, median(np.linalg.norm(some, axis=1)), _steady(some, lasts)
    return bool(size < PLAUSIBLE_FORCE[0] and low < steady < high and steady > LEAST_STEADY_SHARE * size)


def implausible_units(imu: RawImu) -> Iterator[str]:
    """Yield what speaks against the units of samples, one or more, as a whole."""
    step = max(1, imu.t.size // ENOUGH_SAMPLES)
    if _has_no_gravity(imu, thinned(imu.accel, step)):
        yield "no gravity in ax, ay, az; is it linear acceleration? It has to be with gravity"
        return
    for sensor in _sensors(imu):
        some = thinned(sensor.values, step)
        size = median(sensor.sizes(some))
        if size > sensor.usual[1]:  # it may be vibration
            size = median(np.concatenate([sensor.typical(part[None]) for part in _parts(some, imu.t[-1] - imu.t[0])]))
        if sensor.is_off(size):
            yield sensor.reason(size)


def _has_no_gravity(imu: RawImu, some: Array) -> bool:
    """Whether samples move without a force that stays; some (N, 3) : of `imu.accel`, evenly taken."""
    force = median(np.linalg.norm(some, axis=1)) * imu.accel_scale
    steady = _steady(some, imu.t[-1] - imu.t[0]) * imu.accel_scale
    return bool(steady < min(LEAST_STEADY_SHARE * force, LEAST_STEADY) and force > LEAST_MOTION)


def _steady(some: Array, lasts: float) -> float:
    """Size of what stays of forces (N, 3), evenly taken from a recording that lasts so many s: gravity, if any."""
    return median(np.array([np.linalg.norm(np.mean(part, axis=0)) for part in _parts(some, lasts)]))


def _parts(some: Array, lasts: float) -> list[Array]:
    """Some (N, 3) of the samples in a few parts: a box that turns over in one of them has gravity in all others."""
    return np.array_split(some, int(np.clip(lasts / STEADY_TIME, 1, STEADY_PARTS)))
