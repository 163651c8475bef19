"""The table of ablations: a row for each factor, and what its cells say."""

import numpy as np

from ablations import FACTORS, change
from smoother.estimate.factors.graph import TABLE


def test_every_factor_is_left_out_once() -> None:
    assert [factor.name for factor in TABLE] == list(FACTORS)


def test_a_change_is_the_mean_over_phases_with_its_standard_error() -> None:
    usual = np.array([1.0, 2.0])
    assert change(usual, usual) == "not used"
    assert change(np.array([np.nan, 2.0]), usual) == "no solution"
    assert change(1.1 * usual, usual) == "+10.0 ± 0.0 %"
    assert (
        change(np.array([1.0, 2.42]), usual) == "+10.0 ± 9.5 %"
    )  # logarithms 0 and 0.191, their mean is known to 0.095
