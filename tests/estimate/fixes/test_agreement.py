"""Velocities that are turned or scaled against their positions: found, undone and said; others are left as they are."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.estimate.fixes.agreement import (
    FACTOR,
    TURN,
    Disagreement,
    disagreement,
    disagreement_problems,
    in_agreement,
)
from smoother.estimate.smoother import GraphSmoother
from smoother.frames import Origin, nwu_to_geodetic, velocity_n_from_course
from smoother.prepare import prepare
from smoother.samples import GnssFixes, Session
from smoother.session.load import load_raw
from smoother.sim.simulation import Simulation, simulate_preset
from smoother.trajectory import Trajectory
from smoother.units import DEG

ORIGIN = Origin(45.0, 10.0, 100.0)
RECORDINGS = (
    "bicycle_neo6m",
    "car_comma2k19",
    "car_hi600_rtk",
    "car_hi600_twin_a",
    "kart_adria_first_half",
    "kart_lignano_racebox",
    "kart_massafinalese_racechrono",
    "kart_okc_doves",
    "nmea_walk_vs_rtk",
)


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 5, duration=240.0)


@pytest.fixture(scope="module")
def session(simulation: Simulation) -> Session:
    return prepare(simulation.raw)


def with_course_off(session: Session, degrees: float) -> Session:
    """The session with courses that point to the right by that much, as of a compass."""
    north, west, up = session.gnss.velocity_n.T
    course = np.degrees(np.arctan2(-west, north)) + degrees
    sent = velocity_n_from_course(np.hypot(north, west), course)
    return with_velocity(session, np.column_stack([sent[:, :2], up]))


def with_velocity(session: Session, velocity_n: Array) -> Session:
    return replace(session, gnss=replace(session.gnss, velocity_n=velocity_n))


def moved(session: Session, by: Array) -> Session:
    """The session with its fixes moved by (N, 3) m in n."""
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(session.fix_position_n + by, session.origin)
    return replace(session, gnss=replace(session.gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))


@pytest.mark.parametrize("degrees", [1.0, -4.0, 10.0])
def test_a_turn_is_found_by_itself(session: Session, degrees: float) -> None:
    found = disagreement(with_course_off(session, degrees))
    assert abs(found.value[TURN] / DEG - degrees) < 0.25
    assert found.value[TURN] / DEG == pytest.approx(degrees, abs=4.0 * found.sigma[TURN] / DEG)
    assert found.value[FACTOR] == 0.0 and not found.is_course_wrong


@pytest.mark.parametrize("share", [0.012, -0.04])
def test_a_factor_is_found_by_itself(session: Session, share: float) -> None:
    found = disagreement(with_velocity(session, session.gnss.velocity_n * (1.0 + share)))
    assert found.value[FACTOR] == pytest.approx(-np.log1p(share), abs=0.004)
    assert found.value[TURN] == 0.0 and not found.is_course_wrong


def flat_degrees(course: Array) -> Array:
    """atan2(dlon, dlat) at 52 degrees of latitude, in radians."""
    return np.arctan2(np.sin(course) / np.cos(52.0 * DEG), np.cos(course))


@pytest.mark.parametrize(
    "wrong",
    [
        flat_degrees,
        lambda course: course + 0.1 * np.cos(course - 1.0),
        lambda course: course + 0.2 * np.sin(2.0 * course),
    ],
    ids=["degrees as metres", "a compass near iron", "of two axes"],
)
def test_courses_that_err_by_their_direction_are_not_used_and_speeds_are(
    session: Session, wrong: Callable[[Array], Array]
) -> None:
    north, west, up = session.gnss.velocity_n.T
    speed, course = np.hypot(north, west), wrong(np.arctan2(-west, north))
    sent = with_velocity(session, np.column_stack([speed * np.cos(course), -speed * np.sin(course), up]))
    found = disagreement(sent)
    assert found.is_course_wrong and found.value[FACTOR] == 0.0
    right = in_agreement(sent, found).gnss
    assert np.isnan(right.velocity_n[:, :2]).all() and right.speed is not None
    np.testing.assert_allclose(right.speed, speed)
    np.testing.assert_array_equal(right.velocity_n[:, 2], up)


def test_what_is_found_is_undone(session: Session) -> None:
    wrong = with_velocity(
        with_course_off(session, 4.0), with_course_off(session, 4.0).gnss.velocity_n * [1.03, 1.03, 1.0]
    )
    found = disagreement(wrong)
    right = in_agreement(wrong, found)
    off = right.gnss.velocity_n - session.gnss.velocity_n
    assert np.sqrt(np.nanmean(off[:, :2] ** 2)) < 0.06  # it was 0.7
    np.testing.assert_array_equal(right.gnss.velocity_n[:, 2], session.gnss.velocity_n[:, 2])
    assert not disagreement(right).is_found
    assert in_agreement(session, disagreement(session)) is session


def sigmas_off(found: Trajectory, simulation: Simulation, session: Session) -> float:
    """Rms of the error of level velocity in its sigmas, from when the kart drives."""
    inside = (found.t > simulation.truth.first + 20.0) & (found.t < simulation.truth.last - 3.0)
    truth = simulation.truth.trajectory(found.t[inside], simulation.scenario.lever_arm_b, session.origin)
    assert found.sigmas is not None
    off = (found.velocity_n[inside] - truth.velocity_n) / found.sigmas.velocity_n[inside]
    return float(np.sqrt(np.mean(off[:, :2] ** 2)))


@pytest.mark.parametrize("has_samples", [True, False])
def test_a_magnetic_course_costs_little(simulation: Simulation, session: Session, has_samples: bool) -> None:
    given = session if has_samples else replace(session, imu=None, mag=None)
    plain, found = GraphSmoother().estimate(given), GraphSmoother().estimate(with_course_off(given, 4.0))
    apart = np.hypot(*(found.velocity_n - plain.velocity_n)[:, :2].T)
    assert np.sqrt(np.mean(apart**2)) < 0.06  # it was 0.9 m/s
    if has_samples:
        assert sigmas_off(found, simulation, session) < 1.3
    (said,) = [problem for problem in found.report.problems if problem.code == "gps_velocity_turned"]
    assert "deg to the right of the way their positions go; turned back" in said.text
    assert not [problem for problem in plain.report.problems if problem.code.startswith("gps_velocity_")]


def said_of(*value: float) -> list[tuple[str, str]]:
    problems = disagreement_problems(Disagreement(np.array(value), np.full(6, 0.001)))
    return [(problem.code, problem.text) for problem in problems]


def test_the_message() -> None:
    assert said_of(0.0, 0.0, 0.0, 0.0, 0.0, 0.0) == []
    ((code, text),) = said_of(0.0, -2.0 * DEG, 0.0, 0.0, 0.0, 0.0)
    assert code == "gps_velocity_turned"
    assert "point 2.00 ± 0.06 deg to the left of the way" in text
    ((code, text),) = said_of(-np.log(1.03), 0.0, 0.0, 0.0, 0.0, 0.0)
    assert code == "gps_velocity_scaled"
    assert "speeds of the fixes are 3.00 % faster (± 0.10 %) than their positions go" in text
    ((code, text), (other, _)) = said_of(-np.log(1.03), 2.0 * DEG, 0.0, 3.0 * DEG, 4.0 * DEG, 0.0)
    assert (code, other) == ("gps_course_wrong", "gps_velocity_scaled")
    assert "wrong by up to 5.0 deg" in text


def test_a_wall_beside_the_track_is_none(session: Session) -> None:
    place = session.fix_position_n
    beside = np.exp(-np.sum((place[:, :2] - place[len(place) // 2, :2]) ** 2, axis=1) / 20.0**2)
    for azimuth in np.radians([0.0, 60.0, 120.0, 180.0, 240.0, 300.0]):
        off = 4.0 * beside[:, None] * [np.cos(azimuth), np.sin(azimuth), 0.0]
        assert not disagreement(moved(session, off)).is_found


def laps(wrong: Callable[[Array], Array], scale: Array) -> Session:
    """58 laps by a quiet receiver; positions are `wrong` (N, 3) m by where they are, velocities times `scale` (3,)."""
    t, rate, rng = np.arange(0.0, 2400.0, 0.2), 2.0 * np.pi / 41.0, np.random.default_rng(3)
    north, west = 150.0 * np.sin(rate * t), 60.0 * np.sin(2.0 * rate * t) + 30.0 * np.cos(rate * t)
    place = np.stack([north, west, 0.0 * t], axis=1)
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(place + wrong(place) + 0.02 * rng.normal(size=place.shape), ORIGIN)
    bends = 2.0 * np.cos(2.0 * rate * t) * 60.0 - 30.0 * np.sin(rate * t)
    velocity_n = rate * np.stack([150.0 * np.cos(rate * t), bends, 0.0 * t], axis=1)
    velocity_n = scale * velocity_n + 0.03 * rng.normal(size=place.shape)
    return Session("laps", GnssFixes(t, lat_deg, lon_deg, alt_m, velocity_n), ORIGIN)


@pytest.mark.parametrize("phase", [3.0, 4.0])
def test_errors_that_repeat_every_lap_are_reported_once(phase: float) -> None:
    """Errors of 2 m that belong to the place; taken for independent in each of 58 laps they are a factor, 8 sigmas."""

    def wrong(place: Array) -> Array:
        cos, sin = np.array([np.cos(phase), np.sin(phase)]) / 40.0
        ahead, left = place[:, :2] @ [cos, sin], place[:, :2] @ [-sin, cos]
        return 2.0 * np.stack([np.sin(ahead + phase), np.cos(left + 2.0 * phase), 0.0 * ahead], axis=1)

    assert not disagreement(laps(wrong, np.ones(3))).is_found


@pytest.mark.parametrize("preset", ["kart", "kart_harsh", "white"])
def test_simulated_receivers_agree_with_themselves(preset: str) -> None:
    for seed in range(30, 35):
        given = prepare(simulate_preset(preset, seed, duration=150.0, imu_rate=50.0).raw)
        assert not disagreement(given).is_found


def test_jumps_rows_far_off_and_a_late_velocity_are_none(session: Session) -> None:
    t, velocity_n = session.gnss.t, session.gnss.velocity_n
    jumps = np.where((t % 40.0 < 4.0)[:, None], [25.0, -10.0, 0.0], 0.0)
    assert not disagreement(moved(session, jumps)).is_found
    absurd = velocity_n + np.where((np.arange(len(t)) % 300 == 7)[:, None], [40.0, 30.0, 0.0], 0.0)
    assert not disagreement(with_velocity(session, absurd)).is_found
    late = np.column_stack([np.interp(t - 0.3, t, column) for column in velocity_n.T])
    assert not disagreement(with_velocity(session, late)).is_found
    turned = disagreement(with_course_off(moved(session, jumps), 3.0))
    assert turned.value[TURN] == pytest.approx(3.0 * DEG, abs=0.4 * DEG)


def test_with_little_information_nothing_is_found(session: Session) -> None:
    turned = with_course_off(session, 4.0)
    blind = with_velocity(turned, np.full_like(turned.gnss.velocity_n, np.nan))
    assert not disagreement(blind).is_found
    t = turned.gnss.t - turned.gnss.t[0]
    for some in (t < 40.0, np.arange(len(t)) % 10 == 0, np.arange(len(t)) < 1):
        assert not disagreement(replace(turned, gnss=turned.gnss.select(some))).is_found


@pytest.mark.parametrize("recording", RECORDINGS)
def test_real_receivers_agree_with_themselves(recording: str, data_directory: Path) -> None:
    assert not disagreement(prepare(load_raw(data_directory / recording))).is_found
