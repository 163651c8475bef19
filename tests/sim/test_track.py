import numpy as np
import pytest

from smoother.frames import geodetic_to_nwu
from smoother.sim.track import TRACKS, Corner, Track

ALL = pytest.mark.parametrize("track", TRACKS.values(), ids=lambda track: track.name)


@ALL
def test_track_is_as_long_as_a_kart_track(track):
    assert 500.0 < track.length < 1600.0


@ALL
def test_distance_is_measured_along_the_centre_line(track):
    distance = np.linspace(0.0, track.length, 5001)
    step = np.linalg.norm(np.diff(track.centre(distance)[:, :2], axis=0), axis=1)
    # a chord is shorter than its arc by curvature^2 step^2 / 24, below 3e-5 here
    np.testing.assert_allclose(step, track.length / 5000.0, rtol=3e-5)


@ALL
def test_track_closes_smoothly(track):
    ends = np.array([0.0, track.length])
    np.testing.assert_allclose(*track.centre(ends), atol=1e-9)
    np.testing.assert_allclose(*track.tangent(ends), atol=1e-9)
    np.testing.assert_allclose(*track.curvature(ends), atol=1e-9)


@ALL
def test_tangent_curvature_and_slope_are_derivatives_of_the_centre_line(track):
    distance = np.linspace(3.0, track.length - 3.0, 400)
    h = 1e-3
    ahead, behind = track.centre(distance + h), track.centre(distance - h)
    derivative = (ahead - behind) / (2.0 * h)
    np.testing.assert_allclose(track.tangent(distance), derivative[:, :2], atol=1e-5)
    np.testing.assert_allclose(track.slope(distance), derivative[:, 2], atol=1e-7)
    turn = (track.tangent(distance + h) - track.tangent(distance - h)) / (2.0 * h)
    left = np.stack([-track.tangent(distance)[:, 1], track.tangent(distance)[:, 0]], axis=1)
    np.testing.assert_allclose(track.curvature(distance), np.sum(turn * left, axis=1), atol=1e-5)


@ALL
def test_one_lap_turns_once_around_with_hairpins_both_ways(track):
    distance = np.arange(0.0, track.length, 0.5)
    curvature = track.curvature(distance)
    assert abs(np.sum(curvature) * 0.5) == pytest.approx(2.0 * np.pi, rel=1e-3)
    assert np.max(curvature) > 0.03 and np.min(curvature) < -0.03  # bends of less than 33 m radius, left and right
    assert np.max(np.abs(curvature)) < 1.0 / 7.0  # karts do not turn tighter than 7 m at speed


@ALL
def test_roads_of_a_track_keep_apart(track):
    distance = np.arange(0.0, track.length, 2.0)
    centre = track.centre(distance)[:, :2]
    gap = np.linalg.norm(centre[:, None] - centre[None], axis=-1)
    along = np.abs(distance[:, None] - distance[None])
    along = np.minimum(along, track.length - along)
    assert np.min(gap[along > 60.0]) > track.width + 2.0


@ALL
def test_start_line_crosses_the_road_with_its_left_end_on_the_drivers_left(track):
    left, right = track.start_line
    centre, tangent = track.centre(np.zeros(1))[0, :2], track.tangent(np.zeros(1))[0]
    np.testing.assert_allclose(0.5 * (left + right), centre, atol=1e-9)
    assert (left - right) @ tangent == pytest.approx(0.0, abs=1e-9)
    assert tangent[0] * (left - right)[1] - tangent[1] * (left - right)[0] > track.width  # left of travel is +
    lat, lon = track.start_line_deg.T
    again = geodetic_to_nwu(lat, lon, np.full(2, track.origin.alt_m), track.origin)[:, :2]
    np.testing.assert_allclose(again, track.start_line, atol=1e-6)


def test_tracks_differ_in_direction_hemisphere_and_longitude():
    turns = {np.sign(np.sum(t.curvature(np.arange(0.0, t.length)))) for t in TRACKS.values()}
    assert turns == {-1.0, 1.0}
    assert {np.sign(t.origin.lat_deg) for t in TRACKS.values()} == {-1.0, 1.0}
    assert {np.sign(t.origin.lon_deg) for t in TRACKS.values()} == {-1.0, 1.0}


def test_corner_radius_is_the_radius_driven():
    square = Track(
        "square", TRACKS["larkfield"].origin, [Corner(*c, 40.0) for c in ((0, 0), (200, 0), (200, 200), (0, 200))]
    )
    distance = np.arange(0.0, square.length, 1.0)
    assert square.length == pytest.approx(4 * 120.0 + 2.0 * np.pi * 40.0, rel=2e-3)
    assert np.max(square.curvature(distance)) == pytest.approx(1.0 / 40.0, rel=0.01)  # north then west: anticlockwise
    assert np.min(square.curvature(distance)) > -1e-9


def test_start_line_stands_where_it_was_put_on_the_straight_before_the_first_corner():
    corners = [Corner(*c, 40.0) for c in ((0, 0), (200, 0), (200, 200), (0, 200))]
    for fraction, west in ((0.5, 100.0), (0.25, 130.0)):  # the straight runs from west 160 to west 40
        square = Track("square", TRACKS["larkfield"].origin, corners, start_fraction=fraction)
        np.testing.assert_allclose(square.centre(np.zeros(1))[0, :2], [0.0, west], atol=1e-6)
