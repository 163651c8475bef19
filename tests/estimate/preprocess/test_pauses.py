"""Pauses in which nothing was written: found, cut out, put back, and no worse a result on either side of them."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array, BoolArray
from smoother.estimate.preprocess.pauses import LEFT, LONGEST, NO_PAUSES, Pauses, closed_up, opened_up, pauses_of
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.samples import ImuSamples, Session
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Sigmas, Trajectory
from smoother.units import ANY_ANGLE, DEG

TWO = Pauses(np.array([10.0, 20.0]), np.array([100.0, 1000.0]))


def moved(session: Session, time: Callable[[Array], Array]) -> Session:
    """The session with all its times moved."""
    assert session.imu is not None
    gnss, mag = session.gnss, session.mag
    assert gnss.unix_s is not None
    return replace(
        session,
        gnss=replace(gnss, t=time(gnss.t), unix_s=gnss.unix_s + time(gnss.t) - gnss.t),
        imu=replace(session.imu, t=time(session.imu.t)),
        mag=None if mag is None else replace(mag, t=time(mag.t)),
    )


def paused(session: Session, *pauses: tuple[float, float]) -> Session:
    """The session with pauses (at, length) s put in, at rising times of the session without any."""
    at, length = np.array(pauses).T
    return moved(session, lambda t: t + np.append(0.0, np.cumsum(length))[np.searchsorted(at, t)])


def sampled(session: Session, use: BoolArray) -> Session:
    """The session with some of its samples (N,) alone."""
    assert session.imu is not None
    t, force, rate = (v[use] for v in (session.imu.t, session.imu.specific_force_s, session.imu.angular_rate_s))
    return replace(session, imu=ImuSamples(t, force, rate))


@cache
def simulated(seed: int = 3) -> Simulation:
    return simulate_preset("kart", seed, duration=160.0, gnss_outages=())


@cache
def whole() -> Session:
    return prepare(simulated().raw)


# ---- times ----------------------------------------------------------------------------------------------------------


def test_closed_times_go_back_to_where_they_were() -> None:
    t = np.array([0.0, 9.9, 110.0, 115.0, 119.9, 1120.0, 2000.0])
    closed = TWO.closed(t)
    np.testing.assert_allclose(closed, [0.0, 9.9, 10.0, 15.0, 19.9, 20.0, 900.0])
    np.testing.assert_allclose(TWO.opened(closed), t)


def test_times_that_are_cut_out_are_at_the_cut() -> None:
    t = np.array([9.9, 10.0, 60.0, 109.9, 110.0, 120.0, 1119.9, 1120.0])
    np.testing.assert_array_equal(TWO.are_cut_out(t), [0, 1, 1, 1, 0, 1, 1, 0])
    np.testing.assert_array_equal(TWO.closed(t[TWO.are_cut_out(t)]), [10.0, 10.0, 10.0, 20.0, 20.0])


def test_what_lies_between_the_cuts_is_distinguished() -> None:
    t = np.array([5.0, 9.0, 10.0, 19.0, 21.0])
    assert TWO.stretches(t) == [slice(0, 2), slice(2, 4), slice(4, 5)]
    np.testing.assert_allclose(TWO.between(t), [0.0, 100.0, 0.0, 1000.0])


def test_without_pauses_nothing_is_cut_out() -> None:
    t = np.array([0.0, 1.0])
    assert not NO_PAUSES.are_cut_out(t).any()
    np.testing.assert_array_equal(NO_PAUSES.closed(t), t)
    np.testing.assert_array_equal(NO_PAUSES.opened(t), t)
    assert NO_PAUSES.stretches(t) == [slice(0, 2)]


# ---- finding them ---------------------------------------------------------------------------------------------------


def test_a_session_without_a_long_pause_has_none() -> None:
    assert len(pauses_of(whole())) == 0
    assert len(pauses_of(paused(whole(), (80.0, 0.9 * LONGEST)))) == 0


def test_a_pause_of_the_samples_or_of_the_fixes_alone_is_none() -> None:
    session = paused(whole(), (80.0, 3600.0))
    bridged = np.arange(80.0, 3680.0, 10.0)
    assert session.imu is not None
    t = np.union1d(session.imu.t, bridged)
    assert len(pauses_of(replace(session, imu=ImuSamples(t, np.zeros((len(t), 3)), np.zeros((len(t), 3)))))) == 0
    assert len(pauses_of(sampled(whole(), np.abs(whole().imu.t - 80.0) > LONGEST))) == 0  # type: ignore[union-attr]
    assert len(pauses_of(replace(session, imu=None))) == 0


def test_of_each_pause_a_little_is_left() -> None:
    pauses = pauses_of(paused(whole(), (50.0, 3600.0), (100.0, 600.0)))
    np.testing.assert_allclose(pauses.removed, [3600.0 - LEFT, 600.0 - LEFT], atol=0.2)
    np.testing.assert_allclose(pauses.cuts, [50.0 + 0.5 * LEFT, 100.0 + 1.5 * LEFT], atol=0.5)


@pytest.mark.parametrize("length", [3600.03, 3600.11, 3600.17])
def test_fixes_fall_on_the_same_grid_on_both_sides(length: float) -> None:
    session = paused(whole(), (80.0, length))
    t = closed_up(session, pauses_of(session)).gnss.t
    phase = np.exp(2j * np.pi * t / 0.2)
    assert abs(np.mean(phase)) > 0.99


def test_samples_alone_in_a_pause_go_with_it() -> None:
    session = paused(whole(), (50.0, 1800.0), (60.0, 1800.0))
    gnss = session.gnss.select((session.gnss.t < 1000.0) | (session.gnss.t > 2000.0))
    pauses = pauses_of(replace(session, gnss=gnss))
    assert len(pauses) == 1
    closed = closed_up(replace(session, gnss=gnss), pauses)
    assert closed.imu is not None
    assert np.count_nonzero(np.diff(closed.imu.t) > 2.0) == 1
    assert closed.imu.t[-1] < 160.0 + LEFT


# ---- rows -----------------------------------------------------------------------------------------------------------


def test_rows_that_were_cut_out_stand_between_those_beside_them() -> None:
    t = np.arange(0.0, 130.0, 5.0)
    one = Pauses(np.array([10.0]), np.array([100.0]))
    n = int(np.count_nonzero(~one.are_cut_out(t)))
    place = np.column_stack([np.where(np.arange(n) < 2, 0.0, 10.0), np.zeros((n, 2))])
    ones, eye = np.ones((n, 3)), np.tile(np.eye(3), (n, 1, 1))
    sigmas = Sigmas(ones, ones, np.ones(n), ones * DEG, np.ones(n))
    found = opened_up(Trajectory(one.closed(t[~one.are_cut_out(t)]), place, ones, eye, ones, ones, sigmas), one, t)
    inside = one.are_cut_out(t)
    np.testing.assert_array_equal(found.t, t)
    np.testing.assert_array_equal(found.velocity_n[~inside], 1.0)
    np.testing.assert_allclose(found.position_n[inside, 0], 10.0 * (t[inside] - 5.0) / 105.0)
    np.testing.assert_allclose(found.velocity_n[inside], np.tile([10.0 / 105.0, 0.0, 0.0], (inside.sum(), 1)))
    np.testing.assert_array_equal(found.acceleration_b[inside], 0.0)
    assert found.sigmas is not None
    np.testing.assert_allclose(found.sigmas.position_n[inside, 0], np.hypot(1.0, 10.0))
    np.testing.assert_array_equal(found.sigmas.attitude[inside], ANY_ANGLE)
    np.testing.assert_array_equal(found.sigmas.attitude[~inside], DEG)


# ---- the whole way --------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What was made of a session with pauses, which of its rows are of driving, and the truth at these."""

    found: Trajectory
    driven: BoolArray
    truth: Trajectory

    @property
    def velocity_error_n(self) -> Array:
        """Error (N, 2) m/s on the level."""
        return (self.found.velocity_n[self.driven] - self.truth.velocity_n)[:, :2]

    @property
    def turn(self) -> Array:
        """Error (N, 3) rad."""
        return so3.log(self.found.R_nb[self.driven].transpose(0, 2, 1) @ self.truth.R_nb)


