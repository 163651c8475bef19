"""A box that lies otherwise for a while as it drives: turned over, put back another way, or its axes written anew.

The mean force on a vehicle is gravity and what its bends and brakes add to it, at a right angle. How much they added,
the size of the mean tells: so much it may be tilted, and no more. What is left, hills and the sensor's faults, is far
less than a box that was turned. One that was turned about the vertical is not seen here.

To the smoother the box is one with the kart. It would look for a motion in which both lie as they do, and find one: the
next lap, another clock, a kart upside down.
"""

from itertools import pairwise

import numpy as np

from smoother.arrays import Array, BoolArray, ComplexArray, IntArray, median
from smoother.disc import release
from smoother.frames import Origin
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.checks.table import only
from smoother.units import DEG, STANDARD_GRAVITY
from smoother.words import counted

WINDOW = 10.0  # s over which forces are averaged: bends to both sides, starts and stops
FEWEST_WINDOWS = 4
MARGIN = 35.0 * DEG  # beyond what bends and brakes tilt: hills, biases, forces cut off at the end of a range
SHORTEST = 2  # windows; in less a kart lies on its side, and is put back
FEW_BETWEEN = 3  # windows between two that are turned are turned: a steady bend hides it
LEAST_WAY = 100.0  # m driven while it is turned; a box in the hand before the start harms nothing
STANDS = 15.0  # m in a window, below which the kart stands: fixes wander by as much
FAST = 5.0  # m/s; slower, a kart may go backwards
LONGEST_STEP = 0.6  # s from one velocity to the next; what is between two that are farther apart is not known
LAGS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5)  # s that velocities may be late by; the one that fits best is taken
COHERENT = 0.7  # correlation of force and path in a window that tells a side
POINTS_ELSEWHERE = 60.0 * DEG  # a box on the wheel swings by half as much
FEWEST_OF_WINDOW = 10  # velocities
MOST_CANDIDATES = 64  # of the windows, as how the box lies mostly


def without_turned(imu: RawImu, gnss: GnssFixes, file: str, problems: list[Problem]) -> RawImu:
    """Return the samples without those in which the box lies otherwise than on most of the way, said in `problems`.

    file : name for the sentences. A window and a stand on either side go with them, as the box may be turned in these.
    """
    starts = _starts(imu.t)
    if starts.size < FEWEST_WINDOWS:
        return imu
    force, way = _mean_forces(imu, starts), _ways(gnss, imu.t, starts)
    usual = _usual(force, way)
    turned = [
        (
            first,
            last,
            f"lies otherwise, turned by about {median(_angles(force[first : last + 1], usual)) / DEG:.0f} deg",
        )
        for first, last in _runs(~_lie_alike(force, usual))
        if np.sum(way[first : last + 1]) >= LEAST_WAY
    ]
    return _without(imu, starts, way, turned, file, problems)


def _without(
    imu: RawImu, starts: IntArray, way: Array, turned: list[tuple[int, int, str]], file: str, problems: list[Problem]
) -> RawImu:
    """The samples without some windows, and one on either side: (first, last, how the box lies in them), said.

    So are those of a stand beside them: it may have been turned at any time of that. way (K,) m in the windows.
    """
    bad = np.zeros(imu.t.size, dtype=np.bool_)
    ends = np.append(starts[1:], imu.t.size)
    drives = np.flatnonzero(way > STANDS)
    for first, last, how in turned:
        before, after = drives[drives < first], drives[drives > last]
        first = min(first - 1, int(before[-1]) + 1) if before.size else 0
        last = max(last + 1, int(after[0]) - 1) if after.size else ends.size - 1
        rows = slice(int(starts[max(0, first)]), int(ends[min(last, ends.size - 1)]))
        bad[rows] = True
        lost = rows.stop - rows.start
        text = (
            f"{file}: from {imu.t[rows][0]:.0f} to {imu.t[rows][-1]:.0f} s the box {how}; {counted(lost, 'sample')} "
            "left out. Smooth that part for itself, if it counts"
        )
        problems.append(Problem("imu_turned", text, lost))
    return only(imu, ~bad) if bad.any() else imu


def _starts(t: Array) -> IntArray:
    """First sample (K,) of each WINDOW that holds any."""
    return np.unique(np.searchsorted(t, np.arange(t[0], t[-1], WINDOW))) if t.size else np.empty(0, dtype=np.int64)


def _mean_forces(imu: RawImu, starts: IntArray) -> Array:
    """Mean force (K, 3) m/s^2 of each window."""
    count = np.diff(np.append(starts, imu.t.size))
    means = np.add.reduceat(imu.accel, starts, axis=0) / count[:, None] * imu.accel_scale
    release(imu)
    return np.asarray(means)


def _ways(gnss: GnssFixes, t: Array, starts: IntArray) -> Array:
    """How far (K,) m the kart came in each window from sample `starts` (K,) at t (N,) s, by the fixes, straight across
    half of it: at rest fixes wander less."""
    position = gnss.position_n(Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0))[:, :2]
    begin = t[starts]
    times = np.stack([begin, begin + 0.5 * WINDOW, begin + WINDOW])
    north, east = (np.interp(times, gnss.t, position[:, axis]) for axis in (0, 1))
    return np.asarray(np.sum(np.hypot(np.diff(north, axis=0), np.diff(east, axis=0)), axis=0))


def _usual(force: Array, way: Array) -> Array:
    """The mean force (3,) as the box lies on most of the way (K,) m, of those (K, 3) of the windows."""
    some = _candidates(len(force))
    alike = [_lie_alike(force, force[k]) for k in some]
    best = alike[int(np.argmax([np.sum(way[one]) for one in alike]))]
    return np.asarray(np.mean(force[best], axis=0))


