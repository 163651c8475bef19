"""The motion that slopes by constants are made of: the keyframes' velocity and heading, low-passed.

A latency, a lever arm and a receiver's response multiply the acceleration and the turn rate of the kart. Taken from the
state as it is, these hold the noise of the samples, which is in the residuals too: the fit makes the constant small to
make the noise small, by several of its sigmas (errors in variables; Fuller 1987, Measurement Error Models). Below a
frequency that drivers reach and the noise does not fill, the state is the motion. So Jacobians by constants are no
derivatives of the residual: they are those of the low-passed motion. This is the one place where that is so.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.signal import butter, sosfiltfilt

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.model.state import State

ORDER = 2  # of the Butterworth filter, which runs forwards and backwards: no delay
# Hz, of samples as noisy as m/s^2/sqrt(Hz): what a kart does above it is weaker than the noise. Its accelerations fall
# with about the fifth power of the frequency; real karts' samples have 0.5 to 0.9, and are served best by 1 to 1.2 Hz
CUTOFF, AT_DENSITY, SLOWEST, QUICKEST, POWER = 1.5, 0.3, 1.0, 1.5, 5.0
FEWEST = 30  # keyframes that the filter needs for its ends


@dataclass(frozen=True, eq=False)
class Motion:
    """velocity_n, acceleration_n, jerk_n (N, 3), m and s in n; turn_rate (N,) rad/s about up."""

    velocity_n: Array
    acceleration_n: Array
    jerk_n: Array
    turn_rate: Array


def cutoff_for(accel: float) -> float:
    """Frequency, Hz, below which the motion of a session is more than the noise of its force, m/s^2/sqrt(Hz)."""
    return float(np.clip(CUTOFF * (accel / AT_DENSITY) ** (-2.0 / POWER), SLOWEST, QUICKEST))


class LowPassedMotion:
    """Cubic splines through the velocities and the heading of the keyframes of a state, below `cutoff` Hz."""

    def __init__(self, state: State, cutoff: float) -> None:
        turn = so3.log(state.R_ns[:-1].transpose(0, 2, 1) @ state.R_ns[1:])
        about_up = np.einsum("kj,kj->k", state.R_ns[:-1, 2, :], turn)
        values = np.column_stack([state.velocity_n, np.concatenate([[0.0], np.cumsum(about_up)])])
        share = 2.0 * cutoff * state.interval  # of the Nyquist frequency
        if share < 0.95 and len(values) > FEWEST:
            values = sosfiltfilt(butter(ORDER, share, output="sos"), values, axis=0)
        self._span = float(state.t[0]), float(state.t[-1])
        self._values: BSpline = make_interp_spline(state.t, values, min(3, len(values) - 1))
        self._slope, self._bend = self._values.derivative(), self._values.derivative(2)

    def at(self, t: Array) -> Motion:
        """Motion at t (N,) s, beyond the ends that at the ends."""
        t = np.clip(t, *self._span)
        slope = self._slope(t)
        return Motion(self._values(t)[:, :3], slope[:, :3], self._bend(t)[:, :3], slope[:, 3])
