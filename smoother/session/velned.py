"""NAV-VELNED, the velocity of a u-blox receiver with its accuracy, as it comes among NMEA sentences.

Source: u-blox 6 Receiver Description, GPS.G6-SW-10018, UBX-NAV-VELNED; the same up to u-blox 10.
"""

import struct
from array import array
from collections.abc import Iterable, Iterator

import numpy as np

from smoother.arrays import Array

HEAD = b"\xb5\x62\x01\x12\x24\x00"  # sync, class, number, length
BODY = struct.Struct("<IiiiIIiII")  # time of the week ms; north, east, down, speeds cm/s; course; accuracies
SUM_BYTES = 2
CENTI = 1e-2
ALONE_WITHIN = 0.5  # s from the only fix there is
COLUMNS = ("velocity_north", "velocity_east", "velocity_up", "sigma_velocity")


def message(week_ms: int, velocity_n: Array, sigma: float) -> bytes:
    """Return the message of a velocity (3,) m/s in n (north, west, up) with its sigma m/s."""
    north, west, up = (round(value / CENTI) for value in velocity_n.tolist())
    level = round(float(np.hypot(north, west)))
    course = round(float(np.degrees(np.arctan2(-west, north))) % 360.0 * 1e5)
    speed = round(float(np.hypot(level, up)))
    frame = HEAD + BODY.pack(week_ms, north, -west, -up, speed, level, course, round(sigma / CENTI), 0)
    return frame + _checksum(frame)


def _checksum(frame: bytes) -> bytes:
    """Fletcher's sum over all but the sync."""
    a = b = 0
    for byte in frame[2:]:
        a = (a + byte) & 0xFF
        b = (b + a) & 0xFF
    return bytes((a, b))


class Velocities:
    """The velocities among the sentences of a recording: t s, and COLUMNS in m/s, one after the other."""

    def __init__(self) -> None:
        self._t, self._values = array("d"), array("d")

    def extracted_from(self, received: Iterable[tuple[float, bytes]]) -> Iterator[tuple[float, bytes]]:
        """Yield pairs of receive time s and bytes that are no velocity, and keep those that are, if they are whole."""
        for t, data in received:
            if not data.startswith(HEAD):
                yield t, data
            elif len(data) == len(HEAD) + BODY.size + SUM_BYTES and _checksum(data[:-SUM_BYTES]) == data[-SUM_BYTES:]:
                _, north, east, down, _, _, _, sigma, _ = BODY.unpack_from(data, len(HEAD))
                self._t.append(t)
                self._values.extend((north * CENTI, east * CENTI, -down * CENTI, sigma * CENTI))

    def columns_at(self, t: Array) -> dict[str, Array]:
        """COLUMNS, each (N,), of the fixes at t (N,) s: what came nearest, if that is nearer than half a period."""
        values = np.full((t.size, len(COLUMNS)), np.nan)
        if self._t and t.size:
            own, rows = np.frombuffer(self._t), np.frombuffer(self._values).reshape(-1, len(COLUMNS))
            middle = 0.5 * (own[1:] + own[:-1])
            nearest = np.searchsorted(middle, t)
            within = 0.5 * np.median(np.diff(t)) if t.size > 1 else ALONE_WITHIN
            is_near = np.abs(own[nearest] - t) < within
            values[is_near] = rows[nearest[is_near]]
        return dict(zip(COLUMNS, values.T, strict=True))
