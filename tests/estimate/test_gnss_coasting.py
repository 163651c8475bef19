"""A receiver that goes straight on without satellites: its fixes are found by the samples, and left out."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import BoolArray
from smoother.estimate import gnss_coasting
from smoother.estimate.gnss_coasting import COASTING, _held, coasting, coasting_problems
from smoother.estimate.initial.begin import Begun, begin
from smoother.estimate.initial.options import GraphOptions
from smoother.estimate.pauses import pauses_of
from smoother.estimate.quality import assess
from smoother.estimate.smoother import GraphSmoother
from smoother.frames import nwu_to_geodetic
from smoother.prepare import prepare
from smoother.samples import ImuSamples, Session
from smoother.session.load import load_raw
from smoother.sim.motion import Spin
from smoother.sim.scenario import Interval
from smoother.sim.simulation import Simulation, simulate_preset

from .roads import country_road

DURATION = 200.0


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate_preset("kart", 3, duration=DURATION, gnss_rate=10.0, gnss_outages=())


@pytest.fixture(scope="module")
def session(simulation: Simulation) -> Session:
    return prepare(simulation.raw)


def coasted(session: Session, starts: list[float], lasts: float, fades: float = np.inf) -> tuple[Session, BoolArray]:
    """The session of a receiver that goes straight on for `lasts` s from each of the starts, s; and which fixes do.

    fades: s after which a third of its speed is left.
    """
    gnss = session.gnss
    t, position_n, velocity_n = gnss.t - gnss.t[0], session.fix_position_n.copy(), gnss.velocity_n.copy()
    out = np.zeros(len(t), dtype=np.bool_)
    for start in starts:
        k = int(np.searchsorted(t, start))
        rows = np.flatnonzero((t > t[k]) & (t <= t[k] + lasts))
        since = (t[rows] - t[k])[:, None]
        position_n[rows] = position_n[k] + velocity_n[k] * (
            since if np.isinf(fades) else -fades * np.expm1(-since / fades)
        )
        velocity_n[rows] = velocity_n[k] * np.exp(-since / fades)
        out[rows] = True
    lat_deg, lon_deg, alt_m = nwu_to_geodetic(position_n, session.origin)
    gnss = replace(gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m, velocity_n=velocity_n)
    return replace(session, gnss=gnss), out


def in_corners(session: Session) -> list[float]:
    """A quarter of a second before the kart turns hardest, once in every 40 s, s."""
    t, velocity = session.gnss.t - session.gnss.t[0], session.gnss.velocity_n
    turning = np.abs(np.gradient(np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0])), t)) * np.hypot(
        *velocity[:, :2].T
    )
    return [
        float(t[(t > a) & (t < a + 40.0)][np.argmax(turning[(t > a) & (t < a + 40.0)])] - 0.25)
        for a in (25.0, 75.0, 125.0)
    ]


def begun(session: Session) -> Begun:
    return begin(session, GraphOptions(), pauses_of)


def found_in(session: Session) -> BoolArray:
    start = begun(session).start
    return coasting(session, start.alignment, start.driven)


def horizontal_error(session: Session, simulation: Simulation) -> tuple[float, float]:
    """Rms error m/s of velocity, and of the change of position over a second, m."""
    found = GraphSmoother().estimate(session)
    rows = (found.t > 15.0) & (found.t < DURATION - 10.0)
    truth = simulation.truth.trajectory(found.t[rows], simulation.scenario.lever_arm_b, session.origin)
    velocity = np.hypot(*(found.velocity_n[rows] - truth.velocity_n)[:, :2].T)
    off = (found.position_n[rows] - truth.position_n)[:, :2]
    change = np.hypot(*(off[50:] - off[:-50]).T)
    return float(np.sqrt(np.mean(velocity**2))), float(np.sqrt(np.mean(change**2)))


@pytest.mark.parametrize("lasts", [1.2, 2.0, 4.0])
def test_fixes_that_go_straight_on_are_found(session: Session, lasts: float) -> None:
    given, out = coasted(session, in_corners(session), lasts)
    start = begun(session).start
    found = coasting(given, start.alignment, start.driven)
    assert np.mean(found[out]) > 0.9
    assert np.sum(found & ~out) < 0.5 * np.sum(out) + 12  # some before, that were as fast; nothing elsewhere
    assert not found[np.abs(np.convolve(out, np.ones(41), "same")) < 0.5].any()


@pytest.fixture(scope="module")
def unspoilt(session: Session, simulation: Simulation) -> tuple[float, float]:
    return horizontal_error(session, simulation)


def test_they_cost_next_to_nothing(session: Session, simulation: Simulation, unspoilt: tuple[float, float]) -> None:
    given, _ = coasted(session, in_corners(session), 2.0)
    spoiled = horizontal_error(given, simulation)
    assert spoiled[0] < 1.3 * unspoilt[0]
    assert spoiled[1] < 1.3 * unspoilt[1]
    (said,) = [p for p in GraphSmoother().estimate(given).report.problems if p.code == COASTING]
    assert said.text.startswith("3 times the receiver went on by itself")


@pytest.mark.parametrize(("lasts", "fades", "count"), [(3.0, 1.5, 1), (4.0, 4.0, 3), (8.0, 3.0, 1)])
def test_a_receiver_that_slows_down_until_it_jumps_is_not_believed(
    session: Session,
    simulation: Simulation,
    unspoilt: tuple[float, float],
    lasts: float,
    fades: float,
    count: int,
) -> None:
    """The course of such fixes turns the nose with which samples are read, and their bias if there are many."""
    spoilt, out = coasted(session, in_corners(session)[:count], lasts, fades)
    left_out = begun(spoilt).left_out
    assert left_out is not None and np.mean(left_out[out]) > 0.85
    assert np.count_nonzero(left_out & ~out) <= 6 * count  # beside it, where it hardly differs
    velocity, place = horizontal_error(spoilt, simulation)
    assert velocity < 1.6 * unspoilt[0] and place < 1.6 * unspoilt[1]


def test_velocities_that_are_renewed_once_a_second_jump_by_habit(session: Session) -> None:
    gnss = session.gnss
    seldom = gnss.velocity_n[10 * (np.arange(len(gnss)) // 10)]
    assert begun(replace(session, gnss=replace(gnss, velocity_n=seldom))).left_out is None


def test_nothing_is_left_out_where_every_fix_is_measured(session: Session) -> None:
    assert not found_in(session).any()
    for changes in (
        {"motion_spins": tuple(Spin(30.0 * k, 2.5) for k in range(1, 6))},
        {"imu_accel_range": 2.0 * 9.80665},
        {"imu_gyro_range": 1.0},
        {"gnss_rate": 1.0},
        {"gnss_rate": 10.0, "imu_gaps": tuple(Interval(30.0 * k, 6.0) for k in range(1, 6))},
    ):
        other = prepare(simulate_preset("kart", 4, duration=DURATION, **changes).raw)
        assert not found_in(other).any(), changes
    assert not found_in(prepare(simulate_preset("kart_harsh", 4, duration=DURATION).raw)).any()


def test_without_doppler_or_samples_nothing_is_said(session: Session) -> None:
    start = begun(session).start
    velocity_n = np.full_like(session.gnss.velocity_n, np.nan)
    blind = replace(session, gnss=replace(session.gnss, velocity_n=velocity_n))
    assert not coasting(blind, start.alignment, start.driven).any()
    assert not coasting(replace(session, imu=None), start.alignment, start.driven).any()
    assert coasting_problems(np.zeros(5, dtype=np.bool_)) == ()


@pytest.mark.parametrize(
    "recording", ["kart_adria_first_half", "kart_lignano_racebox", "car_hi600_twin_a", "car_hi600_twin_b"]
)
def test_real_recordings(recording: str, data_directory: Path) -> None:
    assert not found_in(prepare(load_raw(data_directory / recording))).any()


def part_of(session: Session, first: float, lasts: float) -> Session:
    """`lasts` s of a session, from `first` s on, as it would have been recorded alone."""
    assert session.imu is not None
    since = session.gnss.t[0] + first
    gnss, imu = (
        replace(
            given,
            **{f.name: value[rows] for f in fields(given) if isinstance(value := getattr(given, f.name), np.ndarray)},
        )
        for given in (session.gnss, session.imu)
        for rows in [(given.t >= since) & (given.t < since + lasts)]
    )
    return replace(session, gnss=gnss, imu=imu, mag=None)


def test_a_car_that_is_driven_gently_goes_straight_on_by_itself(data_directory: Path) -> None:
    session = prepare(load_raw(data_directory / "car_hi600_twin_b"))
    assert not found_in(part_of(session, 540.0, 180.0)).any()
    assert not found_in(part_of(session, 600.0, 300.0)).any()


def test_the_trajectory_may_leave_fixes_that_were_left_out(session: Session) -> None:
    given, out = coasted(session, np.arange(30.0, DURATION - 20.0, 40.0).tolist(), 6.0)
    found = GraphSmoother().estimate(given)
    left_out = found.report.left_out
    assert left_out is not None and np.mean(left_out[out]) > 0.5
    quality = assess(given, found)
    assert not [reason for reason in quality.reasons if "fixes" in reason]
    followed = assess(given, replace(found, report=replace(found.report, left_out=None)))
    assert [reason for reason in followed.reasons if "fixes" in reason]


def test_hills_are_no_braking_that_a_receiver_missed() -> None:
    assert not found_in(country_road().session).any()
    assert not found_in(country_road(slope=0.25).session).any()


def test_vibration_that_grows_with_the_revolutions_is_no_motion() -> None:
    assert not found_in(country_road(vibration=15.0).session).any()
    assert not found_in(country_road(vibration=30.0).session).any()


def pushed(session: Session, time: float) -> Session:
    """The session of samples that are pushed to the front for 0.8 s from `time` on, s, and back as long.

    As vibration does that sampling without a filter folds to nearly 0 Hz.
    """
    imu = session.imu
    assert imu is not None
    t, force = imu.t - session.gnss.t[0], imu.specific_force_s.copy()
    force[(t > time) & (t < time + 0.8), 0] += 5.0
    force[(t > time + 0.8) & (t < time + 1.6), 0] -= 5.0
    return replace(session, imu=replace(imu, specific_force_s=force))


def steadiest(session: Session) -> float:
    """When the velocity changes least over 1.2 s of driving fast, s."""
    t, velocity = session.gnss.t - session.gnss.t[0], session.gnss.velocity_n[:, :2]
    changes = np.array([np.ptp(velocity[k : k + 12], axis=0).max() for k in range(len(t) - 12)])
    fast = np.hypot(*velocity[: len(changes)].T) > 10.0
    inside = (t[: len(changes)] > 40.0) & (t[: len(changes)] < DURATION - 40.0)
    return float(t[int(np.argmin(np.where(fast & inside, changes, np.inf)))])


def test_where_samples_are_off_beside_it_too_the_receiver_is_believed(session: Session) -> None:
    assert not found_in(pushed(session, steadiest(session))).any()
    elsewhere, out = coasted(session, in_corners(session)[:1], 2.0)
    found = found_in(pushed(elsewhere, steadiest(session)))
    assert np.mean(found[out]) > 0.7 and np.count_nonzero(found & ~out) < 5


@pytest.mark.parametrize(("size", "is_found"), [(1.0, True), (30.0, False)])
def test_what_vibration_around_could_push_is_no_motion(
    session: Session, size: float, is_found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Folded to 0 Hz for a moment it pushes by its size; from sample to sample up and down it is seen beside."""
    given, _ = coasted(session, in_corners(session)[:1], 1.2)
    noise = 1e-3 * np.random.default_rng(2).standard_normal(given.gnss.velocity_n.shape)  # else it is one that is held
    given = replace(given, gnss=replace(given.gnss, velocity_n=given.gnss.velocity_n + noise))
    assert given.imu is not None
    up_and_down = size * (-1.0) ** np.arange(len(given.imu.t))[:, None] * np.array([0.0, 0.0, 1.0])
    shaken = replace(given.imu, specific_force_s=given.imu.specific_force_s + up_and_down)
    assert found_in(replace(given, imu=shaken)).any()  # it ends with a jump, which no vibration makes
    monkeypatch.setattr(gnss_coasting, "_jumps", lambda *_: np.empty(0, dtype=np.int64))
    assert found_in(replace(given, imu=shaken)).any() == is_found


