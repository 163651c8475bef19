"""Single inertial samples that neither a kart nor a sensor makes: bits that flipped on a wire, a register half read.

A hit on a kerb rings on in the samples behind it and on the other axes, vibration is as large before as after, and a
value that is clipped stands among large ones. What is replaced here sticks out alone, far, and from quiet neighbours.
"""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, IntArray, median
from smoother.disc import pieces, release, roomy
from smoother.samples import SENSOR_AXES, Problem, RawImu
from smoother.words import counted

LONGEST_SPIKE = 3  # samples; more can be a motion
LEAST_FORCE = 60.0  # m/s^2 beyond both neighbours; recorded karts have 9, harsh simulated vibration 41
LEAST_RATE = 8.0  # rad/s; recorded karts have 4
# Of a sensor that is hardly shaken, and quick enough for a knock to be more than one sample, less sticks out as far: so
# many usual steps (see below), and so much. Recorded cars and karts, and simulated ones on kerbs, have no such spike of
# even three usual steps
CALM_STEPS, CALM, CALM_PERIOD = 8.0, 1.0 / 6.0, 0.02  # steps, of what is least, s
USUAL_STEPS = 4.0  # times the step between samples that 99 % stay below; of vibration the largest spike has 1.6
USUAL_SHARE = 99.0  # percent
ENOUGH_STEPS = 20_000
QUIET_ROWS = 4  # on either side, no step of which, on any axis, is more than ...
QUIET_SHARE = 0.25  # ... of the spike: what rings on does not lose as much in one period of a sensor
MOST_SPIKES = 0.05  # share of the samples; if there are more, they are not single flaws of a good recording


def without_spikes(imu: RawImu, file: str, problems: list[Problem]) -> RawImu:
    """Replace single values between which a line fits far better, and say so; `imu` itself where there are none."""
    calm = CALM if len(imu.t) > 1 and median(np.diff(imu.t[:ENOUGH_STEPS])) <= CALM_PERIOD else 1.0
    accel, of_accel = _repaired(imu.accel, LEAST_FORCE / imu.accel_scale, calm)
    gyro, of_gyro = _repaired(imu.gyro, LEAST_RATE / imu.gyro_scale, calm)
    if (count := of_accel + of_gyro) == 0:
        return imu
    text = f"{file}: {counted(count, 'value')} of single samples far from those around, which no motion makes; bridged"
    problems.append(Problem("imu_spikes", text, count))
    return replace(imu, accel=accel, gyro=gyro)


def _repaired(values: Array, least: float, calm: float) -> tuple[Array, int]:
    """Samples (N, 3) without their spikes of more than `least`, or `calm` times that where they are hardly shaken, and
    how many values those were."""
    spikes = _spikes(values, least, calm)
    count = sum(int(length.sum()) for _, length in spikes)
    return (_bridged(values, spikes), count) if 0 < count <= MOST_SPIKES * len(values) else (values, 0)


Spikes = list[tuple[IntArray, IntArray]]  # of each axis the first rows of its spikes (K,), and their lengths (K,)


def _spikes(values: Array, least: float, calm: float) -> Spikes:
    """The spikes of samples (N, 3), see :func:`_repaired`; a day is looked at bit by bit."""
    margin = QUIET_ROWS + LONGEST_SPIKE + 1
    found: list[list[tuple[IntArray, IntArray]]] = [[] for _ in range(SENSOR_AXES)]
    for part in pieces(len(values)):
        begin = max(0, part.start - margin)
        block = values[begin : part.stop + margin]
        for axis in range(SENSOR_AXES):
            first, length = _spikes_of_axis(block, axis, least, calm)
            own = (first + begin >= part.start) & (first + begin < part.stop)
            found[axis].append((first[own] + begin, length[own]))
        release(values)
    return [(np.concatenate([f for f, _ in axis]), np.concatenate([n for _, n in axis])) for axis in found]


def _spikes_of_axis(values: Array, axis: int, least: float, calm: float) -> tuple[IntArray, IntArray]:
    none = np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    x = values[:, axis]
    if x.size < LONGEST_SPIKE or x.max() - x.min() <= calm * least:
        return none
    step = np.abs(np.diff(x))
    usual = float(np.percentile(step[:: max(1, step.size // ENOUGH_STEPS)], USUAL_SHARE))
    least = max(USUAL_STEPS * usual, min(least, max(calm * least, CALM_STEPS * usual)))
    starts = np.flatnonzero(step > least) + 1
    return _lone(values, axis, starts, least) if starts.size else none


def _lone(values: Array, axis: int, starts: IntArray, least: float) -> tuple[IntArray, IntArray]:
    """Those of the rows `starts` (K,) where a spike begins, and the lengths of the spikes."""
    x, firsts, lengths = values[:, axis], [], []
    for length in range(1, LONGEST_SPIKE + 1):
        starts = starts[starts + length < x.size]
        before, after = x[starts - 1], x[starts + length]
        low, high = np.minimum(before, after), np.maximum(before, after)
        inside = x[starts[:, None] + np.arange(length)].T
        beyond = np.min(np.maximum(inside - high, low - inside), axis=0)
        is_spike = (beyond > least) & (_unrest(values, starts, length) < QUIET_SHARE * beyond)
        firsts.append(starts[is_spike])
        lengths.append(np.full(np.count_nonzero(is_spike), length))
        starts = starts[~is_spike]
    return np.concatenate(firsts), np.concatenate(lengths)


def _unrest(values: Array, starts: IntArray, length: int) -> Array:
    """Largest step (K,) on any axis between the rows before and between those behind each of the rows `starts` (K,)."""
    sides = (np.arange(-QUIET_ROWS - 1, 0), np.arange(length, length + QUIET_ROWS + 1))
    rows = [np.clip(starts[:, None] + side, 0, len(values) - 1) for side in sides]
    largest = [np.max(np.abs(np.diff(values[row], axis=1)), axis=(1, 2), initial=0.0) for row in rows]
    return np.asarray(np.maximum(*largest))


def _bridged(values: Array, spikes: Spikes) -> Array:
    """A read-only copy of samples (N, 3) with a line across each spike."""
    out = roomy(values.shape)
    for part in pieces(len(values)):
        out[part] = values[part]
        release(out, values)
    for axis, (first, length) in enumerate(spikes):
        for k in range(LONGEST_SPIKE):
            at, room = first[length > k], length[length > k]
            before, after = values[at - 1, axis], values[at + room, axis]
            out[at + k, axis] = before + (after - before) * (k + 1) / (room + 1)
    out.flags.writeable = False
    return out
