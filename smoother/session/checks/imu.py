"""Checks of inertial samples: units, values that no sensor measures, dead axes."""

from collections.abc import Callable

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.disc import pieces, release, thinned
from smoother.samples import DEAD_AXES, RawImu
from smoother.session.checks.counts import counts
from smoother.session.checks.table import Check, Finding, dropped
from smoother.session.inertial import FEWEST_IMU_SAMPLES, dead_axes
from smoother.session.recorded import Recording
from smoother.units import DEG, STANDARD_GRAVITY
from smoother.words import counted

ENOUGH_SAMPLES = 20_000  # evenly taken, to know the usual size of force and rate
SLOWEST_IMU = 20.0  # Hz; below, a kart's motion between samples is lost (contract, section 3)
SAME_RATE = 0.02  # share; a clock or its digits may make 20 Hz a little less
IN_ANOTHER_UNIT = 1.0  # s from sample to sample
LARGEST = 1e6  # of what is written for a sample, in whatever unit: milli-g and counts of 16 bits are less
PLAUSIBLE_FORCE = (4.0, 40.0)  # m/s^2, median: outside, the unit is wrong or the sensor dead
LARGEST_RATE = 8.0  # rad/s, median of 460 deg/s: degrees were written for radians
ABSURD_FORCE, ABSURD_RATE = 1000.0, 100.0  # m/s^2, rad/s; no sensor of a kart reads more
GRAVITY_IN_G = (0.7, 1.5)  # what stays of samples in g: gravity, and the mean force of bends all to one side
FORCE_UNITS = {"g": 1.0, "mg": 1e-3}  # in g
RATE_UNITS = {"deg/s": DEG, "mdeg/s": 1e-3 * DEG}  # in rad/s
STEADY_PARTS, STEADY_TIME = 8, 10.0  # of a recording, at most, and s of each at least: each of them has gravity
LEAST_STEADY, LEAST_STEADY_SHARE = 2.5, 0.5  # m/s^2 and of the usual force, that is always there: gravity is
LEAST_MOTION = 0.5  # m/s^2; less is a dead sensor


def force_unit(r: Recording) -> Finding | None:
    """Forces in g or mg, by gravity, which stays of them. In m/s^2 as small ones change with every bend, and stay."""
    some, lasts = _some(r.samples, r.samples.accel)
    for name, unit in FORCE_UNITS.items():
        size, steady = _usual(some * unit), _steady(some * unit, lasts)
        if size < PLAUSIBLE_FORCE[0] and steady > LEAST_STEADY_SHARE * size and _within(steady, GRAVITY_IN_G):
            text = f"typically {size / unit:.2g} m/s^2, where gravity alone gives 9.8, as with {name}; taken so"
            return Finding(text, scale={"accel_scale": unit * STANDARD_GRAVITY})
    return None


def rate_unit(r: Recording) -> Finding | None:
    """Rates in deg/s, or mdeg/s beside forces in mg: as large as of no kart in rad/s."""
    size = _usual(_some(r.samples, r.samples.gyro)[0]) * r.samples.gyro_scale
    is_milli = r.samples.accel_scale < 2.0 * FORCE_UNITS["mg"] * STANDARD_GRAVITY
    for name, unit in RATE_UNITS.items():
        if LARGEST_RATE < size <= LARGEST_RATE / unit and (name == "deg/s" or is_milli):
            text = f"typically {size:.0f} rad/s, which no kart turns, as with {name}; taken so"
            return Finding(text, scale={"gyro_scale": unit})
    return None


def too_slow(r: Recording) -> Finding | None:
    """Samples too rare for the motion between them."""
    period = median(np.diff(r.samples.t))
    if period * SLOWEST_IMU <= 1.0 + SAME_RATE:
        return None
    asked = "; is t_s in seconds?" if period > IN_ANOTHER_UNIT else ""
    rates = f"{1 / period:.3g} samples a second, {SLOWEST_IMU:.0f} are needed"
    return _unusable(r, f"the motion sensor is too slow ({rates}{asked})")


