"""The noise of an interval: by vibration, by place, and where samples are missing."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.model.imu import BinnedImu, bin_imu
from smoother.estimate.model.noise import (
    MISSING_ACCEL,
    MISSING_GYRO,
    InertialNoise,
    hole_lengths,
    interval_noise,
    shared_densities,
)
from smoother.samples import ImuSamples

from .shaken import NO_BIAS, Shaken

NOISE = InertialNoise(0.1, 0.01, 1e-3, 1e-4)


def test_lost_samples_raise_the_density_of_their_interval_only() -> None:
    base = bin_imu(Shaken(1.0, 0.0, 0.0).samples(100.0, 0.0, 2.0), np.array([0.4, 0.8, 1.2, 1.6]), 4, NO_BIAS, NO_BIAS)
    binned = replace(base, missing=np.array([0.0, 0.5, 0.0]))
    accel, gyro = interval_noise(binned, NOISE)
    # a hole of 0.2 s, whose force and rate are off by what they change in it: over all of it by rms 1 - exp(-0.2)
    unseen = (1.0 - np.exp(-0.2)) * np.sqrt(0.2) * np.sqrt(0.5)
    np.testing.assert_allclose(accel, np.hypot(NOISE.accel, [0.0, MISSING_ACCEL * unseen, 0.0]))
    np.testing.assert_allclose(gyro, np.hypot(NOISE.gyro, [0.0, MISSING_GYRO * unseen, 0.0]))


@pytest.mark.parametrize(("length", "turned"), [(0.2, 0.018), (1.0, 0.32), (3.0, 1.16), (30.0, 3.9)])
def test_a_turn_unseen_adds_up_with_the_time_and_in_long_holes_with_its_root(length: float, turned: float) -> None:
    n = round(length / 0.2)
    missing = np.concatenate([np.zeros(3), np.ones(n), np.zeros(3)])
    no = np.zeros((n + 6, 4, 3))
    binned = BinnedImu(0.2 * np.arange(n + 7), 0.05, no, no, missing)
    _, gyro = interval_noise(binned, replace(NOISE, gyro=0.0))
    assert np.sqrt(np.sum(gyro**2 * 0.2)) == pytest.approx(turned, rel=0.02)


def test_holes_are_as_long_as_the_intervals_in_a_row_that_miss_samples() -> None:
    missing = np.array([0.5, 1.0, 0.0, 0.0, 0.25, 0.0, 1.0])
    np.testing.assert_allclose(hole_lengths(missing, np.full(7, 0.2)), [0.3, 0.3, 0.0, 0.0, 0.05, 0.0, 0.2])
    np.testing.assert_allclose(hole_lengths(np.zeros(3), np.full(3, 0.2)), 0.0)


def test_noise_follows_the_vibration_by_its_share() -> None:
    t, rng = np.arange(1, 4001) / 100.0, np.random.default_rng(0)
    shaking = (t > 10.0) & (t < 20.0)
    force = np.where(shaking, 5.0, 0.5)[:, None] * rng.normal(size=(len(t), 3)) + [3.0, 0.0, 9.8]
    rate = 0.1 * rng.normal(size=(len(t), 3))
    binned = bin_imu(ImuSamples(t, force, rate), np.arange(0.2, 39.8, 0.2), 10, NO_BIAS, NO_BIAS)
    assert binned.rough is not None
    np.testing.assert_allclose(binned.rough.mean(axis=0), 1.0)  # so that the density is that of the session
    inside, outside = slice(55, 90), np.r_[5:40, 110:190]
    ratio = np.median(binned.rough[inside], axis=0) / np.median(binned.rough[outside], axis=0)
    assert ratio[0] == pytest.approx(100.0, rel=0.3)  # force alone is rough there, by (5 / 0.5)^2
    assert ratio[1] == pytest.approx(1.0, rel=0.3)
    accel, gyro = interval_noise(binned, replace(NOISE, accel_share=0.8))
    np.testing.assert_allclose(accel, NOISE.accel * np.sqrt(0.2 + 0.8 * binned.rough[:, 0]))
    np.testing.assert_allclose(gyro, NOISE.gyro)
    accel, gyro = interval_noise(binned, replace(NOISE, gyro_share=0.5))
    np.testing.assert_allclose(gyro, NOISE.gyro * np.sqrt(0.5 + 0.5 * binned.rough[:, 1]))
    np.testing.assert_allclose(accel, NOISE.accel)


def test_intervals_share_a_handful_of_densities_each_within_a_hundredth() -> None:
    no, rough = np.zeros((200, 4, 3)), np.linspace(0.5, 2.0, 400).reshape(2, 200).T
    binned = BinnedImu(0.2 * np.arange(201), 0.05, no, no, np.zeros(200), rough)
    noise = replace(NOISE, accel_share=0.9, gyro_share=0.9)
    for shared, own in zip(shared_densities(binned, noise), interval_noise(binned, noise), strict=True):
        assert np.max(np.abs(shared / own - 1.0)) < 0.0101
        assert len(np.unique(shared)) < 25
