import numpy as np
import pytest

from smoother.disc import pieces
from smoother.estimate.baseline import steps as module
from smoother.estimate.baseline.steps import CHUNK, average_into_steps, collect, nearest
from smoother.samples import ImuSamples


def ramp(t, interval):
    """A force equal to the time, each sample the mean over the interval before its stamp."""
    force = np.repeat((t - 0.5 * interval)[:, None], 3, axis=1)
    return ImuSamples(t, force, 2.0 * force)


@pytest.mark.parametrize("rate", [50.0, 100.0, 101.3, 200.0, 1000.0])
def test_a_step_holds_the_mean_of_the_samples_around_its_time(rate):
    t = np.arange(1, int(4.0 * rate)) / rate
    steps = average_into_steps(ramp(t, 1.0 / rate), np.zeros(t.size, dtype=bool), 1.0, 0.02)
    # a mean over samples that straddle the step unevenly is off by at most half a sample
    inner = slice(1, -1)  # the first and last step are filled in part
    np.testing.assert_allclose(steps.specific_force_s[inner, 0], steps.t[inner], atol=0.51 / rate)
    np.testing.assert_allclose(steps.angular_rate_s, 2.0 * steps.specific_force_s)
    np.testing.assert_allclose(np.mean(steps.specific_force_s[inner, 0] - steps.t[inner]), 0.0, atol=0.1 / rate)


def test_steps_reach_back_before_the_first_fix():
    t = np.arange(1, 400) / 100.0
    steps = average_into_steps(ramp(t, 0.01), np.zeros(t.size, dtype=bool), 2.0, 0.02)
    assert steps.number[0] == -100
    np.testing.assert_allclose(steps.t[0], 0.0, atol=1e-12)
    on_clock = steps.on_clock(steps.specific_force_s, 60)
    np.testing.assert_allclose(on_clock[:, 0], 2.0 + 0.02 * np.arange(60), atol=0.006)


def test_gaps_leave_steps_out_and_lengthen_the_interval():
    t = np.concatenate([np.arange(1, 101), np.arange(151, 251)]) / 100.0
    steps = average_into_steps(ramp(t, 0.01), np.zeros(t.size, dtype=bool), 0.0, 0.02)
    assert np.isnan(steps.on_clock(steps.specific_force_s, 125)[60, 0])
    assert abs(np.max(steps.interval) - 0.52) < 0.021
    np.testing.assert_allclose(np.sum(steps.interval), (steps.number[-1] - steps.number[0] + 1) * 0.02)


def test_a_step_is_at_rest_only_if_all_its_samples_are():
    t = np.arange(1, 101) / 100.0
    steps = average_into_steps(ramp(t, 0.01), t <= 0.5, 0.0, 0.02)
    assert np.all(steps.is_at_rest[steps.t < 0.48])
    assert not np.any(steps.is_at_rest[steps.t > 0.505])


def test_a_slow_imu_fills_only_some_steps():
    t = np.arange(1, 100) / 25.0
    steps = average_into_steps(ramp(t, 0.04), np.zeros(t.size, dtype=bool), 0.0, 0.02)
    assert len(steps.number) == 99
    np.testing.assert_array_equal(np.diff(steps.number), 2)


def test_a_long_recording_is_averaged_piece_by_piece_as_a_whole(monkeypatch):
    """Steps that two pieces have samples of, and the interval before the first sample of a piece, are those of all."""
    t = np.delete(np.arange(1, 1000), slice(400, 500)) / 130.0
    imu, is_at_rest = ramp(t, 1.0 / 130.0), t < 2.0
    whole = average_into_steps(imu, is_at_rest, 1.0, 0.02)
    monkeypatch.setattr(module, "pieces", lambda count: pieces(count, 37))
    parts = average_into_steps(imu, is_at_rest, 1.0, 0.02)
    np.testing.assert_array_equal(parts.number, whole.number)
    np.testing.assert_array_equal(parts.is_at_rest, whole.is_at_rest)
    np.testing.assert_allclose(parts.specific_force_s, whole.specific_force_s)
    np.testing.assert_allclose(parts.angular_rate_s, whole.angular_rate_s)


def test_collect_fills_in_chunks_and_in_order():
    count = CHUNK + 7
    rows = collect(((float(i), -float(i)) for i in range(count)), count, 2)
    np.testing.assert_array_equal(rows[:, 0], np.arange(count))
    np.testing.assert_array_equal(rows[:, 1], -np.arange(count))
    assert collect(iter(()), 0, 3).shape == (0, 3)


def test_nearest_takes_the_closer_neighbour_and_the_ends():
    times = np.array([0.0, 1.0, 3.0])
    np.testing.assert_array_equal(nearest(times, np.array([-5.0, 0.4, 0.6, 1.9, 2.1, 9.0])), [0, 0, 1, 1, 2, 2])
