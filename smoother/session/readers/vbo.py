"""VBO, the text format of Racelogic's VBOX, as RaceBox, RaceChrono, Circuit Tools and this program write it.

Latitude and longitude are total minutes, longitude positive to the west; times are UTC of the day. Satellite counts may
carry 64 (brake) and 128 (DGPS). Programs differ in names, units and the order of coordinates in [laptiming].
"""

import datetime as dt
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.frames import velocity_n_from_course
from smoother.samples import IMU_AXES_UNKNOWN, GnssFixes, Problem
from smoother.session.degrees import scale_by_way
from smoother.session.fix_columns import fix_columns
from smoother.session.readers.foreign import (
    ForeignReading,
    date_note,
    fixes_from,
    seconds_since_first,
    speed_unit_note,
    unread_note,
)
from smoother.session.readers.motion import imu_of
from smoother.session.readers.names import SPEED_UNITS
from smoother.session.readers.sheet import Column, Sheet, sheet_of
from smoother.session.readers.times import read_moments, running, time_of_day
from smoother.session.tables import Rows, read_rows
from smoother.session.text import text_head
from smoother.units import DAY
from smoother.words import listed

WHAT = "VBO file ([header], [column names], [data])"
LONGEST_HEAD = 1 << 20  # bytes
NAMES = {  # what is wanted: how programs call it, in lower case
    "sats": ("sats", "satellites", "sat"),
    "time": ("time", "utc time", "utc-time"),
    "lat": ("lat", "latitude"),
    "lon": ("long", "lng", "lon", "longitude"),
    "speed": ("velocity", "velocity kmh", "velocity mph", "velocity knots", "velocity m/s", "speed"),
    "heading": ("heading", "course", "bearing"),
    "height": ("height", "altitude"),
    "climb": (
        *("vert-vel", "vertvel", "vert_vel", "vertical-velocity"),
        *("vertical velocity", "vertical velocity m/s", "vertical velocity kmh"),
    ),
    "accuracy": ("accuracy",),
    "fix": ("fix_type", "fix-type"),
}
IMU_NAMES = (  # three accelerations, three rates of rotation: triples known to be axes of one right-handed sensor
    (
        ("longacc", "latacc", "vertacc"),
        ("x-rotation-gyroscope", "y-rotation-gyroscope", "z-rotation-gyroscope"),
    ),
    (
        ("x_acc-acc", "y_acc-acc", "z_acc-acc"),
        ("x_rate_of_rotation-gyro", "y_rate_of_rotation-gyro", "z_rate_of_rotation-gyro"),
    ),
    (("x_acc", "y_acc", "z_acc"), ("x_rate_of_rotation", "y_rate_of_rotation", "z_rate_of_rotation")),
)
VBOX_NAMES = ("x_accel", "y_accel", "z_accel", "rollrate", "pitchrate", "yawrate")  # axes of which are not known
NEEDED = ("time", "lat", "lon")
SATELLITE_BITS = 64  # and above: brake trigger and DGPS
MOST_NO_TIMES = 0.1  # share; in HHMMSS none is, and of seconds of the day 40 % and more
MINUTES = 1.0 / 60.0  # of a degree
OTHER_FORMS = {  # than minutes, to the west: factors, and text
    (1.0, -1.0): "longitudes count to the east",
    (60.0, -60.0): "positions are in degrees, not minutes, and longitudes count to the east",
    (60.0, 60.0): "positions are in degrees, not minutes",
}
CREATED = re.compile(r"File created on\s+(\d{1,2})/(\d{1,2})/(\d{4})", re.IGNORECASE)
STARTED = re.compile(r"UTC Date Started\s*:\s*(\d{1,2})/(\d{1,2})/(\d{4})(?:\s+(\d{1,2}):(\d{2}))?", re.IGNORECASE)
LINE = re.compile(r"^(start|finish|split)\s+" + r"([-+]?\d+(?:\.\d*)?)[\s,]+" * 3 + r"([-+]?\d+(?:\.\d*)?)(.*)", re.I)


@dataclass(frozen=True)
class TimingLine:
    """A timing line that a file brings along: "start", "finish" or "split", its name, two points (lat, lon) in degrees.

    As written: RaceBox and this program give the ends of the line, RaceChrono a point on the track and one some 30 m
    along it.
    """

    kind: str
    name: str
    first_deg: tuple[float, float]
    second_deg: tuple[float, float]


