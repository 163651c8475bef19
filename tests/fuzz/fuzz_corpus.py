"""Good sessions of every format, small ones: what the mutators damage. File names map to bytes.

Written by the simulator where it can, by hand where only other programs write the format.
"""

import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path

from smoother.sim.record import nmea_sentences, write_csv, write_settings, write_thesis
from smoother.sim.record_log import write_klg
from smoother.sim.simulation import Simulation, simulate_preset

Files = dict[str, bytes]
DURATION = 24.0  # s; long enough to be smoothed, short enough to damage a thousand times
FIXES = 200  # of the recordings of other programs
TRACK = b"""{"type": "FeatureCollection", "features": [
{"type": "Feature", "properties": {"line": "start"},
 "geometry": {"type": "LineString", "coordinates": [[13.0730, 45.0001], [13.0731, 45.0001]]}},
{"type": "Feature", "properties": {"line": "sector 2"},
 "geometry": {"type": "LineString", "coordinates": [[13.0730, 45.0002], [13.0731, 45.0002]]}}]}
"""
PAIRS = b"""{"one": {"start_a_lat": 45.0001, "start_a_lng": 13.073, "start_b_lat": 45.0001, "start_b_lng": 13.0731,
 "sector_2_a_lat": 45.0002, "sector_2_a_lng": 13.073, "sector_2_b_lat": 45.0002, "sector_2_b_lng": 13.0731,
 "lengthFt": 3000}}
"""
SETTINGS = b"""[session]
title = "Morning"
driver = "A"
track = "track.geojson"
date = "2026-04-11"
[mounting]
lever_arm_b = [0.1, 0.0, 0.6]
R_bs = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
[imu]
accel_noise = 0.02
gyro_noise = 1e-3
[gps]
position_latency = 0.1
[magnetometer]
use = false
declination_deg = 3.5
"""
CALIBRATION = b"""[accelerometer]
offset = [0.1, -0.1, 0.05]
matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
[gyroscope]
bias = [0.01, 0.0, -0.01]
bias_per_kelvin = [1e-4, 0.0, 0.0]
temperature = 25.0
temperature_span = [10.0, 40.0]
[magnetometer]
hard_iron = [1.0, 2.0, 3.0]
soft_iron = [[0.02, 0.0, 0.0], [0.0, 0.02, 0.0], [0.0, 0.0, 0.02]]
"""


@cache
def simulation() -> Simulation:
    """Return the session behind the files of the simulator."""
    return simulate_preset("kart", seed=5, duration=DURATION, gnss_rate=5.0, gnss_jumps=(), gnss_outages=())


def _written(write: Callable[[Path], None]) -> Files:
    with tempfile.TemporaryDirectory() as name:
        write(Path(name))
        return {path.name: path.read_bytes() for path in sorted(Path(name).iterdir()) if "truth" not in path.name}


def _columns() -> Files:
    files = _written(lambda directory: write_csv(simulation(), directory))
    return {**files, "session.toml": SETTINGS, "calibration.toml": CALIBRATION, "track.geojson": TRACK}


def _sentences() -> Files:
    def write(directory: Path) -> None:
        write_csv(simulation(), directory)
        (directory / "gps.csv").unlink()
        fixes, kinds = simulation().raw.gnss, ("RMC", "GGA", "VTG", "GST")
        lines = [f"{t:.6f},{s}\r\n" for i, t in enumerate(fixes.t) for s in nmea_sentences(fixes, kinds, i)]
        (directory / "gps.nmea").write_text("".join(lines), encoding="ascii", newline="")
        write_settings(simulation(), directory / "session.toml")

    return _written(write)


def place(k: int, rate: float) -> tuple[float, float]:
    """Latitude and longitude (deg) of fix k: north at 10 m/s."""
    return 45.0 + 10.0 * k / rate / 111_195, 13.073


def _vbo() -> Files:
    rows = []
    for k in range(FIXES):
        lat, lon = place(k, 10.0)
        rows.append(
            f"012 1000{k // 10:02d}.{k % 10}00 {60 * lat:+013.6f} {-60 * lon:+013.6f} 036.000 000.000 +00004.000"
        )
    head = (
        *("File created on 11/04/2026 at 10:00:00", "", "[header]", "satellites", "time", "latitude", "longitude"),
        *("velocity kmh", "heading", "height", "", "[laptiming]", "Start -784.38 2700.01 -784.39 2700.01 ¬ Start", ""),
        *("[column names]", "sats time lat long velocity heading height", "", "[data]"),
    )
    return {"run.vbo": "\r\n".join([*head, *rows, ""]).encode()}


