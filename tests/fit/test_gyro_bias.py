import numpy as np
import pytest
from scipy.stats import chi2

from smoother.fit.ellipsoid import FitError
from smoother.fit.gyro_bias import fit_gyro_bias, fit_gyro_bias_of_first
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
