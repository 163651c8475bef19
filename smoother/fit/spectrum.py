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
LOWEST_LINE = 20.0  # Hz; below, a kart's own motion and its chassis
LINE_WINDOW = 0.5  # s over which the engine's speed changes evenly
SWEEPS = tuple(np.linspace(-120.0, 120.0, 25))  # Hz/s by which a line may rise; 120 is 7,200 rpm in a second
EDGE_BINS = 6  # at either end of the frequencies searched; 6 Hz
MARGIN = 1.35  # because the background, too, is an estimate, of which the least of many sweeps counts
LINE_CHANCE = 1e-3  # that noise alone makes such a peak in a window
BACKGROUND = 30.0  # Hz on either side of a line; the line itself is 8 Hz wide
LEAST_SHARE = 0.05  # of the windows; fifty times what chance gives. A line that sweeps fast is seen rarely
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
    """The strongest line in windows of LINE_WINDOW: t (W,) s, frequency (W,) Hz, is_seen (W,).

    amplitude (W, D) of the tone in each column, in the unit of that column.
    """

    t: Array
    frequency: Array
    amplitude: Array
    is_seen: BoolArray

    @property
    def is_there(self) -> bool:
        """Whether there is such a line in a good part of the recording."""
        return self.share >= LEAST_SHARE

    @property
    def share(self) -> float:
        """In which share of the windows a line is seen."""
        return float(np.mean(self.is_seen)) if self.is_seen.size else 0.0

    @property
    def why_none(self) -> str:
        """Say what is meant where there is no line, though windows may have one, and a weak one show in a spectrum."""
        seen = f"only {100.0 * self.share:.1f} %" if np.any(self.is_seen) else "none"
        where = f"in {seen} of the windows of {LINE_WINDOW:g} s one stands out"
        return f"no lasting line: {where}; a weak one shows in the spectrum"


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
    """Follow the strongest line above LOWEST_LINE through values (N, D), evenly sampled at `rate` Hz from t (N,).

    The columns (any units: each is divided by its own noise) are searched together. A window has a line when its
    highest peak over the background around it is one that white noise reaches once in a thousand windows.
    Raises FitError for too few samples.
    """
    size = round(LINE_WINDOW * rate)
    windows = len(values) // size if size else 0
    if windows < 1 or size < 16:
        raise FitError("the samples are too few or too slow to follow an engine's line")
    noise = np.median(np.abs(np.diff(values, 2, axis=0)), axis=0)
    noise = np.where(noise > 0.0, noise, 1.0)
    blocks = (np.asarray(values) / noise)[: windows * size].reshape(windows, size, -1)
    taper = get_window("hann", size)
    blocks = (blocks - blocks.mean(axis=1, keepdims=True)) * taper[:, None]
    freedom = 2 * blocks.shape[2]  # two quadratures on each axis
    best = _Peaks.none(windows, blocks.shape[2])
    for sweep in SWEEPS:
        best = best.or_better(_Peaks.of(blocks, sweep, rate, freedom))
    threshold = MARGIN * chi2.isf(LINE_CHANCE / (size * len(SWEEPS)), freedom)
    middle = t[0] + (np.arange(windows) + 0.5) * size / rate
    amplitude = noise * 2.0 * np.sqrt(best.height) / np.sum(taper)
    return EngineLine(middle, best.frequency, amplitude, (best.ratio > threshold) & ~best.is_at_edge)


@dataclass(frozen=True, eq=False)
class _Peaks:
    """The highest peak of each window (W,): ratio to the background around, power (W, D), frequency Hz, at an edge."""

    ratio: Array
    height: Array
    frequency: Array
    is_at_edge: BoolArray

    @staticmethod
    def none(windows: int, columns: int) -> "_Peaks":
        nothing = np.zeros(windows)
        return _Peaks(nothing, np.zeros((windows, columns)), nothing, np.zeros(windows, dtype=np.bool_))

    @staticmethod
    def of(blocks: Array, sweep: float, rate: float, freedom: int) -> "_Peaks":
        """Peaks of blocks (W, n, D) for a line whose frequency rises by `sweep` Hz/s through each window."""
        windows, size = blocks.shape[:2]
        time = (np.arange(size) - 0.5 * (size - 1)) / rate
        smoothed_speed = blocks * np.exp(-1j * np.pi * sweep * time**2)[:, None]
        padded = 2 * size  # so that a peak is met within a fraction of its width
        frequency = np.arange(padded // 2 + 1) * rate / padded
        inside = frequency >= min(LOWEST_LINE, 0.25 * rate)
        each = np.abs(np.fft.fft(smoothed_speed, padded, axis=1)[:, : len(inside)][:, inside]) ** 2
        power, frequency = np.sum(each, axis=2), frequency[inside]
        peak = np.argmax(power, axis=1)
        background = np.median(_around(power, peak, round(BACKGROUND * padded / rate)), axis=1) / chi2.median(freedom)
        height = each[np.arange(windows), peak]
        at_edge = (peak < EDGE_BINS) | (
            peak >= len(frequency) - EDGE_BINS
        )  # the slope of something slower, or folded over
        ratio = power[np.arange(windows), peak] / np.maximum(background, 1e-300)
        return _Peaks(ratio, height, frequency[peak], at_edge)

    def or_better(self, other: "_Peaks") -> "_Peaks":
        """The one of the two with the higher ratio, window by window."""
        mine = self.ratio >= other.ratio
        return _Peaks(
            np.where(mine, self.ratio, other.ratio),
            np.where(mine[:, None], self.height, other.height),
            np.where(mine, self.frequency, other.frequency),
            np.where(mine, self.is_at_edge, other.is_at_edge),
        )


def _around(power: Array, peak: IntArray, width: int) -> Array:
    """Power (W, 2 width + 1) in the bins around each peak (W,), so that a sloping spectrum makes no line."""
    bins = np.clip(peak[:, None] + np.arange(-width, width + 1), 0, power.shape[1] - 1)
    return np.take_along_axis(power, bins, axis=1)


def revolutions(frequency: float, rate: float) -> list[float]:
    """Engine speeds (rpm), ascending, whose shaking appears at `frequency` Hz when sampled at `rate` Hz."""
    folds = range(int(ENGINE_SPEEDS[1] / 60.0 / rate) + 2)
    real = {abs(fold * rate + sign * frequency) * 60.0 for fold in folds for sign in (-1.0, 1.0)}
    return sorted(rpm for rpm in real if ENGINE_SPEEDS[0] <= rpm <= ENGINE_SPEEDS[1])
