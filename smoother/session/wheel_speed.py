"""Whether a recorded wheel speed can be used: it needs inertial samples, and has to be the speed of this vehicle."""

import numpy as np

from smoother.arrays import Array, median
from smoother.frames import Origin
from smoother.samples import GnssFixes, Problem, WheelSpeed

FILE = "wheel_speed.csv"
DRIVING = 3.0  # m/s by the fixes, from which on the two are compared
FEWEST = 20  # fixes at speed
LEAST_RATIO, LARGEST_RATIO = 0.7, 1.4  # of the wheel's speed over that of the fixes; km/h have 3.6, mph 2.2


def usable_wheel_speed(
    wheel: WheelSpeed | None, gnss: GnssFixes, *, has_imu: bool, problems: list[Problem]
) -> WheelSpeed | None:
    """Return the wheel speed; None, with the reason in `problems`, if it is of no use."""
    if wheel is None:
        return None
    if len(wheel.t) == 0:
        problems.append(Problem("wheel_speed_empty", f"{FILE}: no usable row; smoothed without wheel speed"))
        return None
    if not has_imu:
        text = f"{FILE}: not used; a wheel speed needs inertial samples beside it"
        problems.append(Problem("wheel_speed_unused", text))
        return None
    ratio = _ratio(wheel, gnss)
    if ratio is not None and not LEAST_RATIO <= ratio <= LARGEST_RATIO:
        text = f"{FILE}: the wheel is {ratio:.2f} times as fast as the fixes; not used. Is speed_mps in m/s?"
        problems.append(Problem("wheel_speed_unlike", text))
        return None
    return wheel


def _ratio(wheel: WheelSpeed, gnss: GnssFixes) -> float | None:
    """Median ratio of the speeds of wheel and fixes while driving; None where too few fixes show it."""
    speed = _speed(gnss)
    with np.errstate(invalid="ignore"):
        driving = (speed > DRIVING) & (gnss.t > wheel.t[0]) & (gnss.t < wheel.t[-1])
    if np.count_nonzero(driving) < FEWEST:
        return None
    return median(np.interp(gnss.t[driving], wheel.t, wheel.speed) / speed[driving])


def _speed(gnss: GnssFixes) -> Array:
    """Speed (N,) m/s of the fixes: as measured, else by their distances."""
    measured = np.hypot(gnss.velocity_n[:, 0], gnss.velocity_n[:, 1])
    if np.isfinite(measured).any():
        return np.asarray(measured)
    position_n = gnss.position_n(Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0))
    return np.asarray(np.hypot(*(np.gradient(position_n[:, i], gnss.t) for i in (0, 1)))) if len(gnss) > 1 else measured
