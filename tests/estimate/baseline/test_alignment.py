from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.baseline.alignment import (
    Course,
    course_of,
    forward_of_box,
    north_from_motion,
    rest_state,
)
from smoother.frames import Origin, rotation_from_euler, wrap_angle
from smoother.samples import GnssFixes, ImuSamples, Session
from smoother.units import DEG, STANDARD_GRAVITY

BIAS = np.array([5.0, -3.0, 58.0]) * DEG


def winding(t, least=0.0):
    """Velocity, acceleration and yaw of a drive with straights and turns, at 12 m/s after setting off at 10 s."""
    speed = 12.0 * np.clip((t - 10.0) / 4.0, 0.0, 1.0)
    driven = np.clip(t - 20.0, 0.0, None)
    yaw = 0.8 + 1.5 * np.sin(driven / 4.0) * (np.sin(driven / 16.0) > least)
    velocity = speed[:, None] * np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    return velocity, np.gradient(velocity, t, axis=0), yaw


def fixes(t, velocity=None):
    n = len(t)
    velocity = np.full((n, 3), np.nan) if velocity is None else np.column_stack([velocity, np.zeros(n)])
    return GnssFixes(t, np.full(n, 45.0), np.full(n, 10.0), np.zeros(n), velocity)


def session_of(t, rate_up, force, R_sb, fix_t, velocity):
    rate = np.stack([0.0 * t, 0.0 * t, rate_up], axis=1) @ R_sb.T + BIAS
    imu = ImuSamples(t, force @ R_sb.T, rate)
    return Session("s", fixes(fix_t, velocity), Origin(45.0, 10.0, 0.0), imu=imu)


@pytest.mark.parametrize("north", [0.0, 2.0, -3.0])
def test_north_is_found_by_comparing_accelerations_with_those_of_the_fixes(north):
    t = np.arange(0.0, 90.0, 0.02)
    _, acceleration, _ = winding(t)
    fix_t = np.arange(0.0, 90.0, 0.2)
    velocity, _, _ = winding(fix_t)
    c, s = np.cos(north), np.sin(north)
    own = acceleration @ np.array([[c, s], [-s, c]]).T  # seen in axes turned by `north`
    noisy = own + 2.0 * np.random.default_rng(1).normal(size=own.shape)
    found = north_from_motion(t, noisy, Course(fix_t, velocity))
    # the noise makes 2 m/s^2 sqrt(0.02 s x 1 s) = 0.3 m/s of each change, of which 60 s hold 60
    assert abs(wrap_angle(np.asarray(found - north))) < 2.0 * DEG


def test_without_motion_north_stays_unknown():
    t = np.arange(0.0, 30.0, 0.02)
    course = Course(np.arange(0.0, 30.0, 0.2), np.zeros((150, 2)))
    assert north_from_motion(t, np.zeros((t.size, 2)), course) is None


@pytest.mark.parametrize("heading", [0.0, 1.0, 3.1, -2.0])
def test_forward_is_where_the_kart_goes_on_straights(heading):
    t = np.arange(0.0, 120.0, 0.02)
    _, _, yaw = winding(t, -0.7)  # mostly corners
    slip = 12.0 * DEG * np.abs(np.tanh(3.0 * np.gradient(yaw, t)))  # in corners the nose points off the path
    fix_t = np.arange(0.0, 120.0, 0.2)
    found = forward_of_box(t, wrap_angle(yaw + slip + heading), Course(fix_t, winding(fix_t, -0.7)[0]), np.inf)
    assert abs(wrap_angle(np.asarray(found - heading))) < 0.5 * DEG


def test_forward_uses_only_the_first_part_of_the_drive_where_yaw_drifts():
    t = np.arange(0.0, 300.0, 0.02)
    fix_t = np.arange(0.0, 300.0, 0.2)
    drift = np.where(t > 80.0, 2.0, 0.0)
    found = forward_of_box(t, wrap_angle(winding(t)[2] + drift), Course(fix_t, winding(fix_t)[0]), 60.0)
    assert abs(found) < 1.0 * DEG


def test_without_motion_forward_stays_unknown():
    t = np.arange(0.0, 30.0, 0.02)
    assert forward_of_box(t, 0.0 * t, Course(np.arange(0.0, 30.0, 0.2), np.zeros((150, 2))), np.inf) is None


