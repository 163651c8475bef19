"""The path through the fixes: accuracy against truth, identified noise, honest sigmas, outliers, and scarce data."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from smoother.arrays import Array
from smoother.config import GnssTiming, SessionConfig
from smoother.estimate.fixes.path import GnssPathOptions, fit_gnss_path
from smoother.estimate.fixes.path_graph import WhiteJerk
from smoother.frames import Origin, nwu_to_geodetic
from smoother.samples import GnssFixes, Session

Make = Callable[..., Any]
JUMPS = ((20.0, 21.0, 30.0), (50.0, 55.0, 20.0), (70.0, 73.0, -12.0), (80.0, 80.3, 50.0))


def with_fixes(session: Session, **columns: Array) -> Session:
    """The session with some columns of its fixes replaced."""
    return replace(session, gnss=GnssFixes(**{**vars(session.gnss), **columns}))


def horizontal_rms(error: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(error[:, :2] ** 2, axis=1))))


def inner_times(session: Session) -> Array:
    """Times every 20 ms, half a second inside the first and last fix."""
    return np.arange(session.gnss.t[0] + 0.5, session.gnss.t[-1] - 0.5, 0.02)


@pytest.mark.parametrize("rate", [5.0, 10.0, 25.0])
def test_noise_and_the_lag_of_doppler_are_identified(lap_fixes: Make, rate: float) -> None:
    path = fit_gnss_path(lap_fixes(rate=rate).session)
    np.testing.assert_allclose(path.position_sigma, [0.2, 0.2, 0.35], rtol=0.15)
    np.testing.assert_allclose(path.velocity_sigma[:2], 0.15, rtol=0.15)
    assert path.velocity_lag.source == "identified"
    assert path.velocity_lag.observable
    assert path.velocity_lag.sigma < 0.005
    # truth is no sample of the prior, so that the sigma is a little small: 4 of them
    assert abs(path.velocity_lag.value - 0.1) < 4.0 * path.velocity_lag.sigma


def test_positions_late_by_a_varying_time_are_put_right(lap_fixes: Make, lap_motion: Make) -> None:
    made = lap_fixes(rate=1.0, duration=300.0, offset=(0.0, 0.0, 0.0), white=(0.5, 0.5, 0.9))
    t, rng = made.session.gnss.t, np.random.default_rng(1)
    late = np.interp(t, np.arange(0.0, 320.0, 10.0), rng.uniform(-0.8, 0.8, 32))
    position = lap_motion(t - late) + rng.normal(size=(len(t), 3)) * 0.5
    lat, lon, alt = nwu_to_geodetic(position, made.session.origin)
    accuracy = np.full(len(t), 5.0)
    path = fit_gnss_path(with_fixes(made.session, lat_deg=lat, lon_deg=lon, alt_m=alt, sigma_horizontal=accuracy))
    raw, smoothed = position - lap_motion(t), path.at(t).track_n - lap_motion(t)
    assert horizontal_rms(raw) > 5.0
    assert horizontal_rms(smoothed) < 0.3 * horizontal_rms(raw)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("changes", [{}, {"rate": 1.0}, {"rate": 25.0, "duration": 40.0}, {"lag": 0.3}])
def test_path_beats_the_fixes_and_their_interpolation(
    lap_fixes: Make, lap_motion: Make, seed: int, changes: Any
) -> None:
    made = lap_fixes(seed=seed, **changes)
    t, fix_t = inner_times(made.session), made.session.gnss.t
    fixes = made.session.fix_position_n
    # what the slow offset leaves: nobody can know it, so that the line in the frame of the fixes is judged
    truth = lap_motion(t) + np.stack([np.interp(t, fix_t, made.offset_n[:, i]) for i in range(3)], axis=1)
    error = horizontal_rms(fit_gnss_path(made.session).at(t).track_n - truth)
    linear = np.stack([np.interp(t, fix_t, fixes[:, i]) for i in range(3)], axis=1)
    assert error < horizontal_rms(linear - truth)
    assert error < horizontal_rms(CubicSpline(fix_t, fixes)(t) - truth)


@pytest.mark.parametrize("seed", range(3))
def test_white_fixes_without_doppler_are_smoothed_to_half_their_error(
    lap_fixes: Make, lap_motion: Make, seed: int
) -> None:
    made = lap_fixes(seed=seed, white=(2.5, 2.5, 4.3), offset=(0.0, 0.0, 0.0), doppler=None)
    t = inner_times(made.session)
    path = fit_gnss_path(made.session)
    assert horizontal_rms(path.at(t).track_n - lap_motion(t)) < 0.6 * 2.5 * np.sqrt(2.0)
    np.testing.assert_allclose(path.position_sigma[:2], 2.5, rtol=0.1)


def test_speeds_without_a_course_are_measurements(lap_fixes: Make, lap_motion: Make) -> None:
    """The speed is as good as of full velocities, and far better than of positions alone; the sigma knows both."""
    made = lap_fixes(rate=5.0)
    t, velocity_n = inner_times(made.session), made.session.gnss.velocity_n
    speed = np.hypot(velocity_n[:, 0], velocity_n[:, 1])
    unknown = np.full_like(velocity_n, np.nan)
    truth = np.linalg.norm(np.gradient(lap_motion(t)[:, :2], t, axis=0), axis=1)
    errors = []
    for columns in ({"speed": speed}, {"velocity_n": unknown, "speed": speed}, {"velocity_n": unknown}):
        path = fit_gnss_path(with_fixes(made.session, **columns))
        v = path.at(t).velocity_n
        errors.append(float(np.sqrt(np.mean((np.hypot(v[:, 0], v[:, 1]) - truth) ** 2))))
    full, alone, none = errors
    assert alone < 1.2 * full and alone < 0.6 * none
    sigma = fit_gnss_path(with_fixes(made.session, velocity_n=unknown, speed=speed)).sigma_at(t)
    along = path.at(t).velocity_n[:, :2]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    of_speed = np.sum((along * sigma.velocity_n[:, :2]) ** 2, axis=1)
    of_speed += 2.0 * along[:, 0] * along[:, 1] * sigma.velocity_cross
    assert 0.7 * alone < np.sqrt(np.mean(of_speed)) < 1.4 * alone


def test_velocity_is_the_rate_of_change_of_position(lap_fixes: Make) -> None:
    path = fit_gnss_path(lap_fixes(duration=30.0).session)
    t, step = np.linspace(path.t[0] + 0.1, path.t[-1] - 0.1, 500), 1e-4
    before, here, after = path.at(t - step), path.at(t), path.at(t + step)
    speed = (after.position_n - before.position_n) / (2.0 * step)
    np.testing.assert_allclose(speed, here.velocity_n, atol=1e-5)
    # at a node the third derivative jumps, so that the difference is only of first order there
    np.testing.assert_allclose((after.velocity_n - before.velocity_n) / (2.0 * step), here.acceleration_n, atol=1e-2)


@pytest.mark.parametrize("rate", [5.0, 10.0])
@pytest.mark.parametrize("seed", range(2))
def test_jumps_of_seconds_leave_no_trace_with_doppler(lap_fixes: Make, rate: float, seed: int) -> None:
    made, clean = (lap_fixes(seed=seed, rate=rate, jumps=jumps) for jumps in (JUMPS, ()))
    path = fit_gnss_path(made.session)
    assert path.position_weight[made.is_bad].max() < 0.1
    assert path.position_weight[~made.is_bad].mean() > 0.98
    t = inner_times(made.session)
    # for 5 s Doppler of 0.15 m/s carries the path alone: 0.15 sqrt(0.2 x 5) = 0.15 m
    assert horizontal_rms(path.at(t).track_n - fit_gnss_path(clean.session).at(t).track_n) < 0.25


def test_jumps_without_doppler_are_left_out_too_when_fixes_come_quickly(lap_fixes: Make) -> None:
    made = lap_fixes(rate=10.0, doppler=None, jumps=JUMPS)
    path = fit_gnss_path(made.session)
    assert path.position_weight[made.is_bad].max() < 0.1
    assert path.position_weight[~made.is_bad].mean() > 0.98


def test_wild_doppler_is_left_out(lap_fixes: Make, lap_motion: Make) -> None:
    made = lap_fixes()
    rng = np.random.default_rng(1)
    wild = rng.random(len(made.session.gnss)) < 0.05
    velocity = made.session.gnss.velocity_n.copy()
    velocity[wild, :2] += rng.normal(0.0, 8.0, (np.count_nonzero(wild), 2))
    path = fit_gnss_path(with_fixes(made.session, velocity_n=velocity))
    t = inner_times(made.session)
    assert horizontal_rms(path.at(t).velocity_n - lap_motion(t, 1)) < 0.2
    np.testing.assert_allclose(path.velocity_sigma[0], 0.15, rtol=0.25)


@pytest.mark.parametrize("rows", [[0], [100], [100, 101, 102, 103]])
def test_a_wrong_hemisphere_does_not_move_the_path(lap_fixes: Make, rows: list[int]) -> None:
    session = lap_fixes().session
    latitude = session.gnss.lat_deg.copy()
    latitude[rows] *= -1.0
    path = fit_gnss_path(with_fixes(session, lat_deg=latitude))
    t = inner_times(session)
    assert path.position_weight[rows].max() == 0.0
    assert np.abs(path.at(t).track_n - fit_gnss_path(session).at(t).track_n).max() < 1.0


def test_fixes_that_report_a_bad_accuracy_count_less_and_the_level_of_the_report_does_not_matter(
    lap_fixes: Make,
) -> None:
    session = lap_fixes().session
    reported = np.where(session.gnss.t < 8.0, 30.0, 0.5)
    position = session.fix_position_n
    position[session.gnss.t < 8.0, :2] += 8.0
    lat, lon, alt = nwu_to_geodetic(position, session.origin)
    shifted = with_fixes(session, lat_deg=lat, lon_deg=lon, alt_m=alt, sigma_horizontal=reported)
    punctual = GnssPathOptions(latency_change=0.0)
    path = fit_gnss_path(shifted, punctual)
    assert path.position_scale[0] == pytest.approx(60.0)
    t = np.arange(session.gnss.t[0], 7.0, 0.1)
    apart = path.at(t).track_n - fit_gnss_path(session).at(t).track_n
    assert np.abs(apart[:, :2]).max() < 3.0  # of 8 m, without a single fix rejected
    louder = with_fixes(shifted, sigma_horizontal=7 * reported)
    np.testing.assert_allclose(fit_gnss_path(louder, punctual).position_n, path.position_n, atol=1e-6)


@pytest.mark.parametrize(
    "changes",
    [
        {"doppler": None},
        {"rate": 1.0, "doppler": None},
        {"rate": 0.2},
        {"rate": 25.0, "duration": 20.0},
        {"rate": 100.0, "duration": 10.0},
        {"outages": [(20.0, 80.0)]},
        {"outages": [(20.0, 80.0)], "doppler": None},
        {"is_still": True},
        {"is_still": True, "doppler": None, "has_altitude": False},
        {"is_still": True, "white": (0.0, 0.0, 0.0), "offset": (0.0, 0.0, 0.0), "doppler": 0.0, "rate": 20.0},
        {"has_altitude": False},
        {"duration": 0.4},
        {"duration": 0.2},
        {"duration": 0.2, "doppler": None, "has_altitude": False},
    ],
    ids=str,
)
def test_scarce_data_gives_a_bounded_path_with_its_sigma(lap_fixes: Make, changes: dict[str, Any]) -> None:
    session = lap_fixes(**changes).session
    path = fit_gnss_path(session)
    t = np.arange(session.gnss.t[0], session.gnss.t[-1] + 0.01, 0.02)
    motion, sigma = path.at(t), path.sigma_at(t)
    assert np.isfinite(motion.position_n).all()
    assert np.isfinite(sigma.position_n).all()
    assert np.abs(motion.position_n[:, :2]).max() < 400.0  # the lap reaches 160 m from its middle
    assert np.abs(motion.velocity_n).max() < 60.0  # and is driven at up to 37 m/s
    at_fixes = path.at(session.gnss.t).track_n - session.fix_position_n
    assert np.nanmax(np.abs(at_fixes)) < 2.0  # white noise of 0.35 m up, five sigma
    if not changes.get("has_altitude", True):
        assert sigma.position_n[:, 2].min() >= 100.0 - 1e-9  # rounding of the interpolation


def test_an_outage_makes_sigma_grow_and_the_truth_stays_within_it(lap_fixes: Make, lap_motion: Make) -> None:
    session = lap_fixes(outages=[(40.0, 50.0)]).session
    path = fit_gnss_path(session)
    t = np.arange(40.0, 50.0, 0.1)
    sigma, error = path.sigma_at(t).track_n, path.at(t).track_n - lap_motion(t)
    assert sigma[50, 0] > 20.0 * path.sigma_at(np.array([30.0])).track_n[0, 0]
    assert np.all(np.abs(error[:, :2]) < 4.0 * np.hypot(sigma[:, :2], 2.0))


def test_standing_still_shows_no_speed_and_no_lag(lap_fixes: Make) -> None:
    session = lap_fixes(is_still=True).session
    path = fit_gnss_path(session)
    t = inner_times(session)
    assert np.sqrt(np.mean(path.at(t).velocity_n[:, :2] ** 2)) < 0.15  # Doppler's own noise
    assert not path.velocity_lag.observable


def test_configured_latencies_are_kept(lap_fixes: Make) -> None:
    session = lap_fixes(latency=0.15, lag=0.1).session
    stated = replace(session, config=SessionConfig(gps=GnssTiming(position_latency=0.15, velocity_latency=0.25)))
    path = fit_gnss_path(stated)
    assert (path.position_latency, path.velocity_lag.source) == (0.15, "configured")
    assert path.velocity_lag.value == pytest.approx(0.1)
    overruled = fit_gnss_path(stated, GnssPathOptions(position_latency=0.0, velocity_latency=0.0))
    assert (overruled.position_latency, overruled.velocity_lag.value) == (0.0, 0.0)


def test_latency_moves_the_path_in_time(lap_fixes: Make, lap_motion: Make) -> None:
    quiet = {"white": (0.01, 0.01, 0.01), "offset": (0.01, 0.01, 0.01), "doppler": 0.01}
    session = lap_fixes(latency=0.3, **quiet).session
    t = inner_times(session)
    assert horizontal_rms(fit_gnss_path(session).at(t).track_n - lap_motion(t)) < 0.1  # 0.3 s are 6 m


def sampled_session(seed: int, motion: WhiteJerk, duration: float, rate: float) -> tuple[Session, Array, Array]:
    """Fixes of a path drawn from the prior itself, and its true states (N, 3, 2), offset (N, 2); no height."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * rate)) / rate
    step = np.array([1.0 / rate])
    Phi, covariance = (part[0] for part in motion.discrete(step))
    root = np.linalg.cholesky(covariance)
    states, offset = np.zeros((t.size, 3, 2)), np.zeros((t.size, 2))
    states[0, 1:] = rng.normal(size=(2, 2)) * np.array([[motion.velocity], [motion.acceleration]])
    offset[0] = rng.normal(0.0, 2.0, 2)
    keep = np.exp(-1.0 / (rate * 60.0))
    for k in range(1, t.size):
        states[k] = Phi @ states[k - 1] + root @ rng.normal(size=(3, 2))
        offset[k] = keep * offset[k - 1] + 2.0 * np.sqrt(1.0 - keep**2) * rng.normal(size=2)
    position, velocity = np.zeros((t.size, 3)), np.full((t.size, 3), np.nan)
    position[:, :2] = states[:, 0] + offset + rng.normal(0.0, 0.3, (t.size, 2))
    velocity[:, :2] = states[:, 1] + rng.normal(0.0, 0.2, (t.size, 2))
    origin = Origin(45.0, 12.0, 50.0)
    lat, lon, _ = nwu_to_geodetic(position, origin)
    return Session("sampled", GnssFixes(t, lat, lon, np.full(t.size, np.nan), velocity), origin), states, offset


