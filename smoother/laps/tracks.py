"""Track files: timing lines as GeoJSON or as pairs of points, the library of known tracks, and lines as text.

GeoJSON: a feature with a LineString of two points for each line. Its property `line` is "start"
(also "start/finish"), "sector" (in driving order, or numbered: "sector 2") or "finish" where that is separate; without
it the property `name` is used. A property `track` distinguishes several tracks of one file.

Pairs of points: `start_a_lat`, `start_a_lng`, `start_b_lat`, `start_b_lng`, then likewise `sector_2_..` for the line at
which sector 2 begins and so on, `finish_..`, and `lengthFt`; at the top, or one such object per track.
"""

import difflib
import json
import re
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from smoother.arrays import Array
from smoother.documents import load_json
from smoother.errors import ConfigError
from smoother.frames import Origin, geodetic_to_nwu
from smoother.laps.line import meeting_places
from smoother.laps.reference import Curve
from smoother.laps.results import GivenLines
from smoother.units import FOOT

ENDINGS = (".json", ".geojson")
ALIKE = 0.75  # of difflib, 1 for equal: one or two wrong letters
_NUMBER = re.compile(r"\d{1,9}")


@dataclass(frozen=True, eq=False)
class TrackFile:
    """The lines of one track as latitude and longitude. Each line (2, 2) deg; length m, NaN where not stated."""

    name: str
    start: Array
    sectors: tuple[Array, ...] = ()
    finish: Array | None = None
    length: float = float("nan")
    source: str = "given"

    def lines(self, origin: Origin) -> GivenLines:
        """Return the lines in the n of a session."""

        def plan(ends: Array) -> Array:
            return geodetic_to_nwu(ends[:, 0], ends[:, 1], np.full(2, origin.alt_m), origin)[:, :2]

        finish = None if self.finish is None else plan(self.finish)
        return GivenLines(plan(self.start), tuple(plan(s) for s in self.sectors), finish, self.name, self.source)


def library() -> dict[str, TrackFile]:
    """Return the tracks that come with the program, by name."""
    folder = resources.files("smoother.laps") / "library"
    tracks = {}
    for entry in sorted(folder.iterdir(), key=lambda item: item.name):
        if entry.name.endswith(ENDINGS):
            for track in _tracks(entry.name, json.loads(entry.read_text(encoding="utf-8"))):
                tracks[track.name] = TrackFile(
                    track.name, track.start, track.sectors, track.finish, track.length, "library"
                )
    return tracks


def named_tracks(name: str, folder: Path) -> tuple[TrackFile, ...]:
    """Return the tracks that `track` of session.toml names: of a file beside it, or of the library; none if unknown.

    `file.json#name` picks one of several. Raises ConfigError when a named file cannot be used.
    """
    path, _, chosen = name.partition("#")
    if path.strip().lower().endswith(ENDINGS):
        return load_tracks(_inside(folder, path.strip()), chosen.strip())
    known = {key.lower(): track for key, track in library().items()}
    track = known.get(name.strip().lower())
    return () if track is None else (track,)


def nearest_known(name: str) -> str | None:
    """Return the known track with a similar name, None if there is none."""
    near = difflib.get_close_matches(name.strip().lower(), [key.lower() for key in library()], n=1, cutoff=ALIKE)
    return near[0] if near else None


def _inside(folder: Path, name: str) -> Path:
    """The file of that name in `folder` or below: files outside are not opened."""
    path = folder / name
    try:
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):  # a loop of links, an invalid name
        inside = False
    if not inside:
        raise ConfigError(
            f"{folder / 'session.toml'}: [session] track {name!r} lies outside the folder; copy the file into it"
        )
    return path


def load_tracks(path: Path, chosen: str = "") -> tuple[TrackFile, ...]:
    """Read a track file; `chosen` names one of several. Raises ConfigError naming file and remedy."""
    tracks = _tracks(path.name, load_json(path))
    if not chosen:
        return tracks
    for track in tracks:
        if track.name.lower() == chosen.lower():
            return (track,)
    raise ConfigError(
        f"{path}: holds no track {chosen!r}; there are {', '.join(t.name or 'one without a name' for t in tracks)}"
    )


def line_from_text(text: str) -> TrackFile:
    """Return the line of a text "lat,lon;lat,lon". Raises ConfigError."""
    points = [part for part in text.split(";") if part.strip()]
    try:
        values = [[float(number) for number in point.split(",")] for point in points]
    except ValueError as error:
        raise ConfigError(f'line {text!r}: write it as "lat,lon;lat,lon" in degrees') from error
    if len(values) != 2 or any(len(value) != 2 for value in values):
        raise ConfigError(f'line {text!r}: write two points as "lat,lon;lat,lon" in degrees')
    return TrackFile("", _line(values[0], values[1], f"line {text!r}"))


def layout_on(tracks: tuple[TrackFile, ...], origin: Origin, curve: Curve | None) -> GivenLines | None:
    """Return the lines of the matching track: passed, and of its stated length."""
    if not tracks or curve is None or len(tracks) == 1:
        return tracks[0].lines(origin) if tracks else None

    def misfit(track: TrackFile) -> float:
        lines = track.lines(origin)
        missed = sum(meeting_places(curve, ends).size == 0 for ends in (lines.start, *lines.sectors))
        wrong = abs(track.length / curve.length - 1.0) if np.isfinite(track.length) else 0.0
        return 10.0 * missed + wrong

    return min(tracks, key=misfit).lines(origin)


