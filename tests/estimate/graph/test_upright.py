"""A kart that stays upright and along its path where the gyroscope does not tell attitudes."""

import math
from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.expected import ExpectedMotion
from smoother.estimate.graph.imu import DensePath
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.slip import slip_of
from smoother.estimate.graph.state import CONSTANTS_SIZE, KEYFRAME_SIZE, SLIP, ChainState, Constants
from smoother.estimate.graph.upright import (
    STEADY,
    UNSTEADY,
    WANDER,
    along_path_rows,
    unsteadiness,
    upright_rows,
)
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory
from smoother.units import DEG

K, T = 6, 0.2
EVERYWHERE = np.ones(K, dtype=np.bool_)


def tilted() -> ChainState:
    """A kart in a bend that leans and slips a little, the box lying any way."""
    t, rng = T * np.arange(K), np.random.default_rng(4)
    course = 3.0 + 0.4 * t
    velocity_n = np.column_stack([12.0 * np.cos(course), 12.0 * np.sin(course), 0.0 * t])
    R_bs = so3.exp(np.array([[0.4, -1.0, 2.0]]))[0]
    R_ns = so3.exp(np.column_stack([0.0 * t, 0.0 * t, course])) @ so3.exp(0.05 * rng.normal(size=(K, 3))) @ R_bs
    constants = Constants(0.1, 0.15, np.zeros(3), level_axes_s=R_bs)
    zeros = np.zeros((K, 3))
    return ChainState(t, R_ns, zeros, velocity_n, zeros, zeros, zeros, constants)


def rows_of(state: ChainState, share: float = 1.0) -> tuple[Rows, Rows]:
    zeros, along = np.zeros((K, 3)), np.zeros((K - 1, 3))
    path = DensePath(state.t, state.R_ns, zeros, state.velocity_n, along, along)
    felt = ExpectedMotion(state.velocity_n, np.gradient(state.velocity_n, state.t, axis=0), 0.0 * state.t)
    slip = slip_of(state, path, felt, EVERYWHERE, EVERYWHERE)
    return upright_rows(state, slip, share), along_path_rows(state, slip, share)


def test_rows_are_changes_of_lean_and_of_slip() -> None:
    state = tilted()
    upright, along = rows_of(state)
    E, ahead_n = state.constants.level_axes_s, state.R_ns @ state.constants.level_axes_s[0]
    np.testing.assert_allclose(upright.residual, np.diff(state.R_ns[:, 2] @ E[:2].T, axis=0), atol=1e-12)
    course = np.arctan2(state.velocity_n[:, 1], state.velocity_n[:, 0]) - np.arctan2(ahead_n[:, 1], ahead_n[:, 0])
    np.testing.assert_allclose(along.residual[:, 0], np.diff(np.angle(np.exp(1j * course))), atol=1e-12)
    for rows in (upright, along):
        np.testing.assert_allclose(rows.sigma, WANDER * math.sqrt(T))
        np.testing.assert_array_equal(rows.interval, np.arange(K - 1))
    np.testing.assert_allclose(rows_of(state, 0.25)[0].sigma, 2.0 * WANDER * math.sqrt(T))


@pytest.mark.parametrize("which", [0, 1])
def test_jacobians_are_those_of_the_rows(which: int) -> None:
    state = tilted()
    rows = rows_of(state)[which]
    for k in range(K):
        for i in range(9):  # rotation, translation, velocity
            step = np.zeros((K, KEYFRAME_SIZE))
            step[k, i] = 1e-6
            found = (_residual(state, which, step) - _residual(state, which, -step)) / 2e-6
            want = np.zeros_like(rows.residual)
            if k < K - 1:
                want[k] += rows.left[k, :, i]
            if k > 0:
                want[k - 1] += rows.right[k - 1, :, i]
            # slip is asked for by the turn about up alone, so that it tilts nothing: by the lean itself off
            np.testing.assert_allclose(found, want, atol=(1e-6, 0.1)[which])


def test_slip_constants_have_their_slopes() -> None:
    state = tilted()
    along = rows_of(state)[1]
    step = np.array([0.0, 1e-3, 0.0, 0.0])
    constants = state.constants.as_vector()
    constants[SLIP] += step
    changed = replace(state, constants=Constants.from_vector(constants, state.constants.level_axes_s))
    moved = rows_of(changed)[1].residual - along.residual
    np.testing.assert_allclose(moved[:, 0], along.constants[:, 0, SLIP] @ step, atol=1e-9)


def _residual(state: ChainState, which: int, step: Array) -> Array:
    # accelerations that the slip goes with count as known: its constants are zero here
    return rows_of(state.retract(step, np.zeros(CONSTANTS_SIZE)))[which].residual


def test_good_gyroscopes_are_believed_alone_and_the_rest_comes_by_and_by() -> None:
    assert unsteadiness(0.0) == unsteadiness(3.3 * DEG) == unsteadiness(STEADY) == 0.0
    assert unsteadiness(UNSTEADY) == unsteadiness(20.0 * DEG) == pytest.approx(1.0)
    assert unsteadiness(math.sqrt(STEADY * UNSTEADY)) == pytest.approx(0.5)


@pytest.fixture(scope="module", params=[3, 11])
def folded(request: pytest.FixtureRequest) -> tuple[Simulation, Trajectory]:
    """A kart whose vibration, 80 deg/s rms, is not filtered before 25 samples a second are taken."""
    simulation = simulate_preset(
        "kart",
        request.param,
        duration=240.0,
        imu_rate=25.0,
        imu_anti_alias_hz=None,
        imu_gyro_tone=100.0 * DEG,
        imu_accel_tone=6.0,
    )
    return simulation, GraphSmoother(GraphOptions()).estimate(prepare(simulation.raw))


def test_delays_and_arm_of_a_shaken_box_are_as_near_as_they_say(folded: tuple[Simulation, Trajectory]) -> None:
    simulation, found = folded
    identified, true = found.report.identified, simulation.scenario
    for name, latency in (
        ("gps_position_latency", true.gnss.position_latency),
        ("gps_velocity_latency", true.gnss.velocity_latency),
    ):
        value, sigma = identified[name].value, identified[name].sigma
        assert isinstance(value, float) and isinstance(sigma, float)
        assert abs(value - latency) < 2.0 * sigma
        assert abs(value - latency) < 0.02
    arm = identified["lever_arm_b"]
    assert isinstance(arm.sigma, list)
    off = np.subtract(arm.value, true.lever_arm_b)
    assert np.all(np.abs(off[:2]) < 2.5 * np.array(arm.sigma[:2]))
