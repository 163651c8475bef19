"""Choosing rows: what is out of order, repeated, stray or restarted, and what is only late."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from smoother.session.coarse import Spread, spread_coarse_times
from smoother.session.rows import WRAPS, Ordered, in_time_order, is_all, longest_increasing, unwrap


def codes(of: Ordered | Spread) -> dict[str, int]:
    return {problem.code: problem.count for problem in of.problems}


def order(t: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, np.ndarray, Ordered]:
    ordered = in_time_order(np.asarray(t, dtype=float), *values, file="imu.csv", prefix="imu")
    return ordered.t, ordered.index, ordered


def spread_of(t: np.ndarray, values: np.ndarray) -> Spread:
    return spread_coarse_times(t, values, file="imu.csv", prefix="imu")


def test_a_flawless_stream_is_used_as_it_is() -> None:
    t = np.cumsum(np.random.default_rng(3).uniform(0.001, 500.0, 1000))
    time, index, rows = order(t)
    np.testing.assert_array_equal(time, t)
    np.testing.assert_array_equal(index, np.arange(1000))
    assert is_all(index, 1000)
    assert not rows.problems
    assert t.flags.writeable


@pytest.mark.parametrize("index", [[0, 1], [0, 2, 1], [1, 2, 3], [0, 1, 2, 3]])
def test_an_index_of_all_rows_is_one_of_each_in_order(index: list[int]) -> None:
    assert not is_all(np.array(index), 3)


def longest_by_force(t: list[float]) -> int:
    best = [1] * len(t)
    for i in range(len(t)):
        best[i] = 1 + max((best[j] for j in range(i) if t[j] < t[i]), default=0)
    return max(best, default=0)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.integers(0, 12).map(float), max_size=14))
def test_the_longest_increasing_subsequence_is_one_and_is_longest(t: list[float]) -> None:
    keep = longest_increasing(np.array(t, dtype=float))
    chosen = np.array(t, dtype=float)[keep]
    assert np.all(np.diff(chosen) > 0)
    assert chosen.size == longest_by_force(t)


def test_rows_in_order_are_all_kept_without_a_word() -> None:
    time, index, rows = order(np.arange(100) * 0.01)
    assert index.size == 100 and rows.problems == []
    np.testing.assert_array_equal(time, np.arange(100) * 0.01)


def test_one_far_future_stamp_costs_itself_and_not_all_that_follow() -> None:
    t = np.arange(1000) * 0.01
    t[500] = 1e9
    _, index, rows = order(t)
    assert codes(rows) == {"imu_out_of_order": 1}
    assert 500 not in index and index.size == 999


@pytest.mark.parametrize("place", [0, -1])
def test_a_far_stamp_at_either_end_is_in_order_but_dropped(place: int) -> None:
    t = np.arange(1000) * 0.01
    t[place] = -1e9 if place == 0 else 1e9
    _, index, rows = order(t)
    assert codes(rows) == {"imu_stray_time": 1} and index.size == 999


def test_a_long_pause_inside_a_recording_is_a_gap_and_not_stray() -> None:
    t = np.concatenate([np.arange(2000) * 0.1, 4000.0 + np.arange(500) * 0.1])
    _, index, rows = order(t)
    assert index.size == 2500 and rows.problems == []


@pytest.mark.parametrize("rows_between", [1, 8])
def test_a_few_rows_between_two_long_parts_cost_neither_of_them(rows_between: int) -> None:
    between = 5000.0 + np.arange(rows_between) * 0.1
    t = np.concatenate([np.arange(2000) * 0.1, between, 9000.0 + np.arange(1500) * 0.1])
    for times in (t, -t[::-1]):
        _, index, rows = order(times)
        assert index.size == t.size and rows.problems == []


def test_the_first_of_a_repeated_time_is_kept_and_rows_out_of_order_are_counted() -> None:
    t = np.arange(1000) * 0.01
    t[10], t[20], t[30] = t[9], t[5], t[28]
    _, index, rows = order(t)
    assert codes(rows) == {"imu_repeated_time": 3}  # 20 and 30 repeat other rows' times as well
    assert {9, 5, 28} <= set(index) and not {10, 20, 30} & set(index)
    t[40] = 0.1234567
    assert codes(order(t)[2]) == {"imu_repeated_time": 3, "imu_out_of_order": 1}


@pytest.mark.parametrize(("first", "second"), [(0, 1), (500, 501), (500, 503), (998, 999)])
def test_two_rows_that_changed_places_are_sorted_and_none_is_lost(first: int, second: int) -> None:
    t = np.arange(1000) * 0.01
    t[[first, second]] = t[[second, first]]
    time, index, rows = order(t)
    assert set(codes(rows)) == {"imu_reordered"}
    np.testing.assert_array_equal(time, np.arange(1000) * 0.01)
    np.testing.assert_array_equal(t[index], time)


def test_a_stamp_that_points_between_two_rows_that_lack_nothing_is_dropped() -> None:
    t = np.arange(1000) * 0.01
    t[500] = 0.01 * 520 + 0.004
    _, index, rows = order(t)
    assert codes(rows) == {"imu_out_of_order": 1} and 500 not in index


def test_a_stream_shuffled_in_small_batches_is_sorted_rather_than_halved() -> None:
    t = np.arange(1000) * 0.01
    swapped = t.reshape(-1, 2)[:, ::-1].ravel()
    time, index, rows = order(swapped)
    np.testing.assert_array_equal(time, t)
    assert index.size == 1000 and codes(rows) == {"imu_reordered": 1000}


def test_after_a_restart_of_the_clock_the_longest_part_is_kept_and_never_a_mixture() -> None:
    first, second = np.arange(600) * 0.1, np.arange(900) * 0.1
    _, index, rows = order(np.concatenate([first, second]))
    assert set(index) == set(range(600, 1500))
    assert codes(rows) == {"imu_clock_restart": 600}


def test_rows_in_no_order_at_all_are_sorted_and_not_cut_where_their_times_fall() -> None:
    t = np.random.default_rng(1).permutation(np.arange(900) * 0.1)
    time, index, rows = order(t)
    np.testing.assert_array_equal(time, np.sort(t))
    np.testing.assert_array_equal(index, np.argsort(t))
    assert codes(rows) == {"imu_reordered": 900}


def test_two_recordings_whose_rows_were_mixed_are_not_sorted_into_one() -> None:
    t = np.stack([np.arange(300) * 0.1, 0.02 + np.arange(300)[::-1] * 0.1], axis=-1).ravel()
    _, index, _ = order(t)
    assert index.size < 600


def test_a_restart_is_found_among_stray_stamps() -> None:
    t = np.concatenate([np.arange(600) * 0.1, np.arange(900) * 0.1])
    t[[50, 700, 1200]] = [1e7, 1e7, -1e7]
    _, index, _ = order(t)
    assert set(index) == set(range(600, 1500)) - {700, 1200}


def blocks(*parts: slice) -> tuple[np.ndarray, np.ndarray, Ordered]:
    """What is left of parts of 1000 rows at 10 Hz, written one behind the other, with values that tell them apart."""
    which = np.concatenate([np.arange(1000)[part] for part in parts])
    time, index, rows = order(which * 0.1, np.sin(which)[:, None])
    np.testing.assert_allclose(time, which[index] * 0.1)
    return time, which[index], rows


@pytest.mark.parametrize(
    ("parts", "said"),
    [
        ((slice(0, 600), slice(400, 500), slice(600, 1000)), {"imu_blocks_moved": 1, "imu_repeated_time": 100}),
        ((slice(0, 200), slice(300, 700), slice(200, 300), slice(700, 1000)), {"imu_blocks_moved": 1}),
        ((slice(500, 1000), slice(0, 500)), {"imu_blocks_moved": 1}),
        ((slice(0, 1000), slice(0, 1000)), {"imu_blocks_moved": 1, "imu_repeated_time": 1000}),
        ((slice(None, None, -1),), {"imu_reordered": 1000}),
    ],
)
def test_blocks_written_twice_or_in_another_order_cost_nothing(parts: tuple[slice, ...], said: dict[str, int]) -> None:
    _, which, rows = blocks(*parts)
    assert which.tolist() == list(range(1000)) and codes(rows) == said


def test_a_short_second_run_of_the_clock_is_not_mixed_into_the_gaps_of_the_first() -> None:
    first = np.delete(np.arange(2000) * 0.1, np.s_[500:700])
    t = np.concatenate([first, 52.0 + np.arange(100) * 0.1])
    _, index, rows = order(t)
    assert index.tolist() == list(range(1800)) and codes(rows) == {"imu_clock_restart": 100}


def test_a_file_from_the_newest_row_to_the_oldest_may_have_gaps() -> None:
    t = np.delete(np.arange(1000) * 0.1, np.s_[40::50])
    t = (t + 1.1 * np.floor(t / 5.0))[::-1]
    time, _, rows = order(t, np.sin(t)[:, None])
    np.testing.assert_array_equal(time, t[::-1])
    assert codes(rows) == {"imu_reordered": t.size}


def test_blocks_with_time_between_them_are_a_restart_of_the_clock() -> None:
    _, which, rows = blocks(slice(400, 1000), slice(0, 350))
    assert which.tolist() == list(range(400, 1000)) and codes(rows) == {"imu_clock_restart": 350}


def test_other_rows_of_the_same_times_are_a_restart_of_the_clock() -> None:
    t = np.concatenate([np.arange(600), np.arange(900)]) * 0.1
    _, index, rows = order(t, np.arange(1500.0))
    assert index[0] == 600 and codes(rows) == {"imu_clock_restart": 600}


@pytest.mark.parametrize("counts_per_second, limit", [(1e6, 2.0**32), (1e3, 2.0**32)])
def test_a_32_bit_counter_may_wrap(counts_per_second: float, limit: float) -> None:
    true = limit / counts_per_second - 5.0 + np.arange(1000) * 0.01
    wrapped = np.mod(np.round(true * counts_per_second), limit) / counts_per_second
    time, index, rows = order(wrapped)
    assert index.size == 1000 and codes(rows) == {"imu_clock_wrapped": 1}
    np.testing.assert_allclose(time, true, atol=1e-3)


def test_a_single_low_stamp_is_not_a_wrap() -> None:
    t = WRAPS[0] - 5.0 + np.arange(400) * 0.01
    t[200] = 0.0
    np.testing.assert_array_equal(unwrap(t)[0], t)


def test_stamps_with_too_few_decimals_are_spread_over_the_interval_they_share() -> None:
    true = np.arange(400) * 0.005
    coarse = np.floor(true * 100 + 1e-9) / 100
    made = spread_of(coarse, np.arange(400.0)[:, None])
    spread = made.t
    np.testing.assert_allclose(spread, true, atol=1e-9)
    assert made.problems[0].count == 200


@pytest.mark.parametrize("decimals", [3, 6])
def test_samples_that_were_read_out_together_end_with_their_stamp(decimals: int) -> None:
    true = np.arange(4000) / 200.0
    late = np.random.default_rng(0).uniform(0.0, 0.002, 200)
    stamps = np.repeat(np.round(true[19::20] + late, decimals), 20)
    made = spread_of(stamps, np.arange(4000.0)[:, None])
    spread = made.t
    assert np.all(np.diff(spread) > 0.0)
    assert abs(np.mean(spread - true) - 0.001) < 5e-4
    assert np.max(np.abs(spread - true)) < 0.004
    assert made.problems[0].count == 3800
    assert "read out together" in made.problems[0].text


@pytest.mark.parametrize(("tick", "decimals"), [(1 / 64, 3), (0.0156, 4), (1 / 60, 6), (0.01, 2), (1.0, 0)])
def test_a_clock_with_coarse_ticks_is_no_read_out(tick: float, decimals: int) -> None:
    true = 100.0 + 0.0031 + np.arange(12000) / 200.0
    stamps = np.round(np.floor(true / tick) * tick, decimals)
    stamps[5000] += 1.3e-4  # one stamp that is damaged
    made = spread_of(stamps, np.arange(12000.0)[:, None])
    spread = made.t
    assert "spread evenly; if stamps are rounded" in made.problems[0].text
    assert made.sigma == pytest.approx(0.5 * tick, rel=0.05)
    assert abs(np.median(spread - true)) < 0.007


def test_batches_of_one_size_end_with_their_stamp_even_on_a_grid() -> None:
    true = 0.035 + np.arange(4000) / 200.0
    stamps = np.repeat(np.round(true[19::20], 2), 20)
    made = spread_of(stamps, np.arange(4000.0)[:, None])
    spread = made.t
    assert abs(np.median(spread - true)) < 0.006


def test_rows_written_twice_are_not_spread() -> None:
    t = np.repeat(np.arange(200) * 0.01, 2)
    made = spread_of(t, np.repeat(np.arange(200.0), 2)[:, None])
    np.testing.assert_array_equal(made.t, t)
    assert not made.problems


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=60))
@example([1.0, 0.0, 2.225073858507203e-309, 1.0])
@example([0.0, 0.0])
def test_whatever_the_times_the_result_increases_and_every_row_is_accounted_for(t: list[float]) -> None:
    time, index, rows = order(np.array(t, dtype=float))
    assert time.shape == index.shape
    assert np.all(np.diff(time) > 0)
    dropped = sum(count for code, count in codes(rows).items() if code not in ("imu_reordered", "imu_clock_wrapped"))
    assert dropped + index.size == len(t)


def test_a_logger_that_catches_up_now_and_then_is_left_alone() -> None:
    stamps = np.arange(4000) / 200.0
    stamps[500:520] = stamps[520] - 1e-4 * np.arange(20, 0, -1)
    np.testing.assert_array_equal(spread_of(stamps, np.arange(4000.0)[:, None]).t, stamps)


def test_samples_taken_in_short_drives_of_a_fast_sensor_are_no_readings() -> None:
    """2 kHz for a tenth of a second in each: nothing waits for as many as come."""
    stamps = (np.arange(200) / 2000.0 + np.arange(40)[:, None] * np.geomspace(0.15, 0.9, 40)[:, None]).ravel()
    np.testing.assert_array_equal(spread_of(stamps, np.arange(8000.0)[:, None]).t, stamps)


@pytest.mark.parametrize("back", [2.634, 5.0])
def test_a_clock_set_back_by_seconds_is_no_disorder(back: float) -> None:
    """Sorted, rows from before and after would stand by turns: at ten a second, two places for each of the seconds."""
    t = np.arange(1000) / 10.0
    t[600:] -= back
    ordered, index, rows = order(t)
    np.testing.assert_array_equal(index, np.arange(600))
    assert np.all(np.diff(ordered) > 0.0) and codes(rows) == {"imu_clock_restart": 400}
