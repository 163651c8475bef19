"""Axes of the gyroscope that differ from those of the accelerometer show in how the vehicle leans."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.initial.align import Alignment, align
from smoother.estimate.path_motion import PathMotion
from smoother.estimate.preprocess.lean_rates import lean_rates
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

LEVEL = so3.exp(np.array([1.0, -1.5, 0.0]) * DEG)
ON_ITS_SIDE = so3.exp(np.array([0.5 * np.pi, 0.0, 0.3]))


def session_of(R_bs: Array, seed: int = 41, preset: str = "kart", **changes: Any) -> Session:
    return prepare(simulate_preset(preset, seed, duration=150.0, R_bs=R_bs, **changes).raw)


def aligned(session: Session, measured: Array) -> Alignment:
    """Align with rates that are measured (3, 3) @ the true ones."""
    assert session.imu is not None
    imu = replace(session.imu, angular_rate_s=session.imu.angular_rate_s @ measured.T)
    return align(imu, PathMotion(session.gnss.t, session.gnss.velocity_n))


@pytest.mark.parametrize("R_bs", [LEVEL, ON_ITS_SIDE])
def test_the_columns_of_a_rotated_gyroscope_are_named(R_bs: Array) -> None:
    session = session_of(R_bs)
    assert not aligned(session, np.eye(3)).problems
    for columns, true in (
        ("-gy, gx, gz", [[0, -1, 0], [1, 0, 0], [0, 0, 1]]),  # as a RaceCapture has it
        ("gy, gz, gx", [[0, 1, 0], [0, 0, 1], [1, 0, 0]]),
        ("-gx, gy, gz", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ):
        found = aligned(session, np.array(true, dtype=np.float64).T)
        (problem,) = found.problems
        assert problem.code == "imu_axes_disagree" and f"from the columns {columns}. " in problem.text
        assert found.is_misnamed


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
@pytest.mark.parametrize("preset", ["kart", "kart_harsh"])
def test_other_vehicles_and_receivers_have_right_axes(preset: str, changes: dict[str, float]) -> None:
    assert not aligned(session_of(LEVEL, 42, preset, **changes), np.eye(3)).problems


def test_few_or_rare_fixes_show_nothing() -> None:
    t, axes, rate = np.arange(200.0), np.zeros((200, 3)), np.zeros((200, 3))
    assert lean_rates(t, axes, t, rate) is None
    assert lean_rates(0.2 * t, axes, 0.2 * t[:20], rate[:20]) is None
