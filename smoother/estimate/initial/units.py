"""Units of the motion sensor, by the gains of force and rate against the path of the fixes.

A gyroscope in another unit turns with the course, only so many times as fast; an accelerometer with another range
reads so many times gravity. A known unit of the gyroscope is converted. With any other factor the sensor is not used.
"""

from dataclasses import replace

from smoother.estimate.fixes.screen import has_velocities
from smoother.estimate.initial.align import Alignment, align
from smoother.estimate.preprocess.path_motion import PathMotion
from smoother.samples import GnssFixes, ImuSamples, Problem, RawImu, RawSession
from smoother.units import DEG

ENOUGH = 1 << 20  # samples from the beginning, an hour and a half at 200 Hz
LIKELY_TURN = (0.5, 2.0)  # of the course; boxes of karts and cars have 0.85 to 1.02
LIKELY_FORCE = (0.75, 1.4)  # of gravity; likewise 0.95 to 1.07
SAME_UNIT = 0.2  # share; the nearest two units are many times apart
TURN_UNITS = {  # how many times too fast
    "with deg/s where rad/s belong": 1.0 / DEG,
    "with rad/s where deg/s belong": DEG,
    "with thousandths of a rad/s": 1e3,
}


def in_known_units(raw: RawSession) -> RawSession:
    """Return the session with a gyroscope in rad/s, or without a motion sensor that is off by another factor.

    Its problems report either. Where the path does not explain force and rate, the session is as it was.
    """
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
    """Return how the box lies in the kart by the first ENOUGH samples, None without velocities."""
    driven = has_velocities(fixes.velocity_n)
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
