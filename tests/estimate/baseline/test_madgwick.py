import numpy as np
import pytest
from ahrs.filters import Madgwick

from smoother import so3
from smoother.estimate.baseline.madgwick import run_madgwick
from smoother.frames import rotation_from_euler
from smoother.units import DEG, STANDARD_GRAVITY

DIP = 60.0 * DEG
FIELD_N = np.array([np.cos(DIP), 0.0, -np.sin(DIP)])
UP = np.array([0.0, 0.0, STANDARD_GRAVITY])
IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def at_rest(R_ns, seconds, rate=100.0, gyro_bias=0.0):
    n = int(seconds * rate)
    force = np.tile(STANDARD_GRAVITY * R_ns[2], (n, 1))
    field = np.tile(R_ns.T @ FIELD_N, (n, 1))
    return np.full(n, 1.0 / rate), force, np.zeros((n, 3)) + gyro_bias, field


def angle_between(q, R):
    return np.linalg.norm(so3.log(so3.from_quaternion_wxyz(q).swapaxes(-1, -2) @ R), axis=-1)


@pytest.mark.parametrize("has_field", [False, True])
@pytest.mark.parametrize("beta", [0.13, 0.5])
def test_the_update_equals_an_independent_implementation_when_zeta_is_zero(has_field, beta):
    rng = np.random.default_rng(1)
    n, dt = 400, 0.02
    force = rng.normal(size=(n, 3)) + UP
    rate = rng.normal(size=(n, 3))
    field = 30.0 * (FIELD_N + 0.3 * rng.normal(size=(n, 3))) if has_field else None
    start = rng.normal(size=4)
    start /= np.linalg.norm(start)
    other, q = Madgwick(gain=beta), start
    expected = []
    for i in range(n):
        if field is None:
            q = other.updateIMU(q, rate[i], force[i], dt=dt)
        else:
            q = other.updateMARG(q, rate[i], force[i], field[i], dt=dt)
        expected.append(q)
    found, bias = run_madgwick(np.full(n, dt), force, rate, field, start, beta, 0.0)
    np.testing.assert_allclose(found, expected, atol=1e-12)
    np.testing.assert_array_equal(bias, 0.0)


@pytest.mark.parametrize("seed", range(4))
def test_it_settles_on_the_true_attitude_at_rest(seed):
    rng = np.random.default_rng(seed)
    roll, pitch, yaw = rng.uniform(-1.0, 1.0, 3) * [np.pi, 1.4, np.pi]
    R_ns = rotation_from_euler(np.asarray(roll), np.asarray(pitch), np.asarray(yaw))
    off = so3.quaternion_wxyz(R_ns @ so3.exp(0.7 * rng.normal(size=3)))
    q, _ = run_madgwick(*at_rest(R_ns, 60.0), off, 0.13, 0.0)
    assert angle_between(q[-1], R_ns) < 0.2 * DEG  # beta * dt is 0.07 deg, to which it dithers


def test_without_a_field_it_levels_and_keeps_its_yaw():
    R_ns = rotation_from_euler(np.asarray(0.2), np.asarray(-0.3), np.asarray(1.0))
    step, force, rate, _ = at_rest(R_ns, 60.0)
    # start with the tilt wrong by a rotation about a level axis, so that the yaw about Up is right
    start = so3.quaternion_wxyz(so3.exp(np.array([0.4, -0.2, 0.0])) @ R_ns)
    q, _ = run_madgwick(step, force, rate, None, start, 0.13, 0.0)
    up = so3.from_quaternion_wxyz(q[-1])[2]
    assert np.arccos(np.clip(up @ R_ns[2], -1.0, 1.0)) < 0.2 * DEG
    assert angle_between(q[-1], R_ns) < 3.0 * DEG  # levelling itself turns a little about Up


def test_a_constant_rate_is_integrated_to_the_right_angle():
    n, dt, rate = 2000, 0.005, 40.0 * DEG
    angular = np.tile([0.0, 0.0, rate], (n, 1))
    force = np.tile(UP, (n, 1))
    q, _ = run_madgwick(np.full(n, dt), force, angular, None, IDENTITY, 0.13, 0.0)
    R = so3.exp(np.array([0.0, 0.0, rate * n * dt]))
    assert angle_between(q[-1], R) < 0.05 * DEG  # eq. 2.44 goes straight on: (rate dt)^3 / 12 each step


def test_zeta_finds_a_constant_gyro_bias():
    # Madgwick 2010, eq. 47-49: what the gradient says about the rate, added up
    bias = np.array([0.5, -0.8, 0.6]) * DEG
    step, force, rate, field = at_rest(np.eye(3), 120.0, gyro_bias=bias)
    q, found = run_madgwick(step, force, rate, field, IDENTITY, 0.13, 0.01)
    np.testing.assert_allclose(np.mean(found[-2000:], axis=0), bias, atol=0.05 * DEG)
    assert np.mean(angle_between(q[-2000:], np.eye(3))) < 0.2 * DEG


def test_a_disturbed_field_turns_the_heading_and_never_tilts_the_level():
    step, force, rate, field = at_rest(np.eye(3), 120.0)
    disturbed = field + np.array([0.1, 0.4, 0.5])
    q, _ = run_madgwick(step, force, rate, disturbed, IDENTITY, 0.13, 0.0)
    R = so3.from_quaternion_wxyz(q[-1])
    assert np.arccos(R[2, 2]) < 0.3 * DEG
    assert abs(np.arctan2(R[1, 0], R[0, 0])) > 20.0 * DEG


def test_the_heading_follows_magnetic_north_at_x():
    R_ns = so3.exp(np.array([0.0, 0.0, 1.2]))
    step, force, rate, field = at_rest(R_ns, 1.0)
    q, _ = run_madgwick(step, force, rate, field, so3.quaternion_wxyz(R_ns), 0.13, 0.0)
    assert angle_between(q[-1], R_ns) < 0.1 * DEG


def test_samples_without_a_field_reading_take_the_form_without_magnetometer():
    rng = np.random.default_rng(6)
    n = 100
    force, rate = rng.normal(size=(n, 3)) + UP, rng.normal(size=(n, 3))
    step = np.full(n, 0.02)
    without, _ = run_madgwick(step, force, rate, None, IDENTITY)
    empty, _ = run_madgwick(step, force, rate, np.full((n, 3), np.nan), IDENTITY)
    zero, _ = run_madgwick(step, force, rate, np.zeros((n, 3)), IDENTITY)
    np.testing.assert_array_equal(empty, without)
    np.testing.assert_array_equal(zero, without)


def test_a_force_of_zero_corrects_nothing():
    rate = np.tile([0.1, 0.2, 0.3], (50, 1))
    step = np.full(50, 0.01)
    q, bias = run_madgwick(step, np.zeros((50, 3)), rate, np.tile(FIELD_N, (50, 1)), IDENTITY)
    free, _ = run_madgwick(step, np.zeros((50, 3)), rate, None, IDENTITY, 0.0, 0.0)
    np.testing.assert_array_equal(q, free)
    np.testing.assert_array_equal(bias, 0.0)
