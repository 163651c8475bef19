from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import periodogram

from smoother import so3
from smoother.sim.motion import Motion, drive, wander
from smoother.sim.scenario import GnssErrors, ImuErrors, Interval, Jump, MagErrors
from smoother.sim.sensors import (
    Wheel,
    earth_field_n,
    filter_response,
    mean_motion,
    simulate_gnss,
    simulate_imu,
    simulate_mag,
    simulate_mag_calibration,
)
from smoother.sim.track import TRACKS
from smoother.sim.truth import Clock
from smoother.units import DEG, KNOT, STANDARD_GRAVITY

EYE = np.eye(3)
ARM = np.array([0.3, -0.2, 0.5])
FIELD_N = np.array([20.0, -2.0, -45.0])
UNIX = 1778925600.0


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.fixture(scope="module")
def truth():
    return drive(TRACKS["larkfield"], Motion(standstill=5.0), 60.0, rng(1))


@pytest.fixture(scope="module")
def parked():
    return drive(TRACKS["larkfield"], Motion(driving=False, standstill=0.0, roughness=0.0), 3000.0, rng(1))


def values(simulated):
    raw = simulated.raw
    return raw.accel * raw.accel_scale, raw.gyro * raw.gyro_scale


# --- inertial unit


@pytest.mark.parametrize("rate", [25.0, 200.0, 2000.0])
def test_perfect_samples_are_means_over_the_interval_that_ends_at_their_stamp(truth, rate):
    imu = simulate_imu(truth, ImuErrors(rate=rate), EYE, 60.0, rng())
    assert len(imu.raw.t) == 60 * rate
    np.testing.assert_allclose(np.diff(imu.raw.t), 1.0 / rate, atol=1e-6)
    k = np.arange(int(20 * rate), int(22 * rate))
    fine = imu.raw.t[k, None] - (np.arange(200) + 0.5) / (200.0 * rate)
    states = truth.at(fine.ravel())
    accel, gyro = values(imu)
    # both are quadratures of the same smooth signal; 1e-3 of its size of 20 m/s^2 and 1.5 rad/s
    np.testing.assert_allclose(accel[k], states.specific_force_b.reshape(-1, 200, 3).mean(axis=1), atol=5e-3)
    np.testing.assert_allclose(gyro[k], states.angular_rate_b.reshape(-1, 200, 3).mean(axis=1), atol=5e-4)


def test_latency_delays_the_samples_against_their_stamps(truth):
    late = simulate_imu(truth, ImuErrors(latency=0.02), EYE, 60.0, rng())
    prompt = simulate_imu(truth, ImuErrors(), EYE, 60.0, rng())
    np.testing.assert_allclose(values(late)[0][4:], values(prompt)[0][:-4], atol=1e-9)


def test_a_delay_of_the_accelerometer_leaves_the_rate_alone(truth):
    late = simulate_imu(truth, ImuErrors(accel_delay=0.02, accel_noise=0.1), EYE, 60.0, rng())
    prompt = simulate_imu(truth, ImuErrors(), EYE, 60.0, rng())
    noise = values(simulate_imu(truth, ImuErrors(accel_noise=0.1), EYE, 60.0, rng()))[0] - values(prompt)[0]
    np.testing.assert_allclose((values(late)[0] - noise)[4:], values(prompt)[0][:-4], atol=1e-9)
    np.testing.assert_array_equal(values(late)[1], values(prompt)[1])


def test_a_logger_on_the_wheel_measures_in_axes_that_turn_with_it(truth):
    wheel = Wheel(wander(-5.0, 65.0, 0.15, rng(), 10.0 * DEG), np.array([-0.6, 0.0, 0.8]))
    R_bs = so3.exp(np.array([0.4, -1.0, 2.0]))
    force, rate = values(simulate_imu(truth, ImuErrors(rate=1000.0), R_bs, 60.0, rng(), wheel))
    still_force, still_rate = values(simulate_imu(truth, ImuErrors(rate=1000.0), EYE, 60.0, rng()))
    t = np.arange(1, len(force) + 1) / 1000.0 - 0.0005  # the middles of the intervals
    turned = so3.exp(wheel.angle(t)[:, None] * wheel.axis_b) @ R_bs
    assert 5.0 * DEG < np.std(wheel.angle(t)) < 15.0 * DEG
    # within an interval of 1 ms the box turns by 3 mrad
    np.testing.assert_allclose(np.einsum("nij,nj->ni", turned, force), still_force, atol=1e-3)
    own = wheel.angle(t, nu=1)[:, None] * wheel.axis_b
    np.testing.assert_allclose(np.einsum("nij,nj->ni", turned, rate) - own, still_rate, atol=1e-3)


