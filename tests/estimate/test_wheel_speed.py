"""The speed of a wheel in simulated sessions: its constants within their sigmas, a shorter way astray in an outage."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from smoother import api
from smoother.estimate.preprocess.clock import with_samples_at
from smoother.estimate.preprocess.pauses import Pauses, closed_up
from smoother.prepare import prepare
from smoother.samples import Session, WheelSpeed
from smoother.sim.scenario import Interval
from smoother.sim.simulation import Simulation
from smoother.trajectory import Trajectory

SEEDS = range(4)
BEGIN, LASTS = 80.0, 15.0  # s, of the outage
TRUE = {"wheel_scale": 0.03, "wheel_slip": 0.004, "wheel_side": 0.5}


@cache
def drive(seed: int) -> tuple[Simulation, Session]:
    sensor = TRUE | {"wheel_rate": 50.0, "wheel_noise": 0.05}
    simulation = api.simulate("kart", seed, duration=180.0, gnss_outages=(Interval(BEGIN, LASTS),), **sensor)
    return simulation, prepare(simulation.raw)


@cache
def smoothed(seed: int, with_wheel: bool) -> Trajectory:
    return api.smooth(drive(seed)[1], without=() if with_wheel else ("wheel_speed",))


def off(trajectory: Trajectory) -> list[float]:
    """Errors of the constants over their sigmas."""
    found = trajectory.report.identified
    pairs = ((found[name].value, found[name].sigma, true) for name, true in TRUE.items())
    return [float((np.ravel(value)[0] - true) / np.ravel(sigma)[0]) for value, sigma, true in pairs]


@pytest.mark.slow
def test_scale_slip_and_side_are_off_by_their_sigmas() -> None:
    errors = np.array([off(smoothed(seed, True)) for seed in SEEDS])
    assert np.all(np.sqrt(np.mean(errors**2, axis=0)) < 1.6)
    sigmas = [smoothed(seed, True).report.identified["wheel_scale"].sigma for seed in SEEDS]
    assert np.all(np.array(sigmas) < 1.5e-3)


@pytest.mark.slow
def test_the_recording_decides_how_noisy_a_wheel_is() -> None:
    simulation = api.simulate("kart", 1, duration=180.0, wheel_rate=50.0, wheel_noise=1.0)
    found = api.smooth(prepare(simulation.raw)).report.identified["wheel_speed_noise"]
    assert found.value == pytest.approx(1.0 / np.sqrt(5.0), rel=0.2)  # five samples are in a reading


@pytest.mark.slow
def test_errors_in_an_outage_shrink_and_sigmas_stay_honest() -> None:
    squares, expected = np.zeros(2), np.zeros(2)
    for seed in SEEDS:
        simulation, session = drive(seed)
        for i, with_wheel in enumerate((False, True)):
            found = smoothed(seed, with_wheel)
            truth = simulation.truth.trajectory(found.t, simulation.scenario.lever_arm_b, session.origin)
            begin = simulation.truth.clock.to_session(np.array([BEGIN]))[0]
            rows = (found.t > begin) & (found.t < begin + LASTS)
            assert found.sigmas is not None
            squares[i] += np.sum((found.velocity_n - truth.velocity_n)[rows, :2] ** 2)
            expected[i] += np.sum(found.sigmas.velocity_n[rows, :2] ** 2)
    without, with_wheel = np.sqrt(squares)
    assert with_wheel < 0.85 * without
    assert expected[1] < 0.85**2 * expected[0]
    assert np.all((squares / expected > 0.4) & (squares / expected < 2.0))


@pytest.mark.slow
def test_a_wheel_that_locks_and_spins_at_times_is_still_of_use() -> None:
    _, session = drive(0)
    wheel = session.wheel_speed
    assert wheel is not None
    phase = wheel.t % 30.0
    factor = np.where(phase < 2.5, 0.3, np.where((phase > 15.0) & (phase < 17.5), 1.5, 1.0))
    skidding = replace(session, wheel_speed=WheelSpeed(wheel.t, factor * wheel.speed))
    found = api.smooth(skidding)
    scale = found.report.identified["wheel_scale"]
    assert abs(float(np.ravel(scale.value)[0]) - TRUE["wheel_scale"]) < 0.005
    assert found.report.residuals["wheel_speed"].rejected >= 8


def test_a_session_without_the_file_has_no_wheel_speed() -> None:
    simulation = api.simulate("white", 1, duration=30.0)
    found = api.smooth(prepare(simulation.raw))
    assert not any(name.startswith("wheel") for name in found.report.identified)
    assert "wheel_speed" not in found.report.residuals


def test_a_wheel_stays_on_the_clock_of_the_samples() -> None:
    simulation = api.simulate("white", 1, duration=60.0, wheel_rate=20.0)
    session = prepare(simulation.raw)
    wheel = session.wheel_speed
    assert wheel is not None
    later = with_samples_at(session, lambda t: t + 0.5).wheel_speed
    assert later is not None
    np.testing.assert_allclose(later.t, wheel.t + 0.5)
    fixes = session.gnss.select((session.gnss.t < 19.5) | (session.gnss.t > 30.5))
    closed = closed_up(replace(session, gnss=fixes), Pauses(np.array([20.0]), np.array([10.0]))).wheel_speed
    assert closed is not None and len(closed.t) < len(wheel.t) - 190
    np.testing.assert_array_equal(closed.speed, wheel.speed[(wheel.t < 20.0) | (wheel.t >= 30.0)])