def implausible(r: Recording) -> Finding | None:
    """Samples that are no specific force or no rate, whatever is wrong with them."""
    imu = r.samples
    force, lasts = _some(imu, imu.accel)
    force, size = force * imu.accel_scale, _usual(force) * imu.accel_scale
    steady = _steady(force, lasts)
    if steady < min(LEAST_STEADY_SHARE * size, LEAST_STEADY) and size > LEAST_MOTION:
        return _unusable(r, "no gravity in ax, ay, az; is it linear acceleration? It has to be with gravity")
    size = steady if size > PLAUSIBLE_FORCE[1] else size  # of vibration the mean is gravity
    if not _within(size, PLAUSIBLE_FORCE):
        text = f"typically {size:.2g} m/s^2, where gravity alone gives 9.8; are ax, ay, az in m/s^2?"
        return _unusable(r, text)
    rate = _usual(_some(imu, imu.gyro)[0]) * imu.gyro_scale
    if rate > LARGEST_RATE:
        return _unusable(r, f"typically {rate:.0f} rad/s, which no kart turns; are gx, gy, gz in rad/s?")
    return None


def few(r: Recording) -> Finding | None:
    """So few samples that they say nothing of the motion."""
    count = len(r.samples.t)
    return None if count >= FEWEST_IMU_SAMPLES else _unusable(r, f"only {counted(count, 'usable sample')}")


def absurd(r: Recording) -> Finding | None:
    """Values beyond any sensor."""
    force, rate = ABSURD_FORCE / r.samples.accel_scale, ABSURD_RATE / r.samples.gyro_scale
    bad = _rows_where(r.samples, lambda f, w: np.any(np.abs(f) > force, axis=1) | np.any(np.abs(w) > rate, axis=1))
    return dropped(bad, "with accelerations or rates no sensor can read")


def dead(r: Recording) -> Finding | None:
    """Axes that never change while others do. If none does, the smoother sees that none can be used."""
    axes = dead_axes(r.samples)
    if not 0 < len(axes) < 2 * 3:
        return None
    named = ", ".join(f"{axis} of the {sensor}" for sensor, axis in axes)
    return Finding(f"{named} never changes; attitude and what depends on it are wrong: check sensor and wiring")


def _unusable(r: Recording, reason: str) -> Finding:
    return Finding(f"{reason}: smoothed from GPS alone", drop=np.ones(len(r.samples.t), dtype=np.bool_))


def _rows_where(imu: RawImu, is_bad: Callable[[Array, Array], BoolArray]) -> BoolArray:
    """Mask (N,) of the samples of which is_bad, of forces and rates (K, 3), says so."""
    bad = np.empty(len(imu.t), dtype=np.bool_)
    for part in pieces(len(imu.t)):
        bad[part] = is_bad(imu.accel[part], imu.gyro[part])
        release(imu)
    return bad


def _some(imu: RawImu, values: Array) -> tuple[Array, float]:
    """Samples (M, 3) that a sensor can have read, evenly taken, and how long the recording lasts, s."""
    some = thinned(values, max(1, len(values) // ENOUGH_SAMPLES))
    return some[np.all(np.abs(some) < LARGEST, axis=1)], float(imu.t[-1] - imu.t[0])


def _usual(some: Array) -> float:
    return median(np.linalg.norm(some, axis=1)) if len(some) else 0.0


def _steady(some: Array, lasts: float) -> float:
    """Size of what stays of forces (M, 3) through `lasts` s, part by part: a box is turned over in one of them."""
    parts = np.array_split(some, int(np.clip(lasts / STEADY_TIME, 1, STEADY_PARTS))) if len(some) else []
    return median(np.array([np.linalg.norm(np.mean(part, axis=0)) for part in parts if len(part)])) if parts else 0.0


def _within(value: float, bounds: tuple[float, float]) -> bool:
    return bounds[0] < value < bounds[1]


USABLE = (
    Check("imu_missing", "imu", (), few),
    Check("imu_counts", "imu", (), counts),
    Check("imu_accel_unit", "imu", (), force_unit),
    Check("imu_gyro_unit", "imu", (), rate_unit),
    Check("imu_too_slow", "imu", (), too_slow),
    Check("imu_implausible", "imu", (), implausible),
)
IMU_CHECKS = (
    Check("imu_missing", "imu", (), few),
    Check("imu_absurd", "imu", (), absurd),
    Check(DEAD_AXES, "imu", (), dead),
    Check("imu_missing", "imu", (), few),
)
