"""Jumps beside outages are found, and right fixes are not taken for one, however far off the path was."""

from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from smoother.estimate.graph import edges
from smoother.estimate.graph.chain import NotPositiveDefiniteError
from smoother.estimate.graph.edges import Innovations, beside_outages, best_run, jumped, jumped_beside_outages
from smoother.estimate.graph.start import make_start
from smoother.estimate.resample import resample
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.sim.scenario import Interval, Jump
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import FixResiduals, Trajectory

OUTAGE = Interval(48.0, 15.0)
AFTER, BEFORE = (63.0, 63.8), (47.0, 47.999)  # s, of jumps


def innovations_of(
    t: np.ndarray, seed: int = 0, white: float = 0.5, drift: float = 2.0, scale: float = 1.0
) -> Innovations:
    """Fixes predicted by a path whose velocity is off by `drift` m/s, as the covariance says, and whiter ones."""
    rng = np.random.default_rng(seed)
    axis = drift**2 * np.outer(t, t) + white**2 * np.eye(len(t))
    covariance = np.asarray(np.kron(axis, np.eye(2)), dtype=np.float64)
    return Innovations(scale * np.linalg.cholesky(covariance) @ rng.normal(size=2 * len(t)), covariance)


def displaced(innovations: Innovations, fixes: slice, by: tuple[float, float]) -> Innovations:
    values = innovations.values.copy().reshape(-1, 2)
    values[fixes] += by
    return replace(innovations, values=values.ravel())


class TestJumped:
    T = np.arange(60) / 10.0

    @pytest.mark.parametrize("fixes", [slice(0, 8), slice(52, 60), slice(20, 45), slice(30, 31)])
    def test_the_fixes_of_a_jump_are_found_and_no_others(self, fixes: slice) -> None:
        innovations = displaced(innovations_of(self.T), fixes, (8.0, -6.0))
        np.testing.assert_array_equal(np.sort(jumped(self.T, innovations)), np.arange(60)[fixes])

    def test_two_jumps_are_both_found(self) -> None:
        innovations = displaced(innovations_of(self.T), slice(0, 8), (8.0, -6.0))
        innovations = displaced(innovations, slice(40, 50), (0.0, 20.0))
        np.testing.assert_array_equal(np.sort(jumped(self.T, innovations)), [*range(8), *range(40, 50)])

    def test_fixes_far_from_an_unsure_prediction_have_not_jumped(self) -> None:
        innovations = innovations_of(self.T, drift=20.0, seed=3)
        assert np.max(np.abs(innovations.values)) > 50.0
        assert jumped(self.T, innovations).size == 0

    def test_a_jump_is_seen_in_an_unsure_prediction_by_its_step(self) -> None:
        innovations = displaced(innovations_of(self.T, drift=20.0), slice(52, 60), (8.0, -6.0))
        np.testing.assert_array_equal(np.sort(jumped(self.T, innovations)), np.arange(52, 60))

    def test_steps_of_a_few_metres_are_let_be(self) -> None:
        assert jumped(self.T, displaced(innovations_of(self.T, white=0.1), slice(0, 8), (3.0, 0.0))).size == 0

    def test_a_prediction_that_is_worse_than_it_says_finds_nothing(self) -> None:
        innovations = displaced(innovations_of(self.T, scale=4.0), slice(0, 8), (30.0, 0.0))
        assert jumped(self.T, innovations).size == 0

    def test_none_is_found_where_none_is(self) -> None:
        assert not any(jumped(self.T, innovations_of(self.T, seed)).size for seed in range(50))

    def test_the_best_run_is_that_of_least_squares(self) -> None:
        t = self.T[:7]
        innovations = innovations_of(t, seed=5)

        def certainty(a: int, b: int) -> float:
            design = np.kron((np.arange(7) >= a) & (np.arange(7) < b), np.eye(2)).T
            white = np.linalg.inv(np.linalg.cholesky(innovations.covariance))
            fitted = np.linalg.lstsq(white @ design, white @ innovations.values, rcond=None)[0]
            return float(np.sum((white @ design @ fitted) ** 2))

        best = max((certainty(a, b), a, b) for a in range(7) for b in range(a + 1, min(a + 4, 7) + 1))
        run = best_run(t, innovations, 0.35)
        assert (run.fixes[0], run.fixes[-1] + 1) == best[1:]
        assert run.certainty == pytest.approx(best[0])


class TestBesideOutages:
    def test_both_sides_of_every_outage_are_predicted_and_the_ends_are_not(self) -> None:
        t = np.concatenate([np.arange(0.0, 40.0), np.arange(60.0, 100.0)])
        before, after = beside_outages(t)
        np.testing.assert_array_equal(t[before], np.arange(34.0, 40.0))
        np.testing.assert_array_equal(t[after], np.arange(60.0, 66.0))

    def test_a_third_of_what_is_short_is_predicted_at_most(self) -> None:
        t = np.concatenate([np.arange(0.0, 40.0), np.arange(60.0, 69.1, 0.5), np.arange(80.0, 120.0)])
        _, after, before, _ = beside_outages(t)
        assert np.ptp(t[after]) < 3.0
        assert np.ptp(t[before]) < 3.0

    @pytest.mark.parametrize("t", [np.arange(0.0, 100.0), np.arange(0.0, 100.0, 5.0), np.zeros(1), np.empty(0)])
    def test_fixes_without_outages_and_single_ones_are_left_alone(self, t: np.ndarray) -> None:
        assert not list(beside_outages(t))


