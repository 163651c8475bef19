"""The formats by name: who opens each, how its files end, what writes it."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from smoother.export import aim, geojson, gpx, kml, motec, racechrono, tum, vbo
from smoother.export.source import Source


@dataclass(frozen=True)
class ExportFormat:
    """One format: its name on the command line, the ending of its file, what it is and who opens it."""

    name: str
    ending: str
    text: str
    write: Callable[[Source, Path], None]


FORMATS: tuple[ExportFormat, ...] = (
    ExportFormat(
        "vbo",
        ".vbo",
        "Racelogic VBOX: Circuit Tools, Harry's LapTimer, and video overlays such as RaceRender and Telemetry Overlay",
        vbo.write,
    ),
    ExportFormat(
        "racechrono",
        ".racechrono.csv",
        "RaceChrono CSV version 3: RaceRender, Telemetry Overlay, spreadsheets and scripts",
        racechrono.write,
    ),
    ExportFormat("motec", ".ld", "MoTeC i2 Standard and Pro; the laps are in the .ldx beside it", motec.write),
    ExportFormat("aim", ".aim.csv", "AiM CSV: Race Studio's own form, and programs that read it", aim.write),
    ExportFormat("gpx", ".gpx", "GPX 1.1: maps, GoPro and Garmin video programs, almost everything", gpx.write),
    ExportFormat("kml", ".kml", "Google Earth: plays over time, laps to switch on (try --rate 10)", kml.write),
    ExportFormat("geojson", ".geojson", "a feature per lap: QGIS, geojson.io, web maps, scripts", geojson.write),
    ExportFormat("tum", ".tum", "trajectory in metres with quaternions: evo and other robotics tools", tum.write),
)
BY_NAME = {form.name: form for form in FORMATS}
