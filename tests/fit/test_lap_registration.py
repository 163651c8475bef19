"""Wander of fixes from laps: against a process that is known, whatever the driver does."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from smoother import api
from smoother.arrays import Array
from smoother.fit.lap_crossings import LapCrossings, cross_stations
from smoother.fit.lap_registration import register_laps, registered

LENGTH, STATIONS = 900.0, 90
LAP = 50.0  # s
WANDERS = [(0.5, 60.0), (1.5, 60.0), (1.5, 200.0)]
RECORDED = {  # change over a lap, m: least and most
    "kart_okc_doves": (0.13, 0.30),
    "kart_massafinalese_racechrono": (0.27, 0.52),
    "kart_lignano_racebox": (0.06, 0.20),
    "kart_adria_first_half": (0.22, 0.60),
}


def gauss_markov(t: Array, sigma: float, tau: float, rng: np.random.Generator) -> Array:
    """A process (N, 2) at times t (N,) s."""
    apart = np.abs(t[:, None] - t)
    root = np.linalg.cholesky(sigma**2 * np.exp(-apart / tau) + 1e-9 * np.eye(len(t)))
    return np.asarray(root @ rng.standard_normal((len(t), 2)))


def driver(laps: int, rng: np.random.Generator) -> Array:
    """Offsets (n, J) m of a driver, 0.4 m rms, that last for some 30 m."""
    kernel = np.exp(-0.5 * (np.arange(-10, 11) * LENGTH / STATIONS / 20.0) ** 2)
    white = rng.standard_normal((laps, STATIONS + 20))
    smooth = np.array([np.convolve(row, kernel, mode="valid") for row in white])
    return np.asarray(0.4 * smooth / np.sqrt(np.sum(kernel**2)))


def laps_with(sigma: float, tau: float, seed: int, laps: int = 10) -> LapCrossings:
    """Laps of a round track by a driver, with wander."""
    rng = np.random.default_rng(seed)
    angle = 2.0 * np.pi * np.arange(STATIONS) / STATIONS
    normal_n = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    time = LAP * (np.arange(laps)[:, None] + np.arange(STATIONS) / STATIONS)
    wander = gauss_markov(time.ravel(), sigma, tau, rng).reshape(laps, STATIONS, 2)
    offset = driver(laps, rng) + np.einsum("nja,ja->nj", wander, normal_n)
    return LapCrossings(offset, time, normal_n, angle / (2.0 * np.pi) * LENGTH, LENGTH, LAP)


def true_change(sigma: float, tau: float) -> float:
    return float(sigma * np.sqrt(-2.0 * np.expm1(-LAP / tau)))


@pytest.mark.parametrize(("sigma", "tau"), WANDERS)
def test_the_change_over_a_lap_is_that_of_the_process_and_its_sigma_honest(sigma: float, tau: float) -> None:
    found = [registered(laps_with(sigma, tau, seed)) for seed in range(12)]
    error = np.log([f.change / true_change(sigma, tau) for f in found])
    assert abs(error.mean()) < 0.2
    assert error.std() < 0.35
    assert 0.5 < np.sqrt(np.mean((error / [f.change_spread for f in found]) ** 2)) < 1.6


def test_a_driver_alone_is_not_taken_for_wander() -> None:
    found = [registered(laps_with(1e-4, 60.0, seed)) for seed in range(12)]
    assert np.exp(np.mean(np.log([f.change for f in found]))) < 0.12
    moved = np.sqrt(np.mean([np.sum(f.translation_n**2) / (2 * (f.laps - 1)) for f in found]))
    assert np.sqrt(np.mean([f.noise**2 for f in found])) == pytest.approx(moved, rel=0.15)


def test_corners_driven_another_way_do_not_move_a_lap() -> None:
    crossings = laps_with(0.5, 60.0, 3)
    offset = crossings.offset.copy()
    offset[2, 10:16], offset[5, 40:50], offset[7:, 70:76] = 6.0, np.nan, -4.0
    one, two = registered(crossings), registered(dataclasses.replace(crossings, offset=offset))
    np.testing.assert_allclose(two.translation_n, one.translation_n, atol=0.25)
    assert two.change == pytest.approx(one.change, rel=0.3)


def oval(laps: float, *, reverse: bool = False, lap_to_lap: float = 0.0) -> tuple[Array, Array]:
    """Fixes at 10 Hz of a kart at 15 m/s on a track of two straights, which are 20 m apart."""
    straight, radius = 150.0, 10.0
    length = 2.0 * straight + 2.0 * np.pi * radius
    t = np.arange(0.0, laps * length / 15.0, 0.1)
    s = np.mod(15.0 * t, length)
    turn = np.pi * radius
    legs = [straight, straight + turn, 2.0 * straight + turn]
    one, two = (s - legs[0]) / radius, (s - legs[2]) / radius
    zero = np.zeros_like(s)
    parts = [
        (s, zero),
        (straight + radius * np.sin(one), radius - radius * np.cos(one)),
        (straight - (s - legs[1]), zero + 2.0 * radius),
        (-radius * np.sin(two), radius + radius * np.cos(two)),
    ]
    on = [s < legs[0], s < legs[1], s < legs[2]]
    north, west = (np.select(on, [leg[i] for leg in parts[:3]], parts[3][i]) for i in (0, 1))
    position_n = np.stack([north, west], axis=1)
    position_n += lap_to_lap * np.floor(15.0 * t / length)[:, None] * np.array([0.6, 0.8])
    return t, position_n[::-1] if reverse else position_n


def test_laps_are_found_and_their_translations_are_those_of_the_fixes() -> None:
    found = register_laps(*oval(8.4, lap_to_lap=0.5))
    assert found is not None
    assert found.laps in (7, 8)
    np.testing.assert_allclose(np.diff(found.translation_n, axis=0).mean(axis=0), [0.3, 0.4], atol=0.04)


def test_the_other_direction_gives_no_lap() -> None:
    t, there = oval(6.0)
    later, back = oval(5.0, reverse=True)
    found = register_laps(np.concatenate([t, later + t[-1] + 30.0]), np.concatenate([there, back]))
    assert found is not None
    assert found.laps <= 6
    assert np.max(np.abs(found.translation_n)) < 0.05


def test_holes_and_unknown_positions_are_no_crossings() -> None:
    t, position_n = oval(6.0)
    position_n[100:130] = np.nan
    keep = (t < 56.5) | (t > 59.0)  # out of the first bend
    crossings = cross_stations(t[keep], position_n[keep])
    assert crossings is not None
    assert np.isnan(crossings.offset).any()
    assert np.nanmax(np.abs(crossings.offset - np.nanmedian(crossings.offset, axis=0))) < 0.1


@pytest.mark.parametrize(("laps", "every"), [(3.5, 1), (8.0, 5)])
def test_few_laps_or_rare_fixes_show_nothing(laps: float, every: int) -> None:
    t, position_n = oval(laps)
    assert register_laps(t[::every], position_n[::every]) is None


def test_nothing_comes_of_no_fixes() -> None:
    assert register_laps(np.zeros(0), np.zeros((0, 2))) is None


@pytest.mark.slow
@pytest.mark.skipif("SMOOTH_DATA" not in os.environ, reason="SMOOTH_DATA is not set")
@pytest.mark.parametrize("name", RECORDED)
def test_real_receivers_change_by_decimetres(name: str) -> None:
    session = api.read(Path(os.environ["SMOOTH_DATA"]) / name)
    at = [register_laps(session.gnss.t, session.fix_position_n[:, :2], spacing) for spacing in (5.0, 10.0, 15.0)]
    changes = [found.change for found in at if found is not None]
    assert len(changes) == 3
    assert RECORDED[name][0] < changes[1] < RECORDED[name][1]
    assert max(changes) < 1.35 * min(changes)
