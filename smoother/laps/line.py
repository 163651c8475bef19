"""Timing lines: the intersection of a given line with the track, and the position of one that is not given.

Position and direction of a given line are used, but not its ends: fixes err by metres, so a kart may seem to pass
beside the gate. The intersection with the reference line counts; a second straight that a long line also meets is
recognised by its direction or by its distance from the middle of the gate.
"""

import numpy as np

from smoother.arrays import Array
from smoother.fit.running import running_maximum
from smoother.frames import to_left
from smoother.laps.reference import Curve
from smoother.laps.results import Line

BESIDE = 12.0  # m beyond the ends of a gate at which a track may pass: three sigma of the wander of a GPS, twice
HALF_WIDTH = 8.0  # m, of a line that was found: a wide kart track and the spread of its fixes
ELSEWHERE, ELSEWHERE_OF_SMALL = 40.0, 0.4  # m along the track, of the length of small ones: the other side of the round
STRAIGHT = 1.0 / 120.0  # 1/m, largest curvature of a straight for a line
FAST = 0.9  # of the best point's speed: all such points are equally good, and the one with more laps is chosen


def meeting_places(curve: Curve, ends: Array) -> Array:
    """Return track distances (K,) m where a line with ends (2, 2) m meets the track, the most central one first."""
    centre, span = ends.mean(axis=0), ends[1] - ends[0]
    width = float(np.linalg.norm(span))
    across = span / width
    normal = np.array([-across[1], across[0]])
    points = curve.line.position_n - centre
    past, place = points @ normal, points @ across
    later, later_place = np.roll(past, -1), np.roll(place, -1)
    meets = np.sign(past) != np.sign(later)
    meets[-1] &= curve.line.is_closed
    share = past / np.where(meets, past - later, 1.0)
    where = np.abs(place + share * (later_place - place))
    meets &= where < 0.5 * width + BESIDE
    k = np.flatnonzero(meets)
    oblique = np.abs(curve.line.tangent_n[k] @ normal) < 0.5  # least sine between line and track: 30 deg
    k = k[~oblique]
    spacing = curve.length / len(points) if curve.line.is_closed else float(np.median(np.diff(curve.line.distance)))
    return np.asarray(curve.line.distance[k] + share[k] * spacing)[np.argsort(where[k], kind="stable")]


def oriented(name: str, ends: Array, forward: Array, source: str, distance: float = float("nan")) -> Line:
    """Return the line with its ends named left and right as seen in direction forward (2,)."""
    span = ends[0] - ends[1]
    left, right = (ends[0], ends[1]) if to_left(forward, span) > 0.0 else (ends[1], ends[0])
    return Line(name, left, right, source, distance)


def both_ways(ends: Array) -> list[Array]:
    """Return the two unit vectors (2,) across a line with ends (2, 2), the two possible directions of travel."""
    span = ends[1] - ends[0]
    normal = np.array([-span[1], span[0]]) / np.linalg.norm(span)
    return [normal, -normal]


def line_across(curve: Curve, distance: float, name: str, spread: float = 0.0) -> Line:
    """Return a line perpendicular to the track at `distance`, wide enough for laps that spread over `spread` m."""
    at = np.array([distance])
    centre, tangent = curve.position(at)[0], curve.tangent(at)[0]
    left = np.array([-tangent[1], tangent[0]])
    # of the distance to another part of the track, which the line must not reach
    half = min(max(HALF_WIDTH, spread + 3.0), 0.45 * _room(curve, distance))
    return Line(name, centre + half * left, centre - half * left, "found", distance)


def best_place(curve: Curve, speed: Array, laps_at: Array) -> float:
    """Return the track distance where a line times best: fast and straight, and as many whole laps as possible.

    speed, laps_at (P,) at the points of the line: usual speed in m/s, and the number of laps for a line there.
    An error of position along the track becomes one of time divided by the speed.
    """
    is_closed = curve.line.is_closed
    window = 2 * max(1, round(10.0 * len(speed) / curve.length)) + 1  # m before and after the line
    straight = running_maximum(np.abs(curve.line.curvature), window, is_closed=is_closed)
    steady = -running_maximum(-speed, window, is_closed=is_closed)
    worth = np.where(straight < STRAIGHT, 1.0, STRAIGHT / np.maximum(straight, STRAIGHT)) * steady
    good = worth >= FAST * worth.max()
    good &= laps_at == laps_at[good].max()
    return float(curve.line.distance[np.flatnonzero(good)[np.argmax(worth[good])]])


def _room(curve: Curve, distance: float) -> float:
    """Distance (m) from the line at `distance` to the nearest part of the track that is elsewhere along it."""
    along = np.abs(curve.line.distance - distance)
    if curve.line.is_closed:
        along = np.minimum(along, curve.length - along)
    elsewhere = along > min(ELSEWHERE, ELSEWHERE_OF_SMALL * curve.length)
    if not elsewhere.any():
        return np.inf
    centre = curve.position(np.array([distance]))[0]
    return float(np.linalg.norm(curve.line.position_n[elsewhere] - centre, axis=1).min())
