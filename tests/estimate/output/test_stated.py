"""Settings that a session contradicts: each is said with what the session tells, and those that are right are not."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from smoother import so3
from smoother.config import GnssTiming, ImuNoise, Mounting, SessionConfig
from smoother.estimate.judge.quality import assess
from smoother.estimate.output.stated import contradicted_filter
from smoother.estimate.smoother import GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Problem
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory
from smoother.units import DEG


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 51, duration=120.0)


def with_settings(simulation: Simulation, config: SessionConfig) -> Trajectory:
    return GraphSmoother().estimate(prepare(replace(simulation.raw, config=config)))


def contradictions(simulation: Simulation, config: SessionConfig, code: str = "stated_wrong") -> list[Problem]:
    """What is said of settings. What is wrong by more than error bars is in the reasons of the quality gate, too."""
    trajectory = with_settings(simulation, config)
    wrong = [problem for problem in trajectory.report.problems if problem.code.startswith("stated_")]
    reasons = assess(prepare(simulation.raw), trajectory).reasons
    for problem in wrong:
        assert (problem.text.partition(": ")[0] in reasons) == (problem.code == "stated_wrong")
    return [problem for problem in wrong if problem.code == code]


def test_what_is_right_is_not_contradicted(simulation: Simulation) -> None:
    truth, receiver, imu = simulation.scenario, simulation.scenario.gnss, simulation.scenario.imu
    assert imu is not None
    settings = SessionConfig(
        mounting=Mounting(truth.lever_arm_b, truth.R_bs),
        gps=GnssTiming(receiver.position_latency, receiver.velocity_latency),
        imu=ImuNoise(imu.accel_noise, imu.gyro_noise),
    )
    for code in ("stated_wrong", "stated_noise_wrong"):
        assert contradictions(simulation, settings, code) == []
    assert contradictions(simulation, SessionConfig()) == []


@pytest.mark.parametrize("off", [0.1, -0.15])
@pytest.mark.parametrize("name", ["position_latency", "velocity_latency"])
def test_a_wrong_delay_is_named_with_the_one_that_the_motion_tells(
    simulation: Simulation, name: str, off: float
) -> None:
    true = getattr(simulation.scenario.gnss, name)
    (problem,) = contradictions(simulation, SessionConfig(gps=GnssTiming(**{name: true + off})))
    assert problem.text.startswith(f"[gps] {name} is stated as")
    (told,) = re.findall(r"it tells about (-?[\d.]+) s", problem.text)
    assert float(told) == pytest.approx(true, abs=0.4 * abs(off))


def test_of_two_delays_and_an_arm_that_are_stated_the_wrong_one_is_named(simulation: Simulation) -> None:
    truth, receiver = simulation.scenario, simulation.scenario.gnss
    timing = GnssTiming(receiver.position_latency + 0.15, receiver.velocity_latency)
    (problem,) = contradictions(simulation, SessionConfig(gps=timing, mounting=Mounting(truth.lever_arm_b)))
    assert "position_latency" in problem.text


def test_a_delay_that_an_arm_makes_up_for_is_what_is_blamed(simulation: Simulation) -> None:
    true = simulation.scenario.gnss.position_latency
    trajectory = with_settings(simulation, SessionConfig(gps=GnssTiming(true + 0.35)))
    report = trajectory.report
    texts = {problem.code: problem.text for problem in report.problems}
    assert "position_latency is stated as" in texts["stated_wrong"]
    assert not assess(prepare(simulation.raw), trajectory).passed


@pytest.mark.parametrize("times", [-1.0, 10.0])
def test_a_wrong_arm_is_named(simulation: Simulation, times: float) -> None:
    arm = np.array([0.6, -0.5, 0.3])
    of_arm = simulate_preset("kart", 52, duration=120.0, lever_arm_b=arm)
    assert contradictions(of_arm, SessionConfig(mounting=Mounting(arm))) == []
    (problem,) = contradictions(of_arm, SessionConfig(mounting=Mounting(times * arm)))
    assert problem.text.startswith("[mounting] lever_arm_b is stated as")


@pytest.mark.parametrize("turn", [[0.0, 0.0, 10.0], [6.0, 0.0, 0.0], [0.0, -6.0, 0.0], [0.0, 0.0, 90.0]])
def test_a_wrong_mounting_is_named_with_the_one_that_the_drive_shows(simulation: Simulation, turn: list[float]) -> None:
    true = simulation.scenario.R_bs
    wrong = so3.exp(np.array(turn) * DEG) @ true
    (problem,) = contradictions(simulation, SessionConfig(mounting=Mounting(R_bs=wrong)))
    told = np.array(re.findall(r"-?\d\.\d{3}", problem.text), dtype=np.float64).reshape(3, 3)
    assert np.linalg.norm(so3.log(told @ true.T)) < 2.5 * DEG


@pytest.mark.parametrize("times", [0.05, 20.0])
@pytest.mark.parametrize("name", ["accel_noise", "gyro_noise"])
def test_a_density_that_the_samples_contradict_is_named(simulation: Simulation, name: str, times: float) -> None:
    true = getattr(simulation.scenario.imu, name)
    (problem,) = contradictions(simulation, SessionConfig(imu=ImuNoise(**{name: times * true})), "stated_noise_wrong")
    assert problem.text.startswith(f"[imu] {name} is stated as")


def behind_filter(simulation: Simulation, delay: float, *, is_true: bool) -> Simulation:
    """Samples of which session.toml says that a low-pass holds them back by `delay` s, as the reader hands them on."""
    imu = simulation.raw.imu
    assert imu is not None
    if is_true:
        kept = np.exp(-float(np.median(np.diff(imu.t))) / delay)
        accel, gyro = (lfilter([1.0 - kept], [1.0, -kept], values, axis=0) for values in (imu.accel, imu.gyro))
        imu = replace(imu, accel=accel, gyro=gyro)
    raw = replace(simulation.raw, imu=replace(imu, t=imu.t - delay))
    return replace(simulation, raw=raw)


@pytest.mark.parametrize("preset", ["kart", "white"])
def test_a_delay_of_a_low_pass_that_the_vibration_contradicts_is_named(preset: str) -> None:
    simulation, config = simulate_preset(preset, 53, duration=120.0), SessionConfig(imu_delay=0.12)
    (problem,) = contradictions(behind_filter(simulation, 0.12, is_true=False), config)
    assert problem.text.startswith("[imu] delay is stated as 0.12 s")


@pytest.mark.parametrize("delay", [0.006, 0.05, 0.15])
def test_a_delay_of_a_low_pass_that_was_there_is_not(delay: float) -> None:
    for preset in ("kart", "kart_harsh"):
        simulation = behind_filter(simulate_preset(preset, 54, duration=100.0), delay, is_true=True)
        assert simulation.raw.imu is not None
        session = replace(prepare(simulation.raw), config=SessionConfig(imu_delay=delay))
        assert contradicted_filter(session) == ()


def test_axes_that_are_wrong_are_blamed_alone(simulation: Simulation) -> None:
    raw = simulation.raw
    assert raw.imu is not None
    wrong = replace(raw, imu=replace(raw.imu, gyro=raw.imu.gyro * [1.0, 1.0, -1.0]))
    config = SessionConfig(mounting=Mounting(R_bs=simulation.scenario.R_bs))
    problems = with_settings(replace(simulation, raw=wrong), config).report.problems
    codes = [problem.code for problem in problems]
    assert "imu_axes_disagree" in codes and "stated_wrong" not in codes
