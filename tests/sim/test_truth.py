import numpy as np
import pytest

from smoother import so3
from smoother.frames import GRAVITY_N, Origin, geodetic_to_nwu
from smoother.sim.motion import Motion, drive
from smoother.sim.track import TRACKS
from smoother.sim.truth import CHANNELS, Clock, Truth
from smoother.units import STANDARD_GRAVITY

ARM = np.array([0.4, -0.25, 0.3])
ORIGIN = Origin(45.0, 9.0, 100.0)


@pytest.fixture(scope="module")
def truth():
    return drive(TRACKS["larkfield"], Motion(standstill=5.0), 80.0, np.random.default_rng(4))


def random_times(count=500, start=0.0, stop=80.0):
    return np.sort(np.random.default_rng(0).uniform(start, stop, count))


def central(function, t, h=1e-4):
    """Derivative by central differences, fourth order."""
    return (8.0 * (function(t + h) - function(t - h)) - (function(t + 2 * h) - function(t - 2 * h))) / (12.0 * h)


def assert_agree(actual, expected, relative):
    assert np.max(np.abs(actual - expected)) < relative * np.max(np.abs(expected))


def test_velocity_and_acceleration_are_derivatives_of_position(truth):
    t = random_times()
    states = truth.at(t)
    assert_agree(states.velocity_n, central(lambda x: truth.at(x).position_n, t), 1e-6)
    assert_agree(states.acceleration_n, central(lambda x: truth.at(x).velocity_n, t), 1e-6)


def test_rate_and_angular_acceleration_are_derivatives_of_attitude(truth):
    t = random_times()
    states = truth.at(t)
    derivative = central(lambda x: truth.at(x).R_nb, t)
    spin = np.swapaxes(states.R_nb, 1, 2) @ derivative  # R' = R skew(w)
    expected = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    assert_agree(states.angular_rate_b, expected, 1e-6)
    assert_agree(states.angular_acceleration_b, central(lambda x: truth.at(x).angular_rate_b, t), 1e-6)


def test_antenna_moves_as_a_point_of_the_rigid_kart(truth):
    t = random_times()
    position = truth.antenna_position_n(t, ARM)
    np.testing.assert_allclose(np.linalg.norm(position - truth.at(t).position_n, axis=1), np.linalg.norm(ARM))
    assert_agree(truth.antenna_velocity_n(t, ARM), central(lambda x: truth.antenna_position_n(x, ARM), t), 1e-6)


@pytest.mark.parametrize("name", TRACKS)
def test_integrating_specific_force_and_rate_gives_the_position_back_to_a_centimetre(name):
    truth = drive(TRACKS[name], Motion(), 61.0, np.random.default_rng(5))
    h, steps = 5e-4, 120_000  # a minute at 2 kHz
    t = np.linspace(0.0, h * steps, steps + 1)
    states = truth.at(t)
    R_nb = integrated_attitude(truth, t, states.R_nb[0])
    acceleration = np.einsum("nij,nj->ni", R_nb, states.specific_force_b) + GRAVITY_N
    first, middle, last = acceleration[:-2:2], acceleration[1:-1:2], acceleration[2::2]
    velocity = states.velocity_n[0] + np.cumsum((first + 4.0 * middle + last) * (h / 3.0), axis=0)  # Simpson
    before = np.vstack([states.velocity_n[:1], velocity[:-1]])
    move = 2.0 * h * before + (first + 2.0 * middle) * (2.0 * h * h / 3.0)
    position = states.position_n[0] + np.cumsum(move, axis=0)
    error = np.linalg.norm(position - states.position_n[2::2], axis=1)
    assert np.max(error) < 1e-5  # the promise is a centimetre; a fourth-order integrator shows far better


def integrated_attitude(truth, t, start):
    """Attitude from the rate alone. Source: fourth-order Magnus expansion on two Gauss points."""
    h = t[1] - t[0]
    middle, offset = t[:-1] + 0.5 * h, h * np.sqrt(3.0) / 6.0
    early, late = truth.at(middle - offset).angular_rate_b, truth.at(middle + offset).angular_rate_b
    turn = so3.exp(0.5 * h * (early + late) + np.sqrt(3.0) / 12.0 * h * h * np.cross(early, late))
    R = [start]
    for step in turn:
        R.append(R[-1] @ step)
    return np.array(R)


def circle(radius=20.0, turn_rate=0.8, step=0.02, duration=30.0):
    """A level circle to the left, driven nose first. The B-spline scales a sinusoid by a known factor."""
    t = np.arange(-1.0, duration + 1.0, step)
    angle = turn_rate * t
    control = np.zeros((len(t), CHANNELS))
    control[:, 0], control[:, 1] = radius * np.cos(angle), radius * np.sin(angle)
    control[:, 5] = angle + 0.5 * np.pi
    u = turn_rate * step
    shrink = (66.0 + 52.0 * np.cos(u) + 2.0 * np.cos(2.0 * u)) / 120.0  # the quintic B-spline's values at its knots
    return Truth(ORIGIN, control, t[0], step), radius * shrink


