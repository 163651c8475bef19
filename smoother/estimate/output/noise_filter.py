"""Accelerations and angular rates of the rows without the noise of the samples: a Wiener filter without phase.

At each frequency a share 1 - noise / power of a signal is kept, `noise` being the power of white noise of known
variance and `power` that of the signal, smoothed over SMOOTHED Hz. Source: Wiener 1949, of a spectrum that is estimated
(spectral subtraction).
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.running import running_mean

SMOOTHED = 0.8  # Hz; of 0.1 to 3.2 the one with the least errors of accelerations on simulated karts
BEYOND = 10.0  # s by which both ends are mirrored


def without_noise(values: Array, noise: Array, dt: float, falling: BoolArray) -> tuple[Array, Array]:
    """Return values (N, c), dt s apart, without white noise of variance `noise` (c,), and the variances (c,) left.

    falling (c,): signals of which there is the less the quicker they are, beyond where they are strongest. Of these the
    kept share never rises again: engines that the sampling folds do not pass for motion. (A kart bounces on its tyres.)
    """
    n = len(values)
    beyond = min(n - 1, round(BEYOND / dt))
    unit = 1 << max((n + 2 * beyond).bit_length() - 5, 0)  # a length of few factors is quick to transform
    mirrored = np.pad(values, ((beyond, beyond + -(n + 2 * beyond) % unit), (0, 0)), "reflect")
    spectrum = np.fft.rfft(mirrored, axis=0)
    width = 2 * max(1, round(0.5 * SMOOTHED * dt * len(mirrored)))
    power = running_mean(np.abs(spectrum) ** 2 / len(mirrored), width)
    share = np.maximum(1.0 - noise / np.maximum(power, 1e-300), 0.0)
    for i in np.flatnonzero(falling):
        beyond_peak = share[int(np.argmax(power[:, i])) :, i]
        np.minimum.accumulate(beyond_peak, out=beyond_peak)
    kept = np.fft.irfft(spectrum * share, len(mirrored), axis=0)[beyond : beyond + n]
    return kept, np.asarray(noise * share.mean(axis=0))