def test_a_magnetometer_on_the_wheel_turns_with_it(parked):
    wheel = Wheel(wander(-5.0, 65.0, 0.15, rng(), 10.0 * DEG), np.array([-0.6, 0.0, 0.8]))
    still, turned = (simulate_mag(parked, MagErrors(), FIELD_N, EYE, 60.0, rng(), w).field for w in (None, wheel))
    np.testing.assert_allclose(turned @ wheel.axis_b, still @ wheel.axis_b, atol=1e-9)
    across = np.cross(still[0], wheel.axis_b)
    assert np.std(turned @ across) > 0.05 * (across @ across)  # as sin(10 deg)


def test_samples_are_resolved_in_sensor_axes(truth):
    R_bs = so3.exp(np.array([0.4, -1.0, 2.0]))
    turned, straight = (simulate_imu(truth, ImuErrors(), R, 60.0, rng()) for R in (R_bs, EYE))
    for in_s, in_b in zip(values(turned), values(straight), strict=True):
        np.testing.assert_allclose(in_s @ R_bs.T, in_b, atol=1e-12)


def test_bias_scale_and_misalignment_act_as_documented(truth):
    matrix, bias = EYE + 0.01 * rng().standard_normal((3, 3)), np.array([0.1, -0.2, 0.3])
    errors = ImuErrors(accel_matrix=matrix, accel_bias=bias, gyro_matrix=matrix.T, gyro_bias=-bias)
    flawed, clean = simulate_imu(truth, errors, EYE, 60.0, rng()), simulate_imu(truth, ImuErrors(), EYE, 60.0, rng())
    np.testing.assert_allclose(values(flawed)[0], values(clean)[0] @ matrix.T + bias, atol=1e-12)
    np.testing.assert_allclose(values(flawed)[1], values(clean)[1] @ matrix - bias, atol=1e-12)


@pytest.mark.parametrize("rate", [50.0, 400.0])
def test_white_noise_has_its_density_at_any_rate(parked, rate):
    errors = ImuErrors(rate=rate, accel_noise=0.15, gyro_noise=0.7 * DEG)
    accel, gyro = values(simulate_imu(parked, errors, EYE, 500.0, rng()))
    for measured, density in ((accel, 0.15), (gyro, 0.7 * DEG)):
        seconds = measured.reshape(500, int(rate), 3).mean(axis=1)
        allan = np.sqrt(0.5 * np.mean(np.diff(seconds, axis=0) ** 2))
        assert allan == pytest.approx(density, rel=0.1)  # Allan deviation at 1 s; 1500 values know it to 3 %
        np.testing.assert_allclose(np.std(measured, axis=0), density * np.sqrt(rate), rtol=0.03)


def test_bias_walk_grows_with_the_root_of_time(parked):
    errors = ImuErrors(rate=20.0, accel_bias_walk=0.003, gyro_bias_walk=0.005 * DEG)
    imu = simulate_imu(parked, errors, EYE, 3000.0, rng())
    for bias, walk in ((imu.accel_bias_s, 0.003), (imu.gyro_bias_s, 0.005 * DEG)):
        for seconds in (1, 10):
            change = bias[20 * seconds :: 20 * seconds] - bias[: -20 * seconds : 20 * seconds]
            # 900 independent values for 10 s: known to 2.4 %, three times that allowed
            assert np.std(change) == pytest.approx(walk * np.sqrt(seconds), rel=0.08)
    clean = simulate_imu(parked, ImuErrors(rate=20.0), EYE, 3000.0, rng())
    np.testing.assert_allclose(values(imu)[0] - values(clean)[0], imu.accel_bias_s, atol=1e-12)