def _tracks(name: str, document: Any) -> tuple[TrackFile, ...]:
    if not isinstance(document, dict):
        raise ConfigError(
            f"{name}: no track file; wanted GeoJSON, or start_a_lat, start_a_lng, start_b_lat, start_b_lng"
        )
    if document.get("type") in ("FeatureCollection", "Feature"):
        return _from_geojson(name, document)
    if "start_a_lat" in document:
        return (_from_pairs(name, "", document),)
    tracks = [_from_pairs(name, str(k), v) for k, v in document.items() if isinstance(v, dict) and "start_a_lat" in v]
    if not tracks:
        raise ConfigError(
            f"{name}: no start line; wanted GeoJSON, or start_a_lat, start_a_lng, start_b_lat, start_b_lng"
        )
    return tuple(tracks)


def _from_pairs(file: str, name: str, values: dict[str, Any]) -> TrackFile:
    prefixes = sorted(
        {match.group(0)[:-6] for key in values if (match := re.fullmatch(r"sector_\d{1,9}_a_lat", key))},
        key=lambda prefix: int(prefix.split("_")[1]),
    )
    length = values.get("lengthFt")
    return TrackFile(
        name=name,
        start=_pair(file, values, "start"),
        sectors=tuple(_pair(file, values, prefix) for prefix in prefixes),
        finish=_pair(file, values, "finish") if "finish_a_lat" in values else None,
        length=float(length) * FOOT if isinstance(length, int | float) and 0.0 < length < 1e9 else float("nan"),
    )


def _pair(file: str, values: dict[str, Any], prefix: str) -> Array:
    ends = []
    for end in ("a", "b"):
        lat, lon = (
            values.get(f"{prefix}_{end}_lat"),
            values.get(f"{prefix}_{end}_lng", values.get(f"{prefix}_{end}_lon")),
        )
        ends.append([lat, lon])
    return _line(ends[0], ends[1], f"{file}: {prefix}")


def _from_geojson(file: str, document: dict[str, Any]) -> tuple[TrackFile, ...]:
    features = document.get("features", [document]) if document["type"] == "FeatureCollection" else [document]
    by_track: dict[str, list[tuple[str, Array]]] = {}
    for i, feature in enumerate(_list(features)):
        properties, geometry = (
            _mapping(_mapping(feature).get("properties")),
            _mapping(_mapping(feature).get("geometry")),
        )
        points = _list(geometry.get("coordinates"))
        if geometry.get("type") != "LineString" or len(points) != 2:
            continue  # the outline of the track, a paddock: not a timing line
        role = str(properties.get("line") or properties.get("name") or "start").lower()
        ends = _line(_list(points[0])[1::-1], _list(points[1])[1::-1], f"{file}: feature {i + 1}")
        by_track.setdefault(str(properties.get("track") or ""), []).append((role, ends))
    tracks = [_assembled(name, lines) for name, lines in by_track.items()]
    found = tuple(track for track in tracks if track is not None)
    if not found:
        raise ConfigError(f'{file}: no LineString of two points with the property "line": "start"')
    return found


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _assembled(name: str, lines: list[tuple[str, Array]]) -> TrackFile | None:
    starts = [ends for role, ends in lines if "start" in role]
    finishes = [ends for role, ends in lines if "finish" in role and "start" not in role]
    sectors = [(role, ends) for role, ends in lines if "start" not in role and "finish" not in role]
    if not starts and len(finishes) == 1:
        starts, finishes = finishes, []  # a line "finish" alone is the start/finish line
    if not starts:
        return None
    if all(_NUMBER.search(role) for role, _ in sectors):
        sectors.sort(key=lambda item: int(_NUMBER.findall(item[0])[-1]))
    return TrackFile(name, starts[0], tuple(ends for _, ends in sectors), finishes[0] if finishes else None)


def _line(a: Any, b: Any, what: str) -> Array:
    """Two points (lat, lon) in degrees as (2, 2), checked."""
    try:
        ends = np.array([[float(a[0]), float(a[1])], [float(b[0]), float(b[1])]])
    except (TypeError, ValueError, IndexError, KeyError, OverflowError) as error:
        raise ConfigError(f"{what}: wanted two points of latitude and longitude in degrees") from error
    if not np.all(np.isfinite(ends)) or np.any(np.abs(ends[:, 0]) > 90.0) or np.any(np.abs(ends[:, 1]) > 360.0):
        raise ConfigError(f"{what}: latitude or longitude is out of range")
    origin = Origin(float(ends[0, 0]), float(ends[0, 1]), 0.0)
    width = float(np.linalg.norm(geodetic_to_nwu(ends[1:, 0], ends[1:, 1], np.zeros(1), origin)[0, :2]))
    if not 0.5 < width < 500.0:  # m; a longer line has swapped coordinates or a wrong point
        raise ConfigError(f"{what}: the line is {width:.1f} m long; wanted its two ends, beside the track")
    return ends
