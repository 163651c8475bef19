"""The columns every reader of fixes fills, as checks see them, and their positions in rough metres."""

from dataclasses import dataclass, fields, replace

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.session.checks.table import OneStream

ABSURD_SPEED = 150.0  # m/s, 540 km/h
METRES_PER_DEGREE = 111_195.0  # of latitude; good to 0.5 %, enough for screening


@dataclass(frozen=True, eq=False)
class FixColumns:
    """Raw columns of N rows, each (N,), NaN where unknown. Units as in GnssFixes; velocities in m/s.

    fix : quality, 0 or less is no fix.
    """

    t: Array
    lat_deg: Array
    lon_deg: Array
    alt_m: Array
    speed: Array
    course_deg: Array
    velocity_north: Array
    velocity_east: Array
    velocity_up: Array
    sigma_horizontal: Array
    sigma_up: Array
    sigma_velocity: Array
    hdop: Array
    num_sv: Array
    fix: Array
    unix_s: Array

    @property
    def is_blank(self) -> BoolArray:
        """Mask (N,) of the rows without any position."""
        return np.asarray(~np.isfinite(self.lat_deg) & ~np.isfinite(self.lon_deg))

    def take(self, index: IntArray) -> "FixColumns":
        """Return the rows at `index`."""
        return FixColumns(**{column.name: getattr(self, column.name)[index] for column in fields(self)})

    def at(self, t: Array) -> "FixColumns":
        """Return the same rows at other times t (N,) s."""
        return replace(self, t=t)


def sent_speed(c: FixColumns) -> Array:
    """Horizontal speed (N,) m/s as sent, alone or in components; NaN where neither was."""
    return np.where(np.isfinite(c.speed), c.speed, np.hypot(c.velocity_north, c.velocity_east))


def fix_columns(t: Array, lat_deg: Array, lon_deg: Array, **known: Array) -> FixColumns:
    """Columns (N,) of fixes of which the others than `known`, by their names, are unknown."""
    unknown = np.full(t.size, np.nan)
    columns = {column.name: unknown for column in fields(FixColumns)}
    return FixColumns(**{**columns, "t": t, "lat_deg": lat_deg, "lon_deg": lon_deg, **known})


def metres(c: FixColumns) -> tuple[Array, Array]:
    """North and east (N,) in metres, rough, relative to the first row; continuous across 180 degrees of longitude."""
    if c.t.size == 0:
        return c.t, c.t
    east = np.mod(c.lon_deg - c.lon_deg[0] + 180.0, 360.0) - 180.0
    return (c.lat_deg - c.lat_deg[0]) * METRES_PER_DEGREE, east * METRES_PER_DEGREE * np.cos(np.radians(c.lat_deg))


def way_from_before(c: FixColumns) -> Array:
    """Metres (N,) from the fix before to each, 0 for the first one; what fixes scatter by is in it."""
    north, east = metres(c)
    return np.append(0.0, np.hypot(np.diff(north), np.diff(east)))


@dataclass(frozen=True, eq=False)
class FixRows(OneStream):
    """Columns of fixes of one file.

    has_rows_between : whoever read the file left out rows that its exporter interpolated between fixes.
    """

    has_rows_between: bool = False

    @property
    def columns(self) -> FixColumns:
        """The rows."""
        columns: FixColumns = self.rows
        return columns
