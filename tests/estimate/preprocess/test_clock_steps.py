"""Stamps that jump in the middle of a drive: the step is found on whole sessions, taken out, and nowhere else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.initial.begin import begin
from smoother.estimate.pauses import pauses_of
from smoother.estimate.preprocess.clock import ONE_CLOCK, Clock, ClockStep, moved
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.estimate.true_time import in_session_time
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.session.load import load_raw
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import IMU_SHAKEN, ClockMove, EstimateReport, Identified, Trajectory

DURATION, AT = 300.0, 140.0


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 5, duration=DURATION)


@pytest.fixture(scope="module")
def session(simulation: Simulation) -> Session:
    return prepare(simulation.raw)


def in_order(t: Array) -> Array:
    """Which rows a reader keeps: those that are later than all before."""
    return np.asarray(t > np.maximum.accumulate(np.concatenate([[-np.inf], t[:-1]])))


def fixes_stepped(session: Session, by: float, at: float = AT) -> Session:
    t = np.where(session.gnss.t > at, session.gnss.t + by, session.gnss.t)
    return replace(session, gnss=replace(session.gnss.select(in_order(t)), t=t[in_order(t)]))


def samples_stepped(session: Session, by: float, *, lost: float = 0.0, at: float = AT) -> Session:
    """Samples that are stamped `by` s later from `at` s on; `lost` s of them after that were not written."""
    imu = session.imu
    assert imu is not None
    t = np.where(imu.t > at, imu.t + by, imu.t)
    keep = in_order(t) & ~((imu.t > at) & (imu.t < at + lost))
    force, rate = imu.specific_force_s[keep], imu.angular_rate_s[keep]
    return replace(session, imu=replace(imu, t=t[keep], specific_force_s=force, angular_rate_s=rate))


def found_in(session: Session) -> tuple[ClockStep, ...]:
    return begin(session, GraphOptions().for_fixes(session.gnss.t), pauses_of).clock.steps


@pytest.mark.parametrize("by", [0.15, 0.4, 1.5, -0.3, -1.0])
def test_fixes_whose_stamps_step_are_moved_back(session: Session, by: float) -> None:
    (step,) = found_in(fixes_stepped(session, by))
    assert step.size == pytest.approx(by, abs=0.02)
    assert abs(step.size - by) < 4.0 * step.sigma
    assert step.t == pytest.approx(AT, abs=2.0)
    assert step.move.moves_fixes
    assert step.move.by == pytest.approx(-step.size)


@pytest.mark.parametrize("by", [0.4, 1.0])
def test_samples_with_a_gap_of_the_size_of_the_step_are_moved_up_to_close_it(session: Session, by: float) -> None:
    (step,) = found_in(samples_stepped(session, by))
    assert step.size == pytest.approx(-by, abs=0.02)
    assert not step.move.moves_fixes
    assert step.move.at == pytest.approx(AT, abs=0.006)
    assert step.move.by == pytest.approx(-by, abs=0.02)


@pytest.mark.parametrize("lost", [0.2, 0.8])
def test_samples_that_were_lost_without_a_trace_are_moved_off(session: Session, lost: float) -> None:
    (step,) = found_in(samples_stepped(session, -lost, lost=lost))
    assert step.size == pytest.approx(lost, abs=0.02)
    assert not step.move.moves_fixes
    assert step.move.at == pytest.approx(AT, abs=0.3)
    assert step.move.by == pytest.approx(step.size)


def test_two_steps_are_two(session: Session) -> None:
    first, second = found_in(fixes_stepped(fixes_stepped(session, 0.4, 90.0), -0.6, 200.0))
    assert (first.size, second.size) == (pytest.approx(0.4, abs=0.03), pytest.approx(-0.6, abs=0.03))


def test_of_few_fixes_steps_are_known_less_well(session: Session) -> None:
    slow = replace(session, gnss=session.gnss.select(np.arange(len(session.gnss)) % 5 == 0))
    assert found_in(slow) == ()
    (step,) = found_in(fixes_stepped(slow, 1.0))
    assert step.size == pytest.approx(1.0, abs=0.15)
    assert step.sigma > 0.02


@pytest.mark.parametrize("preset", ["kart", "kart_harsh", "white"])
def test_what_does_not_step_does_not(preset: str) -> None:
    for seed in (11, 12):
        assert found_in(prepare(simulate_preset(preset, seed, duration=DURATION).raw)) == ()


def late(session: Session, delay: Array) -> Session:
    """The session with each fix stamped as much later, (N,) s."""
    t = session.gnss.t + delay
    return replace(session, gnss=replace(session.gnss.select(in_order(t)), t=t[in_order(t)]))


def test_what_comes_and_goes_or_changes_gradually_is_no_step(session: Session) -> None:
    t = session.gnss.t
    for delay in (
        0.4 * ((t > AT) & (t < AT + 20.0)),
        0.4 * np.clip((t - AT) / 30.0, 0.0, 1.0),
        0.15 * np.sin(2.0 * np.pi * (t - t[0]) / 130.0),
        1e-3 * (t - t[0]),
    ):
        assert found_in(late(session, delay)) == ()


def test_turns_alone_that_are_later_from_some_moment_on_are_no_step(session: Session) -> None:
    imu = session.imu
    assert imu is not None
    at = np.where(imu.t > AT, imu.t - 0.3, imu.t)
    rate = np.stack([np.interp(at, imu.t, imu.angular_rate_s[:, i]) for i in range(3)], axis=1)
    assert found_in(replace(session, imu=replace(imu, angular_rate_s=rate))) == ()


def test_a_box_that_was_turned_round_is_no_step(session: Session) -> None:
    imu = session.imu
    assert imu is not None
    turned = np.where(imu.t[:, None] > AT, np.array([-1.0, -1.0, 1.0]), 1.0)
    force, rate = imu.specific_force_s * turned, imu.angular_rate_s * turned
    assert found_in(replace(session, imu=replace(imu, specific_force_s=force, angular_rate_s=rate))) == ()


def test_beside_the_ends_nothing_is_told(session: Session) -> None:
    assert found_in(fixes_stepped(session, 0.4, 15.0)) == ()
    short = session.gnss.select(np.arange(len(session.gnss)) < 200)
    assert found_in(fixes_stepped(replace(session, gnss=short), 0.4, 25.0)) == ()


def errors(found: Trajectory, simulation: Simulation, session: Session) -> tuple[float, float]:
    """Rms of velocity m/s and of attitude rad, but for what is beside the step."""
    t = found.t[(found.t > 15.0) & (found.t < DURATION - 5.0) & (abs(found.t - AT) > 4.0)]
    rows = np.isin(found.t, t)
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)
    between = np.einsum("nji,njk->nik", truth.R_nb, found.R_nb[rows])
    angle = np.arccos(np.clip(0.5 * (np.trace(between, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    off = found.velocity_n[rows, :2] - truth.velocity_n[:, :2]
    return float(np.sqrt(np.mean(off**2))), float(np.sqrt(np.mean(angle**2)))


def test_a_stepped_session_is_estimated_as_one_without(simulation: Simulation, session: Session) -> None:
    plain = errors(GraphSmoother().estimate(session), simulation, session)
    for stepped in (fixes_stepped(session, 0.4), fixes_stepped(session, -0.3), samples_stepped(session, 0.4)):
        found = GraphSmoother().estimate(stepped)
        velocity, attitude = errors(found, simulation, session)
        assert velocity < 1.1 * plain[0]
        assert attitude < 1.1 * plain[1]
        codes = [problem.code for problem in found.report.problems]
        assert "clock_step" in codes
        assert IMU_SHAKEN not in codes
        latency = found.report.identified["gps_position_latency"]
        assert abs(latency.value - simulation.scenario.gnss.position_latency) < 3.5 * latency.sigma
        assert len(found.report.clock_moves) == 1


@pytest.mark.parametrize("recording", ["kart_adria_first_half", "car_hi600_twin_a", "car_hi600_twin_b"])
def test_real_recordings(recording: str, data_directory: Path) -> None:
    session = prepare(load_raw(data_directory / recording))
    assert found_in(session) == ()
    at = 0.5 * float(session.gnss.t[0] + session.gnss.t[-1])
    (step,) = found_in(fixes_stepped(session, 0.8, at))
    assert step.size == pytest.approx(0.8, abs=0.06)
    assert abs(step.size - 0.8) < 3.0 * step.sigma
    assert step.t == pytest.approx(at, abs=3.0)


STEP = ClockStep(100.0, 0.4, 0.01, 99.0, 102.0, ClockMove(False, 99.8, 0.4))
VAGUE = replace(STEP, last=130.0)


@pytest.mark.parametrize("first", [0, 8])
def test_a_kart_that_is_seen_once_in_two_seconds_tells_no_step(first: int, data_directory: Path) -> None:
    """Between two of those fixes it goes round a bend."""
    session = prepare(load_raw(data_directory / "kart_adria_first_half"))
    seldom = np.arange(len(session.gnss)) % 16 == first
    assert found_in(replace(session, gnss=session.gnss.select(seldom))) == ()


def test_what_is_reported(session: Session) -> None:
    first = float(session.gnss.t[0])
    (said,) = Clock(steps=(STEP,)).problems(session)
    assert said.code == "clock_step"
    assert (
        f"{100.0 - first:.1f} s after the first fix stamps step: from there on fixes come 0.40 ± 0.01 s later"
        in said.text
    )
    assert "taken out of the times of the samples" in said.text
    vague_one = Clock(steps=(replace(VAGUE, size=-0.4),))
    (vague,) = vague_one.problems(replace(session, inputs=("run/imu.csv",)))
    assert vague.text.startswith("imu.csv: ")
    assert "earlier behind the samples, sometime in 31 s, so it is not taken out" in vague.text


def test_what_is_not_placed_is_said_and_left(session: Session) -> None:
    assert Clock(steps=(STEP, VAGUE)).moves == (STEP.move,)
    delay = {"gps_position_latency": Identified(0.2, 0.003, "s", True, "identified")}
    assert ONE_CLOCK.on_both_sides(delay)["gps_position_latency"].sigma == pytest.approx(0.003)
    assert Clock(steps=(STEP,)).on_both_sides(delay)["gps_position_latency"].sigma == pytest.approx(0.00583, abs=1e-4)
    assert Clock(steps=(VAGUE,)).on_both_sides(delay)["gps_position_latency"].sigma == pytest.approx(0.2, abs=1e-3)
    assert moved(session, ()) is session
    assert ONE_CLOCK.taken_out(session) is session


def test_moves_are_told_on_the_clock_of_the_session() -> None:
    zeros = np.zeros((2, 3))
    report = EstimateReport(clock_moves=(ClockMove(True, 100.0, 0.4),))
    found = Trajectory(np.arange(2.0), zeros, zeros, np.stack([np.eye(3)] * 2), zeros, zeros, report=report)
    assert in_session_time(found, 1.02).report.clock_moves == (ClockMove(True, 102.0, pytest.approx(0.408)),)
