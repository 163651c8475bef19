"""The quality gate: passes what is honest, however poor, and stops what is wrong."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.estimate.judge.quality import QualityLimits, assess
from smoother.frames import Origin, nwu_to_geodetic, rotation_from_euler
from smoother.samples import DEAD_AXES, GnssFixes, Problem, Session
from smoother.trajectory import EstimateReport, Identified, ResidualStatistics, Sigmas, Trajectory

ORIGIN = Origin(45.0, 12.0, 30.0)
SPEED = 20.0  # m/s along north
SECONDS = 200.0


def session(error_n: np.ndarray | None = None, hacc: float = 2.0, latency: float = 0.0) -> Session:
    t = np.arange(0.0, SECONDS, 0.2)
    position = np.stack([SPEED * (t - latency), 0 * t, 0 * t], axis=1) + (0.0 if error_n is None else error_n)
    lat, lon, alt = nwu_to_geodetic(position, ORIGIN)
    fixes = GnssFixes(t, lat, lon, alt, np.full((len(t), 3), np.nan), sigma_horizontal=np.full(len(t), hacc))
    return Session("straight", fixes, ORIGIN)


def estimate(sigma: float = 1.0, report: EstimateReport | None = None, factor: float = 1.0) -> Trajectory:
    t = np.arange(0.0, SECONDS - 0.2, 0.02)
    n = len(t)
    sigmas = Sigmas(np.full((n, 3), sigma), np.ones((n, 3)), np.ones(n), np.ones((n, 3)), np.ones(n))
    zero = np.zeros((n, 3))
    velocity = np.tile([SPEED * factor, 0.0, 0.0], (n, 1))
    report = EstimateReport() if report is None else report
    return Trajectory(t, velocity * t[:, None], velocity, np.tile(np.eye(3), (n, 1, 1)), zero, zero, sigmas, report)


def shifted_rows(first: int, last: int, north: float) -> np.ndarray:
    error = np.zeros((round(SECONDS / 0.2), 3))
    error[first:last, 0] = north
    return error


def test_a_trajectory_along_its_fixes_passes() -> None:
    quality = assess(session(), estimate())
    assert quality.passed
    assert quality.reasons == ()
    assert quality.measures["far_fix_share"] == 0.0
    assert quality.measures["top_speed_mps"] == pytest.approx(SPEED)


def test_wide_sigmas_and_bad_fixes_are_honest_not_wrong() -> None:
    noise = np.random.default_rng(2).normal(0.0, 10.0, (round(SECONDS / 0.2), 3))
    assert assess(session(noise, hacc=15.0), estimate(sigma=20.0)).passed


def test_a_known_latency_is_no_distance() -> None:
    late = session(latency=0.4)  # 8 m along the track
    told = EstimateReport(identified={"gps_position_latency": Identified(0.4, 0.01, "s", True, "identified")})
    assert assess(late, estimate(report=told)).measures["median_fix_distance_m"] == pytest.approx(0.0, abs=1e-3)
    assert not assess(late, estimate(), QualityLimits()).passed


def test_some_jumps_of_the_fixes_are_accepted() -> None:
    assert assess(session(shifted_rows(100, 150, 40.0)), estimate()).passed  # 10 s of 200 s, refused by the smoother


@pytest.mark.parametrize(("speed", "passes"), [(0.6, True), (3.0, False)])
def test_fixes_that_wander_while_the_kart_stands_are_no_fault_of_the_result(speed: float, passes: bool) -> None:
    """Under a roof; fixes that say that they go somewhere are judged."""
    whole, driven = session(shifted_rows(0, 300, 20.0)), estimate()
    velocity = np.where(whole.gnss.t[:, None] < 60.0, speed, SPEED) * [1.0, 0.0, 0.0]
    whole = replace(whole, gnss=replace(whole.gnss, velocity_n=velocity))
    assert not assess(whole, driven).passed
    stood = np.where(driven.t[:, None] < 60.0, 0.0, driven.velocity_n)
    assert assess(whole, replace(driven, velocity_n=stood)).passed == passes


@pytest.mark.parametrize(("length", "passes"), [(30, True), (38, False)])  # rows: 12 and 15.2 s of a minute
def test_a_short_session_may_have_as_long_jumps_as_a_long_one(length: int, passes: bool) -> None:
    jumps = shifted_rows(40, 40 + length, 40.0) + shifted_rows(150, 150 + length, 40.0)
    whole = session(jumps)
    minute = replace(whole, gnss=whole.gnss.select(whole.gnss.t < 60.0))
    assert assess(minute, estimate()).passed is passes
    assert not assess(replace(whole, gnss=whole.gnss.select(whole.gnss.t < 40.0)), estimate()).passed


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda: assess(session(shifted_rows(0, 150, 40.0)), estimate()), "15 % of the fixes lie far"),
        (lambda: assess(session(shifted_rows(100, 190, 40.0)), estimate()), "leaves the fixes for 18 s"),
        (lambda: assess(session(), estimate(sigma=60.0)), "horizontal sigma is 85 m"),
        (lambda: assess(session(), estimate(sigma=float("nan"))), "horizontal sigma is nan"),
        (lambda: assess(session(), estimate(factor=6.0)), "432 km/h is not a kart's"),
        (lambda: assess(session(), estimate(factor=float("nan"))), "no position or velocity"),
    ],
)
def test_what_is_wrong_is_stopped_with_its_reason(made: object, words: str) -> None:
    quality = made()  # type: ignore[operator]
    assert not quality.passed
    assert any(words in reason for reason in quality.reasons), quality.reasons


@pytest.mark.parametrize(
    ("residual", "words"),
    [
        (ResidualStatistics("m", 500, 0.0, 9.0, 9.0, 0), "residuals of gps position are 9.0 times their sigma"),
        (ResidualStatistics("m", 500, 0.0, 1.0, 1.0, 200), "40 % of gps position was rejected"),
        (ResidualStatistics("m", 5, 0.0, 9.0, 9.0, 5), ""),
        (ResidualStatistics("m", 500, 0.0, 1.0, 1.3, 20), ""),
    ],
)
def test_residuals_far_from_their_sigma_are_stopped(residual: ResidualStatistics, words: str) -> None:
    quality = assess(session(), estimate(report=EstimateReport(residuals={"gps_position": residual})))
    assert quality.passed == (words == "")
    assert words in "; ".join(quality.reasons)


@pytest.mark.parametrize("name", ["slip", "inertial", "bias_walk"])
def test_a_kart_that_slides_all_day_is_no_wrong_result(name: str) -> None:
    residuals = {name: ResidualStatistics("rad", 500, 0.0, 9.0, 9.0, 200)}
    assert assess(session(), estimate(report=EstimateReport(residuals=residuals))).passed


def test_wander_of_the_fixes_within_the_trajectory_s_own_sigma_is_no_distance() -> None:
    wander = 6.0 * np.sin(np.arange(0.0, SECONDS, 0.2) / 10.0)[:, None] * [1.0, 0.0, 0.0]
    assert assess(session(wander, hacc=0.0), estimate(sigma=3.0)).measures["far_fix_share"] == 0.0
    assert assess(session(wander, hacc=0.0), estimate(sigma=0.1)).measures["far_fix_share"] > 0.1


@pytest.mark.parametrize(
    ("source", "sigma", "is_far"), [("identified", 3.0, False), ("default", 3.0, False), ("default", 2.0, True)]
)
def test_wander_that_was_found_is_no_distance(source: str, sigma: float, is_far: bool) -> None:
    """Over a quarter of an hour the trajectory knows its place to a metre, and fixes go on wandering by three.

    Too short a session does not pin that; but what all receivers do, two metres, says nothing of this one.
    """
    wander = 6.0 * np.sin(np.arange(0.0, SECONDS, 0.2) / 10.0)[:, None] * [1.0, 0.0, 0.0]
    found = Identified([sigma, sigma, 2.0 * sigma], None, "m", True, source)
    told = EstimateReport(identified={"gps_offset_sigma": found})
    share = assess(session(wander, hacc=0.0), estimate(sigma=0.1, report=told)).measures["far_fix_share"]
    assert (share > 0.1) is is_far


def test_wander_that_no_receiver_has_is_one() -> None:
    found = Identified([50.0, 50.0, 80.0], None, "m", True, "identified")
    told = EstimateReport(identified={"gps_offset_sigma": found})
    assert not assess(session(shifted_rows(0, 999, 20.0), hacc=0.0), estimate(sigma=0.1, report=told)).passed


def leaning(roll: np.ndarray | float, pitch: np.ndarray | float = 0.0, yaw: np.ndarray | float = 0.0) -> Trajectory:
    """The drive with an attitude that wanders by a degree from corner to corner, and by these angles (rad) besides."""
    plain, rng = estimate(), np.random.default_rng(4)
    n = len(plain)
    wander = np.repeat(rng.normal(0.0, np.radians(1.0), (n // 100 + 1, 3)), 100, axis=0)[:n]
    angles = wander.T + np.stack([np.broadcast_to(angle, n) for angle in (roll, pitch, yaw)])
    assert plain.sigmas is not None
    sigmas = replace(plain.sigmas, attitude=np.full((n, 3), np.radians(0.8)))
    report = EstimateReport(mode="full")
    return replace(plain, R_nb=rotation_from_euler(*angles), sigmas=sigmas, report=report)


def half_way(degrees: float) -> np.ndarray:
    n = len(estimate())
    return np.where(np.arange(n) > 0.5 * n, np.radians(degrees), 0.0)


def test_a_kart_that_leans_and_slides_from_corner_to_corner_passes() -> None:
    assert assess(session(), leaning(0.0)).passed


@pytest.mark.parametrize("axis", [0, 1])
def test_a_kart_that_drives_on_its_side_is_none(axis: int) -> None:
    angles = [0.0, 0.0, 0.0]
    angles[axis] = np.radians(-90.0 if axis == 0 else 40.0)
    quality = assess(session(), leaning(*angles))
    assert any("deg off level: are the axes of the samples" in reason for reason in quality.reasons), quality.reasons


def test_a_remounted_logger_is_found_however_large_the_sigma_of_attitude() -> None:
    """Two mountings in one leave a third of the session on its side, and noise so large that no row is sure."""
    n = len(estimate())
    moved = leaning(np.where(np.arange(n) < 0.35 * n, np.radians(120.0), 0.0))
    assert moved.sigmas is not None
    unsure = replace(moved, sigmas=replace(moved.sigmas, attitude=np.full((n, 3), np.radians(4.0))))
    reasons = assess(session(), unsure).reasons
    assert [reason for reason in reasons if "deg off level for 60 s and more: did the logger move?" in reason], reasons


def test_a_slightly_remounted_logger_is_found_though_no_row_is_certain() -> None:
    moved = leaning(half_way(25.0))
    assert moved.sigmas is not None
    unsure = replace(moved, sigmas=replace(moved.sigmas, attitude=np.full((len(moved), 3), np.radians(5.0))))
    assert any("askew" in reason for reason in assess(session(), unsure).reasons)
    little = replace(leaning(half_way(8.0)), sigmas=unsure.sigmas)  # within three of such sigmas
    assert not any("askew" in reason for reason in assess(session(), little).reasons)


def test_a_kart_on_a_banked_track_passes() -> None:
    assert assess(session(), leaning(np.radians(18.0))).passed


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_logger_that_slips_by_four_degrees_about_any_axis_is_seen(axis: int) -> None:
    angles = [half_way(4.0) if i == axis else 0.0 for i in range(3)]
    quality = assess(session(), leaning(*angles))
    assert not quality.passed
    assert "askew" in quality.reasons[0]
    assert quality.measures["largest_lean_step_rad"] == pytest.approx(np.radians(4.0), abs=np.radians(0.6))


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(("degrees", "passes"), [(10.0, False), (3.0, True)])
def test_a_logger_that_is_knocked_in_the_last_minute_is_seen_if_it_went_far(
    axis: int, degrees: float, passes: bool
) -> None:
    t = estimate().t
    knocked = np.where(t > t[-1] - 40.0, np.radians(degrees), 0.0)
    quality = assess(session(), leaning(*[knocked if i == axis else 0.0 for i in range(3)]))
    assert quality.passed == passes
    assert passes or "askew" in quality.reasons[0]


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_logger_that_slips_little_by_little_is_seen(axis: int) -> None:
    creep = np.radians(12.0) * np.linspace(0.0, 1.0, len(estimate()))
    quality = assess(session(), leaning(*[creep if i == axis else 0.0 for i in range(3)]))
    assert any("more and more askew" in reason for reason in quality.reasons), quality.reasons
    assert quality.measures["lean_creep_rad"] == pytest.approx(np.radians(10.8), abs=np.radians(1.5))


def test_a_slowly_slipping_logger_is_found_though_it_widens_the_sigma_of_the_mounting() -> None:
    moved = leaning(np.radians(12.0) * np.linspace(0.0, 1.0, len(estimate())))
    assert moved.sigmas is not None
    unsure = replace(moved, sigmas=replace(moved.sigmas, attitude=np.full((len(moved), 3), np.radians(3.0))))
    assert any("more and more askew" in reason for reason in assess(session(), unsure).reasons)


def test_a_lean_that_comes_and_goes_does_not_creep() -> None:
    t = estimate().t
    for period in (90.0, 250.0, 400.0):
        slow = np.radians(6.0) * np.sin(2.0 * np.pi * t / period)
        assert assess(session(), leaning(slow)).measures["lean_creep_rad"] == 0.0
    assert assess(session(), leaning(np.radians(3.0) * t / t[-1])).passed


def test_a_step_that_does_not_stand_out_of_the_scatter_is_none() -> None:
    n = len(estimate())
    slow = np.radians(6.0) * np.sin(2.0 * np.pi * np.arange(n) * 0.02 / 90.0)  # a long climb, a long descent
    assert "largest_lean_step_rad" in assess(session(), leaning(slow)).measures
    assert assess(session(), leaning(slow)).measures["largest_lean_step_rad"] == 0.0


def test_a_hill_tilts_floor_and_direction_of_travel_alike() -> None:
    climb = half_way(5.0)  # positive pitch is nose down
    plain = leaning(0.0, climb)
    velocity = SPEED * np.stack([np.cos(climb), 0.0 * climb, -np.sin(climb)], axis=1)
    downhill = replace(plain, velocity_n=velocity)
    assert assess(session(), downhill).measures["largest_lean_step_rad"] == 0.0


def test_a_logger_that_swings_for_some_seconds_is_seen_and_one_that_always_does_is_not() -> None:
    t = estimate().t
    swing = np.radians(12.0) * np.sin(2.0 * np.pi * t)
    loose = assess(session(), leaning(np.where((t > 100.0) & (t < 110.0), swing, 0.0)))
    assert any("loose" in reason for reason in loose.reasons)
    assert loose.measures["rattling_s"] == pytest.approx(10.0, abs=3.0)  # a mean over 2 s on either end
    assert assess(session(), leaning(swing)).measures["rattling_s"] == 0.0


@pytest.mark.parametrize("code", ["imu_mirrored", "imu_axes_disagree"])
def test_axes_that_no_mounting_explains_are_wrong_wherever_they_were_used(code: str) -> None:
    told = EstimateReport(problems=(Problem(code, "ay is mirrored: change it"),), mode="full")
    assert assess(session(), estimate(report=told)).reasons == ("ay is mirrored",)
    assert assess(session(), estimate(report=replace(told, mode="gps-only"))).passed


def test_pauses_of_both_sensors_are_not_judged() -> None:
    """Rows there run away, as nothing tells otherwise; a hole of 100 s is half of this session."""
    whole, found = session(), estimate()
    hole = (whole.gnss.t > 50.0) & (whole.gnss.t < 150.0)
    fixes = whole.gnss.select(~hole)
    inside = (found.t > 55.0) & (found.t < 145.0)
    velocity_n = np.where(inside[:, None], [0.0, 900.0, 0.0], found.velocity_n)
    assert found.sigmas is not None
    wide = np.where(inside[:, None], 1e4, found.sigmas.position_n)
    told = replace(found.report, mode="full")
    lost = replace(found, velocity_n=velocity_n, sigmas=replace(found.sigmas, position_n=wide), report=told)
    assert assess(replace(whole, gnss=fixes), lost).passed
    reasons = " ".join(assess(whole, lost).reasons)
    assert "km/h" in reasons
    assert "sideways" in reasons


@pytest.mark.parametrize(("n", "passes"), [(1, False), (4, False), (5, True)])
def test_a_few_fixes_are_no_drive(n: int, passes: bool) -> None:
    whole = session()
    few = whole.gnss.select(np.arange(len(whole.gnss)) < n)
    quality = assess(replace(whole, gnss=few), estimate())
    assert quality.passed == passes
    assert passes or "too few for a path" in quality.reasons[0]


@pytest.mark.parametrize(("mode", "passes"), [("full", False), ("gps-only", True)])
def test_a_dead_axis_is_no_attitude(mode: str, passes: bool) -> None:
    dead = Problem(DEAD_AXES, "imu.csv: z of the gyroscope never changes; attitude and what depends on it are wrong")
    told = EstimateReport(mode=mode)  # type: ignore[arg-type]
    quality = assess(replace(session(), problems=(dead,)), estimate(report=told))
    assert quality.passed == passes
    assert passes or quality.reasons == ("z of the gyroscope never changes",)


def around(radius: float, speed: float, seconds: float, sigma: float, mode: str = "gps-only") -> Trajectory:
    """Rounds of a circle at a speed, as fixes alone show it."""
    t = np.arange(0.0, seconds, 0.02)
    n, angle = len(t), speed / radius * t
    zero = np.zeros((n, 3))
    position = radius * np.column_stack([np.cos(angle), np.sin(angle), 0 * t])
    velocity = speed * np.column_stack([-np.sin(angle), np.cos(angle), 0 * t])
    sigmas = Sigmas(np.ones((n, 3)), np.ones((n, 3)), np.full(n, sigma), np.ones((n, 3)), np.ones(n))
    attitude = np.full((n, 3, 3), np.nan)
    return Trajectory(t, position, velocity, attitude, zero, zero, sigmas, EstimateReport(mode=mode))


def along(trajectory: Trajectory) -> Session:
    """A session with fixes on a trajectory."""
    rows = slice(None, None, 10)
    lat, lon, alt = nwu_to_geodetic(trajectory.position_n[rows], ORIGIN)
    unknown = np.full((len(lat), 3), np.nan)
    return Session("round", GnssFixes(trajectory.t[rows], lat, lon, alt, unknown), ORIGIN)


@pytest.mark.parametrize(("radius", "speed", "sigma"), [(4.0, 0.4, 0.3), (4.0, 2.5, 1.0), (10.0, 1.4, 0.1)])
def test_fixes_alone_of_a_kart_that_stands_are_no_drive(radius: float, speed: float, sigma: float) -> None:
    """GPS that wanders, with and without Doppler; a kart that is pushed about the paddock."""
    stood = around(radius, speed, 60.0, sigma)
    (reason,) = assess(along(stood), stood).reasons
    assert reason.startswith("the kart did not drive: it stays within ") and reason.endswith(" m, at no clear speed")


@pytest.mark.parametrize(
    ("radius", "speed", "seconds", "sigma"),
    [(8.0, 6.0, 60.0, 1.0), (40.0, 1.4, 200.0, 1.0), (4.0, 0.4, 20.0, 0.3)],
)
def test_fixes_alone_of_a_skid_pad_a_walk_or_a_moment_are_accepted(
    radius: float, speed: float, seconds: float, sigma: float
) -> None:
    driven = around(radius, speed, seconds, sigma)
    assert assess(along(driven), driven).passed


@pytest.mark.parametrize("seconds", [58.0, 60.0])
def test_less_than_a_minute_of_a_logger_at_rest_is_no_drive(seconds: float) -> None:
    stood = around(4.0, 0.1, seconds, 0.1, "full")
    level = np.tile(np.eye(3), (len(stood), 1, 1))
    stood = Trajectory(
        stood.t, stood.position_n, stood.velocity_n, level, stood.acceleration_b, stood.angular_rate_b, stood.sigmas
    )
    (reason,) = assess(along(stood), stood).reasons
    assert reason == "the heading is not known (sigma 57 deg): the kart hardly drove"
