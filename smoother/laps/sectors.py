"""Sectors: lines where none were given, and every lap's times between the lines."""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.plan_path import PlanPath
from smoother.laps.circuit import Circuit
from smoother.laps.line import line_across
from smoother.laps.passages import Passage
from smoother.laps.reference import Curve
from smoother.laps.results import Corner, Line
from smoother.laps.sigma import Crossed, sigma_of, time_covariances
from smoother.laps.timing import crossings, forward_normal, gate_crossings
from smoother.trajectory import JointPosition

SECTORS = 3
SHORTEST = 0.12  # of the lap


def found_sectors(curve: Curve, corners: tuple[Corner, ...], counting: BoolArray) -> tuple[Line, ...]:
    """Return the lines between :data:`SECTORS` sectors, at the braking points nearest to equal parts of the lap.

    There the kart is fastest, which makes timing most accurate, and a sector contains whole corners. counting (L,)
    bool: usual laps.
    """
    places = np.array([_braking_place(corner, counting) for corner in corners if corner.segment[0] > 0.0])
    lines: list[Line] = []
    last = 0.0
    for number in range(1, SECTORS):
        wanted = curve.length * number / SECTORS
        ends = places[(places > last + SHORTEST * curve.length) & (places < (1.0 - SHORTEST) * curve.length)]
        if ends.size == 0:
            break
        last = float(ends[np.argmin(np.abs(ends - wanted))])
        lines.append(line_across(curve, last, f"sector {number}"))
    return tuple(lines)


def _braking_place(corner: Corner, counting: BoolArray) -> float:
    points = corner.braking_point[counting]
    points = points[np.isfinite(points)]
    return float(np.median(points)) if points.size else corner.segment[0]


def line_times(
    path: PlanPath, circuit: Circuit, passages: tuple[Passage, ...], lines: tuple[Line, ...], beside: float
) -> Array:
    """Times (L, S + 1) s at which each lap passed the start, each sector line and the finish; NaN where it did not.

    beside m: tolerance beyond the ends of a line, as for :func:`find_passages`.
    """
    out = np.full((len(passages), len(lines) + 2), np.nan)
    for i, lap in enumerate(passages):
        out[i, 0] = lap.start if lap.starts_at_line else np.nan
        out[i, -1] = lap.end if lap.ends_at_line else np.nan
    for column, line in enumerate(lines, start=1):
        if circuit.finish_line is None:
            passed = crossings(path, circuit.followed, circuit.curve.length, line, beside).t
        else:
            passed = gate_crossings(path, line, beside)
        for i, lap in enumerate(passages):
            within = passed[(passed > lap.start) & (passed < lap.end)]
            out[i, column] = within[0] if within.size else np.nan
    return out


def lap_sigmas(
    path: PlanPath,
    circuit: Circuit,
    lines: tuple[Line, ...],
    times: Array,
    errors: JointPosition | None,
    best: int | None,
) -> tuple[Array, Array, Array]:
    """Sigma (L,) s of each lap time, (L, S) s of its sectors, and of their differences (L, S) s from those of the lap
    `best`, from the joint covariance of all its crossings and of that lap's."""
    last = circuit.finish_line or circuit.start_line
    normal = np.array([forward_normal(line) for line in (circuit.start_line, *lines, last)])
    sigmas = np.full((len(times), 2 * len(lines) + 3), np.nan)
    laps = np.flatnonzero(np.count_nonzero(np.isfinite(times), axis=1) >= 2)
    if errors is not None and laps.size:
        sector = np.diff(np.eye(len(lines) + 2), axis=0)
        none = np.zeros_like(sector)
        weights = np.concatenate(  # the lap, its sectors, these against the best lap's; crossings of it and of the best
            [sector.sum(axis=0)[None] @ np.eye(len(lines) + 2, 2 * len(lines) + 4)]
            + [np.concatenate(pair, axis=1) for pair in ((sector, none), (sector, -sector))]
        )
        against = np.full(len(lines) + 2, np.nan) if best is None else times[best]
        both = [np.concatenate([times[lap], against]) for lap in laps]
        known = [np.isfinite(t) for t in both]
        normals = np.concatenate([normal, normal])
        groups = [Crossed(t[k], normals[k], path.at(t[k])[1]) for t, k in zip(both, known, strict=True)]
        for lap, there, covariance in zip(laps, known, time_covariances(errors, groups), strict=True):
            is_known = np.all(there[None, :] | (weights == 0.0), axis=1)
            sigmas[lap] = np.where(is_known, sigma_of(covariance, weights[:, there]), np.nan)
    sectors = len(lines) + 1
    if best is not None:
        sigmas[best, sectors + 1 :] *= 0.0
    return sigmas[:, 0], sigmas[:, 1 : sectors + 1], sigmas[:, sectors + 1 :]
