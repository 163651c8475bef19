import numpy as np
import pytest

from smoother.estimate.baseline.alignment import Course
from smoother.estimate.baseline.kalman import accel_covariance_at_rest, accel_covariance_in_motion, fix_variance
from smoother.samples import GnssFixes

UNKNOWN = 2.5


def fixes(t, sigma=None):
    n = len(t)
    return GnssFixes(
        t, np.full(n, 45.0), np.full(n, 10.0), np.zeros(n), np.full((n, 3), np.nan), sigma_horizontal=sigma
    )


def circle(t, radius=40.0, speed=15.0):
    angle = speed / radius * t
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@pytest.mark.parametrize("sigma", [0.5, 1.5])
def test_the_scatter_of_the_fixes_is_found_while_driving(sigma):
    t = 0.2 * np.arange(2000)
    position = circle(t) + sigma * np.random.default_rng(1).normal(size=(2000, 2))
    # the bend of the path itself, v^2 / r dt^2 / 2 = 0.11 m, adds little
    np.testing.assert_allclose(np.sqrt(fix_variance(fixes(t), position)), sigma, rtol=0.06)


def test_a_slow_wander_is_not_scatter():
    t = 0.2 * np.arange(3000)
    wander = 2.0 * np.stack([np.sin(t / 30.0), np.cos(t / 40.0)], axis=1)
    position = wander + 0.3 * np.random.default_rng(2).normal(size=(3000, 2))
    reported = np.full(3000, 2.0)
    np.testing.assert_allclose(np.sqrt(fix_variance(fixes(t, reported), position)), 0.3, rtol=0.1)


def test_slow_fixes_on_a_winding_path_count_as_reported_or_as_the_default():
    t = 2.0 * np.arange(300)  # between fixes the path bends by v^2 / r dt^2 / 2 = 11 m
    np.testing.assert_allclose(fix_variance(fixes(t), circle(t)), UNKNOWN**2)
    np.testing.assert_allclose(fix_variance(fixes(t, np.full(300, 0.7)), circle(t)), 0.49)


def test_a_receiver_that_smooths_its_fixes_has_no_noise_of_a_millimetre():
    t = 0.1 * np.arange(500)
    np.testing.assert_allclose(fix_variance(fixes(t), 3.0 * np.stack([t, t], axis=1)), 0.04)


def test_fixes_reported_worse_than_usual_weigh_less():
    t = 0.2 * np.arange(500)
    reported = np.full(500, 1.0)
    reported[100:110] = 6.0
    reported[200] = np.nan
    variance = fix_variance(fixes(t, reported), circle(t))
    np.testing.assert_allclose(variance[100] / variance[0], 36.0)
    assert variance[200] == variance[0]


def test_an_outage_is_not_scatter():
    t = np.concatenate([0.2 * np.arange(300), 80.0 + 0.2 * np.arange(300)])
    position = circle(t) + 0.4 * np.random.default_rng(3).normal(size=(600, 2))
    np.testing.assert_allclose(np.sqrt(fix_variance(fixes(t), position)), 0.4, rtol=0.15)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_fixes_count_as_the_default(count):
    t = 0.2 * np.arange(count)
    np.testing.assert_allclose(fix_variance(fixes(t), np.zeros((count, 2))), UNKNOWN**2)


def test_white_noise_in_the_acceleration_comes_back_as_its_variance_per_step():
    rng = np.random.default_rng(4)
    t = 0.02 * np.arange(30_000)
    acceleration = 3.0 * rng.normal(size=(t.size, 2)) * [1.0, 2.0]
    course = Course(0.2 * np.arange(1, 2990), np.tile([10.0, 0.0], (2989, 1)))
    covariance = accel_covariance_in_motion(t, acceleration, course, 0.02)
    # 600 s hold 300 independent spans of 2 s
    np.testing.assert_allclose(np.diagonal(covariance), [9.0, 36.0], rtol=0.3)
    assert abs(covariance[0, 1]) < 0.25 * 18.0


def test_an_error_that_stays_for_seconds_weighs_as_much_as_white_noise_of_its_density():
    # 2 m/s^2, changing sign every 3 s: at rest such a filter would believe 2^2, here about 2^2 * 2 s / 0.02 s
    t = 0.02 * np.arange(30_000)
    leak = 2.0 * np.sign(np.sin(np.pi * t / 3.0))
    course = Course(0.2 * np.arange(1, 2990), np.tile([10.0, 0.0], (2989, 1)))
    covariance = accel_covariance_in_motion(t, np.stack([leak, 0.0 * t], axis=1), course, 0.02)
    assert 100.0 < covariance[0, 0] < 400.0
    np.testing.assert_allclose(covariance[1, 1], 0.0, atol=1e-9)


def test_a_true_acceleration_is_no_error():
    t = 0.02 * np.arange(20_000)
    fix_t = 0.2 * np.arange(1, 1990)

    def velocity(s):
        return np.stack([12.0 + 5.0 * np.sin(s), 5.0 * np.cos(s)], axis=1)

    acceleration = np.stack([5.0 * np.cos(t), -5.0 * np.sin(t)], axis=1)
    covariance = accel_covariance_in_motion(t, acceleration, Course(fix_t, velocity(fix_t)), 0.02)
    assert np.sqrt(covariance[0, 0]) < 0.5  # integration by sums, half a step late


@pytest.mark.parametrize(("driven", "sigma"), [(300.0, 3.0), (0.0, 0.3)])
def test_a_stand_counts_only_where_nothing_was_driven(driven, sigma):
    """At rest nothing shakes: a session half of which is a stand is as noisy as its drive."""
    t, fix_t = 0.02 * np.arange(30_000), 0.2 * np.arange(1, 2990)
    noise = np.where(t < driven, 3.0, 0.3)[:, None] * np.random.default_rng(5).normal(size=(t.size, 2))
    course = Course(fix_t, np.where(fix_t < driven, 10.0, 0.0)[:, None] * [1.0, 0.0])
    noise[np.searchsorted(t, driven), 0] -= 10.0 / 0.02 if driven else 0.0  # it stops at once
    covariance = accel_covariance_in_motion(t, noise, course, 0.02)
    np.testing.assert_allclose(np.diagonal(covariance), sigma**2, rtol=0.4)  # 150 independent spans of 2 s


def test_too_few_fixes_tell_nothing():
    t = 0.02 * np.arange(100)
    course = Course(np.array([0.5, 1.0]), np.zeros((2, 2)))
    assert accel_covariance_in_motion(t, np.zeros((100, 2)), course, 0.02) is None
    outside = Course(np.array([50.0, 51.0]), np.zeros((2, 2)))
    assert accel_covariance_in_motion(t, np.zeros((100, 2)), outside, 0.02) is None


def test_at_rest_it_is_the_covariance_of_the_thesis():
    acceleration = np.random.default_rng(5).multivariate_normal([1.0, 2.0], [[0.3, 0.1], [0.1, 0.2]], 5000)
    at_rest = np.arange(5000) < 4000
    np.testing.assert_allclose(accel_covariance_at_rest(acceleration, at_rest), [[0.3, 0.1], [0.1, 0.2]], atol=0.03)
    assert accel_covariance_at_rest(acceleration, np.arange(5000) < 20) is None
