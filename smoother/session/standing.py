"""Samples, or one axis of them, that never change or stop to while the fixes move on: they were not measured."""

from collections.abc import Iterator

import numpy as np

from smoother.disc import pieces, release
from smoother.frames import Origin
from smoother.samples import DEAD_AXES, SENSOR_AXES, STUCK_AXES, GnssFixes, Problem, RawImu
from smoother.session.frozen import stands_at_level, without_rows
from smoother.session.inertial import FEWEST_IMU_SAMPLES, dead_axes, longest_constant
from smoother.units import STANDARD_GRAVITY
from smoother.words import counted

SENSORS = 2  # of force and of rate
FROZEN = 1.0  # s for which not one of six noisy values changes
FROZEN_WAY = 10.0  # m on which it should have
STUCK_TIME, STUCK_WAY = 10.0, 50.0  # s and m for which one noisy value does not change, however coarse its steps
STUCK_SPEED = 1.0  # m/s; slower, it is the noise of a kart at rest
UNIFORM_FORCE, UNIFORM_RATE = 0.1, 2e-3  # m/s^2 from gravity, rad/s: nothing happens that a sensor could have missed


def dead_problems(imu: RawImu, file: str) -> Iterator[Problem]:
    """What to say of axes that never change while others do. If none does, the smoother sees that none can be used."""
    dead = dead_axes(imu)
    if 0 < len(dead) < SENSORS * SENSOR_AXES:
        axes = ", ".join(f"{axis} of the {sensor}" for sensor, axis in dead)
        text = f"{file}: {axes} never changes; attitude and what depends on it are wrong: check sensor and wiring"
        yield Problem(DEAD_AXES, text)


def stuck_problems(imu: RawImu, gnss: GnssFixes, file: str) -> Iterator[Problem]:
    """What to say of axes that stop, or start late, while others go on; a cable that came off, or a failing chip."""
    dead = dead_axes(imu)
    for sensor, values in (("accelerometer", imu.accel), ("gyroscope", imu.gyro)):
        for axis, letter in enumerate("xyz"):
            first, last = longest_constant(imu.t, values, axis)
            begin, end = float(imu.t[first]), float(imu.t[last])
            if (sensor, letter) in dead or end - begin < STUCK_TIME or not _moves(gnss, begin, end):
                continue
            if stands_at_level(imu.t, values[:, axis : axis + 1], first, last):
                continue
            text = f"{file}: {letter} of the {sensor} does not change from {begin:.0f} to {end:.0f} s"
            yield Problem(STUCK_AXES, f"{text}; attitude and what depends on it are wrong: check sensor and wiring")


def without_frozen(imu: RawImu, gnss: GnssFixes, file: str, problems: list[Problem]) -> RawImu:
    """The samples without those that repeat one another while the fixes move on: a sensor that stands still.

    A box at rest, or at one speed straight ahead, may repeat itself where a simulation has no noise. Samples of which
    none ever changes are left for the smoother, which sees that they have nothing to do with the fixes.
    """
    frozen = np.zeros(imu.t.size, dtype=np.bool_)
    for first, last in _repeating(imu):
        force = float(np.linalg.norm(imu.accel[first])) * imu.accel_scale
        rate = float(np.linalg.norm(imu.gyro[first])) * imu.gyro_scale
        is_uniform = abs(force - STANDARD_GRAVITY) < UNIFORM_FORCE and rate < UNIFORM_RATE
        if not is_uniform and _way(gnss, imu.t[first], imu.t[last]) > FROZEN_WAY:
            frozen[first + 1 : last + 1] = True
    lost = int(np.count_nonzero(frozen))
    if lost == 0 or imu.t.size - lost < FEWEST_IMU_SAMPLES:
        return imu
    text = f"{file}: {counted(lost, 'sample')} like the one before while the fixes move on; left out, as not measured"
    problems.append(Problem("imu_frozen", text, lost))
    return without_rows(imu, frozen)


def _repeating(imu: RawImu) -> Iterator[tuple[int, int]]:
    """First and last sample of each stretch of at least FROZEN s in which none differs from the one before."""
    same = np.zeros(imu.t.size + 1, dtype=np.bool_)  # as the one before; after the last one comes another
    for part in pieces(imu.t.size - 1):
        before, now = slice(part.start, part.stop), slice(part.start + 1, part.stop + 1)
        same[now] = np.all(imu.accel[now] == imu.accel[before], axis=1) & np.all(
            imu.gyro[now] == imu.gyro[before], axis=1
        )
        release(imu)
    edges = np.flatnonzero(np.diff(same))
    for first, last in zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True):
        if imu.t[last] - imu.t[first] > FROZEN:
            yield first, last


def _moves(gnss: GnssFixes, begin: float, end: float) -> bool:
    """Whether the kart goes STUCK_WAY from begin to end s, by the fixes' places and by their speeds, where sent.

    After a cold start, or beside a wall, the fixes of a kart at rest wander as far.
    """
    if _way(gnss, begin, end) < STUCK_WAY:
        return False
    assert gnss.speed is not None
    inside = (gnss.t >= begin) & (gnss.t <= end)
    speed = np.where(np.isfinite(gnss.speed), gnss.speed, np.hypot(gnss.velocity_n[:, 0], gnss.velocity_n[:, 1]))[
        inside
    ]
    known = np.isfinite(speed)
    if np.count_nonzero(known) < 0.5 * known.size:
        return True
    driven = np.where(speed[known] > STUCK_SPEED, speed[known], 0.0)
    return bool(np.mean(driven) * (end - begin) >= STUCK_WAY)


def _way(gnss: GnssFixes, begin: float, end: float) -> float:
    """How far apart the fixes from begin to end s lie, m: the larger of north and west."""
    inside = (gnss.t >= begin) & (gnss.t <= end)
    if not inside.any():
        return 0.0
    position = gnss.position_n(Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0))[inside, :2]
    return float(np.max(np.ptp(position, axis=0)))
