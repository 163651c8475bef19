"""What every format is given: blocks, rates, laps, delta; and results that are missing or damaged."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from smoother.errors import SessionError
from smoother.export import rows as rows_module
from smoother.export import vbo
from smoother.export.gates import timing_gates
from smoother.export.rows import Rows
from smoother.export.source import Source, open_source
from smoother.session.readers.vbo import own_lines, read_vbo

Factory = Callable[[Any, Path], Path]


def whole(source: Source) -> Rows:
    blocks = list(source.rows())
    return Rows({name: np.concatenate([block[name] for block in blocks]) for name in blocks[0].columns})


@pytest.mark.parametrize("rate", [None, 10.0, 12.5, 200.0])
def test_small_blocks_give_the_same_rows_as_one(
    results: Factory, scene: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, rate: float | None
) -> None:
    out = results(scene(), tmp_path)
    one = whole(open_source(out, rate))
    monkeypatch.setattr(rows_module, "BLOCK_BYTES", 700)  # two or three rows
    source = open_source(out, rate)
    many = whole(source)
    assert len(many) == source.count
    for name in one.columns:
        np.testing.assert_allclose(many[name], one[name], rtol=1e-12, atol=1e-9, err_msg=name)


@pytest.mark.parametrize("rate", [7.0, 33.3, 50.0, 180.0])
def test_another_rate_lies_on_the_circle(results: Factory, scene: Any, tmp_path: Path, rate: float) -> None:
    """Between rows 20 ms apart at 36 m/s^2 a straight line would be 1.8 mm off; the cubic is not."""
    circle = scene()
    rows = whole(open_source(results(circle, tmp_path), rate))
    np.testing.assert_allclose(np.diff(rows["t_s"]), 1.0 / rate, atol=2e-6)
    off = np.hypot(rows["north_m"], rows["west_m"] - circle.radius) - circle.radius
    assert np.max(np.abs(off)) < 2e-4
    yaw = np.radians(rows["yaw_deg"]) - circle.speed / circle.radius * (rows["t_s"] - circle.start)
    np.testing.assert_allclose(np.mod(yaw - 0.05 + np.pi, 2 * np.pi) - np.pi, 0.0, atol=1e-5)


def test_rows_outside_timed_laps_have_no_lap_and_the_best_lap_has_no_delta(
    results: Factory, scene: Any, tmp_path: Path
) -> None:
    circle = scene()
    source = open_source(results(circle, tmp_path))
    rows = whole(source)
    ends = circle.crossings()
    np.testing.assert_allclose(source.crossings, ends, atol=1e-6)
    in_laps = (rows["t_s"] >= ends[0]) & (rows["t_s"] < ends[-1])
    assert np.array_equal(np.isfinite(rows["lap"]), in_laps)
    np.testing.assert_allclose(
        rows["lap_time_s"][in_laps], np.mod(rows["t_s"] - ends[0], circle.lap_time)[in_laps], atol=2e-6
    )
    assert np.nanmax(np.abs(rows["delta_s"])) < 2e-3  # every lap is like the best; its distance is in millimetres


def test_a_lap_that_is_a_metre_behind_has_lost_the_time_of_a_metre(
    results: Factory, scene: Any, tmp_path: Path
) -> None:
    circle = scene()
    out = results(circle, tmp_path)
    frame = pl.read_csv(out / "trajectory.csv")
    behind = pl.when(pl.col("lap") == 2).then(pl.col("lap_distance_m") - 1.0).otherwise(pl.col("lap_distance_m"))
    frame.with_columns(lap_distance_m=behind).write_csv(out / "trajectory.csv")
    rows = whole(open_source(out))
    late = (rows["lap"] == 2) & (rows["lap_distance_m"] > 0.0)
    np.testing.assert_allclose(rows["delta_s"][late], 1.0 / circle.speed, atol=1e-3)


def test_without_inertial_sensor_the_acceleration_is_that_of_the_path(
    results: Factory, scene: Any, tmp_path: Path
) -> None:
    circle = scene(has_imu=False, turns_left=False)
    rows = whole(open_source(results(circle, tmp_path)))
    np.testing.assert_allclose(rows["accel_left_mps2"][1:-1], -(circle.speed**2) / circle.radius, rtol=2e-3)
    np.testing.assert_allclose(rows["accel_forward_mps2"][1:-1], 0.0, atol=0.05)
    np.testing.assert_allclose(rows["yaw_rate_dps"][1:-1], -np.degrees(circle.speed / circle.radius), rtol=2e-3)
    assert rows["distance_m"][-1] == pytest.approx(circle.speed * (circle.count - 1) / circle.rate, rel=1e-4)


def test_a_standing_kart_keeps_its_own_heading(results: Factory, scene: Any, tmp_path: Path) -> None:
    rows = whole(open_source(results(scene(speed=0.01, count=50), tmp_path)))
    np.testing.assert_allclose(rows["course_deg"], np.mod(-rows["yaw_deg"], 360.0), atol=1e-9)


def test_the_start_line_lies_across_the_track_where_laps_begin(results: Factory, scene: Any, tmp_path: Path) -> None:
    circle = scene()
    source = open_source(results(circle, tmp_path))
    start, sector = timing_gates(source)
    middle = 0.5 * (start.lat1_deg + start.lat2_deg), 0.5 * (start.lon1_deg + start.lon2_deg)
    rows = whole(source)
    at = int(np.argmin(np.abs(rows["t_s"] - circle.crossings()[0])))
    assert middle == pytest.approx((rows["lat_deg"][at], rows["lon_deg"][at]), abs=2e-6)
    assert start.lon1_deg == pytest.approx(start.lon2_deg, abs=1e-6)  # the kart goes west there: the line runs north
    assert start.lat1_deg < start.lat2_deg  # its left end first
    assert abs(start.lat1_deg - sector.lat1_deg) + abs(start.lon1_deg - sector.lon1_deg) > 1e-5


def test_a_program_that_times_the_vbo_by_its_own_line_finds_the_same_laps(
    results: Factory, scene: Any, tmp_path: Path
) -> None:
    circle = scene(radius=20.0, count=900)
    vbo.write(open_source(results(circle, tmp_path)), tmp_path / "x.vbo")
    reading = read_vbo(tmp_path / "x.vbo")
    (line, _), (split, _) = own_lines(tmp_path / "x.vbo")  # longitude first, as they are written
    assert (line.kind, split.kind) == ("start", "split")
    gnss = reading.gnss
    scale = np.array([1.0, np.cos(np.radians(gnss.lat_deg[0]))])
    left, right = np.array(line.first_deg) * scale, np.array(line.second_deg) * scale
    away = np.stack([gnss.lat_deg, gnss.lon_deg], axis=-1) * scale - left
    side = (right - left)[0] * away[:, 1] - (right - left)[1] * away[:, 0]
    near = np.hypot(*(away - 0.5 * (right - left)).T) < 1e-4  # 11 m: not the other side of the circle
    before = np.flatnonzero((side[:-1] * side[1:] < 0.0) & near[:-1])
    crossed = gnss.t[before] + np.diff(gnss.t)[before] * side[before] / (side[before] - side[before + 1])
    np.testing.assert_allclose(np.diff(crossed), circle.lap_time, atol=2e-3)


def test_results_without_laps_or_with_an_empty_table_have_none(results: Factory, scene: Any, tmp_path: Path) -> None:
    out = results(scene(laps=False), tmp_path)
    for text in (None, "", "lap,start_s,end_s,lap_time_s,lap_time_sigma_s,valid,reason\n"):
        if text is not None:
            (out / "laps.csv").write_text(text)
        source = open_source(out)
        assert source.laps == () and source.best is None and timing_gates(source) == []


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda out: (out / "trajectory.csv").unlink(), "cannot be read"),
        (lambda out: (out / "summary.json").unlink(), "cannot be read"),
        (lambda out: (out / "summary.json").write_text("{"), "damaged"),
        (lambda out: (out / "summary.json").write_text("[]"), "damaged"),
        (lambda out: (out / "trajectory.csv").write_text("t_s\n1\n"), "no column lat_deg"),
        (lambda out: truncate(out / "trajectory.csv", 1), "no rows"),
        (lambda out: replace_cell(out / "trajectory.csv", "x"), "damaged"),
        (lambda out: replace_cell(out / "trajectory.csv", "NaN"), "times do not increase"),
        (lambda out: repeat_row(out / "trajectory.csv"), "times do not increase"),
    ],
)
def test_damaged_results_are_one_line_with_a_remedy(
    results: Factory, scene: Any, tmp_path: Path, spoil: Callable[[Path], object], message: str
) -> None:
    out = results(scene(laps=False), tmp_path)
    spoil(out)
    with pytest.raises(SessionError, match=message) as error:
        open_source(out)
    assert "\n" not in str(error.value)


def truncate(path: Path, lines: int) -> None:
    path.write_text("\n".join(path.read_text().splitlines()[:lines]) + "\n")


def replace_cell(path: Path, text: str) -> None:
    lines = path.read_text().splitlines()
    lines[9] = f"{text},{lines[9].partition(',')[2]}"
    path.write_text("\n".join(lines))


def repeat_row(path: Path) -> None:
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:9], lines[8], *lines[9:]]))


def test_a_rate_that_makes_too_many_rows_is_refused(results: Factory, scene: Any, tmp_path: Path) -> None:
    out = results(scene(rate=1e-3, count=200, laps=False), tmp_path)  # 55 hours
    with pytest.raises(SessionError, match="rows at 1000 Hz; ask for fewer"):
        open_source(out, 1000.0)


def test_time_of_day_comes_from_utc_and_counts_from_1970_without(results: Factory, scene: Any, tmp_path: Path) -> None:
    known = open_source(results(scene(), tmp_path / "a"))
    assert known.has_utc and known.clock.at(0.0) == pytest.approx(scene().unix_at_zero, abs=6e-4)
    unknown = open_source(results(replace(scene(), unix_at_zero=None), tmp_path / "b"))
    assert not unknown.has_utc
    assert whole(unknown)["unix_s"][0] == 0.0
