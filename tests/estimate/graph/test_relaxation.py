"""How far the constants go of each step, so that they come to rest."""

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.relaxation import SWINGING, Relaxation
from smoother.estimate.graph.state import CONSTANTS_SIZE

SIGMA = np.linspace(0.01, 2.0, CONSTANTS_SIZE)
START = 5.0 * SIGMA * np.cos(np.arange(CONSTANTS_SIZE))


def solution(step: Array) -> ChainSolution:
    """What :class:`Relaxation` reads of a solution whose constants are to go by `step` (30,)."""
    return cast(ChainSolution, SimpleNamespace(constants=step, constants_covariance=np.diag(SIGMA**2)))


def left(gains: Array, turns: int, relaxation: Relaxation | None) -> Array:
    """How far off, in sigmas, (turns, 30) constants are whose full steps go `gains` (30,) times what they should."""
    off, out = START.copy(), []
    for _ in range(turns):
        step = -gains * off
        off = off + (1.0 if relaxation is None else relaxation.share(solution(step))) * step
        out.append(off / SIGMA)
    return np.array(out)


@pytest.mark.parametrize("gain", [0.5, 1.0, 1.2])
def test_what_comes_to_rest_goes_whole_steps(gain: float) -> None:
    gains = np.full(CONSTANTS_SIZE, gain)
    np.testing.assert_array_equal(left(gains, 8, Relaxation()), left(gains, 8, None))


@pytest.mark.parametrize("gain", [1.9, 2.5, 4.0])
def test_what_swings_comes_to_rest(gain: float) -> None:
    gains = np.full(CONSTANTS_SIZE, gain)
    assert np.max(np.abs(left(gains, 12, None)[-1])) > 1.0
    assert np.max(np.abs(left(gains, 12, Relaxation())[-1])) < 0.5


def test_some_constants_that_swing_take_the_others_along() -> None:
    """All are shortened alike: a part of a step of all is one of the same equations."""
    gains = np.ones(CONSTANTS_SIZE)
    gains[SWINGING.stop - 1] = 3.0
    assert np.max(np.abs(left(gains, 25, None)[-1])) > 1e3
    assert np.max(np.abs(left(gains, 25, Relaxation())[-1])) < 0.5


def test_what_turned_back_once_may_have_had_another_noise() -> None:
    relaxation, step = Relaxation(), np.zeros(CONSTANTS_SIZE)
    step[SWINGING.stop - 1] = 3.0 * SIGMA[SWINGING.stop - 1]
    shares = [relaxation.share(solution(sign * step)) for sign in (1.0, -1.0, -1.0, 0.5)]
    assert shares == [1.0, 1.0, 1.0, 1.0]


def test_latencies_that_turn_back_go_half_of_the_way() -> None:
    relaxation, step = Relaxation(), np.zeros(CONSTANTS_SIZE)
    step[:2] = 3.0 * SIGMA[:2]
    assert relaxation.share(solution(step)) == 1.0
    assert relaxation.share(solution(-0.5 * step)) == 0.5


def test_it_goes_whole_steps_again_when_nothing_swings() -> None:
    relaxation = Relaxation()
    for i in range(5):
        swung = relaxation.share(solution((-1.0) ** i * START))
    assert swung < 0.5
    for _ in range(6):
        share = relaxation.share(solution(START))
    assert share == 1.0


def test_a_tenth_of_each_step_is_gone_however_far_it_goes_too_far() -> None:
    relaxation = Relaxation()
    shares = [relaxation.share(solution((-1.0) ** i * 20.0**i * START)) for i in range(8)]
    assert min(shares) == 0.1


def test_what_swings_goes_the_share_of_the_secant_each_constant_over_its_sigma() -> None:
    relaxation, uneven = Relaxation(), np.linspace(0.5, 1.5, CONSTANTS_SIZE)
    steps = [START, -1.1 * START, 1.3 * uneven * START]
    shares = [relaxation.share(solution(step)) for step in steps]
    last, step = ((steps[i] / SIGMA)[SWINGING] for i in (1, 2))
    assert shares[2] == pytest.approx(shares[1] * float(last @ (last - step)) / float((last - step) @ (last - step)))
