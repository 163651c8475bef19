"""report.html as text: whole, self-contained, small; what comes from files is text; what is missing is said."""

import base64
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from smoother.cli.lap_tables import figures
from smoother.config import SessionConfig
from smoother.estimate.judge.quality import Quality
from smoother.laps.analysis import analyse
from smoother.laps.document import analysis_document, lap_rows
from smoother.laps.results import FixPath, LapAnalysis
from smoother.laps.stage import fix_path
from smoother.report import page as page_module
from smoother.report import page_data
from smoother.report.files import to_json
from smoother.report.page import Report, page, write_page
from smoother.report.page_html import (
    LONG,
    element,
    json_in_script,
    lap_clock,
    number,
    parted,
    row,
    table,
    whole_page,
    with_sigma,
)
from smoother.report.page_sections import _rolling
from smoother.samples import Problem, Session
from smoother.sim.simulation import simulate_preset
from smoother.trajectory import (
    BOX_ON_WHEEL,
    IMU_SHAKEN,
    WHITENED,
    EstimateReport,
    Identified,
    ResidualStatistics,
    Sigmas,
    Trajectory,
)

NASTY = "<script>alert(1)</script>"
GOOD = Quality(True, (), {"far_fix_share": 0.0})


@pytest.fixture(scope="module")
def driven() -> tuple[Trajectory, LapAnalysis, Session]:
    """Some laps, from truth, with sigmas."""
    from smoother.prepare import prepare

    simulation = simulate_preset("kart", 5, duration=240.0)
    session = prepare(simulation.raw)
    t = np.arange(session.gnss.t[0], session.gnss.t[-1], 0.02)
    truth = simulation.truth.trajectory(t, simulation.scenario.lever_arm_b)
    n = len(t)
    sigmas = Sigmas(
        np.full((n, 3), 1.5), np.full((n, 3), 0.1), np.full(n, 0.1), np.full((n, 3), 0.01), np.full(n, 0.05)
    )
    trajectory = Trajectory(**{**vars(truth), "sigmas": sigmas})
    known = np.isfinite(session.fix_position_n[:, 0])
    laps = analyse(trajectory, FixPath(session.gnss.t[known], session.fix_position_n[known, :2]))
    assert laps.traces is not None and sum(lap.is_valid for lap in laps.laps) >= 3
    return trajectory, laps, session


@pytest.fixture
def report(driven: tuple[Trajectory, LapAnalysis, Session]) -> Report:
    trajectory, laps, session = driven
    return Report(session, trajectory, trajectory.every(5), laps, GOOD)


