"""The filter and its transforms against noise that is known."""

import numpy as np
import pytest

from smoother.estimate.graph.wiener import FACTOR, Transform, most_probable, quick_length
from smoother.fit.running import gaussian_mean

DT = 0.04
MIDDLE = np.asarray(DT * (np.arange(15000) + 0.5), dtype=np.float64)


def filtered(values: np.ndarray, sigma: np.ndarray, wanted: slice = slice(None)) -> np.ndarray:
    return most_probable(Transform.of(values, DT), sigma, wanted).signal.values()


class TestTransform:
    @pytest.mark.parametrize("count", [1, 2, 5, 100, 15017])
    def test_there_and_back(self, count: int) -> None:
        values = np.random.default_rng(0).normal([0.0, 5.0, -100.0], size=(count, 3))
        np.testing.assert_allclose(Transform.of(values, DT).values(), values, atol=1e-12)

    def test_noise_has_the_power_that_is_stated(self) -> None:
        transform = Transform.of(3.0 * np.random.default_rng(1).normal(size=(15017, 2)), DT)
        power = np.mean(np.abs(transform.coefficients) ** 2, axis=0) / transform.count
        np.testing.assert_allclose(power, 9.0, rtol=0.04)

    def test_noisy_ends_are_filtered_like_the_middle(self) -> None:
        """One reading that stands out must not become a wave as long as the way back."""
        rng = np.random.default_rng(2)
        values = 5.0 * np.sin(0.7 * MIDDLE + 3.0 * np.sin(0.05 * MIDDLE))[:, None]
        noise = rng.normal(size=(15000, 1))
        noise[[0, -1]] = 10.0
        error = (filtered(values + noise, np.ones(1)) - values)[:, 0]
        ends = np.concatenate([error[:250], error[-250:]])
        assert np.sqrt(np.mean(ends**2)) < 2.0 * np.sqrt(np.mean(error**2))

    def test_what_comes_later_comes_later(self) -> None:
        wave = np.sin(2.0 * np.pi * 0.5 * MIDDLE)[:, None]
        late = Transform.of(np.hstack([wave, wave]), DT).later(np.array([0.3, 0.0])).values()
        inside = slice(1000, -1000)
        np.testing.assert_allclose(late[inside, 0], np.sin(2.0 * np.pi * 0.5 * (MIDDLE - 0.3))[inside], atol=1e-3)
        np.testing.assert_allclose(late[:, 1], wave[:, 0], atol=1e-12)

    def test_what_is_slower_stays_and_what_is_quicker_goes(self) -> None:
        slow, quick = np.sin(2.0 * np.pi * 0.5 * MIDDLE), np.sin(2.0 * np.pi * 4.0 * MIDDLE)
        left = Transform.of((slow + quick + 7.0)[:, None], DT).slower_than(2.0).values()[:, 0]
        np.testing.assert_allclose(left[500:-500], slow[500:-500] + 7.0, atol=0.01)

    def test_lengths_are_quick(self) -> None:
        for count in (*range(1, 500), 15017, 30047, 999983):
            length = quick_length(count)
            assert length % 2 == 0
            assert count <= length <= 1.07 * count + 2
            while length % 2 == 0:
                length //= 2
            assert length <= FACTOR


class TestMostProbable:
    def test_channels_that_are_not_wanted_still_lend_a_hand(self) -> None:
        motion = np.sin(0.5 * MIDDLE[:, None] + [0.0, 1.0, 2.0])
        values = 16.0 * motion + np.random.default_rng(5).normal(size=(15000, 3))
        whole = filtered(values, np.ones(3))
        np.testing.assert_allclose(filtered(values, np.ones(3), slice(1, 2)), whole[:, 1:2], atol=1e-12)

    def test_pure_noise_is_taken_for_noise(self) -> None:
        values = np.random.default_rng(1).normal(size=(15000, 3))
        assert np.std(filtered(values, np.ones(3))) < 0.15

    def test_a_channel_that_sees_the_same_lends_a_hand(self) -> None:
        rng = np.random.default_rng(2)
        signal = np.sin(0.7 * MIDDLE + 3.0 * np.sin(0.05 * MIDDLE))
        values = signal[:, None] + rng.normal(size=(len(signal), 2)) * [1.0, 0.1]
        both = filtered(values, np.array([1.0, 0.1]))[:, 0] - signal
        alone = filtered(values[:, :1], np.array([1.0]))[:, 0] - signal
        assert np.std(both) < 0.4 * np.std(alone)

    @pytest.mark.parametrize("sigma", [0.3, 1.0, 4.0])
    def test_errors_are_as_large_as_is_said(self, sigma: float) -> None:
        rng = np.random.default_rng(6)
        signal = gaussian_mean(rng.normal(size=(15000, 1)), 6.0)  # without an edge in its spectrum
        signal = np.hstack([signal, 0.7 * signal + 0.5 * gaussian_mean(rng.normal(size=(15000, 1)), 10.0)])
        signal /= np.std(signal, axis=0)
        noise = sigma * np.array([1.0, 0.5])
        found = most_probable(Transform.of(signal + noise * rng.normal(size=signal.shape), DT), noise, slice(None))
        error = np.std(found.signal.values() - signal, axis=0)
        np.testing.assert_allclose(np.sqrt(found.variance), error, rtol=0.15)
        assert np.all(error < np.minimum(noise, 1.0))

    def test_the_error_where_noise_is_said_to_be_less_at_some_frequencies(self) -> None:
        """White noise that Doppler has taken out below a hertz."""
        rng = np.random.default_rng(7)
        signal = gaussian_mean(rng.normal(size=(15000, 1)), 6.0)
        signal /= np.std(signal)
        noise = Transform.of(2.0 * rng.normal(size=(15000, 1)), DT)
        share = np.where(noise.frequency < 1.0, 0.1, 1.0)[:, None]
        left = Transform(share * noise.coefficients, noise.mean, noise.count, DT).values()
        found = most_probable(Transform.of(signal + left, DT), 2.0 * share, slice(None))
        error = np.std(found.signal.values() - signal)
        np.testing.assert_allclose(np.sqrt(found.variance[0]), error, rtol=0.15)

    def test_noise_of_velocities_does_not_pass_to_the_other_channel_in_phase_with_the_velocities(self) -> None:
        """Though that one leads: what is passed on must not contain the slope of the acceleration."""
        rng, n, lead = np.random.default_rng(3), 15000, 3  # bins; the nose turns in 0.12 s before the path
        motion = gaussian_mean(rng.normal(size=(n + lead, 1)), 4.0)[:, 0]
        motion *= 6.0 / np.std(motion)
        disturbed = gaussian_mean(rng.normal(size=(n + 1, 1)), 2.0)[:, 0]  # velocities; their slope is in channel 0
        values = np.column_stack([motion[:n] + 0.3 * np.diff(disturbed) / DT, motion[lead:] + 5.0 * rng.normal(size=n)])
        left = filtered(values, np.array([1.0, 5.0]))[:, 1] - motion[lead:]
        # 1 / sqrt(n) is 0.008, and neighbours are alike
        assert abs(np.corrcoef(left, disturbed[1:] + disturbed[:-1])[0, 1]) < 0.05
