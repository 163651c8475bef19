import numpy as np
import pytest

from smoother import so3
from smoother.fit.standstill import (
    confirmed_at_rest,
    detect_standstill,
    fix_speeds,
    session_standstill,
    standstill_intervals,
)
from smoother.frames import Origin
from smoother.prepare import prepare
from smoother.samples import GnssFixes
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

RATE = 200.0
ORIGIN = Origin(45.0, 10.0, 0.0)


def rng(seed=0):
    return np.random.default_rng(seed)


class Drive:
    """60 s: at rest until 20 s, 4 m/s^2 for 3 s, constant speed on a smooth straight until 40 s, braking, at rest."""

    def __init__(self, noise=0.5, gyro_noise=2.0 * DEG, engine=0.0, engine_hz=33.0, mounting=None, seed=0):
        self.t = np.arange(1, int(60.0 * RATE) + 1) / RATE
        forward = np.where((self.t > 20.0) & (self.t < 23.0), 4.0, 0.0)
        forward -= np.where((self.t > 40.0) & (self.t < 43.0), 4.0, 0.0)
        self.speed = np.cumsum(forward) / RATE
        self.is_at_rest = (self.t <= 20.0) | (self.t >= 43.0)
        force = np.stack([forward, 0.0 * forward, np.full_like(forward, 9.81)], axis=1)
        rate = np.zeros_like(force)
        draw = rng(seed)
        phase = 2.0 * np.pi * engine_hz * self.t + np.cumsum(draw.normal(size=self.t.size)) * 0.05
        force += engine * np.sin(phase)[:, None] * [1.0, 0.7, 0.5] + noise * draw.normal(size=force.shape)
        rate += 5.0 * engine * DEG * np.sin(phase + 1.0)[:, None] + gyro_noise * draw.normal(size=rate.shape)
        R_sb = np.eye(3) if mounting is None else mounting
        self.force = force @ R_sb.T + [0.3, -0.4, 0.2]
        self.rate = rate @ R_sb.T + np.array([10.0, 3.0, -58.0]) * DEG
        self.fix_t = np.arange(0.2, 60.0, 0.2)
        self.fix_speed = np.interp(self.fix_t - 0.3, self.t, self.speed)  # late, as Doppler is

    def detect(self, **changes):
        return detect_standstill(self.t, self.force, self.rate, self.fix_t, self.fix_speed, **changes)


def share(mask, where):
    return np.mean(mask[where])


@pytest.mark.parametrize("seed", range(3))
def test_rest_is_found_for_any_mounting_with_unknown_biases(seed):
    mounting = so3.exp(rng(seed).normal(size=3) * 2.0)
    drive = Drive(mounting=mounting, seed=seed)
    mask = drive.detect()
    assert share(mask, drive.is_at_rest) > 0.9
    assert not np.any(mask & ~drive.is_at_rest)


def test_a_smooth_straight_at_constant_speed_is_not_rest_because_the_fixes_move():
    drive = Drive(noise=0.02, gyro_noise=0.05 * DEG)
    straight = (drive.t > 25.0) & (drive.t < 39.0)
    assert not np.any(drive.detect()[straight])
    # without fixes nothing could tell: this is what makes the test above one of the fixes
    assert share(detect_standstill(drive.t, drive.force, drive.rate), straight) > 0.9


@pytest.mark.parametrize("engine_hz", [23.0, 33.0, 71.0])
def test_an_idling_engine_does_not_hide_a_stop(engine_hz):
    drive = Drive(engine=3.0, engine_hz=engine_hz)
    mask = drive.detect()
    assert share(mask, drive.is_at_rest) > 0.85
    assert not np.any(mask & ~drive.is_at_rest)


def test_setting_off_ends_the_rest_although_the_fixes_come_late():
    drive = Drive()
    late = np.interp(drive.fix_t - 0.6, drive.t, drive.speed)
    mask = detect_standstill(drive.t, drive.force, drive.rate, drive.fix_t, late)
    assert not np.any(mask & ~drive.is_at_rest)


