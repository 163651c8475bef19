"""Finding laps where nothing is given: what is a loop, what only looks like one, and where the line goes."""

from collections.abc import Callable

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.fit import loop
from smoother.fit.loop import find_loop
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.circuit import find_circuit
from smoother.laps.follow import follow
from smoother.laps.path import in_gaps, interpolated, plan_path
from smoother.laps.reference import Curve, first_line
from smoother.laps.results import FixPath, GivenLines, LapAnalysis
from smoother.sim.truth import Truth
from smoother.trajectory import Trajectory

Made = Callable[..., Trajectory]
Fixes = Callable[..., FixPath]
RoundTrip = Callable[..., tuple[Array, Array]]

EIGHT = np.array([[0, 0], [40, 40], [80, 60], [110, 30], [80, 0], [40, -5], [0, 0], [-40, 40], [-80, 60], [-110, 30]])
EIGHT = np.concatenate([EIGHT, [[-80, 0], [-40, -5]]]).astype(float)[:, ::-1]
PAPERCLIP = np.array(  # out along one straight, back, and out again 12 m beside the first, in the same direction
    [
        *([0, 0], [60, 0], [120, 0], [180, 0], [205, 25], [180, 50], [120, 50], [60, 50], [0, 50], [-20, 30], [0, 12]),
        *([60, 12], [120, 12], [170, 12], [188, 25], [170, 37], [120, 38], [60, 38], [20, 40], [-30, 60], [-60, 30]),
        [-30, 2],
    ],
    dtype=float,
)


def timed(analysis: LapAnalysis) -> list[float]:
    return [lap.time for lap in analysis.laps if lap.is_timed]


def test_laps_are_found_with_nothing_given(driven: Trajectory, larkfield: Truth, fixes: Fixes) -> None:
    found = analyse(driven, fixes(driven))
    assert found.start_line is not None
    ends = np.stack([found.start_line.left_n, found.start_line.right_n])
    true = larkfield.crossings(ends)
    true = true[(true > driven.t[0]) & (true < driven.t[-1])]
    assert timed(found) == pytest.approx(np.diff(true), abs=1e-3)
    assert [lap.reasons for lap in found.laps] == [("out-lap",), *[()] * (len(found.laps) - 2), ("in-lap",)]