def _candidates(n: int) -> IntArray:
    """Of n windows, MOST_CANDIDATES at most, evenly: a day has 8000, and each is compared with all."""
    return np.unique(np.linspace(0, n - 1, MOST_CANDIDATES).round().astype(np.int64))


def _lie_alike(force: Array, other: Array) -> BoolArray:
    """Mask (K,) of the windows whose mean force (K, 3) is as another (3,) of a box that lies the same way may be."""
    return np.asarray(_angles(force, other) <= MARGIN + _tilts(force) + _tilts(other))


def _angles(force: Array, other: Array) -> Array:
    """Angle (K,) rad of forces (K, 3) to another (3,)."""
    size = np.linalg.norm(force, axis=1) * np.linalg.norm(other)
    return np.asarray(np.arccos(np.clip(force @ other / np.maximum(size, 1e-9), -1.0, 1.0)))


def _tilts(force: Array) -> Array:
    """By how much (...) rad bends and brakes tilted mean forces (..., 3), by how much larger than gravity they are."""
    return np.asarray(np.arccos(STANDARD_GRAVITY / np.maximum(np.linalg.norm(force, axis=-1), STANDARD_GRAVITY)))


def _runs(turned: BoolArray) -> list[tuple[int, int]]:
    """First and last window of each run of those that are turned, with the few between two of them."""
    index = np.flatnonzero(turned)
    if index.size == 0:
        return []
    cuts = np.flatnonzero(np.diff(index) > FEW_BETWEEN + 1)
    first, last = index[np.append(0, cuts + 1)], index[np.append(cuts, -1)]
    return [(a, b) for a, b in zip(first.tolist(), last.tolist(), strict=True) if b + 1 - a >= SHORTEST]


def without_turned_about(imu: RawImu, gnss: GnssFixes, file: str, problems: list[Problem]) -> RawImu:
    """The same for a box turned about the vertical, where the fixes have velocities often enough to tell."""
    starts = _starts(imu.t)
    if starts.size < FEWEST_WINDOWS:
        return imu
    force, way = _mean_forces(imu, starts), _ways(gnss, imu.t, starts)
    points = max((_pointings(imu, gnss, starts, _usual(force, way), lag) for lag in LAGS), key=lambda c: _told(c, way))
    tells = np.abs(points) > COHERENT
    if np.count_nonzero(tells) < FEWEST_WINDOWS:
        return imu
    others = points[tells]
    apart = np.abs(np.angle(points[:, None] / others[None, _candidates(others.size)]))
    alike = apart < POINTS_ELSEWHERE
    usual = int(np.argmax((way * tells) @ alike))
    turned = []
    for first, last in _runs(tells & ~alike[:, usual]):
        between = slice(first, last + 1)
        if np.sum(way[between]) < LEAST_WAY or np.any(tells[between] & alike[between, usual]):
            continue
        angle = median(apart[between, usual][tells[between]]) / DEG
        turned.append((first, last, f"points elsewhere, turned by about {angle:.0f} deg about the vertical"))
    return _without(imu, starts, way, turned, file, problems)


def _told(points: ComplexArray, way: Array) -> float:
    """How much of the way (K,) m tells where the box points (K,)."""
    return float(np.sum(np.abs(points) * way))


def _pointings(imu: RawImu, gnss: GnssFixes, starts: IntArray, up: Array, lag: float) -> ComplexArray:
    """Where the box points in each window, (K,) complex: correlation of the level force with the kart's path.

    up (3,) : the usual force. Velocities are late by `lag` s. 0 where nothing tells.
    """
    points = np.zeros(starts.size, dtype=np.complex128)
    t = gnss.t - lag
    velocity = gnss.velocity_n[:, 0] + 1j * gnss.velocity_n[:, 1]
    at = np.searchsorted(imu.t, t)
    some = np.isfinite(velocity) & (at < imu.t.size) & (np.abs(velocity) > FAST)
    rows = np.flatnonzero(some[1:] & some[:-1] & (np.diff(t) < LONGEST_STEP) & (np.diff(at) > 0) & (at[:-1] > 0))
    if rows.size < FEWEST_OF_WINDOW:
        return points
    bounds = np.stack([at[rows], at[rows + 1]], axis=1)
    sums = np.add.reduceat(imu.accel, bounds.ravel(), axis=0)[::2]
    release(imu)
    force = sums / np.diff(bounds) * imu.accel_scale @ _level_axes(up)
    along = 0.5 * (velocity[rows] + velocity[rows + 1])
    pushed = (velocity[rows + 1] - velocity[rows]) / np.diff(t)[rows] * np.conj(along) / np.abs(along)
    window = np.searchsorted(imu.t[starts], t[rows], side="right") - 1
    edges = np.flatnonzero(np.diff(window, prepend=-1, append=starts.size))
    for first, last in pairwise(edges.tolist()):
        felt, did = (values[first:last] - np.mean(values[first:last]) for values in (force, pushed))
        if last - first >= FEWEST_OF_WINDOW:
            size = float(np.linalg.norm(did) * np.linalg.norm(felt))
            points[window[first]] = np.vdot(did, felt) / max(size, 1e-9)
    return points


def _level_axes(up: Array) -> ComplexArray:
    """(3,) complex: what makes of a force (3,) its level part, along some level axis and i times to the left of it."""
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    first = np.cross(up, np.eye(3)[int(np.argmin(np.abs(up)))])
    first /= np.linalg.norm(first)
    return np.asarray(first + 1j * np.cross(up, first))
