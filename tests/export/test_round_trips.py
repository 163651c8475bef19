"""Every format is read back by a reader that others wrote, wherever there is one, over random sessions.

Independent readers: gpxpy (GPX), fastkml with its schemas (KML), evo (TUM), pygeoif (GeoJSON), pandas (the tables of
VBO, RaceChrono and AiM), and for MoTeC a walk along the pointers of the documented layout.
"""

import json
import math
import struct
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import fastkml
import gpxpy
import numpy as np
import pandas as pd
import polars as pl
import pygeoif
import pytest
from evo.tools import file_interface
from fastkml import gx, validator
from fastkml.utils import find_all
from hypothesis import Phase, given, settings
from hypothesis import strategies as st

from smoother.export.formats import BY_NAME
from smoother.export.source import open_source
from smoother.frames import rotation_from_euler
from smoother.session.readers.sets import read_tables as read_aim
from smoother.session.readers.sets import read_tables as read_racechrono
from smoother.session.readers.tracks import read_track as read_gpx
from smoother.session.readers.vbo import own_lines, read_vbo
from smoother.units import DEG, KMH, STANDARD_GRAVITY

Factory = Callable[[Any, Path], Path]
MIDNIGHT = 1_775_952_000.0  # the start of a day
EXAMPLES = settings(
    max_examples=20, deadline=None, phases=[Phase.explicit, Phase.generate]
)  # minimal cases cost minutes


def choices() -> st.SearchStrategy[dict[str, Any]]:
    """Both hemispheres, the date line, midnight, negative heights, names of any letters; without UTC or IMU or laps."""
    return st.fixed_dictionaries(
        {
            "lat_deg": st.floats(-80.0, 80.0).filter(lambda lat: abs(lat) > 1e-6),  # (0, 0) is no place for a fix
            "lon_deg": st.floats(-180.0, 179.9) | st.sampled_from([0.0, 179.99999, -179.99999, 180.0]),
            "alt_m": st.floats(-400.0, 4000.0),
            "unix_at_zero": st.floats(0.0, 4.0e9) | st.floats(MIDNIGHT - 5.0, MIDNIGHT) | st.none(),
            "start": st.floats(0.0, 5000.0),
            "rate": st.sampled_from([1.0, 7.5, 10.0, 50.0]),
            "count": st.integers(2, 120),
            "speed": st.floats(3.0, 40.0),
            "radius": st.floats(4.0, 400.0) | st.floats(4.0, 12.0),  # of the small ones laps are timed
            "turns_left": st.booleans(),
            "has_imu": st.booleans(),
            "laps": st.booleans(),
            "title": st.text(max_size=20),
            "driver": st.text(max_size=40),
        }
    ).map(drivable)


def drivable(chosen: dict[str, Any]) -> dict[str, Any]:
    """No faster than tyres hold, and half a radian from fix to fix: readers leave out speeds that positions deny."""
    held = min(math.sqrt(4.0 * STANDARD_GRAVITY * chosen["radius"]), 0.5 * chosen["radius"] * chosen["rate"])
    return {**chosen, "speed": min(chosen["speed"], held)}


class Written:
    """A random session, exported; its rows as trajectory.csv has them."""

    def __init__(self, directory: str, results: Factory, scene: Any, form: str) -> None:
        self.scene = scene
        out = results(scene, Path(directory) / "monday")
        self.source = open_source(out)
        self.path = out / f"monday{BY_NAME[form].ending}"
        BY_NAME[form].write(self.source, self.path)
        self.rows = {
            name: pl.Series(values).cast(pl.Float64).fill_null(np.nan).to_numpy()
            for name, values in pl.read_csv(out / "trajectory.csv", infer_schema_length=None).to_dict().items()
            if name != "utc"
        }

    @property
    def unix(self) -> np.ndarray:
        zero = self.scene.unix_at_zero
        return self.rows["t_s"] + (-self.rows["t_s"][0] if zero is None else zero)

    @property
    def left_g(self) -> np.ndarray:
        sign = 1.0 if self.scene.turns_left else -1.0
        return np.full(len(self.rows["t_s"]), sign * self.scene.speed**2 / self.scene.radius / STANDARD_GRAVITY)


def assert_same_longitude(found: np.ndarray, wanted: np.ndarray, tolerance: float) -> None:
    assert np.max(np.abs((found - wanted + 180.0) % 360.0 - 180.0)) <= tolerance


def assert_same_course(found: np.ndarray, written: Written, tolerance: float) -> None:
    rows = written.rows
    wanted = np.degrees(np.arctan2(-rows["vel_west_mps"], rows["vel_north_mps"]))
    assert np.max(np.abs((found - wanted + 180.0) % 360.0 - 180.0)) <= tolerance


