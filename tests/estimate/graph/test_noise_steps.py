"""How the noise goes from turn to turn."""

from collections.abc import Callable

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.graph.inertial_noise import InertialNoise
from smoother.estimate.graph.inputs import LEVELS_SIZE, Noise
from smoother.estimate.graph.noise_steps import BACK, LEAST, NoiseSteps

START = Noise(InertialNoise(0.5, 0.03, 0.01, 1e-4), np.full(3, 0.05), np.full(3, 0.1), np.ones(3), 60.0, np.ones(3))
PLACE = np.linspace(-0.5, 0.8, LEVELS_SIZE)  # of the logarithms of all levels, where residuals are what is expected


def turns(gain: float, n: int, steps: Callable[[Noise, Noise], Noise]) -> Array:
    """Steps (n, LEVELS_SIZE) from START after each of n turns, where each turn goes `gain` times the way to PLACE."""
    noise, out = START, []
    for _ in range(n):
        left = PLACE - noise.step_from(START)
        noise = steps(noise.moved_by(np.clip(gain * left, -0.4, 0.4)), noise)
        out.append(noise.step_from(START))
    return np.array(out)


def test_levels_are_moved_each_by_its_own_step() -> None:
    moved = START.moved_by(PLACE)
    assert moved.step_from(START) == pytest.approx(PLACE)
    assert moved.inertial.accel == pytest.approx(0.5 * np.exp(PLACE[0]))
    assert moved.velocity == pytest.approx(0.1 * np.exp(PLACE[5:8]))


@pytest.mark.parametrize("gain", [0.3, 1.0])
def test_what_goes_one_way_goes_on_as_it_would(gain: float) -> None:
    steps = NoiseSteps()
    assert turns(gain, 12, steps.towards) == pytest.approx(turns(gain, 12, lambda better, _: better))


@pytest.mark.parametrize("gain", [1.8, 3.0, 8.0])
def test_what_jumps_over_its_place_comes_to_rest_there(gain: float) -> None:
    """Where residuals answer more strongly than counted on, full steps go to and fro between two noises for ever."""
    full = turns(gain, 60, lambda better, _: better)
    assert gain < 2.0 or np.max(np.abs(full[-1] - full[-2])) > 0.3  # without, which is what this is about
    found = turns(gain, 60, NoiseSteps().towards)
    assert found[-1] == pytest.approx(PLACE, abs=2.0 * LEAST)


def test_turning_back_is_by_half_of_the_way_that_it_came() -> None:
    steps, there, back = NoiseSteps(), np.full(LEVELS_SIZE, 0.3), np.full(LEVELS_SIZE, -0.3)
    first = steps.towards(START.moved_by(there), START)
    second = steps.towards(first.moved_by(back), first)
    assert second.step_from(first) == pytest.approx(BACK * back)
    third = steps.towards(second.moved_by(back), second)
    assert np.all(third.step_from(second) < 0.0)
    assert np.all(third.step_from(second) > 1.5 * BACK * back)
