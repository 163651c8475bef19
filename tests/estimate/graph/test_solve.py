"""When the steps over a whole session have come to an end."""

import pytest

from smoother.estimate.graph.solve import CONSTANTS_WELL_KNOWN, STEADY, TINY, WELL_KNOWN, are_settled


def shrinking(first: float, ratio: float, n: int) -> list[float]:
    return [first * ratio**i for i in range(n)]


class TestAreSettled:
    def test_one_step_tells_nothing(self) -> None:
        assert not are_settled([(1e-6, 1e-6)])

    @pytest.mark.parametrize("ratio", [0.1, 0.5, 0.9])
    def test_what_the_steps_to_come_add_up_to_is_no_more_than_promised(self, ratio: float) -> None:
        """A step that looks small may be one of many."""
        steps = shrinking(0.9, ratio, 100)
        taken = next(n for n in range(2, 100) if are_settled([(step, 0.0) for step in steps[:n]]))
        assert sum(steps[taken:]) <= max(WELL_KNOWN, TINY * WELL_KNOWN / (1.0 - ratio))
        assert taken == 2 or sum(steps[taken - 1 :]) > TINY * WELL_KNOWN  # nor does it go on for longer

    def test_constants_count_as_well(self) -> None:
        assert not are_settled([(0.1, 3.0), (0.01, 2.0)])
        assert are_settled([(0.1, 3.0), (0.01, 0.2)])

    def test_a_large_step_may_be_the_last_where_they_shrink_quickly(self) -> None:
        limit = CONSTANTS_WELL_KNOWN
        assert are_settled([(0.3, 9.0 * limit), (0.08, 1.15 * limit)])
        assert not are_settled([(0.3, 2.0 * limit), (0.08, 1.15 * limit)])
        assert not are_settled([(0.3, 99.0 * limit), (0.08, 2.1 * limit)])

    def test_small_steps_to_and_fro_are_an_end(self) -> None:
        small = 0.9 * TINY * WELL_KNOWN, 0.9 * TINY * CONSTANTS_WELL_KNOWN
        assert are_settled([small, small])
        assert not are_settled([(WELL_KNOWN, 0.0), (WELL_KNOWN, 0.0)])

    def test_steps_with_a_noise_that_still_changes_are_not_the_last(self) -> None:
        steps = [(0.1, 0.1), (0.01, 0.01)]
        assert are_settled(steps, 0.9 * STEADY)
        assert not are_settled(steps, 1.1 * STEADY)
