"""Accuracy figures against answers known from a formula."""

import numpy as np
import pytest

from smoother import so3
from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.estimate.baseline.baseline import GpsAlone, fixes_as_trajectory
from smoother.estimate.judge.evaluate import at_fixes, evaluate, nees, without_doubtful_velocity
from smoother.estimate.output.resample import resample
from smoother.frames import Origin, nwu_to_geodetic, rotation_from_euler
from smoother.samples import GnssFixes, Session
from smoother.trajectory import EstimateReport, Keyframes, Sigmas, Trajectory
from smoother.units import DEG

RADIUS, RATE = 20.0, 0.7  # m, rad/s: 14 m/s, a fast kart corner
ORIGIN = Origin(45.0, 12.0, 30.0)


def circle(t: Array, radius: float = RADIUS, yaw_offset: float = 0.0) -> Trajectory:
    """A level kart on a circle about n's origin, nose along its path."""
    angle = RATE * t
    direction = np.stack([np.cos(angle), np.sin(angle), 0 * t], axis=1)
    across = np.stack([-np.sin(angle), np.cos(angle), 0 * t], axis=1)
    zero = np.zeros_like(t)
    return Trajectory(
        t=t,
        position_n=radius * direction,
        velocity_n=radius * RATE * across,
        R_nb=rotation_from_euler(zero, zero, angle + np.pi / 2 + yaw_offset),
        acceleration_b=np.tile([0.0, radius * RATE**2, 0.0], (len(t), 1)),
        angular_rate_b=np.tile([0.0, 0.0, RATE], (len(t), 1)),
    )


def shifted(
    trajectory: Trajectory, position: Array, velocity: Array | None = None, turn: Array | None = None
) -> Trajectory:
    return Trajectory(
        trajectory.t,
        trajectory.position_n + position,
        trajectory.velocity_n + (0.0 if velocity is None else velocity),
        trajectory.R_nb if turn is None else so3.exp(turn) @ trajectory.R_nb,
        trajectory.acceleration_b,
        trajectory.angular_rate_b,
        trajectory.sigmas,
        trajectory.report,
    )


def session_of(fixes_n: Array, t: Array, velocity_n: Array | None = None) -> Session:
    lat, lon, alt = nwu_to_geodetic(fixes_n, ORIGIN)
    velocity = np.full((len(t), 3), np.nan) if velocity_n is None else velocity_n
    return Session("circle", GnssFixes(t, lat, lon, alt, velocity), ORIGIN)


def test_a_perfect_estimate_has_no_error_at_times_between_its_rows():
    truth = circle(np.arange(0.003, 20.0, 0.0137))
    result = evaluate(circle(np.arange(0.0, 20.02, 0.02)), truth)
    # cubic Hermite over 20 ms of a circle: d^4 x / 384 * dt^4 < 1e-8 m; velocity linear: dt^2/8 * jerk = 3.4e-4 m/s
    assert result.horizontal_rms_m < 1e-7
    assert result.velocity_rms_mps < 5e-4
    assert result.yaw_rms_deg < 1e-9
    assert result.relative_1s_rms_m < 1e-7
    assert result.count == len(truth)


def test_constant_offsets_come_out_as_they_went_in():
    truth = circle(np.arange(0.0, 10.0, 0.02))
    estimate = shifted(truth, np.array([3.0, 4.0, 1.5]), np.array([0.1, 0.2, 0.2]))
    result = evaluate(estimate, truth)
    assert result.horizontal_rms_m == pytest.approx(5.0)
    assert result.horizontal_max_m == pytest.approx(5.0)
    assert result.up_rms_m == pytest.approx(1.5)
    assert result.velocity_rms_mps == pytest.approx(0.3)
    assert result.horizontal_velocity_rms_mps == pytest.approx(np.hypot(0.1, 0.2))
    assert result.relative_1s_rms_m == pytest.approx(0.0, abs=1e-12)
    assert np.hypot(result.along_track_rms_m, result.cross_track_rms_m) == pytest.approx(5.0)