def simulated(seed: int = 3, **changes: Any) -> Simulation:
    """A kart that has an outage, and no Doppler: positions alone say where and how fast it went on."""
    figures = {"gnss_outages": (OUTAGE,), "gnss_velocity": False, "gnss_rate": 10.0, **changes}
    return simulate_preset("kart", seed, duration=110.0, **figures)


def jumps_of(*times: tuple[float, float], size: float = 20.0) -> tuple[Jump, ...]:
    directions = (np.array([np.cos(start), np.sin(start), 0.0]) for start, _ in times)
    return tuple(Jump(start, end - start, size * d) for (start, end), d in zip(times, directions, strict=True))


@dataclass(frozen=True, eq=False)
class Smoothed:
    """A simulated session and what was made of it; error (T,) m, level, and the same over its sigma."""

    simulation: Simulation
    trajectory: Trajectory
    error: np.ndarray
    error_in_sigma: np.ndarray

    @property
    def fixes(self) -> FixResiduals:
        assert self.trajectory.report.fixes is not None
        return self.trajectory.report.fixes

    @property
    def has_jumped(self) -> np.ndarray:
        return np.asarray(np.any(self.simulation.gnss.jump_n != 0.0, axis=1))


def smoothed(simulation: Simulation, options: GraphOptions | None = None) -> Smoothed:
    session = prepare(simulation.raw)
    trajectory = GraphSmoother(options or GraphOptions()).estimate(session)
    arm = simulation.scenario.lever_arm_b
    truth = simulation.truth.trajectory(trajectory.t, arm, session.origin)
    assert trajectory.sigmas is not None
    error, sigma = trajectory.position_n - truth.position_n, trajectory.sigmas.position_n
    return Smoothed(simulation, trajectory, np.hypot(error[:, 0], error[:, 1]), np.hypot(*(error / sigma)[:, :2].T))


@cache
def with_jumps(*times: tuple[float, float], rate: float = 10.0, doppler: bool = False) -> Smoothed:
    return smoothed(simulated(gnss_jumps=jumps_of(*times), gnss_rate=rate, gnss_velocity=doppler))


@pytest.mark.parametrize(
    ("times", "rate"), [((AFTER,), 10.0), ((BEFORE,), 10.0), ((AFTER, BEFORE), 1.0), ((AFTER, BEFORE), 25.0)]
)
def test_a_jump_beside_an_outage_does_not_bend_the_path(times: tuple[tuple[float, float], ...], rate: float) -> None:
    s = with_jumps(*times, rate=rate)
    session = prepare(s.simulation.raw)
    lost = replace(session, gnss=session.gnss.select(~s.has_jumped))
    without = GraphSmoother().estimate(lost)
    apart = resample(s.trajectory, without.t).position_n - without.position_n
    assert np.max(np.hypot(*apart[:, :2].T)) < 1.0  # as if they had never come, but for where the keyframes are
    assert np.max(s.error_in_sigma) < 4.0
    assert np.all(s.fixes.weight[s.has_jumped] == 0.0)
    assert np.all(np.hypot(*s.fixes.residual_n[s.has_jumped, :2].T) > 10.0)  # what was left out says how far off it was


@pytest.mark.parametrize("doppler", [False, True])
@pytest.mark.parametrize("rate", [1.0, 10.0])
def test_right_fixes_beside_an_outage_keep_their_weight(rate: float, doppler: bool) -> None:
    s = with_jumps(rate=rate, doppler=doppler)
    t = prepare(s.simulation.raw).gnss.t
    beside = (np.abs(t - OUTAGE.start) < 6.0) | (np.abs(t - OUTAGE.start - OUTAGE.duration) < 6.0)
    assert np.all(s.fixes.weight[beside] > 0.0)
    assert np.mean(s.fixes.weight[beside] > 0.9) > 0.9


def test_the_other_solver_leaves_them_out_as_well() -> None:
    s = smoothed(simulated(gnss_jumps=jumps_of(AFTER)), GraphOptions(solver="isam2"))
    assert np.all(s.fixes.weight[s.has_jumped] == 0.0)
    assert np.max(s.error) < np.max(with_jumps(AFTER).error) + 0.5


def test_long_sessions_are_looked_at_bit_by_bit_with_the_same_result(monkeypatch: pytest.MonkeyPatch) -> None:
    simulation = simulated(gnss_jumps=jumps_of(AFTER, BEFORE))
    start = make_start(prepare(simulation.raw), GraphOptions())
    whole = jumped_beside_outages(start, start.noise, 4)
    monkeypatch.setattr(edges, "AROUND", 20.0)
    monkeypatch.setattr(edges, "LONGEST_WINDOW", 50.0)
    assert whole.size == np.count_nonzero(np.any(simulation.gnss.jump_n != 0.0, axis=1))
    np.testing.assert_array_equal(jumped_beside_outages(start, start.noise, 4), whole)


def test_a_prediction_that_fails_finds_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    start = make_start(prepare(simulated(gnss_jumps=jumps_of(AFTER)).raw), GraphOptions())

    def fails(*_: object) -> None:
        raise NotPositiveDefiniteError("as rounding may")

    monkeypatch.setattr(edges, "_predicted", fails)
    assert jumped_beside_outages(start, start.noise, 4).size == 0
