"""UBX, the binary messages of u-blox receivers, as loggers store them: the fixes of NAV-PVT, with their velocities.

A file is a stream of messages of every kind, maybe damaged; each NAV-PVT is found by its first bytes and believed if
its checksum is right. Refuses older receivers' messages (NAV-POSLLH, NAV-VELNED), and NMEA, which has a reader.
Source: u-blox, Interface Description M8, UBX-NAV-PVT.
"""

import mmap
import re
from pathlib import Path

import numpy as np
import numpy.typing as npt

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import Problem
from smoother.session.fix_columns import ESTIMATED
from smoother.session.foreign import ForeignReading, fixes_from
from smoother.units import DAY
from smoother.words import counted

SYNC = b"\xb5\x62"
HEAD = SYNC + b"\x01\x07\x5c\x00"  # class, number, length
WEEK = 7.0 * DAY  # s after which the time of the week starts again
DATE_AND_TIME = 0b11  # bits of `valid`: both are known
FIX_OK = 0b1  # bit of `flags`: within the receiver's limits
DEAD_RECKONING, TIME_ONLY = 1, 5  # kinds of fix that are none
MILLI, NANO = 1e-3, 1e-9
NAV_PVT = np.dtype(
    [
        *(("itow_ms", "<u4"), ("year", "<u2"), ("month", "u1"), ("day", "u1"), ("hour", "u1"), ("minute", "u1")),
        *(("second", "u1"), ("valid", "u1"), ("time_accuracy_ns", "<u4"), ("nano", "<i4"), ("fix", "u1")),
        *(("flags", "u1"), ("flags2", "u1"), ("satellites", "u1"), ("lon_1e7", "<i4"), ("lat_1e7", "<i4")),
        *(("ellipsoid_mm", "<i4"), ("height_mm", "<i4"), ("hacc_mm", "<u4"), ("vacc_mm", "<u4"), ("north_mm", "<i4")),
        *(("east_mm", "<i4"), ("down_mm", "<i4"), ("speed_mm", "<i4"), ("course_1e5", "<i4"), ("sacc_mm", "<u4")),
        *(("course_accuracy_1e5", "<u4"), ("pdop", "<u2"), ("rest", "V14")),
    ]
)
FRAME = len(HEAD) + NAV_PVT.itemsize + 2  # with two bytes of checksum


def read_ubx(path: Path) -> ForeignReading:
    """Read the fixes of a UBX file. Raises SessionError, one line, where there is no NAV-PVT in it."""
    frames = _frames(path)
    good = _is_whole(frames)
    lost = int(np.count_nonzero(~good))
    payload = np.ascontiguousarray(frames[good, len(HEAD) : -2])
    if not len(payload):
        raise SessionError(f"{path.name}: no UBX message NAV-PVT in it; have the receiver send that, or NMEA")
    pvt = payload.view(NAV_PVT)[:, 0]
    sent_t = _seconds(pvt["itow_ms"] * MILLI)
    gnss, problems = fixes_from(
        path.name,
        sent_t - sent_t[0],
        pvt["lat_1e7"] * 1e-7,
        pvt["lon_1e7"] * 1e-7,
        alt_m=pvt["height_mm"] * MILLI,
        speed=pvt["speed_mm"] * MILLI,
        course_deg=pvt["course_1e5"] * 1e-5,
        velocity_north=pvt["north_mm"] * MILLI,
        velocity_east=pvt["east_mm"] * MILLI,
        velocity_up=-pvt["down_mm"] * MILLI,
        sigma_horizontal=pvt["hacc_mm"] * MILLI,
        sigma_up=pvt["vacc_mm"] * MILLI,
        sigma_velocity=pvt["sacc_mm"] * MILLI,
        num_sv=pvt["satellites"].astype(np.float64),
        fix=_quality(pvt),
        unix_s=_unix(pvt),
    )
    text = f"{path.name}: {counted(lost, 'NAV-PVT message')} with a wrong checksum; left out"
    return ForeignReading(gnss, [*([Problem("gps_row_damaged", text, lost)] if lost else []), *problems])


def _frames(path: Path) -> npt.NDArray[np.uint8]:
    """What begins as a NAV-PVT message, (K, FRAME) bytes."""
    try:
        with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
            found = [data[match.start() : match.start() + FRAME] for match in re.finditer(re.escape(HEAD), data)]
    except (OSError, ValueError) as error:  # the latter of an empty file
        raise SessionError(f"{path.name}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    return np.frombuffer(b"".join(frame for frame in found if len(frame) == FRAME), np.uint8).reshape(-1, FRAME)


def _is_whole(frames: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
    """Which frames (K, FRAME) have the right checksum (Fletcher's, over all between the first two bytes and it)."""
    body = frames[:, len(SYNC) : -2].astype(np.int64)
    weights = np.arange(body.shape[1], 0, -1)
    return np.asarray((body.sum(axis=1) % 256 == frames[:, -2]) & (body @ weights % 256 == frames[:, -1]))


def _seconds(of_week: Array) -> Array:
    """Times (K,) s that run on where a week ends."""
    return of_week + WEEK * np.cumsum(np.diff(of_week, prepend=of_week[:1]) < -0.5 * WEEK)


def _quality(pvt: npt.NDArray[np.void]) -> Array:
    """Quality (K,) of the fixes: the kind, ESTIMATED for dead reckoning, 0 for none."""
    kind = pvt["fix"].astype(np.float64)
    kind[kind == TIME_ONLY] = 0.0
    kind[kind == DEAD_RECKONING] = ESTIMATED
    return np.where(pvt["flags"] & FIX_OK, kind, 0.0)


def _unix(pvt: npt.NDArray[np.void]) -> Array:
    """UTC (K,) in s since 1970, NaN where the receiver does not know it."""
    known = (pvt["valid"] & DATE_AND_TIME) == DATE_AND_TIME
    months = (pvt["year"].astype(np.int64) - 1970) * 12 + pvt["month"] - 1
    midnight = months.astype("datetime64[M]").astype("datetime64[D]").astype(np.int64) + pvt["day"] - 1
    of_day = pvt["hour"] * 3600.0 + pvt["minute"] * 60.0 + pvt["second"] + pvt["nano"] * NANO
    return np.where(known, midnight * DAY + of_day, np.nan)
