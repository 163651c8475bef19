"""Laps against the direction of the reference line: they are not timed, and a problem reports them.

The other direction has other corners, so its laps cannot be compared. Smoothed separately it is a normal session.
"""

from collections.abc import Iterator

import numpy as np

from smoother.arrays import BoolArray, IntArray
from smoother.disc import pieces
from smoother.fit.plan_path import PlanPath
from smoother.laps.follow import FOUND_WITHIN, MOVING, SAME_DIRECTION, Followed
from smoother.laps.reference import Curve
from smoother.samples import Problem

SPACING = 4.0  # m of driven distance between the tested points
TOGETHER = 2048  # points at once: with a long track some 100 MB
LEAST_DRIVEN, LEAST_COVERED = 0.95, 0.8  # of a lap; less is the way to the pits, or a road beside the track
MOST_REPORTED = 3  # stretches
ROUND = 0.05  # of the area of a circle of that length; a line around less, as a figure eight, has no direction


def driven_against(path: PlanPath, curve: Curve, followed: Followed) -> Iterator[Problem]:
    """Return a problem where the line was driven backwards for a lap or more; None for an open line."""
    if not curve.line.is_closed:
        return
    places = _places_off(path, followed)
    nearest, is_against = _beside(path, curve, places)
    places, nearest = places[is_against], nearest[is_against]
    cuts = np.flatnonzero(np.diff(path.t[places]) > 30.0) + 1  # s at rest or off the line within one stretch
    found = [
        (float(path.t[rows[0]]), float(path.t[rows[-1]]), laps)
        for rows, points in zip(np.split(places, cuts), np.split(nearest, cuts), strict=True)
        if (laps := len(rows) * SPACING / curve.length) > LEAST_DRIVEN and _covered(curve, points) > LEAST_COVERED
    ]
    if found:
        times = ", ".join(f"from {begin:.0f} to {end:.0f} s" for begin, end, _ in found[:MOST_REPORTED])
        times += ", .." if len(found) > MOST_REPORTED else ""
        laps = sum(each for _, _, each in found)
        text = f"{times} the track was driven the other way round{_way(curve)}, {laps:.1f} laps, which are not timed"
        yield Problem("driven_against", f"{text}; to have them, split the files there and smooth each part")


def _places_off(path: PlanPath, followed: Followed) -> IntArray:
    """Rows (K,) every SPACING m of driven distance where the kart moves and does not follow the line."""
    row = np.searchsorted(path.driven, np.arange(0.0, path.driven[-1], SPACING))
    return np.asarray(row[~followed.is_on[row] & (path.speed[row] > MOVING)], dtype=np.int64)


def _beside(path: PlanPath, curve: Curve, places: IntArray) -> tuple[IntArray, BoolArray]:
    """Of rows `places` (K,) the nearest point of the line (K,), and whether it is near and passed against its way."""
    line = curve.line
    nearest, is_against = np.zeros(len(places), dtype=np.int64), np.zeros(len(places), dtype=np.bool_)
    for part in pieces(len(places), TOGETHER):
        rows = places[part]
        north, west = (path.position_n[rows, i, None] - line.position_n[:, i] for i in (0, 1))
        away = north * north + west * west
        nearest[part] = np.argmin(away, axis=1)
        along = np.sum(path.velocity_n[rows] * line.tangent_n[nearest[part]], axis=1) / path.speed[rows]
        is_against[part] = (np.min(away, axis=1) < FOUND_WITHIN**2) & (along < -SAME_DIRECTION)
    return nearest, is_against


def _covered(curve: Curve, points: IntArray) -> float:
    """The share of the line that contains `points` (K,), by parts of twice their SPACING."""
    parts = np.unique((curve.line.distance[points] / (2.0 * SPACING)).astype(np.int64))
    return len(parts) * 2.0 * SPACING / curve.length


def _way(curve: Curve) -> str:
    """The direction against that of the line, clockwise or anticlockwise; empty for a line without one."""
    north, west = curve.line.position_n[:, 0], curve.line.position_n[:, 1]
    area = 0.5 * float(np.sum(north * np.roll(west, -1) - np.roll(north, -1) * west))
    if abs(area) < ROUND * curve.length**2 / (4.0 * np.pi):
        return ""
    return " (clockwise)" if area > 0.0 else " (anticlockwise)"
