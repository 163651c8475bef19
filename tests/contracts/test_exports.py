"""contracts.md 6: `smooth export SESSION FORMAT`, each format read back by what its makers document."""

import json
import xml.etree.ElementTree as ElementTree
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

Read = Callable[[Path], pl.DataFrame]
G = 9.80665
ENDINGS = {
    "vbo": ".vbo",
    "racechrono": ".racechrono.csv",
    "motec": ".ld",
    "aim": ".aim.csv",
    "gpx": ".gpx",
    "kml": ".kml",
    "geojson": ".geojson",
    "tum": ".tum",
}


def exported(drive: Path, smooth: Any, folder: Path, form: str, *words: str) -> Path:
    printed = smooth("export", drive, form, "--out", folder / f"x{ENDINGS[form]}", *words)
    assert printed.code == 0
    return Path(printed.last)


def rows_below(path: Path, header: str, separator: str) -> pl.DataFrame:
    """The table below the line that begins with `header`."""
    lines = path.read_text(encoding="utf-8").splitlines()
    start = next(i for i, line in enumerate(lines) if line.startswith(header))
    names = [name.strip('"') for name in lines[start].split(separator)]
    rows = [[cell.strip('"') for cell in line.split(separator)] for line in lines[start + 1 :]]
    numbers = [row for row in rows if len(row) == len(names) and row[0][:1].isdigit()]
    return pl.DataFrame(numbers, schema=names, orient="row")


def numbers(rows: pl.DataFrame, name: str) -> np.ndarray:
    return rows[name].cast(pl.Float64, strict=False).to_numpy()


@pytest.mark.parametrize("form", ENDINGS)
def test_an_export_is_one_file_beside_the_results_by_default(
    drive: Path, results: Path, smooth: Any, form: str
) -> None:
    before = set(results.iterdir())
    printed = smooth("export", drive, form)
    path = Path(printed.last)
    new = set(results.iterdir()) - before
    assert printed.code == 0 and path == results / f"monday{ENDINGS[form]}"
    assert new == ({path, path.with_suffix(".ldx")} if form == "motec" else {path})
    assert path.stat().st_size > 10_000
    for file in new:
        file.unlink()


def test_vbo_has_minutes_west_and_accelerations_in_g(
    drive: Path, results: Path, smooth: Any, trajectory: pl.DataFrame, tmp_path: Path
) -> None:
    path = exported(drive, smooth, tmp_path, "vbo")
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    names = lines[lines.index("[column names]") + 1].split()
    data = np.array([line.split() for line in lines[lines.index("[data]") + 1 :] if line.strip()])
    at = {name: data[:, i] for i, name in enumerate(names)}
    assert len(data) == trajectory.height
    np.testing.assert_allclose(at["lat"].astype(float) / 60.0, trajectory["lat_deg"], atol=1e-7)
    np.testing.assert_allclose(-at["long"].astype(float) / 60.0, trajectory["lon_deg"], atol=1e-7)
    np.testing.assert_allclose(at["velocity"].astype(float) / 3.6, trajectory["speed_mps"], atol=0.01)
    longitudinal, lateral = (at[name].astype(float) for name in ("longitudinal_acc", "lateral_acc"))
    np.testing.assert_allclose(longitudinal * G, trajectory["accel_forward_mps2"], atol=0.01)
    np.testing.assert_allclose(np.abs(lateral) * G, np.abs(trajectory["accel_left_mps2"]), atol=0.01)


def test_tum_is_in_n_with_the_quaternion_of_R_nb(
    drive: Path, results: Path, smooth: Any, trajectory: pl.DataFrame, tmp_path: Path
) -> None:
    data = np.loadtxt(exported(drive, smooth, tmp_path, "tum"))
    np.testing.assert_allclose(data[:, 0], trajectory["t_s"], atol=1e-6)
    np.testing.assert_allclose(data[:, 1:4], trajectory.select("north_m", "west_m", "up_m"), atol=1e-4)
    roll, pitch, yaw = (np.radians(trajectory[f"{name}_deg"].to_numpy()) / 2.0 for name in ("roll", "pitch", "yaw"))
    (cr, cp, cy), (sr, sp, sy) = (tuple(f(a) for a in (roll, pitch, yaw)) for f in (np.cos, np.sin))
    wanted = np.stack(
        [
            sr * cp * cy - cr * sp * sy,
            cr * sp * cy + sr * cp * sy,
            cr * cp * sy - sr * sp * cy,
            cr * cp * cy + sr * sp * sy,
        ],
        axis=-1,
    )
    np.testing.assert_allclose(np.abs(np.sum(data[:, 4:8] * wanted, axis=1)), 1.0, atol=1e-6)


