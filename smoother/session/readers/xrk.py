"""AiM's binary logs, .xrk, .xrz and .drk, through libxrk: every channel at its own rate, laps by the beacon.

Its accelerometer counts z downwards and its gyroscope upwards, as gravity shows; a box that lies on its head is the
same. The library gives of the receiver's velocity its size and the rate at which it turns; summed up, that is the
course. Runs in a child process.
"""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array, BoolArray
from smoother.errors import SessionError
from smoother.session.readers.sheet import Column, Sheet, sheet_of
from smoother.units import DEG

MOST_CHANNELS = 200
LAP = "lap"  # sheet of times of laps
PLACE, SPEED, TURNING = ("GPS Latitude", "GPS Longitude"), "GPS Speed", "GPS_Yaw_Rate"  # channels
LATENCIES = np.linspace(-0.3, 0.3, 31)  # s, of positions behind velocities; a receiver filters one more than the other


def sheets(paths: Sequence[Path]) -> list[Sheet]:
    """The channels of a log that share their times, as sheets; and one of its laps. Raises SessionError without any."""
    import libxrk

    log = libxrk.aim_xrk(str(paths[0]))
    groups: dict[bytes, list[Column]] = {}
    for name, table in list(log.channels.items())[:MOST_CHANNELS]:
        t = np.asarray(table.column("timecodes"), dtype=np.float64)
        values = np.asarray(table.column(name), dtype=np.float64)
        unit = (table.schema.field(name).metadata or {}).get(b"units", b"").decode(errors="replace")
        if t.size:
            columns = groups.setdefault(t.tobytes(), [Column("time", t, "ms")])
            columns.append(Column(name, values, unit))
    if not groups:
        raise SessionError("no channels in it; was the recording started?")
    groups = {key: _with_course(columns) for key, columns in groups.items()}
    about = {key.lower(): str(log.metadata.get(key) or "").strip() for key in ("Log Date", "Log Time")}
    about["z of forces"] = "down"
    found = [sheet_of("", columns, about=about) for columns in groups.values()]
    whole = np.array([kind == "full" for kind in log.laps.column("lap_type").to_pylist()], dtype=np.bool_)
    laps = {key: np.asarray(log.laps.column(key), dtype=np.float64)[whole] for key in ("start_time", "end_time")}
    if laps["start_time"].size:
        found.append(sheet_of("", [Column(key, 1e-3 * values, "s") for key, values in laps.items()], sensor=LAP))
    return found


def _with_course(columns: list[Column]) -> list[Column]:
    """The channels of the receiver with the course, and without the time of a row that is out of order; others as
    they are.
    """
    channels = {column.name: column.values for column in columns}
    if not {*PLACE, SPEED, TURNING} <= set(channels):
        return columns
    time, *others = columns
    t = 1e-3 * time.values
    wrong = np.zeros(t.size, dtype=np.bool_)
    wrong[1:-1] = (t[1:-1] < t[:-2]) & (t[2:] > t[:-2])  # sorted, such a fix would be the first of the recording
    north, east = channels[PLACE[0]], channels[PLACE[1]] * np.cos(np.nanmedian(channels[PLACE[0]]) * DEG)
    course = _course(t, channels[SPEED], channels[TURNING], north + 1j * east, ~wrong)
    return [replace(time, values=np.where(wrong, np.nan, time.values)), *others, Column("course", course, "deg")]


def _course(t: Array, speed: Array, turning: Array, position: npt.NDArray[np.complex128], is_right: BoolArray) -> Array:
    """Course (N,) deg from the rate (N,) deg/s at which it changes, by the steps of t (N,) s, and speed (N,) m/s.

    The rate of a step back in time is lost: what is behind it is a part of its own. How far each part is turned shows
    the direction (complex, north and east) in which positions (N,) move, at whichever latency agrees best.
    """
    steps = np.diff(t, prepend=t[:1])
    turned = np.cumsum(np.where(steps > 0.0, turning * steps, 0.0))
    course = np.full(t.size, np.nan)
    for part in np.split(np.arange(t.size), np.flatnonzero(steps < 0.0)):
        rows = part[is_right[part]]
        if rows.size < 2 or np.any(np.diff(t[rows]) <= 0.0):
            continue
        moved = np.gradient(position[rows], t[rows])
        velocity = speed[rows] * np.exp(1j * turned[rows] * DEG)
        sums = [np.sum(np.conj(velocity) * np.interp(t[rows] + late, t[rows], moved)) for late in LATENCIES]
        course[rows] = (turned[rows] + np.angle(max(sums, key=abs)) / DEG) % 360.0
    return course
