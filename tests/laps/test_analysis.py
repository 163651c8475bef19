"""What laps say: traces by position, line, corners, statistics, validity; and their way to disk and back."""

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.cli.lap_tables import figures
from smoother.frames import Origin
from smoother.laps.analysis import LapOptions, analyse, reference_lap_of
from smoother.laps.clock import lap_clock
from smoother.laps.delta import zones
from smoother.laps.document import analysis_document, lap_rows, lap_table
from smoother.laps.results import FixPath, GivenLines, LapAnalysis
from smoother.laps.sigma import are_real, significance_threshold
from smoother.laps.stage import analyse_rows, analysed_rows, lap_columns
from smoother.laps.stored import read_stored
from smoother.report.files import to_json, write_csv, write_trajectory
from smoother.samples import Problem
from smoother.trajectory import BOX_ON_WHEEL, EstimateReport, Sigmas, Trajectory
from smoother.utc_clock import UtcClock

Made = Callable[..., Trajectory]
Fixes = Callable[..., FixPath]
GATE = GivenLines(np.array([[0.0, -50.0], [0.0, -70.0]]))
ORIGIN = Origin(45.0, 12.0, 100.0)


@pytest.fixture(scope="module")
def rings(make: Made) -> Trajectory:
    """Laps of circles 60, 61 and 60 m wide at the same turns a second, with a dip of speed in the third."""
    t = np.arange(0.0, 100.0, 0.02)
    turns = t / 25.0 - 0.02 * np.exp(-(((t - 68.0) / 2.0) ** 2)) - 0.01 * (1.0 + np.tanh((t - 68.0) / 2.0))
    radius = 60.0 + np.exp(-(((turns - 2.05) / 0.4) ** 6))
    angle = 2.0 * np.pi * (turns - 0.25) - 0.3
    return make(t, radius[:, None] * np.stack([-np.cos(angle), -np.sin(angle)], axis=1), track=0.01)


@pytest.fixture(scope="module")
def found(driven: Trajectory, fixes: Fixes) -> LapAnalysis:
    return analyse(driven, fixes(driven))


def test_delta_compares_the_same_places_however_far_laps_were_driven(rings: Trajectory, fixes: Fixes) -> None:
    analysis = analyse(rings, fixes(rings), LapOptions(lines=GATE))
    assert analysis.traces is not None
    timed = [i for i, lap in enumerate(analysis.laps) if lap.is_timed]
    wide = max(timed, key=lambda i: analysis.laps[i].distance)
    assert analysis.laps[wide].distance > analysis.laps[timed[0]].distance + 3.0  # 2 pi for a whole lap
    # it turned as fast as the others, but for its end, where the dip of the third lap begins
    np.testing.assert_allclose(analysis.traces.delta[wide, :170], 0.0, atol=2e-3)


def test_delta_ends_as_the_difference_of_the_lap_times(found: LapAnalysis) -> None:
    assert found.traces is not None and found.reference_lap is not None
    best = found.laps[found.reference_lap].time
    for i, lap in enumerate(found.laps):
        if lap.is_timed:
            assert found.traces.delta[i, -1] == pytest.approx(lap.time - best, abs=1e-6)
            assert found.traces.delta[i, 0] == pytest.approx(0.0, abs=1e-6)
            expected = 0.0 if i == found.reference_lap else np.hypot(lap.sigma, found.laps[found.reference_lap].sigma)
            assert found.traces.delta_sigma[i, -1] == pytest.approx(expected, rel=0.35)