def test_gpx_is_a_track_with_times(
    drive: Path, results: Path, smooth: Any, trajectory: pl.DataFrame, tmp_path: Path
) -> None:
    root = ElementTree.parse(exported(drive, smooth, tmp_path, "gpx")).getroot()
    space = {"g": "http://www.topografix.com/GPX/1/1"}
    points = root.findall(".//g:trkpt", space)
    assert len(points) == trajectory.height
    np.testing.assert_allclose([float(p.attrib["lat"]) for p in points], trajectory["lat_deg"], atol=1e-8)
    np.testing.assert_allclose([float(p.attrib["lon"]) for p in points], trajectory["lon_deg"], atol=1e-8)
    assert points[100].findtext("g:time", namespaces=space) == trajectory["utc"][100]


def test_geojson_is_longitude_then_latitude(
    drive: Path, results: Path, smooth: Any, trajectory: pl.DataFrame, tmp_path: Path
) -> None:
    document = json.loads(exported(drive, smooth, tmp_path, "geojson").read_text())
    assert document["type"] == "FeatureCollection"
    lines = [one["geometry"] for one in document["features"] if one["geometry"]["type"] == "LineString"]
    lon, lat = np.array(lines[0]["coordinates"])[:, :2].T
    np.testing.assert_allclose([lon[0], lat[0]], [trajectory["lon_deg"][0], trajectory["lat_deg"][0]], atol=1e-8)


def test_kml_is_longitude_latitude_and_height(
    drive: Path, results: Path, smooth: Any, trajectory: pl.DataFrame, tmp_path: Path
) -> None:
    root = ElementTree.parse(exported(drive, smooth, tmp_path, "kml")).getroot()
    texts = [e.text or "" for e in root.iter() if e.tag.endswith(("}coord", "}coordinates"))]
    first = [float(value) for value in texts[0].replace(",", " ").split()[:2]]
    near = np.hypot(trajectory["lon_deg"] - first[0], trajectory["lat_deg"] - first[1])
    assert near.min() < 1e-6


def test_racechrono_and_aim_hold_position_and_speed(
    drive: Path, results: Path, smooth: Any, trajectory: pl.DataFrame, tmp_path: Path
) -> None:
    chrono = rows_below(exported(drive, smooth, tmp_path, "racechrono"), "timestamp", ",")
    np.testing.assert_allclose(numbers(chrono, "latitude"), trajectory["lat_deg"], atol=1e-8)
    np.testing.assert_allclose(numbers(chrono, "speed"), trajectory["speed_mps"], atol=1e-3)
    aim = rows_below(exported(drive, smooth, tmp_path, "aim"), '"Time","GPS Speed"', ",")
    np.testing.assert_allclose(numbers(aim, "GPS Longitude"), trajectory["lon_deg"], atol=1e-8)
    np.testing.assert_allclose(numbers(aim, "GPS Speed") / 3.6, trajectory["speed_mps"], atol=1e-3)


def test_motec_is_a_log_with_its_laps_beside_it(drive: Path, results: Path, smooth: Any, tmp_path: Path) -> None:
    path = exported(drive, smooth, tmp_path, "motec")
    data = path.read_bytes()
    assert data[:4] == b"\x40\x00\x00\x00"  # how every log begins
    assert b"Ground Speed" in data or b"Speed" in data
    assert ElementTree.parse(path.with_suffix(".ldx")).getroot().tag == "LDXFile"


def test_rate_chooses_the_rows_of_an_export(drive: Path, results: Path, smooth: Any, tmp_path: Path) -> None:
    data = np.loadtxt(exported(drive, smooth, tmp_path, "tum", "--rate", "10"))
    np.testing.assert_allclose(np.diff(data[:, 0]), 0.1, atol=2e-6)