class Tags(HTMLParser):
    """Collects tags, attributes and texts of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str | None]] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes += attrs

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


def numbers(text: str) -> dict[str, object]:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    document = json.loads(found.group(1))
    assert isinstance(document, dict)
    return document


def floats(text: object) -> np.ndarray:
    assert isinstance(text, str)
    return np.frombuffer(base64.b64decode(text), dtype="<f4")


def test_text_from_files_is_text_wherever_it_appears(report: Report) -> None:
    config = SessionConfig(title=NASTY, driver=NASTY, kart=NASTY, track=NASTY, notes=NASTY)
    problem = Problem("odd", f"{NASTY}.csv: odd", 2)
    session = replace(report.session, name=NASTY, config=config, problems=(problem,))
    assert report.laps is not None
    laps = replace(report.laps, track=NASTY, reference_name=NASTY, reference_lap=None)
    quality = Quality(False, (NASTY,), {})
    text = page(replace(report, session=session, laps=laps, quality=quality))
    assert "<script>alert" not in text.lower()
    tags = Tags(text)
    assert tags.tags.count("script") == 2
    assert sum(NASTY in piece for piece in tags.texts) >= 7
    assert numbers(text)["against_name"] == NASTY


def test_a_name_of_any_characters_makes_a_page(report: Report, tmp_path: Path) -> None:
    name = "\x00\x1b[31m \udc80 </style> ]]> --> ' \" & \u2028 \u202e ☃ 中"
    session = replace(report.session, config=SessionConfig(title=name, driver=name))
    write_page(tmp_path / "report.html", replace(report, session=session))
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.lower().count("</style>") == 1
    assert not {"\x00", "\x1b", "\u202e"} & set(text)
    assert any("☃ 中" in piece for piece in Tags(text).texts)


def test_nothing_in_the_page_points_outside(report: Report) -> None:
    tags = Tags(page(report))
    assert not {"link", "img", "iframe", "object", "base"} & set(tags.tags)
    targets = [value or "" for name, value in tags.attributes if name in ("src", "href", "action", "style")]
    assert targets and all(target.startswith("#") for target in targets)
    policy = next(
        value or "" for name, value in tags.attributes if name == "content" and "default-src" in (value or "")
    )
    assert policy.startswith("default-src 'none'") and "unsafe" not in policy


def test_ten_minutes_stay_below_three_megabytes_and_each_further_one_below_0_15(report: Report) -> None:
    size = len(page(report).encode())
    assert report.laps is not None
    minutes = (report.smoothed.t[-1] - report.smoothed.t[0]) / 60.0
    bare = len(page(replace(report, laps=None, smoothed=_first(report.smoothed, 500))).encode())
    assert size + 10.0 * 0.15e6 < 3.0e6
    assert (size - bare) / minutes < 0.15e6


def _first(trajectory: Trajectory, rows: int) -> Trajectory:
    parts = {name: getattr(trajectory, name)[:rows] for name in ("t", "position_n", "velocity_n", "R_nb")}
    rates = {name: getattr(trajectory, name)[:rows] for name in ("acceleration_b", "angular_rate_b")}
    return Trajectory(**parts, **rates)


def test_the_charts_get_the_laps_as_they_were_analysed(report: Report) -> None:
    document, laps = numbers(page(report)), report.laps
    assert laps is not None and laps.traces is not None and laps.statistics is not None
    grid, traces = floats(document["grid"]), document["traces"]
    assert isinstance(traces, dict)
    assert len(grid) == len(laps.traces.distance)  # a kart is slow enough for every point
    speed = floats(traces["speed"]).reshape(-1, len(grid))
    best = laps.statistics.best_lap
    assert best is not None
    shown = document["best"]
    assert isinstance(shown, int)
    np.testing.assert_allclose(speed[shown], laps.traces.speed[best], rtol=1e-6)
    x, y = (floats(traces[name]).reshape(-1, len(grid))[shown] for name in "xy")
    driven = np.nansum(np.hypot(np.diff(x), np.diff(y)))
    assert driven == pytest.approx(laps.laps[best].distance, rel=0.01)


def test_laps_stand_in_a_table_with_their_sigma_and_the_best_is_marked(report: Report) -> None:
    text = page(report)
    assert report.laps is not None and report.laps.statistics is not None
    for lap in report.laps.laps:
        if lap.is_timed:
            assert f"{lap_clock(lap.time)}<small> ± {number(lap.sigma, 3)}</small>" in text
            is_best = lap is report.laps.laps[report.laps.statistics.best_lap or 0]
            for time, sigma in zip(lap.sector_time, lap.sector_gap_sigma, strict=True):
                plus_minus = "" if is_best else f" ± {number(float(sigma), 3)}"
                assert f"<td>{lap_clock(float(time))}<small>{plus_minus}</small>" in text or is_best
    assert "difference from the same sector of the best lap" in text
    assert text.count('<tr class="best">') == 1
    assert lap_clock(report.laps.statistics.theoretical) in text


def test_a_loss_is_called_real_only_where_it_is(report: Report) -> None:
    text = page(report)
    assert report.laps is not None
    real = sum(int(corner.is_real[i]) for corner in report.laps.corners for i in _timed(report.laps))
    real += sum(corner.usual_is_real for corner in report.laps.corners)
    assert f"at least {number(report.laps.corners[0].real_from, 1)} times its ±" in text
    corner = report.laps.corners[0]
    usual = f"{number(corner.usual_lost, 2, signed=True)}{'*' if corner.usual_is_real else ''}"
    assert f"{usual}<small> ± {number(corner.usual_lost_sigma, 2)}</small>" in text
    assert text.count('class="slower"') + text.count('class="faster"') == real


def test_without_sigmas_of_losses_chance_is_not_mentioned(report: Report) -> None:
    assert report.laps is not None
    unknown = (
        replace(c, time_lost_sigma=np.full_like(c.time_lost_sigma, np.nan), is_real=np.zeros_like(c.is_real))
        for c in report.laps.corners
    )
    text = page(replace(report, laps=replace(report.laps, corners=tuple(unknown))))
    assert "The uncertainty of the losses" in text and "larger than its uncertainty" not in text


def _timed(laps: LapAnalysis) -> list[int]:
    return [i for i, lap in enumerate(laps.laps) if lap.is_timed]


def test_without_laps_motion_sensor_and_baseline_the_page_reports_it(session: Session, trajectory: Trajectory) -> None:
    n = len(trajectory)
    unknown = {"R_nb": np.full((n, 3, 3), np.nan), "acceleration_b": np.full((n, 3), np.nan)}
    bare = replace(trajectory, **unknown, sigmas=None, report=EstimateReport(mode="gps-only"))
    text = page(Report(replace(session, imu=None, mag=None), bare, None, None, GOOD))
    for words in ("Roll, pitch, yaw and sideslip", "Laps and every", "Uncertainties:", "comparison with the baseline"):
        assert words in text
    document = numbers(text)
    assert document["axis"] == "time"
    traces = document["traces"]
    assert isinstance(traces, dict)
    assert np.isfinite(floats(traces["longitudinal"])).all()  # from the speed of the GPS


def test_what_is_compared_is_called_by_what_is_there(report: Report) -> None:
    for baseline, name, other in (
        (report.baseline, "Baseline against smoother", "GPS fixes against smoother"),
        (None, "GPS fixes against smoother", "Baseline against smoother"),
    ):
        text = page(replace(report, baseline=baseline))
        assert f'<a href="#compared">{name}</a>' in text and f'<h2 id="compared">{name}</h2>' in text
        assert other not in text
        assert ("Fixes, baseline and smoother" in text) == (baseline is not None)
        assert ("the baseline, an older method" in text) == (baseline is not None)


def test_a_baseline_without_a_calibrated_compass_is_reported_to_need_one(report: Report) -> None:
    words = "the yaw of the baseline comes from the motion of the first minute"
    assert report.baseline is not None and words not in page(report)
    lost = EstimateReport(problems=(Problem("baseline_no_magnetometer", "no calibrated magnetometer"),))
    bare = replace(report, baseline=replace(report.baseline, report=lost))
    text = page(bare)
    assert words in text and "needs a calibrated logger" in text
    unknown = np.full(report.smoothed.R_nb.shape, np.nan)  # then no difference of yaw is shown
    assert words not in page(replace(bare, smoothed=replace(report.smoothed, R_nb=unknown)))


def test_traces_are_not_denser_than_twenty_a_second(session: Session, trajectory: Trajectory) -> None:
    document = numbers(page(Report(session, trajectory, None, None, GOOD)))
    assert np.diff(floats(document["grid"])).min() >= 0.05 - 1e-3


def test_what_failed_its_gate_is_not_to_be_trusted(report: Report) -> None:
    text = page(replace(report, quality=Quality(False, ("the trajectory leaves the fixes for 99 s",), {})))
    assert "No: the trajectory leaves the fixes for 99 s." in text


def test_laps_may_be_equally_fast_up_to_two_sigma_of_their_difference(report: Report) -> None:
    laps = report.laps
    assert laps is not None and laps.statistics is not None
    valid = [lap for lap in laps.laps if lap.is_valid]
    best = min(valid, key=lambda lap: lap.time)
    sure = [replace(lap, sigma=0.03 if lap is best else 0.04) for lap in laps.laps]
    said = replace(laps.statistics, best_sigma=0.03)
    text = page(replace(report, laps=replace(laps, laps=tuple(sure), statistics=said)))
    assert "± 0.030 s; two laps that differ by less than 0.10 s may be equally fast." in text
    alone = [lap if lap.number == best.number else replace(lap, reasons=("pit",)) for lap in sure]
    text = page(replace(report, laps=replace(laps, laps=tuple(alone), statistics=said)))
    assert "<li>Best lap: ± 0.030 s.</li>" in text


def test_residuals_far_below_one_sigma_are_not_called_dishonest(report: Report) -> None:
    text = page(report)
    assert "they should be about 1 or less" in text
    assert "1 is honest" not in text


def test_measurements_of_little_weight_are_not_called_rejected_beside_fixes_that_were_dropped(report: Report) -> None:
    residuals = {"gps_position": ResidualStatistics("m", 500, 0.0, 0.3, 1.0, 3)}
    counted_so = replace(report.smoothed, report=EstimateReport(residuals=residuals))
    text = page(replace(report, smoothed=counted_so))
    assert '<th scope="col">little weight</th>' in text and "rejected" not in text


def test_residuals_have_the_names_of_things_and_sigmas_stand_once(report: Report) -> None:
    of_sensor = ResidualStatistics(WHITENED, 500, 0.0, 0.351, 0.351, 0)
    residuals = {"slip": ResidualStatistics("rad", 500, 0.0, 0.004, 0.5, 0), "inertial": of_sensor}
    text = page(replace(report, smoothed=replace(report.smoothed, report=EstimateReport(residuals=residuals))))
    assert ">wheels, sideways<" in text and ">motion sensor<" in text
    assert ">inertial<" not in text and "0.351" not in text and ">0.35<" in text


def test_a_lap_against_itself_has_no_differences(report: Report) -> None:
    laps = report.laps
    assert laps is not None and laps.statistics is not None and laps.statistics.best_lap is not None
    text = page(report)
    best = re.search(r'<tr class="best">.*?</tr>', text)
    assert best is not None and "+0.000" not in best[0] and "<td>–</td>" in best[0]
    assert laps.reference_lap is not None
    lost = "<td>–</td>" * len(laps.corners)
    assert f"<tr><td>{laps.laps[laps.reference_lap].number}</td>{lost}</tr>" in text
    assert [one["is_against"] for one in numbers(text)["laps"]].count(True) == 1  # type: ignore[attr-defined]


def test_identified_values_stand_with_their_sigma(session: Session, trajectory: Trajectory) -> None:
    text = page(Report(session, trajectory, None, None, GOOD))
    assert "<td>GPS position latency</td><td>0.120</td><td>0.010</td><td>s</td><td>identified</td>" in text
    assert "mounting of the logger: roll, pitch, yaw" in text


@pytest.mark.parametrize(
    ("source", "row"),
    [
        ("identified", "forward, left (up is not known)</td><td>0.47, 0.352</td><td>0.12, 0.026</td>"),
        ("default", "forward, left (up is not known)</td><td>0.47, 0.352</td><td>0.12, 0.026</td>"),
        ("configured", "forward, left, up</td><td>0.470, 0.352, 0.200</td><td>–</td>"),
    ],
)
def test_of_an_arm_that_was_not_stated_the_height_is_not_known(report: Report, source: str, row: str) -> None:
    sigma = None if source == "configured" else [0.12, 0.026, 0.5]
    found = {"lever_arm_b": Identified([0.47, 0.352, 0.2], sigma, "m", source != "default", source)}
    estimate = replace(report.smoothed.report, identified=found)
    text = page(replace(report, smoothed=replace(report.smoothed, report=estimate)))
    assert f"<td>antenna from the logger: {row}<td>m</td><td>{source}</td>" in text


def identified_on(report: Report, **found: Identified) -> str:
    """The table of what was identified."""
    estimate = replace(report.smoothed.report, identified=found)
    text = page(replace(report, smoothed=replace(report.smoothed, report=estimate)))
    return text.partition("Identified constants")[2].partition("</table>")[0]


def test_the_smoothing_time_of_a_receiver_is_shown_in_seconds_where_significant(report: Report) -> None:
    clear = Identified(0.0072, 0.0006, "s^2", True, "identified")
    row = "smooths its speed</td><td>0.1200</td><td>0.0050</td><td>s</td><td>identified</td>"
    assert row in identified_on(report, gps_velocity_response=clear)
    for found in (replace(clear, value=0.0011), replace(clear, value=-0.0072), replace(clear, source="default")):
        assert "smooths" not in identified_on(report, gps_velocity_response=found)


def test_rare_faults_that_a_session_does_not_show_are_left_out(report: Report) -> None:
    assert "<tbody></tbody>" in identified_on(
        report,
        accel_delay=Identified(0.0, None, "s", False, "default"),
        imu_clock_drift=Identified(0.0, 4.0, "ppm", False, "default"),
    )


def test_json_in_a_script_can_not_end_it() -> None:
    text = json_in_script({"a": "</script><!--\u2028&"})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"a": "</script><!--\u2028&"}
    with pytest.raises(ValueError, match="JSON"):
        json_in_script(float("nan"))


def test_elements_keep_text_between_and_after_children() -> None:
    node = element("p", "a<", element("b", "c"), "d&", class_="x", data_y='"')
    text = whole_page("t", [node, row("1", element("td", "2"))], "", "", {})
    assert '<p class="x" data-y="&quot;">a&lt;<b>c</b>d&amp;</p><tr><td>1</td><td>2</td></tr>' in text


def test_a_name_is_parted_at_its_signs_and_stays_itself() -> None:
    name = element("span", *parted("a-b/kart_okc_doves"))
    assert "".join(name.itertext()) == "a-b/kart_okc_doves"
    assert [wbr.tail for wbr in name] == ["b", "/kart_", "okc_", "doves"] and name.text == "a-"
    assert parted("") == []


def test_numbers_are_written_as_people_write_them() -> None:
    assert [lap_clock(s) for s in (58.6481, 62.345, 119.9999, float("nan"))] == ["58.648", "1:02.345", "2:00.000", "–"]
    assert lap_clock(3652.892) == "1:00:52.892"  # across lunch
    assert number(-0.001, 2) == "0.00"
    assert with_sigma(1.0, 0.25, 2) == "1.00 ± 0.25"
    assert with_sigma(1.0, float("nan"), 2, signed=True) == "+1.00"


def test_of_very_many_laps_the_quickest_are_drawn_and_the_page_notes_it(
    report: Report, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert report.laps is not None
    valid = [i for i, lap in enumerate(report.laps.laps) if lap.is_valid]
    monkeypatch.setattr(page_data, "MOST_DRAWN", 2)
    monkeypatch.setattr(page_module, "MOST_DRAWN", 2)
    quickest = sorted(valid, key=lambda i: report.laps.laps[i].time)[:2]  # type: ignore[union-attr]
    assert page_data.drawn_laps(report.laps) == sorted(quickest)
    text = page(report)
    assert f"Of {len(report.laps.laps)} laps the 2 quickest are shown" in text
    laps = numbers(text)["laps"]
    assert isinstance(laps, list) and len(laps) == 2


def test_a_long_table_scrolls_by_itself() -> None:
    for count, is_long in ((LONG - 1, False), (LONG, True)):
        made = table(["lap"], [row(str(i)) for i in range(count)])
        assert ("long" in (made.get("class") or "").split()) == is_long


def test_fixes_alone_list_no_mounting(report: Report) -> None:
    placeholder = Identified([0.0, 0.0, 0.0], None, "m", False, "default")
    found = {"lever_arm_b": placeholder, "gps_offset_tau": Identified(60.0, None, "s", False, "default")}
    told = {}
    for mode in ("gps-only", "full"):
        estimate = replace(report.smoothed.report, identified=found, mode=mode)
        told[mode] = page(replace(report, smoothed=replace(report.smoothed, report=estimate)))
    assert "GPS slow error, time constant" in told["gps-only"] and "GPS slow error, time constant" in told["full"]
    assert "antenna from the logger" in told["full"] and "antenna from the logger" not in told["gps-only"]


def test_units_of_what_was_identified_are_written_as_on_paper(report: Report) -> None:
    noise = {"accel_noise": Identified(0.2, None, "m/s^2/sqrt(Hz)", True, "identified")}
    text = page(replace(report, smoothed=replace(report.smoothed, report=EstimateReport(identified=noise))))
    assert ">m/s²/√Hz<" in text and "sqrt(Hz)" not in text


def test_the_page_has_the_length_of_the_drive_as_the_terminal(report: Report) -> None:
    trajectory = report.smoothed
    length = float(trajectory.t[-1] - trajectory.t[0])
    stretched = replace(trajectory, t=trajectory.t[0] + (trajectory.t - trajectory.t[0]) * (199.7 / length))
    assert "in 3 min 20 s" in page(replace(report, smoothed=stretched))


def test_without_laps_the_time_shown_is_around_the_top_speed(
    session: Session, trajectory: Trajectory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not around a step of the fixes, where speed is high and known to be wrong."""
    assert trajectory.sigmas is not None
    monkeypatch.setattr(page_data, "WITHOUT_LAPS", 6.0)  # of a session of 40 s
    told = page_data.compared_times(page_data.Numbers(session, trajectory, None, None))
    step = 0 if told[0] > trajectory.t[0] else -1
    speed, sigma = trajectory.velocity_n.copy(), trajectory.sigmas.speed.copy()
    speed[step], sigma[step] = [200.0, 0.0, 0.0], 100.0
    stepped = replace(trajectory, velocity_n=speed, sigmas=replace(trajectory.sigmas, speed=sigma))
    assert page_data.compared_times(page_data.Numbers(session, stepped, None, None)) == told


