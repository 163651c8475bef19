"""Delays that change and stretches of another motion: said on whole sessions, the gate fails; nothing of good ones."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from smoother.arrays import Array, IntArray
from smoother.estimate.evaluate import evaluate
from smoother.estimate.initial.begin import begin
from smoother.estimate.pauses import pauses_of
from smoother.estimate.quality import assess
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.samples import Problem, Session
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import DELAY_CHANGES, MOTION_UNLIKE
from smoother.units import DEG

AT = 130.0


@pytest.fixture(scope="module", params=["kart", "kart_harsh"])
def session(request: pytest.FixtureRequest) -> Session:
    return prepare(simulate_preset(request.param, 71, duration=260.0).raw)


def told(session: Session) -> list[Problem]:
    begun = begin(session, GraphOptions().for_fixes(session.gnss.t), pauses_of)
    return [problem for problem in begun.problems if problem.code in (DELAY_CHANGES, MOTION_UNLIKE)]


def late(session: Session, delay: Array) -> Session:
    """Fixes that are stamped as much later, (N,) s."""
    t = session.gnss.t + delay
    keep = t > np.maximum.accumulate(np.concatenate([[-np.inf], t[:-1]]))
    return replace(session, gnss=replace(session.gnss.select(keep), t=t[keep]))


def sampled(session: Session, rows: IntArray, t: Array) -> Session:
    imu = session.imu
    assert imu is not None
    of_rows = replace(imu, t=t, specific_force_s=imu.specific_force_s[rows], angular_rate_s=imu.angular_rate_s[rows])
    return replace(session, imu=of_rows)


def lost_and_counted(session: Session) -> Session:
    """One of five samples is lost by chance, and the rest is stamped evenly from the first to the last."""
    assert session.imu is not None
    t = session.imu.t
    rows = np.flatnonzero(np.random.default_rng(3).random(len(t)) < 0.8)
    return sampled(session, rows, np.linspace(t[0], t[-1], len(rows)))


def half_the_rate(session: Session) -> Session:
    """From AT on every second sample is taken, and samples are counted as before."""
    assert session.imu is not None
    t = session.imu.t
    rows = np.flatnonzero((t < AT) | (np.arange(len(t)) % 2 == 0))
    return sampled(session, rows, t[: len(rows)])


def antenna_off(session: Session) -> Session:
    """From AT on the antenna lies beside the track."""
    gnss, rng = session.gnss, np.random.default_rng(4)
    off = gnss.t > AT
    still, place = 1e-7 * np.cumsum(rng.normal(0.0, 0.2, (len(off), 2)), axis=0), int(np.argmax(off))
    lat_deg = np.where(off, gnss.lat_deg[place] + still[:, 0], gnss.lat_deg)
    lon_deg = np.where(off, gnss.lon_deg[place] + still[:, 1], gnss.lon_deg)
    velocity_n = np.where(off[:, None], rng.normal(0.0, 0.05, (len(off), 3)), gnss.velocity_n)
    return replace(session, gnss=replace(gnss, lat_deg=lat_deg, lon_deg=lon_deg, velocity_n=velocity_n))


def held_up(session: Session) -> Session:
    """Fixes that come 0.4 s later for 40 s, too short for two steps: a clock that was set and set back."""
    return late(session, 0.4 * ((session.gnss.t > AT - 20.0) & (session.gnss.t < AT + 20.0)))


def swinging(session: Session) -> Session:
    """Fixes that come 0.15 s later and earlier by turns."""
    return late(session, 0.15 * np.sin(2.0 * np.pi * session.gnss.t / 100.0))


def creeping(session: Session) -> Session:
    """Fixes that come 0.4 s later within 40 s and stay so, as behind a buffer that fills."""
    return late(session, 0.4 * np.clip((session.gnss.t - AT) / 40.0, 0.0, 1.0))


@pytest.mark.parametrize("damage", [held_up, swinging, creeping, lost_and_counted])
def test_a_delay_that_changes_is_said_with_how_much_and_where(
    session: Session, damage: Callable[[Session], Session]
) -> None:
    (problem,) = told(damage(session))
    assert problem.code == "delay_changes"
    (size,) = re.findall(r"fixes come ([\d.]+) s later", problem.text)
    assert 0.2 < float(size) < 0.7


def test_samples_that_are_counted_at_another_rate_are_of_another_motion() -> None:
    session = prepare(simulate_preset("kart", 71, duration=260.0).raw)
    assert "motion_unlike" in [problem.code for problem in told(half_the_rate(session))]


def test_an_antenna_that_came_off_is_seen_by_samples_that_drive_on(session: Session) -> None:
    (problem,) = told(antenna_off(session))
    assert problem.code == "motion_unlike"
    assert re.match(r"between 1[34]\d and 2\d\d s after the first fix the fixes stand still for", problem.text)


def frozen(session: Session) -> Session:
    """For 50 s from AT on the receiver says again where it was, and that it stands: its antenna is unplugged."""
    gnss = session.gnss
    off = (gnss.t > AT) & (gnss.t < AT + 50.0)
    place = int(np.argmax(off))
    lat_deg, lon_deg = (np.where(off, values[place], values) for values in (gnss.lat_deg, gnss.lon_deg))
    velocity_n = np.where(off[:, None], 0.0, gnss.velocity_n)
    speed = np.where(off, 0.0, np.hypot(velocity_n[:, 0], velocity_n[:, 1]))
    return replace(session, gnss=replace(gnss, lat_deg=lat_deg, lon_deg=lon_deg, velocity_n=velocity_n, speed=speed))


def test_fixes_that_stand_while_the_kart_drives_on_are_left_out(session: Session) -> None:
    stood = frozen(session)
    begun = begin(stood, GraphOptions().for_fixes(stood.gnss.t), pauses_of)
    off = (stood.gnss.t > AT + 1.0) & (stood.gnss.t < AT + 49.0)
    out = begun.left_out
    assert out is not None and out[off].mean() > 0.95 and out[stood.gnss.t < AT - 2.0].mean() < 0.05
    left = begun.session.gnss
    assert left.speed is not None and np.isnan(left.speed[out]).all() and np.isnan(left.velocity_n[out]).all()
    driven = begun.start.driven
    assert driven.is_told is not None and not driven.moves[(driven.t > AT + 3.0) & (driven.t < AT + 47.0)].any()
    assert [problem.code for problem in begun.problems] == [MOTION_UNLIKE]  # the gate fails all the same


@pytest.mark.parametrize("damage", [held_up, lost_and_counted, half_the_rate, antenna_off])
def test_the_quality_gate_fails(damage: Callable[[Session], Session]) -> None:
    session = damage(prepare(simulate_preset("kart", 72, duration=260.0).raw))
    trajectory = GraphSmoother().estimate(session)
    codes = {DELAY_CHANGES, MOTION_UNLIKE}
    wrong = [problem.text.partition(": ")[0] for problem in trajectory.report.problems if problem.code in codes]
    assert wrong and set(wrong) <= set(assess(session, trajectory).reasons)


@pytest.mark.parametrize("preset", ["kart", "kart_harsh", "white"])
def test_of_good_sessions_nothing_is_said(preset: str) -> None:
    for seed in (73, 74, 75):
        assert told(prepare(simulate_preset(preset, seed, duration=200.0).raw)) == []


def test_a_kart_that_stands_with_a_box_that_is_handled_does_not_drive(session: Session) -> None:
    """A box that is carried turns and tilts as much as on a track, but not in step."""
    stood = antenna_off(session)
    imu = stood.imu
    assert imu is not None
    shifted = np.where(imu.t > AT, imu.t - 8.0, imu.t)
    rate = np.stack([np.interp(shifted, imu.t, axis) for axis in imu.angular_rate_s.T], axis=1)
    assert told(replace(stood, imu=replace(imu, angular_rate_s=rate))) == []


def test_what_is_too_short_or_too_slow_tells_nothing(session: Session) -> None:
    short = session.gnss.select(session.gnss.t < 50.0)
    slow = session.gnss.select(np.arange(len(session.gnss)) % 10 == 0)
    for gnss in (short, slow):
        assert told(swinging(replace(session, gnss=gnss))) == []


@pytest.mark.parametrize("top_speed", [6.0, 8.0])
def test_a_kart_whose_speed_is_limited_drives(top_speed: float) -> None:
    """At an even speed the force ahead is noise in most stretches, and at a slow one what bends pull is little."""
    simulation = simulate_preset("kart", 2, duration=300.0, motion_top_speed=top_speed)
    session = prepare(simulation.raw)
    trajectory = GraphSmoother().estimate(session)
    assert assess(session, trajectory).passed
    assert not [problem for problem in trajectory.report.problems if problem.code == MOTION_UNLIKE]
    sigmas = trajectory.sigmas
    assert sigmas is not None and np.median(sigmas.attitude) < 2.0 * DEG
    t = trajectory.t[(trajectory.t > simulation.truth.first + 20.0) & (trajectory.t < simulation.truth.last)]
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b, origin=session.origin)
    found = evaluate(trajectory, truth)
    assert max(found.roll_rms_deg, found.pitch_rms_deg, found.yaw_rms_deg) < 2.5  # 2.2 and 3.2 with a rough mounting


def test_a_slow_kart_that_is_shaken_tells_nothing() -> None:
    """What is felt of its motion is as small as the noise, and by chance two stretches have nothing in common."""
    slow = {"track": "longmeadow", "motion_top_speed": 6.0, "gnss_rate": 1.0}
    assert told(prepare(simulate_preset("kart_harsh", 202, duration=240.0, **slow).raw)) == []


def test_samples_of_another_drive_are_of_another_motion_at_any_speed() -> None:
    session = prepare(simulate_preset("kart", 2, duration=300.0, motion_top_speed=4.0).raw)
    assert "motion_unlike" in [problem.code for problem in told(antenna_off(session))]
