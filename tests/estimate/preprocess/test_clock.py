"""Samples and fixes stamped by two clocks: the drift is found on whole sessions, taken out, and nowhere else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.initial.begin import begin
from smoother.estimate.preprocess.clock import ONE_CLOCK, Clock, with_samples_at
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Session
from smoother.session.load import load_raw
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory

DURATION = 300.0


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 3, duration=DURATION)


@pytest.fixture(scope="module")
def session(simulation: Simulation) -> Session:
    return prepare(simulation.raw)


def with_drift(session: Session, drift: float) -> Session:
    """The session as a logger writes it whose samples' clock begins with that of the fixes, and runs fast."""
    zero = session.gnss.t[0]
    return with_samples_at(session, lambda t: np.asarray(zero + (t - zero) * (1.0 + drift)))


def found_in(session: Session) -> Clock:
    return begin(session, GraphOptions().for_fixes(session.gnss.t)).clock


@pytest.mark.parametrize("drift", [2e-4, -2e-4, 1e-3, 8e-3, -0.014])
def test_the_drift_of_a_clock_is_found_whether_it_is_a_crystal_or_a_nominal_rate(
    session: Session, drift: float
) -> None:
    found, plain = found_in(with_drift(session, drift)), found_in(session)
    assert found.drifts
    assert 3e-6 < found.drift_sigma < 3e-5
    assert found.drift - plain.drift == pytest.approx(drift, abs=0.5 * found.drift_sigma)  # same noise: less than one
    assert found.drift == pytest.approx(drift, abs=3.5 * found.drift_sigma)


@pytest.mark.parametrize("preset", ["kart", "kart_harsh", "white"])
def test_one_clock_is_no_two(preset: str) -> None:
    for seed in (11, 12):
        aligned = begin(prepare(simulate_preset(preset, seed, duration=DURATION).raw), GraphOptions())
        found = aligned.clock
        assert not found.drifts and not aligned.unusable
        assert abs(found.drift) < 4.0 * found.drift_sigma


def test_short_sessions_and_few_fixes_tell_nothing(session: Session) -> None:
    few = np.arange(len(session.gnss))
    for kept in (few < 200, few % 20 == 0):
        assert found_in(replace(session, gnss=session.gnss.select(kept))) == ONE_CLOCK


def test_fixes_a_second_apart_tell_clocks_that_are_far_off(session: Session) -> None:
    slow = replace(session, gnss=session.gnss.select(np.arange(len(session.gnss)) % 5 == 0))
    assert not found_in(slow).drifts
    found = found_in(with_drift(slow, 1e-3))
    assert found.drift == pytest.approx(1e-3, abs=2e-4)
    assert found_in(with_drift(slow, 8e-3)).drifts


def test_a_step_between_the_clocks_is_no_drift(session: Session) -> None:
    assert session.imu is not None
    t = session.imu.t
    for later in (0.3 * (t > t[0] + 150.0), 1e-3 * np.maximum(t - t[0] - 150.0, 0.0)):
        assert not found_in(replace(session, imu=replace(session.imu, t=t + later))).drifts


def test_in_a_minute_or_two_only_clocks_that_are_far_off_show() -> None:
    short = prepare(simulate_preset("kart", 3, duration=120.0, gnss_outages=()).raw)
    assert not found_in(with_drift(short, 1e-4)).drifts
    assert found_in(with_drift(short, 3e-3)).drifts


@pytest.mark.parametrize("seed", [83, 431])
def test_what_slow_karts_show_by_chance_is_no_clock(seed: int) -> None:
    slow = simulate_preset("kart_harsh", seed, duration=90.0, motion_top_speed=7.0, motion_grip_g=0.8, imu_rate=100.0)
    assert not found_in(prepare(slow.raw)).drifts


