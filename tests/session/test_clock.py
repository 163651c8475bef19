"""The time base: jitter goes, gaps stay, drift is followed, and what is even or irregular is left alone."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smoother.session import clock
from smoother.session.clock import TimeBase, describe_time_base, find_gaps, regularize, true_fix_times

RNG = 20240531


def sampled(count: int, period: float, drift: float = 0.0, lost: np.ndarray | None = None) -> np.ndarray:
    """True times on the logger's clock of steady samples, some of them lost."""
    true = 3.0 + period * (1.0 + drift) * np.arange(count)
    return true if lost is None else np.delete(true, lost)


def stamped(true: np.ndarray, jitter: float, seed: int = RNG) -> np.ndarray:
    """Stamps as a logger writes them: late or early, but in order."""
    return np.sort(true + jitter * np.random.default_rng(seed).standard_normal(true.size))


def wander(base: TimeBase, true: np.ndarray) -> float:
    """rms of the error without its mean, which no stamp can tell and latency absorbs."""
    return float(np.std(base.t - true))


@pytest.mark.parametrize(("jitter", "drift"), [(0.0005, 0.0), (0.001, 50e-6), (0.004, 200e-6), (0.004, -200e-6)])
def test_jitter_is_evened_out_to_a_twentieth_of_the_period(jitter: float, drift: float) -> None:
    true = sampled(60_000, 0.005, drift)
    base = regularize(stamped(true, jitter))
    assert wander(base, true) < 0.05 * 0.005  # what the length of the blocks is chosen for
    assert np.std(np.diff(base.t)) < 1e-5
    assert base.period == pytest.approx(0.005, rel=1e-3)
    assert not np.any(find_gaps(base))


def test_even_stamps_come_back_unchanged() -> None:
    for t in (sampled(5000, 0.01), np.round(sampled(5000, 0.01), 3)):
        base = regularize(t)
        np.testing.assert_array_equal(base.t, t)
        assert base.jitter == 0.0


def test_a_gap_stays_a_gap_of_its_length() -> None:
    true = sampled(20_000, 0.005, 200e-6, np.arange(9000, 9030))
    base = regularize(stamped(true, 0.004))
    assert np.count_nonzero(find_gaps(base)) == 1
    assert np.max(np.diff(base.t)) == pytest.approx(31 * 0.005, abs=1e-3)
    assert wander(base, true) < 0.05 * 0.005


def test_single_lost_samples_are_gaps_and_not_smeared_over_their_neighbours() -> None:
    lost = np.arange(100, 40_000, 97)
    true = sampled(40_000, 0.005, 100e-6, lost)
    base = regularize(stamped(true, 0.0005))
    np.testing.assert_array_equal(np.flatnonzero(find_gaps(base)), lost - np.arange(lost.size) - 1)
    assert np.max(np.abs(base.t - true - np.mean(base.t - true))) < 0.15 * 0.005


def test_many_lost_samples_are_distinguished_from_a_longer_period() -> None:
    lost = np.random.default_rng(RNG).choice(40_000, 4000, replace=False)
    true = sampled(40_000, 0.005, 0.0, lost)
    base = regularize(stamped(true, 0.00005))
    assert base.period == pytest.approx(0.005, rel=1e-4)
    np.testing.assert_array_equal(find_gaps(base), np.diff(true) > 0.006)


def test_a_rate_that_changes_is_followed() -> None:
    periods = np.concatenate([np.full(10_000, 0.01), np.full(10_000, 0.0101), np.linspace(0.0101, 0.0099, 10_000)])
    true = np.cumsum(periods)
    base = regularize(stamped(true, 0.001))
    assert wander(base, true) < 0.4e-3  # rms 1.0e-3 before
    assert not np.any(find_gaps(base))


