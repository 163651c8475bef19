"""Vibration spectrum and the engine's line, on tones and noise of known size."""

import numpy as np
import pytest

from smoother.fit.ellipsoid import FitError
from smoother.fit.spectrum import engine_line, revolutions, vibration_spectrum

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


def test_a_line_that_sweeps_and_folds_is_followed():
    rng = np.random.default_rng(2)
    frequency = 125.0 + 18.0 * np.sin(2.0 * np.pi * T / 2.0)  # up to 57 Hz/s, above half the sampling rate
    phase = 2.0 * np.pi * np.cumsum(frequency) / RATE
    values = 0.5 * rng.standard_normal((len(T), 3)) + np.sin(phase)[:, None] * [1.0, 2.0, 0.5]
    found = engine_line(T, values, RATE)
    assert found.is_there
    assert np.mean(found.is_seen) > 0.8
    true = np.interp(found.t, T, np.abs((frequency + 100.0) % 200.0 - 100.0))
    assert np.median(np.abs(found.frequency - true)[found.is_seen]) < 1.0
    np.testing.assert_allclose(np.median(found.amplitude[found.is_seen], axis=0), [1.0, 2.0, 0.5], rtol=0.15)


def test_noise_alone_has_no_line_even_when_it_falls_with_frequency():
    rng = np.random.default_rng(3)
    white = rng.standard_normal((len(T), 3))
    assert np.mean(engine_line(T, white, RATE).is_seen) < 0.03
    assert not engine_line(T, np.cumsum(white, axis=0), RATE).is_there


def test_a_line_too_weak_to_be_followed_is_said_to_show_in_the_spectrum_and_how_often_it_was_seen():
    rng = np.random.default_rng(4)
    values = rng.standard_normal((len(T), 3)) + 0.45 * np.sin(2.0 * np.pi * 60.0 * T)[:, None]
    spectrum, line = vibration_spectrum(values, RATE), engine_line(T, values, RATE)
    at = np.argmin(np.abs(spectrum.frequency - 60.0))
    assert spectrum.density[at, 0] > 5.0 * np.median(spectrum.density[:, 0])
    assert not line.is_there and 0.0 < line.share < 0.05
    assert f"in only {100.0 * line.share:.1f} % of the windows of 0.5 s one stands out" in line.why_none
    assert "no line stands out" not in line.why_none


def test_the_engine_speeds_behind_a_folded_line():
    assert revolutions(80.0, 200.0) == pytest.approx([4800.0, 7200.0, 16800.0, 19200.0])


@pytest.mark.parametrize(("values", "says"), [(np.zeros((20, 3)), "too few"), (np.full((5000, 3), np.nan), "finite")])
def test_degenerate_readings_are_refused(values, says):
    with pytest.raises(FitError, match=says):
        vibration_spectrum(values, RATE)


def test_too_few_samples_follow_no_line():
    with pytest.raises(FitError, match="too few or too slow"):
        engine_line(T[:50], np.zeros((50, 3)), RATE)
