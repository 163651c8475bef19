"""MoTeC i2: the log as .ld (little endian, one block of samples per channel) and the lap beacons as .ldx beside it.

The format is not published; the layout is what i2 and the readers in circulation agree on. i2 shows nothing of a file
whose driver, vehicle, venue or session is empty, so none is. Lateral G is positive in left-hand corners, as MoTeC's
manual of the Interpreter asks for.
"""

import struct
import unicodedata
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from smoother.errors import UsageError
from smoother.export.channels import ALWAYS, LAP, Channel, lap_channels, logged_channels
from smoother.export.rows import Rows
from smoother.export.source import Source
from smoother.export.text import PRODUCT, date_and_time, lap_clock
from smoother.report.files import replacing
from smoother.units import KMH, MICROSECOND, STANDARD_GRAVITY

VEHICLE_AT, VENUE_AT, EVENT_AT, CHANNELS_AT = 1762, 5078, 8180, 11336
CHANNEL_BYTES = 124
CHANNEL = struct.Struct("<4I4H4h32s8s12s40x")
FIRST_CHANNEL_ID = 0x2EE1
FLOAT, INT = 7, 5  # codes of the kinds of number; both 4 bytes here
ANGLE_DECIMALS = 7  # of a degree, 11 mm: what fits into 32 bits
LARGEST_FILE = 2**32 - 1  # pointers have 32 bits
SERIAL, DEVICE, DEVICE_VERSION = 0x1F44, "ADL", 420
MARKS = (  # offset, layout, values: the same in every file
    (0, "<I", (0x40,)),
    (8, "<2I", (CHANNELS_AT, 0)),  # the second is filled in below
    (36, "<I", (EVENT_AT,)),
    (64, "<3H", (1, 0x4240, 0xF)),
    (70, "<I", (SERIAL,)),
    (82, "<2H", (DEVICE_VERSION, 0xADB0)),
    (1502, "<I", (0xC81A4,)),
)


@dataclass(frozen=True)
class LogChannel:
    """A channel of the log. Values are stored as floats, or as integers of 10^-decimals."""

    channel: Channel
    short: str
    decimals: int | None = None

    def encoded(self, rows: Rows) -> bytes:
        """Return the samples of a block as they stand in the file."""
        values = self.channel.filled(rows)
        if self.decimals is None:
            return values.astype("<f4").tobytes()
        return np.round(values * 10.0**self.decimals).astype("<i4").tobytes()


G = STANDARD_GRAVITY
ALL = (
    LogChannel(Channel("Ground Speed", "speed_mps", "km/h", KMH), "Speed"),
    LogChannel(Channel("GPS Speed", "speed_mps", "km/h", KMH), "GPSSpd"),
    LogChannel(Channel("GPS Latitude", "lat_deg", "deg"), "GPSLat", ANGLE_DECIMALS),
    LogChannel(Channel("GPS Longitude", "lon_deg", "deg"), "GPSLong", ANGLE_DECIMALS),
    LogChannel(Channel("GPS Altitude", "alt_m", "m"), "GPSAlt"),
    LogChannel(Channel("GPS Heading", "course_deg", "deg"), "GPSHead"),
    LogChannel(Channel("G Force Lat", "accel_left_mps2", "G", G), "GLat"),
    LogChannel(Channel("G Force Long", "accel_forward_mps2", "G", G), "GLong"),
    LogChannel(Channel("G Force Vert", "accel_up_mps2", "G", G), "GVert"),
    LogChannel(Channel("Gyro Yaw Velocity", "yaw_rate_dps", "deg/s"), "Yaw"),
    LogChannel(Channel("Roll Angle", "roll_deg", "deg"), "Roll"),
    LogChannel(Channel("Pitch Angle", "pitch_deg", "deg"), "Pitch"),
    LogChannel(Channel("Yaw Angle", "yaw_deg", "deg"), "YawAng"),
    LogChannel(Channel("Distance", "distance_m", "m"), "Dist"),
    LogChannel(Channel("Lap Number", "lap", ""), "Lap"),
    LogChannel(Channel("Running Lap Time", "lap_time_s", "s"), "LapTime"),
    LogChannel(Channel("Lap Distance", "lap_distance_m", "m"), "LapDist"),
    LogChannel(Channel("Lap Delta", "delta_s", "s"), "Delta"),
    LogChannel(Channel("Sigma Track", "sigma_track_m", "m"), "SigTrk"),
    LogChannel(Channel("Sigma North", "sigma_north_m", "m"), "SigN"),
    LogChannel(Channel("Sigma West", "sigma_west_m", "m"), "SigW"),
    LogChannel(Channel("Sigma Up", "sigma_up_m", "m"), "SigU"),
    LogChannel(Channel("Sigma Speed", "sigma_speed_mps", "km/h", KMH), "SigSpd"),
    LogChannel(Channel("Sigma Roll", "sigma_roll_deg", "deg"), "SigRoll"),
    LogChannel(Channel("Sigma Pitch", "sigma_pitch_deg", "deg"), "SigPitch"),
    LogChannel(Channel("Sigma Yaw", "sigma_yaw_deg", "deg"), "SigYaw"),
)


def write(source: Source, path: Path) -> None:
    """Write the session as .ld, and the beacons as .ldx beside it. Rates are whole: others are resampled."""
    rate = max(1.0, float(np.round(source.row_rate)))
    source = replace(source, rate=rate)
    channels = _channels(source)
    head = _head(source, channels)
    if len(head) + 4 * source.count * len(channels) > LARGEST_FILE:
        raise UsageError(f"{path.name}: the session is too long for one MoTeC file; ask for a lower --rate")
    with replacing(path) as temporary, temporary.open("wb") as file:
        file.write(head)
        _write_samples(file, source, channels, len(head))
    with replacing(path.with_suffix(".ldx")) as temporary:
        temporary.write_text(beacons(source), encoding="utf-8", newline="\r\n")