@EXAMPLES
@given(chosen=choices())
def test_gpx_is_read_by_gpxpy(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "gpx")
        document = gpxpy.parse(written.path.read_text(encoding="utf-8"))
        points = [point for track in document.tracks for part in track.segments for point in part.points]
        rows = written.rows
        assert len(points) == len(rows["t_s"])
        assert max(abs(p.latitude - lat) for p, lat in zip(points, rows["lat_deg"], strict=True)) <= 1e-9
        assert_same_longitude(np.array([p.longitude for p in points]), rows["lon_deg"], 1e-8)
        assert all(-180.0 <= p.longitude < 180.0 for p in points)
        np.testing.assert_allclose([p.elevation for p in points], rows["alt_m"], atol=6e-4)
        times = np.array([p.time.timestamp() for p in points])
        np.testing.assert_allclose(times, written.unix, atol=1.1e-3)  # utc in trajectory.csv has milliseconds too
        tags = {element.tag.rpartition("}")[2]: element for element in points[0].extensions}
        speed = tags["TrackPointExtension"][0]
        assert speed.tag == "{http://www.garmin.com/xmlschemas/TrackPointExtension/v2}speed"
        assert float(speed.text) == pytest.approx(rows["speed_mps"][0], abs=1e-4)
        assert float(tags["sigma_track"].text) == pytest.approx(rows["sigma_track_m"][0], abs=1e-4)
        assert len(document.waypoints) == sum(lap.is_timed for lap in written.source.laps)


@EXAMPLES
@given(chosen=choices())
def test_kml_is_valid_and_read_by_fastkml(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "kml")
        assert validator.validate(file_to_validate=written.path)
        document = fastkml.KML.parse(written.path)
        (track,) = find_all(document, of_type=gx.Track)
        rows = written.rows
        places = np.array([item.coord.coords[0] for item in track.track_items])
        assert_same_longitude(places[:, 0], rows["lon_deg"], 1e-8)
        np.testing.assert_allclose(places[:, 1], rows["lat_deg"], atol=1e-9)
        np.testing.assert_allclose(places[:, 2], rows["alt_m"], atol=6e-4)
        times = [item.when.dt.timestamp() for item in track.track_items]
        np.testing.assert_allclose(times, written.unix, atol=1.1e-3)
        (schema_data,) = track.extended_data.elements
        arrays = {array.name: np.array(array.data, dtype=float) for array in schema_data.array_data}
        np.testing.assert_allclose(arrays["speed"], rows["speed_mps"] / KMH, atol=1e-4)
        np.testing.assert_allclose(arrays["sigma_track"], rows["sigma_track_m"], atol=1e-4)


@EXAMPLES
@given(chosen=choices())
def test_tum_is_read_by_evo(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "tum")
        read = file_interface.read_tum_trajectory_file(written.path)
        rows = written.rows
        np.testing.assert_allclose(read.timestamps, rows["t_s"], atol=1e-6)
        position = np.stack([rows["north_m"], rows["west_m"], rows["up_m"]], axis=-1)
        np.testing.assert_allclose(read.positions_xyz, position, atol=1e-4)
        assert read.check()[0]
        if chosen["has_imu"]:
            R_nb = rotation_from_euler(*(rows[f"{name}_deg"] * DEG for name in ("roll", "pitch", "yaw")))
            np.testing.assert_allclose([pose[:3, :3] for pose in read.poses_se3], R_nb, atol=1e-6)


@EXAMPLES
@given(chosen=choices())
def test_geojson_is_read_by_pygeoif(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "geojson")
        document = json.loads(written.path.read_text(encoding="utf-8"))
        places, speeds, laps = [], [], []
        for feature in document["features"]:
            shape, geometry = pygeoif.shape(feature["geometry"]), feature["geometry"]["coordinates"]
            lines = geometry if feature["geometry"]["type"] == "MultiLineString" else [geometry]
            found = [coordinate for line in lines for coordinate in line]
            lats = [coordinate[1] for coordinate in found]
            np.testing.assert_allclose([shape.bounds[1], shape.bounds[3]], [min(lats), max(lats)])
            values = feature["properties"]["coordinateProperties"]["speed_kmh"]
            values = [v for part in values for v in part] if isinstance(values[0], list) else values
            assert len(values) == len(found)
            places, speeds, laps = places + found, speeds + values, [*laps, feature["properties"]["lap"]]
            for line in lines:
                longitudes = np.array([coordinate[0] for coordinate in line])
                assert len(longitudes) >= 2
                assert np.max(np.abs(np.diff(longitudes))) < 180.0  # no line runs round the Earth
        rows = written.rows
        keep = np.insert(np.any(np.diff(places, axis=0) != 0.0, axis=1), 0, True)  # a lone row stands twice
        lat = np.array(places)[keep, 1]
        np.testing.assert_allclose(lat, rows["lat_deg"], atol=1e-9)
        np.testing.assert_allclose(np.array(speeds)[keep], rows["speed_mps"] / KMH, atol=1e-4)
        timed = [lap for lap in written.source.laps if lap.is_timed]  # at 1 Hz a lap may be over between two rows
        inside = {lap.number for lap in timed if any(lap.start <= t < lap.end for t in rows["t_s"])}
        assert [lap for lap in laps if lap is not None] == sorted(inside)