def test_samples_clip_at_full_scale_and_are_whole_counts(truth):
    errors = ImuErrors(accel_range=1.2 * STANDARD_GRAVITY, gyro_range=50.0 * DEG, bits=16, accel_noise=0.5)
    raw = simulate_imu(truth, errors, EYE, 60.0, rng()).raw
    assert np.max(raw.accel) == 32767.0 and np.min(raw.accel) == -32768.0
    np.testing.assert_array_equal(raw.accel, np.round(raw.accel))
    assert raw.accel_scale == pytest.approx(1.2 * STANDARD_GRAVITY / 32768.0)
    assert (raw.accel_full_scale, raw.gyro_full_scale) == (errors.accel_range, errors.gyro_range)
    assert np.max(np.abs(raw.gyro * raw.gyro_scale)) <= 50.0 * DEG


def test_quantisation_error_is_uniform_within_half_a_count(truth):
    coarse = ImuErrors(accel_range=16.0 * STANDARD_GRAVITY, gyro_range=1000.0 * DEG, bits=10)
    raw = simulate_imu(truth, coarse, EYE, 60.0, rng()).raw
    exact = values(simulate_imu(truth, ImuErrors(), EYE, 60.0, rng()))[0]
    rest = (raw.accel * raw.accel_scale - exact)[2000:, :2] / raw.accel_scale
    assert np.max(np.abs(rest)) <= 0.5 + 1e-9
    assert np.std(rest) == pytest.approx(1.0 / np.sqrt(12.0), rel=0.03)


def test_stamps_jitter_in_order_while_the_samples_stay_where_they_were(parked):
    imu = simulate_imu(parked, ImuErrors(jitter=1e-3), EYE, 1000.0, rng())
    late = imu.raw.t - imu.true_time
    assert np.std(late) == pytest.approx(1e-3, rel=0.03)
    assert abs(np.mean(late)) < 1e-5
    assert np.min(np.diff(imu.raw.t)) > 0.0
    np.testing.assert_allclose(np.diff(imu.true_time), 0.005, atol=1e-9)


def test_strong_jitter_still_leaves_whole_microseconds_in_order(parked):
    imu = simulate_imu(parked, ImuErrors(jitter=4e-3), EYE, 500.0, rng())
    t = imu.raw.t
    assert abs(np.mean(t - imu.true_time)) < 6e-5  # 100,000 stamps of 4 ms: 1.3e-5; pushing late ones on gives 2e-3
    assert np.min(np.diff(t)) > 0.9e-6
    np.testing.assert_allclose(t * 1e6, np.round(t * 1e6), atol=1e-3)


def test_clock_offset_and_drift_stretch_all_stamps():
    clock = Clock(offset=3.0, drift=200e-6)
    truth = drive(TRACKS["larkfield"], Motion(driving=False), 600.0, rng(1), clock)
    imu = simulate_imu(truth, ImuErrors(rate=50.0), EYE, 600.0, rng())
    gnss = simulate_gnss(truth, GnssErrors(), ARM, 600.0, UNIX, rng())
    mag = simulate_mag(truth, MagErrors(), FIELD_N, EYE, 600.0, rng())
    for last in (imu.raw.t[-1], gnss.fixes.t[-1], mag.t[-1]):
        assert last == pytest.approx(3.0 + 600.0 * (1.0 + 200e-6), abs=1e-6)
    utc = gnss.fixes.unix_s - UNIX
    np.testing.assert_allclose(gnss.fixes.t, clock.to_session(utc), atol=1e-6)


def test_gap_loses_the_samples_inside_it_and_nothing_else(truth):
    whole = simulate_imu(truth, ImuErrors(accel_noise=0.1), EYE, 60.0, rng())
    gapped = simulate_imu(truth, ImuErrors(accel_noise=0.1, gaps=(Interval(20.0, 0.15),)), EYE, 60.0, rng())
    assert len(whole.raw.t) - len(gapped.raw.t) == 30
    kept = np.isin(whole.raw.t, gapped.raw.t)
    np.testing.assert_array_equal(whole.raw.accel[kept], gapped.raw.accel)
    assert np.max(np.diff(gapped.raw.t)) == pytest.approx(0.155, abs=1e-6)


def test_anti_alias_filter_is_a_butterworth_low_pass():
    gain = np.abs(filter_response(np.array([0.0, 92.0, 920.0]), 92.0))
    np.testing.assert_allclose(gain, [1.0, np.sqrt(0.5), 0.01], rtol=0.02)
    np.testing.assert_array_equal(filter_response(np.array([5.0, 500.0]), None), 1.0)


