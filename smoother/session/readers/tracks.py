"""Tracks in XML with times: GPX, TCX and KML's gx:Track, with whatever their extensions hold, as speed or heart rate.

Parsed as a stream and not with a library for each: those build the whole document in memory, a hundred times the file.
"""

import datetime as dt
import re
import xml.etree.ElementTree as ET
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.readers.columns import recording_of
from smoother.session.readers.foreign import ForeignReading
from smoother.session.readers.sheet import Column, sheet_of
from smoother.session.readers.times import UNIX
from smoother.words import counted

WHAT = "track in XML"
CHUNK_BYTES = 1 << 16
LONGEST_POINT = 1 << 20  # bytes between the ends of two elements; a point has some hundred
LONGEST_SALVAGED = 1 << 14  # bytes of a point in a damaged file
MOST_NAMES = 64  # of values beside the places
POINTS = ("trkpt", "Trackpoint", "Track")  # of GPX and TCX; of KML a whole track
_POINT = re.compile(rb"<(trkpt|Trackpoint)\b[^<>]*(?<!/)>(?:(?!<\1\b).)*?</\1\s*>", re.DOTALL)
_PREFIX = re.compile(r"(</?)[\w.-]+:")  # of a name whose declaration stands elsewhere in the file
UNITS = {  # element, in lower case: what the standards count it in
    **{"lat": "deg", "lon": "deg", "latitudedegrees": "deg", "longitudedegrees": "deg"},
    **{"ele": "m", "altitudemeters": "m", "speed": "m/s", "course": "deg", "bearing": "deg", "distancemeters": "m"},
    **{"atemp": "C", "hr": "bpm", "heartratebpm": "bpm", "cad": "rpm", "cadence": "rpm", "watts": "W"},
}
NAMES = {
    **{"altitudemeters": "altitude", "latitudedegrees": "latitude", "longitudedegrees": "longitude"},
    **{"sat": "satellites", "hr": "heart rate", "heartratebpm": "heart rate", "cad": "cadence", "atemp": "temperature"},
    **{"lat": "latitude", "lon": "longitude", "distancemeters": "distance"},
}


@dataclass
class _Points:
    """Values of points by their names, by the number of the point; and how many had no time."""

    values: dict[str, dict[int, float]] = field(default_factory=lambda: defaultdict(dict))
    length: int = 0
    untimed: int = 0

    def add(self, element: ET.Element) -> None:
        """Take the values of a point, or the points of a KML track."""
        if _local(element) == "track":
            self._add_track(element)
            return
        found = {name: _number(element.get(name)) for name in ("lat", "lon")}
        for child in element.iter():
            name, text = _local(child), child.text or ""
            if name == "time" and "time" not in found:
                found["time"] = _unix(text)
            elif name == "value":
                continue
            elif name == "heartratebpm":
                found.setdefault(name, _number(next((c.text for c in child if _local(c) == "value"), None)))
            elif text.strip():
                found.setdefault(name, _number(text))
        self._take(found)

    def _add_track(self, track: ET.Element) -> None:
        times = [_unix(e.text) for e in track if _local(e) == "when"]
        places = [(e.text or "").split() for e in track if _local(e) == "coord"]
        arrays = [e for e in track.iter() if _local(e) == "simplearraydata"]
        more = {str(e.get("name")).lower(): [_number(c.text) for c in e if _local(c) == "value"] for e in arrays}
        for i, (time, place) in enumerate(zip(times, places, strict=False)):
            cells = dict(zip(("lon", "lat", "ele"), map(_number, place), strict=False))
            self._take({"time": time, **cells, **{name: v[i] for name, v in more.items() if i < len(v)}})

    def _take(self, found: dict[str, float]) -> None:
        if not np.isfinite(found.get("time", np.nan)):
            self.untimed += 1
            return
        for name, value in found.items():
            if np.isfinite(value) and (name in self.values or len(self.values) < MOST_NAMES):
                self.values[name][self.length] = value
        self.length += 1

    def column(self, name: str) -> Array:
        """Values (N,) of a name, NaN where a point does not say."""
        values = np.full(self.length, np.nan)
        cells = self.values.get(name, {})
        values[list(cells)] = list(cells.values())
        return values


