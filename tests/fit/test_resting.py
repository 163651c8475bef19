"""Resting positions: where they are, and whether the covariances of their means are honest."""

import numpy as np
import pytest

from smoother.fit.ellipsoid import FitError
from smoother.fit.resting import batch_means, distinct_directions, resting_positions, rounding_step, rounding_variance

RATE = 100.0


def rests(count, length, rng, scatter=0.05, memory=0.0):
    """Readings at rest in `count` positions with a short move between; true forces (count, 3)."""
    n, gap = int(length * RATE), int(2.0 * RATE)
    true = rng.normal(0.0, 5.0, (count, 3))
    force, still = [], []
    for direction in true:
        noise = rng.standard_normal((n + gap, 3))
        for k in range(1, len(noise)):
            noise[k] = memory * noise[k - 1] + np.sqrt(1.0 - memory**2) * noise[k]
        force.append(direction + scatter * noise)
        still.append(np.arange(n + gap) < n)
    return np.concatenate(force), np.concatenate(still), true


def test_each_stretch_at_rest_becomes_a_position():
    rng = np.random.default_rng(1)
    force, still, true = rests(5, 6.0, rng)
    t = np.arange(len(force)) / RATE
    found = resting_positions(t, force, 0.1 * force, still, 20.0 + t)
    assert len(found) == 5
    np.testing.assert_allclose([p.force for p in found], true, atol=0.02)
    np.testing.assert_allclose([p.rate for p in found], 0.1 * true, atol=0.002)
    assert found[0].end - found[0].start == pytest.approx(6.0 - 2 * 0.4, abs=0.03)
    assert found[2].temperature == pytest.approx(20.0 + 0.5 * (found[2].start + found[2].end), abs=0.01)


def test_short_rests_are_passed_over():
    force, still, _ = rests(3, 2.5, np.random.default_rng(2))
    assert resting_positions(np.arange(len(force)) / RATE, force, force, still) == ()


@pytest.mark.parametrize("memory", [0.0, 0.8], ids=["white", "behind a low-pass"])
def test_the_covariance_of_a_mean_is_honest_also_when_readings_are_alike(memory):
    rng = np.random.default_rng(3)
    z = []
    for _ in range(12):
        force, still, true = rests(6, 6.0, rng, memory=memory)
        for position, direction in zip(
            resting_positions(np.arange(len(force)) / RATE, force, force, still), true, strict=True
        ):
            z.append((position.force - direction) / np.sqrt(np.diagonal(position.force_covariance)))
    assert 0.8 < np.sqrt(np.mean(np.square(z))) < 1.2  # 216 values, of which the memory of a rest's ends takes some


def test_batches_are_averaged_and_broken_ones_left_out():
    t = np.concatenate([np.arange(100), np.arange(120, 300)]) / RATE
    middle, means = batch_means(t, np.column_stack([t, 2.0 * t]))
    np.testing.assert_allclose(means[:, 0], middle, atol=1e-12)
    np.testing.assert_allclose(means[:, 1], 2.0 * middle, atol=1e-12)


def test_too_little_rest_has_no_covariance():
    t = np.arange(281) * 0.0101  # 2.03 s without its edges
    t = t[:280]
    still = np.ones(280, dtype=bool)
    with pytest.raises(FitError, match="too briefly"):
        resting_positions(t, np.ones((280, 3)), np.ones((280, 3)), still)


def test_rounding_hides_most_when_there_is_no_noise_and_nothing_when_there_is_much():
    rng = np.random.default_rng(4)
    offset = rng.uniform(0.0, 1.0, 400)
    for noise, most in ((0.05, 0.1), (0.3, 0.02), (1.0, 1e-4)):
        errors, claimed = [], []
        for value in offset:
            rounded = np.round(value + noise * rng.standard_normal((2000, 1)))
            errors.append(rounded.mean() - value)
            claimed.append(rounding_variance(rounded, np.ones(1))[0])
        hidden = np.mean(np.square(errors)) - noise**2 / 2000
        assert hidden - 1e-4 < np.mean(claimed) * 2.0 < 4.0 * most


def test_the_size_of_a_count_is_found():
    values = np.round(np.random.default_rng(5).normal(0.0, 5.0, (1000, 2))) * [0.1, 2.0]
    np.testing.assert_allclose(rounding_step(np.column_stack([values, np.ones(1000)])), [0.1, 2.0, 0.0])


def test_directions_that_differ_by_little_count_once():
    forces = 9.8 * np.array([[0, 0, 1.0], [0.1, 0, 1.0], [1.0, 0, 0], [0, 0, -1.0]])
    assert len(distinct_directions(forces)) == 3
