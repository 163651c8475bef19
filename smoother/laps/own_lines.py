"""Timing lines stored in a recording: used where they lie across the track, else reported.

Programs write different things there: RaceBox and VBOX the ends of a line, RaceChrono a point of the track and another
one some 30 m along it, which is no line.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.fit.plan_path import PlanPath
from smoother.frames import Origin, geodetic_to_nwu
from smoother.laps.line import both_ways, oriented
from smoother.laps.results import GivenLines
from smoother.laps.timing import forward_normal, gate_crossings
from smoother.samples import Problem

LENGTH = (3.0, 120.0)  # m, of anything that may be a line across a track

Ends = tuple[tuple[float, float], tuple[float, float]]  # two points (lat, lon), degrees


@dataclass(frozen=True)
class OwnLine:
    """A line of a recording: kind "start", "split", ..; its ends in each possible order of the coordinates."""

    kind: str
    orders: tuple[Ends, ...]


def trusted_lines(own: Sequence[OwnLine], origin: Origin, path: PlanPath) -> GivenLines | Problem | None:
    """Return the lines of the recording where its start line is plausible, else the problem; None without lines."""
    starts = [line for line in own if line.kind == "start"]
    if not starts:
        return None
    start = _across(starts[0], origin, path)
    if start is None:
        return Problem(
            "own_line_unused",
            "the start/finish line in the recording does not lie across the track as it was driven; one was found",
        )
    splits = [_across(line, origin, path) for line in own if line.kind == "split"]
    sectors = tuple(ends for ends in splits if ends is not None) if all(e is not None for e in splits) else ()
    return GivenLines(start, sectors, source="file")


def _across(line: OwnLine, origin: Origin, path: PlanPath) -> Array | None:
    """Ends (2, 2) m of the line where the path crosses it, else None."""
    for order in line.orders:
        lat, lon = np.array(order).T
        if np.abs(lat).max() > 90.0 or np.abs(lon).max() > 180.0:
            continue
        ends = geodetic_to_nwu(lat, lon, np.full(2, origin.alt_m), origin)[:, :2]
        if LENGTH[0] < float(np.linalg.norm(ends[1] - ends[0])) < LENGTH[1] and _is_passed(ends, path):
            return np.asarray(ends)
    return None


def _is_passed(ends: Array, path: PlanPath) -> bool:
    for forward in both_ways(ends):
        line = oriented("", ends, forward, "")
        t = gate_crossings(path, line, 0.0)
        if len(t) < 2:  # times at least, in one direction
            continue
        velocity = path.at(t)[1]
        sine = velocity @ forward_normal(line) / np.maximum(np.linalg.norm(velocity, axis=1), 1e-6)
        # of the angle between line and path, usually: 45 deg; laps cut a line that lies along them at 10
        if float(np.median(sine)) > 0.7:
            return True
    return False