def read_track(path: Path) -> ForeignReading:
    """Read the points of a track. Raises SessionError, one line, where it is none or has no times."""
    points, flaw = _Points(), None
    try:
        _stream(path, points)
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter two of unknown encodings
        flaw = f"{path.name}: broken XML ({error})"
    except OSError as error:
        raise SessionError(f"{path.name}: cannot be read ({error.strerror or error})") from error
    if flaw is not None:
        points = max(points, _salvage(path), key=lambda found: found.length)
    if points.length == 0:
        timeless = f"{path.name}: {counted(points.untimed, 'point')} without time, which cannot be smoothed"
        no_points = timeless if points.untimed else f"{path.name}: no track points in it"
        raise SessionError(no_points if flaw is None else f"{flaw}; save it anew")
    said = []
    if flaw is not None:
        said.append(Problem("gps_file_cut", f"{flaw}; the points that are whole are used"))
    if points.untimed:
        text = f"{path.name}: {counted(points.untimed, 'point')} without a time; dropped"
        said.append(Problem("gps_no_time", text, points.untimed))
    names = dict.fromkeys(("time", *points.values))
    columns = [Column(NAMES.get(name, name), points.column(name), UNITS.get(name, "")) for name in names]
    columns[0] = Column("time", columns[0].values, UNIX)
    return recording_of(path.name, [sheet_of(path.name, columns, said)])


def _stream(path: Path, points: _Points) -> None:
    """Pass the file through a parser, keeping no more than one point of it, or one track of KML."""
    parser: ET.XMLPullParser[ET.Element] = ET.XMLPullParser(("start", "end"))
    open_elements: list[ET.Element] = []
    since_end = inside = 0  # bytes; how many of the open elements are points
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            parser.feed(chunk)
            since_end += len(chunk)
            for happened in parser.read_events():
                event, element = happened[0], happened[-1]
                assert isinstance(element, ET.Element)
                is_point = _is_point(element)
                if event == "start":
                    open_elements.append(element)
                    inside += is_point
                    continue
                since_end = 0
                open_elements.pop()
                if is_point:
                    inside -= 1
                    points.add(element)
                if not inside and open_elements:
                    open_elements[-1].remove(element)
            if since_end > LONGEST_POINT:
                raise SessionError(f"{path.name}: {LONGEST_POINT} characters without an element; this is no {WHAT}")
    parser.close()


def _is_point(element: ET.Element) -> bool:
    """Whether an element is a point, or a track of KML's extension; a Track of TCX holds points."""
    space, _, name = element.tag.rpartition("}")
    return name in POINTS and (name != "Track" or "kml" in space.lower())


def _salvage(path: Path) -> _Points:
    """The points of a file that is no XML as a whole: each that is whole in itself, before and after the damage."""
    points, rest = _Points(), b""
    with path.open("rb") as file:
        while chunk := file.read(CHUNK_BYTES):
            block, end = rest + chunk, 0
            for match in _POINT.finditer(block):
                end = match.end()
                try:
                    text = _PREFIX.sub(r"\1", match.group().decode("utf-8", errors="replace"))
                    points.add(ET.fromstring(text))
                except ET.ParseError:
                    continue  # the damage itself
            rest = block[end:][-LONGEST_SALVAGED:]
    return points


def _local(element: ET.Element) -> str:
    return str(element.tag).rpartition("}")[2].lower()


def _number(text: str | None) -> float:
    try:
        value = float(text or "nan")
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def _unix(text: str | None) -> float:
    """Seconds since 1970; a time without zone is UTC, as the standards say."""
    try:
        moment = dt.datetime.fromisoformat((text or "").strip())
    except ValueError:
        return np.nan
    return (moment if moment.tzinfo else moment.replace(tzinfo=dt.UTC)).timestamp()
