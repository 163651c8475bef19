"""Samples and fixes of devices whose clocks show different times."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.fixes.pieces import fit_path
from smoother.estimate.initial.begin import begin
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.path_motion import PathMotion
from smoother.estimate.pauses import pauses_of
from smoother.estimate.preprocess.clock import ONE_CLOCK, Clock, with_samples_at
from smoother.estimate.preprocess.search import DELAY, search_clock
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.session.load import load_raw
from smoother.sim.simulation import Simulation, simulate_preset

DURATION = 240.0


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 3, duration=DURATION, gnss_outages=())


@pytest.fixture(scope="module")
def session(simulation: Simulation) -> Session:
    return prepare(simulation.raw)


def ahead(session: Session, offset: float) -> Session:
    """The session with the samples' clock ahead of the fixes'."""
    return with_samples_at(session, lambda t: np.asarray(t + offset))


def path_of(session: Session) -> PathMotion:
    return PathMotion(session.gnss.t, fit_path(session).at(session.gnss.t).velocity_n)


def found_in(session: Session) -> float | None:
    assert session.imu is not None
    found = search_clock(session.imu, path_of(session))
    return None if found is None else found[0]


@pytest.mark.parametrize("offset", [-61.0, -18.0, -1.3, 1.3, 7.4, 40.0])
def test_an_offset_is_found_but_for_the_delay_of_the_receiver(
    simulation: Simulation, session: Session, offset: float
) -> None:
    late = simulation.scenario.gnss.velocity_latency
    assert found_in(ahead(session, offset)) == pytest.approx(offset - late + DELAY, abs=0.1)


@pytest.mark.parametrize("offset", [-18.0, 1.3])
def test_what_is_offset_is_estimated_as_what_is_not(simulation: Simulation, session: Session, offset: float) -> None:
    found = GraphSmoother().estimate(ahead(session, offset))
    assert "clock_offset" in [problem.code for problem in found.report.problems]
    # times are those of the fixes, which come a latency after they are true; some of it is left as theirs
    latency = found.report.identified["gps_velocity_latency"].value
    assert isinstance(latency, float)
    late = simulation.scenario.gnss.velocity_latency - latency
    rows = (found.t > 20.0) & (found.t < DURATION - 25.0)
    truth = simulation.truth.trajectory(found.t[rows] - late, simulation.scenario.lever_arm_b, session.origin)
    assert np.sqrt(np.mean((found.velocity_n[rows, :2] - truth.velocity_n[:, :2]) ** 2)) < 0.1


def test_clocks_that_differ_and_drift(session: Session) -> None:
    def other(t: Array) -> Array:
        return np.asarray(t + 12.0 + 1e-3 * t)

    clock = begin(with_samples_at(session, other), GraphOptions(), pauses_of).clock
    assert clock.drift == pytest.approx(1e-3, abs=1e-4)
    assert clock.offset == pytest.approx(12.0, abs=0.4)


def test_one_clock_is_not_looked_at_again(session: Session) -> None:
    assert begin(session, GraphOptions(), pauses_of).clock.offset == 0.0


@pytest.mark.parametrize("recording", ["kart_adria_first_half", "kart_lignano_racebox", "car_hi600_rtk"])
def test_real_recordings(recording: str, data_directory: Path) -> None:
    session = prepare(load_raw(data_directory / recording))
    begun = begin(ahead(session, 18.0), GraphOptions(), pauses_of)
    assert begun.clock.offset == pytest.approx(18.0, abs=0.4)


def test_samples_of_another_drive_have_no_offset(session: Session) -> None:
    other = prepare(simulate_preset("kart", 1, duration=DURATION, track="tinbarn").raw)
    assert other.imu is not None
    assert search_clock(other.imu, path_of(session)) is None


def test_laps_that_are_all_the_same_tell_no_offset_but_the_smallest(session: Session) -> None:
    """Which of the laps it was nobody can tell; that the clocks were a lap apart is not the first thing to believe."""
    imu, lap = session.imu, 50.0
    assert imu is not None
    t, fixes = np.arange(0.0, 400.0, 0.02), np.arange(0.0, 400.0, 0.2)

    def repeated(at: Array, given: Array, values: Array) -> Array:
        return np.stack([np.interp(100.0 + np.mod(at, lap), given, row) for row in values.T], axis=1)

    path = PathMotion(fixes, repeated(fixes, session.gnss.t, session.gnss.velocity_n))
    force, rate = (repeated(t, imu.t, values) for values in (imu.specific_force_s, imu.angular_rate_s))
    found = search_clock(replace(imu, t=t + 20.0, specific_force_s=force, angular_rate_s=rate), path)
    assert found is None or found[0] == pytest.approx(20.0, abs=0.3)


def test_too_little_in_common_is_nothing(session: Session) -> None:
    assert session.imu is not None
    few = slice(100, 250)  # 30 s
    assert search_clock(session.imu, PathMotion(session.gnss.t[few], session.gnss.velocity_n[few])) is None


def test_what_is_said(session: Session) -> None:
    assert ONE_CLOCK.problems(session) == ()
    (said,) = Clock(offset=-18.04).problems(session)
    assert said.text.startswith("the samples' clock is 18.0 s behind that of the fixes; taken out")
