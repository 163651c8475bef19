import numpy as np
import pytest
from scipy.stats import chi2

from smoother.fit.ellipsoid import FitError
from smoother.fit.gyro_bias import fit_gyro_bias, fit_gyro_bias_of_first, fit_temperature
from smoother.units import DEG

BIAS = np.array([3.0, -1.0, 58.0]) * DEG


def test_the_bias_is_the_mean_of_the_readings_at_rest_only():
    rate = np.array([[1.0, 2.0, 3.0], [9.0, 9.0, 9.0], [3.0, 2.0, 1.0]])
    fit = fit_gyro_bias(rate, np.array([True, False, True]))
    np.testing.assert_allclose(fit.bias, [2.0, 2.0, 2.0])
    assert fit.count == 2


def test_the_covariance_is_about_the_mean_and_not_of_the_readings_themselves():
    # eq. 2.3 as printed would give the square of the bias, (58 deg/s)^2, on top of the noise
    rng = np.random.default_rng(1)
    noise = np.array([[0.04, 0.01, 0.0], [0.01, 0.09, 0.0], [0.0, 0.0, 0.01]])
    rate = BIAS + rng.multivariate_normal(np.zeros(3), noise, 20000)
    fit = fit_gyro_bias(rate)
    np.testing.assert_allclose(fit.noise_covariance, noise, atol=0.004)  # 0.09 sqrt(2 / 20000) is 0.0009
    printed = rate.T @ rate / (len(rate) - 1)
    assert printed[2, 2] > 50.0 * noise[2, 2]


def test_the_sigma_of_the_bias_is_honest():
    rng = np.random.default_rng(2)
    nees = []
    for _ in range(200):
        fit = fit_gyro_bias(BIAS + 0.05 * rng.normal(size=(300, 3)))
        error = fit.bias - BIAS
        nees.append(error @ np.linalg.solve(fit.covariance, error))
    low, high = chi2.ppf([0.0005, 0.9995], 600) / 200
    assert low < np.mean(nees) < high
    np.testing.assert_allclose(fit.sigma, np.sqrt(np.diagonal(fit.covariance)))


def test_the_thesis_form_takes_the_first_thousand_readings():
    rate = np.concatenate([np.tile(BIAS, (1000, 1)), np.ones((500, 3))])
    rate[::2] += 0.01
    rate[1:1000:2] -= 0.01
    np.testing.assert_allclose(fit_gyro_bias_of_first(rate).bias, BIAS, atol=1e-12)
    assert fit_gyro_bias_of_first(rate[:400]).count == 400  # a shorter file gives what it has
    assert fit_gyro_bias_of_first(rate, 100).count == 100


def test_nan_rows_do_not_count():
    rate = np.tile(BIAS, (10, 1))
    rate[3, 1] = np.nan
    fit = fit_gyro_bias(rate)
    assert fit.count == 9
    np.testing.assert_allclose(fit.bias, BIAS)


@pytest.mark.parametrize("at_rest", [0, 1])
def test_too_few_readings_at_rest_are_refused(at_rest):
    mask = np.arange(50) < at_rest
    with pytest.raises(FitError, match=f"{at_rest} gyro readings at rest are too few"):
        fit_gyro_bias(np.zeros((50, 3)), mask)


def warming(rng, slope, count=100, sigma=1e-4):
    temperature = 25.0 + 12.0 * (1.0 - np.exp(-np.arange(count) / 40.0))
    rate = BIAS_AT_30 + (temperature - 30.0)[:, None] * slope + sigma * rng.standard_normal((count, 3))
    return temperature, rate


BIAS_AT_30 = np.array([0.02, -0.01, 0.005])


def test_the_dependence_on_temperature_is_found_with_honest_sigmas():
    rng, z = np.random.default_rng(7), []
    for _ in range(40):
        slope = rng.normal(0.0, 1e-3, 3)
        fit = fit_temperature(*warming(rng, slope))
        z.append(np.concatenate([(fit.slope - slope) / fit.slope_sigma, fit.at(np.array([30.0]))[0] - BIAS_AT_30]))
        z[-1][3:] /= np.hypot(fit.bias_sigma, (30.0 - fit.temperature) * fit.slope_sigma)
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.2  # 240 values


def test_of_few_means_two_are_spent_on_the_line():
    temperature, rate = warming(np.random.default_rng(9), np.full(3, 1e-3), count=15)
    fit = fit_temperature(temperature, rate)
    for axis in range(3):  # so few have no growth: neighbours that are alike do not show
        _, covariance = np.polyfit(temperature - fit.temperature, rate[:, axis], 1, cov=True)
        np.testing.assert_allclose([fit.slope_sigma[axis], fit.bias_sigma[axis]], np.sqrt(np.diag(covariance)))


def test_a_temperature_that_was_not_seen_counts_as_the_nearest_that_was():
    fit = fit_temperature(*warming(np.random.default_rng(8), np.full(3, 1e-3)))
    np.testing.assert_array_equal(fit.at(np.array([80.0])), fit.at(np.array([fit.span[1]])))


@pytest.mark.parametrize(
    ("temperature", "says"),
    [(np.full(100, 25.0), r"changed by only 0\.0 K"), (np.full(100, np.nan), "0 means at rest with a temperature")],
)
def test_without_a_change_of_temperature_there_is_no_slope(temperature, says):
    with pytest.raises(FitError, match=says):
        fit_temperature(temperature, np.zeros((100, 3)))