def _racechrono() -> Files:
    head = (
        "This file is created using RaceChrono v9.1.3 ( http://racechrono.com/ ).\nFormat,3\nSession title,x\n\n"
        "timestamp,fragment_id,accuracy,altitude,bearing,fix_type,latitude,longitude,satellites,speed\n"
        "unix time,,m,m,deg,,deg,deg,sats,m/s\n," + 8 * ",100: gps" + "\n"
    )
    rows = []
    for k in range(FIXES):
        lat, lon = place(k, 10.0)
        rows.append(f"{1775907141 + 0.1 * k:.3f},0,0.42,4.5,0.0,3,{lat:.9f},{lon:.9f},16,10.0\n")
    return {"session.csv": (head + "".join(rows)).encode()}


def _aim() -> Files:
    def line(*cells: str) -> str:
        return ",".join(f'"{cell}"' for cell in cells) + "\r\n"

    names = ("Time", "GPS Speed", "GPS Nsat", "GPS Heading", "GPS Altitude", "GPS Latitude", "GPS Longitude")
    head = [
        line("Format", "AiM CSV File"),
        line("Session", "Circuit"),
        line("Date", "Saturday, April 11, 2026"),
        "\r\n",
    ]
    rows = [line(*names), line("s", "km/h", "#", "deg", "m", "deg", "deg"), "\r\n"]
    for k in range(FIXES):
        lat, lon = place(k, 20.0)
        rows.append(line(f"{0.05 * k:.3f}", "36.00", "16", "0.0", "4.5", f"{lat:.8f}", f"{lon:.8f}"))
    return {"session.csv": "".join([*head, *rows]).encode()}


def _table() -> Files:
    """A table of a program without a reader of its own, as RaceBox writes it."""
    head = "Format,RaceBox CSV\nLaps,1\n\nRecord,Time,Latitude,Longitude,Altitude,Speed,GForceX,GForceY,GForceZ,Lap"
    rows = []
    for k in range(FIXES):
        lat, lon = place(k, 10.0)
        moment = f"2026-04-11T11:{32 + k // 600:02d}:{k // 10 % 60:02d}.{k % 10}00Z"
        rows.append(f"{k},{moment},{lat:.7f},{lon:.7f},4.5,36.00,0.01,-0.02,1.00,1,0.10,-0.20,0.30")
    return {"session.csv": "\n".join([f"{head},GyroX,GyroY,GyroZ", *rows, ""]).encode()}


def gpx_points() -> list[str]:
    """Return the elements of a GPX track, a string for each point."""
    points = []
    for k in range(FIXES):
        lat, lon = place(k, 5.0)
        time = f"2026-04-11T11:32:{k // 5:02d}.{k % 5 * 200:03d}Z"
        points.append(
            f'<trkpt lat="{lat:.9f}" lon="{lon}"><ele>4.5</ele><time>{time}</time>'
            "<extensions><speed>10.0</speed><course>0.0</course></extensions></trkpt>\n"
        )
    return points


def _gpx() -> Files:
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">\n'
    return {"run.gpx": (head + "<trk><trkseg>\n" + "".join(gpx_points()) + "</trkseg></trk></gpx>\n").encode()}


CORPUS: dict[str, Callable[[], Files]] = {
    "log": cache(lambda: _written(lambda directory: write_klg(simulation(), directory))),
    "thesis": cache(
        lambda: _written(lambda directory: write_thesis(simulation(), directory, sentences=("RMC", "GGA")))
    ),
    "columns": cache(_columns),
    "sentences": cache(_sentences),
    "vbo": cache(_vbo),
    "racechrono": cache(_racechrono),
    "aim": cache(_aim),
    "table": cache(_table),
    "gpx": cache(_gpx),
}


def write_files(directory: Path, files: Files) -> Path:
    """Write files into a directory that is made for them; return it."""
    directory.mkdir(parents=True, exist_ok=True)
    for name, data in files.items():
        (directory / name).write_bytes(data)
    return directory