def test_a_spike_that_is_not_sure_is_left_out_of_scales_as_of_the_top_speed(
    session: Session, trajectory: Trajectory
) -> None:
    plain = page_data.page_data(page_data.Numbers(session, trajectory, None, None))
    assert "is_sure" not in plain["traces"]  # type: ignore[operator]
    document = page_data.page_data(page_data.Numbers(session, spiked(trajectory), None, None))
    traces = document["traces"]
    assert isinstance(traces, dict)
    speed, sure = floats(traces["speed"]), floats(traces["is_sure"])
    assert speed.max() > 100.0 and set(sure) == {0.0, 1.0}
    assert speed[sure == 1.0].max() == pytest.approx(floats(plain["traces"]["speed"]).max())  # type: ignore[index]
    assert len(floats(document["cloud"]["right"])) == len(floats(plain["cloud"]["right"])) - 20  # type: ignore[index]


def test_a_spike_does_not_make_the_places_that_are_drawn_fewer(
    driven: tuple[Trajectory, LapAnalysis, Session],
) -> None:
    trajectory, laps, _ = driven
    assert laps.traces is not None
    plain, with_spike = (page_data.grid_columns(one, laps.traces) for one in (trajectory, spiked(trajectory)))
    np.testing.assert_array_equal(plain, with_spike)