def test_an_error_along_the_path_is_along_track():
    truth = circle(np.arange(0.0, 10.0, 0.02))
    late = Trajectory(**{**vars(circle(truth.t - 0.01)), "t": truth.t})
    result = evaluate(late, truth)
    assert result.along_track_rms_m == pytest.approx(RADIUS * RATE * 0.01, rel=1e-3)
    assert result.cross_track_rms_m < 1e-3
    assert result.lag_s == pytest.approx(0.01, abs=2e-4)
    assert result.horizontal_rms_at_lag_m < 5e-3  # xatol of the search times the speed


def test_yaw_errors_are_taken_across_the_half_turn():
    truth = circle(np.arange(0.0, 20.0, 0.02))
    result = evaluate(circle(truth.t, yaw_offset=2 * DEG), truth)
    assert result.yaw_rms_deg == pytest.approx(2.0)
    assert result.roll_rms_deg == pytest.approx(0.0, abs=1e-9)


def test_relative_error_is_the_change_of_the_error_over_one_second():
    truth = circle(np.arange(0.0, 30.0, 0.02))
    drift = np.stack([0.3 * truth.t, 0 * truth.t, 0 * truth.t], axis=1)
    assert evaluate(shifted(truth, drift), truth).relative_1s_rms_m == pytest.approx(0.3)


def test_coverage_counts_errors_within_the_reported_sigma():
    rng = np.random.default_rng(3)
    truth = circle(np.arange(0.0, 400.0, 0.02))
    n = len(truth)
    estimate = shifted(truth, rng.normal(0.0, 0.5, (n, 3)), rng.normal(0.0, 0.1, (n, 3)))
    sigma = Sigmas(np.full((n, 3), 0.5), np.full((n, 3), 0.05), np.ones(n), np.ones((n, 3)), np.ones(n))
    estimate = Trajectory(**{**vars(estimate), "sigmas": sigma})
    result = evaluate(estimate, truth)
    # 60,000 independent errors: the share scatters by 0.2 %; velocity sigma is half of what it should be
    assert result.coverage_1sigma == pytest.approx(0.6827, abs=0.01)
    assert result.coverage_2sigma == pytest.approx(0.9545, abs=0.005)
    assert result.coverage["vel_north"][0] == pytest.approx(0.3829, abs=0.02)


def keyframes_of(truth: Trajectory, covariance: Array, rng: np.random.Generator) -> Keyframes:
    error = rng.multivariate_normal(np.zeros(9), covariance, len(truth))
    zero = np.zeros((len(truth), 3))
    return Keyframes(
        truth.t,
        truth.position_n - error[:, 6:],
        truth.velocity_n - error[:, 3:6],
        so3.exp(-error[:, :3]) @ truth.R_nb,
        np.tile(covariance, (len(truth), 1, 1)),
        zero,
        zero,
        zero,
        zero,
    )


def test_nees_of_an_honest_covariance_is_its_dimension():
    rng = np.random.default_rng(5)
    truth = circle(np.arange(0.0, 200.0, 0.1))
    root = rng.normal(size=(9, 9)) * np.repeat([0.01, 0.1, 1.0], 3)[:, None]
    covariance = root @ root.T
    result = nees(keyframes_of(truth, covariance, rng), truth)
    assert result is not None
    assert (result.dimension, result.count) == (9, len(truth))
    # chi-square with 9 degrees over 2000 samples: sigma of the mean is sqrt(18 / 2000) = 0.095
    assert result.mean == pytest.approx(9.0, abs=0.4)
    keyframes = keyframes_of(truth, covariance, rng)
    boastful = nees(Keyframes(**{**vars(keyframes), "covariance": keyframes.covariance / 4}), truth)
    assert boastful is not None
    assert boastful.mean == pytest.approx(36.0, abs=1.6)


def test_nees_uses_what_the_truth_holds():
    rng = np.random.default_rng(6)
    truth = circle(np.arange(0.0, 200.0, 0.1))
    covariance = np.diag(np.repeat([1e-4, 1e-2, 1.0], 3))
    keyframes = keyframes_of(truth, covariance, rng)
    without_attitude = Trajectory(**{**vars(truth), "R_nb": np.full((len(truth), 3, 3), np.nan)})
    result = nees(keyframes, without_attitude)
    assert result is not None
    assert result.dimension == 6
    assert result.mean == pytest.approx(6.0, abs=0.35)


