"""Units of the motion sensor, as its motion beside that of the fixes shows them.

A gyroscope in another unit turns with the course all the same, only so many times as fast, and an accelerometer with
another range feels so many times gravity. What is off by a known unit is converted; what is off by any other factor is
left out, since nobody knows what else is wrong with it. Strong vibration that is clipped makes gravity seem another,
too; that is said as what it is, and such samples stay.
"""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array
from smoother.estimate.averages import averages_of
from smoother.estimate.fixes.screen import says_velocity
from smoother.estimate.initial.align import Alignment, align
from smoother.estimate.path_motion import PathMotion
from smoother.samples import VIBRATION, GnssFixes, ImuSamples, Problem, RawImu, RawSession
from smoother.units import DEG, STANDARD_GRAVITY

ENOUGH = 1 << 20  # samples from the beginning, an hour and a half at 200 Hz
SOME = 100_000  # samples, evenly taken, that tell how much the box is shaken
FEW = 10_000  # likewise, that tell by how much axes scatter
LIKELY_TURN = (0.5, 2.0)  # of the course; boxes of karts and cars have 0.85 to 1.02
LIKELY_FORCE = (0.75, 1.4)  # of gravity; likewise 0.95 to 1.07
SHAKEN = 30.0  # m/s^2 rms of what changes from sample to sample; engines and tracks make 1 to 26 of it
BENT_FORCE = (0.6, 1.7)  # of gravity, what clipped vibration leaves of it; twice or half of it is another range
AT_THE_END = 0.01  # share of the samples at the largest value of an axis, beyond which it is the end of the range
SAME_UNIT = 0.2  # share; the nearest two of them are many times apart
# share by which a single axis may be off beside the others once it is in their unit
SAME_AXIS_UNIT = 0.3
LASTING, NO_KART = 0.5, 0.5  # s, and rad/s that a level axis turns by over them; karts lean by 0.02 to 0.1
ALIKE = 4.0  # times, by which axes of one gyroscope scatter differently at the most; degrees and radians do by 57
TURN_UNITS = {  # how many times too fast
    "with deg/s where rad/s belong": 1.0 / DEG,
    "with rad/s where deg/s belong": DEG,
    "with thousandths of a rad/s": 1e3,
}


def in_known_units(raw: RawSession) -> RawSession:
    """Return the session with a gyroscope in rad/s, or without a motion sensor that is off by another factor, and say
    so in its problems; as it is where the motion does not tell."""
    if raw.imu is None:
        return raw
    raw, found = _in_one_unit(raw, raw.imu, aligned(raw.imu, raw.gnss))
    assert raw.imu is not None
    shaken = _shaken(raw.imu)
    if not shaken:
        return _judged(raw, raw.imu, found, LIKELY_FORCE)
    return _judged(replace(raw, problems=(*raw.problems, *shaken)), raw.imu, found, BENT_FORCE)


def _in_one_unit(raw: RawSession, imu: RawImu, found: Alignment | None) -> tuple[RawSession, Alignment | None]:
    """The session, and how its box lies, with all axes of a sensor in the unit of one, where only then the motion fits.

    Of the accelerometer the motion tells the size of each axis by itself. Of the gyroscope it tells that of what is up;
    axes in two units scatter by as many times more than one another.
    """
    for name, tried in (("a", _force_scales(found)), ("g", _rate_scales(imu))):
        for scales in tried:
            one = _rescaled(imu, name, scales)
            again = aligned(one, raw.gnss)
            if again is None or again.problems or not _is_rotation(again.felt):
                continue
            if not LIKELY_TURN[0] < again.turn_scale < LIKELY_TURN[1]:
                continue
            changed = " and ".join(name + axis for axis, scale in zip("xyz", scales, strict=True) if scale != 1.0)
            times = next(scale for scale in scales if scale != 1.0)
            unit = "g where m/s^2 belong" if name == "a" else "degrees and others in radians"
            text = f"only with {changed} times {times:.3g} the sensor fits the motion, as where some axes are in {unit}"
            problem = Problem("imu_axis_unit", f"{text}; taken so")
            return replace(raw, imu=one, problems=(*raw.problems, problem)), again
    return raw, found


def _force_scales(found: Alignment | None) -> list[Array]:
    """What (3,) would bring axes in g to m/s^2, where one or two feel as much less than the others."""
    if found is None or found.felt is None:
        return []
    sizes = np.linalg.norm(found.felt, axis=1)
    is_small = np.abs(sizes * STANDARD_GRAVITY - 1.0) < SAME_AXIS_UNIT
    is_right = np.abs(sizes - 1.0) < SAME_AXIS_UNIT
    if not (is_small.any() and is_right.any() and np.all(is_small | is_right)):
        return []
    return [np.where(is_small, STANDARD_GRAVITY, 1.0)]


def _rate_scales(imu: RawImu) -> list[Array]:
    """What (3,) would bring rates to one unit, where one axis scatters as degrees beside radians do.

    So do the level axes of a box that rocks on rubber. But it comes to rest within a rocking or two: what turns on and
    on by as many radians a second is no kart.
    """
    alike = _rates_alike(imu)
    turns_on = _lasting_rate(imu) > NO_KART if alike else np.ones(3, dtype=np.bool_)
    return [scales for scales in alike if np.all(turns_on[scales < 1.0])]


