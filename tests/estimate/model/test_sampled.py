"""Which times samples cover."""

import numpy as np
import pytest

from smoother.estimate.model.imu import HOLE, are_sampled, has_hole, sampled_spans

SPANS = np.array([[0.0, 10.0], [30.0, 50.0]])


def test_a_stretch_of_samples_ends_where_there_is_a_hole() -> None:
    t = np.concatenate([np.arange(0.0, 10.0, 0.5), 9.5 + HOLE + np.arange(0.0, 5.0, 0.5), [40.0]])
    np.testing.assert_array_equal(sampled_spans(t), [[0.0, 9.5 + HOLE + 4.5], [40.0, 40.0]])


def test_a_time_is_sampled_when_all_of_it_is_in_one_stretch() -> None:
    since = np.array([-1.0, 0.0, 9.0, 20.0, 29.0, 30.0, 50.0, 5.0])
    until = np.array([0.5, 10.0, 11.0, 21.0, 31.0, 50.0, 51.0, 35.0])
    np.testing.assert_array_equal(are_sampled(SPANS, since, until), [0, 1, 0, 0, 0, 1, 0, 0])


@pytest.mark.parametrize(
    ("first", "last", "expected"),
    [(0.5, 9.5, False), (-0.9 * HOLE, 10.0 + 0.9 * HOLE, False), (-1.1 * HOLE, 9.0, True), (31.0, 51.0 + HOLE, True)],
)
def test_a_hole_is_before_or_after_the_samples_too(first: float, last: float, expected: bool) -> None:
    assert has_hole(SPANS, first, last) == expected
    assert has_hole(SPANS, first - 100.0, last + 100.0)


def test_where_there_are_no_samples_at_all_there_is_a_hole() -> None:
    assert has_hole(SPANS, 15.0, 20.0)
