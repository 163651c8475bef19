"""Clocks that step ahead in mid-drive: a receiver that learns of leap seconds, a logger that is set by the network.

The stamps then hold seconds that never passed: the kart goes on from fix to fix as it did, at the same speed on the
same way, while its clock says that a second is missing. A real hole in the recording is as long as the way through it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, IntArray, median
from smoother.frames import Origin, geodetic_to_nwu
from smoother.samples import GnssFixes, Problem, RawImu, RawMag
from smoother.words import span

SHORTEST, LONGEST = 0.15, 20.0  # s of a step; leap seconds are 18 by now
FARTHEST = 0.2  # of the step, by which the way between both fixes may differ from the usual one
NEAREST = 3.0  # m that the kart would have gone in the step, at least; fixes wander by less from one to the next
BESIDE = 3  # fixes on either side that tell velocity
TURNED = 1.2  # of the speed, by which velocities before and after may differ
STARTS = 0.5  # s by which a hole in the samples may begin before or after the step, to be of it


@dataclass(frozen=True, eq=False)
class Stepless:
    """What was recorded, on a clock without steps, and what to say of them."""

    gnss: GnssFixes
    imu: RawImu | None
    mag: RawMag | None
    problems: tuple[Problem, ...] = ()


def without_clock_steps(gnss: GnssFixes, imu: RawImu | None, mag: RawMag | None, file: str) -> Stepless:
    """Take steps of the fixes' clock out; of the samples' too, where these have a hole as long at the same place."""
    at, steps = clock_steps(gnss)
    if not at.size:
        return Stepless(gnss, imu, mag)
    since = gnss.t[at]
    t = gnss.t - np.sum(np.where(np.arange(len(gnss))[:, None] > at, steps, 0.0), axis=1)
    if imu is not None:
        both = np.array([_steps_too(imu.t, begin, step) for begin, step in zip(since, steps, strict=True)])
        imu = replace(imu, t=_closed(imu.t, since[both], steps[both]))
        mag = None if mag is None else replace(mag, t=_closed(mag.t, since[both], steps[both]))
    return Stepless(replace(gnss, t=t), imu, mag, tuple(_said(file, since, steps)))


def _said(file: str, since: Array, steps: Array) -> Iterator[Problem]:
    for begin, step in zip(since.tolist(), steps.tolist(), strict=True):
        text = f"{file}: its clock steps ahead by {span(step)} at {begin:.1f} s, while the kart drives on as before"
        yield Problem("clock_step", f"{text}; taken out. Later times are those of the clock before the step")


def clock_steps(gnss: GnssFixes) -> tuple[IntArray, Array]:
    """Return after which fixes (K,) the clock steps ahead, and by how many seconds (K,)."""
    nothing = np.empty(0, dtype=np.int64), np.empty(0)
    if len(gnss) < 2 * BESIDE + 2:
        return nothing
    interval = np.diff(gnss.t)
    usual = median(interval)
    asked = np.flatnonzero((interval > usual + SHORTEST) & (interval < usual + LONGEST))
    asked = asked[(asked >= BESIDE) & (asked < len(gnss) - 1 - BESIDE)]
    if not asked.size:
        return nothing
    origin = Origin(float(gnss.lat_deg[0]), float(gnss.lon_deg[0]), 0.0)
    place = geodetic_to_nwu(gnss.lat_deg, gnss.lon_deg, np.zeros(len(gnss)), origin)[:, :2]
    at = np.array([k for k in asked.tolist() if _goes_on(gnss.t, place, k, usual)], dtype=np.int64)
    return at, interval[at] - usual


def _goes_on(t: Array, place: Array, k: int, usual: float) -> bool:
    """Whether from fix k to the next at t (N,) s, at places (N, 2) m, the kart goes only as far as in `usual` s."""
    before = (place[k] - place[k - BESIDE]) / (t[k] - t[k - BESIDE])
    after = (place[k + 1 + BESIDE] - place[k + 1]) / (t[k + 1 + BESIDE] - t[k + 1])
    velocity, speed = 0.5 * (before + after), float(np.hypot(*(0.5 * (before + after))))
    step = float(t[k + 1] - t[k]) - usual
    if speed * step < NEAREST or float(np.hypot(*(after - before))) > TURNED * speed:
        return False
    off = place[k + 1] - place[k] - velocity * usual
    return float(np.hypot(*off)) < FARTHEST * speed * step


def _steps_too(t: Array, begin: float, step: float) -> bool:
    """Whether samples at t (N,) s have a hole of about `step` s where the fixes' clock steps, at `begin` s."""
    near = np.flatnonzero(np.abs(t - begin) < STARTS)
    if not near.size:
        return False
    around = t[max(int(near[0]) - 1, 0) : int(near[-1]) + 2]
    return bool(np.max(np.diff(around), initial=0.0) > 0.8 * step)


def _closed(t: Array, begins: Array, steps: Array) -> Array:
    """Times (N,) s without the largest hole beside each of `begins` (K,) s."""
    out = np.array(t)
    for begin, step in zip(begins.tolist(), steps.tolist(), strict=True):
        beside = np.flatnonzero(np.abs(t[:-1] - begin) < STARTS + step)
        if beside.size:
            out[int(beside[np.argmax(np.diff(t)[beside])]) + 1 :] -= step
    return out
