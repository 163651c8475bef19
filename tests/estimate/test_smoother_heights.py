"""The smoother where fixes have no heights or few, and on ground that rises."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG, STANDARD_GRAVITY

from .roads import country_road
from .smoothed import smoothed


@pytest.mark.parametrize("solver", ["batch", "isam2"])
def test_fixes_without_a_height_are_as_good_on_the_level(solver: str) -> None:
    simulation = simulate_preset("kart", 6, duration=100.0)
    session = prepare(simulation.raw)
    level = replace(session, gnss=replace(session.gnss, alt_m=np.full(len(session.gnss), np.nan)))
    with_height, without = (smoothed(simulation, s, GraphOptions(solver=solver)) for s in (session, level))
    assert without.trajectory.report.mode == "full"
    driving = without.trajectory.speed > 5.0
    one, other = (np.sqrt(np.mean(s.velocity_error_n[driving, :2] ** 2)) for s in (with_height, without))
    assert other < 1.05 * one
    assert np.max(np.sqrt(np.mean(without.euler_error[driving] ** 2, axis=0))) < 1.5 * DEG
    sigmas = without.trajectory.sigmas
    assert sigmas is not None
    # where up is nobody knows; how fast it goes there the samples know, but for how the ground rises
    assert np.all((sigmas.position_n[:, 2] > 100.0) & (sigmas.position_n[:, 2] < 110.0))
    ground = 0.03 * without.trajectory.speed
    assert np.all(sigmas.velocity_n[driving, 2] > ground[driving])
    climb = (without.velocity_error_n[:, 2] / np.sqrt(sigmas.velocity_n[:, 2] ** 2 - ground**2))[driving]
    assert 0.5 < np.sqrt(np.mean(climb**2)) < 1.5


@pytest.mark.parametrize("solver", ["batch", "isam2"])
def test_one_height_is_enough_for_a_session(solver: str) -> None:
    """From there the samples would carry it away by kilometres."""
    simulation = simulate_preset("kart", 61, duration=110.0, gnss_outages=(), motion_standstill=None)
    session = prepare(simulation.raw)
    first = np.where(np.arange(len(session.gnss)) == 0, session.gnss.alt_m, np.nan)
    found = smoothed(simulation, replace(session, gnss=replace(session.gnss, alt_m=first)), GraphOptions(solver=solver))
    assert found.trajectory.report.mode == "full"
    sigmas = found.trajectory.sigmas
    assert sigmas is not None
    assert np.max(np.abs(found.error_n[:, 2])) < 15.0
    assert np.sqrt(np.mean((found.velocity_error_n[:, 2] / sigmas.velocity_n[:, 2]) ** 2)) < 1.6


def test_fixes_once_a_second_wander_as_much_as_they_do() -> None:
    """White noise is first taken for ten times as much: beside that heights hardly seem to wander, and hold it."""
    simulation = simulate_preset("kart", 501, duration=300.0, gnss_rate=1.0)
    found = smoothed(simulation, prepare(simulation.raw))
    sigmas = found.trajectory.sigmas
    assert sigmas is not None
    driving = found.trajectory.speed > 5.0
    up = (found.velocity_error_n / sigmas.velocity_n)[driving, 2]
    assert np.sqrt(np.mean(up**2)) < 1.8
    noise = found.trajectory.report.identified["gps_position_noise"].value
    assert simulation.scenario.gnss.white_up < np.asarray(noise)[2] < 1.8 * simulation.scenario.gnss.white_up


def test_without_heights_the_ground_may_rise() -> None:
    """A level drive put on a slope: what it climbs nobody measured, and the sigma of the velocity up knows."""
    simulation, slope = simulate_preset("kart", 6, duration=120.0, gnss_outages=()), 0.04
    session, imu = prepare(simulation.raw), simulation.scenario.imu
    assert session.imu is not None and imu is not None
    gravity_n = STANDARD_GRAVITY * np.array([np.sin(slope), 0.0, np.cos(slope) - 1.0])
    felt_b = np.einsum("nji,j->ni", simulation.truth.at(session.imu.t).R_nb, gravity_n)
    force_s = session.imu.specific_force_s + felt_b @ simulation.scenario.R_bs
    blind = replace(session.gnss, alt_m=np.full(len(session.gnss), np.nan))
    uphill = replace(session, gnss=blind, imu=replace(session.imu, specific_force_s=force_s))
    found = GraphSmoother().estimate(uphill)
    truth = simulation.truth.trajectory(found.t, simulation.scenario.lever_arm_b, session.origin)
    assert found.sigmas is not None and found.report.mode == "full"
    driving = found.speed > 5.0
    off = found.velocity_n[:, 2] - slope * truth.velocity_n[:, 0]
    assert np.sqrt(np.mean((off / found.sigmas.velocity_n[:, 2])[driving] ** 2)) < 1.5


def test_without_any_height_a_road_may_climb() -> None:
    """The ground is taken to be level then, and 5 % of slope are 0.7 m/s: 6 of the sigmas of a level road."""
    road = country_road(slope=0.05)
    gnss = road.session.gnss
    level = replace(gnss, alt_m=np.full(len(gnss), np.nan), velocity_n=gnss.velocity_n * [1.0, 1.0, np.nan])
    found = GraphSmoother().estimate(replace(road.session, gnss=level))
    assert found.report.mode == "full" and found.sigmas is not None
    off = found.velocity_n[:, 2] - np.interp(found.t, road.t, road.velocity_n[:, 2])
    assert np.sqrt(np.mean((off / found.sigmas.velocity_n[:, 2]) ** 2)) < 1.5


def test_vertical_velocities_of_receivers_err_slowly() -> None:
    """By 0.02 m/s, as recorded ones do: nothing in a session shows it, and fixes are no judges of minutes."""
    road = country_road()
    gnss = road.session.gnss
    slow = 0.02 * np.sqrt(2.0) * np.sin(2.0 * np.pi * gnss.t / 60.0)
    drifting = replace(gnss, velocity_n=gnss.velocity_n + slow[:, None] * [0.0, 0.0, 1.0])
    found = GraphSmoother().estimate(replace(road.session, gnss=drifting))
    assert found.sigmas is not None
    off = found.velocity_n[:, 2] - np.interp(found.t, road.t, road.velocity_n[:, 2])
    inside = (found.t > 5.0) & (found.t < road.t[-1] - 5.0)
    assert 0.7 < np.sqrt(np.mean((off / found.sigmas.velocity_n[:, 2])[inside] ** 2)) < 1.3


@pytest.mark.parametrize("height", [0.0, 0.7])
def test_a_car_that_rocks_swings_its_antenna_by_an_unknown_height(height: float) -> None:
    road = country_road(rocking=0.03, height=height)
    found = GraphSmoother().estimate(road.session)
    inside = (found.t > 5.0) & (found.t < road.t[-1] - 5.0)
    assert found.sigmas is not None
    for i in range(2):
        off = found.velocity_n[:, i] - np.interp(found.t, road.t, road.velocity_n[:, i])
        assert 0.6 < np.sqrt(np.mean((off / found.sigmas.velocity_n[:, i])[inside] ** 2)) < 1.8
