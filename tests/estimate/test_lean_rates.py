"""Axes of the gyroscope that the way a vehicle leans tells apart, whatever way the box lies."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.check import check
from smoother.estimate.initial.align import Alignment, align
from smoother.estimate.lean_rates import NAMINGS, lean_rates
from smoother.estimate.on_wheel import is_on_wheel
from smoother.estimate.path_motion import PathMotion
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

LEVEL = so3.exp(np.array([1.0, -1.5, 0.0]) * DEG)
ON_ITS_SIDE = so3.exp(np.array([0.5 * np.pi, 0.0, 0.3]))
TILTED = so3.exp(np.array([0.0, 25.0, 40.0]) * DEG)
RIGHT = NAMINGS[0]


def session_of(R_bs: Array, seed: int = 41, preset: str = "kart", **changes: Any) -> Session:
    return prepare(simulate_preset(preset, seed, duration=150.0, R_bs=R_bs, **changes).raw)


def aligned(session: Session, measured: Array) -> Alignment:
    """Align with rates that are measured (3, 3) @ the true ones."""
    assert session.imu is not None
    imu = replace(session.imu, angular_rate_s=session.imu.angular_rate_s @ measured.T)
    return align(imu, PathMotion(session.gnss.t, session.gnss.velocity_n))


@pytest.fixture(scope="module", params=[LEVEL, ON_ITS_SIDE, TILTED], ids=["level", "on its side", "tilted"])
def session(request: pytest.FixtureRequest) -> Session:
    return session_of(request.param)


def test_right_axes_are_not_doubted(session: Session) -> None:
    assert not aligned(session, np.eye(3)).problems


@pytest.mark.parametrize("number", [i for i, naming in enumerate(NAMINGS) if naming.is_single])
def test_a_single_mistake_is_named(session: Session, number: int) -> None:
    naming = NAMINGS[number]
    (problem,) = aligned(session, naming.true.T).problems
    assert problem.code == "imu_axes_disagree"
    assert f"it all fits once {naming.words}. " in problem.text


@pytest.mark.parametrize(("R_bs", "names"), [(LEVEL, "gx and gy"), (ON_ITS_SIDE, "gx and gz")])
@pytest.mark.parametrize("seed", [44, 45])
def test_two_level_axes_with_the_wrong_sign_are_told_by_how_the_vehicle_squats(
    R_bs: Array, names: str, seed: int
) -> None:
    session = session_of(R_bs, seed, "white")
    assert not aligned(session, np.eye(3)).problems
    naming = next(one for one in NAMINGS if one.words == f"the signs of {names} are changed")
    (problem,) = aligned(session, naming.true.T).problems
    assert problem.code == "imu_axes_disagree"
    assert f"it all fits once {naming.words}. " in problem.text


@pytest.mark.parametrize("words", ["gy, -gx, gz", "-gy, gx, gz", "gy, gz, gx"])
def test_a_gyroscope_that_stands_turned_beside_the_accelerometer_is_named(session: Session, words: str) -> None:
    naming = next(one for one in NAMINGS if one.words.endswith(f"columns {words}"))
    (problem,) = aligned(session, naming.true.T).problems
    assert naming.words in problem.text


@pytest.mark.parametrize(
    "changes",
    [
        {"motion_roll_per_acceleration": -0.004},  # as on banked bends
        {"motion_roll_per_acceleration": 0.0, "motion_pitch_per_acceleration": 0.0},
        {"motion_roll_per_acceleration": 0.009, "motion_pitch_per_acceleration": 0.004},  # as cars do
        {"gnss_rate": 1.0},
        {"motion_slip_per_acceleration": 0.012},
    ],
)
@pytest.mark.parametrize("preset", ["kart", "kart_harsh", "white"])
def test_other_vehicles_and_receivers_are_not_doubted(preset: str, changes: dict[str, float]) -> None:
    assert not aligned(session_of(LEVEL, 42, preset, **changes), np.eye(3)).problems


def test_what_hardly_leans_says_nothing() -> None:
    """Its level rates are slip and noise, which any of 48 namings may happen to fit."""
    rigid = {"motion_roll_per_acceleration": 0.0, "motion_pitch_per_acceleration": 0.0}
    session = session_of(LEVEL, 43, "white", **rigid)
    upright = [naming.true for naming in NAMINGS if naming.true[2, 2] > 0.0]
    assert not any(aligned(session, measured).problems for measured in upright)


def test_few_or_rare_fixes_say_nothing() -> None:
    t, axes, rate = np.arange(200.0), np.zeros((200, 3)), np.zeros((200, 3))
    assert lean_rates(t, axes, t, rate) is None
    assert lean_rates(0.2 * t, axes, 0.2 * t[:20], rate[:20]) is None


def test_names_are_of_all_48_and_the_first_is_right() -> None:
    assert len({naming.words for naming in NAMINGS}) == len(NAMINGS) == 48
    np.testing.assert_array_equal(RIGHT.true, np.eye(3))
    measured = np.array([1.0, 2.0, 3.0])
    turned = next(one for one in NAMINGS if one.words.endswith("columns gy, -gx, gz"))
    np.testing.assert_array_equal(turned.true @ measured, [2.0, -1.0, 3.0])


def test_a_box_whose_axis_is_wrong_is_not_taken_for_one_on_the_wheel() -> None:
    """About an axis that turns the wrong way a box on the frame turns and rolls as one on a wheel does."""
    raw = simulate_preset("kart", 51, duration=120.0).raw
    assert raw.imu is not None
    wrong = replace(raw, imu=replace(raw.imu, gyro=raw.imu.gyro * [1.0, 1.0, -1.0]))
    session = prepare(wrong)
    assert session.imu is not None
    assert is_on_wheel(session.imu, session.gnss)
    problems = GraphSmoother().estimate(session).report.problems
    (problem,) = (problem for problem in problems if problem.code == "imu_axes_disagree")
    assert "it all fits once the sign of gz is changed. " in problem.text
    (finding,) = (finding for finding in check(wrong).findings if "gyroscope" in finding.text)
    assert finding.level == "stop"


@pytest.mark.parametrize("seed", [61, 62])
def test_a_box_on_the_wheel_keeps_its_axes(seed: int) -> None:
    session = session_of(LEVEL, seed, motion_steering=0.1, motion_steering_per_curvature=2.0)
    assert not aligned(session, np.eye(3)).is_misnamed
