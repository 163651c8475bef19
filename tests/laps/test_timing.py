"""Crossing times and their sigma, against formulas and against the simulator's own crossings."""

from collections.abc import Callable

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.results import FixPath, GivenLines
from smoother.laps.sigma import Crossed, Drift, OffsetModel, covariances, drift_of, position_errors, time_covariance
from smoother.sim.track import TRACKS
from smoother.sim.truth import Truth
from smoother.trajectory import Trajectory

Fixes = Callable[..., FixPath]
LAP = 2.0 * np.pi * 60.0 / 15.0  # s, of the circle
GATE = GivenLines(np.array([[0.0, -54.0], [0.0, -66.0]]))  # across the circle, where it runs north


def test_a_lap_of_a_circle_takes_its_circumference_over_the_speed(circle: Trajectory, fixes: Fixes) -> None:
    laps = [lap for lap in analyse(circle, fixes(circle), LapOptions(lines=GATE)).laps if lap.is_timed]
    assert [lap.start for lap in laps] == pytest.approx(LAP * (0.25 + np.arange(5)), abs=2e-4)
    assert [lap.time for lap in laps] == pytest.approx([LAP] * 5, abs=1e-4)


def test_the_ends_of_a_gate_may_come_in_either_order(circle: Trajectory, fixes: Fixes) -> None:
    turned = GivenLines(GATE.start[::-1])
    one, other = (analyse(circle, fixes(circle), LapOptions(lines=lines)) for lines in (GATE, turned))
    assert [lap.start for lap in one.laps] == [lap.start for lap in other.laps]
    assert one.start_line is not None and other.start_line is not None
    np.testing.assert_array_equal(one.start_line.left_n, other.start_line.left_n)


def test_left_and_right_are_those_of_the_driver(circle: Trajectory, fixes: Fixes) -> None:
    line = analyse(circle, fixes(circle), LapOptions(lines=GATE)).start_line
    assert line is not None
    assert np.linalg.norm(line.left_n) < np.linalg.norm(line.right_n)  # anticlockwise: the middle is on the left


def test_sectors_add_up_to_the_lap(circle: Trajectory, fixes: Fixes) -> None:
    sectors = (np.array([[54.0, 0.0], [66.0, 0.0]]), np.array([[0.0, 54.0], [0.0, 66.0]]))
    found = analyse(circle, fixes(circle), LapOptions(lines=GivenLines(GATE.start, sectors)))
    timed = [lap for lap in found.laps if lap.is_timed]
    assert len(timed) == 5
    for lap in timed:
        assert lap.sector_time.sum() == pytest.approx(lap.time, abs=1e-9)
        assert sorted(lap.sector_time) == pytest.approx([LAP / 4.0, LAP / 4.0, LAP / 2.0], abs=1e-3)


def test_crossings_are_those_of_the_truth_to_the_millisecond(
    larkfield: Truth, driven: Trajectory, fixes: Fixes
) -> None:
    line = np.asarray(TRACKS["larkfield"].start_line)
    true = larkfield.crossings(line)
    true = true[(true > driven.t[0]) & (true < driven.t[-1])]
    laps = [lap for lap in analyse(driven, fixes(driven), LapOptions(lines=GivenLines(line))).laps if lap.is_timed]
    assert [lap.start for lap in laps] == pytest.approx(true[:-1], abs=1e-3)
    assert [lap.end for lap in laps] == pytest.approx(true[1:], abs=1e-3)


def test_raw_times_are_those_of_straight_lines_between_fixes(circle: Trajectory, fixes: Fixes) -> None:
    laps = [lap for lap in analyse(circle, fixes(circle, 10), LapOptions(lines=GATE)).laps if lap.is_timed]
    # 5 Hz: the chord of 3 m lies up to 19 mm beside the circle, which moves no crossing at right angles to it much
    assert [lap.raw_time for lap in laps] == pytest.approx([LAP] * 5, abs=2e-3)


class _Independent:
    """Position errors of 0.3 m, independent at all times."""

    def covariance(self, t: Array, direction_n: Array) -> Array:
        return np.where(t[:, None] == t[None, :], 0.09, 0.0) * (direction_n @ direction_n.T)


class _Common(_Independent):
    """One error of 2 m, the same at all times."""

    def covariance(self, t: Array, direction_n: Array) -> Array:
        return 4.0 * direction_n @ direction_n.T


def test_independent_errors_of_both_crossings_add_up(circle: Trajectory, fixes: Fixes) -> None:
    sure = Trajectory(**{**vars(circle), "joint": _Independent()})
    found = analyse(sure, fixes(circle), LapOptions(lines=GATE, ties_laps=False))
    assert found.sigma_source == "joint"
    sigmas = [lap.sigma for lap in found.laps if lap.is_timed]
    assert sigmas == pytest.approx([np.sqrt(2.0) * 0.3 / 15.0] * 5, rel=1e-3)


def test_an_offset_common_to_both_crossings_cancels(circle: Trajectory, fixes: Fixes) -> None:
    sure = Trajectory(**{**vars(circle), "joint": _Common()})
    sigmas = [lap.sigma for lap in analyse(sure, fixes(circle), LapOptions(lines=GATE)).laps if lap.is_timed]
    # the direction at both crossings is the same but for rounding
    assert sigmas == pytest.approx([0.0] * 5, abs=2e-3)


def test_without_a_joint_covariance_the_offset_is_modelled_and_reported(circle: Trajectory, fixes: Fixes) -> None:
    found = analyse(circle, fixes(circle), LapOptions(lines=GATE))
    offset = 2.0 * 4.0 * (1.0 - np.exp(-LAP / 60.0))
    assert found.sigma_source == "model"
    for lap in found.laps:
        if lap.is_timed:
            assert lap.sigma == pytest.approx(np.sqrt(offset + 2.0 * 0.05**2) / 15.0, rel=1e-3)