@pytest.mark.parametrize(
    ("preset", "seed", "changes"),
    [
        ("kart", 214, {"track": "longmeadow", "motion_top_speed": 8.0, "imu_rate": 50.0}),
        ("kart_harsh", 404, {"track": "tinbarn", "motion_top_speed": 9.0, "gnss_rate": 25.0}),
    ],
)
def test_nor_is_what_noise_makes_of_quick_fixes_and_few_samples(
    preset: str, seed: int, changes: dict[str, float | str]
) -> None:
    """A change of what is felt that is nearly all noise: 290 and 200 ppm were taken out, at sigmas of 50 and 40."""
    slow = prepare(simulate_preset(preset, seed, duration=240.0, **changes).raw)
    assert not found_in(slow).drifts


def test_turns_alone_that_are_later_and_later_are_no_clock(session: Session) -> None:
    assert session.imu is not None
    t, rate = session.imu.t, session.imu.angular_rate_s
    late = t + 5e-4 * (t - t[0])
    later = np.stack([np.interp(late, t, rate[:, i]) for i in range(3)], axis=1)
    assert not found_in(replace(session, imu=replace(session.imu, angular_rate_s=later))).drifts


@pytest.mark.parametrize("drift", [5e-4, -5e-4])
def test_a_drift_is_found_beside_forces_that_are_late_now_more_now_less(session: Session, drift: float) -> None:
    assert session.imu is not None
    t, force = session.imu.t, session.imu.specific_force_s
    late = t + 0.04 * np.sin(2.0 * np.pi * (t - t[0]) / 70.0 + np.pi)
    wandering = np.stack([np.interp(late, t, force[:, i]) for i in range(3)], axis=1)
    found = found_in(with_drift(replace(session, imu=replace(session.imu, specific_force_s=wandering)), drift))
    assert found.drifts
    assert found.drift == pytest.approx(drift, abs=3.5 * found.drift_sigma)


@pytest.mark.parametrize("place", [0.2, 0.35, 0.5, 0.65, 0.8])
def test_a_step_is_no_drift_wherever_it_is(session: Session, place: float) -> None:
    assert session.imu is not None
    t = session.imu.t
    for size in (0.1, 0.3):
        later = size * (t > t[0] + place * DURATION)
        assert not found_in(replace(session, imu=replace(session.imu, t=t + later))).drifts


def test_a_receiver_that_is_late_now_more_now_less_is_no_clock(session: Session) -> None:
    gnss = session.gnss
    late = gnss.t + 0.15 * np.sin(2.0 * np.pi * (gnss.t - gnss.t[0]) / 130.0 + 0.7)
    aligned = begin(replace(session, gnss=replace(gnss, t=late)), GraphOptions())
    assert not aligned.clock.drifts and not aligned.unusable


def with_step(session: Session, size: float, place: float = 0.5) -> Session:
    """The samples' clock jumps ahead by `size` s; one that goes back leaves out what it repeats."""
    assert session.imu is not None
    t = session.imu.t + np.where(session.imu.t > session.imu.t[0] + place * DURATION, size, 0.0)
    new = np.append(True, np.diff(np.maximum.accumulate(t)) > 0.0)
    imu = session.imu
    imu = replace(imu, t=t[new], specific_force_s=imu.specific_force_s[new], angular_rate_s=imu.angular_rate_s[new])
    return replace(session, imu=imu, mag=None)


@pytest.mark.parametrize(("size", "place"), [(0.08, 0.5), (0.1, 0.2), (0.3, 0.7), (1.5, 0.5), (-0.3, 0.5)])
def test_after_a_step_the_fixes_are_smoothed_alone(session: Session, size: float, place: float) -> None:
    found = GraphSmoother().estimate(with_step(session, size, place))
    assert found.report.mode == "gps-only"
    assert "clock_step" in [problem.code for problem in found.report.problems]


def speed_error(trajectory: Trajectory, simulation: Simulation, session: Session) -> float:
    t = trajectory.t[(trajectory.t > 15.0) & (trajectory.t < DURATION - 5.0)]
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, session.origin)
    error = trajectory.velocity_n[np.isin(trajectory.t, t), :2] - truth.velocity_n[:, :2]
    return float(np.sqrt(np.mean(error**2)))


