"""Timing lines for programs that find the laps themselves: put where the best lap crossed, across its direction."""

from dataclasses import dataclass

import numpy as np

from smoother.export.rows import Rows, joined
from smoother.export.source import LapRow, Source
from smoother.frames import nwu_to_geodetic

HALF_WIDTH = 8.0  # m; a kart track is 7 to 10 m wide, and the wander of a cheap GPS moves laps by some metres


@dataclass(frozen=True)
class Gate:
    """A line between two points, degrees; the first is the start/finish line, the others end the sectors."""

    name: str
    lat1_deg: float
    lon1_deg: float
    lat2_deg: float
    lon2_deg: float


def timing_gates(source: Source) -> list[Gate]:
    """Return start/finish and sector lines of a session; none where no lap was timed."""
    timed = [lap for lap in source.laps if lap.is_timed]
    if not timed:
        return []
    lap = source.best.lap if source.best is not None else min(timed, key=lambda lap: lap.time)
    ends = lap.start + np.cumsum([0.0, *lap.sectors[:-1]])  # the last sector ends at the start/finish line
    times = [float(t) for t in ends if np.isfinite(t)]
    names = ["Start / Finish", *(f"Sector {i}" for i in range(1, len(times)))]
    rows = _rows_of(source, lap)
    return [_gate(source, rows, t, name) for t, name in zip(times, names, strict=True)] if len(rows) > 1 else []


def _rows_of(source: Source, lap: LapRow) -> Rows:
    """The rows of one lap, with a second on either side."""
    chosen: Rows | None = None
    for rows in source.rows():
        near = (rows["t_s"] > lap.start - 1.0) & (rows["t_s"] < lap.end + 1.0)
        if near.any():
            chosen = joined(chosen, Rows({name: column[near] for name, column in rows.columns.items()}))
        if rows["t_s"][-1] > lap.end + 1.0:
            break
    return Rows({"t_s": np.empty(0)}) if chosen is None else chosen


def _gate(source: Source, rows: Rows, t: float, name: str) -> Gate:
    north, west, up, vel_north, vel_west = (
        float(np.interp(t, rows["t_s"], rows[column]))
        for column in ("north_m", "west_m", "up_m", "vel_north_mps", "vel_west_mps")
    )
    along = np.array([vel_north, vel_west]) / max(np.hypot(vel_north, vel_west), 1e-6)
    left = HALF_WIDTH * np.array([-along[1], along[0]])
    ends = np.array([[north + left[0], west + left[1], up], [north - left[0], west - left[1], up]])
    lat, lon, _ = nwu_to_geodetic(ends, source.origin)
    return Gate(name, float(lat[0]), float(lon[0]), float(lat[1]), float(lon[1]))
