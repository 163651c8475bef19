"""The stream against the batch on the same graph: a drive with latencies, a slow offset, a standstill and an outage."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.graph.batch import Batch, Solved
from smoother.estimate.graph.chain import NotPositiveDefiniteError
from smoother.estimate.graph.heading import Heading
from smoother.estimate.graph.imu import BinnedImu, bin_imu
from smoother.estimate.graph.incremental import IncrementalOptions, Stream, solve_as_stream, solve_incrementally
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.inputs import Data, Noise, Priors
from smoother.estimate.graph.state import CONSTANTS_SIZE, ChainState, Constants
from smoother.frames import GRAVITY_N
from smoother.samples import ImuSamples

T, RATE, N_BINS = 0.2, 200.0, 10
CONSTANTS = Constants(0.13, 0.21, np.array([0.3, -0.2, 0.4]), 0.1, np.array([0.02, -0.01, 0.0]))
FROZEN = 1e-7  # sigma of the constants, with which the batch solves what the stream does: the constants are known
GYRO_BIAS = np.array([0.01, 0.02, -0.015])
FIELD_N = np.array([1.0, 0.0, -2.0])
OUTAGE = (20.0, 26.0)


@dataclass(frozen=True, eq=False)
class Drive:
    """What both solvers get, and what the batch makes of it."""

    data: Data
    binned: BinnedImu
    priors: Priors
    noise: Noise
    start: ChainState
    batch: Batch
    solved: Solved

    def stream(self) -> ChainState:
        return solve_incrementally(self.data, self.binned, self.priors, self.noise, self.start, CONSTANTS)

    def ended(self) -> Solved:
        d = self
        return solve_as_stream(d.batch, d.data, d.binned, d.priors, d.noise, d.start, CONSTANTS)


@cache
def drive(outlier: float = 0.0, duration: float = 40.0) -> Drive:
    """A standstill of 3 s, then bends, from a wrong yaw; fixes at 5 Hz but for an outage, one `outlier` m off."""
    rng = np.random.default_rng(5)
    t = np.arange(1, round((duration + 1.0) * RATE) + 1) / RATE
    moving = np.clip((t - 3.0) / 0.5, 0.0, 1.0)
    turn = 0.8 * moving * np.sin(0.7 * t)
    yaw = np.cumsum(turn) / RATE
    speed = moving * (10.0 + 3.0 * np.sin(0.5 * t))
    v = np.stack([speed * np.cos(yaw), speed * np.sin(yaw), np.zeros_like(t)], axis=1)
    p = np.cumsum(v, axis=0) / RATE
    R_ns = so3.exp(np.stack([0.0 * yaw, 0.0 * yaw, yaw], axis=1)) @ so3.exp(np.array([0.2, -0.4, 2.0]))
    rate_n = np.stack([0.0 * turn, 0.0 * turn, turn], axis=1)
    noise = Noise(
        InertialNoise(0.1, 0.01, 0.003, 1e-4),
        np.full(3, 0.2),
        np.full(3, 0.15),
        np.array([2.0, 2.0, 3.0]),
        60.0,
        np.full(3, FROZEN),
    )
    force = np.einsum("nji,nj->ni", R_ns, np.gradient(v, t, axis=0) - GRAVITY_N) + np.array([0.2, -0.1, 0.15])
    rate = np.einsum("nji,nj->ni", R_ns, rate_n) + GYRO_BIAS
    force += noise.inertial.accel * np.sqrt(RATE) * rng.normal(size=force.shape)
    rate += noise.inertial.gyro * np.sqrt(RATE) * rng.normal(size=rate.shape)
    keyframes = 0.1 + T * np.arange(round(duration / T) + 1)
    i = np.searchsorted(t, keyframes - 1e-9)
    stamps = np.arange(0.5, duration, 0.2)
    stamps = stamps[(stamps < OUTAGE[0]) | (stamps > OUTAGE[1])]
    arm_n, swing_n = R_ns @ CONSTANTS.lever_arm_s, np.cross(rate_n, R_ns @ CONSTANTS.lever_arm_s)
    at, late = (np.searchsorted(t, stamps - latency) for latency in (0.13, 0.21))
    position = (p + arm_n)[at] + np.array([1.5, -2.0, 2.0]) + 0.2 * rng.normal(size=(len(at), 3))
    velocity = (v + swing_n)[late] + CONSTANTS.doppler_bias_n + 0.15 * rng.normal(size=(len(at), 3))
    position[50, :2] += outlier
    velocity[::7, 2] = np.nan
    looks = np.arange(0, len(keyframes) - 1, 5)
    field_s = np.einsum("kji,j->ki", R_ns[i[looks]] @ so3.exp(0.02 * rng.normal(size=(len(looks), 3))), FIELD_N)
    n_fixes = len(stamps)
    data = Data(
        stamps,
        position,
        velocity,
        np.ones(n_fixes),
        np.ones(n_fixes),
        np.arange(0, 13),
        heading=Heading(looks, field_s, -CONSTANTS.heading_offset, 0.05, 1.0),
    )
    wrong = so3.exp(np.array([0.02, 0.03, 0.3]))
    zeros = np.zeros((len(keyframes), 3))
    start = ChainState(
        keyframes, wrong @ R_ns[i], p[i], v[i], zeros, np.tile(GYRO_BIAS + 0.005, (len(keyframes), 1)), zeros, CONSTANTS
    )
    binned = bin_imu(ImuSamples(t, force, rate), keyframes, N_BINS, np.zeros(3), np.zeros(3))
    priors = Priors(0.5, 0.05, GYRO_BIAS, CONSTANTS.as_vector(), np.full(CONSTANTS_SIZE, FROZEN))
    batch = Batch(data, binned, priors)
    state = batch.converge(batch.graph(start, noise), start, noise, 10)
    for _ in range(4):
        solved = batch.step(batch.graph(state, noise), state, noise)
        state = solved.state
    return Drive(data, binned, priors, noise, start, batch, solved)


def distance(state: ChainState, solved: Solved) -> np.ndarray:
    """Difference (K, 18) to the batch, in its sigmas."""
    ours, theirs = state, solved.state
    R_sn = theirs.R_ns.transpose(0, 2, 1)
    difference = np.concatenate(
        [
            so3.log(R_sn @ ours.R_ns),
            np.einsum("kij,kj->ki", R_sn, ours.position_n - theirs.position_n),
            ours.velocity_n - theirs.velocity_n,
            ours.accel_bias_s - theirs.accel_bias_s,
            ours.gyro_bias_s - theirs.gyro_bias_s,
            ours.offset_n - theirs.offset_n,
        ],
        axis=1,
    )
    return np.abs(difference) / np.sqrt(np.einsum("kii->ki", solved.solution.covariance))


@pytest.mark.parametrize("outlier", [0.0, 30.0])
def test_the_stream_ends_where_the_batch_does(outlier: float) -> None:
    d = drive(outlier)
    assert distance(d.ended().state, d.solved).max() < 0.1  # of a sigma: nothing that anyone can see


def test_before_the_step_at_its_end_it_is_close_already() -> None:
    d = drive()
    apart = distance(d.stream(), d.solved)
    assert np.sqrt(np.mean(apart**2)) < 0.5


def test_the_newest_estimate_uses_nothing_that_comes_later() -> None:
    d = drive()
    later = d.data.t > 21.0
    changed = replace(d.data, position_n=np.where(later[:, None], 1e3, d.data.position_n))
    states = []
    for data in (d.data, changed):
        stream = Stream(data, d.binned, d.priors, d.noise, d.start, CONSTANTS, IncrementalOptions())
        for end in stream.chunk_ends():
            if end > 100:
                break
            stream.advance(end)
        states.append(stream.finish())
    assert len(states[0].t) == 100
    np.testing.assert_array_equal(states[0].position_n, states[1].position_n)


def test_of_the_first_guess_only_the_first_keyframe_counts() -> None:
    d = drive()
    start = replace(d.start, position_n=np.concatenate([d.start.position_n[:1], 1e3 + d.start.position_n[1:]]))
    state = solve_incrementally(d.data, d.binned, d.priors, d.noise, start, CONSTANTS)
    np.testing.assert_array_equal(state.position_n, d.stream().position_n)
    np.testing.assert_array_equal(start.position_n[1:], 1e3 + d.start.position_n[1:])  # the argument is left alone


def test_it_comes_with_the_covariances_of_the_batch() -> None:
    d = drive()
    solved = d.ended()
    np.testing.assert_allclose(
        np.einsum("kii->ki", solved.solution.covariance), np.einsum("kii->ki", d.solved.solution.covariance), rtol=0.02
    )
    assert set(solved.rows) == set(d.solved.rows)
    assert distance(solved.state, d.solved).max() < 0.1


def test_the_first_chunk_holds_three_fixes_however_rare_they_are() -> None:
    d = drive()
    rare = replace(
        d.data, position_n=np.where((np.arange(len(d.data.t)) % 20 == 0)[:, None], d.data.position_n, np.nan)
    )
    ends = Stream(rare, d.binned, d.priors, d.noise, d.start, CONSTANTS, IncrementalOptions()).chunk_ends()
    third = rare.t[40] - CONSTANTS.position_latency
    assert d.start.t[ends[0] - 2] <= third <= d.start.t[ends[0] - 1]
    assert ends[-1] == len(d.start.t)
    assert np.all(np.diff(ends)[:-1] == 25)


def test_measurements_that_are_not_numbers_are_refused() -> None:
    d = drive()
    broken = replace(d.binned, specific_force_s=np.full_like(d.binned.specific_force_s, np.nan))
    with pytest.raises(NotPositiveDefiniteError):
        solve_incrementally(d.data, broken, d.priors, d.noise, d.start, CONSTANTS)