@cache
def smoothed(*pauses: tuple[float, float], solver: str = "batch") -> Smoothed:
    session = paused(whole(), *pauses) if pauses else whole()
    found = GraphSmoother(GraphOptions(solver=solver)).estimate(session)
    at, length = np.array(pauses).T if pauses else np.empty((2, 0))
    ends = at + np.cumsum(length)
    passed = np.searchsorted(ends, found.t)
    t = found.t - np.append(0.0, np.cumsum(length))[passed]
    inside = t <= np.append(at, np.inf)[passed]
    near = np.min(np.abs(t[:, None] - [0.0, 160.0, 50.0, 80.0, 110.0]), axis=1) < 1.0  # where there may be a pause
    driven = inside & ~near
    truth = simulated().truth.trajectory(t[driven], simulated().scenario.lever_arm_b, session.origin)
    return Smoothed(found, driven, truth)


def rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


HOUR, SEVERAL = ((80.0, 3600.0),), ((50.0, 900.0), (80.0, 120.0), (110.0, 7200.0))


@pytest.mark.parametrize(("pauses", "solver"), [(SEVERAL, "batch"), (HOUR, "isam2")])
def test_beside_a_pause_the_result_is_as_good_as_without(pauses: tuple[tuple[float, float], ...], solver: str) -> None:
    part, everything = smoothed(*pauses, solver=solver), smoothed()
    assert part.found.report.mode == "full"
    assert not part.found.report.problems
    assert rms(part.velocity_error_n) < 1.1 * rms(everything.velocity_error_n)
    assert rms(part.turn) < 1.3 * rms(everything.turn)
    assert part.found.sigmas is not None
    assert 0.8 < rms(part.velocity_error_n / part.found.sigmas.velocity_n[part.driven, :2]) < 1.2
    assert 0.6 < rms(part.turn) / rms(part.found.sigmas.attitude[part.driven]) < 1.4