@pytest.fixture(scope="module")
def steady():
    """A kart at its top speed on a road without bends that matter: constant rpm."""
    motion = Motion(standstill=None, top_speed=9.0, grip_sigma=0.0, line_sigma=0.0)
    return drive(TRACKS["longmeadow"], motion, 60.0, rng(1))


def test_engine_tone_folds_to_where_sampling_puts_it(steady):
    rpm = float(np.mean(steady.engine_rpm(np.arange(5.0, 55.0, 0.1))))
    f, rate, amplitude = rpm / 60.0, 230.0, 4.0  # at 200 Hz the two orders would fold onto each other
    errors = ImuErrors(rate=rate, accel_tone=amplitude, harmonics=(1.0, 0.5))
    shaken, calm = (simulate_imu(steady, e, EYE, 60.0, rng()) for e in (errors, ImuErrors(rate=rate)))
    signal = (values(shaken)[0] - values(calm)[0])[1000:11000, 0]
    frequency, power = periodogram(signal, rate, window="flattop", scaling="spectrum")
    for order, relative in ((1, 1.0), (2, 0.5)):
        alias = abs((order * f + rate / 2) % rate - rate / 2)
        near = np.abs(frequency - alias) < 1.0
        expected = relative * amplitude * abs(filter_response(np.array([order * f]), 92.0)[0])
        assert np.sqrt(2.0 * np.max(power[near])) == pytest.approx(expected, rel=0.03)
        power[near] = 0.0
    assert np.max(power) < 1e-4  # nothing anywhere else


def test_engine_shakes_gyro_and_accelerometer_only_while_driving(truth):
    errors = ImuErrors(accel_tone=4.0, gyro_tone=30.0 * DEG, anti_alias_hz=None)
    shaken, calm = (simulate_imu(truth, e, EYE, 60.0, rng()) for e in (errors, ImuErrors()))
    for k, amplitude in ((0, 4.0), (1, 30.0 * DEG)):
        vibration = values(shaken)[k] - values(calm)[k]
        assert np.max(np.abs(vibration[shaken.raw.t < 5.0])) < 1e-9
        # fundamental and two harmonics of half and a quarter: rms sqrt((1 + 1/4 + 1/16) / 2) of the amplitude
        rms = np.sqrt(np.mean(vibration[shaken.raw.t > 10.0] ** 2))
        assert rms == pytest.approx(amplitude * np.sqrt(1.3125 / 2.0), rel=0.03)