def test_truth_without_attitude_and_velocity_leaves_those_figures_unknown():
    t = np.arange(0.0, 20.0, 0.2)
    full = circle(t)
    unknown = np.full((len(t), 3), np.nan)
    truth = Trajectory(t, full.position_n, unknown, np.full((len(t), 3, 3), np.nan), unknown, unknown)
    result = evaluate(shifted(circle(np.arange(0.0, 20.02, 0.02)), np.array([1.0, 0.0, 0.0])), truth)
    assert result.horizontal_rms_m == pytest.approx(1.0, abs=1e-6)
    assert np.isfinite(result.along_track_rms_m)  # the direction comes from the positions
    assert np.isnan(result.velocity_rms_mps)
    assert np.isnan(result.yaw_rms_deg)


def test_the_start_is_left_out_only_on_request():
    truth = circle(np.arange(0.0, 20.0, 0.02))
    early = np.where(truth.t < 10.0, 6.0, 0.0)[:, None] * [1.0, 0.0, 0.0]
    estimate = shifted(truth, early)
    assert evaluate(estimate, truth).horizontal_rms_m == pytest.approx(6.0 / np.sqrt(2), rel=1e-3)
    assert evaluate(estimate, truth, skip=10.0).horizontal_rms_m == pytest.approx(0.0, abs=1e-9)


def test_truth_on_another_clock_is_a_clear_error():
    with pytest.raises(SessionError, match="do not overlap"):
        evaluate(circle(np.arange(0.0, 10.0, 0.02)), circle(np.arange(100.0, 110.0, 0.02)))


def test_gps_alone_joins_the_fixes_with_straight_lines():
    t = np.array([0.0, 1.0, 2.0])
    fixes_n = np.array([[0.0, 0.0, 0.0], [10.0, 0.0, 2.0], [10.0, -20.0, 2.0]])
    result = GpsAlone().estimate(session_of(fixes_n, t))
    middle = resample(result, np.array([0.5, 1.0, 1.25])).position_n
    assert middle == pytest.approx(np.array([[5.0, 0.0, 1.0], [10.0, 0.0, 2.0], [10.0, -5.0, 2.0]]), abs=1e-6)
    assert set(t) <= set(result.t)


def test_errors_at_the_fixes_leave_the_straight_lines_between_them_out():
    t = np.arange(0.0, 21.0, 1.0)
    truth = circle(np.arange(0.0, 20.01, 0.01))
    session = session_of(circle(t).position_n, t)
    gps = GpsAlone().estimate(session)
    # the chord of a 1 s step of 0.7 rad leaves the arc by up to r (1 - cos 0.35) = 1.2 m
    assert evaluate(gps, truth).horizontal_rms_m > 0.5
    assert at_fixes(gps, truth, session) == pytest.approx(0.0, abs=1e-5)


def test_resampling_does_not_bridge_gaps_longer_than_asked():
    whole = circle(np.arange(0.0, 10.0, 0.02))
    holed = Trajectory(
        **{k: v[(whole.t < 4.0) | (whole.t > 6.0)] for k, v in vars(whole).items() if isinstance(v, np.ndarray)}
    )
    result = resample(holed, np.array([3.0, 5.0, 7.0]), longest_gap=0.5)
    assert list(np.isfinite(result.position_n[:, 0])) == [True, False, True]
    assert list(np.isfinite(result.R_nb[:, 0, 0])) == [True, False, True]


def test_a_single_fix_is_a_trajectory_too():
    session = session_of(np.zeros((1, 3)), np.array([5.0]))
    assert len(GpsAlone().estimate(session)) == 1
    assert len(fixes_as_trajectory(session)) == 1


def test_an_estimate_without_keyframes_has_no_nees():
    truth = circle(np.arange(0.0, 2.0, 0.02))
    assert evaluate(Trajectory(**{**vars(truth), "report": EstimateReport()}), truth).nees is None


def test_a_truth_whose_velocity_contradicts_its_positions_loses_it() -> None:
    truth = circle(np.arange(0.0, 60.0, 1.0))
    assert without_doubtful_velocity(truth) is truth
    mirrored = Trajectory(**{**vars(truth), "velocity_n": truth.velocity_n * [1.0, -1.0, 1.0]})
    assert np.isnan(without_doubtful_velocity(mirrored).velocity_n).all()
    silent = Trajectory(**{**vars(truth), "velocity_n": np.full((len(truth), 3), np.nan)})
    assert without_doubtful_velocity(silent) is silent