def test_what_drifts_is_estimated_as_what_does_not(simulation: Simulation, session: Session) -> None:
    plain = speed_error(GraphSmoother().estimate(session), simulation, session)
    for drift in (1e-3, 8e-3):
        found = GraphSmoother().estimate(with_drift(session, drift))
        assert speed_error(found, simulation, session) < 1.03 * plain
        assert "clock_drift" in [problem.code for problem in found.report.problems]
        value = found.report.identified["imu_clock_drift"]
        assert value.observable
        assert value.value == pytest.approx(1e6 * drift, abs=50.0)
        latency = found.report.identified["gps_position_latency"]
        assert abs(latency.value - simulation.scenario.gnss.position_latency) < 3.5 * latency.sigma


def test_clocks_drift_on_in_a_pause() -> None:
    simulation = simulate_preset("kart", 4, duration=240.0, gnss_outages=())
    drift, pause = 4e-4, 1800.0
    session = prepare(simulation.raw)
    assert session.imu is not None

    def paused(t: Array) -> Array:
        return np.asarray(np.where(t > 120.0, t + pause, t))

    imu = replace(session.imu, t=paused(session.imu.t))
    apart = replace(session, gnss=replace(session.gnss, t=paused(session.gnss.t)), imu=imu, mag=None)
    found = GraphSmoother().estimate(with_drift(apart, drift))  # 0.7 s in the pause alone
    assert found.report.identified["imu_clock_drift"].value == pytest.approx(1e6 * drift, abs=10.0)
    rows = (found.t > pause + 140.0) & (found.t < pause + 235.0)
    truth = simulation.truth.trajectory(found.t[rows] - pause, simulation.scenario.lever_arm_b, session.origin)
    assert np.sqrt(np.mean((found.velocity_n[rows, :2] - truth.velocity_n[:, :2]) ** 2)) < 0.12


@pytest.mark.parametrize(
    "recording", ["kart_adria_first_half", "kart_lignano_racebox", "car_hi600_rtk", "car_hi600_twin_a"]
)
def test_real_recordings_of_one_clock(recording: str, data_directory: Path) -> None:
    """In one the box turns with the wheel, and delays of the axes change each for itself; one stamps what arrives."""
    session = prepare(load_raw(data_directory / recording))
    assert not found_in(session).drifts
    drift = 1.5 / float(np.ptp(session.gnss.t))
    apart = found_in(with_drift(session, drift))
    assert apart.drifts
    assert apart.drift == pytest.approx(drift, abs=min(6e-4, 3.5 * apart.drift_sigma))


@pytest.mark.parametrize("place", [0.5, 0.8])
def test_a_hole_in_the_fixes_of_a_real_kart_makes_no_drift(place: float, data_directory: Path) -> None:
    """Its axes seem to drift, by a third apart; so they do with a part of it, by a little less."""
    session = prepare(load_raw(data_directory / "kart_adria_first_half"))
    gnss = session.gnss
    since = gnss.t - gnss.t[0] - place * np.ptp(gnss.t)
    holed = replace(session, gnss=gnss.select((since < 0.0) | (since > 30.0)))
    assert not found_in(holed).drifts


def test_what_changes_a_lap_by_less_than_slip_does_is_no_clock() -> None:
    assert not found_in(with_drift(prepare(simulate_preset("white", 1, duration=DURATION).raw), 4e-5)).drifts


def test_what_is_reported() -> None:
    found = Clock(drift=5e-5, drift_sigma=3e-6, drifts=True).identified()
    assert (found.value, found.sigma, found.unit, found.observable) == (pytest.approx(50.0), 3.0, "ppm", True)
    none = Clock(drift=3e-6, drift_sigma=4e-6).identified()
    assert (none.value, none.source) == (0.0, "default")
    assert none.sigma == pytest.approx(1.0 / np.hypot(1.0 / 5.0, 1.0 / 50.0))  # what a quartz may do tells as well
    unseen = ONE_CLOCK.identified()
    assert (unseen.sigma, unseen.observable) == (pytest.approx(50.0), False)
    assert ONE_CLOCK.problems(DURATION) == ()
    (slow,) = Clock(drift=-2e-4, drift_sigma=3e-6, drifts=True).problems(DURATION)
    assert "runs 200 ppm slow against that of the fixes, 0.06 s over the session" in slow.text
