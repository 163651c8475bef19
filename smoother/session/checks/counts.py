"""Raw counts of a motion sensor in place of SI: the accelerometer's range by gravity, the gyroscope's by the path.

Sensors of the MPU family, and others of 16 bits, have ranges a factor of two apart, of which gravity in the mean, and
how fast the path turns, tell which.
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import thinned
from smoother.samples import GnssFixes, RawImu
from smoother.session.checks.table import Finding
from smoother.session.recorded import Recording
from smoother.units import DEG, STANDARD_GRAVITY

PER_G = np.array([2048.0, 4096.0, 8192.0, 16384.0])  # counts at 16, 8, 4 and 2 g
PER_DEG_S = np.array([16.4, 32.8, 65.6, 131.2])  # counts at 2000, 1000, 500 and 250 deg/s
FULL_SCALE = 32768.0
ENOUGH_ROWS = 20_000
AS_MUCH = 1.35  # times gravity in the mean, up or down: halfway to the next range
WINDOW = 0.5  # s, over which turning is compared; a fix is late by less
LEAST_SPEED = 4.0  # m/s; slower, the path says little of turning
FEWEST_WINDOWS = 20


def counts(r: Recording) -> Finding | None:
    """Whole numbers of 16 bits whose mean size is gravity at one of the ranges of such sensors."""
    size = _size_of_counts(r.samples)
    if size is None:
        return None
    per_g = float(PER_G[np.argmin(np.abs(np.log(size / PER_G)))])
    text = f"raw counts, by gravity of an accelerometer at {FULL_SCALE / per_g:.0f} g"
    gain = _gain(r.samples, r.gnss)
    if gain is None:
        per_deg_s = PER_DEG_S[0]
        text += "; the path does not show the gyroscope's range, taken as 2000 deg/s"
    else:
        per_deg_s = float(PER_DEG_S[np.argmin(np.abs(np.log(gain * PER_DEG_S / DEG)))])
        of_gyro = 2000.0 * PER_DEG_S[0] / per_deg_s
        text += f", and by how the path turns of a gyroscope at {of_gyro:.0f} deg/s; taken so"
    return Finding(text, scale={"accel_scale": STANDARD_GRAVITY / per_g, "gyro_scale": DEG / per_deg_s})


def _size_of_counts(imu: RawImu) -> float | None:
    """The usual size of forces that are counts; None of any other values, and of counts whose scale the file says."""
    if imu.accel_scale != 1.0 or imu.gyro_scale != 1.0:
        return None
    step = max(1, len(imu.t) // ENOUGH_ROWS)
    some = np.hstack([np.asarray(thinned(imu.accel, step)), np.asarray(thinned(imu.gyro, step))])
    if np.any(some != np.round(some)) or np.max(np.abs(some)) > FULL_SCALE:
        return None
    size = float(np.median(np.linalg.norm(some[:, :3], axis=1)))
    return size if PER_G[0] / AS_MUCH < size < PER_G[-1] * AS_MUCH else None


def _gain(imu: RawImu, gnss: GnssFixes) -> float | None:
    """How many rad/s of the path one count is; None where too little turning tells."""
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
