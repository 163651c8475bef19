"""Lines that recordings bring along: ends across the track are used, points along it are not, and it is said."""

from pathlib import Path

import numpy as np
import pytest

from smoother.frames import Origin, nwu_to_geodetic
from smoother.laps.own_lines import Ends, OwnLine, trusted_lines
from smoother.laps.path import plan_path
from smoother.laps.results import GivenLines
from smoother.samples import Problem
from smoother.session.readers.vbo import own_lines
from smoother.trajectory import Trajectory

ORIGIN = Origin(44.8, 11.2, 10.0)
RADIUS = 60.0  # m, of the circle, about the origin
FORMS = ("longitude", "latitude")


def ends(first: tuple[float, float], second: tuple[float, float]) -> Ends:
    """Two points north and west, m, as degrees."""
    lat, lon, _ = nwu_to_geodetic(np.array([[*first, 0.0], [*second, 0.0]]), ORIGIN)
    return (float(lat[0]), float(lon[0])), (float(lat[1]), float(lon[1]))


def swapped(line: Ends) -> Ends:
    return (line[0][1], line[0][0]), (line[1][1], line[1][0])


ACROSS = ends((0.0, -RADIUS + 7.0), (0.0, -RADIUS - 7.0))
SPLIT = ends((RADIUS - 7.0, 0.0), (RADIUS + 7.0, 0.0))
ALONG = ends((-2.0, -RADIUS - 0.3), (28.0, -RADIUS + 0.3))


@pytest.mark.parametrize("right", [0, 1])
def test_a_line_across_the_track_is_used_whichever_way_its_numbers_stand(circle: Trajectory, right: int) -> None:
    orders = [swapped(ACROSS), swapped(ACROSS)]
    orders[right] = ACROSS
    own = [OwnLine("start", tuple(orders)), OwnLine("split", (SPLIT,))]
    lines = trusted_lines(own, ORIGIN, plan_path(circle))
    assert isinstance(lines, GivenLines)
    assert lines.source == "file"
    assert lines.start == pytest.approx(np.array([[0.0, -53.0], [0.0, -67.0]]), abs=0.01)
    assert len(lines.sectors) == 1


def test_two_points_along_the_track_are_no_line_and_reported(circle: Trajectory) -> None:
    said = trusted_lines([OwnLine("start", (ALONG, swapped(ALONG)))], ORIGIN, plan_path(circle))
    assert isinstance(said, Problem)
    assert "does not lie across" in said.text


def test_a_line_elsewhere_or_none_is_not_used(circle: Trajectory) -> None:
    path = plan_path(circle)
    elsewhere = OwnLine("start", (ends((500.0, 0.0), (514.0, 0.0)),))
    assert isinstance(trusted_lines([elsewhere], ORIGIN, path), Problem)
    assert trusted_lines([OwnLine("split", (SPLIT,))], ORIGIN, path) is None
    assert trusted_lines([], ORIGIN, path) is None


def test_sectors_count_only_when_all_of_them_can_be_trusted(circle: Trajectory) -> None:
    own = [OwnLine("start", (ACROSS,)), OwnLine("split", (SPLIT,)), OwnLine("split", (ALONG,))]
    lines = trusted_lines(own, ORIGIN, plan_path(circle))
    assert isinstance(lines, GivenLines) and lines.sectors == ()


@pytest.mark.parametrize(
    ("name", "file", "form"),
    [
        ("kart_lignano_racebox", "raw_racebox_lignano.vbo", "latitude"),
        ("kart_massafinalese_racechrono", "raw_racechrono_massa.vbo", "longitude"),
    ],
)
def test_a_head_alone_holds_both_orders(data_directory: Path, name: str, file: str, form: str) -> None:
    path = data_directory / name / file
    if not path.is_file():
        pytest.skip(f"no {path}")
    found = own_lines(path)
    assert found[0][0].kind == "start"
    lat, lon = found[0][FORMS.index(form)].first_deg
    assert 44.0 < lat < 46.5 and 10.0 < lon < 14.0
