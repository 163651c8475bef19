"""RaceChrono CSV version 3, for RaceChrono's own users and every script and overlay program that reads it.

Lateral acceleration is positive to the left. lap_number is blank outside timed laps; what is unknown is blank.
"""

from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.export.channels import MOTION, SIGMAS, STANDARD, Channel, lap_channels, logged_channels
from smoother.export.rows import Rows
from smoother.export.source import Source
from smoother.export.text import PRODUCT, cells, date_and_time, lines, quoted
from smoother.report.files import replacing

FIXED = (  # name, unit
    ("timestamp", "unix time"),
    ("fragment_id", ""),
    ("lap_number", ""),
    ("elapsed_time", "s"),
    ("distance_traveled", "m"),
    ("accuracy", "m"),
    ("altitude", "m"),
    ("bearing", "deg"),
    ("fix_type", ""),
    ("latitude", "deg"),
    ("longitude", "deg"),
    ("speed", "m/s"),
)
THREE_DIMENSIONAL = 3
SOURCE = "calc"
UNITS = {"g": "G"}


def write(source: Source, path: Path) -> None:
    """Write the session as RaceChrono CSV v3."""
    channels = _channels(source)
    names = [*FIXED, *((channel.name, UNITS.get(channel.unit, channel.unit)) for channel in channels)]
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.write("\n".join(_preamble(source)) + "\n\n")
        file.write(",".join(name for name, _ in names) + "\n" + ",".join(unit for _, unit in names) + "\n")
        file.write(",".join([""] * 3 + [SOURCE] * (len(names) - 3)) + "\n")
        template = ",".join(["%s"] * len(names)) + "\n"
        for rows in source.rows():
            file.write(lines(template, [*_fixed(rows), *(cells(channel.of(rows), "%.4f") for channel in channels)]))


def _channels(source: Source) -> list[Channel]:
    laps = [channel for channel in lap_channels(source) if channel.name != "lap"]
    renamed = {"yaw_rate": "z_rate_of_rotation"}  # the kart's own axes: z is up
    motion = [Channel(renamed.get(c.name, c.name), c.column, c.unit, c.factor) for c in MOTION]
    logged = logged_channels(source)
    names = [STANDARD.get(channel.name, {}).get("racechrono", channel.name) for channel in logged]
    more = [Channel(name, c.column, c.unit) for name, c in zip(names, logged, strict=True)]
    return [*motion, *laps, *SIGMAS, *more]


def _preamble(source: Source) -> list[str]:
    date, time = date_and_time(source)
    clock = "" if source.has_utc else " The time of day is unknown: timestamps count from the start."
    note = f"{source.text('notes')} Columns sigma_ are one standard deviation.{clock}".strip()
    return [
        f"This file is created using {PRODUCT}",
        "Format,3",
        f"Session title,{quoted(source.text('title', source.name))}",
        "Session type,Lap timing",
        f"Track name,{quoted(source.text('track'))}",
        f"Driver name,{quoted(source.text('driver'))}",
        f"Created,{date},{time[:5]}",
        f"Note,{quoted(note)}",
    ]


def _fixed(rows: Rows) -> list[Array | list[str]]:
    accuracy = np.hypot(rows["sigma_north_m"], rows["sigma_west_m"])
    constant = [str(THREE_DIMENSIONAL)] * len(rows)
    return [
        cells(rows["unix_s"], "%.3f"),
        ["0"] * len(rows),
        cells(rows["lap"], "%.0f"),
        cells(rows["elapsed_s"], "%.3f"),
        cells(rows["distance_m"], "%.3f"),
        cells(accuracy, "%.3f"),
        cells(rows["alt_m"], "%.3f"),
        cells(np.round(rows["course_deg"], 3) % 360.0, "%.3f"),
        constant,
        cells(rows["lat_deg"], "%.9f"),
        cells(rows["lon_deg"], "%.9f"),
        cells(rows["speed_mps"], "%.4f"),
    ]
