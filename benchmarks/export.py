"""Memory and time of every export, for ten minutes and for four hours: python benchmarks/export.py

Writes results of a kart that goes round in circles, exports them in a process of its own per format, and prints the
peak memory and the processor time of each. Flat memory is the aim: four hours take what ten minutes take.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import polars as pl

from smoother.export.formats import BY_NAME
from smoother.export.rows import MOTION, SIGMAS
from smoother.export.source import open_source
from smoother.frames import Origin, nwu_to_geodetic

SPEED, RADIUS, RATE = 20.0, 160.0, 50.0  # m/s, m, Hz: a lap of 50 s
ORIGIN = Origin(45.7, 13.07, 4.0)
MEGABYTE = 1024.0 if sys.platform != "darwin" else 1024.0**2  # what ru_maxrss counts in


def main() -> None:
    """Measure, and print one row per format."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--minutes", type=float, nargs=2, default=(10.0, 240.0), help="the two lengths [10 240]")
    parser.add_argument("--format", action="append", choices=list(BY_NAME), help="only this one; may be repeated")
    parser.add_argument("--child", nargs=2, metavar=("DIR", "FORMAT"), help=argparse.SUPPRESS)
    parser.add_argument("--make", nargs=2, metavar=("DIR", "SECONDS"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        measure(Path(arguments.child[0]), arguments.child[1])
        return
    if arguments.make:
        write_results(Path(arguments.make[0]), float(arguments.make[1]))
        return
    with tempfile.TemporaryDirectory() as directory:
        places = [Path(directory) / f"{minutes:g}" for minutes in arguments.minutes]
        for place, minutes in zip(places, arguments.minutes, strict=True):
            # a process of its own: a child's peak is never below what its parent holds
            subprocess.run([sys.executable, __file__, "--make", str(place), str(60.0 * minutes)], check=True)
        short, long = arguments.minutes
        print(f"{'format':<12}{f'{short:g} min, MB':>14}{f'{long:g} min, MB':>14}{'CPU s':>8}{'file, MB':>10}")
        for form in arguments.format or BY_NAME:
            small, large = (in_child(place, form) for place in places)
            memory = f"{small['memory']:>14.0f}{large['memory']:>14.0f}"
            print(f"{form:<12}{memory}{large['cpu']:>8.1f}{large['size'] / 1e6:>10.0f}", flush=True)


def in_child(directory: Path, form: str) -> dict[str, float]:
    """Run one export in a process of its own and return what it measured."""
    command = [sys.executable, __file__, "--child", str(directory), form]
    measured: dict[str, float] = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    return measured


def measure(directory: Path, form: str) -> None:
    """Export, and print peak memory (MB), processor time (s) and size (bytes) as JSON."""
    start, path = time.process_time(), directory / f"run{BY_NAME[form].ending}"
    BY_NAME[form].write(open_source(directory), path)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / MEGABYTE
    size = path.stat().st_size
    path.unlink()
    print(json.dumps({"memory": memory, "cpu": time.process_time() - start, "size": size}))


def write_results(directory: Path, duration: float) -> None:
    """Write trajectory.csv, laps.csv and summary.json of `duration` s."""
    directory.mkdir()
    t = np.arange(0.0, duration, 1.0 / RATE)
    angle = SPEED / RADIUS * t
    north, west = RADIUS * np.sin(angle), RADIUS * (1.0 - np.cos(angle))
    lat, lon, alt = nwu_to_geodetic(np.stack([north, west, 0.0 * t], axis=-1), ORIGIN)
    columns = {
        "t_s": t,
        "lat_deg": lat,
        "lon_deg": lon,
        "alt_m": alt,
        "north_m": north,
        "west_m": west,
        "up_m": 0.0 * t,
    }
    columns |= {"vel_north_mps": SPEED * np.cos(angle), "vel_west_mps": SPEED * np.sin(angle), "vel_up_mps": 0.0 * t}
    columns |= {"speed_mps": SPEED + 0.0 * t, **{name: np.cos(angle) for name in (*MOTION, *SIGMAS)}}
    length = 2.0 * np.pi * RADIUS
    columns |= {"lap": np.floor(SPEED * t / length), "lap_distance_m": np.mod(SPEED * t, length)}
    utc = pl.Series("utc", (1.7e12 + np.round(t * 1e3)).astype(np.int64)).cast(pl.Datetime("ms"))
    table = pl.DataFrame(columns).with_columns(pl.selectors.numeric().round(9))
    table.insert_column(1, utc.dt.strftime("%Y-%m-%dT%H:%M:%S%.3fZ")).write_csv(directory / "trajectory.csv")
    lap_time = length / SPEED
    rows = [
        f"{i},{i * lap_time},{(i + 1) * lap_time},{lap_time + 1e-3 * (i % 7)},0.01,true,,"
        for i in range(int(duration / lap_time))
    ]
    head = "lap,start_s,end_s,lap_time_s,lap_time_sigma_s,valid,reason,sector1_s"
    (directory / "laps.csv").write_text("\n".join([head, *rows]) + "\n")
    place = {"lat_deg": ORIGIN.lat_deg, "lon_deg": ORIGIN.lon_deg, "alt_m": ORIGIN.alt_m}
    (directory / "summary.json").write_text(json.dumps({"session": {"name": "circles"}, "origin": place}))


if __name__ == "__main__":
    main()