def test_mean_motion_of_a_constant_rate_is_that_rate(parked):
    force, rate = mean_motion(parked, np.array([10.0, 20.0]), 0.04)
    np.testing.assert_allclose(np.linalg.norm(force, axis=1), STANDARD_GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(rate, 0.0, atol=1e-12)


# --- receiver


def test_perfect_fix_is_the_antenna_at_its_stamp(truth):
    fixes = simulate_gnss(truth, GnssErrors(has_vertical_velocity=True), ARM, 60.0, UNIX, rng()).fixes
    assert len(fixes) == 301
    np.testing.assert_allclose(fixes.position_n(truth.origin), truth.antenna_position_n(fixes.t, ARM), atol=1e-6)
    np.testing.assert_allclose(fixes.velocity_n, truth.antenna_velocity_n(fixes.t, ARM), atol=1e-9)
    np.testing.assert_allclose(fixes.unix_s, UNIX + fixes.t, atol=1e-6)


def test_a_receiver_without_velocity_sends_no_climb_either(truth):
    errors = GnssErrors(velocity=False, has_vertical_velocity=True)
    fixes = simulate_gnss(truth, errors, ARM, 60.0, UNIX, rng()).fixes
    assert np.all(np.isnan(fixes.velocity_n))


def test_row_was_true_at_its_stamp_minus_each_latency(truth):
    errors = GnssErrors(rate=8.0, position_latency=0.13, velocity_latency=0.24, has_vertical_velocity=True)
    simulated = simulate_gnss(truth, errors, ARM, 60.0, UNIX, rng())
    fixes = simulated.fixes
    np.testing.assert_allclose(simulated.position_time, fixes.t - 0.13, atol=1e-6)
    np.testing.assert_allclose(simulated.velocity_time, fixes.t - 0.24, atol=1e-6)
    then = truth.antenna_position_n(fixes.t - 0.13, ARM)
    np.testing.assert_allclose(fixes.position_n(truth.origin), then, atol=5e-5)  # stamps are whole microseconds
    np.testing.assert_allclose(fixes.velocity_n, truth.antenna_velocity_n(fixes.t - 0.24, ARM), atol=5e-5)
    assert fixes.t[-1] <= 60.0


def test_white_errors_have_their_sigma_and_no_memory(parked):
    errors = GnssErrors(white_horizontal=0.3, white_up=0.5, velocity_sigma=0.15, has_vertical_velocity=True)
    fixes = simulate_gnss(parked, errors, ARM, 3000.0, UNIX, rng()).fixes
    error = fixes.position_n(parked.origin) - parked.antenna_position_n(fixes.t, ARM)
    for actual, sigma in ((error, [0.3, 0.3, 0.5]), (fixes.velocity_n, [0.15, 0.15, 0.15])):
        np.testing.assert_allclose(np.std(actual, axis=0), sigma, rtol=0.03)  # 15,000 values: 0.6 %
        following = np.mean(actual[1:] * actual[:-1], axis=0) / np.var(actual, axis=0)
        assert np.max(np.abs(following)) < 0.035


def test_slow_offset_is_gauss_markov_with_its_sigma_and_time_constant(parked):
    errors = GnssErrors(rate=2.0, offset_horizontal=2.0, offset_up=3.4, offset_tau=2.0)
    simulated = simulate_gnss(parked, errors, ARM, 3000.0, UNIX, rng())
    offset = simulated.offset_n
    error = simulated.fixes.position_n(parked.origin) - parked.antenna_position_n(simulated.fixes.t, ARM)
    np.testing.assert_allclose(error, offset, atol=1e-6)
    # 3000 s / (2 tau) = 750 independent values per axis: sigma known to 2.6 %, correlation to 0.04
    np.testing.assert_allclose(np.std(offset, axis=0), [2.0, 2.0, 3.4], rtol=0.1)
    for lag in (1, 4, 8):
        correlation = np.mean(offset[lag:] * offset[:-lag], axis=0) / np.var(offset, axis=0)
        np.testing.assert_allclose(correlation, np.exp(-0.5 * lag / 2.0), atol=0.12)


def test_slow_offset_is_stationary_from_the_first_fix(truth):
    errors = GnssErrors(rate=1.0, offset_horizontal=2.0, offset_up=3.4, offset_tau=60.0)
    first = np.array([simulate_gnss(truth, errors, ARM, 2.0, UNIX, rng(seed)).offset_n[0] for seed in range(400)])
    np.testing.assert_allclose(np.std(first, axis=0), [2.0, 2.0, 3.4], rtol=0.12)  # 400 values: 3.5 %


def test_errors_of_velocity_that_last_are_gauss_markov_beside_the_white_ones(parked):
    errors = GnssErrors(rate=5.0, velocity_sigma=0.1, velocity_lasting=0.2, velocity_tau=1.0)
    fixes = simulate_gnss(parked, replace(errors, has_vertical_velocity=True), ARM, 3000.0, UNIX, rng()).fixes
    error = fixes.velocity_n
    np.testing.assert_allclose(np.std(error, axis=0), np.hypot(0.1, 0.2), rtol=0.06)
    for lag in (1, 5, 10):
        lasting = np.mean(error[lag:] * error[:-lag], axis=0)
        np.testing.assert_allclose(lasting, 0.2**2 * np.exp(-0.2 * lag), atol=0.1 * 0.2**2)
    assert fixes.sigma_velocity[0] == pytest.approx(np.hypot(0.1, 0.2))


def test_errors_of_velocity_that_last_leave_all_others_as_they_were(truth):
    errors = GnssErrors(white_horizontal=0.3, velocity_sigma=0.1, offset_horizontal=1.0, receive_jitter=0.01)
    plain, filtered = (
        simulate_gnss(truth, replace(errors, velocity_lasting=lasting), ARM, 60.0, UNIX, rng()).fixes
        for lasting in (0.0, 0.2)
    )
    for name in ("t", "lat_deg", "lon_deg", "alt_m"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(filtered, name))
    assert 0.1 < np.std((filtered.velocity_n - plain.velocity_n)[:, :2]) < 0.3


def test_speed_and_course_both_come_from_the_noisy_velocity(parked):
    errors = GnssErrors(velocity_sigma=0.2)
    fixes = simulate_gnss(parked, errors, ARM, 600.0, UNIX, rng()).fixes
    assert np.all(np.isnan(fixes.velocity_n[:, 2]))
    assert np.mean(fixes.speed) == pytest.approx(0.2 * np.sqrt(np.pi / 2.0), rel=0.05)  # Rayleigh
    east = fixes.speed * np.sin(np.radians(fixes.course_deg))
    np.testing.assert_allclose(-east, fixes.velocity_n[:, 1], atol=1e-9)
    assert np.std(fixes.velocity_n[:, 0]) == pytest.approx(0.2, rel=0.05)


def test_receiver_without_doppler_sends_neither_velocity_nor_its_accuracy(truth):
    fixes = simulate_gnss(truth, GnssErrors(velocity=False, white_horizontal=1.0), ARM, 60.0, UNIX, rng()).fixes
    for column in (fixes.velocity_n, fixes.speed, fixes.course_deg, fixes.sigma_velocity):
        assert np.all(np.isnan(column))
    assert np.all(np.isfinite(fixes.sigma_horizontal))


def test_outages_and_jumps_are_where_they_were_put(truth):
    jump = Jump(30.0, 0.4, np.array([20.0, -10.0, 0.0]))
    errors = GnssErrors(outages=(Interval(10.0, 5.0),), jumps=(jump,))
    simulated = simulate_gnss(truth, errors, ARM, 60.0, UNIX, rng())
    t = simulated.fixes.t
    assert not np.any((t >= 10.0) & (t < 15.0)) and np.max(np.diff(t)) == pytest.approx(5.2)
    error = simulated.fixes.position_n(truth.origin) - truth.antenna_position_n(t, ARM)
    np.testing.assert_allclose(error, simulated.jump_n, atol=1e-6)
    np.testing.assert_allclose(t[np.any(simulated.jump_n != 0.0, axis=1)], [30.0, 30.2])


def test_reported_accuracy_is_true_wrong_by_a_factor_or_absent(truth):
    errors = GnssErrors(white_horizontal=0.3, offset_horizontal=0.4, white_up=0.6, offset_up=0.8, velocity_sigma=0.2)
    honest = simulate_gnss(truth, errors, ARM, 10.0, UNIX, rng()).fixes
    assert (honest.sigma_horizontal[0], honest.sigma_up[0], honest.sigma_velocity[0]) == pytest.approx((0.5, 1.0, 0.2))
    wrong = simulate_gnss(truth, replace(errors, hacc_factor=2.0, sacc_factor=0.5), ARM, 10.0, UNIX, rng()).fixes
    assert (wrong.sigma_horizontal[0], wrong.sigma_up[0], wrong.sigma_velocity[0]) == pytest.approx((1.0, 2.0, 0.1))
    silent = simulate_gnss(truth, replace(errors, hacc_factor=None, sacc_factor=None), ARM, 10.0, UNIX, rng()).fixes
    assert np.all(np.isnan([silent.sigma_horizontal, silent.sigma_up, silent.sigma_velocity]))


def test_fixes_are_rounded_to_the_digits_of_the_sentences(truth):
    fixes = simulate_gnss(truth, GnssErrors(rounding=True), ARM, 60.0, UNIX, rng()).fixes
    for column, digit in (
        (fixes.lat_deg * 60.0, 1e-5),
        (fixes.lon_deg * 60.0, 1e-5),
        (fixes.alt_m, 0.1),
        (fixes.speed / KNOT, 1e-3),
        (fixes.course_deg, 0.01),
    ):
        np.testing.assert_allclose(column / digit, np.round(column / digit), atol=1e-3)
    exact = truth.antenna_position_n(fixes.t, ARM)
    assert np.max(np.abs(fixes.position_n(truth.origin) - exact)[:, :2]) < 0.01  # half of 1e-5 minutes: 9 mm
    assert np.all((fixes.course_deg >= 0.0) & (fixes.course_deg < 360.0))


def test_sentences_that_arrive_late_are_stamped_late_and_in_order(truth):
    errors = GnssErrors(position_latency=0.1, velocity_latency=0.1, receive_jitter=0.05)
    simulated = simulate_gnss(truth, errors, ARM, 60.0, UNIX, rng())
    extra = simulated.fixes.t - simulated.position_time - 0.1
    assert np.min(extra) > -1e-6 and np.mean(extra) == pytest.approx(0.05, rel=0.25)
    assert np.min(np.diff(simulated.fixes.t)) > 0.0


# --- magnetometer


def test_field_points_where_the_world_magnetic_model_does():
    track = TRACKS["longmeadow"]
    north, west, up = earth_field_n(track.origin, UNIX)
    declination = np.degrees(np.arctan2(-west, north))
    inclination = np.degrees(np.arctan2(-up, np.hypot(north, west)))
    # Kansas in 2026: 4 deg east, 65 deg down, 51 uT (NOAA's maps, read to a degree and a microtesla)
    assert declination == pytest.approx(4.0, abs=1.0)
    assert inclination == pytest.approx(65.0, abs=1.5)
    assert np.linalg.norm([north, west, up]) == pytest.approx(51.0, abs=1.5)


def test_perfect_magnetometer_reads_the_field_in_its_own_axes(truth):
    R_bs = so3.exp(np.array([0.3, 0.2, -2.0]))
    mag = simulate_mag(truth, MagErrors(), FIELD_N, R_bs, 60.0, rng())
    assert len(mag.t) == 600
    field_n = np.einsum("nij,nj->ni", truth.at(mag.t).R_nb, mag.field @ R_bs.T)
    np.testing.assert_allclose(field_n, np.tile(FIELD_N, (600, 1)), atol=1e-9)


def test_hard_and_soft_iron_noise_and_resolution_act_as_documented(truth):
    soft, hard = EYE + 0.1 * np.ones((3, 3)), np.array([20.0, -15.0, 5.0])
    clean = simulate_mag(truth, MagErrors(), FIELD_N, EYE, 60.0, rng()).field
    iron = simulate_mag(truth, MagErrors(hard_iron_s=hard, soft_iron=soft), FIELD_N, EYE, 60.0, rng()).field
    np.testing.assert_allclose(iron, clean @ soft.T + hard, atol=1e-9)
    noisy = simulate_mag(truth, MagErrors(noise=0.02), FIELD_N, EYE, 60.0, rng()).field
    assert np.std(noisy - clean) == pytest.approx(0.02 * np.linalg.norm(FIELD_N), rel=0.06)
    counts = simulate_mag(truth, MagErrors(resolution=0.15), FIELD_N, EYE, 60.0, rng()).field / 0.15
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-9)