def vbo_sections(path: Path) -> dict[str, list[str]]:
    sections: dict[str, list[str]] = {"": []}
    name = ""
    for line in path.read_bytes().decode("utf-8").split("\r\n"):
        if line.startswith("["):
            name = line
            sections[name] = []
        elif line:
            sections[name].append(line)
    return sections


@EXAMPLES
@given(chosen=choices())
def test_vbo_is_a_table_of_minutes_west_and_comes_back(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "vbo")
        rows, sections = written.rows, vbo_sections(written.path)
        assert list(sections)[1:] == [
            *("[header]", "[channel units]", "[comments]", "[laptiming]", "[column names]", "[data]"),
        ]
        names = sections["[column names]"][0].split()
        assert len(names) == len(sections["[header]"])
        table = pd.DataFrame([line.split(" ") for line in sections["[data]"]], columns=names).astype(float)
        np.testing.assert_allclose(table["lat"] / 60.0, rows["lat_deg"], atol=1e-8)  # 1e-6 minutes
        assert_same_longitude(-table["long"].to_numpy() / 60.0, rows["lon_deg"], 1.1e-8)
        np.testing.assert_allclose(table["velocity"], rows["speed_mps"] / KMH, atol=6e-4)
        np.testing.assert_allclose(table["height"], rows["alt_m"], atol=6e-4)
        assert table["heading"].between(0.0, 359.9995).all()
        assert_same_course(table["heading"].to_numpy(), written, 0.01)
        clock = [datetime.fromtimestamp(round(t, 3), UTC) for t in written.unix]
        seconds = np.array([int(c.strftime("%H%M%S")) + c.microsecond / 1e6 for c in clock])
        np.testing.assert_allclose(table["time"] % 100, seconds % 100, atol=1.6e-3)
        if chosen["has_imu"]:
            np.testing.assert_allclose(table["lateral_acc"], written.left_g, atol=1e-4)
        back = read_vbo(written.path)
        assert_comes_back(back.gnss, written, 1.1e-8)
        if chosen["unix_at_zero"] is not None:
            np.testing.assert_allclose(back.gnss.unix_s, written.unix, atol=1.6e-3)
        timed = any(lap.is_timed for lap in written.source.laps)
        assert len(own_lines(written.path)) == (2 if timed else 0)


def assert_comes_back(gnss: Any, written: Written, degrees: float) -> None:
    """The importer gives the rows, times counted from the first; rows that repeat a position at speed aside."""
    rows = written.rows
    assert len(gnss) == len(rows["t_s"])
    np.testing.assert_allclose(gnss.t - gnss.t[0], rows["t_s"] - rows["t_s"][0], atol=1.6e-3)
    np.testing.assert_allclose(gnss.lat_deg, rows["lat_deg"], atol=degrees)
    assert_same_longitude(gnss.lon_deg, rows["lon_deg"], degrees)
    np.testing.assert_allclose(gnss.alt_m, rows["alt_m"], atol=6e-4)
    np.testing.assert_allclose(gnss.speed, rows["speed_mps"], atol=6e-4)
    np.testing.assert_allclose(gnss.velocity_n[:, 0], rows["vel_north_mps"], atol=0.01)  # course to a thousandth


@EXAMPLES
@given(chosen=choices())
def test_racechrono_is_read_by_pandas_and_comes_back(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "racechrono")
        rows = written.rows
        head = written.path.read_text(encoding="utf-8").split("\n")[:10]
        assert head[1] == "Format,3" and head[8] == ""
        table = pd.read_csv(written.path, skiprows=9)
        assert list(table.columns[:4]) == ["timestamp", "fragment_id", "lap_number", "elapsed_time"]
        numbers = table.iloc[2:].astype(float)
        np.testing.assert_allclose(numbers["latitude"], rows["lat_deg"], atol=1e-9)
        np.testing.assert_allclose(numbers["speed"], rows["speed_mps"], atol=1e-4)
        np.testing.assert_allclose(numbers["timestamp"], written.unix, atol=1.6e-3)
        np.testing.assert_allclose(numbers["accuracy"], np.hypot(1.5, 1.5), atol=6e-4)
        in_lap = [np.isfinite(n) for n in numbers["lap_number"]]
        timed = [lap for lap in written.source.laps if lap.is_timed]
        assert in_lap == [any(lap.start <= t < lap.end for lap in timed) for t in rows["t_s"]]
        if chosen["has_imu"]:
            np.testing.assert_allclose(numbers["lateral_acc"], written.left_g, atol=1e-4)
        assert_comes_back(read_racechrono(written.path).gnss, written, 1e-9)


