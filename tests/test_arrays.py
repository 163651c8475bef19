"""Data types hold float64, read-only arrays of the stated shape."""

import re

import numpy as np
import pytest
from scipy.stats import norm

from smoother.arrays import MAD_TO_SIGMA, frozen, frozen_int, median, require_increasing, runs_of


def test_frozen_array_is_float64_contiguous_and_read_only() -> None:
    out = frozen(np.arange(6, dtype=np.int32).reshape(2, 3).T, (3, 2), "x")
    assert out.dtype == np.float64
    assert out.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        out[0, 0] = 1.0


def test_freezing_leaves_the_callers_array_writeable_and_apart() -> None:
    mine = np.zeros(3)
    held = frozen(mine, (3,), "x")
    mine[0] = 1.0
    assert held[0] == 0.0


def test_freezing_a_view_does_not_keep_it_tied_to_its_base() -> None:
    base = np.zeros((4, 3))
    held = frozen(base[1:3], (2, 3), "x")
    base[1, 0] = 1.0
    assert held[0, 0] == 0.0
    assert base.flags.writeable


def test_a_frozen_array_is_passed_on_without_a_copy() -> None:
    once = frozen([1.0, 2.0], (2,), "x")
    assert frozen(once, (None,), "x") is once


def test_lists_are_accepted_and_integers_stay_integers() -> None:
    np.testing.assert_array_equal(frozen([[1, 2], [3, 4]], (None, 2), "x"), [[1.0, 2.0], [3.0, 4.0]])
    whole = frozen_int([1, 2], (2,), "n")
    assert whole.dtype == np.int64
    assert not whole.flags.writeable


@pytest.mark.parametrize("freeze", [frozen, frozen_int])
@pytest.mark.parametrize("shape", [(3,), (2, 2), (None,), (None, 4), (1, 2, 3)])
def test_a_wrong_shape_is_named_with_what_was_wanted(freeze, shape) -> None:
    with pytest.raises(ValueError, match=r"field_s has shape \(2, 3\), wanted"):
        freeze(np.zeros((2, 3)), shape, "field_s")


def test_times_must_be_finite_and_strictly_increasing() -> None:
    require_increasing(np.array([]), "t")
    require_increasing(np.array([5.0]), "t")
    require_increasing(np.array([-1.0, 0.0, 1e-9]), "t")
    with pytest.raises(ValueError, match="mag is not strictly increasing"):
        require_increasing(np.array([0.0, 1.0, 1.0]), "mag")
    with pytest.raises(ValueError, match="not strictly increasing"):
        require_increasing(np.array([0.0, 1.0, 0.5]), "t")
    for bad in (np.nan, np.inf):
        with pytest.raises(ValueError, match="not finite"):
            require_increasing(np.array([0.0, bad]), "t")


@pytest.mark.parametrize("size", [1, 2, 3, 10, 4_001, 30_000])
def test_the_median_is_that_of_numpy_to_the_last_bit(size: int) -> None:
    rng = np.random.default_rng(size)
    for values in (rng.normal(size=size), np.round(rng.normal(size=size), 1), np.full(size, 0.1)):
        given = values.copy()
        assert median(given) == np.median(values)
        np.testing.assert_array_equal(given, values)


def test_there_is_no_median_where_a_value_is_not_known() -> None:
    values = np.arange(5_000.0)
    for unknown in ([17], np.arange(2_400, 5_000), np.arange(5_000)):
        some = values.copy()
        some[unknown] = np.nan
        assert np.isnan(median(some))
    assert median(np.array([1.0, 2.0, np.inf, np.inf, np.inf])) == np.inf
    assert median(np.append(values, np.inf)) == np.median(np.append(values, np.inf))


def test_half_of_normal_numbers_lie_within_their_sigma_over_its_factor() -> None:
    assert norm.cdf(1.0 / MAD_TO_SIGMA) - norm.cdf(-1.0 / MAD_TO_SIGMA) == pytest.approx(0.5, abs=1e-5)


@pytest.mark.parametrize("word", ["", "0", "1", "0110", "1011", "10100111", "1111"])
def test_runs_are_those_of_true_with_the_index_behind_their_last(word: str) -> None:
    mask = np.array([letter == "1" for letter in word], dtype=np.bool_)
    first, behind = runs_of(mask)
    assert [(m.start(), m.end()) for m in re.finditer("1+", word)] == list(
        zip(first.tolist(), behind.tolist(), strict=True)
    )
