import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from smoother import so3
from smoother.fit.ellipsoid import FitError
from smoother.fit.levelling import level_angles, levelled, yaw_from_field
from smoother.fit.magnetic_model import field_n
from smoother.frames import GRAVITY_N, euler_from_rotation, rotation_from_euler
from smoother.units import DEG

angle = st.floats(-np.pi, np.pi)
tilt = st.floats(-89.0 * DEG, 89.0 * DEG)


def attitude(roll, pitch, yaw):
    return rotation_from_euler(np.asarray(roll), np.asarray(pitch), np.asarray(yaw))


def readings(R_ns, declination, inclination):
    return R_ns.T @ -GRAVITY_N, R_ns.T @ field_n(declination, inclination, 48.0)


@given(angle, tilt, angle, st.floats(-60.0 * DEG, 60.0 * DEG), st.floats(-80.0 * DEG, 80.0 * DEG))
def test_attitude_at_rest_comes_back_for_any_attitude_declination_and_inclination(roll, pitch, yaw, declination, dip):
    R_ns = attitude(roll, pitch, yaw)
    force, field = readings(R_ns, declination, dip)
    found = attitude(*level_angles(force), yaw_from_field(field, force, declination))  # eq. 2.18
    assert np.linalg.norm(so3.log(found.T @ R_ns)) < 1e-6


def test_nose_down_is_positive_pitch_and_right_side_down_positive_roll():
    roll, pitch = level_angles(np.array([-1.0, 0.0, 9.0]))  # forward-left-up: nose down, forward axis reads downhill
    assert roll == 0.0
    assert pitch > 0.0
    roll, pitch = level_angles(np.array([0.0, 1.0, 9.0]))  # the left side is up
    assert roll > 0.0
    assert pitch == 0.0


def test_levelled_turns_the_force_upwards_and_leaves_the_heading():
    force = np.array([2.0, -3.0, 8.0])
    np.testing.assert_allclose(levelled(force) @ force, [0.0, 0.0, np.linalg.norm(force)], atol=1e-12)
    _, _, yaw = euler_from_rotation(levelled(force))
    assert abs(yaw) < 1e-12


def test_a_logger_upside_down_is_levelled_too():
    np.testing.assert_allclose(levelled(np.array([0.0, 0.0, -9.8])) @ [0.0, 0.0, -1.0], [0.0, 0.0, 1.0], atol=1e-12)


def test_yaw_is_zero_facing_north_and_positive_towards_west():
    up, dip = np.array([0.0, 0.0, 9.8]), 60.0 * DEG
    assert abs(yaw_from_field(field_n(0.0, dip), up)) < 1e-12
    facing_west = attitude(0.0, 0.0, 90.0 * DEG)
    assert abs(yaw_from_field(facing_west.T @ field_n(0.0, dip), up) - 90.0 * DEG) < 1e-12


# ---- the errata of the thesis ---------------------------------------------------------------------------------------


def printed_2_32(field, roll, pitch):
    s, c = np.sin, np.cos
    x, y, z = field
    return np.arctan2(c(roll) * y - s(roll) * z, c(pitch) * x + s(roll) * s(pitch) * y + c(roll) * s(pitch) * z)


@given(angle, tilt, angle, st.floats(-80.0 * DEG, 80.0 * DEG))
def test_equation_2_32_as_printed_gives_minus_the_yaw(roll, pitch, yaw, dip):
    force, field = readings(attitude(roll, pitch, yaw), 0.0, dip)
    roll, pitch = level_angles(force)
    printed, right = printed_2_32(field, roll, pitch), yaw_from_field(field, force)
    assert np.cos(printed + right) > 1.0 - 1e-9
    assert np.cos(right - yaw) > 1.0 - 1e-9


def test_equation_2_17_is_the_matrix_2_18_with_r_y_in_the_middle_and_not_with_r_z_twice():
    roll, pitch, yaw = 0.3, -0.4, 1.1
    c, s = np.cos, np.sin

    def R_z(a):
        return np.array([[c(a), -s(a), 0], [s(a), c(a), 0], [0, 0, 1]])

    def R_x(a):
        return np.array([[1, 0, 0], [0, c(a), -s(a)], [0, s(a), c(a)]])

    def R_y(a):
        return np.array([[c(a), 0, s(a)], [0, 1, 0], [-s(a), 0, c(a)]])

    printed_2_11 = R_y(pitch).T
    np.testing.assert_allclose(R_z(yaw) @ R_y(pitch) @ R_x(roll), attitude(roll, pitch, yaw), atol=1e-12)  # 2.18
    assert np.max(np.abs(R_z(yaw) @ R_z(pitch) @ R_x(roll) - attitude(roll, pitch, yaw))) > 0.1
    assert np.max(np.abs(R_z(yaw) @ printed_2_11 @ R_x(roll) - attitude(roll, pitch, yaw))) > 0.1


def test_equation_2_28_as_printed_has_the_west_component_with_the_wrong_sign():
    declination, dip = 10.0 * DEG, 60.0 * DEG  # magnetic north lies 10 degrees east of true north
    printed = np.array([np.cos(dip) * np.cos(declination), np.cos(dip) * np.sin(declination), -np.sin(dip)])
    right = field_n(declination, dip)
    assert right[1] < 0.0  # east is negative on the west axis
    np.testing.assert_allclose(printed * [1.0, -1.0, 1.0], right)
    # a box that faces true north is found to do so only with the right sign
    assert abs(yaw_from_field(right, np.array([0.0, 0.0, 9.8]), declination)) < 1e-12
    assert abs(yaw_from_field(printed, np.array([0.0, 0.0, 9.8]), declination)) > 19.9 * DEG


@pytest.mark.parametrize("force", [[0.0, 0.0, 0.0], [np.nan, 0.0, 9.8]])
def test_a_force_that_points_nowhere_is_refused(force):
    with pytest.raises(FitError, match="where up is"):
        level_angles(np.array(force))


@pytest.mark.parametrize("field", [[0.0, 0.0, 40.0], [0.0, 0.0, 0.0], [np.nan, 1.0, 1.0]])
def test_a_field_without_a_horizontal_part_is_refused(field):
    with pytest.raises(FitError, match="where north is"):
        yaw_from_field(np.array(field), np.array([0.0, 0.0, 9.8]))
