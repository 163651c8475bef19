"""AiM CSV, as Race Studio exports and imports it. Lateral acceleration and yaw rate are positive to the right here.

Times count from the first row; the beacons are the crossings of the start/finish line.
"""

import datetime as dt
from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.export.channels import SIGMAS, Channel, lap_channels, logged_channels
from smoother.export.rows import Rows
from smoother.export.source import Source
from smoother.export.text import PRODUCT, date_and_time, lap_clock, lines, quoted, start_stamp
from smoother.report.files import replacing
from smoother.units import DEG, KMH, STANDARD_GRAVITY

LARGEST_RADIUS = 10_000.0  # m; a straight
NAMES = (  # name, unit, format
    ("Time", "s", "%.3f"),
    ("GPS Speed", "km/h", "%.4f"),
    ("GPS Nsat", "", "%d"),
    ("GPS LatAcc", "g", "%.4f"),
    ("GPS LonAcc", "g", "%.4f"),
    ("GPS Slope", "deg", "%.3f"),
    ("GPS Heading", "deg", "%.3f"),
    ("GPS Gyro", "deg/s", "%.4f"),
    ("GPS Altitude", "m", "%.3f"),
    ("GPS PosAccuracy", "mm", "%.1f"),
    ("GPS SpdAccuracy", "km/h", "%.4f"),
    ("GPS Radius", "m", "%.1f"),
    ("GPS Latitude", "deg", "%.9f"),
    ("GPS Longitude", "deg", "%.9f"),
)
# English whatever the locale, which strftime would follow
DAYS = ("Monday", "Tuesday", "Wednesday", "Thursday", "Friday", "Saturday", "Sunday")
MONTHS = (
    *("January", "February", "March", "April", "May", "June"),
    *("July", "August", "September", "October", "November", "December"),
)
MILLIMETRE = 1e-3  # m
STANDING = 0.1  # m/s; below, the slope of the velocity is noise and is damped


def write(source: Source, path: Path) -> None:
    """Write the session as AiM CSV."""
    channels = _channels(source)
    names = [*NAMES, *((channel.name, channel.unit, "%.4f") for channel in channels)]
    with replacing(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        file.writelines(",".join(quoted(cell) for cell in row) + "\r\n" for row in _head(source))
        titles = [[name for name, _, _ in names], [unit for _, unit, _ in names]]
        file.writelines(",".join(quoted(cell) for cell in row) + "\r\n" for row in titles)
        file.write("\r\n")
        template = ",".join(f'"{form}"' for _, _, form in names) + "\r\n"
        for rows in source.rows():
            file.write(lines(template, [*_fixed(rows), *(channel.filled(rows) for channel in channels)]))


def _channels(source: Source) -> list[Channel]:
    labels = {"lap": "Lap", "lap_time": "Lap Time", "lap_distance": "Lap Distance", "delta": "Lap Delta"}
    laps = [Channel(labels[c.name], c.column, c.unit, c.factor) for c in lap_channels(source)]
    known = [channel for channel in SIGMAS if source.has(channel.column)]
    sigmas = [Channel(c.name.replace("_", " ").title(), c.column, c.unit, c.factor) for c in known]
    return [*laps, *sigmas, *logged_channels(source, "aim")]


def _head(source: Source) -> list[list[str]]:
    duration = (source.count - 1) / source.row_rate
    markers = [t - source.start for t in source.crossings if t - source.start < duration] + [duration]
    segments = np.diff([0.0, *markers])
    clock = "Time is UTC." if source.has_utc else "The time of day is unknown."
    return [
        ["Format", "AiM CSV File"],
        ["Session", source.text("track", source.name)],
        ["Vehicle", source.text("kart")],
        ["Racer", source.text("driver")],
        ["Championship", ""],
        ["Comment", f"Smoothed by {PRODUCT}; Sigma columns are one standard deviation. {clock}"],
        ["Date", _date(source)],
        ["Time", date_and_time(source)[1]],
        ["Sample Rate", f"{source.row_rate:g}"],
        ["Duration", f"{duration:.3f}"],
        ["Segment", "Session"],
        ["Beacon Markers", *(f"{marker:.3f}" for marker in markers)],
        ["Segment Times", *(lap_clock(float(segment)) for segment in segments)],
        [],
    ]


def _date(source: Source) -> str:
    day = start_stamp(source).astype(dt.datetime)
    return f"{DAYS[day.weekday()]}, {MONTHS[day.month - 1]} {day.day:02d}, {day.year}"


def _fixed(rows: Rows) -> list[Array]:
    speed, left = rows["speed_mps"], rows["accel_left_mps2"]
    with np.errstate(divide="ignore", invalid="ignore"):
        radius = np.nan_to_num(speed**2 / np.abs(left), nan=LARGEST_RADIUS, posinf=LARGEST_RADIUS)
    heading = 180.0 - (180.0 - np.round(rows["course_deg"], 3)) % 360.0
    position_sigma = np.hypot(rows["sigma_north_m"], rows["sigma_west_m"])
    return [
        rows["elapsed_s"],
        speed / KMH,
        np.full(len(rows), 10),  # as in the VBO: the number is not known after smoothing, and zero would mean no fix
        -left / STANDARD_GRAVITY,
        rows["accel_forward_mps2"] / STANDARD_GRAVITY,
        np.arctan2(rows["vel_up_mps"], np.maximum(speed, STANDING)) / DEG,
        heading,
        -rows["yaw_rate_dps"],
        rows["alt_m"],
        np.nan_to_num(position_sigma, nan=0.0) / MILLIMETRE,
        np.nan_to_num(rows["sigma_speed_mps"], nan=0.0) / KMH,
        np.minimum(radius, LARGEST_RADIUS),
        rows["lat_deg"],
        rows["lon_deg"],
    ]
