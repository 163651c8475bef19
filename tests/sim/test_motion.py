from dataclasses import replace

import numpy as np
import pytest

from smoother.frames import euler_from_rotation
from smoother.sim.motion import Motion, Spin, Stop, drive, wander
from smoother.sim.track import TRACKS
from smoother.units import DEG, STANDARD_GRAVITY

RATE = 100.0


def states_of(truth, duration, start=0.0):
    return truth.at(np.arange(start, duration, 1.0 / RATE))


def body_acceleration(states):
    return np.einsum("nji,nj->ni", states.R_nb, states.acceleration_n)


def speed_of(states):
    return np.linalg.norm(states.velocity_n, axis=1)


@pytest.fixture(scope="module", params=list(TRACKS))
def driven(request):
    track = TRACKS[request.param]
    return track, drive(track, Motion(standstill=5.0), 300.0, np.random.default_rng(11))


def test_speeds_and_accelerations_are_those_of_a_kart(driven):
    _, truth = driven
    states = states_of(truth, 300.0, start=30.0)
    forward, left, _ = (body_acceleration(states) / STANDARD_GRAVITY).T
    assert np.min(speed_of(states)) > 9.0 and np.max(speed_of(states)) < 33.5
    assert 1.5 < np.percentile(np.abs(left), 99.5) < 2.0
    assert -1.4 < np.min(forward) < -0.7 and 0.3 < np.max(forward) < 0.6


def test_laps_take_the_time_of_kart_laps_and_no_two_are_alike(driven):
    track, truth = driven
    laps = np.diff(truth.crossings(track.start_line))
    assert len(laps) >= 3 and np.all((laps > 35.0) & (laps < 70.0))
    assert 0.02 < np.std(laps[1:]) < 1.0


def test_line_wanders_from_lap_to_lap_but_stays_on_the_road(driven):
    track, truth = driven
    centre = track.centre(np.arange(0.0, track.length, 0.5))[:, :2]
    position = truth.at(np.arange(0.0, 300.0, 0.2)).position_n[:, :2]
    away = np.array([np.min(np.linalg.norm(centre - p, axis=1)) for p in position])
    assert 0.25 < np.sqrt(np.mean(away**2)) < 0.7
    assert np.max(away) < track.width / 2.0


def test_slip_angle_is_a_few_degrees_inwards_and_leads_the_path(driven):
    _, truth = driven
    states = states_of(truth, 300.0, start=30.0)
    velocity_b = np.einsum("nji,nj->ni", states.R_nb, states.velocity_n)
    slip = -np.arctan2(velocity_b[:, 1], velocity_b[:, 0])  # heading - course
    assert 3.0 < np.max(np.abs(slip)) / DEG < 10.0
    assert 2.0 < np.percentile(np.abs(slip), 90) / DEG < 6.0
    left = body_acceleration(states)[:, 1]
    lags = np.arange(0, 30)
    fit = [np.corrcoef(slip[: len(slip) - 30], left[lag : len(left) - 30 + lag])[0, 1] for lag in lags]
    assert 0.05 < lags[int(np.argmax(fit))] / RATE < 0.2
    assert np.max(fit) > 0.9


def test_braking_and_turning_share_the_grip(driven):
    _, truth = driven
    forward, left, _ = (body_acceleration(states_of(truth, 300.0, start=30.0)) / STANDARD_GRAVITY).T
    share = np.hypot(left / Motion().grip_g, np.minimum(forward, 0.0) / (Motion().braking_g + 0.25))  # 0.25 g of drag
    assert np.max(share) < 1.1  # without the sharing: 1.3


def test_jerk_is_bounded(driven):
    _, truth = driven
    states = states_of(truth, 300.0)
    acceleration = states.acceleration_n[:, :2]  # kerbs are a matter of Up
    jerk = np.linalg.norm(np.diff(acceleration, axis=0), axis=1) * RATE
    assert np.max(jerk) < 250.0  # 1.75 g from one side to the other within half a second, and some


def test_roll_follows_the_corner_outwards_and_pitch_the_brakes_forwards(driven):
    _, truth = driven
    t = np.arange(30.0, 300.0, 1.0 / RATE)
    euler, acceleration = truth.euler(t), body_acceleration(truth.at(t))
    assert np.corrcoef(euler[:, 0], acceleration[:, 1])[0, 1] > 0.8  # left turn: right side down
    track, _ = driven
    smooth = drive(track, Motion(standstill=5.0, roughness=0.0), 300.0, np.random.default_rng(11))
    flat = replace(track, hills=())
    level = drive(flat, Motion(standstill=5.0, roughness=0.0), 300.0, np.random.default_rng(11))
    forward = body_acceleration(level.at(t))[:, 0]
    assert np.corrcoef(level.euler(t)[:, 1], forward)[0, 1] < -0.95  # braking: nose down
    climb = smooth.at(t).velocity_n[:, 2] / speed_of(smooth.at(t))
    if track.hills[0][0] > 1.0:
        assert np.corrcoef(smooth.euler(t)[:, 1] - level.euler(t)[:, 1], climb)[0, 1] < -0.8  # uphill: nose up


def test_standing_start_is_perfectly_still_for_exactly_the_time_asked():
    truth = drive(TRACKS["larkfield"], Motion(standstill=30.0), 60.0, np.random.default_rng(2))
    still = states_of(truth, 30.0)
    assert np.max(speed_of(still)) < 1e-9 and np.max(np.abs(still.angular_rate_b)) < 1e-9
    assert np.linalg.norm(truth.at(np.array([31.5])).velocity_n) > 1.0