def test_setting_off_ends_the_rest_even_before_the_fixes_know():
    drive = Drive(noise=1.5)
    very_late = np.interp(drive.fix_t - 2.0, drive.t, drive.speed)
    mask = detect_standstill(drive.t, drive.force, drive.rate, drive.fix_t, very_late)
    assert not np.any(mask[(drive.t > 20.05) & (drive.t < 22.0)])


def test_a_quiet_sensor_that_drifts_slowly_is_at_rest():
    drive = Drive(noise=0.002, gyro_noise=0.001 * DEG)
    drive.rate = drive.rate + 0.05 * DEG * np.sin(0.5 * drive.t)[:, None]
    drive.force = drive.force + 0.01 * np.sin(0.4 * drive.t)[:, None]
    assert share(drive.detect(), drive.is_at_rest) > 0.9


def test_a_logger_turned_while_the_fixes_stand_still_is_not_at_rest():
    drive = Drive()
    turned = (drive.t > 8.0) & (drive.t < 10.0)
    drive.rate[turned, 2] += 20.0 * DEG * np.sin(np.pi * (drive.t[turned] - 8.0))
    mask = drive.detect()
    assert not np.any(mask[turned])
    assert share(mask, drive.t < 7.0) > 0.9


def test_a_session_that_never_stops_has_no_standstill():
    drive = Drive()
    drive.fix_speed = np.full_like(drive.fix_t, 12.0)
    assert not np.any(drive.detect())


def test_without_a_fix_nearby_there_is_no_standstill():
    drive = Drive()
    seen = (drive.fix_t < 5.0) | (drive.fix_t > 12.0)
    mask = detect_standstill(drive.t, drive.force, drive.rate, drive.fix_t[seen], drive.fix_speed[seen])
    assert not np.any(mask[(drive.t > 6.0) & (drive.t < 11.0)])
    assert share(mask, drive.t < 4.0) > 0.9


def test_unknown_speeds_are_as_good_as_no_fixes():
    drive = Drive()
    drive.fix_speed = np.full_like(drive.fix_t, np.nan)
    assert not np.any(drive.detect())


def test_rests_shorter_than_a_second_are_left_out():
    for until, is_found in ((53.5, True), (52.0, False)):
        drive = Drive()
        drive.fix_speed = np.where((drive.fix_t > 50.0) & (drive.fix_t < until), 0.0, 5.0)
        assert np.any(drive.detect()) == is_found


def test_on_the_bench_rest_is_distinguished_from_turning_without_fixes():
    t = np.arange(6000) / 100.0
    is_turned = (t % 10.0) > 6.0  # four positions with turns between them
    draw = rng(3)
    force = np.array([0.0, 0.0, 9.8]) + 0.03 * draw.normal(size=(t.size, 3))
    rate = 0.1 * DEG * draw.normal(size=(t.size, 3))
    rate[is_turned] += 90.0 * DEG * np.sin(2.0 * t[is_turned])[:, None]
    force[is_turned] += 4.0 * np.sin(3.0 * t[is_turned])[:, None]
    mask = detect_standstill(t, force, rate)
    assert share(mask, ~is_turned) > 0.7
    assert not np.any(mask & is_turned)


def test_a_bench_recording_that_is_always_in_motion_has_no_rest():
    t = np.arange(4000) / 100.0
    draw = rng(4)
    wobble = np.sin(np.cumsum(draw.normal(size=(t.size, 3)), axis=0) * 0.05)
    assert not np.any(detect_standstill(t, 9.8 * wobble, 60.0 * DEG * wobble))


def test_a_quantised_gyro_that_repeats_one_count_is_at_rest():
    drive = Drive(noise=0.05, gyro_noise=0.0)
    drive.rate = np.round(drive.rate / (0.57 * DEG)) * 0.57 * DEG
    assert share(drive.detect(), drive.is_at_rest) > 0.9


