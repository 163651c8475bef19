"""Where a line meets the track, when it is passed, and where on the track a place is: against geometry."""

import numpy as np
import pytest

from smoother.fit.plan_path import PlanPath
from smoother.laps.follow import Followed
from smoother.laps.line import meeting_places
from smoother.laps.reference import Curve, line_through
from smoother.laps.results import FixPath, Line
from smoother.laps.timing import crossings, raw_crossings

RADIUS = 40.0


@pytest.fixture(scope="module")
def round_track() -> Curve:
    angle = np.arange(0.0, 2.0 * np.pi, 1.0 / RADIUS)
    points = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Curve(line_through(points, np.zeros(len(points))))


def test_a_line_meets_a_round_track_where_geometry_has_it(round_track: Curve) -> None:
    for angle in (0.013, 1.0, 2.345):
        outwards = np.array([np.cos(angle), np.sin(angle)])
        ends = np.stack([(RADIUS - 8.0) * outwards, (RADIUS + 8.0) * outwards])
        (place,) = meeting_places(round_track, ends)
        met = round_track.position(np.array([place]))[0]
        assert np.arctan2(met[1], met[0]) == pytest.approx(angle, abs=0.02 / RADIUS)  # 2 cm


def test_no_line_meets_an_open_track_between_its_end_and_its_start() -> None:
    angle = np.linspace(0.2, 2.0 * np.pi - 0.2, 250)  # nearly round, and on from its end to its start it would be
    points = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    curve = Curve(line_through(points, np.zeros(len(points)), is_closed=False))
    ends = np.array([[RADIUS - 8.0, 0.0], [RADIUS + 8.0, 0.0]])
    assert meeting_places(curve, ends).size == 0
    assert meeting_places(curve, -ends).size == 1


def test_a_place_beside_a_bend_is_found_from_metres_away(round_track: Curve) -> None:
    angle = np.linspace(0.2, 6.0, 20)
    inside = (RADIUS - 12.0) * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    true, _ = round_track.project(inside, RADIUS * angle, rounds=20)
    found, left = round_track.project(inside, true + 3.0)
    np.testing.assert_allclose(found, true, atol=2e-3)
    np.testing.assert_allclose(
        left, 12.0, atol=0.1
    )  # inside is to the left; smoothing takes 2^2 / (2 * 40) m off the line


def test_a_straight_between_fixes_counts_only_near_the_passage_that_is_meant() -> None:
    t = np.arange(0.0, 10.0, 0.2)
    fixes = FixPath(t, np.stack([10.0 * (t - 5.0), np.zeros(len(t))], axis=1))
    line = Line("start/finish", np.array([0.3, 6.0]), np.array([0.3, -6.0]))
    near = raw_crossings(fixes, line, np.array([5.0, 9.0]))
    assert near[0] == pytest.approx(5.03, abs=1e-9)
    assert np.isnan(near[1])  # the passage is four seconds away


def test_a_passage_in_a_hole_that_left_the_track_is_where_track_distance_has_it() -> None:
    t = np.arange(0.0, 21.0)
    beside = np.where((t > 8.0) & (t < 12.0), 50.0, 0.0)  # m, by which the path leaves the track in the hole
    path = PlanPath(t, np.stack([10.0 * t, beside], axis=1), np.tile([10.0, 0.0], (21, 1)), np.zeros(21))
    blind = (t >= 8.0) & (t < 12.0)
    followed = Followed(10.0 * t, np.where(blind, np.nan, 0.0), ~blind)
    line = Line("start/finish", np.array([103.0, 5.0]), np.array([103.0, -5.0]), distance=103.0)
    found = crossings(path, followed, 150.0, line, blind=blind)
    assert found.t.tolist() == pytest.approx([10.3])
    assert found.lap.tolist() == [0]
    assert not found.is_solved.any()
