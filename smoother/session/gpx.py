"""GPX with times: a session of fixes alone. Speed and course are taken from whatever extension has them.

Parsed as a stream and not with a GPX library: those build the whole document in memory, a hundred times the file.
"""

import datetime as dt
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.foreign import ForeignReading, fixes_from, seconds_since_first
from smoother.words import counted

WHAT = "GPX file"
CHUNK_BYTES = 1 << 16
LONGEST_POINT = 1 << 20  # bytes between the ends of two elements; a point has some hundred
LONGEST_SALVAGED = 1 << 14  # bytes of a point in a damaged file
_POINT = re.compile(rb"<trkpt\b[^<>]*(?<!/)>(?:(?!<trkpt\b).)*?</trkpt\s*>", re.DOTALL)
_PREFIX = re.compile(r"(</?)[\w.-]+:")  # of a name whose declaration stands elsewhere in the file
VALUES = {  # element, wherever in the point it stands: column
    "ele": "alt_m",
    "sat": "num_sv",
    "hdop": "hdop",
    "speed": "speed",
    "course": "course_deg",
    "bearing": "course_deg",
}


@dataclass
class _Points:
    """Columns as they grow, one value per point; NaN where a point does not say."""

    columns: dict[str, list[float]] = field(
        default_factory=lambda: {name: [] for name in ("unix_s", "lat_deg", "lon_deg", *dict.fromkeys(VALUES.values()))}
    )
    untimed: int = 0

    def add(self, point: ET.Element) -> None:
        values = {"lat_deg": _number(point.get("lat")), "lon_deg": _number(point.get("lon"))}
        for element in point.iter():
            name = element.tag.rpartition("}")[2].lower()
            if name == "time" and "unix_s" not in values:
                values["unix_s"] = _unix(element.text)
            elif name in VALUES:
                values.setdefault(VALUES[name], _number(element.text))
        if not np.isfinite(values.get("unix_s", np.nan)):
            self.untimed += 1
            return
        for name, column in self.columns.items():
            column.append(values.get(name, np.nan))


def read_gpx(path: Path) -> ForeignReading:
    """Read the track points of a GPX file. Raises SessionError, one line, where it is none or has no times."""
    points, flaw = _Points(), None
    try:
        _stream(path, points)
    except (ET.ParseError, LookupError, ValueError) as error:  # the latter two of encodings that nobody knows
        flaw = f"{path.name}: broken XML ({error})"
    except OSError as error:
        raise SessionError(f"{path.name}: cannot be read ({error.strerror or error})") from error
    if flaw is not None:
        points = max(points, _salvage(path), key=lambda found: len(found.columns["unix_s"]))
    columns = {name: np.array(values, dtype=np.float64) for name, values in points.columns.items()}
    unix = columns["unix_s"]
    if unix.size == 0:
        timeless = f"{path.name}: {counted(points.untimed, 'point')} without time, which cannot be smoothed"
        no_points = timeless if points.untimed else f"{path.name}: no track points in it"
        raise SessionError(no_points if flaw is None else f"{flaw}; save it anew")
    t = seconds_since_first(unix)
    gnss, problems = fixes_from(path.name, t, has_rows_between=False, is_alone=True, **columns)
    if points.untimed:
        text = f"{path.name}: {counted(points.untimed, 'point')} without a time; dropped"
        problems = [Problem("gps_no_time", text, points.untimed), *problems]
    if flaw is not None:
        problems = [Problem("gps_file_cut", f"{flaw}; the points that are whole are used"), *problems]
    return ForeignReading(gnss, problems)


def _stream(path: Path, points: _Points) -> None:
    """Pass the file through a parser, keeping no more than one point of it."""
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
                is_point = element.tag.rpartition("}")[2] == "trkpt"
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


def _number(text: str | None) -> float:
    try:
        value = float(text or "nan")
    except ValueError:
        return np.nan
    return value if np.isfinite(value) else np.nan


def _unix(text: str | None) -> float:
    """Seconds since 1970; a time without zone is UTC, as the standard says."""
    try:
        moment = dt.datetime.fromisoformat((text or "").strip())
    except ValueError:
        return np.nan
    return (moment if moment.tzinfo else moment.replace(tzinfo=dt.UTC)).timestamp()