def test_samples_that_arrive_in_bursts_get_their_own_times_back() -> None:
    true = sampled(20_000, 0.01)
    rng = np.random.default_rng(RNG)
    wakes = np.cumsum(rng.uniform(0.03, 0.09, 8000)) + 3.0
    arrival = wakes[np.searchsorted(wakes, true)]
    same = np.concatenate([[0], np.flatnonzero(np.diff(arrival) > 0) + 1])
    rank = np.arange(true.size) - np.repeat(same, np.diff(np.append(same, true.size)))
    base = regularize(arrival + 0.002 * rank)
    assert np.std(arrival + 0.002 * rank - true) > 0.015
    assert wander(base, true) < 0.003
    assert not np.any(find_gaps(base))


def test_samples_that_come_late_once_are_compensated_and_no_gap() -> None:
    true = sampled(20_000, 0.01)
    late = true.copy()
    late[8000:8040] = np.maximum(late[8000:8040], true[8030] + 0.0005 * np.arange(40))
    base = regularize(stamped(late, 0.0005))
    assert not np.any(find_gaps(base))
    assert np.max(np.abs(base.t[8000:8040] - true[8000:8040])) < 0.01 + 0.3 / 32 * 3  # 0.3 s late before


def test_fixes_that_come_late_now_and_then_make_the_period_no_shorter() -> None:
    rng, true = np.random.default_rng(3), sampled(3000, 0.2)
    late = true + 0.004 * rng.standard_normal(true.size) + (rng.random(true.size) < 0.05) * rng.uniform(0.1, 0.25, 3000)
    base = regularize(np.maximum.accumulate(late) + 1e-6 * np.arange(true.size))
    assert base.period == pytest.approx(0.2, rel=2e-3)


def test_a_late_sample_after_a_hole_is_no_step_of_its_own() -> None:
    rng, true = np.random.default_rng(4), np.delete(sampled(1500, 0.2), slice(600, 625))
    late = true + 0.004 * rng.standard_normal(true.size) + (rng.random(true.size) < 0.05) * rng.uniform(0.1, 0.25, 1475)
    base = regularize(np.maximum.accumulate(late) + 1e-6 * np.arange(true.size))
    assert np.count_nonzero(find_gaps(base)) == 1
    error = base.t - true
    assert np.max(np.abs(error - np.median(error))) < 0.05  # a false step is 0.1 to 0.2 s


def test_a_sampling_that_is_itself_irregular_is_left_alone() -> None:
    t = np.cumsum(np.random.default_rng(RNG).uniform(0.005, 0.015, 20_000))
    base = regularize(t)
    np.testing.assert_array_equal(base.t, t)
    assert not base.is_steady


@pytest.mark.parametrize("t", [[], [1.0], [1.0, 2.0, 5.0]])
def test_too_few_stamps_come_back_unchanged(t: list[float]) -> None:
    np.testing.assert_array_equal(regularize(np.array(t)).t, t)


def test_gaps_and_jitter_are_reported_in_words() -> None:
    true = sampled(20_000, 0.01, 0.0, np.concatenate([np.arange(500, 515), [9000]]))
    gap, jitter = describe_time_base(regularize(stamped(true, 0.002)), "imu", "imu.csv")
    assert (gap.code, gap.count) == ("imu_gap", 2) and "2 gaps in the samples, the longest 0.16 s" in gap.text
    assert jitter.code == "imu_jitter" and "2.0 ms" in jitter.text


@settings(max_examples=100, deadline=None)
@given(st.lists(st.floats(1e-4, 10.0), min_size=1, max_size=200))
def test_whatever_the_intervals_the_order_is_kept(intervals: list[float]) -> None:
    base = regularize(np.cumsum(intervals))
    assert base.t.size == len(intervals) and np.all(np.diff(base.t) > 0)


def received(count: int, period: float, jitter: float, drift: float = 0.0, seed: int = RNG) -> tuple[np.ndarray, ...]:
    """True times on the IMU clock, receive times 0.12 s and an exponential delay later, and the receiver's UTC."""
    epoch = period * np.arange(count)
    true = 5.0 + (1.0 + drift) * epoch
    delay = np.random.default_rng(seed).exponential(jitter, count)
    arrival = np.maximum.accumulate(true + 0.12 + delay) + 1e-9 * np.arange(count)
    return true, arrival, 1.7e9 + epoch


