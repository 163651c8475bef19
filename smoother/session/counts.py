"""Raw counts of a motion sensor in place of SI: the accelerometer's range by gravity, the gyroscope's by the path.

Sensors of the MPU family, and others of 16 bits, have ranges a factor of two apart, of which gravity in the mean, and
how fast the path turns, tell which.
"""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.units import DEG, STANDARD_GRAVITY

CODE = "imu_counts"
PER_G = np.array([2048.0, 4096.0, 8192.0, 16384.0])  # counts at 16, 8, 4 and 2 g
PER_DEG_S = np.array([16.4, 32.8, 65.6, 131.2])  # counts at 2000, 1000, 500 and 250 deg/s
FULL_SCALE = 32768.0
ENOUGH_ROWS = 20_000
AS_MUCH = 1.35  # times gravity in the mean, up or down: halfway to the next range
WINDOW = 0.5  # s, over which turning is compared; a fix is late by less
LEAST_SPEED = 4.0  # m/s; slower, the path says little of turning
FEWEST_WINDOWS = 20


def are_counts(accel: Array, gyro: Array) -> bool:
    """Whether values (N, 3) are counts of 16 bits: whole numbers whose mean size is gravity at one of the ranges."""
    step = max(1, len(accel) // ENOUGH_ROWS)
    some = np.hstack([accel[::step], gyro[::step]])
    some = some[np.isfinite(some).all(axis=1)]
    if not len(some) or np.any(some != np.round(some)) or np.max(np.abs(some)) > FULL_SCALE:
        return False
    return bool(np.median(np.linalg.norm(some[:, :3], axis=1)) > PER_G[0] / AS_MUCH)


def turned_from_counts(accel: Array, gyro: Array, file: str) -> list[Problem]:
    """Bring counts (N, 3) to m/s^2 and, at the widest range, to rad/s in place; say so."""
    size = float(np.nanmedian(np.linalg.norm(accel[:: max(1, len(accel) // ENOUGH_ROWS)], axis=1)))
    per_g = float(PER_G[np.argmin(np.abs(np.log(size / PER_G)))])
    accel *= STANDARD_GRAVITY / per_g
    gyro *= DEG / PER_DEG_S[0]
    range_g = FULL_SCALE / per_g
    return [Problem(CODE, f"{file}: raw counts, by gravity of an accelerometer at {range_g:.0f} g; taken as such")]


def with_range_by_path(imu: RawImu, gnss: GnssFixes, file: str, problems: list[Problem]) -> RawImu:
    """The samples, if they were counts, with turn rates at the range that fits the path; said in `problems`."""
    if all(problem.code != CODE for problem in problems):
        return imu
    gain = _gain(imu, gnss)
    if gain is None:
        problems.append(Problem(CODE, f"{file}: the path does not show the gyroscope's range; taken as 2000 deg/s"))
        return imu
    ratios = PER_DEG_S / PER_DEG_S[0]
    best = int(np.argmin(np.abs(np.log(gain * ratios))))  # a range half as wide has counts of half the rate
    text = f"{file}: by how the path turns its gyroscope's range is {2000.0 / ratios[best]:.0f} deg/s; taken as such"
    problems.append(Problem(CODE, text))
    return replace(imu, gyro=imu.gyro / ratios[best])


def _gain(imu: RawImu, gnss: GnssFixes) -> float | None:
    """By what the turn rates are to be multiplied to be those of the path; None where too little turning tells."""
    begin, end = max(imu.t[0], gnss.t[0]), min(imu.t[-1], gnss.t[-1])
    edges = np.arange(begin, end, WINDOW)
    if edges.size < FEWEST_WINDOWS:
        return None
    turned, good = _turning(gnss, edges)
    place = np.searchsorted(imu.t, edges)
    sums = np.vstack([np.zeros(3), np.cumsum(imu.gyro, axis=0)])
    count = np.maximum(np.diff(place), 1)
    rates = np.diff(sums[place], axis=0) / count[:, None]
    good &= np.diff(place) > 0
    if np.count_nonzero(good) < FEWEST_WINDOWS:
        return None
    size = np.linalg.norm(rates[good] - np.median(rates[good], axis=0), axis=1)
    path = np.abs(turned[good] - np.median(turned[good]))
    felt, said = float(np.percentile(size, 90.0)), float(np.percentile(path, 90.0))
    return said / felt if felt > 0.0 and said > 0.0 else None


def _turning(gnss: GnssFixes, edges: Array) -> tuple[Array, BoolArray]:
    """How fast the path turns (K,) rad/s between the edges (K + 1,) s, and where that is known."""
    north, east = gnss.lat_deg, gnss.lon_deg * np.cos(gnss.lat_deg[0] * DEG)
    at = [np.interp(edges, gnss.t, values) for values in (north, east)]
    step_n, step_e = (np.diff(values) for values in at)
    heading = np.unwrap(np.arctan2(step_e, step_n))
    way = np.hypot(step_n, step_e) * 111_195.0
    turned = np.gradient(heading, WINDOW)
    return turned, way > LEAST_SPEED * WINDOW


__all__ = ["CODE", "are_counts", "turned_from_counts", "with_range_by_path"]
