"""Heights that jump as no kart climbs: left out where single, joined where they stay, and said."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.session.heights import without_height_jumps, without_impossible_heights
from smoother.session.rows import RowFilter

T = np.arange(600) / 5.0


def track() -> Array:
    return 100.0 + 5.0 * np.sin(T / 10.0) + np.random.default_rng(3).standard_normal(T.size)


def mended(alt_m: Array, t: Array = T) -> tuple[Array, dict[str, int]]:
    rows = RowFilter("gps.csv", "gps", np.ones(t.size, dtype=np.bool_))
    out = without_height_jumps(rows, t, alt_m)
    return out, {problem.code: problem.count for problem in rows.problems}


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
def test_a_height_that_is_measured_from_elsewhere_is_joined(rows: slice) -> None:
    heights = track()
    heights[rows] += 400.0
    out, said = mended(heights)
    assert said == {"gps_height_step": 1}
    np.testing.assert_allclose(out, track(), atol=3.0)  # as unsure as the medians on either side


def test_a_long_pause_may_lie_on_a_hill() -> None:
    t = T + np.where(np.arange(600) < 300, 0.0, 60.0)
    heights = track()
    heights[300:] += 400.0
    assert mended(heights, t)[1] == {}


def test_nothing_but_jumps_ends_in_no_height_and_not_in_an_error() -> None:
    out, said = mended(np.where(np.arange(600) % 2 == 0, 0.0, 400.0))
    assert said and np.nanmax(out) - np.nanmin(out) < 1.0
    assert mended(np.full(600, np.nan))[1] == {} and mended(np.zeros(0), np.zeros(0))[1] == {}


@pytest.mark.parametrize(
    ("times", "speed", "are_used"),
    [(1.0, 15.0, True), (3.28, 15.0, True), (100.0, 15.0, False), (100.0, 0.0, True), (1000.0, 4.0, True)],
)
def test_heights_in_centimetres_are_not_used(times: float, speed: float, are_used: bool) -> None:
    """On a track of half a metre up and down, by a receiver that scatters; of who hardly moves nothing is said."""
    heights = times * (100.0 + 0.5 * np.sin(T / 10.0) + 0.3 * np.random.default_rng(3).standard_normal(T.size))
    rows = RowFilter("gps.csv", "gps", np.ones(T.size, dtype=np.bool_))
    out = without_impossible_heights(rows, T, speed * T, heights)
    assert [problem.code for problem in rows.problems] == ([] if are_used else ["gps_height_impossible"])
    assert np.isfinite(out).all() if are_used else np.isnan(out).all()


def test_a_hill_climb_is_a_road() -> None:
    rows = RowFilter("gps.csv", "gps", np.ones(T.size, dtype=np.bool_))
    heights = 0.2 * 20.0 * T
    assert without_impossible_heights(rows, T, 20.0 * T, heights) is heights and not rows.problems