def _channels(source: Source) -> list[LogChannel]:
    laps = {channel.column for channel in lap_channels(source)}
    known = {log.channel.column for log in ALL if source.has(log.channel.column)} - {channel.column for channel in LAP}
    columns = laps | known | {*ALWAYS, "course_deg"}
    # letters of the short name of a channel, before a zero
    logged = [LogChannel(channel, channel.name[:7]) for channel in logged_channels(source, "motec")]
    return [*(log for log in ALL if log.channel.column in columns), *logged]


def _write_samples(file: BinaryIO, source: Source, channels: Sequence[LogChannel], start: int) -> None:
    done = 0
    for rows in source.rows():
        for i, channel in enumerate(channels):
            file.seek(start + 4 * (i * source.count + done))
            file.write(channel.encoded(rows))
        done += len(rows)
    assert done == source.count


def _head(source: Source, channels: Sequence[LogChannel]) -> bytes:
    """Everything before the samples."""
    size = CHANNELS_AT + CHANNEL_BYTES * len(channels)
    head = bytearray(size)
    for offset, layout, values in MARKS:
        struct.pack_into(layout, head, offset, *values)
    struct.pack_into("<I", head, 12, size)
    struct.pack_into("<I", head, 86, len(channels))
    date, time = date_and_time(source)
    driver, vehicle = _ascii(source.text("driver")) or "Driver", _ascii(source.text("kart")) or "Kart"
    name = _ascii(source.name) or "Session"
    venue, session = _ascii(source.text("track")) or name, _ascii(source.text("title")) or name
    comment = f"Smoothed by {PRODUCT}; Sigma channels are one standard deviation"
    texts = (
        *((74, DEVICE, 8), (94, date, 16), (126, time, 16)),
        *((158, driver, 64), (222, vehicle, 64), (350, venue, 64), (1572, comment, 64)),
        *((VEHICLE_AT, vehicle, 64), (VEHICLE_AT + 196, "Kart", 32), (VEHICLE_AT + 228, "", 32)),
        *(
            (VENUE_AT, venue, 64),
            (EVENT_AT, session, 64),
            (EVENT_AT + 64, session, 64),
            (EVENT_AT + 128, comment, 1024),
        ),
    )
    for offset, text, length in texts:
        head[offset : offset + length] = _text(text, length)
    struct.pack_into("<I", head, VENUE_AT + 1098, VEHICLE_AT)
    struct.pack_into("<I", head, EVENT_AT + 1152, VENUE_AT)
    for i, channel in enumerate(channels):
        at = CHANNELS_AT + i * CHANNEL_BYTES
        head[at : at + CHANNEL_BYTES] = _channel_head(source, channel, i, len(channels), size)
    return bytes(head)


def _channel_head(source: Source, log: LogChannel, index: int, channels: int, data_at: int) -> bytes:
    at = CHANNELS_AT + index * CHANNEL_BYTES
    kind = FLOAT if log.decimals is None else INT
    return CHANNEL.pack(
        at - CHANNEL_BYTES if index else 0,
        at + CHANNEL_BYTES if index + 1 < channels else 0,
        data_at + 4 * index * source.count,
        source.count,
        FIRST_CHANNEL_ID + index,
        kind,
        4,
        int(source.row_rate),
        0,  # shift
        1,  # multiplier
        1,  # scale
        log.decimals or 0,
        _text(log.channel.name, 32),
        _text(log.short, 8),
        _text(log.channel.unit, 12),
    )


def _ascii(text: str) -> str:
    """Text without accents and with question marks for other letters: the format knows ASCII only."""
    plain = unicodedata.normalize("NFKD", text)
    plain = "".join(c for c in plain if not unicodedata.combining(c))
    return plain.encode("ascii", errors="replace").decode().strip()


def _text(text: str, length: int) -> bytes:
    """Plain text padded with zeros, one at least."""
    return text.encode("ascii")[: length - 1].ljust(length, b"\0")


def beacons(source: Source) -> str:
    """Return the .ldx: a marker at every crossing of the start/finish line, and the fastest lap."""
    markers = "".join(
        f'     <Marker Version="100" ClassName="BCN" Name="Manual.{number}" Flags="77" '
        f'Time="{(t - source.start) / MICROSECOND:.3f}"/>\n'
        for number, t in enumerate(source.crossings, start=1)
    )
    details = {"Total Laps": str(len(source.crossings) + 1)}
    counted = [lap for lap in source.laps if lap.is_valid and lap.is_timed]
    if counted:
        best = min(counted, key=lambda lap: lap.time)
        details |= {"Fastest Time": lap_clock(best.time), "Fastest Lap": str(best.number)}
    strings = "".join(f'   <String Id="{key}" Value="{value}"/>\n' for key, value in details.items())
    return (
        '<?xml version="1.0"?>\n<LDXFile Locale="C" DefaultLocale="C" Version="1.6">\n <Layers>\n  <Layer>\n'
        '   <MarkerBlock>\n    <MarkerGroup Name="Beacons" Index="3">\n'
        f"{markers}    </MarkerGroup>\n   </MarkerBlock>\n"
        f"   <RangeBlock/>\n  </Layer>\n  <Details>\n{strings}  </Details>\n </Layers>\n</LDXFile>\n"
    )
