"""The result files of a session: trajectory.csv, baseline.csv, gps.csv and strict JSON.

Every file is written under a temporary name and renamed, so that no partial file is visible. Numbers are rounded
to a resolution well below any sensor's (1e-9 deg, 0.1 mm, 0.1 mm/s, 1e-4 deg), which halves the files.
Nothing is computed here: values missing in trajectory and session are written as NaN.
"""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, is_dataclass
from pathlib import Path

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.disc import pieces, release
from smoother.documents import replacing as replacing
from smoother.estimate.preprocess.clock import clock_of_fixes
from smoother.frames import Origin, nwu_to_geodetic
from smoother.laps.document import LapColumns
from smoother.samples import Channel, Session
from smoother.trajectory import FixResiduals, Sigmas, Trajectory
from smoother.units import DEG
from smoother.utc_clock import UtcClock

ANGLE_DIGITS = 9  # of latitude and longitude: 0.1 mm on the ground
DIGITS = 4
TOGETHER = 1 << 18  # rows that are written together, 90 MB of text

Columns = dict[str, Array]


def write_trajectory(
    path: Path,
    trajectory: Trajectory,
    origin: Origin,
    clock: UtcClock | None,
    laps: LapColumns | None = None,
    channels: Sequence[Channel] = (),
) -> None:
    """Write a trajectory, smoothed or baseline, with the columns of :func:`trajectory_table`; large ones in parts.

    channels : further logged quantities, one column each after the others.
    """
    with replacing(path) as temporary, temporary.open("wb") as file:
        for part in [*pieces(len(trajectory), TOGETHER)] or [slice(0)]:
            of_part = None if laps is None else (laps[0][part], laps[1][part])
            rows = trajectory.rows(part)
            table = trajectory_table(rows, origin, clock, of_part)
            logged = {channel.name: _rounded(channel.at(rows.t), DIGITS) for channel in channels}
            table = table.with_columns(pl.Series(name, values) for name, values in logged.items())
            table.write_csv(file, include_header=part.start in (None, 0))
            release(trajectory)


def write_fixes(path: Path, session: Session, residuals: FixResiduals | None) -> None:
    """Write the fixes of the session, with the residual and weight that the smoother gave to each."""
    write_csv(path, fixes_table(session, residuals))


def write_json(path: Path, document: object) -> None:
    """Write strict JSON: what is not a finite number is null."""
    with replacing(path) as temporary:
        temporary.write_text(to_json(document), encoding="utf-8", errors="replace")  # names of files may be none


def to_json(document: object) -> str:
    """Return strict, indented JSON of nested mappings, sequences, dataclasses, arrays and numbers; NaN becomes null."""
    return json.dumps(_plain(document), indent=2, allow_nan=False, ensure_ascii=False) + "\n"


def trajectory_table(
    trajectory: Trajectory, origin: Origin, clock: UtcClock | None, laps: LapColumns | None = None
) -> pl.DataFrame:
    """Return one row per time of the trajectory; units are in the column names, NaN where there is no estimate."""
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(_at_height(trajectory.position_n), origin)
    alt_m = np.where(np.isfinite(trajectory.position_n[:, 2]), alt_m, np.nan)
    roll_pitch_yaw_deg = _rounded(trajectory.euler / DEG, DIGITS)
    roll_pitch_yaw_deg[roll_pitch_yaw_deg[:, 2] == -180.0, 2] = 180.0  # rounding must not leave (-180, 180]
    motion: Columns = {
        "speed_mps": trajectory.speed,
        **_columns("{}_deg", ("roll", "pitch", "yaw"), roll_pitch_yaw_deg),
        **_columns("accel_{}_mps2", ("forward", "left", "up"), trajectory.acceleration_b),
        "yaw_rate_dps": trajectory.angular_rate_b[:, 2] / DEG,
    }
    sigmas = trajectory.sigmas if trajectory.sigmas is not None else _no_sigmas(len(trajectory))
    columns = {
        "alt_m": alt_m,
        **_columns("{}_m", ("north", "west", "up"), trajectory.position_n),
        **_columns("vel_{}_mps", ("north", "west", "up"), trajectory.velocity_n),
        **motion,
        **_sigma_columns(sigmas),
    }
    table = _table(trajectory.t, clock, lat_deg, lon_deg, columns)
    if laps is None:
        n = len(trajectory)
        laps = pl.Series("lap", [None] * n, dtype=pl.Int64), np.full(n, np.nan)
    return table.with_columns(laps[0].alias("lap"), pl.Series("lap_distance_m", _rounded(laps[1], DIGITS)))


