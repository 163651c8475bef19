"""Crossing times of a line, solved on the smooth path, and by straight lines between the raw fixes."""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.fit.plan_path import PlanPath
from smoother.laps.follow import Followed
from smoother.laps.results import FixPath, Line

BESIDE = 6.0  # m beyond the ends of a gate at which a passage counts without a known sigma: three of a GPS
USUAL_WAY = 11.0  # m from the reference line: width of a track and wander of the GPS
SAME_PLACE = 30.0  # m of track distance from that of the line: a line may be oblique, and laps may pass it wide
APART = 0.4  # of a lap, least distance between two passages


@dataclass(frozen=True, eq=False)
class Crossings:
    """Passages of one line in time order. t (K,) s; lap (K,) int: number of passages of the track's zero before;
    is_solved (K,): on the line itself, else interpolated in a gap of the fixes."""

    t: Array
    lap: IntArray
    is_solved: BoolArray

    def __len__(self) -> int:
        return len(self.t)


def forward_normal(line: Line) -> Array:
    """Unit vector (2,) normal to the line in the direction of travel."""
    span = line.left_n - line.right_n
    return np.asarray(np.array([span[1], -span[0]]) / np.linalg.norm(span))


def past(line: Line, position_n: Array) -> Array:
    """Distance (K,) m past the line (negative: before it) of positions (K, 2)."""
    return np.asarray((position_n - 0.5 * (line.left_n + line.right_n)) @ forward_normal(line))


def across(line: Line, position_n: Array) -> Array:
    """Coordinate along the line (K,) of positions (K, 2): 0 in the middle, 1 at the left end, -1 at the right."""
    span = line.left_n - line.right_n
    away = position_n - 0.5 * (line.left_n + line.right_n)
    return np.asarray(2.0 * (away @ span) / (span @ span))


def crossings(
    path: PlanPath,
    followed: Followed,
    length: float,
    line: Line,
    beside: float = BESIDE,
    blind: BoolArray | None = None,
) -> Crossings:
    """Return every passage of `line`, which stands at line.distance on a track of `length` m.

    A passage crosses the line in the direction of travel, at the right track distance: within the gate (and `beside` m
    beyond its ends) or where laps usually pass. Away from the track only the gate itself counts. Repeated crossings of
    a kart on the line are one passage. In a gap of the fixes, rows `blind` (N,), the time is that of the track
    distance.
    """
    t, distance = _on_the_line(path, followed, length, line, beside)
    lap = np.round((distance - line.distance) / length).astype(np.int64)
    solved = Crossings(t, lap, np.ones(len(t), dtype=np.bool_))
    found = _once(path, solved, length)
    if blind is None or not blind.any():
        return found
    return _with_unseen(path, followed, length, line, blind, found)


def _on_the_line(path: PlanPath, followed: Followed, length: float, line: Line, beside: float) -> tuple[Array, Array]:
    """Times (K,) s and unwrapped track distances (K,) m of all passages at the right track distance."""
    t = gate_crossings(path, line, np.inf)
    place = np.abs(across(line, path.at(t)[0])) if len(t) else np.empty(0)
    half = 0.5 * float(np.linalg.norm(line.left_n - line.right_n))
    row = path.row_before(t) if len(t) else np.empty(0, dtype=np.int64)
    distance = np.interp(t, path.t, followed.distance)
    off = np.abs(np.mod(distance - line.distance + 0.5 * length, length) - 0.5 * length)
    is_on, lateral = followed.is_on[row], np.nan_to_num(np.abs(followed.lateral[row]), nan=np.inf)
    in_gate, is_usual = place * half <= half + beside, lateral <= USUAL_WAY
    good = np.where(is_on, (off < SAME_PLACE) & (in_gate | is_usual), place <= 1.0)
    return t[good], distance[good]


def _once(path: PlanPath, found: Crossings, length: float) -> Crossings:
    """Remove passages that follow another within a part of a lap."""
    driven = np.interp(found.t, path.t, path.driven)
    kept: list[int] = []
    for i in range(len(found)):
        if not kept or driven[i] - driven[kept[-1]] > APART * length:
            kept.append(i)
    return Crossings(found.t[kept], found.lap[kept], found.is_solved[kept])


