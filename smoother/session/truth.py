"""truth.csv to a Trajectory. Read by evaluation only, never by an estimator."""

from pathlib import Path

import numpy as np

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.frames import Origin, geodetic_to_nwu, rotation_from_euler
from smoother.session.rows import in_time_order
from smoother.session.tables import Table, read_table
from smoother.trajectory import Trajectory
from smoother.units import DEG

GEODETIC = ("lat_deg", "lon_deg")
LOCAL = ("north_m", "west_m", "up_m")
VELOCITY = ("vel_north_mps", "vel_west_mps", "vel_up_mps")
ANGLES = ("roll_deg", "pitch_deg", "yaw_deg")


def load_truth(directory: Path, origin: Origin) -> Trajectory:
    """Read truth.csv of a session: position of the antenna in n as placed by `origin`, NaN for what it does not say.

    Latitude and longitude are taken where they stand; north, west, up are relative to an origin of their own and
    taken, as if it were `origin`, only without them. Raises SessionError if there is no truth or no row of it usable.
    """
    path = next((directory / name for name in ("truth.csv", "truth.csv.gz") if (directory / name).is_file()), None)
    if path is None:
        raise SessionError(f"{directory}: no truth.csv; accuracy needs a reference")
    table = read_table(path, ("t_s",), (*GEODETIC, "alt_m", *LOCAL, *VELOCITY, *ANGLES))
    position_n = _position_n(table, origin)
    t = table.column("t_s")
    known = np.flatnonzero(np.isfinite(t) & np.all(np.isfinite(position_n[:, :2]), axis=1))
    ordered = in_time_order(t[known], position_n[known], file=path.name, prefix="truth")
    t, index = ordered.t, known[ordered.index]
    if t.size == 0:
        raise SessionError(f"{path.name}: no usable row; wanted t_s with lat_deg, lon_deg or north_m, west_m")
    unknown = np.full((t.size, 3), np.nan)
    return Trajectory(
        t=t,
        position_n=position_n[index],
        velocity_n=table.stack(*VELOCITY)[index],
        R_nb=rotation_from_euler(*(table.column(name)[index] * DEG for name in ANGLES)),
        acceleration_b=unknown,
        angular_rate_b=unknown,
    )


def _position_n(table: Table, origin: Origin) -> Array:
    """Position (N, 3) m in n, NaN where unknown."""
    if not all(name in table for name in GEODETIC):
        return table.stack(*LOCAL)
    lat, lon, alt = (table.column(name) for name in (*GEODETIC, "alt_m"))
    position_n = geodetic_to_nwu(lat, lon, np.where(np.isfinite(alt), alt, origin.alt_m), origin)
    position_n[~np.isfinite(alt), 2] = np.nan
    return position_n
