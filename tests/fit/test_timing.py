"""Rate, jitter, gaps, clipping, vibration, and the magnetometer against the gyroscope."""

import numpy as np
import pytest

from smoother import so3
from smoother.fit.ellipsoid import FitError
from smoother.fit.timing import clipped_share, magnetometer_against_gyro, sample_timing, vibration_spectrum
from smoother.sim.bench import BenchErrors, BenchPlan, simulate_bench
from smoother.sim.scenario import ImuErrors, MagErrors


def test_rate_jitter_and_gaps_of_a_stream():
    rng = np.random.default_rng(1)
    t = np.arange(20000) / 104.0 + 0.001 * rng.standard_normal(20000)
    t = np.delete(t, slice(5000, 5030))
    found = sample_timing(np.sort(t))
    assert found.rate == pytest.approx(104.0, abs=max(6.0 * found.rate_sigma, 1e-3))
    assert found.jitter == pytest.approx(0.001, rel=0.15)
    assert found.gaps == 1
    assert found.longest_gap == pytest.approx(31 / 104.0, abs=0.005)
    assert found.is_steady


@pytest.mark.parametrize(("count", "jitter"), [(2000, 1e-3), (20_000, 1e-3), (6000, 2e-4)])
def test_the_sigma_of_a_rate_is_correct(count, jitter):
    rng, z = np.random.default_rng(2), []
    for _ in range(40):
        t = np.sort(np.arange(count) / 104.0 + jitter * rng.standard_normal(count))
        found = sample_timing(np.delete(t, slice(count // 3, count // 3 + 30)))
        z.append((found.rate - 104.0) / found.rate_sigma)
    assert 0.7 < np.sqrt(np.mean(np.square(z))) < 1.4  # 99.9 % of the rms of 40, and what sorting takes from jitter


def test_a_handful_of_samples_has_no_rate():
    with pytest.raises(FitError, match="5 samples are too few"):
        sample_timing(np.arange(5.0))


def test_clipping_with_a_known_range():
    values = np.array([[1.0, 0.0, 0.0], [16.0, 0.0, -16.0], [2.0, 0.0, 3.0], [15.0, 0.0, 0.0]])
    np.testing.assert_allclose(clipped_share(values, 16.0), [0.25, 0.0, 0.25])


def test_clipping_without_a_known_range_is_a_run_at_the_extreme():
    wave = 10.0 * np.sin(np.linspace(0.0, 60.0, 2000))
    share = clipped_share(np.stack([np.clip(wave, -8.0, 8.0), wave, np.zeros(2000)], axis=1))
    assert share[0] > 0.2
    assert share[1] < 0.01
    assert share[2] == 0.0


def recording(delay, axes, seed=2, outliers=0.0):
    rng = np.random.default_rng(seed)
    mag = MagErrors(rate=40.0, noise=0.01, soft_iron=so3.exp(-np.asarray(axes)))
    plan = BenchPlan(still=5.0, positions=0, waving=60.0)
    errors = BenchErrors(np.zeros(3), mag_outliers=outliers, mag_delay=delay)
    imu = ImuErrors(rate=100.0, gyro_noise=1e-4)
    return simulate_bench(imu, mag, np.array([22.0, 0.0, -42.0]), rng, plan, errors)


@pytest.mark.parametrize("outliers", [0.0, 0.05])
def test_delay_and_turned_axes_of_a_magnetometer_are_found(outliers):
    axes = np.array([0.01, -0.02, 0.03])
    bench = recording(0.017, axes, outliers=outliers)
    found = magnetometer_against_gyro(bench.imu.t, bench.imu.gyro, bench.mag.t, bench.mag.field / 47.4)
    assert abs(found.delay - 0.017) < 4.0 * found.delay_sigma < 0.004
    assert np.all(np.abs(found.turn - axes) < 4.0 * found.turn_sigma)
    assert np.all(found.turn_sigma < 0.004)


def test_the_sigmas_of_delay_and_turned_axes_are_correct():
    z = []
    for seed in range(20, 28):
        rng = np.random.default_rng(seed)
        delay, axes = rng.uniform(-0.03, 0.03), rng.normal(0.0, 0.02, 3)
        bench = recording(delay, axes, seed=seed)
        found = magnetometer_against_gyro(bench.imu.t, bench.imu.gyro, bench.mag.t, bench.mag.field / 47.4)
        z += [(found.delay - delay) / found.delay_sigma, *(found.turn - axes) / found.turn_sigma]
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.35  # 32 values: 1 within 0.13


def test_a_logger_that_was_not_turned_shows_no_delay():
    t = np.arange(2000) / 100.0
    with pytest.raises(FitError, match="hardly turned"):
        magnetometer_against_gyro(t, np.zeros((2000, 3)), t, np.tile([1.0, 0.0, 0.0], (2000, 1)))


def test_axes_that_do_not_belong_together_are_refused():
    bench = recording(0.0, np.zeros(3))
    with pytest.raises(FitError, match="does not turn as the gyroscope says"):
        magnetometer_against_gyro(bench.imu.t, -bench.imu.gyro, bench.mag.t, bench.mag.field / 47.4)


RATE = 200.0
T = np.arange(int(60 * RATE)) / RATE


def test_white_noise_has_its_variance_spread_evenly():
    values = np.random.default_rng(1).standard_normal((len(T), 3))
    found = vibration_spectrum(values, RATE)
    inner = (found.frequency > 5.0) & (found.frequency < 95.0)
    np.testing.assert_allclose(found.density[inner].mean(axis=0), 2.0 / RATE, rtol=0.05)
    np.testing.assert_allclose(found.rms(), 1.0, rtol=0.05)


def test_the_rms_of_a_band_is_that_of_the_tone_in_it():
    values = np.stack([3.0 * np.sin(2.0 * np.pi * 40.0 * T), np.zeros_like(T), np.zeros_like(T)], axis=1)
    np.testing.assert_allclose(vibration_spectrum(values, RATE).rms(35.0, 45.0)[0], 3.0 / np.sqrt(2.0), rtol=0.02)


@pytest.mark.parametrize(("values", "says"), [(np.zeros((20, 3)), "too few"), (np.full((5000, 3), np.nan), "finite")])
def test_degenerate_readings_are_refused(values, says):
    with pytest.raises(FitError, match=says):
        vibration_spectrum(values, RATE)