def test_the_line_of_a_lap_is_measured_from_the_mean_of_the_laps(rings: Trajectory, fixes: Fixes) -> None:
    analysis = analyse(rings, fixes(rings), LapOptions(lines=GATE))
    assert analysis.traces is not None and analysis.reference is not None
    timed = [i for i, lap in enumerate(analysis.laps) if lap.is_timed]
    wide = max(timed, key=lambda i: analysis.laps[i].distance)
    middle = slice(len(analysis.traces.distance) // 3, 2 * len(analysis.traces.distance) // 3)
    lateral = np.nanmedian(analysis.traces.lateral[:, middle], axis=1)
    assert lateral[timed].mean() == pytest.approx(0.0, abs=0.15)
    assert lateral[wide] - np.mean([lateral[i] for i in timed if i != wide]) == pytest.approx(-1.0, abs=0.1)  # outside


def test_offsets_within_the_wander_of_the_gps_are_not_called_different(rings: Trajectory, fixes: Fixes) -> None:
    class Sure:
        def covariance(self, t: Array, direction_n: Array) -> Array:
            return 1e-4 * np.where(t[:, None] == t[None, :], 1.0, 0.0) * (direction_n @ direction_n.T)

    for trajectory, expected in ((rings, False), (Trajectory(**{**vars(rings), "joint": Sure()}), True)):
        analysis = analyse(trajectory, fixes(rings), LapOptions(lines=GATE))
        assert analysis.traces is not None
        timed = [i for i, lap in enumerate(analysis.laps) if lap.is_timed]
        wide = max(timed, key=lambda i: analysis.laps[i].distance)
        assert analysis.traces.is_off_line[wide, 90] == expected


def test_track_distance_and_lap_of_every_row_agree_with_the_crossings(found: LapAnalysis, driven: Trajectory) -> None:
    assert found.reference is not None
    for lap in found.laps:
        inside = (driven.t > lap.start) & (driven.t < lap.end)
        assert np.all(found.lap_of_row[inside] == lap.number)
        if lap.is_timed:
            distance = found.lap_distance[inside]
            assert distance[0] < 1.0 and distance[-1] > found.reference.length - 1.0
            assert np.all(np.diff(distance) > 0.0)


def test_corners_are_those_of_the_track(found: LapAnalysis) -> None:
    corners = found.corners
    assert 9 <= len(corners) <= 15  # larkfield is drawn with fifteen, of which two pairs are one bend
    assert [c.number for c in corners] == list(range(1, len(corners) + 1))
    assert all(c.start < c.apex < c.end for c in corners)
    assert all(a.segment[1] == b.segment[0] for a, b in pairwise(corners))
    assert sum(c.turns_left for c in corners) < len(corners) / 2  # driven clockwise


def test_corner_speeds_are_read_where_the_corner_is(found: LapAnalysis, driven: Trajectory) -> None:
    for corner in found.corners:
        for i, lap in enumerate(found.laps):
            if not lap.is_timed:
                continue
            assert corner.min_speed[i] <= min(corner.entry_speed[i], corner.exit_speed[i]) + 1e-9
            if np.isfinite(corner.braking_point[i]):
                assert corner.braking_point[i] <= corner.apex
    slowest = min(float(np.nanmin(corner.min_speed)) for corner in found.corners)
    moving = (driven.t > found.laps[1].start) & (driven.t < found.laps[-1].start)
    assert slowest == pytest.approx(driven.speed[moving].min(), abs=0.1)


def stands(driven: Trajectory, t: float, duration: float) -> Trajectory:
    """The same drive with a stand of `duration` s at time t."""
    before = int(np.searchsorted(driven.t, t))
    step = driven.t[1] - driven.t[0]
    rows = np.insert(np.arange(len(driven)), before, np.full(round(duration / step), before))
    standing = np.arange(len(rows)) - before
    velocity = driven.velocity_n[rows]
    velocity[(standing >= 0) & (standing < round(duration / step))] = 0.0
    return replace(
        driven,
        t=driven.t[0] + step * np.arange(len(rows)),
        position_n=driven.position_n[rows],
        velocity_n=velocity,
        R_nb=driven.R_nb[rows],
        acceleration_b=driven.acceleration_b[rows],
        angular_rate_b=driven.angular_rate_b[rows],
        sigmas=None if driven.sigmas is None else Sigmas(*(sigma[rows] for sigma in vars(driven.sigmas).values())),
    )


def test_who_stood_in_a_corner_was_no_faster_than_that(found: LapAnalysis, driven: Trajectory, fixes: Fixes) -> None:
    """Between two places where laps are compared, 2 m apart: the next of them is passed at speed."""
    assert found.traces is not None
    corner, d = found.corners[2], found.traces.distance
    k = int(np.searchsorted(d, corner.apex))
    lap = int(np.flatnonzero(np.isfinite(found.traces.t[:, k - 1 : k + 1]).all(axis=1))[-1])
    middle = float(found.traces.t[lap, k - 1 : k + 1].mean())
    stood = stands(driven, middle, 2.0)
    analysis = analyse(stood, fixes(stood))
    assert corner.min_speed[lap] > 3.0
    assert analysis.corners[2].min_speed[lap] == 0.0


def test_time_lost_in_all_corners_adds_up_to_the_lap(found: LapAnalysis) -> None:
    assert found.reference_lap is not None
    for i, lap in enumerate(found.laps):
        if lap.is_timed:
            lost = sum(float(corner.time_lost[i]) for corner in found.corners)
            assert lost == pytest.approx(lap.time - found.laps[found.reference_lap].time, abs=2e-3)


@pytest.mark.parametrize("metres", [0.1, 0.3, 1.0])
def test_a_loss_is_real_only_beyond_its_threshold(driven: Trajectory, fixes: Fixes, metres: float) -> None:
    class Independent:
        def covariance(self, t: Array, direction_n: Array) -> Array:
            return metres**2 * np.where(t[:, None] == t[None, :], 1.0, 0.0) * (direction_n @ direction_n.T)

    analysis = analyse(Trajectory(**{**vars(driven), "joint": Independent()}), fixes(driven))
    times_sigma = []
    for corner in analysis.corners:
        known = np.isfinite(corner.time_lost) & (corner.time_lost_sigma > 0.0)
        times_sigma += (np.abs(corner.time_lost[known]) / corner.time_lost_sigma[known]).tolist()
        expected = np.abs(corner.time_lost) >= corner.real_from * corner.time_lost_sigma
        np.testing.assert_array_equal(corner.is_real[known], expected[known])
    (sure,) = {corner.real_from for corner in analysis.corners}
    assert sure > 2.0
    assert min(times_sigma) < 2.0 or metres < 0.3
    assert max(times_sigma) > 1.0 or metres > 0.3


@pytest.mark.parametrize("has_reference", [True, False])
def test_the_usual_loss_is_no_surer_than_the_lap_compared_with(
    driven: Trajectory, fixes: Fixes, *, has_reference: bool
) -> None:
    class Independent:
        def covariance(self, t: Array, direction_n: Array) -> Array:
            return 0.04 * np.where(t[:, None] == t[None, :], 1.0, 0.0) * (direction_n @ direction_n.T)

    known = Trajectory(**{**vars(driven), "joint": Independent()})
    analysis = analyse(known, fixes(driven))
    if not has_reference:
        lap = reference_lap_of(analysis, known, fixes(driven), "another")
        analysis = analyse(known, fixes(driven), LapOptions(reference=analysis.reference, reference_lap=lap))
    others = [i for i, lap in enumerate(analysis.laps) if lap.is_valid and i != analysis.reference_lap]
    assert len(others) == (2 if has_reference else 3)
    for corner in analysis.corners:
        cell = corner.time_lost_sigma[others]  # half of its variance is the reference lap's
        assert corner.usual_lost == pytest.approx(float(np.median(corner.time_lost[others])))
        of_median = np.pi / 2.0 if len(others) > 2 else 1.0
        expected = np.sqrt(0.5 + 0.5 * of_median / len(others)) * cell.mean()
        assert corner.usual_lost_sigma == pytest.approx(expected, rel=0.04)  # that of a mean would be 0.07 less


def test_by_chance_alone_hardly_any_loss_is_real() -> None:
    rng = np.random.default_rng(3)
    called, by_two_sigma = [], []
    for _ in range(200):
        lap, reference = rng.standard_normal((40, 1)), rng.standard_normal((1, 1))
        offset = lap - reference  # of the GPS, and one for a whole lap: each corner shows it in its own way
        lost = offset * np.tile([0.9, -0.9, 0.5], 4) + 0.5 * rng.standard_normal((40, 12))
        sigma = np.broadcast_to(np.hypot(np.sqrt(2.0) * np.tile([0.9, 0.9, 0.5], 4), 0.5), lost.shape)
        called.append(bool(are_real(lost, sigma, significance_threshold(lost, sigma)).any()))
        by_two_sigma.append(float(np.mean(are_real(lost, sigma, 2.0))))
    assert np.mean(called) < 0.05
    assert 0.03 < np.mean(by_two_sigma) < 0.06


def test_one_difference_alone_is_real_from_two_sigma_and_more_need_more() -> None:
    assert significance_threshold(np.array([3.0]), np.array([1.0])) == 2.0
    assert significance_threshold(np.array([np.nan, 5.0]), np.array([1.0, 0.0])) == 2.0
    least = NormalDist().inv_cdf(1.0 - 0.5 * 0.05 / (4 * (1.0 + 1.0 / 2.0 + 1.0 / 3.0 + 1.0 / 4.0)))
    assert significance_threshold(np.full((2, 2), 0.5), np.ones((2, 2))) == pytest.approx(least)
    large = np.where(np.arange(100) < 60, 20.0, 0.5)  # many that are surely real lower what each needs
    assert (
        2.0
        < significance_threshold(large, np.ones(100))
        < significance_threshold(np.where(large > 1.0, 0.5, large), np.ones(100))
    )


def test_zones_have_hysteresis() -> None:
    along = np.array([0.0, -1.5, -2.5, -1.5, -0.5, -1.5, -1.2, 0.0, 0.5, 0.8, 0.4, 0.2])
    np.testing.assert_array_equal(zones(along), [0, -1, -1, -1, 0, 0, 0, 0, 1, 1, 1, 0])


def test_statistics_hang_together(found: LapAnalysis) -> None:
    said = found.statistics
    assert said is not None and said.best_lap is not None
    times = [lap.time for lap in found.laps if lap.is_valid]
    assert said.best == min(times) == found.laps[said.best_lap].time
    assert said.theoretical_raw <= said.theoretical <= said.best + 1e-9
    assert said.rolling <= said.best + 1e-9
    assert said.counted == len(times)
    assert 1 <= said.within_tenth <= len(times)


def test_a_stop_on_the_track_and_one_beside_it_are_distinguished(make: Made, fixes: Fixes) -> None:
    turn = 2.0 * np.pi / 25.0
    t = np.arange(0.0, 140.0, 0.02)
    driving = np.clip(np.abs(t - 62.0) - 4.0, 0.0, 1.0)  # stands from 58 to 66 s
    angle = np.cumsum(turn * driving) * 0.02
    on = 60.0 * np.stack([-np.cos(angle), -np.sin(angle)], axis=1)
    away = (60.0 + 30.0 * np.exp(-(((t - 62.0) / 8.0) ** 4)))[:, None] / 60.0
    for position, reason in ((on, "stopped"), (on * away, "pit")):
        laps = analyse(make(t, position), fixes(make(t, position)), LapOptions(lines=GATE)).laps
        slow = [lap for lap in laps if lap.start < 62.0 < lap.end]
        assert reason in slow[0].reasons
        assert [lap.reasons for lap in laps if lap.is_timed and lap not in slow] == [()] * (len(laps) - 3)


def test_a_hole_of_the_fixes_counts_unless_the_inertial_sensor_bridged_it(make: Made) -> None:
    t = np.arange(0.0, 110.0, 0.02)
    angle = 2.0 * np.pi / 25.0 * t
    position = 60.0 * np.stack([-np.cos(angle), -np.sin(angle)], axis=1)
    kept = (t[::10] < 40.0) | (t[::10] > 46.0)
    fixes = FixPath(t[::10][kept], position[::10][kept])
    for mode, expected in (("gps-only", [("gap",)]), ("full", [])):
        laps = analyse(make(t, position, mode=mode), fixes, LapOptions(lines=GATE)).laps
        assert [lap.reasons for lap in laps if lap.is_timed and lap.reasons] == expected


def test_sideslip_shows_only_where_the_attitude_is_known(make: Made, fixes: Fixes) -> None:
    t = np.arange(0.0, 80.0, 0.02)
    angle = 2.0 * np.pi / 25.0 * t
    position = 60.0 * np.stack([-np.cos(angle), -np.sin(angle)], axis=1)
    turned = make(t, position, mode="full")
    slip = 0.06  # rad: the nose points that much further to the left than the path
    c, s = np.cos(slip), np.sin(slip)
    turned = Trajectory(
        **{**vars(turned), "R_nb": turned.R_nb @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])}
    )
    traces = analyse(turned, fixes(turned), LapOptions(lines=GATE)).traces
    blind = analyse(make(t, position), fixes(turned), LapOptions(lines=GATE)).traces
    assert traces is not None and blind is not None
    assert np.nanmedian(traces.sideslip) == pytest.approx(-slip, abs=1e-3)
    assert np.isnan(blind.sideslip).all()