def test_rolling_start_is_at_speed_from_the_first_sample():
    for seed in range(5):
        truth = drive(TRACKS["tinbarn"], Motion(standstill=None), 10.0, np.random.default_rng(seed))
        assert np.min(speed_of(states_of(truth, 10.0))) > 8.0


def test_stops_are_made_when_and_as_long_as_asked():
    motion = Motion(standstill=5.0, stops=(Stop(100.0, 20.0), Stop(200.0, 10.0)))
    truth = drive(TRACKS["larkfield"], motion, 260.0, np.random.default_rng(3))
    t = np.arange(20.0, 255.0, 0.02)
    still = speed_of(truth.at(t)) < 1e-6
    edges = t[np.flatnonzero(np.diff(still.astype(int)))]
    begin, end = edges[::2], edges[1::2]
    # smoothing takes half a second off either end, braking to the stop puts it a few seconds later
    np.testing.assert_allclose(end - begin, [20.0, 10.0], atol=1.3)
    np.testing.assert_allclose(begin, [100.0, 200.0], atol=8.0)


def test_a_spin_turns_the_kart_once_and_leaves_it_on_its_line():
    spins = (Spin(20.0, 2.5), Spin(40.0, 2.0))
    spun, straight = (
        drive(TRACKS["larkfield"], Motion(spins=given), 60.0, np.random.default_rng(3)) for given in (spins, ())
    )
    t = np.arange(10.0, 55.0, 0.02)
    one, other = spun.at(t), straight.at(t)
    np.testing.assert_allclose(one.position_n, other.position_n, atol=1e-9)
    turn = np.unwrap(euler_from_rotation(one.R_nb)[2] - euler_from_rotation(other.R_nb)[2])
    halves = np.interp([15.0, 21.25, 25.0, 41.0, 50.0], t, turn - turn[0]) / np.pi
    np.testing.assert_allclose(halves, np.arange(5.0), atol=0.005)


def test_kart_that_is_not_driven_stays():
    truth = drive(TRACKS["larkfield"], Motion(driving=False), 50.0, np.random.default_rng(3))
    states = states_of(truth, 50.0)
    assert np.max(speed_of(states)) < 1e-9
    assert len(truth.crossings(TRACKS["larkfield"].start_line)) == 0


def test_lapses_cost_time():
    track = TRACKS["larkfield"]
    even = drive(track, Motion(), 300.0, np.random.default_rng(5))
    hobby = drive(track, Motion(lapse_rate=4.0), 300.0, np.random.default_rng(5))
    laps, slower = (np.diff(truth.crossings(track.start_line)) for truth in (even, hobby))
    assert np.ptp(slower[:4]) > 2.0 * np.ptp(laps[:4])
    assert np.min(slower[:4]) > np.min(laps[:4]) - 0.01
    nowhere = drive(track, Motion(lapse_depth=(0.9, 0.9)), 300.0, np.random.default_rng(5))
    np.testing.assert_array_equal(speed_of(states_of(nowhere, 300.0)), speed_of(states_of(even, 300.0)))


def test_kerbs_are_the_only_bumps():
    track = TRACKS["tinbarn"]
    rough = drive(track, Motion(), 60.0, np.random.default_rng(6))
    smooth = drive(track, Motion(kerb_rate=0.0), 60.0, np.random.default_rng(6))
    rough_up, smooth_up = states_of(rough, 60.0).acceleration_n[:, 2], states_of(smooth, 60.0).acceleration_n[:, 2]
    assert np.max(np.abs(rough_up)) > 5.0
    assert np.max(np.abs(smooth_up)) < 0.2
    hit = np.abs(states_of(rough, 60.0).position_n[:, 2] - states_of(smooth, 60.0).position_n[:, 2]) > 0.005
    lifted = (rough.euler(np.arange(0.0, 60.0, 1.0 / RATE)) - smooth.euler(np.arange(0.0, 60.0, 1.0 / RATE)))[hit, 0]
    turn = smooth.at(np.arange(0.0, 60.0, 1.0 / RATE)).angular_rate_b[hit, 2]
    assert np.mean(lifted * turn > 0.0) > 0.95  # the inner wheels climb: left turn, left side up, roll positive
    np.testing.assert_allclose(
        states_of(rough, 60.0).position_n[:, :2], states_of(smooth, 60.0).position_n[:, :2], atol=1e-9
    )


def test_engine_turns_with_the_wheels_between_its_limits():
    motion = Motion(standstill=5.0)
    truth = drive(TRACKS["longmeadow"], motion, 200.0, np.random.default_rng(1))
    t = np.arange(0.0, 200.0, 0.1)
    rpm, speed = truth.engine_rpm(t), speed_of(truth.at(t))
    assert np.min(rpm) > 5990.0 and 15000.0 < np.max(rpm) < 16100.0
    np.testing.assert_allclose(rpm, 6000.0 + 10000.0 * speed / 33.0, atol=60.0)
    assert np.all(truth.running(t[t < 5.0]) < 1e-9) and np.all(truth.running(t[speed > 5.0]) > 0.99)
    assert np.min(truth.throttle(t)) > -1e-9 and np.max(truth.throttle(t)) < 1.0 + 1e-9


def test_same_generator_drives_the_same_session_and_another_does_not():
    first, again, other = (
        drive(TRACKS["tinbarn"], Motion(), 20.0, np.random.default_rng(seed)).control for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.max(np.abs(first - other)) > 0.1


def test_wander_has_the_deviation_asked_for():
    rng = np.random.default_rng(0)
    values = np.concatenate([wander(0.0, 1e5, 10.0, rng, 0.7)(np.arange(0.0, 1e5, 5.0)) for _ in range(3)])
    assert np.std(values) == pytest.approx(0.7, rel=0.03)  # some 10,000 independent values
