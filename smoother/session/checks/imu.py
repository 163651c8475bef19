"""Checks of inertial samples: units, values that no sensor measures, spikes, sensors that stand still, dead axes."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.disc import pieces, release, thinned
from smoother.frames import Origin
from smoother.samples import DEAD_AXES, STUCK_AXES, RawImu
from smoother.session.checks.counts import counts
from smoother.session.checks.spans import Span, constant_runs, mask_of, where
from smoother.session.checks.spikes import spikes
from smoother.session.checks.table import Check, Finding, dropped
from smoother.session.inertial import FEWEST_IMU_SAMPLES, dead_axes
from smoother.session.recorded import Recording
from smoother.units import DEG, STANDARD_GRAVITY
from smoother.words import counted, listed

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
FEW_SILENT = 0.2  # share of samples that may be nothing but zeros, of a sensor that at times does not answer
FROZEN, SENSOR_FROZEN = 1.0, 0.3  # s for which none of six noisy values changes, of three
HELD_TIMES = 10  # runs of a frozen sensor are as many times longer than nearly all that it makes otherwise
NEARLY_ALL = 99.0  # per cent
FEWEST_FROZEN = 10  # samples, however slowly they come
GOING_ON = 0.1  # share of the other sensor's samples that are unlike the one before
DRIVEN, AROUND = 5.0, 1.0  # m/s, within so many s of what is frozen
LEVEL_TIMES = 3  # runs at one value, from which on it is a level of the sensor
NEAR, FEW_NEAR = (
    0.5,
    0.01,
)  # of the way to what stands beside a level, and share of samples that are nearer
RESTING = 0.5 * STANDARD_GRAVITY  # m/s^2; less force than that is no level of an accelerometer
CLIPPED = 0.5  # of the largest value of an axis; an end of its range is farther out
UNIFORM_FORCE, UNIFORM_RATE = 0.1, 2e-3  # m/s^2 from gravity, rad/s: nothing happens that a sensor could have missed
STUCK_TIME, STUCK_WAY = 10.0, 50.0  # s and m for which one noisy value does not change, however coarse its steps
STUCK_SPEED = 1.0  # m/s; slower, it is the noise of a kart at rest
SENSORS = {"accel": "accelerometer", "gyro": "gyroscope"}


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


def silent(r: Recording) -> Finding | None:
    """Samples of nothing but zeros."""
    bad = _rows_where(r.samples, lambda force, rate: ~(np.any(force != 0.0, axis=1) | np.any(rate != 0.0, axis=1)))
    return dropped(bad, "in which all six values are zero: the sensor did not answer", FEW_SILENT)


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


def frozen(r: Recording) -> Finding | None:
    """Samples that repeat one another while the kart drives."""
    imu = r.samples
    found = [run for run in constant_runs(imu.t, imu.accel, imu.gyro) if _lasts(imu.t, run) > FROZEN]
    found = [run for run in found if not _is_uniform(imu, run[0]) and _speed(r, *run) > DRIVEN]
    if not found or len(imu.t) - sum(last - first for first, last in found) < FEWEST_IMU_SAMPLES:
        return None
    lost = mask_of(found, len(imu.t))
    count = int(np.count_nonzero(lost))
    text = f"{counted(count, 'sample')} like the one before while the fixes move on; left out, as not measured"
    return Finding(text, count, drop=lost)


def sensor_frozen(name: str, r: Recording) -> Finding | None:
    """Samples in which one sensor stands still while the other goes on and the kart drives.

    It stands at whatever it last measured. A coarse sensor, one that is read out more often than it measures, and one
    with a level it comes back to, as the 0 of a dead band, repeat themselves as well.
    """
    imu, values = r.samples, getattr(r.samples, name)
    others = imu.gyro if name == "accel" else imu.accel
    if len([axis for sensor, axis in dead_axes(imu) if sensor == SENSORS[name]]) == 3:
        return None
    least = RESTING / imu.accel_scale if name == "accel" else 0.0
    runs = constant_runs(imu.t, values)
    sizes = np.array([last - first for first, last in runs], dtype=np.int64)
    single = len(imu.t) - int(np.sum(sizes)) - sizes.size
    usual = float(np.percentile(np.concatenate([sizes, np.zeros(single, dtype=np.int64)]), NEARLY_ALL, method="lower"))
    fewest = max(FEWEST_FROZEN, HELD_TIMES * usual)
    long = [run for run in runs if run[1] - run[0] >= fewest and _lasts(imu.t, run) > SENSOR_FROZEN]
    found = [
        (first, last)
        for first, last in long
        if np.mean(np.any(np.diff(others[first : last + 1], axis=0) != 0.0, axis=1)) > GOING_ON
        and _speed(r, first, last) > DRIVEN
        and not _is_clipped(values, first)
        and not (np.linalg.norm(values[first]) >= least and is_level(values, runs, (first, last)))
    ]
    if not found:
        return None
    lost = mask_of(found, len(imu.t))
    text = f"the {SENSORS[name]} stands still {where(imu.t, found)} of the drive; those samples are left out"
    return Finding(text, int(np.count_nonzero(lost)), drop=lost)


def stuck(r: Recording) -> Finding | None:
    """Axes that stop, or start late, while others go on; a cable that came off, or a failing chip."""
    imu, none = r.samples, dead_axes(r.samples)
    texts = []
    for name, sensor in SENSORS.items():
        for axis, letter in enumerate("xyz"):
            if (sensor, letter) in none:
                continue
            values = getattr(imu, name)[:, axis : axis + 1]
            runs = constant_runs(imu.t, values)
            run = max(runs, key=lambda run: run[1] - run[0], default=(0, 0))
            if _lasts(imu.t, run) >= STUCK_TIME and _moves(r, *run) and not is_level(values, runs, run):
                begin, end = imu.t[run[0]], imu.t[run[1]]
                texts.append(f"{letter} of the {sensor} does not change from {begin:.0f} to {end:.0f} s")
    if not texts:
        return None
    text = f"{listed(texts, longest=99)}; attitude and what depends on it are wrong: check sensor and wiring"
    return Finding(text, len(texts))


def is_level(values: Array, runs: Sequence[Span], run: Span) -> bool:
    """Whether values (N, M) stand in a run, one of `runs`, at a level of the sensor: several times, as long, coming
    from the value next to it. A sensor that freezes keeps any value; one that fails and writes 0 jumps to it."""
    level, long = values[run[0]], 0.25 * (run[1] - run[0])
    alike = [(i, k) for i, k in runs if k - i >= max(FEWEST_FROZEN, long) and np.all(values[i] == level)]
    if len(alike) < LEVEL_TIMES:
        return False
    beside = [row for i, k in alike for row in (i - 1, k + 1) if 0 <= row < len(values)]
    if not beside:
        return False
    near = NEAR * median(np.linalg.norm(values[beside] - level, axis=1))
    nearer = others = 0
    for part in pieces(len(values)):
        off = np.linalg.norm(values[part] - level, axis=1)
        nearer += int(np.count_nonzero((off > 0.0) & (off < near)))
        others += int(np.count_nonzero(off > 0.0))
        release(values)
    return nearer <= FEW_NEAR * others


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


def _lasts(t: Array, run: Span) -> float:
    return float(t[run[1]] - t[run[0]])


def _is_uniform(imu: RawImu, row: int) -> bool:
    """Whether nothing happens in a sample, as of a kart that stands or rolls straight on."""
    force, rate = np.linalg.norm(imu.accel[row]) * imu.accel_scale, np.linalg.norm(imu.gyro[row]) * imu.gyro_scale
    return bool(abs(force - STANDARD_GRAVITY) < UNIFORM_FORCE and rate < UNIFORM_RATE)


def _is_clipped(values: Array, row: int) -> bool:
    """Whether all axes of a sample of (N, 3) stand at the ends of their ranges, the outermost values they have."""
    value, least, most = values[row], values.min(axis=0), values.max(axis=0)
    outermost = (value == least) | (value == most)
    return bool(np.all(outermost & (np.abs(value) > CLIPPED * np.maximum(np.abs(least), np.abs(most)))))


def _speed(r: Recording, first: int, last: int) -> float:
    """Mean speed, m/s, around samples, by the fixes: as sent, else by the positions; 0 where fixes are missing."""
    gnss, t = r.gnss, r.samples.t
    around = gnss.select((gnss.t >= t[first] - AROUND) & (gnss.t <= t[last] + AROUND))
    if len(around) < 2:
        return 0.0
    known = np.hypot(around.velocity_n[:, 0], around.velocity_n[:, 1])
    if np.isfinite(known).any():
        return float(np.nanmean(known))
    position = around.position_n(Origin(float(around.lat_deg[0]), float(around.lon_deg[0]), 0.0))
    return float(np.hypot(*(position[-1, :2] - position[0, :2])) / (around.t[-1] - around.t[0]))


def _moves(r: Recording, first: int, last: int) -> bool:
    """Whether the kart goes STUCK_WAY meanwhile, by the positions of fixes and by their speeds, where sent.

    After a cold start, or beside a wall, the fixes of a kart at rest wander as far.
    """
    gnss, t = r.gnss, r.samples.t
    inside = gnss.select((gnss.t >= t[first]) & (gnss.t <= t[last]))
    if len(inside) == 0:
        return False
    position = inside.position_n(Origin(float(inside.lat_deg[0]), float(inside.lon_deg[0]), 0.0))[:, :2]
    if np.max(np.ptp(position, axis=0)) < STUCK_WAY:
        return False
    velocity_n = inside.velocity_n
    speed = np.asarray(inside.speed)
    speed = np.where(np.isfinite(speed), speed, np.hypot(velocity_n[:, 0], velocity_n[:, 1]))
    known = speed[np.isfinite(speed)]
    driven = np.where(known > STUCK_SPEED, known, 0.0)
    return known.size < 0.5 * speed.size or bool(np.mean(driven) * (t[last] - t[first]) >= STUCK_WAY)


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
    Check("imu_silent", "imu", (), silent),
    Check("imu_absurd", "imu", (), absurd),
    Check("imu_spikes", "imu", (), spikes),
    Check(DEAD_AXES, "imu", (), dead),
    Check("imu_frozen", "imu", (), frozen),
    Check("imu_sensor_frozen", "imu", (), partial(sensor_frozen, "accel")),
    Check("imu_sensor_frozen", "imu", (), partial(sensor_frozen, "gyro")),
    Check("imu_missing", "imu", (), few),
    Check(STUCK_AXES, "imu", (), stuck),
)
