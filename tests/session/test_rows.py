"""Choosing rows: what is out of order, repeated, stray or restarted, and what is only late."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from smoother.session.rows import Ordered, in_time_order, is_all, longest_increasing


def codes(of: Ordered) -> dict[str, int]:
    return {problem.code: problem.count for problem in of.problems}


def order(t: np.ndarray, *values: np.ndarray) -> tuple[np.ndarray, np.ndarray, Ordered]:
    ordered = in_time_order(np.asarray(t, dtype=float), *values, file="imu.csv", prefix="imu")
    return ordered.t, ordered.index, ordered


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
    assert codes(rows) == {"imu_reordered": 898}


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
        ((slice(0, 600), slice(400, 500), slice(600, 1000)), {"imu_reordered", "imu_repeated_time"}),
        ((slice(0, 200), slice(300, 700), slice(200, 300), slice(700, 1000)), {"imu_reordered"}),
        ((slice(500, 1000), slice(0, 500)), {"imu_reordered"}),
        ((slice(0, 1000), slice(0, 1000)), {"imu_reordered", "imu_repeated_time"}),
        ((slice(None, None, -1),), {"imu_reordered"}),
    ],
)
def test_blocks_written_twice_or_in_another_order_cost_nothing(parts: tuple[slice, ...], said: set[str]) -> None:
    _, which, rows = blocks(*parts)
    assert which.tolist() == list(range(1000)) and set(codes(rows)) == said


def test_a_short_second_run_of_the_clock_is_not_mixed_into_the_gaps_of_the_first() -> None:
    first = np.delete(np.arange(2000) * 0.1, np.s_[500:700])
    t = np.concatenate([first, 52.0 + np.arange(100) * 0.1])
    _, index, rows = order(t)
    assert index.tolist() == list(range(1800)) and codes(rows) == {"imu_clock_restart": 100}


def test_blocks_with_time_between_them_are_a_restart_of_the_clock() -> None:
    _, which, rows = blocks(slice(400, 1000), slice(0, 350))
    assert which.tolist() == list(range(400, 1000)) and codes(rows) == {"imu_clock_restart": 350}


def test_other_rows_of_the_same_times_are_a_restart_of_the_clock() -> None:
    t = np.concatenate([np.arange(600), np.arange(900)]) * 0.1
    _, index, rows = order(t, np.arange(1500.0))
    assert index[0] == 600 and codes(rows) == {"imu_clock_restart": 600}


@settings(max_examples=200, deadline=None)
@given(st.lists(st.floats(allow_nan=False, allow_infinity=False), max_size=60))
@example([1.0, 0.0, 2.225073858507203e-309, 1.0])
@example([0.0, 0.0])
def test_whatever_the_times_the_result_increases_and_every_row_is_accounted_for(t: list[float]) -> None:
    time, index, rows = order(np.array(t, dtype=float))
    assert time.shape == index.shape
    assert np.all(np.diff(time) > 0)
    dropped = sum(count for code, count in codes(rows).items() if code not in ("imu_reordered",))
    assert dropped + index.size == len(t)