def test_constant_turn_reads_the_centripetal_force_and_the_turn_rate():
    truth, radius = circle()
    t = 0.02 * np.arange(50, 1400)
    states = truth.at(t)
    np.testing.assert_allclose(states.angular_rate_b, np.tile([0.0, 0.0, 0.8], (len(t), 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(states.velocity_n, axis=1), 0.8 * radius, rtol=1e-8)
    force = states.specific_force_b
    np.testing.assert_allclose(force, np.tile([0.0, 0.64 * radius, STANDARD_GRAVITY], (len(t), 1)), atol=1e-5)


def test_kart_at_rest_on_a_level_grid_reads_gravity_upwards():
    flat = Motion(driving=False, standstill=10.0, roughness=0.0)
    truth = drive(TRACKS["larkfield"], flat, 10.0, np.random.default_rng(0))
    states = truth.at(np.linspace(0.0, 10.0, 50))
    slope = TRACKS["larkfield"].slope(np.array([-flat.grid_distance]))[0]
    g = STANDARD_GRAVITY
    uphill = np.array([g * np.sin(np.arctan(slope)), 0.0, g * np.cos(np.arctan(slope))])
    np.testing.assert_allclose(states.specific_force_b, np.tile(uphill, (50, 1)), atol=1e-9)
    assert np.max(np.abs([states.velocity_n, states.angular_rate_b])) < 1e-11  # rounding of the spline's weights


def test_crossings_are_on_the_line_to_a_microsecond(truth):
    track = TRACKS["larkfield"]
    for arm in (None, ARM):
        t = truth.crossings(track.start_line, arm)
        assert len(t) == 2
        position = truth.antenna_position_n(t, np.zeros(3) if arm is None else arm)[:, :2]
        past = (position - track.start_line.mean(axis=0)) @ track.tangent(np.zeros(1))[0]
        assert np.max(np.abs(past)) < 20.0 * 1e-6


def test_antenna_ahead_of_the_imu_crosses_earlier_by_its_lead_over_the_speed(truth):
    line = TRACKS["larkfield"].start_line
    imu, antenna = truth.crossings(line), truth.crossings(line, np.array([0.5, 0.0, 0.0]))
    speed = np.linalg.norm(truth.at(imu).velocity_n, axis=1)
    np.testing.assert_allclose(imu - antenna, 0.5 / speed, rtol=0.01)  # speed changes a little over half a metre


def test_line_driven_through_backwards_does_not_count(truth):
    assert len(truth.crossings(TRACKS["larkfield"].start_line[::-1])) == 0


def test_line_beside_the_path_does_not_count(truth):
    line = TRACKS["larkfield"].start_line
    for line_widths in (0.7, 3.0, -0.7):
        aside = line + line_widths * (line[0] - line[1])
        assert len(truth.crossings(aside)) == 0


def test_clock_of_the_session_changes_stamps_and_not_motion():
    plain = drive(TRACKS["tinbarn"], Motion(), 60.0, np.random.default_rng(1))
    clock = Clock(offset=12.5, drift=-200e-6)
    shifted = drive(TRACKS["tinbarn"], Motion(), 60.0, np.random.default_rng(1), clock)
    true_time = random_times(50, 0.0, 60.0)
    session = clock.to_session(true_time)
    np.testing.assert_allclose(clock.to_true(session), true_time, rtol=1e-12)
    np.testing.assert_allclose(shifted.at(session).velocity_n, plain.at(true_time).velocity_n, atol=1e-9)
    np.testing.assert_allclose(
        clock.to_true(shifted.crossings(TRACKS["tinbarn"].start_line)),
        plain.crossings(TRACKS["tinbarn"].start_line),
        atol=1e-9,
    )


def test_truth_outside_the_session_is_unknown(truth):
    states = truth.at(np.array([truth.first - 0.1, truth.last + 0.1]))
    assert np.all(np.isnan(states.position_n))
    assert np.all(np.isfinite(truth.at(np.array([truth.first, truth.last - 1e-9])).position_n))


def test_trajectory_in_another_origin_is_the_same_motion(truth):
    t = random_times(40)
    origin = Origin(truth.origin.lat_deg + 0.004, truth.origin.lon_deg - 0.006, truth.origin.alt_m + 20.0)
    there = truth.trajectory(t, ARM, origin)
    expected = geodetic_to_nwu(*truth.antenna_geodetic(t, ARM), origin)
    np.testing.assert_allclose(there.position_n, expected, atol=1e-6)
    velocity = central(lambda x: geodetic_to_nwu(*truth.antenna_geodetic(x, ARM), origin), t, h=1e-2)
    assert np.max(np.abs(there.velocity_n - velocity)) < 1e-3  # without the turn of the axes: 0.02
    np.testing.assert_allclose(there.acceleration_b, truth.trajectory(t, ARM).acceleration_b)
    here = truth.trajectory(t, ARM)
    tilt = so3.log(np.swapaxes(here.R_nb, 1, 2) @ there.R_nb)
    assert 1e-5 < np.max(np.abs(tilt)) < 2e-4  # 600 m on a globe of 6371 km
