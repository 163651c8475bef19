"""A sensor, or one axis of it, that stands still while the others go on and the kart drives: it was not measured.

What repeats itself may also be a coarse sensor, one whose samples are held until the next one, or one at the end of its
range. A stretch counts where the sensor otherwise hardly ever repeats itself, or always as often, and stands elsewhere.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release
from smoother.frames import Origin
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.inertial import HOLE, dead_axes
from smoother.words import span

SENSOR_FROZEN = 0.3  # s for which not one of three noisy values changes
AXIS_FROZEN = 1.5  # s for which one does not
LONGEST_AXIS_FROZEN = 10.0  # s; from there on the axis is at fault, which is said elsewhere and fails the result
FEWEST_FROZEN = 10  # samples, however slowly they come
REPEATING = 0.02  # of the values are repeated: more is a coarse sensor, unless all are repeated alike
HELD = 99.0  # per cent of the repeated ones that are repeated alike
HELD_TIMES = 10  # as often as that
GOING_ON = 0.1  # of the other sensor's samples are unlike the one before
CLIPPED = 0.5  # of the largest value of an axis; an end of its range is farther out
DRIVEN = 5.0  # m/s
AROUND = 1.0  # s before and after a stretch, within which there are fixes


@dataclass(frozen=True)
class _Part:
    """What of the samples is judged by itself: columns of a sensor, and how long, s, a stretch has to be."""

    name: str
    values: Array
    others: Array
    shortest: float
    longest: float = np.inf


def without_frozen_sensor(imu: RawImu, gnss: GnssFixes, file: str, problems: list[Problem]) -> RawImu:
    """Return the samples without those in which one sensor or axis stands still while the kart drives.

    What is left out is said in `problems`; `file` is the name for the sentences.
    """
    frozen = np.zeros(imu.t.size, dtype=np.bool_)
    for part in _parts(imu):
        found = [
            (first, last)
            for first, last in _stretches(imu.t, part)
            if not frozen[last] and _speed(gnss, imu.t[first], imu.t[last]) > DRIVEN
        ]
        if found:
            problems.append(_said(imu.t, part.name, found, file))
        for first, last in found:
            frozen[first + 1 : last + 1] = True
    return without_rows(imu, frozen) if np.any(frozen) else imu


def without_rows(imu: RawImu, bad: BoolArray) -> RawImu:
    """Return the samples without those of mask `bad` (N,)."""
    temperature = None if imu.temperature is None else imu.temperature[~bad]
    kept_rows = {name: getattr(imu, name)[~bad] for name in ("t", "accel", "gyro")}
    return replace(imu, temperature=temperature, **kept_rows)


def _parts(imu: RawImu) -> Iterator[_Part]:
    """Both sensors, then their axes but for those that never change."""
    dead = dead_axes(imu)
    sensors = {"accelerometer": (imu.accel, imu.gyro), "gyroscope": (imu.gyro, imu.accel)}
    for sensor, (values, others) in sensors.items():
        if not all((sensor, letter) in dead for letter in "xyz"):
            yield _Part(f"the {sensor}", values, others, SENSOR_FROZEN)
    for sensor, (values, others) in sensors.items():
        for axis, letter in enumerate("xyz"):
            if (sensor, letter) not in dead:
                part = values[:, axis : axis + 1]
                yield _Part(f"{letter} of the {sensor}", part, others, AXIS_FROZEN, LONGEST_AXIS_FROZEN)


def _stretches(t: Array, part: _Part) -> list[tuple[int, int]]:
    """First and last sample of each stretch in which a part does not change though it should; see the module's text."""
    edges = np.flatnonzero(np.diff(_repeats(t, part.values)))
    first, last = edges[0::2], edges[1::2]
    length = last - first
    if not length.size:
        return []
    fewest = FEWEST_FROZEN
    if length.size > REPEATING * (t.size - int(np.sum(length))):
        usual = float(np.percentile(length, HELD))
        if usual > 2.0 * float(np.median(length)):
            return []
        fewest = max(fewest, round(HELD_TIMES * usual))
    lasts = t[last] - t[first]
    long = np.flatnonzero((length >= fewest) & (lasts > part.shortest) & (lasts < part.longest))
    found = zip(first[long].tolist(), last[long].tolist(), strict=True)
    smallest, largest = _extremes(part.values)
    return [
        (i, k)
        for i, k in found
        if _go_on(part.others[i : k + 1]) and not _is_clipped(part.values[i], smallest, largest)
    ]


def _go_on(values: Array) -> bool:
    """Whether samples (N, 3) change, held ones among them; a box that rests may repeat all it measures."""
    return bool(np.mean(np.any(np.diff(values, axis=0) != 0.0, axis=1)) > GOING_ON)


def _repeats(t: Array, values: Array) -> BoolArray:
    """Mask (N + 1,) of the samples (N, M) that are as the one before, without a hole; the last one stands for none."""
    same = np.zeros(t.size + 1, dtype=np.bool_)
    for part in pieces(t.size - 1):
        before, now = slice(part.start, part.stop), slice(part.start + 1, part.stop + 1)
        same[now] = np.all(values[now] == values[before], axis=1) & (t[now] - t[before] <= HOLE)
        release(t, values)
    return same


def _extremes(values: Array) -> tuple[Array, Array]:
    """Least and largest value of each column of (N, M)."""
    least, most = np.full(values.shape[1], np.inf), np.full(values.shape[1], -np.inf)
    for part in pieces(len(values)):
        least, most = np.minimum(least, values[part].min(axis=0)), np.maximum(most, values[part].max(axis=0))
        release(values)
    return least, most


def _is_clipped(value: Array, least: Array, most: Array) -> bool:
    """Whether an axis (M,) stands at the end of its range, which is the outermost value it has."""
    outermost = (value == least) | (value == most)
    return bool(np.any(outermost & (np.abs(value) > CLIPPED * np.maximum(np.abs(least), np.abs(most)))))


def _speed(gnss: GnssFixes, begin: float, end: float) -> float:
    """Mean speed, m/s, around a stretch from begin to end s: as sent, else by the places; 0 where fixes are missing."""
    inside = np.flatnonzero((gnss.t >= begin - AROUND) & (gnss.t <= end + AROUND))
    if inside.size < 2:
        return 0.0
    around = gnss.select(inside)
    known = np.hypot(around.velocity_n[:, 0], around.velocity_n[:, 1])
    if np.any(np.isfinite(known)):
        return float(np.nanmean(known))
    place = around.position_n(Origin(float(around.lat_deg[0]), float(around.lon_deg[0]), 0.0))
    return float(np.hypot(*(place[-1, :2] - place[0, :2])) / (around.t[-1] - around.t[0]))


def _said(t: Array, name: str, found: list[tuple[int, int]], file: str) -> Problem:
    lasts, begin = span(sum(float(t[last] - t[first]) for first, last in found)), f"{t[found[0][0]]:.1f} s"
    where = f"from {begin} on" if len(found) == 1 else f"in {len(found)} stretches, the first from {begin} on"
    text = f"{file}: {name} stands still for {lasts} of the drive, {where}; those samples are left out, as not measured"
    return Problem("imu_sensor_frozen", text, sum(last - first for first, last in found))