@dataclass(frozen=True)
class _Head:
    """The sections before the data: lines by section, lower case; "" holds what stands before the first."""

    sections: dict[str, list[str]]

    @property
    def columns(self) -> list[str]:
        """Names of the columns; a repeated one gets a number, so that the first keeps the name."""
        named = " ".join(self.sections.get("column names", [])).split()
        return _unique(named or self.sections.get("header", []))

    def unit_of(self, column: str) -> str:
        """Unit as the [header] adds it to a name that the columns have without, or ""."""
        for line in self.sections.get("header", []):
            name, _, unit = line.lower().rpartition(" ")
            if name and re.sub(r"[\s_-]", "", name) in (column, _WORDS.get(column, column)):
                return unit
        return ""


_WORDS = {"longacc": "longaccel", "latacc": "lataccel", "speed": "velocity", "vertvel": "verticalvelocity"}


def read_vbo(path: Path) -> ForeignReading:
    """Read a VBO file. Raises SessionError, one line, where it is none or nothing in it can be used."""
    lines = _lines_above_data(path)
    head = _Head(_sections(lines))
    names = head.columns
    found = {key: next((name for name in choices if name in names), None) for key, choices in NAMES.items()}
    missing = [key for key in NEEDED if found[key] is None]
    if missing:
        raise SessionError(f"{path.name}: no column for {missing[0]}; has {listed(names)}")
    time = names.index(str(found["time"]))
    rows = read_rows(path, len(lines) + 1, len(names), None, range(len(names)), [time])
    unknown = np.full(rows.columns[time].values.size, np.nan)
    columns = {
        key: rows.columns[names.index(name)].values if name is not None else unknown for key, name in found.items()
    }
    utc = _utc(path.name, columns["time"], rows.columns[time].cells)
    t = seconds_since_first(utc)
    gnss, problems = _fixes(path.name, head, columns, t, utc)
    imu, imu_problems = imu_of(path.name, [(_inertial(path.name, head, names, rows), t)])
    if all(name in names for name in VBOX_NAMES):
        text = f"{path.name}: the inertial channels ({', '.join(VBOX_NAMES)}) are not used: their axes are not known"
        imu_problems = [Problem(IMU_AXES_UNKNOWN, text)]
    used = [name for name in found.values() if name is not None and name != found["time"]]
    unread = [unread_note(path.name, name, rows.columns[names.index(name)].unread) for name in used]
    problems = [*rows.problems, *(note for note in unread if note), *imu_problems, *problems]
    return ForeignReading(gnss, problems, imu)


def _lines_above_data(path: Path) -> list[str]:
    """The lines above [data]. Raises SessionError where there is no such line."""
    lines = text_head(path, LONGEST_HEAD).split("\n")
    place = next((i for i, line in enumerate(lines) if line.strip().lower() == "[data]"), None)
    if place is None:
        if not any(line.strip("\ufeff ") for line in lines):
            raise SessionError(f"{path.name}: the file is empty; expected {WHAT}")
        raise SessionError(f"{path.name}: no rows; not, or not a whole, {WHAT}")
    return [line.strip("\ufeff") for line in lines[:place]]


def _inertial(file: str, head: _Head, names: Sequence[str], rows: Rows) -> Sheet:
    """The columns of the motion sensor, under the names of its axes."""
    triples = max(IMU_NAMES, key=lambda triple: sum(name in names for group in triple for name in group))
    called = zip((name for group in triples for name in group), ("ax", "ay", "az", "gx", "gy", "gz"), strict=True)
    usual = {"a": "g", "g": "deg/s"}
    return sheet_of(
        file,
        [
            Column(axis, rows.columns[names.index(name)].values, head.unit_of(name) or usual[axis[0]])
            for name, axis in called
            if name in names
        ],
    )


def _sections(lines: Iterable[str]) -> dict[str, list[str]]:
    sections: dict[str, list[str]] = {}
    name = ""
    for line in lines:
        text = line.strip()
        if text.startswith("[") and text.endswith("]"):
            name = text[1:-1].strip().lower()
        elif text:
            sections.setdefault(name, []).append(text)
    return sections


def _unique(names: Sequence[str]) -> list[str]:
    lower = [name.lower().replace(",", ";") for name in names]
    return [name if lower.index(name) == i else f"{name} #{i}" for i, name in enumerate(lower)]


