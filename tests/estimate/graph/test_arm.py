"""The arm to the antenna turns with the box on a frame, and with the course where the box is on the steering wheel."""

import numpy as np

from smoother import so3
from smoother.estimate.graph.arm import arm_axes, arm_axes_along, arm_axes_at, course, turning_arm
from smoother.estimate.graph.state import ChainState, Constants
from smoother.estimate.model.imu import DensePath
from smoother.frames import rotation_from_euler

AXES = so3.exp(np.array([0.3, -0.4, 2.0]))  # forward, left and up in s, while the wheel is straight
T = 0.2 * np.arange(40)
YAW = 3.0 + 0.4 * T  # through south
ARM = np.array([0.5, -0.1, 0.2])


def steered(*, is_steered: bool = True) -> ChainState:
    """A kart on a circle to the left, its box turned to and fro on a column that leans by 45 deg."""
    velocity_n = 10.0 * np.column_stack([np.cos(YAW), np.sin(YAW), np.zeros(len(T))])
    column = np.array([-1.0, 0.0, 1.0]) / np.sqrt(2.0)
    wheel = so3.exp(0.6 * np.sin(3.0 * T)[:, None] * column)
    R_ns = rotation_from_euler(np.zeros(len(T)), np.zeros(len(T)), YAW) @ wheel @ AXES
    zeros = np.zeros((len(T), 3))
    constants = Constants(0.0, 0.0, AXES.T @ ARM, level_axes_s=AXES, is_steered=is_steered)
    return ChainState(T, R_ns, zeros, velocity_n, zeros, zeros, zeros, constants)


def path_of(state: ChainState) -> DensePath:
    none = np.zeros((len(T) - 1, 3))
    return DensePath(state.t, state.R_ns, state.position_n, state.velocity_n, none, none)


def test_on_the_wheel_it_keeps_to_the_course_at_keyframes_on_the_path_and_at_any_time() -> None:
    state = steered()
    want = rotation_from_euler(np.zeros(len(T)), np.zeros(len(T)), YAW) @ AXES
    path, at = path_of(state), T[:-1] + 0.07
    np.testing.assert_allclose(arm_axes(state), want, atol=1e-12)
    np.testing.assert_allclose(arm_axes_along(path, state.constants), want, atol=1e-12)
    want = rotation_from_euler(np.zeros(len(at)), np.zeros(len(at)), 3.0 + 0.4 * at) @ AXES
    np.testing.assert_allclose(arm_axes_at(path, state.constants, at, state.R_ns[:-1]), want, atol=1e-12)
    assert not np.any(turning_arm(state))


def test_on_a_frame_it_keeps_to_the_box() -> None:
    state = steered(is_steered=False)
    path = path_of(state)
    for axes in (arm_axes(state), arm_axes_along(path, state.constants), turning_arm(state)):
        np.testing.assert_array_equal(axes, state.R_ns)
    np.testing.assert_array_equal(arm_axes_at(path, state.constants, T, state.R_ns), state.R_ns)


def test_the_course_of_a_kart_that_stands_is_between_those_before_and_after() -> None:
    velocity_n = np.zeros((5, 3))
    velocity_n[0, 1], velocity_n[4, 0] = 9.0, -9.0
    np.testing.assert_allclose(course(velocity_n), np.radians([90.0, 112.5, 135.0, 157.5, 180.0]))
    np.testing.assert_array_equal(course(np.zeros((3, 3))), np.zeros(3))
