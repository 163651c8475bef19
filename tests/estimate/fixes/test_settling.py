"""Receivers that have just found their satellites: what drifts in is left out, and the rest is as good as without."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.fixes.alone import GnssSmoother
from smoother.estimate.fixes.screen import settling_problems, unsettled
from smoother.estimate.judge.quality import assess
from smoother.estimate.smoother import GraphSmoother
from smoother.frames import nwu_to_geodetic
from smoother.prepare import prepare
from smoother.samples import Problem, Session
from smoother.session.load import load_raw
from smoother.sim.scenario import Interval
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory

OFF = np.array([30.0, -20.0, 10.0])  # m


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 6, duration=240.0, gnss_outages=(Interval(120.0, 8.0),))


@pytest.fixture(scope="module")
def session(simulation: Simulation) -> Session:
    return prepare(simulation.raw)


def moved(session: Session, by: Array) -> Session:
    """The session with its fixes moved by (N, 3) m in n."""
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(session.fix_position_n + by, session.origin)
    return replace(session, gnss=replace(session.gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))


def coming_in(session: Session, since: float, off: Array = OFF, memory: float = 12.0) -> Session:
    """The session of a receiver that has found its satellites at `since` s, and comes in from `off` m."""
    t = session.gnss.t - session.gnss.t[0] - since
    return moved(session, np.where(t < 0.0, 0.0, np.exp(-np.maximum(t, 0.0) / memory))[:, None] * off)


def test_fixes_before_the_receiver_had_settled_are_found(session: Session) -> None:
    t = session.gnss.t - session.gnss.t[0]
    out = unsettled(coming_in(session, 0.0))
    assert out[0]
    assert 20.0 < t[out][-1] < 50.0  # at 24 s it is 5 m off, at 36 s 2 m
    assert np.all(np.diff(np.flatnonzero(out)) == 1)
    again = unsettled(coming_in(session, t[t > 121.0][0]))  # after the outage
    assert not again[t < 121.0].any()
    assert 10.0 < np.sum(again) / 5.0 < 50.0


@pytest.mark.parametrize("every", [3, 5])
def test_a_receiver_may_measure_its_velocity_less_often_than_its_positions(session: Session, every: int) -> None:
    moving = coming_in(session, 0.0)
    measured = np.arange(len(moving.gnss)) % every == 0
    velocity_n = np.where(measured[:, None], moving.gnss.velocity_n, np.nan)
    out = unsettled(replace(moving, gnss=replace(moving.gnss, velocity_n=velocity_n)))
    assert out[0] and abs(int(out.sum()) - int(unsettled(moving).sum())) < 30
    seldom = np.where(session.gnss.t[:, None] < session.gnss.t[0] + 60.0, moving.gnss.velocity_n, np.nan)
    assert not unsettled(replace(moving, gnss=replace(moving.gnss, velocity_n=seldom))).any()


@pytest.mark.parametrize("hold", [15.0, 30.0, 60.0])
def test_a_receiver_may_wait_before_it_settles(session: Session, hold: float) -> None:
    t = session.gnss.t - session.gnss.t[0]
    waits = moved(session, np.exp(-np.maximum(t - hold, 0.0) / 10.0)[:, None] * OFF)
    out = unsettled(waits)
    assert out[t < hold].all()
    assert hold + 10.0 < t[out][-1] < hold + 50.0


def once_a_second(session: Session, until: float) -> Session:
    """The session of a receiver that sends one fix a second until so many s, and five from then on."""
    t = session.gnss.t - session.gnss.t[0]
    return replace(session, gnss=session.gnss.select((np.arange(len(t)) % 5 == 0) | (t > until)))


@pytest.mark.parametrize(("first", "lasts"), [(10.0, 15.0), (30.0, 20.0), (60.0, 8.0)])
def test_an_error_that_comes_and_goes_is_not_settling(session: Session, first: float, lasts: float) -> None:
    t = session.gnss.t - session.gnss.t[0]
    assert not unsettled(moved(session, ((t > first) & (t < first + lasts))[:, None] * OFF)).any()


def test_behind_a_short_hole_a_receiver_has_its_satellites(session: Session) -> None:
    t = session.gnss.t - session.gnss.t[0]
    kept = (t < 60.0) | (t > 63.0)
    gnss = {
        name: v[kept] if isinstance(v, np.ndarray) and len(v) == len(t) else v for name, v in vars(session.gnss).items()
    }
    holed = replace(session, gnss=replace(session.gnss, **gnss))
    assert not unsettled(coming_in(holed, 63.0)).any()


def test_a_receiver_that_changes_its_rate_settles_no_more_than_others(session: Session) -> None:
    """Velocities of one fix a second were smoothed by as many as make a second of the rest."""
    for until in (70.0, 100.0):
        assert not unsettled(once_a_second(session, until)).any()


def test_errors_that_come_again_and_again_are_no_settling(session: Session) -> None:
    """Velocities that are wrong for 3 s in every lap, at one fix a second, carry dead reckoning away each time."""
    slow = once_a_second(session, 1e3)
    wrong = (slow.gnss.t - slow.gnss.t[0]) % 53.0 > 50.0
    velocity_n = slow.gnss.velocity_n + np.where(wrong, 8.0, 0.0)[:, None]
    assert not unsettled(replace(slow, gnss=replace(slow.gnss, velocity_n=velocity_n))).any()


def test_the_message(session: Session) -> None:
    t = session.gnss.t - session.gnss.t[0]
    late = t[t > 121.0][0]
    (problem,) = said_of(coming_in(session, 0.0))
    assert problem.code == "gps_settling"
    assert "had not settled at the start: for " in problem.text
    assert problem.count == int(unsettled(coming_in(session, 0.0)).sum())
    assert "after a gap" in said_of(coming_in(session, late))[0].text
    assert "2 times" in said_of(coming_in(coming_in(session, 0.0), late))[0].text
    assert said_of(session) == ()


def said_of(session: Session) -> tuple[Problem, ...]:
    return settling_problems(session.gnss.t, unsettled(session))


def error(trajectory: Trajectory, simulation: Simulation, session: Session, until: float = 240.0) -> float:
    """Horizontal rms, m, of the first minutes."""
    t = trajectory.t[(trajectory.t > 3.0) & (trajectory.t < until - 3.0)]
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)
    off = trajectory.position_n[np.isin(trajectory.t, t), :2] - truth.position_n[:, :2]
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def test_a_cold_start_costs_little(simulation: Simulation, session: Session) -> None:
    plain, cold = GraphSmoother().estimate(session), coming_in(session, 0.0)
    found = GraphSmoother().estimate(cold)
    assert error(found, simulation, session) < error(plain, simulation, session) + 1.0  # it was 6 m
    sigma = found.sigmas
    assert sigma is not None
    speed = [np.hypot(each.velocity_n[:, 0], each.velocity_n[:, 1]) for each in (found, plain)]
    assert np.sqrt(np.mean((speed[0] - speed[1]) ** 2)) < 0.02
    assert "gps_settling" in [problem.code for problem in found.report.problems]
    quality = assess(cold, found)
    assert quality.passed, quality.reasons
    alone = GnssSmoother().estimate(cold)
    assert error(alone, simulation, session) < error(GnssSmoother().estimate(session), simulation, session) + 1.0
    assert assess(cold, alone).passed


def test_receivers_that_wander_as_they_always_do_are_settled() -> None:
    for preset in ("kart", "kart_harsh"):
        for seed in range(20, 26):
            assert not unsettled(prepare(simulate_preset(preset, seed, duration=150.0, imu_rate=50.0).raw)).any()


def test_without_doppler_or_time_nothing_is_left_out(session: Session) -> None:
    cold = coming_in(session, 0.0)
    blind = replace(cold.gnss, velocity_n=np.full_like(cold.gnss.velocity_n, np.nan))
    assert not unsettled(replace(cold, gnss=blind)).any()
    short = cold.gnss.select(cold.gnss.t < cold.gnss.t[0] + 35.0)
    assert not unsettled(replace(cold, gnss=short)).any()


@pytest.mark.parametrize(
    "recording", ["kart_adria_first_half", "kart_lignano_racebox", "car_hi600_rtk", "kart_massafinalese_racechrono"]
)
def test_real_recordings_are_settled(recording: str, data_directory: Path) -> None:
    assert not unsettled(prepare(load_raw(data_directory / recording))).any()