def test_sigmas_are_honest_where_the_model_is_true() -> None:
    """Mean squared error over sigma squared near 1, over 24 sessions of 60 s with noise and lag identified."""
    motion = WhiteJerk(5.0, 12.0, 6.0)
    options = GnssPathOptions(velocity_bias_sigma=0.0)
    squares, jerk = [], []
    for seed in range(24):
        session, states, offset = sampled_session(seed, motion, 60.0, 5.0)
        path = fit_gnss_path(session, options)
        jerk.append(path.jerk_density[0])
        found, sigma = path.at(session.gnss.t), path.sigma_at(session.gnss.t)
        squares.append(
            [
                np.mean(((found.velocity_n[:, :2] - states[:, 1]) / sigma.velocity_n[:, :2]) ** 2),
                np.mean(((found.track_n[:, :2] - states[:, 0] - offset) / sigma.track_n[:, :2]) ** 2),
                np.mean(((found.position_n[:, :2] - states[:, 0]) / sigma.position_n[:, :2]) ** 2),
            ]
        )
    assert np.mean(jerk) == pytest.approx(5.0, rel=0.15)
    velocity, track, position = np.mean(squares, axis=0)
    # velocity and track decorrelate within seconds, 24 x 60 samples; position over 60 s, 48 samples: 1 +- 4 x 0.2
    assert 0.8 < velocity < 1.25
    assert 0.75 < track < 1.3
    assert 0.4 < position < 1.8


def test_cost_grows_with_the_number_of_fixes_and_not_faster(lap_fixes: Make) -> None:
    """Rounds stay few whatever the length; each round is linear by construction of the chain."""
    assert fit_gnss_path(lap_fixes(duration=600.0).session).iterations <= 8
