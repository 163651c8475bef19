"""Force taken to the time of the rate: what is left of it, what is reported, and what it is worth on real karts."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.estimate.initial import begin as begin_module
from smoother.estimate.preprocess.force_delay import UNSEEN, ForceDelay, advanced, in_step
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.samples import ImuSamples, Session
from smoother.session.load import load_raw
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.units import DEG


def signal(t: np.ndarray) -> np.ndarray:
    """Force of 0.3, 1 and 4 Hz, (N, 3)."""
    return np.asarray(np.sin(2.0 * np.pi * np.outer(t, [0.3, 1.0, 4.0])))


def late(t: np.ndarray, delay: float) -> ImuSamples:
    return ImuSamples(t, signal(t - delay), np.zeros((len(t), 3)))


@pytest.mark.parametrize(("rate", "allowed"), [(25.0, 0.03), (100.0, 2e-3), (200.0, 3e-4)])
@pytest.mark.parametrize("delay", [0.055, -0.055, 0.0201])
def test_the_force_comes_to_the_time_of_the_rate(rate: float, allowed: float, delay: float) -> None:
    t = np.arange(round(20.0 * rate)) / rate
    found = advanced(late(t, delay), delay)
    np.testing.assert_array_equal(found.t, t)
    inside = (t > 0.2) & (t < t[-1] - 0.2)
    error = np.abs(found.specific_force_s - signal(t))[inside]
    assert np.max(error) < allowed  # of the tone of 4 Hz; linear interpolation would leave 0.12 at 25 Hz
    assert np.max(error[:, :2]) < 0.1 * allowed


def test_uneven_stamps_are_interpolated_as_they_are() -> None:
    rng = np.random.default_rng(0)
    t = np.cumsum(rng.uniform(0.005, 0.015, 2000))
    found = advanced(late(t, 0.03), 0.03)
    inside = slice(20, -20)
    error = np.abs(found.specific_force_s - signal(t))[inside]
    assert np.max(error) < 0.02  # of a tone of 4 Hz, between samples up to 15 ms apart: chords are no tangents there
    assert np.max(error[:, 0]) < 1e-4


def test_at_the_ends_and_beside_a_gap_the_force_stays_within_what_was_measured() -> None:
    t = np.arange(2000) / 100.0
    t = t[(t < 8.0) | (t > 9.5)]
    for delay in (0.05, -0.05):
        found = advanced(late(t, delay), delay).specific_force_s
        assert np.all(np.isfinite(found))
        assert np.max(np.abs(found)) < 1.05  # the tones have 1
        away = (np.abs(t - 8.75) > 0.9) & (t > 0.1) & (t < t[-1] - 0.1)
        assert np.max(np.abs(found - signal(t))[away]) < 2e-3
    last = advanced(late(t, 0.05), 0.05).specific_force_s[-1]
    np.testing.assert_allclose(last, signal(t[-1:] - 0.05)[0])


def test_what_is_reported_is_what_was_taken_out() -> None:
    found = ForceDelay(0.05, 0.002, True).identified()
    assert (found.value, found.sigma, found.observable, found.source) == (0.05, 0.002, True, "identified")
    none = ForceDelay(0.003, 0.004, True).identified()
    assert (none.value, none.observable, none.source) == (0.0, False, "default")
    assert none.sigma == pytest.approx(1.0 / np.hypot(1.0 / 0.005, 1.0 / 0.003))  # never more than beforehand
    assert ForceDelay(0.0005, 0.0005, True).identified().observable
    unknown = UNSEEN.identified()
    assert (unknown.value, unknown.sigma, unknown.observable, unknown.source) == (0.0, 0.003, False, "default")


def wheel(delay: float) -> Simulation:
    changes = {"motion_steering": 10.0 * DEG, "imu_accel_delay": delay, "mag": None, "gnss_outages": ()}
    return simulate_preset("kart", 1, duration=100.0, **changes)


def test_a_late_accelerometer_is_found_and_taken_out() -> None:
    simulation = wheel(0.05)
    session = prepare(simulation.raw)
    found = GraphSmoother().estimate(session)
    value = found.report.identified["accel_delay"]
    assert value.source == "identified"
    assert value.value == pytest.approx(0.05, abs=8e-3)
    without = GraphSmoother(GraphOptions(in_step=False)).estimate(session)
    assert without.report.identified["accel_delay"].value == 0.0
    assert found.report.identified["accel_noise"].value < without.report.identified["accel_noise"].value
    rms = []
    for trajectory in (found, without):
        t = trajectory.t[(trajectory.t > 15.0) & (trajectory.t < 95.0)]
        truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)
        error = trajectory.velocity_n[np.isin(trajectory.t, t), :2] - truth.velocity_n[:, :2]
        rms.append(float(np.sqrt(np.mean(error**2))))
    assert rms[0] < rms[1]


def test_an_ordinary_session_is_left_as_it_is() -> None:
    session = prepare(simulate_preset("kart", 0, duration=70.0).raw)
    same, found = in_step(session)
    assert same is session
    assert not found.is_seen


@pytest.mark.parametrize(("recording", "delay"), [("kart_adria_first_half", 0.055), ("kart_lignano_racebox", None)])
def test_real_karts_with_the_logger_on_the_wheel(recording: str, delay: float | None, data_directory: Path) -> None:
    _, found = in_step(prepare(load_raw(data_directory / recording)))
    assert found.is_seen
    assert found.is_found == (delay is not None)
    assert found.delay == pytest.approx(delay or 0.0, abs=0.01)
    assert found.sigma < 4e-3


@pytest.mark.parametrize("recording", ["car_hi600_rtk", "car_hi600_twin_a", "car_hi600_twin_b", "car_comma2k19"])
def test_a_logger_fixed_in_a_car_is_not_reported(recording: str, data_directory: Path) -> None:
    _, found = in_step(prepare(load_raw(data_directory / recording)))
    assert not found.is_seen


def test_a_delay_that_the_fixes_do_not_believe_is_not_taken_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """As hairpins seem to show one, into and out of which a nose turns on its own."""
    delay = -0.1
    session = prepare(simulate_preset("kart", 1, duration=100.0, gnss_outages=()).raw)

    def seen(given: Session) -> tuple[Session, ForceDelay]:
        assert given.imu is not None
        return replace(given, imu=advanced(given.imu, delay)), ForceDelay(delay, 0.002, True)

    monkeypatch.setattr(begin_module, "in_step", seen)
    found = GraphSmoother().estimate(session).report.identified
    without = GraphSmoother(GraphOptions(in_step=False)).estimate(session).report.identified
    assert found == without
