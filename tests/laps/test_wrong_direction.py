"""Laps driven the other way round the track."""

from collections.abc import Callable

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps import wrong_direction
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.results import FixPath, GivenLines, LapAnalysis
from smoother.trajectory import Trajectory

Made = Callable[..., Trajectory]
Fixes = Callable[..., FixPath]
RADIUS, SPEED = 60.0, 15.0  # m, m/s
LAP = 2.0 * np.pi * RADIUS / SPEED  # s
CIRCLE = np.stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 13)[:-1]), np.sin(np.linspace(0.0, 2.0 * np.pi, 13)[:-1])], 1)
EIGHT = np.array([[0, 0], [40, 40], [80, 60], [110, 30], [80, 0], [40, -5], [0, 0], [-40, 40], [-80, 60], [-110, 30]])
EIGHT = np.concatenate([EIGHT, [[-80, 0], [-40, -5]]]).astype(float)


def there_and_back(
    laps: float, back: float, rest: float = 20.0, again: float = 0.0, pace: float = 1.0
) -> tuple[Array, Array]:
    """Times (N,) s and laps driven (N,): so many, after a rest so many back, at another pace, and again so many on."""
    t = np.arange(0.0, (laps + back + again) * LAP + 3.0 * rest, 0.02)
    begin, turn = laps * LAP + rest, laps * LAP + rest + back * LAP
    speed = np.interp(t, [laps * LAP - 3.0, laps * LAP], [1.0, 0.0])
    speed -= pace * np.interp(t, [begin, begin + 3.0, turn, turn + 3.0], [0.0, 1.0, 1.0, 0.0]) * (back > 0.0)
    speed += np.interp(t, [turn + rest, turn + rest + 3.0], [0.0, 1.0]) * (again > 0.0)
    return t, np.cumsum(speed) * 0.02 / LAP


def along(corners: Array, laps: Array) -> Array:
    """Positions (N, 2) m after so many laps (N,) of a smooth curve through `corners`."""
    from scipy.interpolate import CubicSpline

    curve = CubicSpline(np.arange(len(corners) + 1), np.concatenate([corners, corners[:1]]), bc_type="periodic")
    return np.asarray(curve(np.mod(laps, 1.0) * len(corners)))


def told(analysis: LapAnalysis) -> list[str]:
    return [problem.text for problem in analysis.problems if problem.code == "driven_against"]


@pytest.mark.parametrize(("side", "way"), [(1.0, "clockwise"), (-1.0, "anticlockwise")])
@pytest.mark.parametrize("together", [7, wrong_direction.TOGETHER])
def test_laps_the_other_way_round_are_reported_and_not_timed(
    make: Made, fixes: Fixes, monkeypatch: pytest.MonkeyPatch, side: float, way: str, together: int
) -> None:
    monkeypatch.setattr(wrong_direction, "TOGETHER", together)
    t, laps = there_and_back(4.3, 3.2)
    driven = make(t, RADIUS * along(CIRCLE, laps) * [1.0, side])
    analysis = analyse(driven, fixes(driven))
    assert [lap.time for lap in analysis.laps if lap.is_timed] == pytest.approx([LAP] * 4, abs=0.1)
    (text,) = told(analysis)
    begin, end = 4.3 * LAP + 20.0, 7.5 * LAP + 20.0
    said = f" the track was driven the other way round ({way}), 3.2 laps, which are not timed; to have them, split the"
    assert said in text
    words = text.split()
    assert float(words[1]) == pytest.approx(begin, abs=4.0) and float(words[3]) == pytest.approx(end, abs=4.0)


def test_two_such_stretches_are_reported_in_one_line(make: Made, fixes: Fixes) -> None:
    """The quickest lap decides which way round the track goes."""
    t, laps = there_and_back(2.3, 5.0, again=2.3, pace=1.2)
    driven = make(t, RADIUS * along(CIRCLE, laps))
    (text,) = told(analyse(driven, fixes(driven)))
    assert text.startswith("from 0 to 5") and " s, from 2" in text and "(anticlockwise), 5." in text


def test_of_an_eight_neither_way_is_named(make: Made, fixes: Fixes) -> None:
    t, laps = there_and_back(4.3, 3.2)
    driven = make(t, along(EIGHT, laps))
    (text,) = told(analyse(driven, fixes(driven)))
    assert " driven the other way round, 3." in text


@pytest.mark.parametrize("back", [0.0, 0.4, 0.85])
def test_a_way_back_of_less_than_a_lap_is_not_worth_a_word(make: Made, fixes: Fixes, back: float) -> None:
    t, laps = there_and_back(4.3, back)
    driven = make(t, RADIUS * along(CIRCLE, laps))
    assert told(analyse(driven, fixes(driven))) == []


def test_a_road_on_which_one_drives_back_to_the_start_is_no_other_direction(make: Made, fixes: Fixes) -> None:
    t, laps = there_and_back(0.7, 0.68, again=0.7)
    driven = make(t, RADIUS * along(CIRCLE, laps))
    gates = [RADIUS * along(CIRCLE, np.array([at])) * np.array([[0.8], [1.2]]) for at in (0.05, 0.55)]
    analysis = analyse(driven, fixes(driven), LapOptions(lines=GivenLines(gates[0], finish=gates[1])))
    assert len([lap for lap in analysis.laps if lap.is_timed]) == 2 and told(analysis) == []