def test_a_slide_has_its_sigma_and_is_counted_outwards_in_either_direction(driven: Trajectory, fixes: Fixes) -> None:
    turn = np.clip(driven.angular_rate_b[:, 2] / 0.5, -1.0, 1.0) * 0.05  # rad: the nose goes before the path
    c, s, o, l = np.cos(turn), np.sin(turn), np.zeros(len(turn)), np.ones(len(turn))
    turned = np.stack([np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, l], -1)], axis=1)
    slid = Trajectory(**{**vars(driven), "R_nb": driven.R_nb @ turned})
    found, before = analyse(slid, fixes(slid)), analyse(driven, fixes(driven))
    assert found.no_sideslip == ""
    pairs = [(a, b) for a, b in zip(found.corners, before.corners, strict=True) if a.radius < 20.0]
    assert {corner.turns_left for corner, _ in pairs} == {True, False}
    for corner, other in pairs:
        more = (corner.slide - other.slide)[np.isfinite(corner.slide)]
        assert more == pytest.approx(np.full(len(more), 0.05), abs=0.02)  # less at both ends, where it turns less
        assert np.nanmax(corner.slide_sigma) == pytest.approx(0.013, abs=0.004)  # 0.01 rad, and 0.1 m/s of 12 m/s
    assert slid.sigmas is not None
    unsure = Trajectory(**{**vars(slid), "sigmas": replace(slid.sigmas, attitude=np.full((len(slid), 3), 0.06))})
    hidden = analyse(unsure, fixes(unsure))
    assert "its uncertainty is ±" in hidden.no_sideslip
    assert all(np.isnan(corner.slide).all() for corner in hidden.corners)
    report = EstimateReport(problems=(Problem(BOX_ON_WHEEL, "turns"),))
    steered = Trajectory(**{**vars(slid), "report": report})
    assert "steering wheel" in analyse(steered, fixes(steered)).no_sideslip
    alone = Trajectory(**{**vars(driven), "report": EstimateReport(mode="gps-only")})
    assert "no motion sensor" in analyse(alone, fixes(alone)).no_sideslip