def test_engine_disturbs_the_field_under_load_and_not_at_rest(truth):
    errors = MagErrors(engine_disturbance=0.2, engine_direction_s=np.array([0.0, 0.6, 0.8]))
    clean = simulate_mag(truth, MagErrors(), FIELD_N, EYE, 60.0, rng())
    disturbed = simulate_mag(truth, errors, FIELD_N, EYE, 60.0, rng())
    engine = disturbed.field - clean.field
    size = np.linalg.norm(engine, axis=1) / np.linalg.norm(FIELD_N)
    assert np.max(size[disturbed.t < 5.0]) < 1e-9
    assert np.max(size) == pytest.approx(0.2)
    np.testing.assert_allclose(np.cross(engine, errors.engine_direction_s), 0.0, atol=1e-9)


def test_calibration_readings_lie_on_the_ellipsoid_of_the_iron():
    soft, hard = np.diag([1.1, 0.9, 1.0]), np.array([30.0, 0.0, -10.0])
    errors = MagErrors(hard_iron_s=hard, soft_iron=soft, calibration_points=500)
    field = simulate_mag_calibration(errors, FIELD_N, rng())
    assert field.shape == (500, 3)
    sphere = np.linalg.solve(soft, (field - hard).T)
    np.testing.assert_allclose(np.linalg.norm(sphere, axis=0), np.linalg.norm(FIELD_N))
    assert np.all(np.abs(np.mean(sphere, axis=1)) < 10.0)  # turned in all directions
    assert simulate_mag_calibration(MagErrors(), FIELD_N, rng()) is None