def test_a_gap_in_the_samples_does_no_harm():
    drive = Drive()
    keep = (drive.t < 8.0) | (drive.t > 9.5)
    mask = detect_standstill(drive.t[keep], drive.force[keep], drive.rate[keep], drive.fix_t, drive.fix_speed)
    assert share(mask, drive.t[keep] < 7.0) > 0.9
    assert share(mask, (drive.t[keep] > 10.5) & (drive.t[keep] < 19.0)) > 0.9


@pytest.mark.parametrize("count", [0, 1, 5, 40])
def test_few_samples_are_not_enough_and_not_an_error(count):
    drive = Drive()
    mask = detect_standstill(drive.t[:count], drive.force[:count], drive.rate[:count], drive.fix_t, drive.fix_speed)
    assert mask.shape == (count,)
    assert not np.any(mask)


def test_intervals_are_the_ends_of_the_runs():
    t = np.arange(6) * 0.5
    mask = np.array([True, True, False, True, True, True])
    np.testing.assert_array_equal(standstill_intervals(t, mask), [[0.0, 0.5], [1.5, 2.5]])
    assert standstill_intervals(t, ~np.ones(6, dtype=bool)).shape == (0, 2)


# ---- speeds of fixes ------------------------------------------------------------------------------------------------


def fixes_at(position, velocity=None, speed=None, step=0.2):
    n = len(position)
    lat = ORIGIN.lat_deg + position[:, 0] / 111132.0
    lon = ORIGIN.lon_deg - position[:, 1] / (111320.0 * np.cos(ORIGIN.lat_deg * DEG))
    velocity = np.full((n, 3), np.nan) if velocity is None else velocity
    return GnssFixes(step * np.arange(n), lat, lon, np.zeros(n), velocity, speed=speed)


def test_doppler_noise_does_not_pass_for_speed():
    velocity = 0.15 * rng(5).normal(size=(300, 3))
    speed, limit = fix_speeds(fixes_at(np.zeros((300, 2)), velocity), ORIGIN)
    assert np.mean(np.hypot(velocity[:, 0], velocity[:, 1]) > 0.3) > 0.1  # taken one by one they would move
    assert np.all(speed < limit)


def test_speed_as_sent_is_used_where_there_is_no_velocity():
    speed, limit = fix_speeds(fixes_at(np.zeros((50, 2)), speed=np.full(50, 3.0)), ORIGIN)
    np.testing.assert_allclose(speed, 3.0)
    np.testing.assert_allclose(limit, 0.3)


@pytest.mark.parametrize("true_speed", [0.0, 5.0])
def test_positions_alone_give_a_speed_with_a_limit_that_their_noise_allows(true_speed):
    position = np.stack([true_speed * 0.2 * np.arange(300), np.zeros(300)], axis=1) + 2.5 * rng(6).normal(size=(300, 2))
    speed, limit = fix_speeds(fixes_at(position), ORIGIN)
    known = np.isfinite(speed)
    assert np.mean(known) > 0.9
    assert np.mean(speed[known] < limit[known]) > 0.9 if true_speed == 0.0 else np.all(speed[known] > limit[known])


def test_a_single_fix_has_no_speed():
    speed, _ = fix_speeds(fixes_at(np.zeros((1, 2))), ORIGIN)
    assert np.isnan(speed[0])


# ---- simulated and real sessions ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("preset", "standstill"), [("white", 30.0), ("kart", 5.0), ("kart_harsh", 10.0)])
def test_the_standing_start_of_every_preset_is_found_and_nothing_else(preset, standstill):
    simulation = simulate_preset(preset, 31, duration=60.0, motion_standstill=standstill, gnss_outages=())
    session = prepare(simulation.raw)
    mask = session_standstill(session)
    speed = np.linalg.norm(simulation.truth.at(session.imu.t).velocity_n, axis=1)
    assert np.all(speed[mask] < 0.02)
    assert np.sum(mask) / 200.0 > 0.8 * standstill