def _lasting_rate(imu: RawImu) -> Array:
    """Scatter (3,) of the rates over LASTING, as the file's unit says, about what is usual."""
    some = beginning(imu)
    if len(some.t) < 2:
        return np.zeros(3)
    _, rate = averages_of(some).around(np.arange(some.t[0], some.t[-1], LASTING), LASTING)
    return np.asarray(np.sqrt(np.mean((rate - np.median(rate, axis=0)) ** 2, axis=0)))


def _rates_alike(imu: RawImu) -> list[Array]:
    """What (3,) would bring the scatter from sample to sample of all axes to one size."""
    rows = np.arange(0, len(imu.t) - 1, max(1, len(imu.t) // FEW))
    if not len(rows):
        return []
    change = (imu.gyro[rows + 1].astype(np.float64) - imu.gyro[rows]) ** 2
    scatter = np.sqrt(np.mean(change, axis=0))
    for odd in range(3):
        others = np.delete(scatter, odd)
        if others.min() <= 0.0 or others.max() > ALIKE * others.min() or scatter[odd] <= 0.0:
            continue
        times = float(scatter[odd] / np.sqrt(others[0] * others[1]))
        for unit in (1.0 / DEG, DEG):
            if 1.0 / ALIKE < times / unit < ALIKE:
                alone = np.where(np.arange(3) == odd, 1.0 / unit, 1.0)
                return [alone, np.where(np.arange(3) == odd, 1.0, unit)]
    return []


def _rescaled(imu: RawImu, name: str, scales: Array) -> RawImu:
    """The samples with the axes of accelerometer or gyroscope multiplied by scales (3,)."""
    if name == "a":
        return replace(imu, accel=imu.accel * scales, accel_full_scale=None)
    return replace(imu, gyro=imu.gyro * scales, gyro_full_scale=None)


def _is_rotation(felt: Array | None) -> bool:
    return felt is not None and bool(np.all(np.abs(np.linalg.norm(felt, axis=1) - 1.0) < SAME_AXIS_UNIT))


def _judged(raw: RawSession, imu: RawImu, found: Alignment | None, likely_force: tuple[float, float]) -> RawSession:
    """The session with units that are known, or without the sensor; likely_force: what it feels of gravity."""
    if found is None:
        return raw
    force, turn = found.force_scale, found.turn_scale
    if force < likely_force[0] or force > likely_force[1]:
        return _without_imu(raw, f"the box feels {force:.3g} times gravity; are ax, ay, az in m/s^2?")
    if not (turn < LIKELY_TURN[0] or turn > LIKELY_TURN[1]):  # NaN: nothing tells
        return raw
    text = f"the box turns {turn:.3g} times as fast as the course of the fixes"
    unit = next((name for name, size in TURN_UNITS.items() if abs(turn / size - 1.0) < SAME_UNIT), None)
    if unit is None:
        return _without_imu(raw, f"{text}; are gx, gy, gz in rad/s?")
    slower = _turning_slower(imu, TURN_UNITS[unit])
    return replace(raw, imu=slower, problems=(*raw.problems, Problem("imu_gyro_unit", f"{text}, as {unit}; taken so")))


def _shaken(imu: RawImu) -> tuple[Problem, ...]:
    """Say so where the box is shaken by more than a road and a damped engine do, and what of it is clipped."""
    step = max(1, len(imu.t) // SOME)
    rows = np.arange(0, len(imu.t) - 1, step)
    some, later = imu.accel[rows] * imu.accel_scale, imu.accel[rows + 1] * imu.accel_scale
    size = float(np.sqrt(0.5 * np.mean(np.sum((later - some) ** 2, axis=1)))) if len(rows) else 0.0
    if not size > SHAKEN:
        return ()
    at_end = np.mean((some == some.max(axis=0)) | (some == some.min(axis=0)), axis=0)
    clipped = float(np.max(at_end[np.ptp(some, axis=0) > 0.0]))
    is_clipped = clipped > AT_THE_END
    what = f", {100 * clipped:.0f} % of an axis at the end of the range" if is_clipped else ""
    wider = ", or set a wider range of the accelerometer" if is_clipped else ""
    text = f"vibration shakes the box by {size:.0f} m/s^2 rms{what}: attitude, delays and line are poorer. Damp the box"
    return (Problem(VIBRATION, f"{text}{wider}"),)


def aligned(imu: RawImu, fixes: GnssFixes) -> Alignment | None:
    """Return how the box lies in the kart by the first ENOUGH samples, None without velocities."""
    driven = says_velocity(fixes.velocity_n)
    if len(imu.t) < 2 or not driven.any():
        return None
    return align(beginning(imu), PathMotion(fixes.t[driven], fixes.velocity_n[driven]))


def beginning(imu: RawImu, most: int = ENOUGH) -> ImuSamples:
    """Return the first samples, `most` of them, as if calibrated."""
    return ImuSamples(imu.t[:most], imu.accel[:most] * imu.accel_scale, imu.gyro[:most] * imu.gyro_scale)


def _turning_slower(imu: RawImu, times: float) -> RawImu:
    full_scale = None if imu.gyro_full_scale is None else imu.gyro_full_scale / times
    return replace(imu, gyro_scale=imu.gyro_scale / times, gyro_full_scale=full_scale)


def _without_imu(raw: RawSession, reason: str) -> RawSession:
    problem = Problem("imu_implausible", f"{reason}: smoothed from GPS alone")
    return replace(raw, imu=None, problems=(*raw.problems, problem))