def test_accelerations_of_fixes_had_no_gravity_in_them(session: Session, trajectory: Trajectory) -> None:
    gps = replace(trajectory, report=replace(trajectory.report, mode="gps-only"))
    with_sensor, without = (page(Report(session, one, None, None, GOOD)) for one in (trajectory, gps))
    assert "Source: the motion sensor, gravity removed." in with_sensor
    assert "Laps shown" not in with_sensor  # of a session without laps
    assert "Source: the smoothed GPS speed." in without


def spiked(trajectory: Trajectory) -> Trajectory:
    """It with a spike of 0.4 s that is known to be unsure."""
    assert trajectory.sigmas is not None
    velocity, sigma = trajectory.velocity_n.copy(), trajectory.sigmas.speed.copy()
    velocity[500:520], sigma[500:520] = [120.0, 0.0, 0.0], 100.0
    return replace(trajectory, velocity_n=velocity, sigmas=replace(trajectory.sigmas, speed=sigma))


def test_of_one_lap_that_counts_nothing_is_compared(driven: tuple[Trajectory, LapAnalysis, Session]) -> None:
    trajectory, laps, session = driven
    second = next(lap for lap in laps.laps if lap.number == 2)
    rows = slice(0, int(np.searchsorted(trajectory.t, second.start + 10.0)))
    few = trajectory.rows(rows)
    one = analyse(few, fix_path(session))
    assert one.statistics is not None and one.statistics.counted == 1
    assert np.isnan(one.statistics.theoretical) and np.isnan(one.statistics.theoretical_raw)
    text = page(Report(session, few, None, one, GOOD))
    assert "Theoretical best" not in text and "usual loss" not in text and "Seconds lost to" not in text
    assert "that counts; there is no other to compare it with" in text and ">0 of 0<" not in text
    assert "offset" not in numbers(text)["traces"]  # type: ignore[operator]
    assert all("<td>–</td>" * len(one.corners) not in part for part in text.split("<tr"))
    said = dict(figures(json.loads(to_json(analysis_document(one, session.origin)))))
    assert "theoretical" not in said and said["consistency"] == "1 lap counts; there is no other to compare it with"