def test_a_loop_is_the_same_however_few_places_are_compared_at_once(
    driven: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    at_once = find_loop(plan_path(driven), 100.0)
    monkeypatch.setattr(loop, "PAIRS", 1)
    assert find_loop(plan_path(driven), 100.0) == at_once is not None


def test_a_hole_of_more_than_a_lap_leaves_the_lap_what_it_is(driven: Trajectory) -> None:
    """Few places around it are seen one lap apart, most of them two laps apart."""
    path = plan_path(driven)
    whole = find_loop(path, 100.0)
    assert whole is not None
    for begin in (70.0, 80.0, 90.0):
        found = find_loop(path, 100.0, (path.t > begin) & (path.t < begin + 65.0))
        assert found is not None
        assert found.length == pytest.approx(whole.length, abs=10.0)


def test_values_between_rows_are_what_numpy_makes_of_them() -> None:
    rng = np.random.default_rng(4)
    t, values = np.cumsum(rng.uniform(0.01, 1.0, 200)), rng.normal(size=200)
    at = np.concatenate([rng.uniform(-5.0, t[-1] + 5.0, 500), t])
    np.testing.assert_allclose(interpolated(at, t, values), np.interp(at, t, values), rtol=0.0, atol=1e-12)


def test_rows_in_holes_of_the_fixes_are_those_between_their_ends() -> None:
    fixes = FixPath(np.array([0.0, 1.0, 4.0, 5.0, 9.0]), np.zeros((5, 2)))
    t = np.array([-1.0, 0.5, 1.0, 1.1, 3.9, 4.0, 4.5, 7.0, 9.0, 10.0])
    np.testing.assert_array_equal(t[in_gaps(t, fixes)], [1.1, 3.9, 7.0])
    assert not in_gaps(t, FixPath(np.zeros(1), np.zeros((1, 2)))).any()


def test_the_line_stands_across_a_fast_straight(driven: Trajectory, fixes: Fixes) -> None:
    found = analyse(driven, fixes(driven))
    assert found.reference is not None and found.traces is not None and found.start_line is not None
    assert abs(found.reference.curvature[0]) < 1.0 / 120.0
    speed = np.nanmedian(found.traces.speed, axis=0)
    assert speed[0] > 0.85 * speed.max()
    across = found.start_line.left_n - found.start_line.right_n
    assert abs(across @ found.reference.tangent_n[0]) < 1e-6


def test_the_crossing_of_a_figure_of_eight_is_no_lap(make: Made, round_trip: RoundTrip, fixes: Fixes) -> None:
    t, position = round_trip(EIGHT, 14.0, 3.6)
    path = plan_path(make(t, position))
    loop = find_loop(path, 100.0)
    whole = path.driven[-1] / 3.6
    assert loop is not None
    assert loop.length == pytest.approx(whole, rel=0.02)
    assert len(timed(analyse(make(t, position), fixes(make(t, position))))) in (2, 3)


@pytest.mark.parametrize("radius", [6.4, 11.5, 15.0, 20.0])
def test_a_round_of_a_small_circle_is_a_lap(make: Made, fixes: Fixes, radius: float) -> None:
    """Rounds in a car park have 40 m, of a skid pad of 15 m radius 94; each is driven a little wider or narrower."""
    speed = float(np.sqrt(6.0 * radius))
    t = np.arange(0.0, 10.5 * 2.0 * np.pi * radius / speed, 0.02)
    angle = speed * t / radius
    driven = (radius + np.sin(0.37 * angle))[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    wander = np.stack([np.sin(t / 40.0), np.cos(t / 55.0)], axis=1)
    found = analyse(make(t, driven + wander), fixes(make(t, driven + wander)))
    lap = 2.0 * np.pi * radius / speed
    assert len(timed(found)) in (9, 10)
    assert timed(found) == pytest.approx([lap] * len(timed(found)), rel=0.02)
    assert all(each.is_valid for each in found.laps if each.is_timed)


@pytest.mark.parametrize("share", [0.15, 0.25])
def test_a_small_figure_of_eight_is_one_lap(make: Made, round_trip: RoundTrip, fixes: Fixes, share: float) -> None:
    t, position = round_trip(share * EIGHT, 7.0, 5.6)
    found = analyse(make(t, position), fixes(make(t, position)))
    assert len(timed(found)) in (4, 5)
    assert timed(found) == pytest.approx([t[-1] / 5.6] * len(timed(found)), rel=0.01)


def test_a_line_stays_on_its_side_of_a_small_circle(make: Made, fixes: Fixes) -> None:
    angle = np.arange(0.0, 60.0, 0.02)
    position = 6.4 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    line = analyse(make(angle, position), fixes(make(angle, position))).start_line
    assert line is not None
    assert np.linalg.norm(line.left_n - line.right_n) < 2.0 * 6.4


def test_spins_on_the_spot_are_no_laps(make: Made, fixes: Fixes) -> None:
    straight = np.arange(0.0, 300.0, 0.2)
    angle = np.arange(0.0, 6.0 * np.pi, 0.2 / 3.0)
    spins = np.array([300.0, 3.0]) + 3.0 * np.stack([np.sin(angle), -np.cos(angle)], axis=1)
    position = np.concatenate([np.stack([straight, 0.0 * straight], axis=1), spins])
    position = np.concatenate([position, spins[-1] + np.stack([straight, 0.0 * straight], axis=1)])
    t = 0.02 * np.arange(len(position))
    assert not timed(analyse(make(t, position), fixes(make(t, position))))


def test_a_parallel_straight_nearby_is_no_lap_and_no_crossing(make: Made, round_trip: RoundTrip, fixes: Fixes) -> None:
    t, position = round_trip(PAPERCLIP, 14.0, 4.5)
    trajectory = make(t, position)
    lap = plan_path(trajectory).driven[-1] / 4.5 / 14.0
    gate = GivenLines(np.array([[100.0, -6.0], [100.0, 6.0]]))  # its 6 m of grace reach the other straight
    for lines in (None, gate):
        times = timed(analyse(trajectory, fixes(trajectory), LapOptions(lines=lines)))
        assert len(times) in (3, 4)
        assert times == pytest.approx([lap] * len(times), abs=0.02)


def test_a_gate_over_two_straights_counts_the_one_nearest_its_middle(
    make: Made, round_trip: RoundTrip, fixes: Fixes
) -> None:
    t, position = round_trip(PAPERCLIP, 14.0, 4.5)
    trajectory = make(t, position)
    wide = GivenLines(np.array([[100.0, -12.0], [100.0, 16.0]]))
    found = analyse(trajectory, fixes(trajectory), LapOptions(lines=wide))
    assert [problem.code for problem in found.problems] == ["line_passed_often"]
    lap = plan_path(trajectory).driven[-1] / 4.5 / 14.0
    assert timed(found) == pytest.approx([lap] * 4, abs=0.02)


def test_a_wandering_gps_does_not_lose_laps(make: Made, round_trip: RoundTrip, fixes: Fixes) -> None:
    t, position = round_trip(PAPERCLIP, 14.0, 6.4)
    wander = 4.0 * np.stack([np.sin(t / 40.0), np.cos(t / 55.0)], axis=1)
    found = analyse(make(t, position + wander), fixes(make(t, position + wander)))
    lap = plan_path(make(t, position)).driven[-1] / 6.4 / 14.0
    assert len(timed(found)) in (5, 6)
    assert timed(found) == pytest.approx([lap] * len(timed(found)), abs=0.6)


@pytest.mark.parametrize("share", [0.05, 0.5, 0.95])
def test_less_than_a_lap_is_no_lap(make: Made, round_trip: RoundTrip, fixes: Fixes, share: float) -> None:
    t, position = round_trip(PAPERCLIP, 14.0, share)
    found = analyse(make(t, position), fixes(make(t, position)))
    assert not timed(found)
    assert [problem.code for problem in found.problems] == ["no_laps"]


def test_a_kart_that_leaves_the_line_is_found_again(make: Made, round_trip: RoundTrip) -> None:
    t, position = round_trip(PAPERCLIP, 12.0, 4.5)
    wander = 4.0 * np.stack([np.sin(t / 7.0), np.cos(t / 11.0)], axis=1)
    away = 70.0 * np.exp(-(((t - 90.0) / 5.0) ** 2))
    path = plan_path(make(t, position + wander + away[:, None]))
    curve = Curve(first_line(path, 0.0, float(t[-1]) / 4.5))
    is_on = follow(path, curve).is_on
    assert not is_on[np.argmin(np.abs(t - 90.0))]
    assert np.mean(is_on[(t > 110.0) & (t < 140.0)]) > 0.9


def test_one_lap_and_a_little_is_one_lap(make: Made, round_trip: RoundTrip, fixes: Fixes) -> None:
    t, position = round_trip(PAPERCLIP, 14.0, 1.3)
    assert len(timed(analyse(make(t, position), fixes(make(t, position))))) == 1


def test_two_passages_of_a_given_line_are_a_lap_even_without_a_repeated_path(
    make: Made, round_trip: RoundTrip, fixes: Fixes
) -> None:
    t, position = round_trip(PAPERCLIP, 14.0, 1.02)
    shifted = np.roll(PAPERCLIP, -1, axis=0)
    t, position = round_trip(shifted, 14.0, 1.02)
    gate = GivenLines(np.array([[66.0, -8.0], [66.0, 5.0]]))
    assert len(timed(analyse(make(t, position), fixes(make(t, position)), LapOptions(lines=gate)))) == 1


def test_a_straight_drive_and_a_stand_are_no_laps(make: Made, fixes: Fixes) -> None:
    t = np.arange(0.0, 60.0, 0.02)
    for speed in (12.0, 0.0):
        position = np.stack([speed * t, 0.0 * t], axis=1)
        assert not analyse(make(t, position), fixes(make(t, position))).laps


def test_the_way_back_on_the_same_road_is_no_lap(make: Made, fixes: Fixes) -> None:
    out = np.stack([np.arange(0.0, 600.0, 0.3), 3.0 * np.sin(np.arange(0.0, 600.0, 0.3) / 50.0)], axis=1)
    angle = np.linspace(0.0, np.pi, 200)
    turn = out[-1] + 10.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    position = np.concatenate([out, turn[1:], out[::-1] + np.array([0.0, 5.0])])
    t = 0.02 * np.arange(len(position))
    assert find_loop(plan_path(make(t, position)), 100.0) is None


def test_laps_in_the_other_direction_are_not_mixed_in(make: Made, round_trip: RoundTrip, fixes: Fixes) -> None:
    t, position = round_trip(PAPERCLIP, 14.0, 3.0)
    there_and_back = np.concatenate([position, position[::-1][1:]])
    times = np.arange(len(there_and_back)) * 0.02
    found = analyse(make(times, there_and_back), fixes(make(times, there_and_back)))
    lap = t[-1] / 3.0
    assert all(abs(lap_.time - lap) < 0.1 for lap_ in found.laps if lap_.is_valid)


def test_a_given_line_elsewhere_is_reported_and_one_is_found(circle: Trajectory, fixes: Fixes) -> None:
    far = GivenLines(np.array([[900.0, 0.0], [910.0, 0.0]]), name="elsewhere")
    found = analyse(circle, fixes(circle), LapOptions(lines=far))
    assert [problem.code for problem in found.problems] == ["line_missed"]
    assert found.start_line is not None and found.start_line.source == "found"
    assert len(timed(found)) == 5


def test_a_reference_of_another_session_is_kept(circle: Trajectory, fixes: Fixes) -> None:
    first = analyse(circle, fixes(circle))
    moved = Trajectory(**{**vars(circle), "position_n": circle.position_n + np.array([1.0, -2.0, 0.0])})
    second = analyse(moved, fixes(moved), LapOptions(reference=first.reference))
    assert first.reference is not None and second.reference is not None
    np.testing.assert_array_equal(second.reference.position_n, first.reference.position_n)
    assert len(timed(second)) == len(timed(first))


def test_runs_from_start_to_finish_are_timed_where_the_two_are_apart(make: Made, fixes: Fixes) -> None:
    t = np.arange(0.0, 90.0, 0.02)
    out = np.stack([15.0 * t, 40.0 * np.sin(t / 12.0)], axis=1)  # a hill road
    back = np.stack([15.0 * t[::-1], 300.0 + 0.0 * t], axis=1)  # home another way
    position = np.concatenate([out, _between(out[-1], back[0]), back, _between(back[-1], out[0]), out])
    times = np.arange(len(position)) * 0.02
    start, finish = np.array([[150.0, -60.0], [150.0, 80.0]]), np.array([[1200.0, -80.0], [1200.0, 60.0]])
    found = analyse(
        make(times, position), fixes(make(times, position)), LapOptions(lines=GivenLines(start, (), finish))
    )
    assert timed(found) == pytest.approx([70.0, 70.0], abs=0.01)
    assert found.reference is not None and not found.reference.is_closed
    assert found.finish_line is not None


def test_a_run_that_passes_all_its_gates_three_metres_outside_has_its_sectors(make: Made, fixes: Fixes) -> None:
    t = np.arange(0.0, 60.0, 0.02)
    run = make(t, np.stack([15.0 * t, np.full(len(t), 8.0)], axis=1))
    start, sector, finish = (np.array([[north, -5.0], [north, 5.0]]) for north in (150.0, 450.0, 750.0))
    (lap,) = analyse(run, fixes(run), LapOptions(lines=GivenLines(start, (sector,), finish))).laps
    assert lap.sector_time == pytest.approx([20.0, 20.0], abs=0.01)


def _between(a: Array, b: Array) -> Array:
    share = np.linspace(0.0, 1.0, 1200)[1:-1, None]
    return np.asarray(a + share * (b - a))


def test_circuits_need_no_more_than_the_path(driven: Trajectory) -> None:
    circuit = find_circuit(plan_path(driven), None, None, 100.0)
    assert not hasattr(circuit, "code")


def test_the_way_home_in_a_car_takes_no_laps_away(make: Made) -> None:
    t = np.arange(0.0, 1300.0, 0.1)
    angle = 20.0 / 80.0 * np.minimum(t, 100.0)  # four laps of 503 m, then 24 km straight on
    ahead = 20.0 * np.maximum(t - 100.0, 0.0)[:, None] * np.array([-np.sin(25.0), np.cos(25.0)])
    found = find_loop(plan_path(make(t, 80.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1) + ahead)), 100.0)
    assert found is not None
    assert found.length == pytest.approx(160.0 * np.pi, rel=0.01)
