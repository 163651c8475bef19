"""GeoJSON (RFC 7946) for maps and scripts: one feature per lap, and one for what was driven outside laps.

`coordinateProperties` holds an array per channel, one value for every coordinate, `times` among them. A lap that
crosses 180 degrees of longitude is cut there into a MultiLineString, as the RFC asks, and its arrays with it.
"""

import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import IO

import numpy as np

from smoother.export.channels import Channel, known_channels
from smoother.export.gpx import longitude
from smoother.export.rows import Rows
from smoother.export.source import LapRow, Source
from smoother.export.text import append, iso_times, lines, parts
from smoother.report.files import replacing
from smoother.units import KMH

SPEED = Channel("speed", "speed_mps", "km/h", KMH)


def write(source: Source, path: Path) -> None:
    """Write the session as GeoJSON."""
    channels = [SPEED, *(channel for channel in known_channels(source) if channel.column != "lap")]
    with (
        replacing(path) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
        parts(2 + len(channels)) as collected,
    ):
        file.write('{"type": "FeatureCollection", "features": [\n')
        writer = _Features(file, source, channels, collected)
        for rows in source.rows():
            writer.add(rows)
        writer.close()
        file.write("\n]}\n")


class _Features:
    """Writes features one after another; the arrays of the one at hand wait in temporary files."""

    def __init__(self, file: IO[str], source: Source, channels: Sequence[Channel], collected: list[IO[str]]) -> None:
        self._file, self._source, self._channels = file, source, channels
        self._places, self._times, *self._values = collected
        self._laps = {lap.number: lap for lap in source.laps if lap.is_timed}
        self._lap: float | None = None  # number of the lap at hand, NaN outside laps, None before the first row
        self._count = 0  # rows in the line at hand
        self._cuts = 0
        self._lon = np.nan
        self._features = 0
        self._last: tuple[Rows, np.ndarray] | None = None

    def add(self, rows: Rows) -> None:
        """Add a block, which may hold the end of one lap and the start of others."""
        lap, lon = np.where(np.isfinite(rows["lap"]), rows["lap"], -1.0), longitude(rows["lon_deg"])
        before = np.concatenate([[self._lon], lon[:-1]])
        new_lap = np.diff(lap, prepend=-2.0 if self._lap is None else self._lap) != 0.0
        new_line = np.abs(lon - before) > 180.0  # deg; a step of longitude beyond is a crossing of the date line
        starts = np.flatnonzero(new_lap | new_line)
        bounds = np.unique(np.concatenate([[0], starts, [len(rows)]]))
        for first, end in pairwise(bounds.tolist()):
            if new_lap[first]:
                self.close()
                self._lap = float(lap[first])
            elif new_line[first]:
                self._cut()
            self._write(rows.part(slice(first, end)), lon[first:end])
        self._lon = float(lon[-1])

    def _cut(self) -> None:
        self._complete()
        self._cuts += 1
        self._count = 0
        for part in (self._places, self._times, *self._values):
            part.write("], [")

    def _complete(self) -> None:
        """A line has two points at least: a single row stands twice."""
        if self._count == 1 and self._last is not None:
            self._write(*self._last)

    def _write(self, rows: Rows, lon: np.ndarray) -> None:
        separated = "" if self._count == 0 else ", "
        self._count += len(rows)
        self._last = (rows.part(slice(-1, None)), lon[-1:])
        points = [lon, rows["lat_deg"], rows["alt_m"]]
        self._places.write(separated + lines(", [%.9f, %.9f, %.3f]", points)[2:])
        self._times.write(separated + lines(', "%s"', [iso_times(rows["unix_s"])])[2:])
        for channel, part in zip(self._channels, self._values, strict=True):
            part.write(separated + lines(", %.4f", [channel.filled(rows)])[2:])

    def close(self) -> None:
        """Write the feature at hand, if there is one."""
        if self._lap is None:
            return
        self._complete()
        is_cut = self._cuts > 0
        left, right = ("[[", "]]") if is_cut else ("[", "]")
        kind = "MultiLineString" if is_cut else "LineString"
        self._file.write(",\n" if self._features else "")
        self._file.write(f'{{"type": "Feature", "geometry": {{"type": "{kind}", "coordinates": {left}')
        append(self._file, self._places)
        self._file.write(
            f'{right}}}, "properties": {self._properties()[:-1]}, "coordinateProperties": {{"times": {left}'
        )
        append(self._file, self._times)
        for channel, part in zip(self._channels, self._values, strict=True):
            self._file.write(f'{right}, "{_key(channel)}": {left}')
            append(self._file, part)
        self._file.write(f"{right}}}}}}}")
        self._features += 1
        self._count = self._cuts = 0

    def _properties(self) -> str:
        texts = {key: self._source.text(key) for key in ("title", "driver", "kart", "track") if self._source.text(key)}
        lap = self._laps.get(int(self._lap if self._lap is not None else -1))
        about: dict[str, object] = {"session": self._source.name, **texts, "lap": None if lap is None else lap.number}
        return json.dumps({**about, **({} if lap is None else _about(lap))}, ensure_ascii=False)


def _about(lap: LapRow) -> dict[str, object]:
    return {
        "lap_time_s": lap.time,
        "lap_time_sigma_s": lap.sigma if np.isfinite(lap.sigma) else None,
        "valid": lap.is_valid,
        "reason": lap.reason,
        "sectors_s": [time if np.isfinite(time) else None for time in lap.sectors],
    }


def _key(channel: Channel) -> str:
    unit = channel.unit.replace("km/h", "kmh").replace("deg/s", "dps")
    return f"{channel.name}_{unit}" if unit else channel.name
