"""contracts.md 3: wheel_speed.csv, `t_s, speed_mps`, optional: a factor of the graph, scale and slip identified."""

from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

TABLES_ONLY = ("--no-figures", "--no-baseline")
SCALE = 1.03


@pytest.fixture
def wheeled(short: Path, read: Any) -> Path:
    """The half minute with a wheel that counts 3 % too much."""
    truth = read(short / "truth.csv")
    speed = np.sqrt(sum(truth[f"vel_{axis}_mps"].to_numpy() ** 2 for axis in ("north", "west", "up")))
    noise = 0.02 * np.random.default_rng(1).standard_normal(len(speed))
    columns = {"t_s": truth["t_s"], "speed_mps": np.maximum(SCALE * speed + noise, 0.0)}
    pl.DataFrame(columns).write_csv(short / "wheel_speed.csv")
    return short


def test_scale_and_slip_of_a_wheel_are_identified(wheeled: Path, smooth: Any) -> None:
    document = smooth(wheeled, "--json", *TABLES_ONLY).document
    assert "wheel_speed.csv" in document["inputs"]
    found = document["identified"]
    scale = found["wheel_scale"]
    assert scale["observable"] and scale["source"] == "identified" and scale["sigma"] < 0.005
    assert abs(scale["value"] - (SCALE - 1.0)) < 3.0 * scale["sigma"]
    assert len(found["wheel_slip"]["value"]) == len(found["wheel_slip"]["sigma"]) == 2
    assert found["wheel_speed_noise"]["value"] < 0.1
    residuals = document["residuals"]["wheel_speed"]
    assert residuals["unit"] == "m/s" and residuals["count"] > 8


def test_bad_rows_of_a_wheel_are_dropped_counted_and_reported(wheeled: Path, smooth: Any) -> None:
    lines = (wheeled / "wheel_speed.csv").read_text().splitlines(keepends=True)
    for row, speed in ((50, "nan"), (51, "nan"), (52, ""), (100, "-3"), (101, "4000")):
        lines[row] = f"{lines[row].split(',')[0]},{speed}\n"
    lines[200], lines[201] = lines[201], lines[200]
    (wheeled / "wheel_speed.csv").write_text("".join(lines))
    document = smooth(wheeled, "--json", *TABLES_ONLY).document
    said = {p["code"]: p for p in document["problems"] if "wheel_speed.csv" in p["text"]}
    assert (said["wheel_speed_invalid"]["count"], said["wheel_speed_absurd"]["count"]) == (3, 2)
    assert "wheel_scale" in document["identified"]


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("t_s,speed_mps\n", "wheel_speed_unusable"),
        ("t_s,rpm\n0.1,3000\n", "wheel_speed_unusable"),
        ("t_s,speed_mps\n0.1,nan\n0.2,nan\n", "wheel_speed_empty"),
    ],
    ids=["no rows", "another column", "no number"],
)
def test_a_wheel_speed_without_a_usable_row_is_no_harm(
    short: Path, short_results: Path, smooth: Any, text: str, code: str
) -> None:
    (short / "wheel_speed.csv").write_text(text)
    printed = smooth(short, "--json", *TABLES_ONLY)
    assert printed.code == 0
    assert code in {problem["code"] for problem in printed.document["problems"]}
    assert (short / "smoothed" / "trajectory.csv").read_bytes() == (short_results / "trajectory.csv").read_bytes()


def test_a_wheel_speed_in_another_unit_is_reported_and_not_used(
    wheeled: Path, short_results: Path, smooth: Any, read: Any
) -> None:
    table = read(wheeled / "wheel_speed.csv")
    table.with_columns(speed_mps=3.6 * table["speed_mps"]).write_csv(wheeled / "wheel_speed.csv")
    printed = smooth(wheeled, "--json", *TABLES_ONLY)
    assert "wheel_speed_unlike" in {problem["code"] for problem in printed.document["problems"]}
    assert (wheeled / "smoothed" / "trajectory.csv").read_bytes() == (short_results / "trajectory.csv").read_bytes()


def test_a_wheel_speed_beside_fixes_alone_is_reported_and_not_used(wheeled: Path, smooth: Any) -> None:
    (wheeled / "imu.csv").unlink()
    printed = smooth(wheeled, "--json", *TABLES_ONLY)
    assert printed.code == 0
    assert "wheel_speed_unused" in {problem["code"] for problem in printed.document["problems"]}