@pytest.mark.parametrize("lasts", [1.5, 8.0])
def test_a_receiver_may_go_straight_on_into_a_gap(session: Session, lasts: float) -> None:
    given, out = coasted(session, in_corners(session), 1.2)
    lost = np.zeros_like(out)
    for end in np.flatnonzero(np.diff(out.astype(np.int8)) < 0):
        lost |= (given.gnss.t > given.gnss.t[end]) & (given.gnss.t < given.gnss.t[end] + lasts)
    found = found_in(replace(given, gnss=given.gnss.select(~lost)))
    assert np.mean(found[out[~lost]]) > 0.9


def test_velocity_that_is_held_to_the_last_digit_is_measured_by_none() -> None:
    # a bend so gentle that no 0.6 s of it stand out
    given, out = coasted(prepare(simulate_preset("kart", 6, duration=DURATION, gnss_outages=()).raw), [61.0], 3.0)
    assert np.mean(found_in(given)[out]) > 0.9


def without_samples(session: Session, starts: list[float], lasts: float) -> Session:
    """The session without its samples for `lasts` s from each of the starts, s from the first fix on."""
    imu = session.imu
    assert imu is not None
    t = imu.t - session.gnss.t[0]
    kept = ~np.any([(t > start) & (t < start + lasts) for start in starts], axis=0)
    parts = (imu.t[kept], imu.specific_force_s[kept], imu.angular_rate_s[kept])
    return replace(session, imu=ImuSamples(*parts))


@pytest.mark.parametrize("lasts", [1.0, 4.0])
def test_beside_holes_of_the_samples_fixes_are_measured_all_the_same(session: Session, lasts: float) -> None:
    """Where the attitude is made up, a hill passes for braking that the receiver missed."""
    for each in (session, country_road(slope=0.09).session):
        holes = np.arange(30.0, 170.0, lasts + 7.0).tolist()
        assert not found_in(without_samples(each, holes, lasts)).any()


def test_coarse_velocities_and_those_that_are_seldom_renewed_are_not_held(session: Session) -> None:
    velocity_n = session.gnss.velocity_n
    coarse = np.round(velocity_n / 2.0) * 2.0
    seldom = velocity_n[np.arange(len(velocity_n)) // 10 * 10]
    for velocity_n in (coarse, seldom):
        t, speed = session.gnss.t, np.hypot(*velocity_n[:, :2].T)
        assert not _held(t, velocity_n[:, :2], speed > 5.0)[0].size
