"""Recordings of others, through the command line: each ends with exit code 0 and a trajectory along its fixes."""

import json
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother.cli.main import run

SECONDS = 150.0  # of each recording, so that the whole suite stays quick
NAMES = [
    "kart_adria_first_half",
    "kart_lignano_racebox",
    "kart_massafinalese_racechrono",
    "car_hi600_rtk",
    "car_hi600_twin_a",
    "car_hi600_twin_b",
    "car_comma2k19",
    "bicycle_neo6m",
]
ON_THE_WHEEL = ("kart_adria_first_half", "kart_lignano_racebox")
GPS_ONLY = ("bicycle_neo6m", "kart_massafinalese_racechrono")


def beginning(source: Path, directory: Path) -> Path:
    """The first part of a recording, cut at the same time in every file."""
    directory.mkdir()
    start = pl.read_csv(source / "gps.csv", columns=["t_s"], infer_schema_length=None)["t_s"].min()
    assert isinstance(start, float)
    for name in ("imu.csv", "gps.csv", "mag.csv"):
        if (source / name).exists():
            table = pl.read_csv(source / name, infer_schema_length=None)
            table.filter(pl.col("t_s") < start + SECONDS).write_csv(directory / name)
    return directory


def distance_to_fixes(out: Path, latency: float) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal distance (m) of each row from the line through the fixes around it, and the allowed one.

    Rows are met where the receiver told of them, `latency` later; rows in gaps beyond 2 s have no fixes around them.
    """
    rows, fixes = pl.read_csv(out / "trajectory.csv"), pl.read_csv(out / "gps.csv").filter(pl.col("weight") > 0.5)
    t, t_fix = rows["t_s"].to_numpy() + latency, fixes["t_s"].to_numpy()
    after = np.searchsorted(t_fix, t)
    inside = (after > 0) & (after < len(t_fix))
    after = np.clip(after, 1, len(t_fix) - 1)
    near = inside & (t_fix[after] - t_fix[after - 1] < 2.0)
    gap = [rows[name].to_numpy() - np.interp(t, t_fix, fixes[name].to_numpy()) for name in ("north_m", "west_m")]
    hacc = np.nan_to_num(fixes["hacc_m"].to_numpy(), nan=0.0)
    allowed = np.maximum(5.0, 3.0 * np.maximum(hacc[after], hacc[after - 1]))
    return np.hypot(*gap)[near], allowed[near]


@pytest.mark.parametrize("name", NAMES)
def test_a_real_recording_ends_well_and_stays_with_its_fixes(name: str, data_directory: Path, tmp_path: Path) -> None:
    session = beginning(data_directory / name, tmp_path / name)
    assert run([str(session), "--no-figures", "--no-baseline"]) == 0
    summary = json.loads((session / "smoothed" / "summary.json").read_text())
    assert summary["mode"] == ("gps-only" if name in GPS_ONLY else "full")
    if name in GPS_ONLY:
        assert any("GPS alone" in problem["text"] for problem in summary["problems"])
    codes = {problem["code"] for problem in summary["problems"]}
    assert ("box_on_wheel" in codes) == (name in ON_THE_WHEEL)
    latency = summary["identified"]["gps_position_latency"]["value"]
    distance, allowed = distance_to_fixes(session / "smoothed", latency)
    assert distance.size > 1000
    assert np.all(distance <= allowed), float(np.max(distance - allowed))