def _utc(file: str, clock: Array, cells: pl.Series | None) -> Array:
    """Seconds (N,) since midnight of the first day, NaN where unknown, by numbers HHMMSS.sss or cells HH:MM:SS.

    Raises SessionError where many are neither.
    """
    if cells is not None and cells.str.contains(":", literal=True).any():
        moments = read_moments(cells, "")
        return clock if moments is None else moments.seconds
    of_day = time_of_day(clock)
    none = np.isfinite(clock) & np.isnan(of_day)
    if np.count_nonzero(none) > MOST_NO_TIMES * np.count_nonzero(np.isfinite(clock)):
        share, example = np.count_nonzero(none) / np.count_nonzero(np.isfinite(clock)), float(clock[none][0])
        raise SessionError(f"{file}: {share:.0%} of its times, as {example:.10g}, are no UTC (HHMMSS.sss)")
    return running(of_day)


def _fixes(file: str, head: _Head, columns: dict[str, Array], t: Array, utc: Array) -> tuple[GnssFixes, list[Problem]]:
    satellites = columns["sats"] % SATELLITE_BITS
    counts = np.isfinite(satellites) & (satellites > 0)
    fix = columns["fix"]
    if counts.any():  # some programs write 0 throughout
        fix = np.where(satellites == 0, 0.0, fix)
    unit = head.unit_of("velocity")
    speed = columns["speed"] * SPEED_UNITS.get(unit, SPEED_UNITS["km/h"])
    unit_problems = speed_unit_note(file, unit, "km/h") if np.isfinite(speed).any() else []
    velocity_n = velocity_n_from_course(speed, columns["heading"])  # components, so that the climb counts too
    midnight, date_problems = _midnight(file, head, utc)
    lat_deg, lon_deg, form_problems = _degrees(file, columns, t, speed)
    gnss, problems = fixes_from(
        file,
        t,
        lat_deg,
        lon_deg,
        alt_m=columns["height"],
        speed=speed,
        course_deg=columns["heading"],
        velocity_north=velocity_n[:, 0],
        velocity_east=-velocity_n[:, 1],
        velocity_up=columns["climb"] * SPEED_UNITS.get(head.unit_of("vertvel"), 1.0),
        sigma_horizontal=columns["accuracy"],
        num_sv=np.where(counts, satellites, np.nan),
        fix=fix,
        unix_s=utc + midnight,
    )
    return gnss, [*date_problems, *unit_problems, *form_problems, *problems]


def _degrees(file: str, columns: dict[str, Array], t: Array, speed: Array) -> tuple[Array, Array, list[Problem]]:
    """Latitude and longitude in degrees, to the east, in whichever of the forms of programs the velocities fit."""
    lat_deg, lon_deg = columns["lat"] * MINUTES, -columns["lon"] * MINUTES
    read = fix_columns(t, lat_deg, lon_deg, speed=speed, course_deg=columns["heading"])
    scale = scale_by_way(read, tuple(OTHER_FORMS))
    if scale is None:
        return lat_deg, lon_deg, []
    text = f"{file}: by its speeds and courses, {OTHER_FORMS[scale]}; read so"
    return scale[0] * lat_deg, scale[1] * lon_deg, [Problem("gps_position_form", text)]


def _midnight(file: str, head: _Head, utc: Array) -> tuple[float, list[Problem]]:
    """Unix time that `utc` counts from, NaN without a date; the stated start may be just across midnight."""
    everything = "\n".join(line for lines in head.sections.values() for line in lines)
    if match := STARTED.search(everything):
        midnight = _day(match)
        if match[4] is not None and np.isfinite(utc).any():
            stated = int(match[4]) * 3600.0 + int(match[5]) * 60.0
            midnight += DAY * round((stated - float(utc[np.isfinite(utc)][0])) / DAY)
        return midnight, []
    if match := CREATED.search(everything):
        return _day(match), [date_note(file, "the date is that of the file, the only one in it")]
    return float("nan"), [date_note(file, "no date in it")]


def _day(match: re.Match[str]) -> float:
    try:
        day = dt.date(int(match[3]), int(match[2]), int(match[1]))
    except ValueError:
        return float("nan")
    return (day - dt.date(1970, 1, 1)).days * DAY


def own_lines(path: Path) -> tuple[tuple[TimingLine, TimingLine], ...]:
    """Return the lines of [laptiming] without reading the data: each with longitude first, and with latitude first."""
    found = [match for text in _sections(_lines_above_data(path)).get("laptiming", []) if (match := LINE.match(text))]
    return tuple((_line_of(match, True), _line_of(match, False)) for match in found)


def _line_of(match: re.Match[str], is_longitude_first: bool) -> TimingLine:
    a, b, c, d = (float(match[i]) * MINUTES for i in range(2, 6))
    first, second = ((b, -a), (d, -c)) if is_longitude_first else ((a, -b), (c, -d))
    return TimingLine(match[1].lower(), match[6].strip(" \t¬Â\ufffd"), first, second)
