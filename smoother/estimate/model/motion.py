"""The filtered motion for Jacobians by constants: velocity and heading of the keyframes without the noise of samples.

A latency, a lever arm and a receiver's response multiply the acceleration and the turn rate of the kart. Those of the
state contain the noise of the samples, as the residuals do, which biases the constant towards zero by several sigmas
(errors in variables; Carroll et al. 2006, Measurement Error in Nonlinear Models). So velocities are low-passed below a
cut-off at which the motion exceeds the noise of the force; headings pass a Wiener filter designed by the noise of the
gyroscope. Jacobians by constants use this motion, so only here a Jacobian is not the derivative of the residual.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.model.state import State
from smoother.fit.running import running_mean

Spectrum = npt.NDArray[np.complex128]

# cut-off Hz at a density m/s^2/sqrt(Hz) of noise, its limits, and the power of frequency with which the spectrum of
# accelerations falls; real karts have 0.5 to 0.9 m/s^2/sqrt(Hz), and the best cut-off is 1 to 1.2 Hz
CUTOFF, AT_DENSITY, SLOWEST, QUICKEST, POWER = 1.5, 0.3, 1.0, 1.5, 5.0
SMOOTHED = 0.4  # Hz over which power is averaged
BEYOND = 10.0  # s by which both ends are mirrored
EVEN = 64  # keyframes; Fourier transforms of other lengths than its multiples can take ten times as long
FINER = 4  # times the rate of the keyframes
HEADED = 2.0  # m/s; below, the course is that between the times at which the kart last and next was faster


@dataclass(frozen=True, eq=False)
class Motion:
    """velocity_n, acceleration_n, jerk_n (N, 3), m and s in n; turn_rate (N,) rad/s about up."""

    velocity_n: Array
    acceleration_n: Array
    jerk_n: Array
    turn_rate: Array


class LowPassedMotion:
    """The velocities and the heading of the keyframes of a state without the noise of the samples, and linear filters
    of them.

    accel m/s^2/sqrt(Hz), gyro rad/s/sqrt(Hz): densities of that noise. Made of spectra: exact between keyframes too, up
    to the linear interpolation of a FINER grid.
    """

    def __init__(self, state: State, accel: float, gyro: float) -> None:
        values = np.column_stack([state.velocity_n, course_of(state) if state.geometry.is_steered else _heading(state)])
        n = len(values)
        beyond = min(n - 1, round(BEYOND / state.interval))
        behind = beyond + -(n + 2 * beyond) % EVEN
        values = np.pad(values, ((beyond, behind), (0, 0)), "reflect", reflect_type="odd")
        slope = (values[-1] - values[0]) / (len(values) - 1)
        line = values[0] + np.arange(len(values))[:, None] * slope  # what is left of the values can be periodic
        frequency = np.fft.rfftfreq(len(values), state.interval)[:, None]
        self._s: Spectrum = np.asarray(2j * np.pi * frequency, dtype=np.complex128)
        spectrum = np.fft.rfft(values - line, axis=0)
        width = 2 * max(1, round(0.5 * SMOOTHED * state.interval * len(values)))
        power = running_mean(np.abs(spectrum[:, 3:] * self._s) ** 2 / len(values), width)[:, 0]
        level = 1.0 / (1.0 + (frequency[:, 0] / _cutoff(accel)) ** 4)  # a Butterworth filter without phase
        turning = level * _share(power, gyro**2 / state.interval)
        self._spectrum = spectrum * np.column_stack([level, level, level, turning])
        self._count, self._inside = len(values), slice(beyond * FINER, (beyond + n - 1) * FINER + 1)
        self._start, self._step = float(state.t[0]), state.interval / FINER
        even = line[0] + np.arange(self._inside.start, self._inside.stop)[:, None] / FINER * slope
        self._values = np.column_stack(
            [self._passed(1.0) + even, self._passed(self._s) + slope / state.interval, self._passed(self._s**2)]
        )

    def at(self, t: Array) -> Motion:
        """Motion at t (N,) s, beyond the ends that at the ends."""
        x = self._at(self._values, t)
        return Motion(x[:, :3], x[:, 4:7], x[:, 8:11], x[:, 7])

    def filtered(self, transfers: Callable[[Spectrum], Sequence[Spectrum]], t: Array) -> list[Array]:
        """The velocity behind filters that pass nothing constant, at t (N,) s, each (N, 3). transfers: by 2 pi i Hz."""
        return [self._at(self._passed(transfer)[:, :3], t) for transfer in transfers(self._s)]

    def _passed(self, transfer: Spectrum | float) -> Array:
        of = self._spectrum * transfer
        return np.asarray(FINER * np.fft.irfft(of, FINER * self._count, axis=0)[self._inside])

    def _at(self, of_grid: Array, t: Array) -> Array:
        u = np.clip((t - self._start) / self._step, 0.0, len(of_grid) - 1)
        k = np.minimum(u.astype(np.int64), len(of_grid) - 2)
        share = (u - k)[:, None]
        return np.asarray((1.0 - share) * of_grid[k] + share * of_grid[k + 1])


def _heading(state: State) -> Array:
    """Heading (K,) rad beyond that of the first keyframe."""
    turn = so3.log(state.R_ns[:-1].transpose(0, 2, 1) @ state.R_ns[1:])
    return np.concatenate([[0.0], np.cumsum(np.einsum("kj,kj->k", state.R_ns[:-1, 2, :], turn))])


def course_of(state: State) -> Array:
    """Course (K,) rad of the keyframes, anticlockwise from north, continuous."""
    velocity_n = state.velocity_n
    fast = np.flatnonzero(np.hypot(velocity_n[:, 0], velocity_n[:, 1]) > HEADED)
    if not len(fast):
        return np.zeros(len(velocity_n))
    course = np.unwrap(np.arctan2(velocity_n[fast, 1], velocity_n[fast, 0]))
    return np.asarray(np.interp(np.arange(len(velocity_n)), fast, course))


def _cutoff(accel: float) -> float:
    """Frequency, Hz, below which the motion of a session is more than the noise of its force, m/s^2/sqrt(Hz)."""
    return float(np.clip(CUTOFF * (accel / AT_DENSITY) ** (-2.0 / POWER), SLOWEST, QUICKEST))


def _share(power: Array, noise: float) -> Array:
    """Share of a signal's power (F,) that is motion, falling beyond its peak."""
    share = np.maximum(1.0 - noise / np.maximum(power, 1e-300), 0.0)
    peak = int(np.argmax(power))
    share[:peak] = 1.0
    share[peak:] = np.minimum.accumulate(share[peak:])
    return np.asarray(share)
