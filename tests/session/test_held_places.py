"""Receivers that hold their place while the kart creeps, and those that hold it at rest."""

from pathlib import Path

import numpy as np
import pytest

from smoother.samples import GnssFixes, Problem
from smoother.session.csv_form import read_fixes

METRE = 1.0 / 111_195.0  # degrees of latitude
RATE = 5.0


def drive(creeps_from: float, creep: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and speeds of a kart that comes to rest, creeping for the last seconds at `creep` m/s, and drives on."""
    t = np.arange(0.0, 90.0, 1.0 / RATE)
    knots = [0.0, creeps_from - 6.0, creeps_from, creeps_from + 4.0, creeps_from + 4.5, 55.0, 62.0, 90.0]
    return t, np.interp(t, knots, [12.0, 12.0, creep, creep, 0.0, 0.0, 12.0, 12.0])


def read(directory: Path, t: np.ndarray, place: np.ndarray, speed: np.ndarray) -> tuple[GnssFixes, list[Problem]]:
    lines = [f"{a:.2f},{45.0 + p * METRE:.9f},12.0,{v:.3f},0.0" for a, p, v in zip(t, place, speed, strict=True)]
    (directory / "gps.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,speed_mps,course_deg", *lines]) + "\n")
    return read_fixes(directory / "gps.csv")


def held(place: np.ndarray, hold: np.ndarray) -> np.ndarray:
    """The places (N,) as they were when last not held."""
    return place[np.maximum.accumulate(np.where(hold, 0, np.arange(len(place))))]


def noisy(place: np.ndarray) -> np.ndarray:
    return place + 0.03 * np.random.default_rng(0).normal(size=len(place))


def test_a_place_that_is_held_while_the_kart_creeps_is_left_out_from_then_on(tmp_path: Path) -> None:
    """Static navigation: below 1.5 m/s the receiver shows no speed, and stays where it was."""
    t, speed = drive(30.0, 1.4)
    slow = speed < 1.5
    place = np.cumsum(speed) / RATE
    fixes, problems = read(tmp_path, t, held(noisy(place), slow), np.where(slow, 0.0, speed))
    assert [problem.code for problem in problems if problem.code == "gps_held"] == ["gps_held"]
    north = (fixes.lat_deg - 45.0) / METRE
    assert np.max(np.abs(north - np.interp(fixes.t, t, place))) < 0.5  # it was 6 m behind before it leapt
    assert len(fixes) == len(t) - np.count_nonzero(slow)


@pytest.mark.parametrize("wander", [0.5, 4.0])
def test_a_receiver_that_holds_its_place_at_rest_was_there(tmp_path: Path, wander: float) -> None:
    """It slows down with the kart, and when it lets go leaps by what it wandered meanwhile."""
    t, speed = drive(30.0, 0.3)
    rest = speed < 0.2
    wandered = wander * (t > t[rest][-1])
    place = noisy(np.cumsum(speed) / RATE + wandered)
    fixes, problems = read(tmp_path, t, held(place, rest), np.where(rest, 0.0, speed))
    assert len(fixes) == len(t)
    assert not [problem for problem in problems if problem.code == "gps_held"]


def test_places_on_a_coarse_grid_are_not_held(tmp_path: Path) -> None:
    t, speed = drive(30.0, 0.9)
    grid = 1e-4 / METRE  # four decimals of degrees: 11 m
    _, problems = read(tmp_path, t, np.round(np.cumsum(speed) / RATE / grid) * grid, speed)
    assert not [problem for problem in problems if problem.code == "gps_held"]