def _at_height(position_n: Array) -> Array:
    """Positions (N, 3), those without a height at that of the origin: a hundred metres of it move none by 2e-5."""
    up = position_n[:, 2]
    return np.column_stack([position_n[:, :2], np.nan_to_num(up)]) if np.any(np.isnan(up)) else position_n


def fixes_table(session: Session, residuals: FixResiduals | None) -> pl.DataFrame:
    """Return one row per fix in the frame of the trajectory. Residual: prediction - measurement; weight 0..1.

    The prediction contains the identified constants of the receiver (latency, lever arm, slow error). Both are NaN
    for a fix that was not used.
    """
    fixes, n = session.gnss, len(session.gnss)
    residual_n, weight = np.full((n, 3), np.nan), np.full(n, np.nan)
    if residuals is not None:
        residual_n[residuals.index] = residuals.residual_n
        weight[residuals.index] = residuals.weight
    optional = {
        "speed_mps": fixes.speed,
        "course_deg": fixes.course_deg,
        "hacc_m": fixes.sigma_horizontal,
        "vacc_m": fixes.sigma_up,
        "sacc_mps": fixes.sigma_velocity,
    }
    columns = {
        "alt_m": fixes.alt_m,
        **_columns("{}_m", ("north", "west", "up"), session.fix_position_n),
        **_columns("vel_{}_mps", ("north", "west", "up"), fixes.velocity_n),
        **{name: value for name, value in optional.items() if value is not None},
        **_columns("residual_{}_m", ("north", "west", "up"), residual_n),
        "weight": weight,
    }
    return _table(fixes.t, clock_of_fixes(session), fixes.lat_deg, fixes.lon_deg, columns)


def _table(t: Array, clock: UtcClock | None, lat_deg: Array, lon_deg: Array, columns: Columns) -> pl.DataFrame:
    rounded = {name: _rounded(value, DIGITS) for name, value in columns.items()}
    return pl.DataFrame(
        {
            "t_s": _rounded(t, 6),
            "utc": _utc(t, clock),
            "lat_deg": _rounded(lat_deg, ANGLE_DIGITS),
            "lon_deg": _rounded(lon_deg, ANGLE_DIGITS),
            **rounded,
        }
    )


def _rounded(value: Array, digits: int) -> Array:
    return np.asarray(np.round(value, digits) + 0.0)  # + 0.0 turns -0.0 into 0.0


def _utc(t: Array, clock: UtcClock | None) -> pl.Series:
    """ISO 8601 to the millisecond, empty where the receiver gave no time."""
    if clock is None:
        return pl.Series("utc", [None] * len(t), dtype=pl.String)
    milliseconds = np.round(clock.at(t) * 1e3).astype(np.int64)
    return pl.Series("utc", milliseconds).cast(pl.Datetime("ms")).dt.strftime("%Y-%m-%dT%H:%M:%S%.3fZ")


def _columns(pattern: str, names: tuple[str, ...], values: Array) -> Columns:
    return {pattern.format(name): values[:, i] for i, name in enumerate(names)}


def _sigma_columns(sigmas: Sigmas) -> Columns:
    return {
        **_columns("sigma_{}_m", ("north", "west", "up"), sigmas.position_n),
        **_columns("sigma_vel_{}_mps", ("north", "west", "up"), sigmas.velocity_n),
        "sigma_speed_mps": sigmas.speed,
        **_columns("sigma_{}_deg", ("roll", "pitch", "yaw"), sigmas.attitude / DEG),
        "sigma_track_m": sigmas.track,
    }


def _no_sigmas(n: int) -> Sigmas:
    vector, scalar = np.full((n, 3), np.nan), np.full(n, np.nan)
    return Sigmas(vector, vector, scalar, vector, scalar)


def write_csv(path: Path, table: pl.DataFrame) -> None:
    """Write a table."""
    with replacing(path) as temporary, temporary.open("wb") as file:  # polars takes no path that is not UTF-8
        table.write_csv(file)


def _plain(value: object) -> object:
    if value is None or isinstance(value, (str, int)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    return str(value) if isinstance(value, Path) else value