@pytest.mark.parametrize(
    ("below_best", "words"),
    [
        (0.1, "best sectors add up to 50.877, which is 0.023 s too fast by chance"),
        (0.0, "best sectors add up to 50.977: faster than the best lap by chance only"),
    ],
)
def test_the_bias_of_the_best_sectors_is_shown_in_seconds(report: Report, below_best: float, words: str) -> None:
    assert report.laps is not None and report.laps.statistics is not None
    theoretical = 51.0 - below_best
    times = {"best": 51.0, "theoretical": theoretical, "theoretical_raw": theoretical - 0.023}
    laps = replace(report.laps, statistics=replace(report.laps.statistics, **times))
    assert f"; {words}" in page(replace(report, laps=laps))
    document = json.loads(to_json(analysis_document(laps, report.session.origin)))
    assert f"({words})" in dict(figures(document))["theoretical"]


def test_a_loss_never_has_a_sigma_of_nought(report: Report) -> None:
    assert report.laps is not None
    corners = tuple(
        replace(c, time_lost=np.full_like(c.time_lost, -0.0712), time_lost_sigma=np.full_like(c.time_lost, 0.0041))
        for c in report.laps.corners
    )
    text = page(replace(report, laps=replace(report.laps, corners=corners)))
    assert "-0.071" in text and "± 0.004</small>" in text and "± 0.00</small>" not in text


