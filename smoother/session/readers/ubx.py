"""UBX, the binary messages of u-blox receivers, as loggers store them, read by pyubx2: fixes with their velocities.

A file is a stream of messages of every kind, maybe damaged; each that is wanted is found by its first bytes, so that a
damaged length costs one message, and used if its checksum is right. Those of one time of the week are one fix.
"""

import datetime as dt
import mmap
import re
from pathlib import Path
from typing import Any

import numpy as np
from pyubx2 import UBXReader
from pyubx2.exceptions import UBXMessageError, UBXParseError, UBXStreamError, UBXTypeError

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.readers.foreign import ForeignReading, fixes_from
from smoother.units import DAY
from smoother.words import counted

WANTED = re.compile(rb"\xb5\x62\x01[\x02\x06\x07\x12\x21](..)", re.DOTALL)  # POSLLH, SOL, PVT, VELNED, TIMEUTC
LONGEST = 256  # bytes of a message; those that are wanted have up to 100
AROUND = 8  # bytes of a message beside what it says
WEEK = 7.0 * DAY  # s after which the time of the week starts again
DEAD_RECKONING, TIME_ONLY = 1, 5  # kinds of fix that are none
MILLI, CENTI, NANO = 1e-3, 1e-2, 1e-9
NAMES = (
    *("lat_deg", "lon_deg", "alt_m", "speed", "course_deg", "velocity_north", "velocity_east", "velocity_up"),
    *("sigma_horizontal", "sigma_up", "sigma_velocity", "num_sv", "fix", "unix_s"),
)


def read_ubx(path: Path) -> ForeignReading:
    """Read the fixes of a UBX file. Raises SessionError, one line, where there is none in it."""
    epochs: list[dict[str, float]] = []
    last: dict[float, dict[str, float]] = {}
    lost = 0
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            for match in WANTED.finditer(data):
                length = int.from_bytes(match[1], "little")
                if (
                    length > LONGEST
                    or (said := _message(data[match.start() : match.start() + AROUND + length])) is None
                ):
                    lost += match.start() + AROUND + length <= len(data)
                    continue
                values = _values(said)
                epoch = last.get(values["itow"])
                if epoch is None or said.identity == "NAV-PVT":
                    epoch = {}
                    last = {values["itow"]: epoch}
                    epochs.append(epoch)
                epoch |= values
    except (OSError, ValueError) as error:  # the latter of an empty file
        raise SessionError(f"{path.name}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    epochs = [epoch for epoch in epochs if "lat_deg" in epoch]
    if not epochs:
        raise SessionError(f"{path.name}: no fix in it; have the receiver send NAV-PVT, or NMEA")
    lat_deg, lon_deg, *others = (np.array([epoch.get(name, np.nan) for epoch in epochs]) for name in NAMES)
    sent_t = _seconds(np.array([epoch["itow"] for epoch in epochs]))
    known = dict(zip(NAMES[2:], others, strict=True))
    gnss, problems = fixes_from(path.name, sent_t - sent_t[0], lat_deg, lon_deg, has_rows_between=False, **known)
    text = f"{path.name}: {counted(lost, 'UBX message')} with a wrong checksum; left out"
    return ForeignReading(gnss, [*([Problem("gps_row_damaged", text, lost)] if lost else []), *problems])


def _message(frame: bytes) -> Any:
    """The message of a frame; None where its checksum is wrong, or it is cut short."""
    try:
        return UBXReader.parse(frame)
    except (UBXMessageError, UBXParseError, UBXStreamError, UBXTypeError, ValueError, IndexError, OverflowError):
        return None


def _values(said: Any) -> dict[str, float]:
    """Columns of a fix by what a message says."""
    itow = {"itow": _of_week(said)}
    match said.identity:
        case "NAV-PVT":
            knows = bool(said.validDate and said.validTime)
            return itow | {
                **_place(said),
                **_velocity(said, MILLI, said.headMot),
                "num_sv": float(said.numSV),
                "fix": _quality(said.fixType, said.gnssFixOk),
                "unix_s": _unix(said.year, said.month, said.day, said.hour, said.min, said.second, said.nano, knows),
            }
        case "NAV-POSLLH":
            return itow | _place(said)
        case "NAV-VELNED":
            return itow | _velocity(said, CENTI, said.heading)
        case "NAV-SOL":
            return itow | {"num_sv": float(said.numSV), "fix": _quality(said.gpsFix, said.gpsfixOK)}
        case _:
            unix = _unix(said.year, said.month, said.day, said.hour, said.min, said.sec, said.nano, bool(said.validUTC))
            return itow | {"unix_s": unix}


def _of_week(said: Any) -> float:
    """Time of the week, s, which pyubx2 gives as a time of the day: the bytes say it."""
    return int.from_bytes(said.payload[:4], "little") * MILLI


def _place(said: Any) -> dict[str, float]:
    values = {"lat_deg": said.lat, "lon_deg": said.lon, "alt_m": said.hMSL * MILLI}
    return values | {"sigma_horizontal": said.hAcc * MILLI, "sigma_up": said.vAcc * MILLI}


def _velocity(said: Any, unit: float, course_deg: float) -> dict[str, float]:
    values = {"velocity_north": said.velN, "velocity_east": said.velE, "velocity_up": -said.velD}
    values |= {"speed": said.gSpeed, "sigma_velocity": said.sAcc}
    return {name: value * unit for name, value in values.items()} | {"course_deg": course_deg}


def _seconds(of_week: Array) -> Array:
    """Times (K,) s that run on where a week ends."""
    return of_week + WEEK * np.cumsum(np.diff(of_week, prepend=of_week[:1]) < -0.5 * WEEK)


def _quality(kind: int, is_within_limits: int) -> float:
    """Quality of a fix: the kind, 0 for none and for dead reckoning."""
    if not is_within_limits or kind in (TIME_ONLY, DEAD_RECKONING):
        return 0.0
    return float(kind)


def _unix(year: int, month: int, day: int, hour: int, minute: int, second: int, nano: int, is_known: bool) -> float:
    """UTC, s since 1970, NaN where the receiver does not know it."""
    try:
        midnight = dt.datetime(year, month, day, tzinfo=dt.UTC).timestamp()
    except ValueError:
        return np.nan
    return midnight + hour * 3600.0 + minute * 60.0 + second + nano * NANO if is_known else np.nan
