"""What is reported of the noise and the wander of fixes, and how unsure it is said to be."""

import math

import numpy as np
import pytest

from smoother.estimate.fixes.offset import OffsetModel
from smoother.estimate.fixes.reported_noise import hidden_wander, noise_of_fixes, scatter_of_fixes, wander_of_fixes

WHITE, STILL = np.array([2.0, 2.0, 4.0]), np.zeros(3)


def test_white_noise_hides_a_wander_below_the_sigma_of_its_mean() -> None:
    """Three hundred fixes in the time over which it is forgotten, in a session that goes on for ever."""
    hidden = hidden_wander(WHITE, STILL, 0.2, math.inf, 60.0)
    assert hidden == pytest.approx(WHITE / math.sqrt(300.0))
    rare = hidden_wander(WHITE, STILL, 100.0, math.inf, 60.0)
    assert rare == pytest.approx(WHITE)  # one fix hides no more than its own noise


def test_doppler_that_is_added_up_hides_a_tenth_of_its_walk() -> None:
    noise = np.array([0.5, 0.5, 1.0])
    walk = noise**2 * 0.2  # m^2/s
    hidden = hidden_wander(STILL, noise, 0.2, math.inf, 60.0)
    assert hidden == pytest.approx(np.sqrt(0.1 * walk * 60.0 / 2.0))  # of a Gauss-Markov process that walks so


def test_a_short_session_may_show_less_by_chance() -> None:
    long, ten_times, once = (hidden_wander(WHITE, STILL, 0.2, lasts, 60.0) for lasts in (math.inf, 600.0, 60.0))
    assert ten_times / long == pytest.approx(np.full(3, math.sqrt(2.0)))
    assert once / long == pytest.approx(np.full(3, math.sqrt(11.0)))


@pytest.mark.parametrize(("spread", "share", "source"), [(math.inf, 0.5, "default"), (0.2, 0.2, "identified")])
def test_a_wander_that_a_session_shows_has_the_sigma_of_its_length(spread: float, share: float, source: str) -> None:
    found = wander_of_fixes(OffsetModel(WHITE, 60.0, spread), np.full(3, 0.1))
    assert found["gps_offset_sigma"].sigma == pytest.approx(np.hypot(share * WHITE, 0.1))
    assert found["gps_offset_tau"].sigma == pytest.approx(60.0 * min(spread, 0.6))
    assert {value.source for value in found.values()} == {source}


def test_noise_that_is_not_observable_is_that_of_any_receiver() -> None:
    told, untold = (noise_of_fixes(np.full(3, 0.1), np.full(3, spread), "m") for spread in (0.05, 0.7))
    assert (told.observable, told.source, untold.observable, untold.source) == (True, "identified", False, "default")
    assert told.sigma == pytest.approx(np.full(3, math.hypot(0.005, 0.01 + 0.3 * (0.05 / 0.7) ** 2)))
    assert untold.sigma == pytest.approx(np.full(3, math.hypot(0.07, 0.31)))


def test_the_way_between_keyframes_is_no_noise_down_to_a_digit() -> None:
    found = scatter_of_fixes(np.array([0.5, 0.5, 0.1]), np.full(3, 0.1), np.array([0.09, 0.09, 1.0]), 0.02)
    assert found.value == pytest.approx([0.4, 0.4, 0.02])
    assert isinstance(found.sigma, list)
    assert found.sigma[0] > 0.05  # half of what was taken off