@pytest.mark.parametrize(("gaps", "longest"), [(0, 0.0), (1, 3.0)])
def test_without_gaps_no_longest_one_is_shown(
    gaps: int, longest: float, report: Report, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = page_module.recorded_check(report.session)
    measures = {**found.measures, "fix_gaps": float(gaps), "fix_gap_longest_s": longest}
    monkeypatch.setattr(page_module, "recorded_check", lambda _: replace(found, measures=measures))
    text = page(report)
    assert f"<td>gaps in the fixes</td><td>{gaps}</td>" in text
    assert ("<td>longest gap in the fixes</td>" in text) == (gaps > 0)


@pytest.mark.parametrize(
    ("code", "remedy"),
    [(IMU_SHAKEN, "Mount the logger away from the engine; sample faster"), (BOX_ON_WHEEL, "Mount it on the frame")],
)
def test_a_problem_shows_its_code_and_what_to_do_about_it(report: Report, code: str, remedy: str) -> None:
    found = EstimateReport(problems=(Problem(code, "so it is", 1),))
    listed = page(replace(report, smoothed=replace(report.smoothed, report=found))).partition("Problems of the")[2]
    assert f"<li>so it is <code>{code}</code><br>What to do: {remedy}" in listed


def test_a_problem_without_a_remedy_shows_none(report: Report) -> None:
    found = EstimateReport(problems=(Problem("gps_null_island", "so it is", 1),))
    listed = page(replace(report, smoothed=replace(report.smoothed, report=found))).partition("Problems of the")[2]
    assert "<li>so it is <code>gps_null_island</code></li>" in listed


def test_consistency_is_the_spread_of_the_laps(report: Report) -> None:
    assert report.laps is not None and report.laps.statistics is not None
    said = replace(report.laps.statistics, counted=12, spread=0.123, within_tenth=4)
    text = page(replace(report, laps=replace(report.laps, statistics=said)))
    assert "<dd>0.123 s<small>spread of 12 laps that count; 3 of the others within" in text
    said = replace(said, spread=np.nan)
    text = page(replace(report, laps=replace(report.laps, statistics=said)))
    assert "<dd>12 laps<small>that count; 3 of the others within" in text


def test_reasons_why_a_lap_does_not_count_stand_apart(report: Report) -> None:
    assert report.laps is not None
    odd = (*report.laps.laps[:-1], replace(report.laps.laps[-1], reasons=("pit", "off-track")))
    laps = replace(report.laps, laps=odd)
    assert "<td>pit, off-track</td>" in page(replace(report, laps=laps))
    assert lap_rows(laps)[-1]["reason"] == "pit, off-track"


@pytest.mark.parametrize("faster", [0.2, -0.2])
def test_a_rolling_best_below_the_theoretical_is_explained(report: Report, faster: float) -> None:
    assert report.laps is not None and report.laps.statistics is not None
    said = report.laps.statistics
    theoretical = said.best - 0.1
    statistics = replace(said, theoretical=theoretical, theoretical_raw=theoretical, rolling=theoretical - faster)
    statistics = replace(statistics, rolling_raw=statistics.rolling)
    laps = replace(report.laps, statistics=statistics)
    assert ("laps that do not count" in _rolling(statistics)) == (faster > 0.0)
    assert _rolling(statistics) in page(replace(report, laps=laps))
    document = json.loads(to_json(analysis_document(laps, report.session.origin)))
    assert ("laps that do not count" in dict(figures(document))["rolling best"]) == (faster > 0.0)
    lucky = replace(statistics, rolling_raw=statistics.rolling - 0.03)
    timed = f"timed as {lap_clock(lucky.rolling_raw)}"
    assert timed in _rolling(lucky) and timed not in _rolling(statistics)
    document = json.loads(to_json(analysis_document(replace(laps, statistics=lucky), report.session.origin)))
    assert timed in dict(figures(document))["rolling best"]
    driven_so = replace(said, theoretical=said.best, theoretical_raw=said.best)
    assert "the best lap has all the best sectors" in page(replace(report, laps=replace(laps, statistics=driven_so)))
