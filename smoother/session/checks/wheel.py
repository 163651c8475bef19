"""Checks of a recorded wheel speed: it needs inertial samples, and has to be the speed of this vehicle."""

import numpy as np

from smoother.arrays import Array, median
from smoother.frames import Origin
from smoother.samples import GnssFixes
from smoother.session.checks.table import Check, Finding
from smoother.session.recorded import Recording

DRIVING = 3.0  # m/s by the fixes, from which on the two are compared
FEWEST = 20  # fixes at speed
LEAST_RATIO, LARGEST_RATIO = 0.7, 1.4  # of the wheel's speed over that of the fixes; km/h have 3.6, mph 2.2


def empty(r: Recording) -> Finding | None:
    """A wheel speed of which no row was usable."""
    assert r.wheel_speed is not None
    return None if len(r.wheel_speed.t) else _unused(r, "no usable row; smoothed without wheel speed")


def alone(r: Recording) -> Finding | None:
    """A wheel speed without samples beside it."""
    text = "not used; a wheel speed needs inertial samples beside it"
    return _unused(r, text) if r.imu is None else None


def unlike(r: Recording) -> Finding | None:
    """A wheel speed that is in another unit, or of another vehicle."""
    wheel, gnss, speed = r.wheel_speed, r.gnss, _speed(r.gnss)
    assert wheel is not None
    with np.errstate(invalid="ignore"):
        driving = (speed > DRIVING) & (gnss.t > wheel.t[0]) & (gnss.t < wheel.t[-1])
    if np.count_nonzero(driving) < FEWEST:
        return None
    ratio = median(np.interp(gnss.t[driving], wheel.t, wheel.speed) / speed[driving])
    if LEAST_RATIO <= ratio <= LARGEST_RATIO:
        return None
    return _unused(r, f"the wheel is {ratio:.2f} times as fast as the fixes; not used. Is speed_mps in m/s?")


def _unused(r: Recording, text: str) -> Finding:
    assert r.wheel_speed is not None
    return Finding(text, drop=np.ones(len(r.wheel_speed.t), dtype=np.bool_))


def _speed(gnss: GnssFixes) -> Array:
    """Speed (N,) m/s of the fixes: as measured, else by their distances."""
    measured = np.hypot(gnss.velocity_n[:, 0], gnss.velocity_n[:, 1])
    if np.isfinite(measured).any() or len(gnss) < 2:
        return np.asarray(measured)
    position_n = gnss.position_n(Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0))
    return np.asarray(np.hypot(*(np.gradient(position_n[:, i], gnss.t) for i in (0, 1))))


WHEEL_CHECKS = (
    Check("wheel_speed_empty", "wheel_speed", (), empty),
    Check("wheel_speed_unused", "wheel_speed", (), alone),
    Check("wheel_speed_unlike", "wheel_speed", (), unlike),
)
