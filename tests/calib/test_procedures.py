"""What single procedures make of what a recording holds, against formulas."""

import numpy as np
import pytest

from calib import allan, ellipsoid, gyro_bias, level, six_position
from calib.recording import Recording
from smoother.calibration import Calibration
from smoother.fit.correlation import correlation_growth
from smoother.fit.resting import RestingPosition
from smoother.samples import RawImu, RawMag
from smoother.units import STANDARD_GRAVITY


def rest(start, end, rate, variance):
    """A rest whose mean rate (3,) has `variance` (rad/s)^2 on every axis."""
    force = np.array([0.0, 0.0, STANDARD_GRAVITY])
    return RestingPosition(start, end, force, np.asarray(rate), 1e-6 * np.eye(3), variance * np.eye(3), 100)


def with_rests(*positions):
    found = Recording("made up")
    vars(found)["positions"] = positions  # what is worked out once, and kept there
    return found


def test_the_mean_bias_of_rests_has_the_sigma_of_a_mean_by_their_lengths():
    density = 1e-3  # rad/s/sqrt(Hz)
    rests = [
        rest(0.0, 10.0, [0.01, 0.0, 0.02], density**2 / 10.0),
        rest(20.0, 50.0, [0.01, 0.0, 0.02], density**2 / 30),
    ]
    bias, sigma = gyro_bias.mean_bias(with_rests(*rests))
    np.testing.assert_allclose(bias, [0.01, 0.0, 0.02])
    np.testing.assert_allclose(sigma, density / np.sqrt(40.0))


def test_the_density_of_rests_explains_the_scatter_of_their_means():
    density = 2e-4
    rests = [rest(10.0 * k, 10.0 * k + 8.0, np.zeros(3), density**2 / 8.0) for k in range(6)]
    assert six_position._density_of_rests(with_rests(*rests)) == pytest.approx(density)


def test_a_field_that_reads_one_count_has_the_sigma_of_the_count():
    t, step = 0.1 * np.arange(100), 0.3
    field = np.tile([30.0, -60.0, 90.0], (100, 1))
    field[::2] += step  # outside the rest readings change by a count
    field[20:60] = [30.0, -60.0, 90.0]
    soft = np.diag([0.02, 0.01, 0.03])
    found = level._field(
        Recording("made up", mag=RawMag(t, field)),
        rest(2.0, 5.9, np.zeros(3), 0.0),
        Calibration(hard_iron=np.zeros(3), soft_iron=soft),
        0.0,
    )
    assert found is not None
    np.testing.assert_allclose(np.sqrt(np.diag(found[1])), np.diag(soft) * step / np.sqrt(12.0), rtol=0.02)


def test_readings_whose_errors_are_alike_make_the_iron_less_sure():
    rng = np.random.default_rng(4)
    directions = rng.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    alike = np.zeros(3000)
    for k in range(1, 3000):
        alike[k] = 0.95 * alike[k - 1] + 0.3 * rng.standard_normal()
    outcome = ellipsoid.calibrate(
        Recording("made up", mag_field=(50.0 + alike[:, None]) * directions + [20.0, -5.0, 8.0])
    )
    fit = outcome.drawing["fit"]
    growth = correlation_growth(np.linalg.norm(fit.apply(outcome.drawing["readings"][fit.is_used]), axis=1) - 1.0)
    assert growth > 3.0
    np.testing.assert_allclose(outcome.values[0].sigma, growth * np.sqrt(np.diag(fit.covariance))[:3])


def test_what_warmth_does_to_the_bias_is_no_noise():
    rng, t = np.random.default_rng(6), 0.01 * np.arange(1, 20_001)
    warmth = 25.0 + 0.02 * t  # 4 K in 200 s
    rate = 1e-3 * rng.normal(size=(len(t), 3)) + 5e-4 * (warmth - 25.0)[:, None]
    force = 0.01 * rng.normal(size=(len(t), 3)) + [0.0, 0.0, STANDARD_GRAVITY]
    recording = Recording("made up", imu=RawImu(t, force, rate, temperature=warmth))
    known = Calibration(gyro_bias_slope=np.full(3, 5e-4), gyro_temperature=25.0, gyro_temperature_span=(25.0, 29.0))
    blamed, explained = (allan.calibrate(recording, calibration) for calibration in (Calibration(), known))
    assert any("the gyroscope drifts more than noise does" in remark for remark in blamed.remarks)
    assert not any("drifts" in remark for remark in explained.remarks)
    np.testing.assert_allclose(explained.notes["allan.gyroscope"]["noise_density"], 1e-4, rtol=0.1)
