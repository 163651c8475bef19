"""First steps on few keyframes: what they find is carried to all of them, and nothing is lost on the way."""

from dataclasses import replace

import numpy as np
import pytest

from smoother import so3
from smoother.estimate.graph.batch import Batch
from smoother.estimate.graph.coarse import EVERY, carried, near_solution, thinned
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.parts import stretch
from smoother.estimate.graph.start import Start, make_start
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

OPTIONS = GraphOptions()
YAW = so3.exp(np.array([[0.0, 0.0, 12.0 * DEG]]))[0]


@pytest.fixture(scope="module")
def start() -> Start:
    return make_start(prepare(simulate_preset("kart", 5, duration=100.0).raw), OPTIONS)


def test_attitudes_that_are_off_by_degrees_come_where_good_ones_come(start: Start) -> None:
    off = replace(start, state=replace(start.state, R_ns=YAW @ start.state.R_ns))
    near, expected = (near_solution(s, start.noise, OPTIONS.approaches) for s in (off, start))
    turn = so3.log(near.R_ns.transpose(0, 2, 1) @ expected.R_ns)
    assert np.max(np.abs(turn)) < 1.0 * DEG
    assert near.t is off.state.t
    np.testing.assert_array_equal(near.constants.as_vector(), off.state.constants.as_vector())


def test_fewer_keyframes_hold_the_same_samples(start: Start) -> None:
    few = thinned(start, EVERY)
    np.testing.assert_array_equal(few.state.t, start.state.t[: (len(few.state.t) - 1) * EVERY + 1 : EVERY])
    assert few.binned.specific_force_s.shape[0] == len(few.state.t) - 1
    span = few.binned.n_bins * few.binned.dt
    assert span == pytest.approx(EVERY * start.binned.n_bins * start.binned.dt)
    whole = start.binned.angular_rate_s[: EVERY * len(few.binned.missing)].mean(axis=(0, 1))
    # joining two bins adds the turn of one in the other's axes, far below what a gyro tells
    np.testing.assert_allclose(few.binned.angular_rate_s.mean(axis=(0, 1)), whole, atol=2e-3)


def test_a_long_interval_stands_still_only_where_all_its_parts_do(start: Start) -> None:
    still = np.array([0, 1, 2, 3, 4, 5, 6, 9, 10, 11, 12, 13, 14, 15])
    few = thinned(replace(start, data=replace(start.data, still=still)), 4)
    np.testing.assert_array_equal(few.data.still, [0, 3])


def test_a_session_of_seconds_keeps_its_keyframes(start: Start) -> None:
    state = start.state
    short = replace(start, state=replace(state, t=state.t[:20]))
    assert thinned(short, EVERY) is short


def test_what_moved_few_keyframes_moves_all_linearly_between_them(start: Start) -> None:
    n = (len(start.state.t) - 2) // EVERY
    state = stretch(start, 0, n * EVERY + 1).state  # one more than the last of the few
    few, t = thinned(stretch(start, 0, n * EVERY + 1), EVERY).state, state.t
    growing = np.stack([0.01 * few.t, -0.02 * few.t, 0.0 * few.t], axis=1)
    after = replace(few, position_n=few.position_n + growing, R_ns=few.R_ns @ so3.exp(0.1 * growing))
    moved = carried(state, few, after)
    within = t <= few.t[-1]
    expected = np.stack([0.01 * t, -0.02 * t, 0.0 * t], axis=1)[within]
    np.testing.assert_allclose((moved.position_n - state.position_n)[within], expected, atol=1e-9)
    turn = so3.log(state.R_ns.transpose(0, 2, 1) @ moved.R_ns)[within]
    np.testing.assert_allclose(turn, 0.1 * expected, atol=1e-9)
    # beyond the last of them there is nothing to go by but the last
    np.testing.assert_allclose((moved.position_n - state.position_n)[~within], growing[-1:], atol=1e-9, rtol=0)


def test_between_few_keyframes_the_samples_say_how_it_went(start: Start) -> None:
    """Carried over linearly the velocity would be 0.2 m/s off, more than that of a fix."""
    near = near_solution(start, start.noise, OPTIONS.approaches)
    batch = Batch(start.data, start.binned, start.priors)
    all_of_them = batch.approach(batch.graph(near, start.noise), near, start.noise, 1e-3, OPTIONS.approaches)
    driving = slice(round(10.0 / near.interval), -2 * EVERY)
    assert np.std((near.velocity_n - all_of_them.velocity_n)[driving, :2]) < 0.5 * 0.15
