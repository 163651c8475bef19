"""Speeds in corners: what a place that is unsure makes of them, and the lowest of many rows."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.corner_speeds import SmoothSpeed, corner_speeds, smooth_speed, speed_at
from smoother.laps.results import FixPath, GivenLines, LapAnalysis, Traces
from smoother.trajectory import Trajectory

Made = Callable[..., Trajectory]
Fixes = Callable[..., FixPath]
WANDER, TAU = 2.0, 60.0  # m, s: of receivers in general, as the analysis takes it where a session says nothing


def braking_lap(place_sigma: float) -> tuple[SmoothSpeed, Traces]:
    """One lap that brakes from 30 m/s by 5 m/s^2 from 0 to 80 m, its places as sure as `place_sigma` m."""
    t = 0.02 * np.arange(150)
    speed = SmoothSpeed(t, 30.0 - 5.0 * t, np.full(150, 0.05))
    distance = np.arange(0.0, 81.0, 2.0)
    passed = np.interp(distance, 30.0 * t - 2.5 * t**2, t)[None, :]
    unknown = np.full(passed.shape, np.nan)
    fields = dict.fromkeys(Traces.__dataclass_fields__, unknown)
    fields |= {"distance": distance, "t": passed, "speed": np.interp(passed, t, speed.speed)}
    return speed, Traces(**{**fields, "place_sigma": np.full(passed.shape, place_sigma)})


def test_where_a_kart_brakes_a_metre_along_the_track_is_part_of_the_sigma_of_its_speed() -> None:
    speed, traces = braking_lap(place_sigma=1.0)
    value, sigma = speed_at(speed, traces, 40.0)
    assert value[0] == pytest.approx(np.sqrt(30.0**2 - 2.0 * 5.0 * 40.0), abs=0.02)
    assert sigma[0] == pytest.approx(np.hypot(0.05, 5.0 / value[0] * 1.0), rel=0.02)
    assert speed_at(*braking_lap(place_sigma=0.0), 40.0)[1][0] == pytest.approx(0.05)


def test_a_lap_that_was_not_at_a_place_has_no_speed_there_and_places_without_sigma_count_as_sure() -> None:
    speed, traces = braking_lap(place_sigma=np.nan)
    assert speed_at(speed, traces, 40.0)[1][0] == pytest.approx(0.05)
    missing = replace(traces, t=np.full(traces.t.shape, np.nan), speed=np.full(traces.t.shape, np.nan))
    seen = corner_speeds(speed, missing, 20.0, 60.0)
    assert all(np.isnan(values).all() for values in vars(seen).values())


def test_the_slowest_speed_is_not_that_of_one_noisy_row(make: Made) -> None:
    t = 0.02 * np.arange(1500)
    errors = []
    for seed in range(20):
        clean = 14.0 + 6.0 * np.cos(2.0 * np.pi * t / 30.0 * 3.0)
        noisy = clean + 0.2 * np.random.default_rng(seed).standard_normal(len(t))
        north = np.concatenate([[0.0], np.cumsum(0.01 * (clean[1:] + clean[:-1]))])
        drive = make(t, np.stack([north, np.zeros(len(t))], axis=1))
        drive = replace(drive, velocity_n=np.stack([noisy, 0.0 * t, 0.0 * t], axis=1))
        errors.append(smooth_speed(drive).speed.min() - 8.0)
        assert noisy.min() - 8.0 < -0.25
    assert -0.15 < np.mean(errors) < 0.05


def test_who_stands_is_not_slower_than_nothing(make: Made) -> None:
    t = 0.02 * np.arange(400)
    speed = np.maximum(0.0, 12.0 * np.abs(t - 4.0) - 12.0)
    drive = make(t, np.stack([np.cumsum(0.02 * speed), 0.0 * t], axis=1))
    assert smooth_speed(replace(drive, velocity_n=np.stack([speed, 0.0 * t, 0.0 * t], axis=1))).speed.min() == 0.0


def wandered(driven: Trajectory, seed: int) -> Trajectory:
    """A drive whose positions wander as those of a GPS do, and whose speeds are true to 2 cm/s."""
    rng, step = np.random.default_rng(seed), driven.t[1] - driven.t[0]
    keeps = np.exp(-step / TAU)
    off = np.empty((len(driven), 2))
    off[0] = WANDER * rng.standard_normal(2)
    for k, noise in enumerate(WANDER * np.sqrt(1.0 - keeps**2) * rng.standard_normal((len(driven) - 1, 2))):
        off[k + 1] = keeps * off[k] + noise
    assert driven.sigmas is not None
    return replace(
        driven,
        position_n=driven.position_n + np.column_stack([off, np.zeros(len(off))]),
        sigmas=replace(driven.sigmas, speed=np.full(len(driven), 0.02)),
    )


def test_speeds_and_braking_points_are_as_sure_as_they_say_where_the_gps_wanders(
    driven: Trajectory, fixes: Fixes
) -> None:
    names = ("entry_speed", "exit_speed", "braking_point")
    z: dict[str, list[float]] = {name: [] for name in names}
    for seed in range(12):
        estimate = wandered(driven, seed)
        found = analyse(estimate, fixes(estimate))
        true = _on_the_same_line(driven, estimate, found, fixes)
        valid = np.array([lap.is_valid for lap in found.laps])
        for seen, corner in zip(found.corners, true.corners, strict=True):
            for name in names:
                sigma: Array = getattr(seen, "braking_sigma" if name == "braking_point" else f"{name}_sigma")
                z[name] += ((getattr(seen, name) - getattr(corner, name)) / sigma)[valid].tolist()
    for name in names:
        known = np.array(z[name])[np.isfinite(z[name])]
        assert len(known) > 150
        assert 0.75 < np.sqrt(np.mean(known**2)) < 1.2, name


def _on_the_same_line(driven: Trajectory, estimate: Trajectory, found: LapAnalysis, fixes: Fixes) -> LapAnalysis:
    """The true drive, moved by what the estimate lies beside it in the mean, on the line of the estimate's laps."""
    off = np.mean(estimate.position_n - driven.position_n, axis=0)
    moved = replace(driven, position_n=driven.position_n + off)
    assert found.start_line is not None
    lines = GivenLines(np.stack([found.start_line.left_n, found.start_line.right_n]))
    return analyse(moved, fixes(moved), LapOptions(lines=lines, reference=found.reference))
