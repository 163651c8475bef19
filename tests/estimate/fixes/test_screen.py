"""The first look at fixes: displaced ones are out, driven ones are in."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from smoother.estimate.fixes.screen import plausible_positions, plausible_velocities

JUMPS = ((20.0, 21.0, 30.0), (50.0, 55.0, 20.0), (70.0, 73.0, -12.0), (80.0, 80.3, 50.0))


def screened(lap_fixes: Callable[..., Any], **changes: Any) -> tuple[np.ndarray, np.ndarray]:
    made = lap_fixes(**changes)
    session = made.session
    t, velocity_n = session.gnss.t, session.gnss.velocity_n
    good = plausible_positions(t, session.fix_position_n, velocity_n, plausible_velocities(t, velocity_n))
    return good, made.is_bad


@pytest.mark.parametrize("rate", [1.0, 5.0, 25.0])
@pytest.mark.parametrize("seed", range(3))
def test_jumps_of_seconds_are_found_where_doppler_speaks_against_them(
    lap_fixes: Callable[..., Any], rate: float, seed: int
) -> None:
    good, is_bad = screened(lap_fixes, seed=seed, rate=rate, jumps=JUMPS)
    np.testing.assert_array_equal(good, ~is_bad)


def test_jumps_are_found_without_doppler_when_fixes_come_quickly(lap_fixes: Callable[..., Any]) -> None:
    good, is_bad = screened(lap_fixes, rate=10.0, doppler=None, jumps=JUMPS)
    np.testing.assert_array_equal(good, ~is_bad)


@pytest.mark.parametrize("changes", [{"rate": 1.0}, {"rate": 5.0}, {"rate": 10.0, "doppler": None}])
@pytest.mark.parametrize("jump", [(1.0, 3.0, 20.0), (38.0, 40.0, 20.0), (55.0, 57.0, 20.0), (99.0, 101.0, 20.0)])
def test_jumps_beside_an_outage_and_at_the_ends_are_found_too(
    lap_fixes: Callable[..., Any], changes: dict[str, Any], jump: tuple[float, float, float]
) -> None:
    good, is_bad = screened(lap_fixes, jumps=(jump,), outages=((40.0, 55.0),), **changes)
    assert np.any(is_bad)
    np.testing.assert_array_equal(good, ~is_bad)


@pytest.mark.parametrize("seed", range(3))
def test_jumps_of_quick_fixes_that_scatter_by_more_than_a_metre_are_found(
    lap_fixes: Callable[..., Any], seed: int
) -> None:
    jumps = ((20.0, 21.0, 25.0), (50.0, 50.5, 25.0))
    good, is_bad = screened(lap_fixes, seed=seed, rate=25.0, doppler=None, white=(1.3, 1.3, 2.2), jumps=jumps)
    np.testing.assert_array_equal(good, ~is_bad)


@pytest.mark.parametrize("changes", [{"rate": 1.0, "doppler": None}, {"rate": 0.2}, {"rate": 10.0}, {"lag": 0.4}])
def test_a_kart_that_drives_is_not_an_outlier(lap_fixes: Callable[..., Any], changes: dict[str, Any]) -> None:
    good, _ = screened(lap_fixes, **changes)
    assert good.all()


def test_fixes_on_the_other_half_of_the_earth_are_out_even_at_the_start(lap_fixes: Callable[..., Any]) -> None:
    session = lap_fixes(doppler=None).session
    position = session.fix_position_n.copy()
    position[[0, 100, 101]] += 9.0e6
    t, velocity_n = session.gnss.t, session.gnss.velocity_n
    good = plausible_positions(t, position, velocity_n, plausible_velocities(t, velocity_n))
    assert np.flatnonzero(~good).tolist() == [0, 100, 101]


def test_single_absurd_velocities_are_out_and_unknown_ones_are_not_judged(lap_fixes: Callable[..., Any]) -> None:
    session = lap_fixes().session
    velocity = session.gnss.velocity_n.copy()
    velocity[[7, 250], :2] += 40.0
    velocity[300] = np.nan
    assert np.flatnonzero(~plausible_velocities(session.gnss.t, velocity)).tolist() == [7, 250]
