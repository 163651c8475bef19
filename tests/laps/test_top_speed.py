"""Top speed without the luck of the highest of many: what is drawn together, what is left alone; on simulated karts."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.analysis import without_laps
from smoother.laps.results import Lap
from smoother.laps.top_speed import shrunk_tops, smoothed_speed, top_speed
from smoother.trajectory import Trajectory

Made = Callable[..., Trajectory]


def straight(make: Made, speed: Array, sigma: Array | float | None) -> Trajectory:
    """A drive along a straight at `speed` (N,) m/s, 50 rows a second, as sure as `sigma` m/s."""
    t = 0.02 * np.arange(len(speed))
    north = np.concatenate([[0.0], np.cumsum(0.01 * (speed[1:] + speed[:-1]))])
    made = make(t, np.stack([north, np.zeros(len(t))], axis=1))
    velocity = np.stack([speed, np.zeros(len(t)), np.zeros(len(t))], axis=1)
    sigmas = made.sigmas if sigma is None else replace(made.sigmas, speed=np.broadcast_to(sigma, speed.shape).copy())
    return replace(made, velocity_n=velocity, sigmas=None if sigma is None else sigmas)


def laps_of(tops: Array) -> Array:
    """Speeds (N,) m/s of laps of 20 s, 50 rows a second, that reach `tops`."""
    beat = np.cos(2.0 * np.pi * np.arange(1000) / 1000.0)
    return np.concatenate([top - 8.0 + 8.0 * -beat for top in tops])


def test_of_an_even_driver_the_highest_peak_is_not_the_top_speed(make: Made) -> None:
    errors, highest = [], []
    for seed in range(30):
        rng = np.random.default_rng(seed)
        noise = 0.2 * rng.standard_normal(20)
        drive = straight(make, laps_of(30.0 + noise), 0.2)
        errors.append(top_speed(drive).speed - 30.0)
        highest.append(drive.speed.max() - 30.0)
        assert top_speed(drive).sigma == pytest.approx(0.2)
    assert np.mean(highest) > 0.3
    assert abs(np.mean(errors)) < 0.1
    assert np.sqrt(np.mean(np.square(errors))) < 0.15


def test_the_top_of_a_lap_that_may_be_the_same_is_that_of_the_session(make: Made) -> None:
    drive = straight(make, laps_of(30.0 + 0.2 * np.random.default_rng(0).standard_normal(20)), 0.2)
    laps, none = without_laps(drive), np.zeros(0)
    top = top_speed(drive).speed
    of_laps = [
        Lap(0, 0.0, 20.0, np.nan, np.nan, (), none, none, none, np.nan, 300.0, value, 5.0)
        for value in (top - 5.0, top - 0.15, np.nan)
    ]
    assert top_speed(drive, replace(laps, laps=tuple(of_laps))).speed == top - 0.15
    assert top_speed(drive, replace(laps, laps=(of_laps[0], of_laps[2]))).speed == top
    assert top_speed(drive, replace(laps, laps=())).speed == top


def test_tops_of_an_even_driver_are_drawn_together_but_never_one_and_the_same() -> None:
    tops = 30.0 + 0.1 * np.random.default_rng(3).standard_normal(12)
    likely = shrunk_tops(tops, np.full(12, 0.2))  # they scatter less than their noise: the likeliest spread is none
    np.testing.assert_array_equal(np.argsort(likely), np.argsort(tops))
    assert 0.05 < np.ptp(likely) / np.ptp(tops) < 0.5
    assert likely.mean() == pytest.approx(tops.mean())


def test_a_lap_that_was_faster_for_a_reason_keeps_its_top_speed(make: Made) -> None:
    tops = np.array([30.0, 30.1, 29.9, 33.0, 30.0, 30.1])
    assert top_speed(straight(make, laps_of(tops), 0.1)).speed == pytest.approx(33.0, abs=0.02)
    np.testing.assert_allclose(shrunk_tops(tops, np.full(6, 0.1))[[0, 3, 5]], [30.0, 33.0, 30.1], atol=0.005)


def test_a_peak_that_is_hardly_known_is_not_the_top_speed(make: Made) -> None:
    tops = np.array([30.0, 30.0, 32.0, 30.0])
    sigma = np.repeat([0.1, 0.1, 2.5, 0.1], 1000)
    assert top_speed(straight(make, laps_of(tops), sigma)).speed == pytest.approx(30.0, abs=0.1)


def test_noise_is_steadied_and_the_tip_before_the_brakes_is_not_blunted(make: Made) -> None:
    t = 0.02 * np.arange(1000)
    tip = np.where(t < 10.0, 20.0 + t, 30.0 - 9.0 * (t - 10.0))
    clean = smoothed_speed(tip, t)
    assert clean.max() == pytest.approx(30.0, abs=0.3)
    rough = np.full(1000, 30.0) + 0.2 * np.random.default_rng(1).standard_normal(1000)
    assert np.std(smoothed_speed(rough, t)) < 0.12


def test_without_sigmas_or_with_a_row_or_two_there_is_a_top_speed(make: Made) -> None:
    told = top_speed(straight(make, laps_of(np.array([30.0, 31.0])), None))
    assert told.speed == pytest.approx(31.0, abs=0.01) and np.isnan(told.sigma)
    assert np.isnan(top_speed(straight(make, np.full(5, 12.0), np.nan)).sigma)
    assert top_speed(straight(make, np.full(5, 12.0), 0.1)).speed == pytest.approx(12.0)
    np.testing.assert_array_equal(shrunk_tops(np.array([np.nan, 12.0]), np.array([np.nan, 0.1])), [np.nan, 12.0])