@EXAMPLES
@given(chosen=choices())
def test_aim_is_read_by_pandas_and_comes_back(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "aim")
        rows = written.rows
        table = pd.read_csv(written.path, skiprows=14, skip_blank_lines=False)
        assert list(table.columns[:3]) == ["Time", "GPS Speed", "GPS Nsat"]
        assert list(table.iloc[0, :2]) == ["s", "km/h"]
        numbers = table.iloc[2:].astype(float)
        np.testing.assert_allclose(numbers["GPS Latitude"], rows["lat_deg"], atol=1e-9)
        np.testing.assert_allclose(numbers["GPS Speed"], rows["speed_mps"] / KMH, atol=1e-4)
        assert numbers["GPS Heading"].between(-180.0, 180.0).all()
        if chosen["has_imu"]:
            np.testing.assert_allclose(numbers["GPS LatAcc"], -written.left_g, atol=1e-4)  # right is positive
        assert_comes_back(read_aim(written.path).gnss, written, 1e-9)


@EXAMPLES
@given(chosen=choices())
def test_gpx_comes_back(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "gpx")
        back = read_gpx(written.path)
        assert_comes_back(back.gnss, written, 1e-8)
        np.testing.assert_allclose(back.gnss.unix_s, written.unix, atol=1.6e-3)


def log_channels(path: Path) -> tuple[dict[str, Any], dict[str, tuple[str, int, np.ndarray]]]:
    """Head and channels of a MoTeC log, found along its pointers."""
    data = path.read_bytes()

    def text(at: int, length: int) -> str:
        return data[at : at + length].split(b"\0")[0].decode("ascii")

    first, samples, event = (struct.unpack_from("<I", data, at)[0] for at in (8, 12, 36))
    venue = struct.unpack_from("<H", data, event + 1152)[0]
    vehicle = struct.unpack_from("<H", data, venue + 1098)[0]
    head = {
        "channels": struct.unpack_from("<I", data, 86)[0],
        "samples": samples,
        "date": text(94, 16),
        "texts": [text(158, 64), text(222, 64), text(350, 64), text(event, 64), text(event + 64, 64)],
        "more": [text(venue, 64), text(vehicle, 64)],
    }
    channels, at, previous = {}, first, 0
    while at:
        before, after, place, count, _, kind, size, rate = struct.unpack_from("<4I4H", data, at)
        shift, factor, scale, decimals = struct.unpack_from("<4h", data, at + 24)
        assert before == previous and size == 4
        raw = np.frombuffer(data, {7: "<f4", 5: "<i4"}[kind], count, place).astype(float)
        channels[text(at + 32, 32)] = (text(at + 72, 12), rate, (raw / scale * 10.0**-decimals + shift) * factor)
        previous, at = at, after
    return head, channels


@EXAMPLES
@given(chosen=choices())
def test_motec_log_holds_every_channel_along_its_pointers(results: Factory, scene: Any, chosen: dict[str, Any]) -> None:
    with tempfile.TemporaryDirectory() as directory:
        written = Written(directory, results, scene(**chosen), "motec")
        rows = written.rows
        head, channels = log_channels(written.path)
        assert head["channels"] == len(channels)
        assert all(head["texts"]) and all(head["more"])  # i2 shows nothing of a file with an empty one
        rate = max(1.0, round(chosen["rate"]))
        unit, hz, lat = channels["GPS Latitude"]
        assert (unit, hz) == ("deg", rate)
        if rate == chosen["rate"]:
            np.testing.assert_allclose(lat, rows["lat_deg"], atol=5.1e-8)
            assert_same_longitude(channels["GPS Longitude"][2], rows["lon_deg"], 5.1e-8)
            np.testing.assert_allclose(channels["Ground Speed"][2], rows["speed_mps"] / KMH, rtol=1e-6, atol=1e-5)
            np.testing.assert_allclose(channels["GPS Altitude"][2], rows["alt_m"], atol=3e-4)
        if chosen["has_imu"]:
            np.testing.assert_allclose(channels["G Force Lat"][2], written.left_g[0], rtol=1e-4, atol=1e-4)
        (markers,) = ElementTree.parse(written.path.with_suffix(".ldx")).iter("MarkerGroup")
        beacons = [float(marker.attrib["Time"]) / 1e6 + rows["t_s"][0] for marker in markers]
        timed = [lap for lap in written.source.laps if lap.is_timed]
        np.testing.assert_allclose(beacons, sorted({t for lap in timed for t in (lap.start, lap.end)}), atol=1e-6)
