"""Long sessions in windows: what the whole would have given, and no seam to be seen."""

import numpy as np
import pytest

from smoother import so3
from smoother.estimate import solve
from smoother.estimate.initial.guess import busiest_part, busiest_span, make_start, stretch
from smoother.estimate.output import windows
from smoother.estimate.smoother import GraphOptions, GraphSmoother
from smoother.prepare import prepare
from smoother.sim.motion import Stop
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import Trajectory

Pair = tuple[Trajectory, Trajectory]


@pytest.fixture(scope="module")
def pair() -> Pair:
    """Five minutes solved at once, and in windows of 80 s that overlap by 60 s to either side."""
    session = prepare(simulate_preset("kart", 3, duration=300.0).raw)
    whole = GraphSmoother().estimate(session)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(windows, "WINDOW", 80.0)
        patch.setattr(solve, "WINDOW", 80.0)
        patch.setattr(windows, "OVERLAP", 60.0)
        return whole, GraphSmoother().estimate(session)


@pytest.fixture(scope="module")
def joint_pair(pair: Pair) -> Pair:
    """The same with constants from all five minutes: how well 80 s show Doppler's mean is not what is compared."""
    session = prepare(simulate_preset("kart", 3, duration=300.0).raw)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(windows, "WINDOW", 80.0)
        patch.setattr(solve, "WINDOW", 80.0)
        patch.setattr(windows, "OVERLAP", 60.0)
        patch.setattr(solve, "busiest_part", lambda start, span: start)
        return pair[0], GraphSmoother().estimate(session)


def in_sigmas(difference: np.ndarray, sigma: np.ndarray) -> float:
    return float(np.sqrt(np.mean((difference / sigma) ** 2)))


def test_the_windows_agree_with_the_whole_to_a_part_of_a_sigma(pair: Pair) -> None:
    whole, parts = pair
    assert whole.sigmas is not None
    np.testing.assert_array_equal(parts.t, whole.t)
    turn = so3.log(whole.R_nb.transpose(0, 2, 1) @ parts.R_nb)
    # the constants are those of 80 s, not of 300 s: their part of every error is larger
    assert in_sigmas(parts.velocity_n - whole.velocity_n, whole.sigmas.velocity_n) < 0.4
    assert in_sigmas(turn, whole.sigmas.attitude) < 0.7
    assert in_sigmas(parts.position_n - whole.position_n, whole.sigmas.position_n) < 0.5


@pytest.mark.parametrize(
    "name",
    [
        "position_n",
        "velocity_n",
        "track",
        "attitude",
    ],
)
def test_sigmas_are_those_of_the_whole_or_little_more(pair: Pair, name: str) -> None:
    whole, parts = pair
    ratio = np.median(getattr(parts.sigmas, name) / getattr(whole.sigmas, name))
    assert 0.9 < ratio < 1.3, name


def test_no_seam_shows_in_position_or_velocity(pair: Pair) -> None:
    _, parts = pair
    dt = float(parts.t[1] - parts.t[0])
    mean_velocity = 0.5 * (parts.velocity_n[1:] + parts.velocity_n[:-1])
    slip = np.linalg.norm(np.diff(parts.position_n, axis=0) / dt - mean_velocity, axis=1)
    assert np.max(slip) < 0.5  # m/s; a step of 1 m would be 5 m/s between two keyframes


def test_every_fix_is_reported_once(pair: Pair) -> None:
    whole, parts = pair
    assert whole.report.fixes is not None
    assert parts.report.fixes is not None
    np.testing.assert_array_equal(parts.report.fixes.index, whole.report.fixes.index)
    used = np.isfinite(parts.report.fixes.residual_n).all(axis=1)
    assert np.mean(used == np.isfinite(whole.report.fixes.residual_n).all(axis=1)) > 0.99
    assert parts.report.residuals["gps_velocity"].count == pytest.approx(
        whole.report.residuals["gps_velocity"].count, abs=5
    )
    assert set(parts.report.identified) == set(whole.report.identified)


def test_what_is_left_of_wheels_and_samples_is_reported_of_all_intervals(pair: Pair) -> None:
    of_whole, of_parts = (one.report.residuals for one in pair)
    assert {"slip", "inertial", "bias_walk"} < set(of_whole) == set(of_parts)
    assert of_parts["inertial"].count == of_whole["inertial"].count
    assert of_parts["slip"].count == pytest.approx(of_whole["slip"].count, abs=10)
    for name in ("slip", "inertial"):
        assert 0.1 < of_whole[name].normalised_rms < 1.0  # the path is fitted to them
        assert of_parts[name].normalised_rms == pytest.approx(of_whole[name].normalised_rms, rel=0.15), name


def change(trajectory: Trajectory, t: np.ndarray, lap: float) -> np.ndarray:
    """Sigma of how the error towards north changes over `lap` s from each t (m,)."""
    assert trajectory.joint is not None
    north = np.tile([1.0, 0.0, 0.0], (2 * len(t), 1))
    P = trajectory.joint.covariance(np.concatenate([t, t + lap]), north)
    m = len(t)
    return np.sqrt(np.diag(P)[:m] + np.diag(P)[m:] - 2.0 * np.diag(P[:m, m:]))


def test_errors_hang_together_over_a_lap_as_they_do_in_the_whole_also_across_seams(
    joint_pair: Pair,
) -> None:
    whole, parts = joint_pair
    t = np.arange(whole.t[0] + 1.0, whole.t[-1] - 41.0, 3.7)
    ratio = change(parts, t, 40.0) / change(whole, t, 40.0)
    assert 1.0 < np.median(ratio) < 1.05  # the fixes beyond the overlap tell a little
    assert np.all((ratio > 0.98) & (ratio < 1.1))


def test_the_error_of_a_single_time_is_the_one_that_is_reported(pair: Pair) -> None:
    _, parts = pair
    assert parts.joint is not None
    assert parts.sigmas is not None
    rows = np.arange(100, len(parts), 777)
    north = np.tile([1.0, 0.0, 0.0], (len(rows), 1))
    sigma = np.sqrt(np.diag(parts.joint.covariance(parts.t[rows], north)))
    np.testing.assert_allclose(sigma, parts.sigmas.position_n[rows, 0], rtol=0.03)  # between keyframes of 0.8 s


def test_times_that_no_window_holds_together_share_the_unseen_offset_alone(pair: Pair) -> None:
    _, parts = pair
    assert parts.joint is not None
    P = parts.joint.covariance(parts.t[[10, -10]], np.tile([0.0, 1.0, 0.0], (2, 1)))
    np.testing.assert_allclose(P, P.T)
    assert 0.0 <= P[0, 1] < P[0, 0]


def test_the_busiest_part_of_a_stretch_is_of_that_stretch() -> None:
    """A session of fifty minutes ended in an error, where its busiest two minutes were not of its busiest twenty."""
    stops = tuple(Stop(20.0 + 40.0 * k, 10.0) for k in range(6))  # then it drives on
    session = prepare(simulate_preset("kart", 3, duration=420.0, motion_stops=stops).raw)
    start = make_start(session, GraphOptions())
    begin, _ = busiest_span(start.driven, start.spans, 60.0)
    assert begin > 240.0
    earlier = stretch(start, 0, int(np.searchsorted(start.state.t, 200.0)))
    part = busiest_part(earlier, 60.0).state.t
    assert part[0] >= earlier.state.t[0] and part[-1] <= earlier.state.t[-1] and 55.0 < np.ptp(part) < 65.0
    whole = busiest_part(start, 60.0).state.t
    assert whole[0] > 230.0 and 55.0 < np.ptp(whole) < 65.0
