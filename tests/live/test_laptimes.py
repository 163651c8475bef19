"""Laps from fixes as they come, before a smoother runs."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.results import Line
from smoother.live.laptimes import STAYED, LapClock

LAP, RADIUS = 30.0, 50.0  # s, m


def driven(t: float) -> tuple[Array, Array]:
    """Position and velocity (3,) on a circle, which crosses the line every LAP at t = 0, LAP .."""
    angle, rate = 2.0 * np.pi * t / LAP, 2.0 * np.pi / LAP
    place = RADIUS * np.array([np.sin(angle) + 1.0, -np.cos(angle), 0.0])
    return place, RADIUS * rate * np.array([np.cos(angle), np.sin(angle), 0.0])


def clock_of(offsets: dict[tuple[float, float], Array], until: float = 100.0) -> LapClock:
    """A clock with fixes at 5 Hz, displaced by offsets (3,) m between two times."""
    clock = LapClock()
    clock.set_line(Line("start", np.array([50.0, -42.0]), np.array([50.0, -58.0])))
    for t in np.arange(0.1, until, 0.2):
        place, velocity = driven(float(t))
        for (begin, end), offset in offsets.items():
            place = place + (offset if begin <= t < end else 0.0)
        clock.add_fix(float(t), place, velocity)
    return clock


def test_laps_are_timed_from_fixes() -> None:
    times = clock_of({}).times(95.0)
    assert times.lap == 3
    assert times.best == pytest.approx(LAP, abs=0.02)


def test_the_lap_runs_on_to_the_moment_that_is_shown() -> None:
    times = clock_of({}).times(95.0)
    later = times.running_on(97.5)
    assert later.running == pytest.approx(times.running + 2.5)
    assert (later.at, later.last, later.best, later.lap) == (97.5, times.last, times.best, times.lap)
    assert times.running_on(3.0) == times  # of a logger that was switched on anew


@pytest.mark.parametrize("size", [10.0, 30.0, 50.0])
@pytest.mark.parametrize("angle", np.arange(0.0, 2.0 * np.pi, 0.5))
def test_fixes_that_jump_across_the_line_are_no_lap(size: float, angle: float) -> None:
    jump = size * np.array([np.cos(angle), np.sin(angle), 0.0])
    times = clock_of({(33.0, 33.6): jump, (40.0, 41.0): -jump, (58.0, 59.0): jump, (75.0, 75.2): jump}).times(95.0)
    assert times.lap == 3
    assert times.best == pytest.approx(LAP, abs=0.02)


def test_a_path_that_stays_where_it_leapt_goes_on_there() -> None:
    clock = clock_of({(40.0, 200.0): np.array([12.0, 0.0, 0.0])})
    assert clock.path()[0][-1] > 99.0
    assert np.max(np.diff(clock.path()[0])) < STAYED + 0.5
    assert clock.times(95.0).lap == 3
