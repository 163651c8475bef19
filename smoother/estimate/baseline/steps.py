"""The clock of the baseline: inertial samples averaged into the steps of the Kalman filter, 50 a second by default.

The mean is the low-pass filter against the engine's vibration that the thesis proposes.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import islice

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray
from smoother.disc import pieces, release, roomy
from smoother.samples import ImuSamples, usual_steps

CHUNK = 65536  # rows


@dataclass(frozen=True, eq=False)
class Steps:
    """Means around the times t (P,) s of a clock that starts at `start`: step number k is `start + k * period`.

    Only steps that hold samples are listed; number (P,) may be negative, before the first fix. specific_force_s (P, 3)
    m/s^2, angular_rate_s (P, 3) rad/s, is_at_rest (P,): all samples of the step were.
    """

    start: float
    period: float
    number: IntArray
    specific_force_s: Array
    angular_rate_s: Array
    is_at_rest: BoolArray

    @property
    def t(self) -> Array:
        """Times of the steps, (P,) s."""
        return np.asarray(self.start + self.number * self.period)

    @property
    def interval(self) -> Array:
        """Time since the step before, (P,) s; one period for the first."""
        return np.diff(self.number, prepend=self.number[0] - 1) * self.period

    def on_clock(self, values: Array, count: int) -> Array:
        """Values (P, k) of the steps at the first `count` times of the clock (count, k), NaN where there are none."""
        out = np.full((count, *values.shape[1:]), np.nan)
        inside = (self.number >= 0) & (self.number < count)
        out[self.number[inside]] = values[inside]
        return out


def average_into_steps(imu: ImuSamples, is_at_rest: BoolArray, start: float, period: float) -> Steps:
    """Average the samples over each step, half a period to either side of its time.

    A sample holds the mean over the interval before its time, so it counts as of the middle of that interval.
    """
    number = _step_numbers(imu, start, period)
    first, size = int(number[0]), int(number[-1] - number[0]) + 1

    def total(values: Array | BoolArray) -> Array:
        """Sum (size,) of values (N,) over each step."""
        out = np.zeros(size)
        for part in pieces(len(values)):
            at = number[part] - first
            low = int(at.min())
            some = np.bincount(at - low, values[part])
            out[low : low + len(some)] += some
            release(number, values)
        return out

    count = total(np.broadcast_to(1.0, len(imu.t)))
    held = np.flatnonzero(count)

    def mean(values: Array) -> Array:
        out = roomy((len(held), values.shape[1]))
        for i, column in enumerate(values.T):
            out[:, i] = total(column)[held] / count[held]
        release(out)
        return out

    resting = total(is_at_rest)[held] == count[held]
    return Steps(start, period, first + held, mean(imu.specific_force_s), mean(imu.angular_rate_s), resting)


def _step_numbers(imu: ImuSamples, start: float, period: float) -> IntArray:
    """Number (N,) of the step that each sample belongs to, ascending."""
    t = imu.t
    number, usual = roomy(len(t), np.int64), imu.interval if len(t) > 1 else period
    for part in pieces(len(t)):
        before = t[part.start - 1] if part.start else t[0] - usual
        interval = np.diff(t[part], prepend=before)
        interval = np.minimum(interval, 2.0 * usual_steps(interval, usual))  # a gap is not part of a sample
        number[part] = np.rint((t[part] - 0.5 * interval - start) / period)
        release(number, t)
    return number


def collect(rows: Iterable[tuple[float, ...]], count: int, width: int) -> Array:
    """Array (count, width) of rows, filled in chunks that fit into memory."""
    out, source = roomy((count, width)), iter(rows)
    for part in pieces(count, CHUNK):
        out[part] = list(islice(source, CHUNK))
        release(out)
    return out


def nearest(times: Array, t: Array) -> IntArray:
    """Index (K,) of the one of `times` (P,) nearest to each t (K,)."""
    after = np.clip(np.searchsorted(times, t), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    return np.asarray(np.where(np.abs(times[before] - t) < np.abs(times[after] - t), before, after))