def test_sigmas_cover_the_errors_of_a_wandering_gps(make: Callable[..., Trajectory], fixes: Fixes) -> None:
    rng = np.random.default_rng(8)
    t = np.arange(0.0, 7.3 * LAP, 0.1)
    angle = 15.0 / 60.0 * t
    plan = 60.0 * np.stack([-np.cos(angle), -np.sin(angle)], axis=1)
    z: list[float] = []
    for _ in range(50):
        found = analyse(
            make(t, plan + _wander(rng, t, 2.0, 60.0), track=0.0), fixes(make(t, plan)), LapOptions(lines=GATE)
        )
        timed = [lap for lap in found.laps if lap.is_timed][::2]  # no two share a crossing
        z += [(lap.time - LAP) / lap.sigma for lap in timed]
    within = [float(np.mean(np.abs(z) < k)) for k in (1.0, 2.0)]
    assert len(z) >= 150
    assert within[0] == pytest.approx(0.683, abs=0.1)  # 2.6 times the binomial sigma of 150 laps
    assert within[1] == pytest.approx(0.954, abs=0.045)


def _wander(rng: np.random.Generator, t: Array, sigma: float, tau: float) -> Array:
    from scipy.signal import lfilter

    decay = np.exp(-(t[1] - t[0]) / tau)
    steps = rng.normal(0.0, sigma * np.sqrt(1.0 - decay**2), (len(t), 2))
    steps[0] = rng.normal(0.0, sigma, 2)
    return np.asarray(lfilter([1.0], [1.0, -decay], steps, axis=0))


def test_speed_that_was_measured_bounds_the_drift_of_the_offset() -> None:
    t, north = np.array([0.0, 50.0]), np.tile([1.0, 0.0, 0.0], (2, 1))
    slow = OffsetModel(t, np.zeros(2), 2.0, 60.0).covariance(t, north)
    walked = OffsetModel(t, np.zeros(2), 2.0, 60.0, walk=0.15**2 * 0.2).covariance(t, north)
    change = [c[0, 0] + c[1, 1] - 2.0 * c[0, 1] for c in (slow, walked)]
    assert np.sqrt(change[0]) == pytest.approx(2.13, abs=0.01)
    assert np.sqrt(change[1]) == pytest.approx(0.46, abs=0.02)  # 0.15 m/s * sqrt(0.2 s * 50 s) = 0.47 m


def test_the_stored_drift_gives_back_the_sigma_of_the_model_it_was_taken_from() -> None:
    t = np.linspace(0.0, 600.0, 601)
    model = OffsetModel(t, np.full(601, 0.1), 1.5, 45.0)
    stored = drift_of(model, 0.0, 600.0)
    ends, north = np.array([100.0, 152.0]), np.tile([1.0, 0.0], (2, 1))
    moving = np.tile([14.0, 0.0], (2, 1))
    sigma = []
    for errors in (model, stored):
        c = time_covariance(errors, Crossed(ends, north, moving))
        sigma.append(np.sqrt(c[0, 0] + c[1, 1] - 2.0 * c[0, 1]))
    assert sigma[1] == pytest.approx(sigma[0], rel=0.03)  # interpolated between the stored lags


def test_a_trajectory_without_sigmas_gives_times_without_sigmas(circle: Trajectory, fixes: Fixes) -> None:
    bare = Trajectory(**{**vars(circle), "sigmas": None})
    found = analyse(bare, fixes(circle), LapOptions(lines=GATE))
    assert position_errors(bare, 0.2) == (None, "none")
    assert all(np.isnan(lap.sigma) for lap in found.laps)
    assert found.statistics is not None
    assert np.isfinite(found.statistics.theoretical)


def test_groups_asked_for_together_get_their_own_covariances() -> None:
    model = OffsetModel(np.array([0.0, 900.0]), np.array([0.1, 0.4]), 2.0, 60.0)
    rng = np.random.default_rng(3)
    sizes = (3, 1, 300, 90, 40, 5)  # one is larger than what is asked for together, others share a question
    t = [np.sort(rng.uniform(0.0, 900.0, size)) for size in sizes]
    directions = [rng.normal(size=(size, 3)) for size in sizes]
    assert list(covariances(model, [], [])) == []
    for group, times, direction in zip(covariances(model, t, directions), t, directions, strict=True):
        np.testing.assert_allclose(group, model.covariance(times, direction), rtol=1e-12)


def test_positions_that_several_groups_hold_are_asked_for_once() -> None:
    model = OffsetModel(np.array([0.0, 1e4]), np.array([0.1, 0.1]), 2.0, 60.0)
    asked: list[int] = []

    class Counting:
        def covariance(self, t: np.ndarray, direction_n: np.ndarray) -> np.ndarray:
            asked.append(len(t))
            return model.covariance(t, direction_n)

    shared, rng = np.linspace(5.0, 65.0, 30), np.random.default_rng(4)
    t = [np.concatenate([100.0 * k + np.sort(rng.uniform(0.0, 60.0, 10)), shared]) for k in range(1, 5)]
    directions = [np.tile([0.6, 0.8, 0.0], (40, 1)) for _ in t]
    for group, times, direction in zip(covariances(Counting(), t, directions), t, directions, strict=True):
        np.testing.assert_allclose(group, model.covariance(times, direction), rtol=1e-12)
    assert asked == [4 * 10 + 30]


def test_drift_needs_increasing_lags() -> None:
    with pytest.raises(ValueError, match="increasing"):
        Drift(np.array([0.0, 2.0, 1.0]), np.zeros(3), 1.0)
