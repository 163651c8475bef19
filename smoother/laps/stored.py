"""Results read from their files, for lap analysis without smoothing again."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.frames import Origin, geodetic_to_nwu, rotation_from_euler
from smoother.laps.results import FixPath
from smoother.laps.sigma import Drift
from smoother.samples import Channel, Problem
from smoother.trajectory import EstimateReport, Identified, Sigmas, Trajectory
from smoother.units import DEG
from smoother.utc_clock import UtcClock

LAST_COLUMN = "lap_distance_m"  # the last column of the trajectory; channels of the logger follow
AXES = ("north", "west", "up")


@dataclass(frozen=True, eq=False)
class Stored:
    """The results of one session: trajectory and fixes in the n of `origin`, drift of the position error if stored.

    document: summary.json. clock: of the time of day, None where unknown.
    """

    trajectory: Trajectory
    fixes: FixPath
    origin: Origin
    drift: Drift | None
    clock: UtcClock | None
    document: dict[str, Any]
    channels: tuple[Channel, ...] = ()

    @property
    def rate(self) -> float:
        """Rows a second, Hz."""
        t = self.trajectory.t
        return 1.0 / float(np.median(np.diff(t))) if len(t) > 1 else 0.0


def read_stored(directory: Path, origin: Origin | None = None) -> Stored:
    """Read the results in `directory`, in the n of `origin` (None: their own). Raises SessionError where damaged."""
    try:
        document = json.loads((directory / "summary.json").read_text(encoding="utf-8"))
        place = document["origin"]
        own = Origin(float(place["lat_deg"]), float(place["lon_deg"]), float(place["alt_m"]))
        rows, fixes = (_columns(directory / name) for name in ("trajectory.csv", "gps.csv"))
        trajectory = _trajectory(rows, document, own, origin or own)
        path = _fixes(fixes, origin or own)
        clock = UtcClock.of_summary(document["session"])
    except (OSError, ValueError, KeyError, TypeError, pl.exceptions.PolarsError) as error:
        raise SessionError(f"{directory}: damaged results ({error}); smooth the session again") from error
    channels = tuple(_channel(name, rows) for name in list(rows)[list(rows).index(LAST_COLUMN) + 1 :])
    return Stored(trajectory, path, origin or own, stored_drift(document), clock, document, channels)


def _channel(name: str, rows: dict[str, Array]) -> Channel:
    """A channel of the logger, where it is known."""
    known = np.isfinite(rows[name])
    return Channel(name, "", rows["t_s"][known], rows[name][known])


def stored_drift(document: dict[str, Any]) -> Drift | None:
    """Return how the position error changes with time, from summary.json; None without it."""
    drift = (document.get("lap_analysis") or {}).get("position_drift")
    if not drift:
        return None
    return Drift(np.array(drift["lag_s"]), np.array(drift["change_m"]), float(drift["absolute_m"]))


def _columns(path: Path) -> dict[str, Array]:
    with path.open("rb") as file:  # polars takes no path that is not UTF-8
        table = pl.read_csv(file, infer_schema=False)
    return {
        name: table[name].cast(pl.Float64, strict=False).fill_null(np.nan).to_numpy()
        for name in table.columns
        if name != "utc"
    }


def _trajectory(rows: dict[str, Array], document: dict[str, Any], own: Origin, origin: Origin) -> Trajectory:
    roll, pitch, yaw = (rows[f"{name}_deg"] * DEG for name in ("roll", "pitch", "yaw"))
    n = len(roll)
    position = np.stack([rows[f"{axis}_m"] for axis in AXES], axis=1)
    if origin != own:
        position = geodetic_to_nwu(rows["lat_deg"], rows["lon_deg"], rows["alt_m"], origin)
    rate = np.stack([np.zeros(n), np.zeros(n), rows["yaw_rate_dps"] * DEG], axis=1)
    return Trajectory(
        t=rows["t_s"],
        position_n=position,
        velocity_n=np.stack([rows[f"vel_{axis}_mps"] for axis in AXES], axis=1),
        R_nb=rotation_from_euler(roll, pitch, yaw),
        acceleration_b=np.stack([rows[f"accel_{axis}_mps2"] for axis in ("forward", "left", "up")], axis=1),
        angular_rate_b=rate,
        sigmas=Sigmas(
            np.stack([rows[f"sigma_{axis}_m"] for axis in AXES], axis=1),
            np.stack([rows[f"sigma_vel_{axis}_mps"] for axis in AXES], axis=1),
            rows["sigma_speed_mps"],
            np.stack([rows[f"sigma_{name}_deg"] * DEG for name in ("roll", "pitch", "yaw")], axis=1),
            rows["sigma_track_m"],
        ),
        report=EstimateReport(
            identified=_identified(document),
            problems=tuple(Problem(str(p["code"]), str(p["text"])) for p in document.get("problems") or ()),
            mode=str(document.get("mode", "full")),
        ),
    )


def _identified(document: dict[str, Any]) -> dict[str, Identified]:
    known = {}
    for name, entry in (document.get("identified") or {}).items():
        if entry.get("value") is not None:
            known[name] = Identified(
                entry["value"], entry.get("sigma"), str(entry["unit"]), bool(entry["observable"]), str(entry["source"])
            )
    return known


def _fixes(rows: dict[str, Array], origin: Origin) -> FixPath:
    position = geodetic_to_nwu(rows["lat_deg"], rows["lon_deg"], np.full(len(rows["t_s"]), origin.alt_m), origin)
    known = np.isfinite(position[:, :2]).all(axis=1)
    return FixPath(rows["t_s"][known], position[known, :2])