@pytest.mark.parametrize("drift", [0.0, 50e-6, -200e-6])
@pytest.mark.parametrize(("count", "period"), [(3000, 0.2), (300, 1.0), (10_000, 0.04)])
def test_only_a_constant_latency_is_left_of_the_receive_delay(count: int, period: float, drift: float) -> None:
    true, arrival, unix = received(count, period, 0.02, drift)
    t, changed = true_fix_times(arrival, unix)
    assert changed
    assert np.std(t - true) < 0.0015  # 0.02 before; a percentile of 20 delays per bin is good to 1 ms
    assert np.mean(t - true) == pytest.approx(np.median(arrival - true), abs=0.001)  # what a row's delay typically was


def test_fixes_with_utc_before_leap_seconds_are_known_keep_their_receive_times() -> None:
    true, arrival, unix = received(1000, 0.2, 0.02)
    unix[:30] -= 18.0
    t, changed = true_fix_times(arrival, unix)
    assert changed
    assert np.max(np.abs(t[:30] - true[:30] - 0.12)) < 0.15  # the exponential delay exceeds 0.15 s once in 1800
    assert np.std((t - true)[30:]) < 0.0015


@pytest.mark.parametrize(
    "spoil",
    [
        lambda unix: np.full_like(unix, np.nan),
        lambda unix: np.floor(unix),  # whole seconds at 5 Hz
        lambda unix: unix[::-1],
        lambda unix: unix[0] + 1.01 * (unix - unix[0]),
        lambda unix: np.full_like(unix, unix[0]),
        lambda unix: unix + np.random.default_rng(1).uniform(0, 5, unix.size),
    ],
)
def test_receive_times_stay_where_the_utc_is_no_clock(spoil: object) -> None:
    _, arrival, unix = received(1000, 0.2, 0.02)
    t, changed = true_fix_times(arrival, spoil(unix))  # type: ignore[operator]
    assert not changed
    np.testing.assert_array_equal(t, arrival)


def test_receive_times_of_few_fixes_stay() -> None:
    _, arrival, unix = received(10, 1.0, 0.02)
    assert not true_fix_times(arrival, unix)[1]


def test_single_fixes_without_utc_move_with_their_neighbours() -> None:
    true, arrival, unix = received(1000, 0.2, 0.02)
    unix[[0, 400, 999]] = np.nan
    t, changed = true_fix_times(arrival, unix)
    assert changed and np.all(np.diff(t) > 0)
    assert np.max(np.abs(t - true - 0.12)) < 0.15


@pytest.fixture
def in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many hours, each of a few seconds."""
    monkeypatch.setattr(clock, "PART", 5000)
    monkeypatch.setattr(clock, "MARGIN", 2000)


@pytest.mark.usefixtures("in_parts")
def test_many_hours_are_evened_as_one_is() -> None:
    true = sampled(42_000, 0.005, 200e-6, np.arange(14_990, 15_020))  # a gap close to a seam
    base = regularize(stamped(true, 0.001))
    assert np.count_nonzero(find_gaps(base)) == 1
    assert np.max(np.diff(base.t)) == pytest.approx(31 * 0.005, abs=1e-3)
    assert wander(base, true) < 0.05 * 0.005
    others = np.delete(np.diff(base.t), np.flatnonzero(find_gaps(base)))
    assert np.max(np.abs(others - 0.005)) < 0.1 * 0.005  # the line may step by a twentieth of a period at a seam


@pytest.mark.usefixtures("in_parts")
def test_many_hours_of_even_or_irregular_stamps_come_back_unchanged() -> None:
    irregular = 3.0 + np.cumsum(np.random.default_rng(RNG).uniform(0.002, 0.02, 20_000))
    for t, is_steady in ((sampled(20_000, 0.01), True), (irregular, False)):
        base = regularize(t)
        np.testing.assert_array_equal(base.t, t)
        assert (base.jitter, base.is_steady) == (0.0, is_steady)
