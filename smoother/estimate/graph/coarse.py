"""First steps on few keyframes: the attitudes, which bend the problem, are brought near at a fraction of the cost.

Positions and velocities enter nearly linearly and one step finds them; attitudes that are off by degrees take several
steps, but what they are off by changes slowly. So the first steps are taken with few keyframes, one in EVERY or in
FOR_CONSTANTS, and what they moved is carried over to all keyframes. The constants stay: long intervals would draw them,
and with attitudes off by degrees steps of the constants lead astray.
"""

from dataclasses import replace

import numpy as np

from smoother import so3
from smoother.arrays import Array, IntArray
from smoother.estimate.graph.batch import Batch
from smoother.estimate.graph.imu import BinnedImu, DensePath, halved, motion_at
from smoother.estimate.graph.inputs import Noise
from smoother.estimate.graph.start import Start
from smoother.estimate.graph.state import ChainState

EVERY = 4  # keyframes; at 0.8 s a lap still has fifty of them
# keyframes, where constants are to be found next: after longer intervals much of the samples' noise is in the motion
# that their slopes are read off, and they overshoot by several sigmas (velocity_response most)
FOR_CONSTANTS = 2
FEWEST = 8  # coarse keyframes; a shorter session is not worth the detour
NEAR = 0.065  # rad, rms; about its square is what a Gauss-Newton step leaves of it, a quarter of a degree


def near_solution(start: Start, noise: Noise, iterations: int, every: int = EVERY) -> ChainState:
    """Return the keyframes of `start` near the solution for its constants, without a magnetometer.

    By at most `iterations` Gauss-Newton steps on one keyframe in `every`, until attitudes move by less than NEAR.
    """
    few = thinned(start, every)
    batch = Batch(few.data, few.binned, few.priors)
    state = batch.approach(batch.graph(few.state, noise), few.state, noise, NEAR, iterations)
    return state if few is start else along(carried(start.state, few.state, state), batch.path(state))


def thinned(start: Start, every: int) -> Start:
    """Return the start with one keyframe in `every`, without what is left at the end. Short ones stay as they are."""
    n = (len(start.state.t) - 1) // every
    if n < FEWEST:
        return start
    state = start.state.between(0, n * every + 1, every)
    data = replace(start.data, still=_wholly_still(start.data.still, n, every), heading=None)
    binned = _joined(start.binned, n, every, state.gyro_bias_s.mean(axis=0))
    return replace(start, state=state, data=data, binned=binned)


def _wholly_still(still: IntArray, n: int, every: int) -> IntArray:
    inside = still[still < n * every] // every
    return np.flatnonzero(np.bincount(inside, minlength=n) == every)


def _joined(binned: BinnedImu, n: int, every: int, gyro_bias: Array) -> BinnedImu:
    """Bins of n longer intervals, half as many as there were where their number is even."""
    n_bins = every * binned.n_bins
    joined = BinnedImu(
        binned.t[: n * every + 1 : every],
        binned.dt,
        binned.specific_force_s[: n * every].reshape(n, n_bins, 3),
        binned.angular_rate_s[: n * every].reshape(n, n_bins, 3),
        binned.missing[: n * every].reshape(n, every).mean(axis=1),
        None if binned.rough is None else binned.rough[: n * every].reshape(n, every, 2).mean(axis=1),
        None if binned.blind is None else binned.blind[: n * every].reshape(n, every, 2).max(axis=1),
    )
    return halved(joined, gyro_bias) if n_bins % 2 == 0 else joined


def along(state: ChainState, path: DensePath) -> ChainState:
    """Return `state` moved onto the path as far as it reaches: between few keyframes the samples say how it went.

    So that slopes by the constants, which are read off the motion, are right from the first step with all keyframes.
    """
    within = state.t <= path.t[-1]
    motion = motion_at(path, state.t[within])
    R_ns, position_n, velocity_n = state.R_ns.copy(), state.position_n.copy(), state.velocity_n.copy()
    R_ns[within], position_n[within], velocity_n[within] = motion.R_ns, motion.position_n, motion.velocity_n
    return replace(state, R_ns=R_ns, position_n=position_n, velocity_n=velocity_n)


def carried(state: ChainState, before: ChainState, after: ChainState) -> ChainState:
    """Return `state` moved by what moved `before` to `after`, a part of its keyframes: linearly between them."""

    def move(one: Array, two: Array) -> Array:
        change = two - one
        return np.stack([np.interp(state.t, before.t, change[:, i]) for i in range(change.shape[1])], axis=1)

    turn = so3.log(before.R_ns.transpose(0, 2, 1) @ after.R_ns)
    return replace(
        state,
        R_ns=state.R_ns @ so3.exp(move(np.zeros_like(turn), turn)),
        position_n=state.position_n + move(before.position_n, after.position_n),
        velocity_n=state.velocity_n + move(before.velocity_n, after.velocity_n),
        accel_bias_s=state.accel_bias_s + move(before.accel_bias_s, after.accel_bias_s),
        gyro_bias_s=state.gyro_bias_s + move(before.gyro_bias_s, after.gyro_bias_s),
        offset_n=state.offset_n + move(before.offset_n, after.offset_n),
        constants=after.constants,
    )
