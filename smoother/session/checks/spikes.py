"""Single inertial samples that neither a kart nor a sensor makes: bits that flipped on a wire, a register half read.

A hit on a kerb rings on in the samples behind it and on the other axes, vibration is as large before as after, and a
value that is clipped stands among large ones. What is left out here sticks out alone, far, and from quiet neighbours.
"""

import numpy as np

from smoother.arrays import Array, IntArray, median
from smoother.disc import pieces, release
from smoother.session.checks.table import Finding
from smoother.session.recorded import Recording
from smoother.words import counted

LONGEST_SPIKE = 3  # samples; more can be a motion
LEAST_FORCE = 60.0  # m/s^2 beyond both neighbours; recorded karts have 9, harsh simulated vibration 41
LEAST_RATE = 8.0  # rad/s; recorded karts have 4
# Of a sensor that is hardly shaken, and quick enough for a knock to be more than one sample, less sticks out as far: so
# many usual steps (see below), and so much. Recorded cars and karts have no such spike of even three usual steps
CALM_STEPS, CALM, CALM_PERIOD = 8.0, 1.0 / 6.0, 0.02  # steps, of what is least, s
USUAL_STEPS = 4.0  # times the step between samples that 99 % stay below; of vibration the largest spike has 1.6
USUAL_SHARE = 99.0  # percent
ENOUGH_STEPS = 20_000
QUIET_ROWS = 4  # on either side, no step of which, on any axis, is more than ...
QUIET_SHARE = 0.25  # ... of the spike: what rings on does not lose as much in one period of a sensor
MOST_SPIKES = 0.05  # share of the samples; if there are more, they are not single flaws of a good recording


def spikes(r: Recording) -> Finding | None:
    """Samples of which a value sticks out."""
    imu, bad = r.samples, np.zeros(len(r.samples.t), dtype=np.bool_)
    calm = CALM if len(imu.t) > 1 and median(np.diff(imu.t[:ENOUGH_STEPS])) <= CALM_PERIOD else 1.0
    margin = QUIET_ROWS + LONGEST_SPIKE + 1
    for values, least in ((imu.accel, LEAST_FORCE / imu.accel_scale), (imu.gyro, LEAST_RATE / imu.gyro_scale)):
        for part in pieces(len(values)):  # a day is looked at bit by bit
            begin = max(0, part.start - margin)
            block = values[begin : part.stop + margin]
            for axis in range(values.shape[1]):
                rows = begin + _spikes_of_axis(block, axis, least, calm)
                bad[rows[(rows >= part.start) & (rows < part.stop)]] = True
            release(values)
    count = int(np.count_nonzero(bad))
    if not 0 < count <= MOST_SPIKES * bad.size:
        return None
    text = f"{counted(count, 'sample')} with a value far from those around, which no motion makes; left out"
    return Finding(text, count, drop=bad)


def _spikes_of_axis(values: Array, axis: int, least: float, calm: float) -> IntArray:
    """Rows of the spikes on one axis of samples (N, 3), beyond `least`, or less of a sensor that is hardly shaken."""
    x = values[:, axis]
    if x.size < LONGEST_SPIKE or x.max() - x.min() <= calm * least:
        return np.empty(0, dtype=np.int64)
    step = np.abs(np.diff(x))
    usual = float(np.percentile(step[:: max(1, step.size // ENOUGH_STEPS)], USUAL_SHARE))
    least = max(USUAL_STEPS * usual, min(least, max(calm * least, CALM_STEPS * usual)))
    starts, found = np.flatnonzero(step > least) + 1, []
    for length in range(1, LONGEST_SPIKE + 1):
        starts = starts[starts + length < x.size]
        before, after = x[starts - 1], x[starts + length]
        inside = x[starts[:, None] + np.arange(length)].T
        beyond = np.min(np.maximum(inside - np.maximum(before, after), np.minimum(before, after) - inside), axis=0)
        is_spike = (beyond > least) & (_unrest(values, starts, length) < QUIET_SHARE * beyond)
        found.append((starts[is_spike, None] + np.arange(length)).ravel())
        starts = starts[~is_spike]
    return np.concatenate(found)


def _unrest(values: Array, starts: IntArray, length: int) -> Array:
    """Largest step (K,) on any axis between the rows before and between those behind each of the rows `starts` (K,)."""
    sides = (np.arange(-QUIET_ROWS - 1, 0), np.arange(length, length + QUIET_ROWS + 1))
    rows = [np.clip(starts[:, None] + side, 0, len(values) - 1) for side in sides]
    largest = [np.max(np.abs(np.diff(values[row], axis=1)), axis=(1, 2), initial=0.0) for row in rows]
    return np.asarray(np.maximum(*largest))