def still_then_driving(R_sb, still=True):
    t = np.arange(0.005, 60.0, 0.005) + (0.0 if still else 14.0)
    _, acceleration, yaw = winding(t)
    forward = acceleration[:, 0] * np.cos(yaw) + acceleration[:, 1] * np.sin(yaw)
    left = -acceleration[:, 0] * np.sin(yaw) + acceleration[:, 1] * np.cos(yaw)
    force = np.stack([forward, left, np.full(t.size, STANDARD_GRAVITY)], axis=1)
    fix_t = np.arange(t[0], t[-1], 0.2)
    rng = np.random.default_rng(2)
    return session_of(
        t, np.gradient(yaw, t), force + 0.3 * rng.normal(size=force.shape), R_sb, fix_t, winding(fix_t)[0]
    )


def test_bias_and_level_come_from_the_rest_at_the_start():
    R_sb = rotation_from_euler(np.asarray(0.3), np.asarray(-0.5), np.asarray(2.0)).T
    session = still_then_driving(R_sb)
    rest = rest_state(session, session.imu, course_of(session.gnss, np.zeros((len(session.gnss), 2))))
    np.testing.assert_allclose(rest.gyro_bias, BIAS, atol=0.02 * DEG)
    np.testing.assert_allclose(rest.R_ls @ R_sb[:, 2], [0.0, 0.0, 1.0], atol=0.005)
    assert rest.start[0] < 0.1
    assert 8.0 < rest.start[1] < 10.0
    assert rest.problems == ()


def test_without_a_rest_the_mean_over_the_drive_is_used_and_reported():
    R_sb = rotation_from_euler(np.asarray(0.3), np.asarray(-0.5), np.asarray(2.0)).T
    session = still_then_driving(R_sb, still=False)
    rest = rest_state(session, session.imu, course_of(session.gnss, np.zeros((len(session.gnss), 2))))
    assert [problem.code for problem in rest.problems] == ["baseline_no_standstill"]
    assert not np.any(rest.is_at_rest)
    np.testing.assert_allclose(rest.gyro_bias, BIAS, atol=0.5 * DEG)
    up = rest.R_ls @ R_sb[:, 2]
    assert np.arccos(up[2]) < 5.0 * DEG  # a drive does not end where it began, so the mean force leans
    assert rest.start[1] - rest.start[0] == 1.0


def test_many_turns_one_way_are_not_taken_for_a_bias():
    t = np.arange(0.005, 120.0, 0.005)
    fix_t = np.arange(0.2, 119.0, 0.2)
    turn = 0.6
    velocity = 12.0 * np.stack([np.cos(turn * fix_t), np.sin(turn * fix_t)], axis=1)
    force = np.tile([0.0, 12.0 * turn, STANDARD_GRAVITY], (t.size, 1))
    session = session_of(t, np.full(t.size, turn), force, np.eye(3), fix_t, velocity)
    rest = rest_state(session, session.imu, course_of(session.gnss, np.zeros((fix_t.size, 2))))
    # the force leans outwards all the time, 36 degrees; the turn is shared out along it
    assert np.linalg.norm(rest.gyro_bias - BIAS) < turn * np.sin(40.0 * DEG)
    assert np.linalg.norm(np.mean(session.imu.angular_rate_s, axis=0) - BIAS) > 0.99 * turn


def test_velocity_comes_from_the_receiver_else_from_positions():
    t = 0.2 * np.arange(100)
    position = np.stack([10.0 * t, -4.0 * t], axis=1)
    np.testing.assert_allclose(course_of(fixes(t), position).velocity, np.tile([10.0, -4.0], (100, 1)))
    sent = np.tile([7.0, 1.0], (100, 1))
    np.testing.assert_allclose(course_of(fixes(t, sent), position).velocity, sent)
    partly = replace(fixes(t, sent), velocity_n=np.where(np.arange(100) < 50, np.nan, 7.0)[:, None] * np.ones(3))
    np.testing.assert_allclose(course_of(partly, position).velocity[:49], np.tile([10.0, -4.0], (49, 1)))


def test_a_single_fix_has_no_velocity():
    np.testing.assert_array_equal(course_of(fixes(np.array([1.0])), np.zeros((1, 2))).velocity, [[0.0, 0.0]])