def test_constants_are_as_far_off_as_they_say() -> None:
    report, scenario = smoothed(*SEVERAL).found.report, simulated().scenario
    for name in ("position", "velocity"):
        found = report.identified[f"gps_{name}_latency"]
        error = float(np.asarray(found.value)) - getattr(scenario.gnss, f"{name}_latency")
        assert abs(error) < 3.0 * float(np.asarray(found.sigma))


def test_rows_go_through_the_pause_with_large_sigmas() -> None:
    found = smoothed(*HOUR).found
    np.testing.assert_allclose(np.diff(found.t), 0.02, rtol=1e-6)
    inside = (found.t > 100.0) & (found.t < 3660.0)
    assert found.sigmas is not None
    assert np.all(np.isfinite(found.position_n))
    assert np.min(found.sigmas.position_n[inside, :2]) > 100.0
    assert np.min(found.sigmas.speed[inside]) > 10.0
    assert np.max(found.speed[(found.t > 200.0) & (found.t < 3500.0)]) < 1.0
    np.testing.assert_array_equal(found.sigmas.attitude[(found.t > 200.0) & (found.t < 3500.0)], ANY_ANGLE)


def test_keyframes_grow_with_the_driving_and_not_with_the_pause() -> None:
    report, without = smoothed(*HOUR).found.report, smoothed().found.report
    assert report.keyframes is not None
    assert without.keyframes is not None
    assert len(report.keyframes.t) < len(without.keyframes.t) + 1.2 * LEFT / 0.2
    assert np.max(np.diff(report.keyframes.t)) > 3500.0
    assert report.keyframes.t[-1] > 3750.0


def test_errors_of_both_sides_share_the_unseen_offset_alone() -> None:
    found = smoothed(*HOUR).found
    assert found.joint is not None
    assert found.sigmas is not None
    t, north = np.array([40.0, 60.0, 3700.0, 3740.0]), np.tile([1.0, 0.0, 0.0], (4, 1))
    P = found.joint.covariance(t, north)
    sigma = np.interp(t, found.t, found.sigmas.position_n[:, 0])
    np.testing.assert_allclose(np.sqrt(np.diag(P)), sigma, rtol=0.03)
    assert found.report.keyframes is not None
    assert found.report.keyframes.unseen_offset is not None
    # none in this session; else what the slow error of Doppler velocities makes of an hour would not be shared either
    np.testing.assert_allclose(P[:2, 2:], found.report.keyframes.unseen_offset[0], rtol=0.15, atol=1e-9)


def test_after_a_pause_the_kart_may_be_at_another_place_and_point_elsewhere() -> None:
    """A minute and a half of driving is left out of both files."""
    simulation = simulate_preset("kart", 3, duration=240.0, gnss_outages=())
    session = prepare(simulation.raw)
    gnss = session.gnss.select((session.gnss.t < 70.0) | (session.gnss.t > 163.0))
    assert session.imu is not None
    session = sampled(replace(session, gnss=gnss), (session.imu.t < 70.0) | (session.imu.t > 163.0))
    assert len(pauses_of(session)) == 1
    found = GraphSmoother().estimate(session)
    truth = simulation.truth.trajectory(found.t, simulation.scenario.lever_arm_b, session.origin)
    late = (found.t > 164.0) & (found.t < 239.0)
    assert found.report.mode == "full"
    assert rms((found.velocity_n - truth.velocity_n)[late, :2]) < 0.2
    assert rms(so3.log(found.R_nb[late].transpose(0, 2, 1) @ truth.R_nb[late])) < 1.5 * DEG


def test_unusable_samples_are_reported_whatever_pauses_there_are() -> None:
    session = paused(whole(), *HOUR)
    assert session.imu is not None
    noise = np.random.default_rng(1).normal(size=(2, len(session.imu.t), 3))
    found = GraphSmoother().estimate(replace(session, imu=ImuSamples(session.imu.t, *noise)))
    assert found.report.mode == "gps-only"
    assert found.t[-1] > 3750.0


@pytest.mark.parametrize("seed", [2, 7])
def test_seconds_between_two_pauses_do_not_cost_the_samples_of_the_whole_session(seed: int) -> None:
    """Four seconds of driving alone do not determine every unknown; through the pauses they do."""
    session = prepare(simulate_preset("kart", seed, duration=330.0, gnss_rate=5.0).raw)
    assert session.imu is not None
    gaps = np.array([[60.0, 121.0], [125.0, 186.0], [190.0, 251.0]])

    def written(t: Array) -> BoolArray:
        return ~np.any((t[:, None] > gaps[:, 0]) & (t[:, None] < gaps[:, 1]), axis=1)

    fixes = session.gnss
    rows = {
        name: values[written(fixes.t)]
        for name, values in vars(fixes).items()
        if isinstance(values, np.ndarray) and len(values) == len(fixes)
    }
    session = sampled(replace(session, gnss=replace(fixes, **rows), mag=None), written(session.imu.t))
    assert len(pauses_of(session)) == 3
    codes = [problem.code for problem in GraphSmoother().estimate(session).report.problems]
    assert "graph_failed" not in codes
