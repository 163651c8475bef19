"""Laps are tied to the line that they have in common: an update by the joint covariance, exact, and of use."""

import numpy as np
import pytest

from smoother import api
from smoother.arrays import Array
from smoother.fit.lap_registration import LapRegistration
from smoother.frames import Origin, geodetic_to_nwu, nwu_to_geodetic
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.closure import LapClosure, TiedLaps, close_laps, tie_laps
from smoother.laps.stage import fix_path
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory

LAP, LAPS, NOISE = 50.0, 8, 0.2  # s, m
WALK = 0.003  # m^2/s


class Walk:
    """The JointPosition of a path whose error walks at random on either axis, beside one that is always the same."""

    def covariance(self, t: Array, direction_n: Array) -> Array:
        return np.asarray((direction_n @ direction_n.T) * (4.0 + WALK * np.minimum(t[:, None], t[None, :])))


def registration(translation_n: Array) -> LapRegistration:
    stations = (np.arange(60) + 0.5) / 60.0
    crossed = LAP * (np.arange(len(translation_n))[:, None] + stations) + 20.0
    return LapRegistration(0.4, 0.2, 0.5, 0.3, 80.0, 0.5, LAP, translation_n, NOISE, crossed)


def closed(translation_n: Array) -> LapClosure:
    return close_laps(Walk(), registration(translation_n))


def level(t: Array) -> tuple[Array, Array]:
    """Both level directions at all times, north first."""
    return np.tile(t, 2), np.repeat(np.eye(3)[:2], len(t), axis=0)


def test_it_is_the_gaussian_conditioned_on_the_mean_of_every_lap_beside_an_unknown_line() -> None:
    seen = np.random.default_rng(1).normal(size=(LAPS, 2))
    seen -= seen.mean(axis=0)
    closure = closed(seen)
    nodes = closure.t
    P = Walk().covariance(*level(nodes))
    means = np.kron(np.eye(2 * LAPS), np.full(6, 1.0 / 6.0))
    line = 1e8 * np.kron(np.eye(2), np.ones((LAPS, LAPS)))  # where the line is, nobody says
    S = means @ P @ means.T + line + NOISE**2 * np.eye(2 * LAPS)
    moved = -(P @ means.T @ np.linalg.solve(S, seen.T.ravel())).reshape(2, -1).T
    np.testing.assert_allclose(closure.at(nodes)[0], moved, atol=1e-6)
    left = P - P @ means.T @ np.linalg.solve(S, means @ P)
    found = TiedLaps(Walk(), closure).covariance(*level(nodes))
    apart = np.eye(len(P)) - np.roll(np.eye(len(P)), 6, axis=1)  # from a lap to the next, of the common error free
    np.testing.assert_allclose(apart @ found @ apart.T, apart @ left @ apart.T, atol=1e-6)


def test_a_path_whose_laps_lie_on_one_line_stays_where_it_is() -> None:
    np.testing.assert_array_equal(closed(np.zeros((LAPS, 2))).moved_n, 0.0)


def test_the_mean_over_all_laps_is_not_observable() -> None:
    seen = np.random.default_rng(2).normal(size=(LAPS, 2))
    t = np.linspace(0.0, 500.0, 300)
    np.testing.assert_allclose(closed(seen + np.array([3.0, -2.0])).at(t)[0], closed(seen).at(t)[0], atol=1e-9)


def test_covariances_stay_possible_and_neighbouring_times_as_sure_as_they_were() -> None:
    closure = closed(np.random.default_rng(3).normal(size=(LAPS, 2)))
    t = np.sort(np.random.default_rng(4).uniform(0.0, 500.0, 200))
    P = TiedLaps(Walk(), closure).covariance(*level(t))
    assert np.min(np.linalg.eigvalsh(P)) > -1e-9
    lap = np.array([100.0, 100.5, 150.0])
    north = np.tile([1.0, 0.0, 0.0], (3, 1))
    before, after = Walk().covariance(lap, north), TiedLaps(Walk(), closure).covariance(lap, north)

    def apart(P: Array, i: int, j: int) -> float:
        return float(P[i, i] + P[j, j] - 2.0 * P[i, j])

    assert apart(after, 0, 1) == pytest.approx(apart(before, 0, 1), rel=0.02)
    assert apart(after, 0, 2) < 0.7 * apart(before, 0, 2)


def test_the_slope_is_that_of_the_correction() -> None:
    closure = closed(np.random.default_rng(5).normal(size=(LAPS, 2)))
    t = np.linspace(closure.t[0] + 1.0, closure.t[-1] - 1.0, 97)
    later, earlier = (closure.at(t + by)[0] for by in (1e-4, -1e-4))
    np.testing.assert_allclose(closure.at(t)[1], (later - earlier) / 2e-4, atol=1e-6)


def line_error(simulation: Simulation, estimate: Trajectory, origin: Origin) -> float:
    """Rms, m, of the level position's error from its mean."""
    some = slice(500, -500, 10)
    t = estimate.t[some]
    place = simulation.truth.antenna_position_n(t, simulation.scenario.lever_arm_b)
    true = geodetic_to_nwu(*nwu_to_geodetic(place, simulation.truth.origin), origin)
    error = (estimate.position_n[some] - true)[:, :2]
    return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return api.simulate("kart", 3, duration=420.0, motion_standstill=None, gnss_offset_horizontal=2.0)


def test_the_line_and_the_laps_of_a_simulated_kart_are_nearer_to_the_true_ones(simulation: Simulation) -> None:
    session = api.prepared(simulation.raw)
    estimate = api.smooth(session)
    assert estimate.joint is not None
    tied, joint = tie_laps(estimate, estimate.joint)
    assert isinstance(joint, TiedLaps)
    errors = [line_error(simulation, one, session.origin) for one in (estimate, tied)]
    assert errors[1] < 0.7 * errors[0]
    fixes = fix_path(session)
    before, after = (
        np.array(
            [(lap.time, lap.sigma) for lap in analyse(estimate, fixes, LapOptions(ties_laps=ties)).laps if lap.is_timed]
        )
        for ties in (False, True)
    )
    assert len(after) == len(before) >= 4
    assert np.all(after[:, 1] < before[:, 1])
    assert not np.array_equal(after[:, 0], before[:, 0])


def test_fewer_than_four_laps_are_left_as_they_are() -> None:
    session = api.prepared(api.simulate("kart", 3, duration=120.0).raw)
    estimate = api.smooth(session)
    assert estimate.joint is not None
    assert tie_laps(estimate, estimate.joint) == (estimate, estimate.joint)
