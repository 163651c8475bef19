"""Where a lap began to brake: between the places at which laps are compared, and as unsure as the driver makes it."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.braking import braking_points
from smoother.laps.results import Traces

DISTANCE = np.arange(0.0, 201.0, 2.0)


def laps(*slowing: Array, place_sigma: float = 0.0) -> Traces:
    """Laps that slow down by `slowing` (M,) m/s^2 at DISTANCE."""
    shape = (len(slowing), len(DISTANCE))
    fields = {name: np.full(shape, np.nan) for name in Traces.__dataclass_fields__}
    fields |= {
        "distance": DISTANCE,
        "t": np.tile(DISTANCE / 20.0, (len(slowing), 1)),
        "longitudinal": -np.stack(slowing),
    }
    return Traces(**{**fields, "place_sigma": np.full(shape, place_sigma)})


def ramp(at: float, over: float, to: float, until: float = 120.0) -> Array:
    """From 0 at `at` m to `to` m/s^2 within `over` m, let go at `until` m."""
    return np.where(until > DISTANCE, to * np.clip((DISTANCE - at) / over, 0.0, 1.0), 0.0)


def test_a_hard_stop_begins_between_two_places_and_is_as_sure_as_the_place() -> None:
    stops = laps(ramp(64.2, 32.0, 8.0), ramp(65.2, 32.0, 8.0), place_sigma=1.5)
    point, sigma = braking_points(stops, 40.0, 130.0)
    np.testing.assert_allclose(point, [68.2, 69.2], atol=0.1)  # where 1 m/s^2 is passed
    np.testing.assert_allclose(sigma, np.hypot(1.5, 2.0), atol=0.1)  # and 0.5 and 1.5 are


def test_hardly_any_braking_has_no_braking_point() -> None:
    lifted = np.maximum(ramp(50.0, 10.0, 2.1, until=80.0), ramp(90.0, 4.0, 1.9))
    point, sigma = braking_points(laps(lifted), 40.0, 130.0)
    assert point[0] == pytest.approx(54.8, abs=0.5)
    assert sigma[0] > 5.0
    twice = np.maximum(ramp(50.0, 10.0, 2.1, until=70.0), ramp(90.0, 4.0, 6.0))
    point, sigma = braking_points(laps(twice), 40.0, 130.0)  # the second takes most, whatever the thresholds
    assert point[0] == pytest.approx(90.7, abs=0.5)
    assert sigma[0] < 1.0


def test_who_does_not_brake_has_no_place_and_no_sigma_of_it() -> None:
    unknown = np.where(DISTANCE > 60.0, np.nan, 0.0)
    point, sigma = braking_points(laps(ramp(70.0, 4.0, 1.5), 0.0 * DISTANCE, unknown), 40.0, 130.0)
    assert np.isnan(point).all() and np.isnan(sigma).all()


def test_braking_that_began_before_its_corners_segment_counts_but_not_that_of_the_corner_before() -> None:
    early, of_another = ramp(30.0, 4.0, 6.0), ramp(15.0, 2.0, 6.0, until=38.0)
    point, _ = braking_points(laps(early, np.maximum(of_another, ramp(70.0, 4.0, 5.0))), 40.0, 130.0)
    np.testing.assert_allclose(point, [30.7, 70.8], atol=0.5)


def test_braking_that_began_before_anything_is_known_begins_at_the_first_known_place() -> None:
    from_the_start = np.where(DISTANCE < 60.0, 6.0, 0.0)
    behind_a_hole = np.where(DISTANCE < 20.0, np.nan, from_the_start)
    point, _ = braking_points(laps(from_the_start, behind_a_hole), 0.0, 130.0)
    np.testing.assert_allclose(point, [0.0, 20.0])