def _with_unseen(
    path: PlanPath, followed: Followed, length: float, line: Line, blind: BoolArray, found: Crossings
) -> Crossings:
    """Add passages in gaps of the fixes where the path is off the track but track distance shows one."""
    reached = np.maximum.accumulate(np.where(np.isfinite(followed.distance), followed.distance, -np.inf))
    lap = np.floor((reached - line.distance) / length)
    row = np.flatnonzero((np.diff(lap) == 1.0) & blind[:-1] & ~followed.is_on[:-1])
    if row.size == 0:
        return found
    wanted = lap[row + 1] * length + line.distance
    share = np.clip((wanted - reached[row]) / np.maximum(reached[row + 1] - reached[row], 1e-9), 0.0, 1.0)
    t = path.t[row] + share * (path.t[row + 1] - path.t[row])
    driven, others = np.interp(t, path.t, path.driven), np.interp(found.t, path.t, path.driven)
    alone = np.array([np.all(np.abs(others - d) > APART * length) for d in driven])
    t, row = t[alone], row[alone]
    times = np.concatenate([found.t, t])
    order = np.argsort(times, kind="stable")
    laps = np.concatenate([found.lap, lap[row + 1].astype(np.int64)])
    solved = np.concatenate([found.is_solved, np.zeros(len(t), dtype=np.bool_)])
    return _once(path, Crossings(times[order], laps[order], solved[order]), length)


def _root(path: PlanPath, line: Line, row: np.ndarray) -> Array:
    """Times (K,) at which the path passes the line between row and row + 1, by Newton's method held to the interval."""
    normal = forward_normal(line)
    t0, t1 = path.t[row], path.t[row + 1]
    a, b = past(line, path.position_n[row]), past(line, path.position_n[row + 1])
    t = t0 + (t1 - t0) * a / np.where(a == b, -1.0, a - b)
    for _ in range(6):  # of Newton's method; from a bracket of one row two suffice
        position, velocity = path.at(t)
        speed = velocity @ normal
        speed = np.where(np.abs(speed) > 1e-3, speed, 1e-3)
        t = np.clip(t - past(line, position) / speed, t0, t1)
    return np.asarray(t)


def gate_crossings(path: PlanPath, line: Line, beside: float) -> Array:
    """Times (K,) s of all passages of a line in its direction, up to `beside` m beyond its ends; no track is needed."""
    beyond = past(line, path.position_n)
    row = np.flatnonzero((beyond[:-1] < 0.0) & (beyond[1:] >= 0.0))
    if row.size == 0:
        return np.empty(0)
    t = _root(path, line, row)
    half = 0.5 * float(np.linalg.norm(line.left_n - line.right_n))
    return np.asarray(t[np.abs(across(line, path.at(t)[0])) * half <= half + beside])


def raw_crossings(fixes: FixPath, line: Line, near: Array, within: float = 1.5) -> Array:
    """Times (K,) s at which straight lines between raw fixes pass the line, nearest to the times `near` (K,) s.

    NaN where there is none within `within` s or the fixes are too far apart.
    """
    beyond = past(line, fixes.position_n)
    # s between raw fixes that are connected
    row = np.flatnonzero((beyond[:-1] < 0.0) & (beyond[1:] >= 0.0) & (np.diff(fixes.t) < 2.5))
    if row.size == 0 or len(near) == 0:
        return np.full(len(near), np.nan)
    t = fixes.t[row] + np.diff(fixes.t)[row] * beyond[row] / (beyond[row] - beyond[row + 1])
    half = 0.5 * float(np.linalg.norm(line.left_n - line.right_n))
    share = ((t - fixes.t[row]) / np.diff(fixes.t)[row])[:, None]
    place = fixes.position_n[row] * (1.0 - share) + fixes.position_n[row + 1] * share
    t = t[np.abs(across(line, place)) * half <= half + 20.0]  # m, tolerance of raw fixes near a known passage
    if t.size == 0:
        return np.full(len(near), np.nan)
    nearest = t[np.argmin(np.abs(t[None, :] - np.asarray(near)[:, None]), axis=1)]
    return np.where(np.abs(nearest - near) < within, nearest, np.nan)
