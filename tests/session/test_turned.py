"""A box that is turned over as the kart drives, and bends that only tilt the force on it."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import GnssFixes, Problem, RawImu
from smoother.session.turned import without_turned
from smoother.units import STANDARD_GRAVITY

RATE, LASTS = 50.0, 300.0  # Hz, s
T = np.arange(round(RATE * LASTS)) / RATE


def forces(left: Array | float = 0.0) -> Array:
    """Specific force (N, 3) m/s^2 of a kart that is pushed to the left by `left` (N,) m/s^2, and shaken."""
    force = np.zeros((T.size, 3)) + 5.0 * np.random.default_rng(1).standard_normal((T.size, 3))
    force[:, 1] += left + 6.0 * np.sin(T)
    force[:, 2] += STANDARD_GRAVITY
    return force


def fixes(speed: Array | float = 12.0) -> GnssFixes:
    t = np.arange(0.0, LASTS, 0.2)
    zero = np.zeros(t.size)
    return GnssFixes(
        t=t,
        lat_deg=45.0 + np.cumsum(np.zeros(t.size) + speed) * 0.2 / 111_195.0,
        lon_deg=zero + 12.0,
        alt_m=zero,
        velocity_n=np.stack([zero + speed, zero, zero], axis=1),
        num_sv=np.full(t.size, 9),
        fix=np.ones(t.size, dtype=np.int64),
    )


def judged(force: Array, gnss: GnssFixes | None = None) -> tuple[RawImu, list[Problem]]:
    problems: list[Problem] = []
    imu = RawImu(T, force, np.zeros_like(force))
    return without_turned(imu, fixes() if gnss is None else gnss, "imu.csv", problems), problems


def turned(force: Array, begin: float, end: float, onto: Array) -> Array:
    inside = (begin <= T) & (end > T)
    return np.where(inside[:, None], force @ onto.T, force)


@pytest.mark.parametrize(("begin", "end"), [(0.0, 104.0), (133.0, 168.0), (251.0, LASTS)])
@pytest.mark.parametrize(
    "onto",
    [
        np.diag([1.0, -1.0, -1.0]),
        np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]]),
        np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]),
    ],
)
def test_samples_of_a_box_that_was_turned_over_are_left_out_and_said(begin: float, end: float, onto: Array) -> None:
    imu, problems = judged(turned(forces(), begin, end, onto))
    assert not np.any((imu.t >= begin) & (imu.t < end))
    lost = T.size - imu.t.size
    assert lost <= (end - begin + 40.0) * RATE  # and not much more than those
    assert [(problem.code, problem.count) for problem in problems] == [("imu_turned", lost)]
    assert "the box lies otherwise" in problems[0].text


@pytest.mark.parametrize("turned_at", [62.0, 85.0, 118.0])
def test_a_box_that_is_turned_while_the_kart_stands_is_known_when_it_drives(turned_at: float) -> None:
    """At what time of the stand it was is not: all of that is left out."""
    t = np.arange(0.0, LASTS, 0.2)
    stands = (t > 60.0) & (t < 120.0)
    imu, problems = judged(
        turned(forces(), 0.0, turned_at, np.diag([1.0, -1.0, -1.0])), fixes(np.where(stands, 0.0, 12.0))
    )
    assert [problem.code for problem in problems] == ["imu_turned"]
    assert 115.0 < imu.t[0] < 135.0


def test_what_most_of_the_way_was_driven_with_is_kept_however_long_the_box_lay_elsewhere_before() -> None:
    """As on a table in the pits; there it harms nothing, and stays."""
    speed = np.where(np.arange(0.0, LASTS, 0.2) < 200.0, 0.0, 12.0)
    imu, problems = judged(turned(forces(), 0.0, 200.0, np.diag([1.0, -1.0, -1.0])), fixes(speed))
    assert imu.t.size == T.size
    assert problems == []


def test_long_bends_first_to_one_side_and_then_to_the_other_are_no_turned_box() -> None:
    """A skid pad at 1.2 g: what the box feels leans by 50 degrees to the left, then to the right."""
    imu, problems = judged(forces(np.where(T < 150.0, 12.0, -12.0)))
    assert imu.t.size == T.size
    assert problems == []


def test_a_kart_on_its_side_for_some_seconds_is_no_turned_box() -> None:
    imu, problems = judged(turned(forces(), 151.0, 159.0, np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=float)))
    assert imu.t.size == T.size
    assert problems == []
