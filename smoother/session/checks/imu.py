"""Checks of inertial samples: units, values that no sensor measures, dead axes."""

from collections.abc import Callable

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.disc import pieces, release, thinned
from smoother.samples import DEAD_AXES, SENSOR_AXES, GnssFixes, Problem, RawImu
from smoother.session.checks.table import Check, Finding, dropped
from smoother.session.fix_columns import METRES_PER_DEGREE
from smoother.session.recorded import Recording
from smoother.session.rows import in_time_order, taken
from smoother.units import DEG, STANDARD_GRAVITY
from smoother.words import counted

FEWEST_IMU_SAMPLES = 100  # fewer show nothing of the motion
PER_G = np.array([2048.0, 4096.0, 8192.0, 16384.0])  # counts at 16, 8, 4 and 2 g
PER_DEG_S = np.array([16.4, 32.8, 65.6, 131.2])  # counts at 2000, 1000, 500 and 250 deg/s
FULL_SCALE = 32768.0
ENOUGH_ROWS = 20_000
AS_MUCH = 1.35  # times gravity in the mean, up or down: halfway to the next range
WINDOW = 0.5  # s, over which turning is compared; a fix is late by less
LEAST_SPEED = 4.0  # m/s; slower, the path says little of turning
FEWEST_WINDOWS = 20


def screen_imu(file: str, t: Array, accel: Array, gyro: Array) -> tuple[RawImu, list[Problem]]:
    """Return the usable samples in time order (maybe none) and what was wrong with the others.

    t (N,) s; accel (N, 3) m/s^2 and gyro (N, 3) rad/s, axes s, which the caller gives away.
    """
    unreadable = np.empty(t.size, dtype=np.bool_)
    for part in pieces(t.size):
        unreadable[part] = ~np.isfinite(t[part])
        for axis in range(SENSOR_AXES):
            unreadable[part] |= ~np.isfinite(accel[part, axis]) | ~np.isfinite(gyro[part, axis])
        release(t, accel, gyro)
    problems = []
    if count := int(np.count_nonzero(unreadable)):
        t, accel, gyro = t[~unreadable], accel[~unreadable], gyro[~unreadable]
        text = f"{file}: {counted(count, 'row')} with an empty or unreadable value; dropped"
        problems.append(Problem("imu_invalid", text, count))
    ordered = in_time_order(t, accel, gyro, file=file, prefix="imu")
    imu = RawImu(ordered.t, taken(accel, ordered.index), taken(gyro, ordered.index))
    return imu, [*problems, *ordered.problems]


def dead_axes(imu: RawImu) -> list[tuple[str, str]]:
    """Sensor and letter of each axis that reads one and the same value throughout, which noise keeps live ones from."""
    return [
        (sensor, "xyz"[axis])
        for sensor, values in (("accelerometer", imu.accel), ("gyroscope", imu.gyro))
        for axis in _constant(values)
    ]


def _constant(values: Array) -> list[int]:
    """Columns of (N, 3) samples that never change; of live ones no more than the first part is looked at."""
    same = list(range(values.shape[1])) if len(values) > 1 else []
    for part in pieces(len(values)):
        same = [axis for axis in same if np.all(values[part, axis] == values[0, axis])]
        release(values)
        if not same:
            break
    return same


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
    """How many rad/s of the path one count is; None where the path turns too little."""
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
    measured, driven = float(np.percentile(size, 90.0)), float(np.percentile(path, 90.0))
    return driven / measured if measured > 0.0 and driven > 0.0 else None


def _turning(gnss: GnssFixes, edges: Array) -> tuple[Array, BoolArray]:
    """How fast the path turns (K,) rad/s between the edges (K + 1,) s, and where that is known."""
    north, east = gnss.lat_deg, gnss.lon_deg * np.cos(gnss.lat_deg[0] * DEG)
    at = [np.interp(edges, gnss.t, values) for values in (north, east)]
    step_n, step_e = (np.diff(values) for values in at)
    heading = np.unwrap(np.arctan2(step_e, step_n))
    way = np.hypot(step_n, step_e) * METRES_PER_DEGREE
    turned = np.gradient(heading, WINDOW)
    return turned, way > LEAST_SPEED * WINDOW


FROZEN, FEWEST_FROZEN = 1.0, 10  # s, and samples, for which three noisy values do not stay the same
LEAST_BEND, MOST_FROZEN = 1.0, 0.5  # m in a second, of a path whose motion changes; share of all samples
DRIVEN, LASTS = 2.0, 10.0  # m/s, for so many s: a kart that drives
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


def frozen(r: Recording) -> Finding | None:
    """Samples of an accelerometer or a gyroscope that repeats itself while the motion of the kart changes.

    One that repeats itself most of the time is no sensor that stalls; see :func:`dead`.
    """
    bad = np.zeros(len(r.samples.t), dtype=np.bool_)
    for values in (r.samples.accel, r.samples.gyro):
        stalled = np.zeros_like(bad)
        for first, last in _constant_runs(values):
            begin, end = r.samples.t[[first, last]]
            if end - begin > FROZEN and last - first > FEWEST_FROZEN and _drives_on(r.gnss, begin, end):
                stalled[first + 1 : last + 1] = True
        if np.mean(stalled) < MOST_FROZEN:
            bad |= stalled
    return dropped(bad, "that repeat the one before for a second and longer while the kart drives: the sensor stalled")


def _constant_runs(values: Array) -> Array:
    """First and last rows (M, 2) of the runs in which all three values (N, 3) stay the same."""
    same = np.ones(len(values) - 1, dtype=np.bool_)
    for axis in values.T:
        same &= axis[1:] == axis[:-1]
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(np.int8)))
    return np.asarray(edges.reshape(-1, 2))


def _drives_on(fixes: GnssFixes, begin: float, end: float) -> bool:
    """Whether the fixes move away between two times, s, and turn or change their speed, which samples would show."""
    at = np.linspace(begin, end, max(3, round(end - begin) + 1))
    north, east = (np.interp(at, fixes.t, degrees) for degrees in (fixes.lat_deg, fixes.lon_deg))
    plan = METRES_PER_DEGREE * np.stack([north, east * np.cos(north[0] * DEG)])
    farthest = float(np.max(np.hypot(*(plan - plan[:, :1]))))
    return farthest > DRIVEN * min(end - begin, LASTS) and float(np.max(np.hypot(*np.diff(plan, 2)))) > LEAST_BEND


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
    Check("imu_frozen", "imu", (), frozen),
    Check(DEAD_AXES, "imu", (), dead),
    Check("imu_missing", "imu", (), few),
)