def test_rows_of_laps_csv_have_the_names_of_the_contract(tmp_path: Path, found: LapAnalysis) -> None:
    write_csv(tmp_path / "laps.csv", lap_table(found))
    with (tmp_path / "laps.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    names = ["lap", "start_s", "end_s", "lap_time_s", "lap_time_sigma_s", "valid", "reason", "sector1_s"]
    assert list(rows[0])[:8] == names
    assert rows[0]["valid"] == "false" and rows[0]["reason"] == "out-lap" and rows[0]["lap_time_s"] == ""
    assert rows[1]["valid"] == "true" and rows[1]["reason"] == ""
    assert float(rows[1]["lap_time_s"]) == pytest.approx(float(rows[1]["end_s"]) - float(rows[1]["start_s"]), abs=2e-4)


def test_a_session_without_laps_has_a_header_and_a_reason(make: Made, fixes: Fixes) -> None:
    t = np.arange(0.0, 20.0, 0.02)
    straight = make(t, np.stack([10.0 * t, 0.0 * t], axis=1))
    analysis = analyse(straight, fixes(straight))
    assert lap_table(analysis).columns[:2] == ["lap", "start_s"]
    assert len(lap_table(analysis)) == 0
    document = json.loads(to_json(analysis_document(analysis, ORIGIN)))
    assert "does not come back" in document["problems"][0]["text"]


def test_lap_columns_fit_any_rate_of_rows(driven: Trajectory, fixes: Fixes) -> None:
    dense = Trajectory(**{**vars(driven), "t": driven.t})
    analysis = analyse_rows(dense, fixes(dense), LapOptions())
    for step in (1, 4):
        t = driven.t[::step]
        columns = lap_columns(analysis, dense, t)
        assert columns is not None
        np.testing.assert_allclose(columns[1], analysis.lap_distance[::step], atol=1e-6)
        assert columns[0].to_list()[len(t) // 2] == analysis.lap_of_row[::step][len(t) // 2]


def test_results_read_back_give_the_same_laps(tmp_path: Path, driven: Trajectory, fixes: Fixes) -> None:
    analysis = analyse(driven, fixes(driven))
    write_trajectory(tmp_path / "trajectory.csv", driven, ORIGIN, UtcClock(0.0, 1.7e9))
    t, position = fixes(driven).t, fixes(driven).position_n
    rows = Trajectory(**{**vars(driven.every(10))})
    write_trajectory(tmp_path / "gps.csv", rows, ORIGIN, UtcClock(0.0, 1.7e9))  # has the columns that are read
    place = {"lat_deg": ORIGIN.lat_deg, "lon_deg": ORIGIN.lon_deg, "alt_m": ORIGIN.alt_m}
    (tmp_path / "summary.json").write_text(
        to_json(
            {
                "origin": place,
                "mode": "full",
                "identified": {},
                "session": UtcClock(0.0, 1.7e9).as_summary() | {"start_s": 0.0},
            }
        )
    )
    stored = read_stored(tmp_path)
    again = analyse(analysed_rows(stored.trajectory), stored.fixes, LapOptions(drift=stored.drift))
    assert [lap.time for lap in again.laps[1:-1]] == pytest.approx([lap.time for lap in analysis.laps[1:-1]], abs=2e-4)
    np.testing.assert_allclose(stored.fixes.position_n, position, atol=1e-3)
    np.testing.assert_allclose(stored.fixes.t, t, atol=1e-6)
    assert stored.clock == UtcClock(0.0, 1.7e9)


def test_a_lap_compared_with_itself_loses_nothing(driven: Trajectory, fixes: Fixes) -> None:
    first = analyse(driven, fixes(driven))
    lap = reference_lap_of(first, driven, fixes(driven), "monday lap 2")
    second = analyse(driven, fixes(driven), LapOptions(reference=first.reference, reference_lap=lap))
    assert second.traces is not None and first.reference_lap is not None
    np.testing.assert_allclose(second.traces.delta[first.reference_lap], 0.0, atol=1e-3)
    assert second.reference_lap is None and second.reference_name == "monday lap 2"
    assert np.nanmin(second.traces.delta_sigma[first.reference_lap, 1:]) > 0.0


def test_the_document_is_strict_json_with_the_laps_of_the_table(found: LapAnalysis) -> None:
    document = json.loads(to_json({"laps": lap_rows(found), **analysis_document(found, ORIGIN)}))
    assert [lap["lap"] for lap in document["laps"]] == [lap.number for lap in found.laps]
    assert document["laps"][0]["lap_time_s"] is None
    assert document["statistics"]["best_lap"] in [lap["lap"] for lap in document["laps"]]
    assert len(document["corners"]) == len(found.corners)


def test_a_lap_is_shown_with_the_time_of_the_best_lap_that_it_is(found: LapAnalysis) -> None:
    """Rounded to a digit more than is shown, one time in twenty would be another thousandth."""
    for time in (52.79152, 52.79148, 61.00049):
        laps = lap_rows(replace(found, laps=[replace(lap, time=time) for lap in found.laps]))
        assert {lap_clock(lap["lap_time_s"]) for lap in laps} == {lap_clock(time)}


def test_a_lap_is_shown_as_sure_as_the_best_lap_that_it_is(found: LapAnalysis) -> None:
    laps = lap_rows(replace(found, laps=[replace(lap, sigma=0.02654) for lap in found.laps]))
    assert {f"{lap['lap_time_sigma_s']:.3f}" for lap in laps} == {"0.027"}  # 0.0265 rounded again is 0.026


def test_a_spread_within_the_timing_noise_is_noted_and_an_assumed_noise_is_not_removed(
    rings: Trajectory, fixes: Fixes
) -> None:
    class Unsure:
        def covariance(self, t: Array, direction_n: Array) -> Array:
            return 4.0**2 * np.eye(len(t)) * (direction_n @ direction_n.T)

    measured = analyse(Trajectory(**{**vars(rings), "joint": Unsure()}), fixes(rings), LapOptions(lines=GATE))
    assumed = analyse(rings, fixes(rings), LapOptions(lines=GATE))
    assert (measured.sigma_source, assumed.sigma_source) == ("joint", "model")
    assert measured.statistics is not None and assumed.statistics is not None
    assert measured.statistics.spread == 0.0
    times = [lap.time for lap in assumed.laps if lap.is_valid]
    assert assumed.statistics.spread == pytest.approx(np.std(times, ddof=1), abs=1e-9)
    for analysis, words in ((measured, "spread within the timing noise"), (assumed, "spread 0.")):
        document = json.loads(to_json(analysis_document(analysis, ORIGIN)))
        said = dict(figures(document))["consistency"]
        assert words in said and "0.000" not in said
