"""GPX 1.1, for maps and video programs: one track of the session, a waypoint at every crossing of the line.

Speed and course stand in Garmin's TrackPointExtension v2, sigmas and accelerations beside it in a namespace of our own.
"""

from pathlib import Path
from typing import IO

import numpy as np

from smoother.export.channels import known_channels
from smoother.export.rows import Rows
from smoother.export.source import LapRow, Source
from smoother.export.text import PRODUCT, iso_times, lap_clock, lines, xml
from smoother.report.files import replacing

NAMESPACE = "urn:kart-smoother:gpx:1"
GARMIN = "http://www.garmin.com/xmlschemas/TrackPointExtension/v2"
HEAD = f"""<?xml version="1.0" encoding="UTF-8"?>
<gpx version="1.1" creator="{PRODUCT}" xmlns="http://www.topografix.com/GPX/1/1" xmlns:gpxtpx="{GARMIN}"
 xmlns:ks="{NAMESPACE}" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
 xsi:schemaLocation="http://www.topografix.com/GPX/1/1 http://www.topografix.com/GPX/1/1/gpx.xsd">
"""
POINT = (
    '<trkpt lat="%.9f" lon="%.9f"><ele>%.3f</ele><time>%s</time><extensions><gpxtpx:TrackPointExtension>'
    "<gpxtpx:speed>%.4f</gpxtpx:speed><gpxtpx:course>%.3f</gpxtpx:course></gpxtpx:TrackPointExtension>"
)


def write(source: Source, path: Path) -> None:
    """Write the session as GPX."""
    channels = known_channels(source)
    custom = "".join(f"<ks:{channel.name}>%.4f</ks:{channel.name}>" for channel in channels)
    template = f"{POINT}{custom}</extensions></trkpt>\n"
    title = xml(source.text("title", source.name))
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        start = iso_times(np.array([source.clock.at(source.start)]))[0]
        file.write(f"{HEAD}<metadata><name>{title}</name><time>{start}</time></metadata>\n")
        _write_crossings(file, source)
        file.write(f"<trk><name>{title}</name><trkseg>\n")
        for rows in source.rows():
            file.write(lines(template, [*_point(rows), *(channel.filled(rows) for channel in channels)]))
        file.write("</trkseg></trk>\n</gpx>\n")


def _point(rows: Rows) -> list[np.ndarray | list[str]]:
    return [
        rows["lat_deg"],
        longitude(rows["lon_deg"]),
        rows["alt_m"],
        iso_times(rows["unix_s"]),
        rows["speed_mps"],
        np.round(rows["course_deg"], 3) % 360.0,
    ]


def longitude(lon_deg: np.ndarray) -> np.ndarray:
    """Longitude in [-180, 180): GPX has no +180."""
    rounded = np.round(lon_deg, 9)
    return np.where(rounded >= 180.0, rounded - 360.0, rounded)


def _write_crossings(file: IO[str], source: Source) -> None:
    """A waypoint where each timed lap ends, named with its time."""
    waiting = [lap for lap in source.laps if lap.is_timed]
    if not waiting:
        return
    for rows in source.rows():
        while waiting and waiting[0].end <= rows["t_s"][-1]:
            file.write(_waypoint(rows, waiting.pop(0)))


def _waypoint(rows: Rows, lap: LapRow) -> str:
    i = min(int(np.searchsorted(rows["t_s"], lap.end)), len(rows) - 1)
    time = iso_times(rows["unix_s"][i : i + 1] + lap.end - rows["t_s"][i])[0]
    lat, lon = rows["lat_deg"][i], longitude(rows["lon_deg"])[i]
    note = "" if lap.is_valid else f"<cmt>does not count: {xml(lap.reason)}</cmt>"
    name = f"Lap {lap.number}: {lap_clock(lap.time)}"
    return f'<wpt lat="{lat:.9f}" lon="{lon:.9f}"><time>{time}</time><name>{name}</name>{note}</wpt>\n'
