"""Allan deviation against allantools, and the noise figures against noise of known figures."""

import numpy as np
import pytest

from smoother.fit.allan import allan_deviation, fit_noise
from smoother.fit.ellipsoid import FitError

RATE = 20.0


def flicker(count, instability, rng):
    longer = 4 * count
    frequency = np.fft.rfftfreq(longer, 1.0 / RATE)
    power = np.zeros_like(frequency)
    power[1:] = instability**2 / (2.0 * np.pi * frequency[1:])
    phase = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    return np.fft.irfft(phase * np.sqrt(0.5 * power * RATE * longer), longer)[:count]


def noise(hours, density, instability, walk, rng, columns=1):
    count = int(hours * 3600 * RATE)
    out = []
    for _ in range(columns):
        white = density * np.sqrt(RATE) * rng.standard_normal(count)
        walking = np.cumsum(walk / np.sqrt(RATE) * rng.standard_normal(count))
        out.append(white + walking + flicker(count, instability, rng))
    return np.stack(out, axis=1)


def test_it_equals_allantools():
    allantools = pytest.importorskip("allantools")
    values = noise(0.1, 0.1, 0.05, 0.02, np.random.default_rng(1), columns=3) + 5.0
    ours = allan_deviation(values, RATE)
    for axis in range(3):
        tau, theirs, _, _ = allantools.oadev(values[:, axis], rate=RATE, data_type="freq", taus=ours.tau)
        np.testing.assert_allclose(ours.tau, tau, rtol=1e-12)
        np.testing.assert_allclose(ours.deviation[:, axis], theirs, rtol=1e-9)


@pytest.mark.parametrize("name", ["calib_hipnuc_static", "calib_mpu6050_static"])
def test_it_equals_allantools_on_real_sensors_at_rest(data_directory, name):
    allantools = pytest.importorskip("allantools")
    path = data_directory / name / "imu.csv"
    if not path.exists():
        pytest.skip(f"no {name}")
    table = np.genfromtxt(path, delimiter=",", names=True)
    values = np.stack([table[axis] for axis in ("ax", "az", "gx", "gz")], axis=1)
    ours = allan_deviation(values, 100.0)
    for column in range(4):
        tau, theirs, _, _ = allantools.oadev(values[:, column], rate=100.0, data_type="freq", taus=ours.tau)
        np.testing.assert_allclose(ours.tau, tau, rtol=1e-12)
        np.testing.assert_allclose(ours.deviation[:, column], theirs, rtol=1e-6)


def test_asked_averaging_times_are_rounded_to_whole_samples():
    found = allan_deviation(noise(0.05, 0.1, 0.0, 0.0, np.random.default_rng(2)), RATE, np.array([0.12, 1.0, 1.01]))
    np.testing.assert_allclose(found.tau, [0.1, 1.0])


def test_white_noise_falls_with_the_root_of_the_time_within_its_error_bars():
    found = allan_deviation(noise(1.0, 0.3, 0.0, 0.0, np.random.default_rng(3), columns=3), RATE)
    z = (found.deviation - 0.3 / np.sqrt(found.tau)[:, None]) / found.sigma
    assert np.mean(np.abs(z) < 3.0) > 0.95
    assert 0.5 < np.sqrt(np.mean(z**2)) < 1.6  # neighbouring points are correlated, so a wide bound


def test_all_three_figures_come_back_within_ten_percent():
    true = np.array([0.1, 0.06, 0.02])
    found = fit_noise(noise(6.0, *true, np.random.default_rng(4), columns=4), RATE)
    np.testing.assert_allclose(found.value, np.tile(true, (4, 1)), rtol=0.10)
    assert np.all(found.is_seen)


def test_the_sigmas_of_the_figures_are_honest():
    rng, true = np.random.default_rng(5), np.array([0.1, 0.06, 0.02])
    z = []
    for _ in range(4):
        found = fit_noise(noise(2.0, *true, rng, columns=6), RATE)
        z.append((found.value - true) / found.sigma)
    rms = np.sqrt(np.mean(np.concatenate(z) ** 2, axis=0))  # 24 values of each: 1 within 0.15, three times that
    np.testing.assert_allclose(rms, 1.0, atol=0.45)


def test_the_density_of_white_noise_has_a_correct_sigma():
    rng, z = np.random.default_rng(11), []
    for _ in range(20):
        found = fit_noise(rng.normal(0.0, 0.1, (20_000, 6)) * np.sqrt(RATE), RATE)
        z.append((found.value[:, 0] - 0.1) / found.sigma[:, 0])
    assert 0.75 < np.sqrt(np.mean(np.square(z))) < 1.25  # of 120; that drift is none from below makes it a little less


def test_the_fitted_figures_draw_the_curve():
    values = noise(6.0, 0.1, 0.06, 0.02, np.random.default_rng(6))
    curve = allan_deviation(values, RATE)
    short = curve.tau < 300.0  # beyond, few intervals are left
    model = fit_noise(values, RATE).allan_deviation(curve.tau)
    np.testing.assert_allclose(curve.deviation[short], model[short], rtol=0.15)


def test_what_a_short_recording_cannot_show_is_not_seen_but_bounded():
    found = fit_noise(noise(0.05, 0.1, 0.0, 1e-4, np.random.default_rng(7), columns=3), RATE)
    assert np.all(found.is_seen[:, 0])
    assert not np.any(found.is_seen[:, 2])
    assert np.all(found.upper[:, 2] > 1e-4)
    np.testing.assert_allclose(found.value[:, 0], 0.1, rtol=0.1)


def test_hum_is_not_taken_for_noise():
    values = noise(1.0, 0.1, 0.0, 0.0, np.random.default_rng(8))
    hum = 0.5 * np.sin(2.0 * np.pi * 1.7 * np.arange(len(values)) / RATE)
    np.testing.assert_allclose(fit_noise(values + hum[:, None], RATE).value[:, 0], 0.1, rtol=0.05)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (np.zeros((50, 3)), "50 samples at rest are too few"),
        (np.ones((5000, 3)), "never change"),
        (np.where(np.arange(15000).reshape(5000, 3) == 7, np.nan, 1.0), "not finite"),
    ],
)
def test_degenerate_readings_are_refused_in_one_sentence(values, says):
    with pytest.raises(FitError, match=says) as error:
        fit_noise(values, RATE)
    assert "\n" not in str(error.value)