def test_a_rolling_start_has_no_standstill():
    simulation = simulate_preset("kart", 32, duration=60.0, motion_standstill=None)
    assert not np.any(session_standstill(prepare(simulation.raw)))


def test_a_session_without_inertial_samples_has_an_empty_mask():
    simulation = simulate_preset("white", 33, duration=10.0, imu=None)
    assert session_standstill(prepare(simulation.raw)).shape == (0,)


def turned_by_hand(drive, begin, end, angle):
    """Turn the resting kart by `angle` rad between two times, smoothly."""
    inside = (drive.t > begin) & (drive.t < end)
    share_of_way = (drive.t[inside] - begin) / (end - begin)
    drive.rate[inside, 2] += angle / (end - begin) * (1.0 - np.cos(2.0 * np.pi * share_of_way))
    return drive


@pytest.mark.parametrize("angle", [90.0 * DEG, -180.0 * DEG])
def test_a_kart_that_is_turned_where_it_stands_does_not_stand_still(angle):
    drive = turned_by_hand(Drive(engine=2.0, gyro_noise=6.0 * DEG), 45.0, 59.0, angle)
    turning = (drive.t > 46.0) & (drive.t < 58.0)
    assert share(drive.detect(), turning) == 0.0
    assert share(drive.detect(), drive.t < 20.0) > 0.9  # the other stop is one


def test_a_stop_of_turning_alone_is_found_by_the_bias():
    drive = Drive(engine=2.0, gyro_noise=6.0 * DEG)
    drive.rate[drive.t > 43.0, 2] += 12.0 * DEG
    at_the_end = drive.t > 44.0
    assert share(drive.detect(), at_the_end) > 0.9  # a bias might be as large
    bias = np.array([10.0, 3.0, -58.0]) * DEG
    assert share(drive.detect(gyro_bias=bias), at_the_end) == 0.0
    assert share(drive.detect(gyro_bias=bias), drive.t < 20.0) > 0.9


def in_a_garage(quiet=0.02, lasts=20.0, speed=0.8):
    """A drive whose engine is off until `lasts` s, beside fixes that wander under a roof."""
    drive = Drive()
    draw, off = rng(5), drive.t <= lasts
    drive.force[off] = [0.3, -0.4, 10.01] + quiet * draw.normal(size=(off.sum(), 3))
    drive.rate[off] = np.array([10.0, 3.0, -58.0]) * DEG + quiet * 4.0 * DEG * draw.normal(size=(off.sum(), 3))
    drive.fix_speed[drive.fix_t < lasts] = speed
    return drive, off


@pytest.mark.parametrize(
    ("changes", "is_found"),
    [
        ({}, True),
        ({"quiet": 0.1}, False),  # m/s^2: the engine idles, or the kart rolls along
        ({"lasts": 4.0}, False),  # a moment
        ({"speed": 2.5}, False),
    ],
)
def test_a_motionless_logger_is_at_rest_though_fixes_wander(changes, is_found):
    drive, off = in_a_garage(**changes)
    assert (share(drive.detect(), off) > 0.85) == is_found
    assert not drive.detect()[(drive.t > 22.0) & (drive.t < 43.0)].any()


def test_a_quiet_sensor_on_a_kart_that_is_never_driven_is_no_proof():
    drive, off = in_a_garage(lasts=60.0)
    assert not drive.detect()[off].any()


def test_what_fixes_say_in_a_stand_counts_where_none_of_them_moves():
    t = np.arange(0.0, 60.0, 0.2)
    velocity = np.zeros((t.size, 3))
    velocity[(t > 10.0) & (t < 15.0), 0] = 0.6
    velocity[(t > 25.0) & (t < 35.0), 0] = 10.0
    zero = np.zeros(t.size)
    fixes = GnssFixes(t, zero + 45.0, zero + 10.0, zero, velocity)
    standing = (t < 20.0) | (t > 40.0)
    np.testing.assert_array_equal(confirmed_at_rest(fixes, ORIGIN, standing), t > 40.0)
