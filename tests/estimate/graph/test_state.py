"""The unknowns: where each sits in the tangent, and what a step along the tangent does."""

import gtsam
import numpy as np
import pytest

from smoother import so3
from smoother.estimate.graph import state as st
from smoother.estimate.graph.state import ChainState, Constants

K = 4


def random_state() -> ChainState:
    rng = np.random.default_rng(0)
    R_ns = so3.exp(rng.normal(size=(K, 3)))
    return ChainState(0.2 * np.arange(K), R_ns, *rng.normal(size=(5, K, 3)), random_constants())


def random_constants() -> Constants:
    rng = np.random.default_rng(1)
    return Constants.from_vector(rng.normal(size=st.CONSTANTS_SIZE), so3.exp(rng.normal(size=3)))


@pytest.mark.parametrize(
    ("size", "parts"),
    [
        (st.KEYFRAME_SIZE, (st.ROTATION, st.TRANSLATION, st.VELOCITY, st.ACCEL_BIAS, st.GYRO_BIAS, st.OFFSET)),
        (
            st.ROW_CONSTANTS_SIZE,
            (
                *(st.POSITION_LATENCY, st.VELOCITY_LATENCY, st.LEVER_ARM, st.HEADING_OFFSET),
                *(st.DOPPLER_BIAS, st.VELOCITY_RESPONSE, st.EVENNESS, st.SLIP, st.COURSE_DELAY),
            ),
        ),
        (st.CONSTANTS_SIZE, (slice(0, st.ROW_CONSTANTS_SIZE), st.ACCEL_ERROR, st.GYRO_ERROR, st.RECTIFICATION)),
    ],
)
def test_the_parts_of_a_tangent_fill_it_without_overlap(size: int, parts: tuple[slice, ...]) -> None:
    assert [i for part in parts for i in range(part.start, part.stop)] == list(range(size))


def test_each_constant_sits_where_its_name_says() -> None:
    vector = np.arange(float(st.CONSTANTS_SIZE))
    constants = Constants.from_vector(vector, np.eye(3))
    np.testing.assert_array_equal(constants.as_vector(), vector)
    assert constants.position_latency == vector[st.POSITION_LATENCY]
    assert constants.velocity_latency == vector[st.VELOCITY_LATENCY]
    assert constants.heading_offset == vector[st.HEADING_OFFSET]
    np.testing.assert_array_equal(constants.lever_arm_s, vector[st.LEVER_ARM])
    np.testing.assert_array_equal(constants.doppler_bias_n, vector[st.DOPPLER_BIAS])
    assert constants.velocity_response == vector[st.VELOCITY_RESPONSE]
    assert constants.evenness == vector[st.EVENNESS]
    np.testing.assert_array_equal(constants.slip, vector[st.SLIP])
    assert constants.course_delay == vector[st.COURSE_DELAY]
    np.testing.assert_array_equal(constants.accel_error.ravel(), vector[st.ACCEL_ERROR])
    np.testing.assert_array_equal(constants.gyro_error.ravel(), vector[st.GYRO_ERROR])
    np.testing.assert_array_equal(constants.rectification.ravel(), vector[st.RECTIFICATION])


def test_errors_of_scale_act_across_gravity_and_about_it_only() -> None:
    constants = random_constants()
    right, left, up = constants.level_axes_s
    np.testing.assert_allclose(constants.accel_matrix @ up, 0.0, atol=1e-12)
    np.testing.assert_allclose(constants.accel_matrix @ right, constants.accel_error[:, 0])
    np.testing.assert_allclose(constants.accel_matrix @ left, constants.accel_error[:, 1])
    np.testing.assert_allclose(constants.gyro_matrix @ (right + 2.0 * left), 0.0, atol=1e-12)
    np.testing.assert_allclose(constants.gyro_matrix @ up, constants.gyro_error)


def test_constants_move_by_the_step_and_keep_their_axes() -> None:
    constants, step = random_constants(), np.random.default_rng(2).normal(size=st.CONSTANTS_SIZE)
    np.testing.assert_allclose(constants.retract(step).as_vector(), constants.as_vector() + step)
    np.testing.assert_array_equal(constants.retract(step).level_axes_s, constants.level_axes_s)


def test_a_step_moves_poses_in_their_own_axes_as_gtsam_does() -> None:
    state, rng = random_state(), np.random.default_rng(3)
    step = 1e-4 * rng.normal(size=(K, st.KEYFRAME_SIZE))
    moved = state.retract(step, np.zeros(st.CONSTANTS_SIZE))
    for k in range(K):
        pose = gtsam.Pose3(gtsam.Rot3(state.R_ns[k]), state.position_n[k]).retract(step[k, :6])
        np.testing.assert_allclose(moved.R_ns[k], pose.rotation().matrix(), atol=1e-12)
        # GTSAM's step turns on its way, which is of second order
        np.testing.assert_allclose(moved.position_n[k], pose.translation(), atol=1e-7)


def test_a_step_adds_to_everything_else() -> None:
    state, rng = random_state(), np.random.default_rng(4)
    step, constants = rng.normal(size=(K, st.KEYFRAME_SIZE)), rng.normal(size=st.CONSTANTS_SIZE)
    moved = state.retract(step, constants)
    for name, part in (
        ("velocity_n", st.VELOCITY),
        ("accel_bias_s", st.ACCEL_BIAS),
        ("gyro_bias_s", st.GYRO_BIAS),
        ("offset_n", st.OFFSET),
    ):
        np.testing.assert_allclose(getattr(moved, name), getattr(state, name) + step[:, part])
    np.testing.assert_allclose(moved.constants.as_vector(), state.constants.as_vector() + constants)
    assert moved.interval == state.interval == pytest.approx(0.2)


def test_a_zero_step_changes_nothing() -> None:
    state = random_state()
    same = state.retract(np.zeros((K, st.KEYFRAME_SIZE)), np.zeros(st.CONSTANTS_SIZE))
    np.testing.assert_allclose(same.R_ns, state.R_ns, atol=1e-15)
    np.testing.assert_array_equal(same.position_n, state.position_n)
