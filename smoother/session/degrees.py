"""Positions that are not in degrees, or in the wrong columns: recognised by places off the Earth, and by velocities.

Nothing of a table is converted: a file of integers may count 1e-7 or 1e-6 of a degree, and a person knows which. What
is likely is named with its remedy, in place of a smooth track in the wrong sea.
"""

from collections.abc import Sequence

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.errors import SessionError
from smoother.session.checks.velocity import Ways, ways_of
from smoother.session.fix_columns import METRES_PER_DEGREE, FixColumns
from smoother.units import DEG

FEWEST_ROWS = 8
LARGEST = (90.0, 360.0)  # deg of latitude, of longitude
LARGEST_OF_MINUTES = (9000.0, 18000.0)  # of 90 and 180 degrees in NMEA's form, 9000.0 and 18000.0
BEYOND_ANY_UNIT = 1e10  # of a position as written; more is a damaged number, with which nothing can be computed
LEAST_COUNT = 1e5  # of a degree's 1e-5, 1e-6 or 1e-7; what is less is no integer form of any place
AGREES, DISAGREES = 0.3, 0.6  # of the velocity, off by less or more; a late fix in a hairpin is off by as much
STANDSTILL = 50.0  # m on which a kart without velocities does not drive, and which in radians are 3 km


def require_degrees(file: str, c: FixColumns) -> None:
    """Raise SessionError, with the likely cause and the remedy, where the positions of most rows are not in degrees."""
    rows = _rows_with_position(c)
    if rows.size < FEWEST_ROWS:
        return
    lat, lon = c.lat_deg[rows], c.lon_deg[rows]
    if cause := _cause_by_size(lat, lon) or _cause_by_way(c.take(rows)):
        example = f"lat_deg {lat[lat.size // 2]:.10g}, lon_deg {lon[lon.size // 2]:.10g}"
        raise SessionError(f"{file}: {example} {cause}")


def scale_by_way(c: FixColumns, scales: Sequence[tuple[float, float]]) -> tuple[float, float] | None:
    """Which of `scales` of latitude and longitude makes the way of the positions that of the velocities.

    None where it is as it stands, where none does, and where too few velocities are known.
    """
    c = c.take(_rows_with_position(c))
    ways = ways_of(c)
    if ways is None or _off_way(c, ways) < DISAGREES:
        return None
    lat, lon = float(np.median(np.abs(c.lat_deg))), float(np.median(np.abs(c.lon_deg)))
    on_earth = [(a, b) for a, b in scales if abs(a) * lat <= 90.0 and abs(b) * lon <= 180.0]
    return next((scale for scale in on_earth if _off_way(c, ways, *scale) < AGREES), None)


def _off_way(c: FixColumns, ways: Ways, lat_scale: float = 1.0, lon_scale: float = 1.0) -> float:
    """How far, as a share of it, the velocity of the positions, times the scales, mostly is off the one sent."""
    by_position = ways.by_position(lat_scale * c.lat_deg, lon_scale * c.lon_deg)
    return float(np.median(np.abs(by_position - ways.sent) / np.abs(ways.sent)))


def _rows_with_position(c: FixColumns) -> IntArray:
    known = (np.abs(c.lat_deg) < BEYOND_ANY_UNIT) & (np.abs(c.lon_deg) < BEYOND_ANY_UNIT)
    known &= ~((c.lat_deg == 0.0) & (c.lon_deg == 0.0))
    return np.flatnonzero(known)


_SWAPPED = "look swapped; exchange the names lat_deg and lon_deg in the header line"
_RADIANS = "look like radians; multiply both columns by 57.29577951"


def _cause_by_size(lat: Array, lon: Array) -> str:
    """What explains positions that are not on Earth; "" for those that are."""
    north, east = float(np.median(np.abs(lat))), float(np.median(np.abs(lon)))
    if north <= LARGEST[0] and east <= LARGEST[1]:
        return ""
    if north <= 2.0 * LARGEST[0] and east <= LARGEST[0]:
        return _SWAPPED
    if max(north, east) >= LEAST_COUNT and np.all(lat == np.round(lat)) and np.all(lon == np.round(lon)):
        return "look like integers of 1e-7 degrees (or 1e-6); divide both columns by 10000000 (or 1000000)"
    if north <= LARGEST_OF_MINUTES[0] and east <= LARGEST_OF_MINUTES[1] and _are_minutes(lat) and _are_minutes(lon):
        return (
            "look like NMEA's degrees and minutes (ddmm.mmmm); degrees are dd + mm.mmmm / 60, "
            "or give the sentences themselves, as *.nmea"
        )
    return "are no degrees on Earth; wanted are degrees with decimals, as 45.0451 and 12.1490"


def _are_minutes(value: Array) -> bool:
    return bool(np.all(np.mod(np.abs(value), 100.0) < 60.0))


def _cause_by_way(c: FixColumns) -> str:
    """Radians, where positions hardly move as degrees and drive as radians; else ""."""
    may_be_radians = bool(np.all(np.abs(c.lat_deg) <= 90.0 * DEG) and np.all(np.abs(c.lon_deg) <= 180.0 * DEG))
    return _RADIANS if may_be_radians and _stands_still(c) and not _stands_still(c, 1.0 / DEG) else ""


def _stands_still(c: FixColumns, scale: float = 1.0) -> bool:
    """Whether most positions, times `scale`, lie within STANDSTILL."""
    sizes = [np.subtract(*np.percentile(scale * v, [95.0, 5.0])) for v in (c.lat_deg, c.lon_deg)]
    return bool(max(sizes) * METRES_PER_DEGREE < STANDSTILL)
