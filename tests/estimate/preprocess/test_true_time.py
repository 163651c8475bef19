"""Clocks that run far too fast or slow: found by UTC, taken out, and put back into the times of the result."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.judge.evaluate import evaluate
from smoother.estimate.preprocess.clock import (
    clock_of_fixes,
    clock_problems,
    clock_scale,
    in_session_time,
    in_true_time,
    utc_clock,
)
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import EstimateReport, Identified, Trajectory
from smoother.utc_clock import UtcClock


def drive(drift: float) -> Simulation:
    return simulate_preset("kart", 2, duration=60.0, gnss_outages=(), imu_clock_drift=drift)


def session(drift: float) -> Session:
    return prepare(drive(drift).raw)


@pytest.mark.parametrize("drift", [0.02, -0.03, 0.005])
def test_a_clock_that_is_far_off_is_found_by_utc(drift: float) -> None:
    assert clock_scale(session(drift)) == pytest.approx(1.0 + drift, abs=3e-4)  # 20 ms of 60 s


def test_a_crystal_is_left_alone() -> None:
    assert clock_scale(session(200e-6)) == 1.0
    assert clock_problems(session(200e-6)) == ()


def test_a_clock_by_which_laps_are_wrong_and_speeds_are_right_is_unchanged_but_reported() -> None:
    slow = session(-0.0015)
    assert clock_scale(slow) == 1.0
    (problem,) = clock_problems(slow)
    assert "0.15 % slow" in problem.text or "0.14 % slow" in problem.text or "0.16 % slow" in problem.text
    assert "corrected" not in problem.text
    assert "lap times are in its seconds, of which a minute has 59.91" in problem.text


def test_without_utc_nothing_is_known() -> None:
    s = session(0.02)
    assert clock_scale(replace(s, gnss=replace(s.gnss, unix_s=None))) == 1.0


def test_stamps_that_follow_no_clock_are_left_alone() -> None:
    s = session(0.0)
    t = s.gnss.t[0] + np.cumsum(np.random.default_rng(3).uniform(0.01, 0.6, len(s.gnss)))
    assert clock_scale(replace(s, gnss=replace(s.gnss, t=t))) == 1.0


def test_times_come_back_as_they_were() -> None:
    s = session(0.02)
    assert in_true_time(s, 1.02).gnss.t[-1] == pytest.approx(s.gnss.t[-1] / 1.02)
    trajectory = GraphSmoother().estimate(s)
    assert trajectory.t[0] == pytest.approx(s.gnss.t[0])
    assert trajectory.t[-1] == pytest.approx(s.gnss.t[-1], abs=0.05)
    assert trajectory.report.keyframes is not None
    assert trajectory.report.keyframes.t[-1] >= trajectory.t[-1]
    assert [p.text for p in trajectory.report.problems if p.code == "clock_scale"] == [
        "the recording's clock runs 2 % fast against the receiver's UTC; corrected in speeds and positions; "
        "t_s and lap times are in its seconds, of which a minute has 61.20"
    ]
    assert trajectory.joint is not None
    north = np.tile([1.0, 0.0, 0.0], (2, 1))
    inside = in_true_time(s, 1.02).gnss.t[[20, 200]]
    at = inside * 1.02
    back = in_session_time(trajectory, 2.0)
    assert back.joint is not None
    np.testing.assert_allclose(
        back.joint.covariance(2.0 * at, north), trajectory.joint.covariance(at, north), rtol=1e-9
    )


def test_a_clock_that_is_off_costs_no_accuracy() -> None:
    errors = []
    for drift in (0.0, 0.02):
        simulation = drive(drift)
        estimate = GraphSmoother().estimate(prepare(simulation.raw))
        t = estimate.t[(estimate.t > simulation.truth.first) & (estimate.t < simulation.truth.last)]
        origin = prepare(simulation.raw).origin
        truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, origin=origin)
        errors.append(evaluate(estimate, truth).horizontal_velocity_rms_mps)
    assert errors[1] < 1.1 * errors[0]  # the same noise on the same drive; 2 % of 15 m/s would be 0.3 m/s


def rows(n: int, told: EstimateReport | None = None) -> Trajectory:
    """A trajectory of n rows a second apart, from 0.4 ms on."""
    zero = np.zeros((n, 3))
    moving = Trajectory(0.0004 + np.arange(n), zero, zero, np.zeros((n, 3, 3)), zero, zero)
    return moving if told is None else replace(moving, report=told)


@pytest.mark.parametrize(("observable", "later"), [(True, 0.15), (False, 0.0)])
def test_utc_is_that_of_the_motion_and_not_of_stamps_that_come_late(observable: bool, later: float) -> None:
    given = session(0.0)
    late = replace(given, gnss=replace(given.gnss, unix_s=1.7e9 + given.gnss.t - 0.15))
    latency = Identified(0.15, 0.01, "s", observable, "identified" if observable else "default")
    told = rows(3, EstimateReport(identified={"gps_position_latency": latency}))
    clock = utc_clock(late, told)
    assert clock is not None and clock.at(0.0) == pytest.approx(1.7e9 - 0.15 + later, abs=1e-3)
    fixes = clock_of_fixes(late)
    assert fixes is not None and fixes.at(0.0) == pytest.approx(1.7e9 - 0.15, abs=1e-3)
    without = utc_clock(replace(given, gnss=replace(given.gnss, unix_s=None), unix_at_zero=5.0), told)
    assert without is not None and without.at(0.0) == pytest.approx(5.0, abs=1e-3)


@pytest.mark.parametrize("drift", [0.02, 5e-4, -2e-4])
def test_utc_goes_on_at_its_own_rate_where_the_clock_of_the_session_does_not(drift: float) -> None:
    given = session(drift)
    t = given.gnss.t
    late = replace(given, gnss=replace(given.gnss, unix_s=1.7e9 + t / (1.0 + drift)))
    clock = utc_clock(late, rows(3))
    assert clock is not None and clock.start_s == 0.0004
    np.testing.assert_allclose(clock.at(t), 1.7e9 + t / (1.0 + drift), rtol=0.0, atol=1e-3)


def test_the_start_is_given_to_the_millisecond_as_results_store_it() -> None:
    given = session(0.0)
    known = replace(given, gnss=replace(given.gnss, unix_s=None), unix_at_zero=1.7e9 + 0.1)
    assert utc_clock(known, rows(3)) == UtcClock(0.0004, 1.7e9 + 0.1)
    assert utc_clock(replace(known, unix_at_zero=None), rows(3)) is None
