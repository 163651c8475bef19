"""Heights that jump as no kart climbs: left out and said."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.session.checks.columns import FixRows
from smoother.session.checks.fixes import PATH_CHECKS
from smoother.session.checks.table import run
from smoother.session.fix_columns import METRES_PER_DEGREE, fix_columns

T = np.arange(600) / 5.0


def track() -> Array:
    return 100.0 + 5.0 * np.sin(T / 10.0) + np.random.default_rng(3).standard_normal(T.size)


def mended(alt_m: Array, t: Array = T, speed: float = 15.0) -> tuple[Array, dict[str, int]]:
    """Heights that are left of fixes on the way north, and what is said of them."""
    columns = fix_columns(t, 45.0 + speed * t / METRES_PER_DEGREE, np.full(t.size, 12.0), alt_m=alt_m)
    checks = [check for check in PATH_CHECKS if check.code.startswith("gps_height")]
    rows, problems = run(checks, FixRows(columns, "gps.csv"))
    return rows.columns.alt_m, {problem.code: problem.count for problem in problems}


def test_heights_of_a_track_stay_as_they_are() -> None:
    heights = track()
    heights[40:50] = np.nan
    out, said = mended(heights)
    assert out is heights and not said


@pytest.mark.parametrize("rows", [slice(300, 301), slice(300, 307), slice(0, 3), slice(598, 600)])
@pytest.mark.parametrize("size", [400.0, -400.0, 70.0])
def test_single_heights_far_from_the_others_are_left_out(rows: slice, size: float) -> None:
    heights = track()
    heights[rows] += size
    out, said = mended(heights)
    count = np.arange(600)[rows].size
    assert said == {"gps_height_jump": count} and np.isnan(out[rows]).all()
    np.testing.assert_array_equal(np.delete(out, rows), np.delete(track(), rows))


@pytest.mark.parametrize("rows", [slice(350, 600), slice(0, 200), slice(200, 260)])
def test_heights_that_are_measured_from_elsewhere_are_left_out(rows: slice) -> None:
    heights = track()
    heights[rows] += 400.0
    out, said = mended(heights)
    assert said == {"gps_height_jump": np.arange(600)[rows].size}
    np.testing.assert_array_equal(np.isnan(out), np.isin(np.arange(600), np.arange(600)[rows]))


def test_a_long_pause_may_lie_on_a_hill() -> None:
    t = T + np.where(np.arange(600) < 300, 0.0, 60.0)
    heights = track()
    heights[300:] += 400.0
    assert mended(heights, t)[1] == {}


def test_nothing_but_jumps_ends_in_no_height_and_not_in_an_error() -> None:
    out, said = mended(np.where(np.arange(600) % 2 == 0, 0.0, 400.0))
    assert said and np.unique(out[np.isfinite(out)]).size <= 1
    assert mended(np.full(600, np.nan))[1] == {} and mended(np.zeros(0), np.zeros(0))[1] == {}


@pytest.mark.parametrize(
    ("times", "speed", "are_used"),
    [(1.0, 15.0, True), (3.28, 15.0, True), (100.0, 15.0, False), (100.0, 0.0, True), (1000.0, 4.0, True)],
)
def test_heights_in_centimetres_are_not_used(times: float, speed: float, are_used: bool) -> None:
    """On a track of half a metre up and down, by a receiver that scatters; of who hardly moves nothing is said."""
    heights = times * (100.0 + 0.5 * np.sin(T / 10.0) + 0.3 * np.random.default_rng(3).standard_normal(T.size))
    out, said = mended(heights, speed=speed)
    assert ("gps_height_impossible" in said) == (not are_used)
    assert are_used or np.isnan(out).all()


def test_a_hill_climb_is_a_road() -> None:
    heights = 0.2 * 20.0 * T
    out, said = mended(heights, speed=20.0)
    assert out is heights and not said
