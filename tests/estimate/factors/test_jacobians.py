"""Every Jacobian of every factor of the table, against differences of its residual."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.factors.graph import TABLE, Factor, Inputs
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import COLUMNS, CONSTANTS, KEYFRAME_SIZE, State
from tests.estimate.factors.driven import inputs

STEP = 1e-5
OF_KEYFRAMES = (
    1.5e-2  # of a column's largest slope: the share of a turn that two keyframes have is right to first order
)
OF_SLIP = 6e-2  # how hard the kart corners, by which the process grows, is taken as it is
ABOUT_UP_ALONE = {"heading", "slip_start", "slip"}  # they turn the kart about up, and never tilt it
# constants whose slopes are those of the low-passed motion, which here is the motion but for the filter's own error
LOW_PASSED = {"position_latency", "velocity_latency", "lever_arm", "velocity_response", "slip"}
OF_LOW_PASSED, OF_CONSTANTS = 3e-2, 1e-6


def moved(state: State, column: int, by: float) -> State:
    """The state with all keyframes, even ones or odd ones, moved along a column of their tangents."""
    delta = np.zeros((len(state.t), KEYFRAME_SIZE))
    delta[:, column % KEYFRAME_SIZE] = by
    delta[(column // KEYFRAME_SIZE + 1) % 2 :: 2] = 0.0
    return replace(
        state,
        R_ns=state.R_ns @ so3.exp(delta[:, 0:3]),
        position_n=state.position_n + np.einsum("kij,kj->ki", state.R_ns, delta[:, 3:6]),
        velocity_n=state.velocity_n + delta[:, 6:9],
        accel_bias_s=state.accel_bias_s + delta[:, 9:12],
        gyro_bias_s=state.gyro_bias_s + delta[:, 12:15],
        offset_n=state.offset_n + delta[:, 15:18],
    )


def rows_at(factor: Factor, x: Inputs, state: State) -> list[Rows]:
    return list(factor.rows(replace(x, state=state)))  # along the same low-passed motion


def slope(factor: Factor, x: Inputs, plus: State, minus: State) -> list[Array]:
    pairs = zip(rows_at(factor, x, plus), rows_at(factor, x, minus), strict=True)
    return [(one.residual - two.residual) / (2.0 * STEP) for one, two in pairs]


@pytest.fixture(name="x", params=[False, True], ids=["on the frame", "on the steering wheel"])
def _x(request: pytest.FixtureRequest) -> Inputs:
    return inputs(np.random.default_rng(5), is_steered=request.param)


@pytest.mark.parametrize("factor", TABLE, ids=lambda factor: factor.name)
def test_slopes_by_keyframes_are_those_of_the_residual(factor: Factor, x: Inputs) -> None:
    here = rows_at(factor, x, x.state)
    assert here, "the session of these tests lacks what this factor needs"
    follows_course = x.state.geometry.is_steered and factor.name in ("gps_position", "gps_velocity")
    state = x.state
    if factor.name == "standstill":  # whose slopes are those at rest
        state = replace(state, R_ns=np.broadcast_to(state.R_ns[0], state.R_ns.shape))
        x = replace(x, state=state)
        here = rows_at(factor, x, state)
    for column in range(2 * KEYFRAME_SIZE):
        found = slope(factor, x, moved(x.state, column, STEP), moved(x.state, column, -STEP))
        for rows, numeric in zip(here, found, strict=True):
            even, block = (rows.interval % 2 == 0), column % KEYFRAME_SIZE
            is_left = even == (column < KEYFRAME_SIZE)
            claimed = np.where(is_left[:, None], rows.left[:, :, block], rows.right[:, :, block])
            if rows.name in ABOUT_UP_ALONE and block < 3:
                continue
            if follows_course and 6 <= block < 9:  # the arm turns with the course, which hardly matters: no slope
                continue
            scale = max(np.abs(numeric).max(), np.abs(claimed).max(), 1e-2)
            is_slip = rows.name.startswith("slip")
            tolerance = OF_SLIP * np.abs(rows.left).max() if is_slip else OF_KEYFRAMES * scale
            np.testing.assert_allclose(claimed, numeric, atol=tolerance, err_msg=f"{rows.name}, {column}")


@pytest.mark.parametrize("factor", TABLE, ids=lambda factor: factor.name)
def test_slopes_by_a_turn_about_up_are_those_of_the_residual(factor: Factor, x: Inputs) -> None:
    def turned(by: float) -> State:
        about_up = so3.exp(np.array([0.0, 0.0, by]))
        R_ns = x.state.R_ns.copy()
        R_ns[::2] = about_up @ R_ns[::2]
        return replace(x.state, R_ns=R_ns)

    found = slope(factor, x, turned(STEP), turned(-STEP))
    for rows, numeric in zip(rows_at(factor, x, x.state), found, strict=True):
        k = rows.interval
        by_left, by_right = (
            np.einsum("nri,ni->nr", J[:, :, 0:3], x.state.R_ns[at][:, 2, :])
            for J, at in ((rows.left, k), (rows.right, k + 1))
        )
        claimed = np.where((k % 2 == 0)[:, None], by_left, by_right)
        if rows.name != "standstill":
            np.testing.assert_allclose(claimed, numeric, atol=OF_KEYFRAMES * max(0.1, np.abs(numeric).max()))


@pytest.mark.parametrize("factor", TABLE, ids=lambda factor: factor.name)
@pytest.mark.parametrize("name", [c.name for c in CONSTANTS])
def test_slopes_by_constants_are_those_of_the_low_passed_motion(factor: Factor, name: str, x: Inputs) -> None:
    size = COLUMNS[name].stop - COLUMNS[name].start
    here = rows_at(factor, x, x.state)
    for i in range(size):
        plus, minus = (
            replace(
                x.state, constants=x.state.constants | {name: x.state.constants[name] + sign * STEP * np.eye(size)[i]}
            )
            for sign in (1.0, -1.0)
        )
        for rows, numeric in zip(here, slope(factor, x, plus, minus), strict=True):
            claimed = rows.constants[name][:, :, i] if name in rows.constants else np.zeros_like(numeric)
            tolerance = OF_LOW_PASSED if name in LOW_PASSED else OF_CONSTANTS
            scale = max(float(np.abs(numeric).max()), 1e-3)
            if rows.name == "gps_velocity" and name == "velocity_latency":
                claimed, numeric = claimed[:, :2], numeric[:, :2]  # upwards it has none, on purpose
            np.testing.assert_allclose(claimed, numeric, atol=tolerance * scale, err_msg=f"{rows.name} by {name}")
