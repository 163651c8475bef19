"""Vibration spectrum of inertial samples, and the engine's line in it.

An engine at 6,000 to 16,000 rpm shakes at 100 to 270 Hz and its multiples, which a logger at 200 Hz sees folded: the
frequencies here are those in the samples, and :func:`revolutions` says which engine speeds they could be.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import get_window, welch
from scipy.stats import chi2

from smoother.arrays import Array, BoolArray, IntArray
from smoother.fit.ellipsoid import FitError

FEWEST_SAMPLES = 256
RESOLUTION = 1.0  # Hz; finer than an engine holds its speed
LOWEST_LINE = 10.0  # Hz; below, a kart's own motion and its chassis
LINE_WINDOW = 0.5  # s over which the engine's speed hardly changes
LINE_CHANCE = 1e-3  # that noise alone makes such a peak in a window
BACKGROUND = 12.0  # Hz on either side of a line; the line itself is 4 Hz wide
LEAST_SHARE = 0.2  # of the windows; a line that is seen more rarely is called none
ENGINE_SPEEDS = (1500.0, 20000.0)  # rpm, of kart engines


@dataclass(frozen=True, eq=False)
class Spectrum:
    """One-sided power density (F, D), unit^2/Hz, of D columns at frequency (F,) Hz."""

    frequency: Array
    density: Array

    def rms(self, low: float = 0.0, high: float = np.inf) -> Array:
        """Root mean square (D,) of what lies between two frequencies, Hz."""
        inside = (self.frequency >= low) & (self.frequency <= high)
        step = float(self.frequency[1] - self.frequency[0])
        return np.asarray(np.sqrt(np.sum(self.density[inside], axis=0) * step))


@dataclass(frozen=True, eq=False)
class EngineLine:
    """The strongest line in windows of LINE_WINDOW: t (W,) s, frequency (W,) Hz, amplitude (W,); is_seen (W,).

    The amplitude is the root sum square over the axes of the tone's amplitude on each, in the unit of the values.
    """

    t: Array
    frequency: Array
    amplitude: Array
    is_seen: BoolArray

    @property
    def is_there(self) -> bool:
        """Whether there is such a line in a good part of the recording."""
        return bool(self.is_seen.size and np.mean(self.is_seen) >= LEAST_SHARE)


def vibration_spectrum(values: Array, rate: float) -> Spectrum:
    """Welch's estimate of values (N, D), evenly sampled at `rate` Hz. Raises FitError for too few or not finite."""
    values = np.asarray(values, dtype=np.float64)
    if len(values) < FEWEST_SAMPLES:
        raise FitError(f"{len(values)} samples are too few for a spectrum; record for some seconds")
    if not np.all(np.isfinite(values)):
        raise FitError("some readings are not finite numbers; drop those rows first")
    size = min(len(values), max(FEWEST_SAMPLES, round(rate / RESOLUTION)))
    frequency, density = welch(values, rate, nperseg=size, axis=0)
    return Spectrum(np.asarray(frequency), np.asarray(density))


def engine_line(t: Array, values: Array, rate: float) -> EngineLine:
    """Follow the strongest line above LOWEST_LINE through values (N, 3), evenly sampled at `rate` Hz from t (N,).

    A window has a line when its highest peak, summed over the axes and over the background around it, is one that
    white noise reaches once in a thousand windows. Raises FitError for too few samples.
    """
    size = round(LINE_WINDOW * rate)
    windows = len(values) // size if size else 0
    if windows < 1 or size < 16:
        raise FitError("the samples are too few or too slow to follow an engine's line")
    blocks = np.asarray(values, dtype=np.float64)[: windows * size].reshape(windows, size, -1)
    taper = get_window("hann", size)
    blocks = (blocks - blocks.mean(axis=1, keepdims=True)) * taper[:, None]
    padded = 4 * size  # so that the peak is met within a fraction of its width
    power = np.sum(np.abs(np.fft.rfft(blocks, padded, axis=1)) ** 2, axis=2)
    frequency = np.fft.rfftfreq(padded, 1.0 / rate)
    inside = frequency >= min(LOWEST_LINE, 0.25 * rate)
    power, frequency = power[:, inside], frequency[inside]
    peak = np.argmax(power, axis=1)
    freedom = 2 * blocks.shape[2]  # two quadratures on each axis
    background = np.median(_around(power, peak, round(BACKGROUND * padded / rate)), axis=1) / chi2.median(freedom)
    height = power[np.arange(windows), peak]
    threshold = chi2.isf(LINE_CHANCE / size, freedom)  # noise exceeds it in LINE_CHANCE of the windows
    amplitude = 2.0 * np.sqrt(height) / np.sum(taper)
    is_seen = height > threshold * np.maximum(background, 1e-300)
    middle = t[0] + (np.arange(windows) + 0.5) * size / rate
    at_the_edge = (peak == 0) | (peak == len(frequency) - 1)  # the slope of something slower, or folded over
    return EngineLine(middle, frequency[peak], amplitude, is_seen & ~at_the_edge)


def _around(power: Array, peak: IntArray, width: int) -> Array:
    """Power (W, 2 width + 1) in the bins around each peak (W,), so that a sloping spectrum makes no line."""
    bins = np.clip(peak[:, None] + np.arange(-width, width + 1), 0, power.shape[1] - 1)
    return np.take_along_axis(power, bins, axis=1)


def revolutions(frequency: float, rate: float) -> list[float]:
    """Engine speeds (rpm), ascending, whose shaking appears at `frequency` Hz when sampled at `rate` Hz."""
    folds = range(int(ENGINE_SPEEDS[1] / 60.0 / rate) + 2)
    real = {abs(fold * rate + sign * frequency) * 60.0 for fold in folds for sign in (-1.0, 1.0)}
    return sorted(rpm for rpm in real if ENGINE_SPEEDS[0] <= rpm <= ENGINE_SPEEDS[1])
