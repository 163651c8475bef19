"""The GPS-only smoother as an estimator: its rows, what it leaves unknown, its report, and real recordings."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, CubicSpline

from smoother.arrays import Array
from smoother.config import GnssTiming, SessionConfig
from smoother.estimate.baseline.baseline import GpsAlone
from smoother.estimate.fixes.alone import GnssOnlyOptions, GnssSmoother
from smoother.estimate.judge.evaluate import evaluate
from smoother.estimate.judge.quality import assess
from smoother.frames import Origin, nwu_to_geodetic
from smoother.laps.sigma import position_errors
from smoother.laps.top_speed import top_speed
from smoother.prepare import prepare
from smoother.samples import GnssFixes, Session
from smoother.session.load import load_raw
from smoother.sim.simulation import simulate_preset

Make = Callable[..., Any]
STATED = SessionConfig(gps=GnssTiming(position_latency=0.0))
RADIUS, RATE = 30.0, 0.5  # m, rad/s: 15 m/s anticlockwise, 7.5 m/s^2 to the left


@pytest.fixture(scope="module")
def circle() -> Session:
    """Fixes every 0.2 s on a circle, all but free of noise."""
    t = np.arange(0.0, 60.0, 0.2)
    angle, rng = RATE * t, np.random.default_rng(0)
    position = RADIUS * np.stack([np.cos(angle), np.sin(angle), 0 * t], axis=1) + rng.normal(0.0, 0.01, (t.size, 3))
    velocity = RADIUS * RATE * np.stack([-np.sin(angle), np.cos(angle), np.full(t.size, np.nan)], axis=1)
    origin = Origin(45.0, 12.0, 30.0)
    return Session("circle", GnssFixes(t, *nwu_to_geodetic(position, origin), velocity), origin)


def test_rows_run_from_the_first_fix_to_the_last_at_the_rate_asked_for(lap_fixes: Make) -> None:
    session = lap_fixes(outages=[(30.0, 60.0)]).session
    estimate = GnssSmoother(GnssOnlyOptions(rate=20.0)).estimate(session)
    np.testing.assert_allclose(np.diff(estimate.t), 0.05, rtol=1e-9)
    assert estimate.t[0] == session.gnss.t[0]
    assert session.gnss.t[-1] - 0.05 < estimate.t[-1] <= session.gnss.t[-1]
    assert np.isfinite(estimate.position_n).all()
    assert np.isfinite(estimate.velocity_n).all()
    assert estimate.report.mode == "gps-only"


def test_acceleration_and_yaw_rate_of_a_circle_are_those_of_its_formula(circle: Session) -> None:
    estimate = GnssSmoother().estimate(circle)
    inner = (estimate.t > 3.0) & (estimate.t < 57.0)
    np.testing.assert_allclose(estimate.acceleration_b[inner, 0], 0.0, atol=0.3)
    np.testing.assert_allclose(estimate.acceleration_b[inner, 1], RADIUS * RATE**2, atol=0.3)
    np.testing.assert_allclose(estimate.angular_rate_b[inner, 2], RATE, atol=0.02)
    assert np.isnan(estimate.acceleration_b[:, 2]).all()
    assert np.isnan(estimate.R_nb).all()


def test_direction_is_unknown_at_a_standstill(lap_fixes: Make) -> None:
    estimate = GnssSmoother().estimate(lap_fixes(is_still=True).session)
    assert np.isnan(estimate.acceleration_b).all()
    assert np.isnan(estimate.angular_rate_b).all()
    assert estimate.speed.max() < 1.0


def test_sigma_contains_the_slow_offset_and_the_track_does_not(lap_fixes: Make) -> None:
    sigmas = GnssSmoother().estimate(lap_fixes().session).sigmas
    assert sigmas is not None
    assert sigmas.position_n[:, :2].min() >= 2.0
    assert sigmas.position_n[:, 2].min() >= 3.4
    assert np.median(sigmas.track) < 0.15
    assert np.median(sigmas.speed) == pytest.approx(np.median(sigmas.velocity_n[:, :2]), rel=0.05)


def test_an_unknown_delay_is_reported_and_widens_positions_along_the_track_alone(
    circle: Session,
) -> None:
    stated = replace(circle, config=SessionConfig(gps=GnssTiming(position_latency=0.0)))
    known, unknown = (GnssSmoother().estimate(session) for session in (stated, circle))
    assert [problem.code for problem in known.report.problems] == []
    assert [problem.code for problem in unknown.report.problems] == ["gps_delay_unknown"]
    assert known.sigmas is not None
    assert unknown.sigmas is not None
    more = unknown.sigmas.position_n**2 - known.sigmas.position_n**2
    np.testing.assert_allclose(np.sqrt(more[:, :2].sum(axis=1)), 0.15 * RADIUS * RATE, rtol=0.05)
    np.testing.assert_allclose(unknown.sigmas.velocity_n, known.sigmas.velocity_n)
    np.testing.assert_allclose(unknown.sigmas.track, known.sigmas.track)
    latency = unknown.report.identified["gps_velocity_latency"]
    assert (latency.source, latency.observable) == ("default", False)


def test_absolute_sigma_is_honest_over_sessions(lap_fixes: Make, lap_motion: Make) -> None:
    squares = []
    for seed in range(12):
        estimate = GnssSmoother(GnssOnlyOptions(rate=2.0)).estimate(lap_fixes(seed=seed, duration=60.0).session)
        assert estimate.sigmas is not None
        squares.append(np.mean(((estimate.position_n - lap_motion(estimate.t)) / estimate.sigmas.position_n) ** 2))
    # one sample of the offset per axis and session, 36 in all: 1 +- 3 x 0.24
    assert 0.3 < np.mean(squares) < 1.7


def test_report_lists_what_was_found_and_what_was_rejected(lap_fixes: Make) -> None:
    made = lap_fixes(jumps=((40.0, 41.0, 30.0),))
    report = GnssSmoother().estimate(made.session).report
    position, velocity = report.residuals["gps_position"], report.residuals["gps_velocity"]
    assert (position.unit, position.count, position.rejected) == ("m", 500, 5)
    assert (velocity.unit, velocity.count, velocity.rejected) == ("m/s", 500, 0)
    assert 0.6 < position.normalised_rms < 1.2
    assert 0.4 < velocity.normalised_rms < 1.2
    assert report.fixes is not None
    np.testing.assert_array_equal(report.fixes.weight < 0.5, made.is_bad)
    identified = report.identified
    assert identified["gps_velocity_lag"].value == pytest.approx(0.1, abs=0.02)
    assert identified["gps_velocity_lag"].observable
    assert (identified["gps_position_latency"].source, identified["gps_position_latency"].observable) == (
        "default",
        False,
    )
    # only the difference of the two delays is seen, so that neither of them is
    assert not identified["gps_velocity_latency"].observable
    assert identified["gps_offset_tau"].source == "default"
    assert (identified["lever_arm_b"].value, identified["R_bs"].source) == ([0.0, 0.0, 0.0], "default")


@pytest.mark.parametrize(("offset", "tau"), [(2.0, 60.0), (4.0, 60.0)])
def test_a_larger_offset_widens_the_sigmas_of_positions_and_laps(offset: float, tau: float) -> None:
    squares, changes, said, lap = [], [], [], 265  # rows
    for seed in range(3):
        changed = {"gnss_offset_horizontal": offset, "gnss_offset_tau": tau, "gnss_position_latency": 0.0}
        simulation = simulate_preset("kart", 40 + seed, duration=400.0, gnss_jumps=(), **changed)
        session = replace(prepare(replace(simulation.raw, imu=None, mag=None)), config=STATED)
        found = GnssSmoother(GnssOnlyOptions(rate=5.0)).estimate(session)
        true = simulation.truth.trajectory(found.t, simulation.scenario.lever_arm_b, session.origin)
        known = np.isfinite(true.position_n[:, 0])
        error = (found.position_n - true.position_n)[known, :2]
        assert found.sigmas is not None
        squares.append(np.mean((error / found.sigmas.position_n[known, :2]) ** 2))
        errors, source = position_errors(found, 0.2)
        assert errors is not None and source == "model"
        ends = np.stack([found.t[known][:-lap], found.t[known][lap:]], axis=1)
        north = np.tile([1.0, 0.0, 0.0], (2, 1))
        expected = np.mean([np.array([-1, 1]) @ errors.covariance(t, north) @ np.array([-1, 1]) for t in ends[::50]])
        changes.append(np.mean((error[lap:] - error[:-lap]) ** 2) / expected)
        said.append(found.report.identified["gps_offset_sigma"])
    for one in said:  # by laps
        value, sigma = float(np.ravel(one.value)[0]), float(np.ravel(one.sigma)[0])
        assert abs(np.log(value / offset)) < 3.0 * sigma / value < 1.5 and one.source == "identified"
    assert np.mean(squares) < 2.0
    assert 0.4 < np.mean(changes) < 1.6


def test_without_doppler_its_noise_is_not_reported(lap_fixes: Make) -> None:
    report = GnssSmoother().estimate(lap_fixes(doppler=None, has_altitude=False).session).report
    assert "gps_velocity" not in report.residuals
    assert "gps_height" not in report.residuals
    assert "gps_velocity_noise" not in report.identified
    assert report.identified["gps_velocity_latency"].source == "default"


def test_where_positions_alone_step_aside_speed_and_line_say_so(circle: Session) -> None:
    """Fixes every second that move 60 m aside within three, as a receiver does that loses and finds its satellites."""
    t, rng = np.arange(0.0, 120.0), np.random.default_rng(2)
    aside = 60.0 * np.clip((t - 60.0) / 3.0, 0.0, 1.0)
    position = np.stack([4.0 * t, 10.0 * np.sin(t / 8.0) + aside, 0.0 * t], axis=1) + rng.normal(0.0, 0.3, (120, 3))
    fixes = GnssFixes(t, *nwu_to_geodetic(position, circle.origin), np.full((120, 3), np.nan))
    estimate = GnssSmoother().estimate(Session("step", fixes, circle.origin))
    assert estimate.sigmas is not None
    during, before = (estimate.t > 60.0) & (estimate.t < 63.0), (estimate.t > 5.0) & (estimate.t < 55.0)
    assert estimate.speed[during].max() > 15.0
    wrong = estimate.speed[during] - 4.0
    assert np.all(estimate.sigmas.speed[during] > 0.5 * wrong)
    assert estimate.sigmas.track[during].min() > 3.0
    assert estimate.sigmas.speed[before].max() < 1.5 and estimate.sigmas.track[before].max() < 1.0
    assert top_speed(estimate).speed < 8.0  # 4.2 m/s were driven


def test_a_single_fix_gives_one_row(lap_fixes: Make) -> None:
    session = lap_fixes().session
    estimate = GnssSmoother().estimate(replace(session, gnss=session.gnss.select(np.arange(1))))
    assert len(estimate) == 1
    np.testing.assert_allclose(estimate.position_n[0], session.fix_position_n[0], atol=0.01)


@pytest.mark.parametrize("preset", ["white", "kart", "kart_harsh"])
def test_never_worse_than_the_fixes_joined_by_lines(preset: str) -> None:
    simulation = simulate_preset(preset, seed=4, duration=120.0)
    session, scenario = prepare(simulation.raw), simulation.scenario
    delay = scenario.gnss.position_latency  # nobody can tell it from the fixes alone; both are judged at their truth

    def judged(estimator: GnssSmoother | GpsAlone) -> Any:
        estimate = estimator.estimate(session)
        inside = (estimate.t > session.gnss.t[0] + 1.0) & (estimate.t < session.gnss.t[-1] - 1.0)
        truth = simulation.truth.trajectory(estimate.t[inside] - delay, scenario.lever_arm_b, session.origin)
        return evaluate(estimate, replace(truth, t=estimate.t[inside]))

    smoothed, plain = judged(GnssSmoother()), judged(GpsAlone())
    assert smoothed.horizontal_rms_m <= 1.02 * plain.horizontal_rms_m  # the offset is left in both
    assert smoothed.relative_1s_rms_m < plain.relative_1s_rms_m
    # `white` needs nothing but Doppler's own noise averaged, and pays for a lag that its fixes hardly show
    assert smoothed.horizontal_velocity_rms_mps < 1.05 * plain.horizontal_velocity_rms_mps


def first_seconds(session: Session, seconds: float) -> Session:
    return replace(session, gnss=session.gnss.select(session.gnss.t < session.gnss.t[0] + seconds))


def dropped_fix_errors(session: Session, interval: float) -> dict[str, float]:
    """Horizontal rms, m, at the fixes left out when one per `interval` s is kept, of the smoother and of splines."""
    t, z = session.gnss.t, session.fix_position_n[:, :2]
    keep = np.diff(np.floor((t - t[0]) / interval + 1e-6), prepend=-1.0) > 0.0
    sigma = session.gnss.sigma_horizontal
    assert sigma is not None
    usual = np.median(sigma[np.isfinite(sigma)]) if np.isfinite(sigma).any() else np.inf
    judged = ~keep & (t < t[keep][-1]) & (np.nan_to_num(sigma) <= 5.0 * usual)
    estimate = GnssSmoother().estimate(replace(session, imu=None, gnss=session.gnss.select(keep)))
    at_fixes = np.stack([np.interp(t[judged], estimate.t, estimate.position_n[:, i]) for i in range(2)], axis=1)
    velocity = session.gnss.velocity_n[keep, :2]
    known = np.isfinite(velocity).all(axis=1)
    curves: dict[str, Array] = {
        "smoothed": at_fixes,
        "linear": np.stack([np.interp(t[judged], t[keep], z[keep, i]) for i in range(2)], axis=1),
        "cubic": CubicSpline(t[keep], z[keep])(t[judged]),
    }
    if known.sum() > 2:
        curves["hermite"] = CubicHermiteSpline(t[keep][known], z[keep][known], velocity[known])(t[judged])
    return {name: float(np.sqrt(np.mean(np.sum((p - z[judged]) ** 2, axis=1)))) for name, p in curves.items()}


@pytest.mark.parametrize(
    ("name", "interval"),
    [
        ("kart_adria_first_half", 1.0),
        ("kart_adria_first_half", 2.0),
        ("kart_adria_first_half", 5.0),
        ("kart_okc_doves", 1.0),
        ("kart_okc_doves", 2.0),
        ("kart_okc_doves", 5.0),
        ("kart_massafinalese_racechrono", 1.0),
        ("kart_massafinalese_racechrono", 2.0),
        ("kart_massafinalese_racechrono", 5.0),
        ("bicycle_neo6m", 2.0),
    ],
)
def test_dropped_fixes_of_real_recordings_are_met_better_than_by_any_spline(
    data_directory: Path, name: str, interval: float
) -> None:
    session = first_seconds(prepare(load_raw(data_directory / name)), 400.0)
    errors = dropped_fix_errors(session, interval)
    assert errors["smoothed"] == min(errors.values()), errors


@pytest.mark.parametrize("name", ["kart_adria_first_half", "kart_massafinalese_racechrono", "bicycle_neo6m"])
def test_real_recordings_stay_with_their_fixes(data_directory: Path, name: str) -> None:
    session = first_seconds(prepare(load_raw(data_directory / name)), 200.0)
    estimate = GnssSmoother().estimate(session)
    at_fixes = np.stack([np.interp(session.gnss.t, estimate.t, estimate.position_n[:, i]) for i in range(2)], axis=1)
    distance = np.hypot(*(at_fixes - session.fix_position_n[:, :2])[:-1].T)
    accuracy = session.gnss.sigma_horizontal
    assert accuracy is not None
    assert np.all(distance < np.fmax(5.0, 3.0 * np.nan_to_num(accuracy[:-1])))
    assert assess(session, estimate).passed


def alone(seed: int, **changes: Any) -> Session:
    """A simulated kart whose inertial sensor was left at home."""
    simulation = simulate_preset("kart", seed, duration=200.0, gnss_outages=(), gnss_jumps=(), **changes)
    return prepare(replace(simulation.raw, imu=None, mag=None))


def test_noise_of_quick_fixes_is_found_within_its_sigma_beside_a_large_wander() -> None:
    """Four fixes share a node, between which their offset goes its way: it passed for noise of twice as much."""
    for seed in (3, 4):
        changes = {"gnss_rate": 20.0, "gnss_white_horizontal": 0.05, "gnss_white_up": 0.09}
        session = alone(seed, gnss_offset_horizontal=3.0, gnss_offset_up=5.0, gnss_velocity_sigma=0.1, **changes)
        found = GnssSmoother().estimate(session).report.identified
        noise = found["gps_position_noise"]
        error = np.asarray(noise.value) - [0.05, 0.05, 0.09]
        assert np.all(np.abs(error) < 2.6 * np.asarray(noise.sigma))
        assert noise.observable == bool(noise.sigma[0] < noise.value[0])
        velocity = found["gps_velocity_noise"]
        assert abs(np.ravel(velocity.value)[0] - 0.1) < 2.6 * np.ravel(velocity.sigma)[0]


def test_fixes_that_scatter_without_doppler_may_wander_unseen() -> None:
    changes = {"gnss_white_horizontal": 1.5, "gnss_white_up": 2.5, "gnss_velocity": False}
    session = alone(5, gnss_offset_horizontal=2.0, **changes)
    found = GnssSmoother().estimate(replace(session, config=STATED))
    assert found.report.identified["gps_offset_sigma"].value == pytest.approx([2.0, 2.0, 3.4])
    assert found.sigmas is not None
    assert np.min(found.sigmas.position_n[:, :2]) > 1.9


def test_what_is_stated_of_fixes_alone_has_no_sigma() -> None:
    session = alone(3)
    stated = SessionConfig(gps=GnssTiming(position_latency=0.1, velocity_latency=0.2))
    for name, value in GnssSmoother().estimate(replace(session, config=stated)).report.identified.items():
        assert value.sigma is None or np.all(np.asarray(value.sigma) > 0.0), name
        assert value.source != "configured" or value.sigma is None, name
