"""What the cells of the table of ablations say."""

import numpy as np

from ablations import change


def test_a_change_is_the_mean_over_phases_with_its_standard_error() -> None:
    usual = np.array([1.0, 2.0])
    assert change(usual, usual) == "not used"
    assert change(np.array([np.nan, 2.0]), usual) == "no solution"
    assert change(1.1 * usual, usual) == "+10.0 ± 0.0 %"
    # logarithms 0 and 0.191, whose mean is known to 0.095
    assert change(np.array([1.0, 2.42]), usual) == "+10.0 ± 9.5 %"
