"""KML 2.2 for Google Earth: the session as a gx:Track that plays over time, and a line for every lap to switch on.

The schema wants all times before all places before each array of values, so the parts are collected in temporary files.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import IO

import numpy as np

from smoother.export.channels import Channel, known_channels
from smoother.export.gpx import longitude
from smoother.export.rows import Rows
from smoother.export.source import LapRow, Source
from smoother.export.text import PRODUCT, append, iso_times, lap_clock, lines, parts, xml
from smoother.report.files import replacing
from smoother.units import KMH

HEAD = f"""<?xml version="1.0" encoding="UTF-8"?>
<!-- by {PRODUCT} -->
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">
<Document>
"""
STYLES = """<Style id="session"><LineStyle><color>ff2080ff</color><width>3</width></LineStyle></Style>
<Style id="best"><LineStyle><color>ff40c040</color><width>4</width></LineStyle></Style>
<Style id="lap"><LineStyle><color>ffc08040</color><width>2</width></LineStyle></Style>
"""
SPEED = Channel("speed", "speed_mps", "km/h", KMH)


def write(source: Source, path: Path) -> None:
    """Write the session as KML."""
    channels = [SPEED, *known_channels(source)]
    title = xml(source.text("title", source.name))
    laps = [lap for lap in source.laps if lap.is_timed]
    with (
        replacing(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
        parts(2 + len(channels) + 1) as collected,
    ):
        whens, places, *values, lines_of_laps = collected
        _collect(source, channels, laps, (whens, places, values, lines_of_laps))
        file.write(f"{HEAD}<name>{title}</name>\n{STYLES}{_schema(channels)}")
        file.write(f"<Placemark><name>{title}</name><styleUrl>#session</styleUrl>\n<gx:Track>")
        file.write("<altitudeMode>clampToGround</altitudeMode>\n")
        append(file, whens)
        append(file, places)
        file.write('<ExtendedData><SchemaData schemaUrl="#channels">\n')
        for channel, part in zip(channels, values, strict=True):
            file.write(f'<gx:SimpleArrayData name="{channel.name}">\n')
            append(file, part)
            file.write("</gx:SimpleArrayData>\n")
        file.write("</SchemaData></ExtendedData></gx:Track></Placemark>\n")
        file.write("<Folder><name>Laps</name>\n" if laps else "")
        append(file, lines_of_laps)
        file.write("</Folder>\n" if laps else "")
        file.write("</Document>\n</kml>\n")


def _schema(channels: Sequence[Channel]) -> str:
    fields = "".join(
        f'<gx:SimpleArrayField name="{c.name}" type="float"><displayName>{xml(_label(c))}</displayName>'
        "</gx:SimpleArrayField>\n"
        for c in channels
    )
    return f'<Schema id="channels">\n{fields}</Schema>\n'


def _label(channel: Channel) -> str:
    name = channel.name.replace("_", " ")
    return f"{name} ({channel.unit})" if channel.unit else name


def _collect(
    source: Source,
    channels: Sequence[Channel],
    laps: Sequence[LapRow],
    collected: tuple[IO[str], IO[str], Sequence[IO[str]], IO[str]],
) -> None:
    whens, places, values, lines_of_laps = collected
    best = None if source.best is None else source.best.lap
    opened = closed = 0  # laps whose line has begun, has ended
    for rows in source.rows():
        lon = longitude(rows["lon_deg"])
        whens.write(lines("<when>%s</when>\n", [iso_times(rows["unix_s"])]))
        places.write(lines("<gx:coord>%.9f %.9f %.3f</gx:coord>\n", [lon, rows["lat_deg"], rows["alt_m"]]))
        for channel, part in zip(channels, values, strict=True):
            part.write(lines("<gx:value>%.4f</gx:value>\n", [channel.filled(rows)]))
        for i in range(closed, len(laps)):
            if laps[i].start > rows["t_s"][-1]:
                break
            if i >= opened:
                lines_of_laps.write(_lap_head(laps[i], laps[i] == best))
                opened = i + 1
            lines_of_laps.write(_piece(rows, lon, laps[i]))
            if laps[i].end <= rows["t_s"][-1]:
                lines_of_laps.write(LAP_END)
                closed = i + 1
    lines_of_laps.write(LAP_END * (opened - closed))


LAP_END = "</coordinates></LineString></Placemark>\n"


def _lap_head(lap: LapRow, is_best: bool) -> str:
    reason = "" if lap.is_valid else f"<description>does not count: {xml(lap.reason)}</description>"
    return (
        f"<Placemark><name>Lap {lap.number}: {lap_clock(lap.time)}</name><visibility>0</visibility>{reason}"
        f"<styleUrl>#{'best' if is_best else 'lap'}</styleUrl><LineString><tessellate>1</tessellate><coordinates>\n"
    )


def _piece(rows: Rows, lon: np.ndarray, lap: LapRow) -> str:
    inside = (rows["t_s"] >= lap.start) & (rows["t_s"] <= lap.end)
    return lines("%.9f,%.9f,%.3f\n", [lon[inside], rows["lat_deg"][inside], rows["alt_m"][inside]])
