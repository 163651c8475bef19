"""Results of a kart going round in a circle, anywhere on Earth and at any time, as `smooth` would have written them."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother.frames import Origin, rotation_from_euler, wrap_angle
from smoother.report.files import write_trajectory
from smoother.trajectory import Sigmas, Trajectory
from smoother.utc_clock import UtcClock

LAP_HEADER = (
    "lap,start_s,end_s,lap_time_s,lap_time_sigma_s,valid,reason,sector1_s,sector1_sigma_s,sector2_s,sector2_sigma_s"
)


@dataclass(frozen=True)
class Scene:
    """A circle of `radius` m at `speed` m/s, to the left or right, from `start` s on the session clock."""

    lat_deg: float = 45.7
    lon_deg: float = 13.07
    alt_m: float = 4.0
    unix_at_zero: float | None = 1_775_907_141.25
    start: float = 3.5
    rate: float = 50.0
    count: int = 400
    speed: float = 12.0
    radius: float = 4.0
    turns_left: bool = True
    has_imu: bool = True
    laps: bool = True
    title: str = "Monday, second run"
    driver: str = "A. Driver"

    @property
    def lap_time(self) -> float:
        return 2.0 * np.pi * self.radius / self.speed

    def trajectory(self) -> Trajectory:
        t = self.start + np.arange(self.count) / self.rate
        sign = 1.0 if self.turns_left else -1.0
        angle = sign * self.speed / self.radius * (t - self.start)
        height = 0.5 * np.sin(0.5 * angle)
        around = sign * self.radius * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=-1)
        position = np.column_stack([around, height])
        climb = 0.25 * sign * self.speed / self.radius * np.cos(0.5 * angle)
        velocity = np.stack([self.speed * np.cos(angle), sign * self.speed * np.sin(sign * angle), climb], axis=-1)
        n, unknown = t.size, np.full((t.size, 3), np.nan)
        euler = np.stack([0.02 + 0.0 * angle, -0.03 + 0.0 * angle, wrap_angle(angle + 0.05)], axis=-1)
        centripetal = np.stack([0.3 + 0.0 * t, sign * self.speed**2 / self.radius + 0.0 * t, 0.1 + 0.0 * t], axis=-1)
        rate = np.stack([0.0 * t, 0.0 * t, sign * self.speed / self.radius + 0.0 * t], axis=-1)
        attitude = np.full((n, 3), 0.01) if self.has_imu else unknown
        return Trajectory(
            t=t,
            position_n=position,
            velocity_n=velocity,
            R_nb=rotation_from_euler(*euler.T) if self.has_imu else np.full((n, 3, 3), np.nan),
            acceleration_b=centripetal if self.has_imu else unknown,
            angular_rate_b=rate if self.has_imu else unknown,
            sigmas=Sigmas(
                np.full((n, 3), 1.5), np.full((n, 3), 0.1), np.full(n, 0.08), attitude, 0.1 + 0.001 * np.arange(n)
            ),
        )

    def crossings(self) -> list[float]:
        """Times at which the kart crosses a line a quarter of the way round."""
        first, last = self.start + 0.25 * self.lap_time, self.start + (self.count - 1) / self.rate
        return [first + i * self.lap_time for i in range(1000) if first + i * self.lap_time <= last]


def write_results(scene: Scene, directory: Path) -> Path:
    """Write trajectory.csv, summary.json and laps.csv into directory/smoothed, and return that."""
    out = directory / "smoothed"
    out.mkdir(parents=True, exist_ok=True)
    origin = Origin(scene.lat_deg, scene.lon_deg, scene.alt_m)
    clock = None if scene.unix_at_zero is None else UtcClock(scene.start, round(scene.unix_at_zero + scene.start, 3))
    write_trajectory(out / "trajectory.csv", scene.trajectory(), origin, clock)
    about = {"name": "monday", "title": scene.title, "driver": scene.driver, "kart": "KZ2", "track": "Circle"}
    about |= {} if clock is None else {"start_s": scene.start, **clock.as_summary()}
    document = {
        "session": about,
        "origin": {"lat_deg": origin.lat_deg, "lon_deg": origin.lon_deg, "alt_m": origin.alt_m},
        "quality": {"passed": True, "reasons": []},
    }
    (out / "summary.json").write_text(json.dumps(document), encoding="utf-8")
    (out / "gps.csv").write_text("t_s\n")
    if scene.laps:
        _write_laps(scene, out)
    return out


def _write_laps(scene: Scene, out: Path) -> None:
    ends, last = scene.crossings(), scene.start + (scene.count - 1) / scene.rate
    rows = [f"0,{scene.start},{ends[0]},,,false,out-lap,,,,"] if ends else []
    for i in range(len(ends) - 1):
        time = ends[i + 1] - ends[i]
        rows.append(
            f"{i + 1},{ends[i]:.6f},{ends[i + 1]:.6f},{time:.6f},0.012,true,,{time / 2:.6f},0.01,{time / 2:.6f},0.01"
        )
    rows += [f"{len(ends)},{ends[-1]},{last},,,false,in-lap,,,,"] if ends else []
    (out / "laps.csv").write_text("\n".join([LAP_HEADER, *rows]) + "\n")
    frame = pl.read_csv(out / "trajectory.csv", infer_schema=False)
    t = frame["t_s"].cast(pl.Float64).to_numpy()
    lap = np.searchsorted(ends, t, side="right")
    length = 2.0 * np.pi * scene.radius
    distance = np.mod((t - scene.start) * scene.speed - 0.25 * length, length)
    frame.with_columns(lap=pl.Series(lap), lap_distance_m=pl.Series(np.round(distance, 3))).write_csv(
        out / "trajectory.csv"
    )


@pytest.fixture(scope="session")
def results() -> Callable[[Scene, Path], Path]:
    return write_results


@pytest.fixture(scope="session")
def scene() -> type[Scene]:
    return Scene
