"""Places of which one coordinate has the wrong sign are told from a box whose axes are mirrored."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.mirrored import COURSE_WRONG, explained
from smoother.prepare import prepare
from smoother.samples import Problem, Session
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import MIRRORED_AXES, MIRRORED_PLACES, UNLIKE_AXES

OTHER = Problem("imu_vibration", "it shakes")
MIRRORED = (Problem(MIRRORED_AXES, "ay is mirrored"), OTHER, Problem(UNLIKE_AXES, "gz turns the other way"))


@pytest.fixture(scope="module")
def session() -> Session:
    """A minute of a kart; the longitude of its places has the wrong sign, the course that was sent goes round right."""
    raw = simulate_preset("kart", 3, duration=60.0, gnss_outages=()).raw
    return prepare(replace(raw, gnss=replace(raw.gnss, lon_deg=-raw.gnss.lon_deg)))


def codes(problems: tuple[Problem, ...], session: Session) -> list[str]:
    return [problem.code for problem in explained(problems, session)]


def test_it_is_the_places_where_the_box_turns_as_the_course_does(session: Session) -> None:
    assert codes(MIRRORED, session) == [MIRRORED_PLACES, OTHER.code]


def test_it_is_the_places_where_their_course_was_found_wrong(session: Session) -> None:
    without = replace(session.gnss, velocity_n=np.full_like(session.gnss.velocity_n, np.nan))
    read = replace(session, gnss=without, problems=(Problem(COURSE_WRONG, "it points elsewhere"),))
    assert codes(MIRRORED, read) == [MIRRORED_PLACES, OTHER.code]


@pytest.mark.parametrize("velocity", [[1.0, -1.0, 1.0], [np.nan, np.nan, np.nan]])
def test_it_is_the_box_where_the_course_goes_round_as_the_places_do_or_is_unknown(
    session: Session, velocity: list[float]
) -> None:
    session = replace(session, gnss=replace(session.gnss, velocity_n=session.gnss.velocity_n * velocity))
    assert explained(MIRRORED, session) == MIRRORED


@pytest.mark.parametrize("told", [MIRRORED[:2], MIRRORED[1:]])
def test_axes_of_one_sensor_alone_are_no_places(session: Session, told: tuple[Problem, ...]) -> None:
    assert explained(told, session) == told


def test_a_course_of_few_of_the_places_tells_nothing(session: Session) -> None:
    few = np.where(np.arange(len(session.gnss)) % 5 == 0, 1.0, np.nan)[:, None]
    few_known = replace(session.gnss, velocity_n=session.gnss.velocity_n * few)
    assert explained(MIRRORED, replace(session, gnss=few_known)) == MIRRORED
