"""A sensor, or one axis of it, that stands still while the others go on and the kart drives: it was not measured.

What repeats itself may also be a coarse sensor, one whose samples are held until the next one, one that writes 0 for
any slow turn, or one at the end of its range. A stretch counts where the sensor otherwise hardly ever repeats itself,
or always as often, and stands elsewhere: at whatever it last measured.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.disc import pieces, release
from smoother.frames import Origin
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.inertial import HOLE, dead_axes
from smoother.units import STANDARD_GRAVITY
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
LEVEL_TIMES = (2, 3)  # stretches at 0, and at another value, from which on it is a level of the sensor
AS_LONG = 0.25  # of one of them, at least, lasts another that counts
# of the step to what comes next to a level, and share of samples that may be so near to it: it has none between
NEAR, FEW_NEAR = 0.5, 0.01
RESTING = 0.5 * STANDARD_GRAVITY  # m/s^2; less force than that is no level of an accelerometer
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
    least_level: float = 0.0  # size of its values below which none is a level


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
            least_level = RESTING / imu.accel_scale if sensor == "accelerometer" else 0.0
            yield _Part(f"the {sensor}", values, others, SENSOR_FROZEN, least_level=least_level)
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
    levels = _Levels(part.values, first, last, part.least_level)
    return [
        (i, k)
        for i, k in found
        if _go_on(part.others[i : k + 1])
        and not _is_clipped(part.values[i], smallest, largest)
        and not levels.has(i, k)
    ]


def stands_at_level(t: Array, values: Array, first: int, last: int) -> bool:
    """Whether values (N, 1) of an axis that do not change from row `first` to `last` stand at a level of the sensor."""
    edges = np.flatnonzero(np.diff(_repeats(t, values)))
    return _Levels(values, edges[0::2], edges[1::2], 0.0).has(first, last)


class _Levels:
    """Values at which a part stands again and again, coming from the next one to them: of coarse steps, or a dead band.

    A sensor that freezes keeps any value; one that fails, and writes 0, jumps to it past others that are nearer.
    """

    def __init__(self, values: Array, first: IntArray, last: IntArray, least: float) -> None:
        """values (N, M), which repeat one another in each stretch from a row of first (K,) to that of last (K,)."""
        long = last - first >= FEWEST_FROZEN
        self._values, self._first, self._last, self._least = values, first[long], last[long], least
        self._is_next: dict[bytes, bool] = {}

    def has(self, first: int, last: int) -> bool:
        """Whether the stretch from row `first` to `last` is one of several, about as long, at one level."""
        level = self._values[first]
        if np.linalg.norm(level) < self._least:
            return False
        here = np.all(self._values[self._first] == level, axis=1)
        alike = here & (self._last - self._first >= AS_LONG * (last - first))
        if np.count_nonzero(alike) < LEVEL_TIMES[int(np.any(level != 0.0))]:
            return False
        key = level.tobytes()
        if key not in self._is_next:
            self._is_next[key] = self._comes_from_next(level, self._first[here], self._last[here])
        return self._is_next[key]

    def _comes_from_next(self, level: Array, first: IntArray, last: IntArray) -> bool:
        """Whether hardly any sample is nearer to a level (M,) than those before and after its stretches."""
        rows = np.concatenate([first[first > 0] - 1, last[last < len(self._values) - 1] + 1])
        beside = np.linalg.norm(self._values[rows] - level, axis=1)
        near, nearer, others = NEAR * median(beside) if beside.size else 0.0, 0, 0
        for part in pieces(len(self._values)):
            off = np.linalg.norm(self._values[part] - level, axis=1)
            nearer += int(np.count_nonzero((off > 0.0) & (off < near)))
            others += int(np.count_nonzero(off > 0.0))
            release(self._values)
        return nearer <= FEW_NEAR * others


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
