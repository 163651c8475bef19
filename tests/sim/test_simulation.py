import numpy as np
import pytest

from smoother.samples import RawSession
from smoother.sim.presets import PRESETS
from smoother.sim.simulation import simulate_preset
from smoother.sim.track import TRACKS
from smoother.units import DEG


def assert_same(first, second):
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("preset", PRESETS)
def test_same_seed_gives_the_same_session_and_another_does_not(preset):
    first, again, other = (simulate_preset(preset, seed, duration=30.0) for seed in (1, 1, 2))
    for a, b in ((first.raw.imu, again.raw.imu), (first.raw.gnss, again.raw.gnss), (first.raw.mag, again.raw.mag)):
        for name, value in vars(a).items():
            if isinstance(value, np.ndarray):
                assert_same(value, getattr(b, name))
    assert np.max(np.abs(first.raw.imu.accel - other.raw.imu.accel[: len(first.raw.imu.t)])) > 0.1


def test_one_changed_figure_leaves_all_other_draws_as_they_were():
    plain = simulate_preset("kart", 5, duration=40.0)
    blind = simulate_preset("kart", 5, duration=40.0, gnss_velocity=False, imu_accel_noise=0.0, mag=None)
    assert_same(plain.raw.gnss.lat_deg, blind.raw.gnss.lat_deg)
    assert np.all(np.isnan(blind.raw.gnss.speed))
    assert_same(plain.raw.imu.gyro, blind.raw.imu.gyro)
    assert not np.array_equal(plain.raw.imu.accel, blind.raw.imu.accel)
    assert_same(plain.scenario.lever_arm_b, blind.scenario.lever_arm_b)
    assert_same(plain.truth.control, blind.truth.control)
    assert blind.raw.mag is None


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("track", TRACKS)
def test_session_is_an_ordinary_one_of_its_track(preset, track):
    simulation = simulate_preset(preset, 7, track=track, duration=100.0)
    assert type(simulation.raw) is RawSession
    assert len(simulation.raw.imu.t) > 19_900 and len(simulation.raw.gnss) > 250
    assert abs(simulation.raw.gnss.lat_deg[0] - TRACKS[track].origin.lat_deg) < 0.01
    assert len(simulation.lap_crossings()) >= 1
    assert simulation.raw.unix_at_zero == simulation.scenario.start_unix


def test_errors_of_the_fixes_are_the_recorded_ones():
    simulation = simulate_preset("kart_harsh", 3, duration=200.0)
    gnss, truth = simulation.gnss, simulation.truth
    position = truth.antenna_position_n(gnss.position_time, simulation.scenario.lever_arm_b)
    white = gnss.fixes.position_n(truth.origin) - position - gnss.offset_n - gnss.jump_n
    np.testing.assert_allclose(np.std(white, axis=0), [0.3, 0.3, 0.5], rtol=0.15)
    assert np.max(np.abs(gnss.jump_n)) > 5.0


def test_a_steering_wheel_turns_with_the_bends_and_leaves_the_draws_as_they_were():
    """A turn about a column that stands upright is one about up: of the wheel, as fast as the curvature changes."""
    changes = {"duration": 60.0, "motion_steering": 1.0 * DEG, "motion_column": 90.0 * DEG}
    still, turned = (simulate_preset("white", 4, motion_steering_per_curvature=k, **changes) for k in (0.0, 2.0))
    assert_same(still.truth.control, turned.truth.control)
    t = turned.raw.imu.t
    up_s = turned.scenario.R_bs.T @ [0.0, 0.0, 1.0]
    angle = np.cumsum((turned.raw.imu.gyro - still.raw.imu.gyro) @ up_s) * np.median(np.diff(t))
    states = turned.truth.at(t)
    velocity, change = states.velocity_n, states.acceleration_n
    across = velocity[:, 0] * change[:, 1] - velocity[:, 1] * change[:, 0]
    fast = np.hypot(velocity[:, 0], velocity[:, 1]) > 5.0
    wanted = 2.0 * across[fast] / np.hypot(velocity[fast, 0], velocity[fast, 1]) ** 3
    assert np.std(wanted) > 2.0 * DEG
    assert np.std(angle[fast] - wanted) < 0.1 * np.std(wanted)


def test_static_session_without_gps_velocity_can_be_asked_for():
    simulation = simulate_preset("kart", 0, duration=60.0, motion_driving=False, motion_standstill=60.0)
    speed = np.linalg.norm(simulation.truth.at(np.arange(0.0, 60.0, 0.5)).velocity_n, axis=1)
    assert np.max(speed) < 1e-9 and len(simulation.lap_crossings()) == 0


@pytest.mark.parametrize(("imu_rate", "gnss_rate"), [(25.0, 1.0), (2000.0, 25.0)])
def test_rates_from_the_slowest_to_the_fastest_are_served(imu_rate, gnss_rate):
    raw = simulate_preset("white", 0, duration=30.0, imu_rate=imu_rate, gnss_rate=gnss_rate).raw
    assert len(raw.imu.t) == 30 * imu_rate and len(raw.gnss) == 30 * gnss_rate + 1


def test_laps_are_counted_at_the_antenna_not_at_the_imu():
    simulation = simulate_preset("kart", 2, duration=150.0)
    antenna, imu = simulation.lap_crossings(), simulation.truth.crossings(simulation.track.start_line)
    assert len(antenna) == len(imu) >= 2
    assert 0.003 < np.max(np.abs(antenna - imu)) < 0.1
