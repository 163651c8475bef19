"""Signals out of white noise: what is kept, how far off it is, and what is not taken for motion."""

import numpy as np

from smoother.estimate.output.dense_rows import without_noise

DT, N = 0.02, 15_000
T = DT * np.arange(N)


def test_a_slow_signal_is_recovered_within_its_variance() -> None:
    rng, noise = np.random.default_rng(1), np.array([4.0, 0.25])
    signal = np.column_stack([3.0 * np.sin(2.0 * np.pi * 0.3 * T) + 0.002 * T, np.cos(2.0 * np.pi * 1.1 * T)])
    found, variance = without_noise(
        signal + np.sqrt(noise) * rng.normal(size=(N, 2)), noise, DT, np.array([True, True])
    )
    error = np.mean((found - signal) ** 2, axis=0)
    assert np.all(error < 0.2 * noise)
    np.testing.assert_allclose(error, variance, rtol=0.5)


def test_without_noise_nothing_changes() -> None:
    signal = np.cumsum(np.random.default_rng(2).normal(size=(500, 1)), axis=0)
    found, variance = without_noise(signal, np.zeros(1), DT, np.array([True]))
    np.testing.assert_allclose(found, signal, atol=1e-9)
    np.testing.assert_array_equal(variance, 0.0)


def test_a_line_above_the_motion_passes_where_signals_may_rise_again_alone() -> None:
    rng = np.random.default_rng(3)
    line, slow = 2.0 * np.sin(2.0 * np.pi * 11.0 * T), 4.0 * np.sin(2.0 * np.pi * 0.2 * T)
    values = np.tile((slow + line + rng.normal(size=N))[:, None], (1, 2))
    found, _ = without_noise(values, np.ones(2), DT, np.array([True, False]))
    kept = line @ found / (line @ line)
    assert kept[0] < 0.02 and kept[1] > 0.9
