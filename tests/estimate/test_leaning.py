"""Two wheels lean into corners; karts and cars lean out of them."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.leaning import LEANS, leaning_problems
from smoother.frames import rotation_from_euler
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import EstimateReport, Keyframes, Trajectory


@pytest.fixture(scope="module")
def driven() -> Trajectory:
    simulation = simulate_preset("kart", 3, duration=90.0)
    return simulation.truth.trajectory(np.arange(0.0, 90.0, 0.02), np.zeros(3))


def leaning(driven: Trajectory, share: float) -> Trajectory:
    """The same way with a floor that leans by a share of the angle at which nothing pushes sideways, + outwards."""
    velocity = driven.velocity_n[:, :2]
    yaw = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    push = np.hypot(*velocity.T) * np.gradient(yaw, driven.t)
    roll = share * np.arctan(push / 9.81)
    return replace(driven, R_nb=rotation_from_euler(roll, 0.0 * roll, yaw))


def test_a_kart_does_not_lean(driven: Trajectory) -> None:
    assert leaning_problems(driven) == ()
    assert leaning_problems(leaning(driven, 0.3)) == ()
    assert leaning_problems(leaning(driven, -0.1)) == ()


def test_two_wheels_do(driven: Trajectory) -> None:
    (said,) = leaning_problems(leaning(driven, -0.8))
    assert said.code == LEANS
    assert "leans into corners by" in said.text


@pytest.mark.parametrize("rate", [1, 2, 10])
def test_rows_may_be_as_far_apart_as_they_were_asked_for(driven: Trajectory, rate: int) -> None:
    leans = leaning(driven, -0.8)
    rows, at = leans.every(50 // rate), leans.every(10)
    n, unknown = len(at), np.zeros((len(at), 3))
    keyframes = Keyframes(
        at.t,
        at.position_n,
        at.velocity_n,
        at.R_nb,
        np.zeros((n, 9, 9)),
        *(unknown,) * 5,
        np.zeros(3),
    )
    (said,) = leaning_problems(replace(rows, report=EstimateReport(keyframes=keyframes)))
    assert said.code == LEANS


def test_who_stands_tells_nothing(driven: Trajectory) -> None:
    assert leaning_problems(replace(leaning(driven, -0.8), velocity_n=np.zeros_like(driven.velocity_n))) == ()
