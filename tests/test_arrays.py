"""Data types hold float64, read-only arrays of the stated shape."""

import numpy as np
import pytest

from smoother.arrays import frozen, frozen_int, require_increasing


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
