"""smooth laps and smooth compare as a person calls them, on two short simulated sessions."""

import datetime as dt
import html
import json
import re
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother.cli.main import run
from smoother.laps.clock import lap_clock, local_day, local_time, local_zone
from smoother.sim.track import TRACKS

Captured = pytest.CaptureFixture[str]
TABLES_ONLY = ("--no-baseline", "--no-figures")


@pytest.fixture(scope="module")
def lapped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two smoothed sessions of one track, named by its own line."""
    folder = tmp_path_factory.mktemp("lapped")
    for name, seed in (("saturday", "5"), ("sunday", "6")):
        made = ["simulate", str(folder / name), "--track", "tinbarn", "--duration", "130", "--seed", seed]
        assert run([*made, "--preset", "white", "--set", "motion.standstill=2"]) == 0
        (folder / name / "session.toml").write_text('[session]\ntrack = "tinbarn"\n')
        assert run([str(folder / name), *TABLES_ONLY]) == 0
    return folder


def line_of(track: str) -> str:
    return ";".join(f"{lat:.9f},{lon:.9f}" for lat, lon in TRACKS[track].start_line_deg)


def test_a_typed_line_a_track_file_and_a_known_track_are_the_same_line(
    lapped: Path, tmp_path: Path, capsys: Captured
) -> None:
    (a_lat, a_lon), (b_lat, b_lon) = TRACKS["tinbarn"].start_line_deg
    ends = {"start_a_lat": a_lat, "start_a_lng": a_lon, "start_b_lat": b_lat, "start_b_lng": b_lon}
    (tmp_path / "t.json").write_text(json.dumps({"hall": ends, "far": {**ends, "start_a_lat": a_lat + 1e-4}}))
    times = []
    for line in (line_of("tinbarn"), f"{tmp_path / 't.json'}#hall", "tinbarn"):
        assert run(["laps", str(lapped / "saturday"), "--line", line, "--json"]) == 0
        laps = json.loads(capsys.readouterr().out)["laps"]
        times.append([lap["lap_time_s"] for lap in laps if lap["valid"]])
    assert times[1] == pytest.approx(times[0], abs=1e-3)
    assert times[2] == pytest.approx(times[0], abs=1e-3)
    summary = json.loads((lapped / "saturday" / "smoothed" / "summary.json").read_text())
    assert times[0] == pytest.approx([lap["lap_time_s"] for lap in summary["laps"] if lap["valid"]], abs=2e-3)


def test_a_line_that_was_not_passed_leaves_times_and_sigmas_as_they_were(
    lapped: Path, tmp_path: Path, capsys: Captured
) -> None:
    (a_lat, a_lon), (b_lat, b_lon) = TRACKS["tinbarn"].start_line_deg
    away = f"{a_lat + 0.01},{a_lon};{b_lat + 0.01},{b_lon}"
    recording = with_settings(lapped, tmp_path, "")
    assert run([str(recording), *TABLES_ONLY]) == 0
    summary = json.loads((recording / "smoothed" / "summary.json").read_text())
    capsys.readouterr()
    assert run(["laps", str(recording), "--line", away, "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["laps"] == summary["laps"]
    assert document["lap_analysis"]["sigma_source"] == "joint"
    assert document["lap_analysis"]["problems"]  # which say so
    assert summary["lap_analysis"]["problems"] == []


def test_the_table_shows_every_lap_with_its_error_bar(lapped: Path, capsys: Captured) -> None:
    assert run(["laps", str(lapped / "saturday"), "--corners", "--units", "mph"]) == 0
    text = capsys.readouterr().out
    summary = json.loads((lapped / "saturday" / "smoothed" / "summary.json").read_text())
    for lap in summary["laps"]:
        assert lap_clock(lap["lap_time_s"]) in text
    for word in ("±", "mph", "theoretical", "rolling best", "consistency", "lost in each corner", "out-lap"):
        assert word in text


def test_times_of_day_are_the_same_on_every_way_out(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    """The delay of the fixes counts in all of them: here it moves what is shown to the next second."""
    recording = Path(shutil.copytree(lapped / "saturday", tmp_path / "saturday", ignore=lambda *_: ["smoothed"]))
    fixes = pl.read_csv(recording / "gps.csv")
    fixes.with_columns(pl.col("unix_s") - starts_late(lapped)).write_csv(recording / "gps.csv")
    assert run([str(recording), "--no-baseline", "--no-pictures"]) == 0
    summary = json.loads((recording / "smoothed" / "summary.json").read_text())
    about = summary["session"]
    assert summary["identified"]["gps_position_latency"]["observable"]
    zero = dt.datetime.fromisoformat(about["start_utc"]).timestamp() - about["start_s"]
    wanted = [local_time(zero + lap["start_s"]) for lap in summary["laps"]]
    zone = local_zone([zero])
    said = capsys.readouterr().out
    assert times_of_day(said) == wanted and f"laps, times of day in {zone}\n" in said
    assert run(["laps", str(recording)]) == 0
    said = capsys.readouterr().out
    assert times_of_day(said) == wanted and f"{recording}, times of day in {zone}\n" in said
    page = (recording / "smoothed" / "report.html").read_text().partition("<script")[0]
    assert times_of_day(page) == wanted and f"started ({zone})" in page and local_day(zero) in page


def starts_late(lapped: Path) -> float:
    """Seconds by which a session has to be earlier for its first lap to start a moment after a whole second."""
    summary = json.loads((lapped / "saturday" / "smoothed" / "summary.json").read_text())
    about = summary["session"]
    start = dt.datetime.fromisoformat(about["start_utc"]).timestamp() - about["start_s"] + summary["laps"][1]["start_s"]
    return start % 1.0 - 0.3 * float(summary["identified"]["gps_position_latency"]["value"])


def times_of_day(text: str) -> list[str]:
    return re.findall(r"\b\d\d:\d\d:\d\d\b", text)


def test_official_times_are_shown_beside_ours(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    true = pl.read_csv(lapped / "saturday" / "truth_laps.csv")
    official = tmp_path / "transponder.csv"
    official.write_text("\n".join(["lap_time_s", *(str(t) for t in true["lap_time_s"])]))
    assert run(["laps", str(lapped / "saturday"), "--official", str(official), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["lap_analysis"]["official"]
    assert [one["lap"] for one in found] == true["lap"].to_list()
    assert max(abs(one["difference_s"]) for one in found) < 0.2


def with_settings(lapped: Path, folder: Path, settings: str) -> Path:
    """A copy of a smoothed session with other settings."""
    copy = Path(shutil.copytree(lapped / "saturday", folder / "copy"))
    (copy / "session.toml").write_text(settings)
    return copy


def test_a_known_track_with_a_wrong_letter_is_not_passed_over(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    session = with_settings(lapped, tmp_path, '[session]\ntrack = "tinbran"\n')
    for command in (["laps", str(session)], [str(session), *TABLES_ONLY]):
        assert run(command) == 2
        assert "track 'tinbran' is not known; did you mean 'tinbarn'?" in capsys.readouterr().err


def test_a_track_without_a_line_is_reported_as_only_a_name(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    session = with_settings(lapped, tmp_path, '[session]\ntrack = "Some Raceway"\n')
    assert run(["laps", str(session), "--json"]) == 0
    (problem,) = json.loads(capsys.readouterr().out)["lap_analysis"]["problems"]
    assert problem["code"] == "track_unknown" and "'Some Raceway' is taken as a name only" in problem["text"]


def test_two_sessions_are_compared_on_one_line(lapped: Path, capsys: Captured) -> None:
    assert run(["compare", str(lapped / "saturday"), str(lapped / "sunday"), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    one, other = document["sessions"]
    assert document["reference"].split(" lap ")[0] in ("saturday", "sunday")
    assert one["lap_analysis"]["length_m"] == pytest.approx(other["lap_analysis"]["length_m"], abs=1e-6)
    assert len(one["lap_analysis"]["corners"]) == len(other["lap_analysis"]["corners"])
    assert run(["compare", str(lapped / "saturday"), str(lapped / "sunday")]) == 0
    text = capsys.readouterr().out
    assert "best laps, times of day in " in text and "lost against" in text
    assert (
        text.count("the line was given after smoothing: each ± is typical of its session, not of the single lap") == 1
    )
    assert "best lap's top km/h" in text  # that of the session is mostly another lap's
    page = Path(text.splitlines()[-1])
    assert page == lapped / "saturday" / "smoothed" / "comparison.html"
    assert "Top speed: that of the best lap." in page.read_text(encoding="utf-8")
    assert "Comparison on one reference line" in page.read_text(encoding="utf-8")
    words = "each ± is typical of its session and not of the single lap"
    assert words in html.unescape(page.read_text(encoding="utf-8"))


def test_a_session_without_a_whole_lap_has_dashes_in_a_comparison_and_a_reason(
    lapped: Path, tmp_path: Path, capsys: Captured
) -> None:
    made = ["simulate", str(tmp_path / "short"), "--track", "tinbarn", "--duration", "20", "--seed", "7"]
    assert run([*made, "--preset", "white"]) == 0
    assert run([str(tmp_path / "short"), *TABLES_ONLY]) == 0
    capsys.readouterr()
    assert run(["compare", str(lapped / "saturday"), str(tmp_path / "short")]) == 0
    said = capsys.readouterr()
    assert said.err == "smooth: short: no whole lap on the reference line\n"
    rows = [line.split() for line in said.out.splitlines() if line.endswith("  short")]
    assert len(rows) == 3 and all(set(row[:-1]) == {"-"} for row in rows[1:])
    page = Path(said.out.splitlines()[-1]).read_text(encoding="utf-8")
    assert "short: no whole lap on the reference line" in page


def test_the_way_home_makes_no_other_track_of_a_session(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    """A logger that was left on in the car: most of its rows are 50 km away."""
    home = tmp_path / "home"
    shutil.copytree(lapped / "saturday", home)
    path = home / "smoothed" / "trajectory.csv"
    rows = pl.read_csv(path, infer_schema_length=None)
    last, n = rows["t_s"][-1], len(rows) + 100
    far = pl.concat([rows[-1:]] * n).with_columns(
        t_s=pl.Series(last + 0.02 * np.arange(1, n + 1)),
        lat_deg=pl.col("lat_deg") + 0.5,
        north_m=pl.col("north_m") + 5e4,
    )
    pl.concat([rows, far]).write_csv(path)
    assert run(["compare", str(lapped / "sunday"), str(home), "--json"]) == 0
    _, there = json.loads(capsys.readouterr().out)["sessions"]
    assert there["lap_analysis"]["statistics"]["counted"] > 1
    rows.with_columns(lat_deg=pl.col("lat_deg") + 0.5, north_m=pl.col("north_m") + 5e4).write_csv(path)
    assert run(["compare", str(lapped / "sunday"), str(home)]) == 2
    assert "km away from sunday; compare one track" in capsys.readouterr().err


def test_a_session_of_the_other_direction_is_reported(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    fixes = pl.read_csv(lapped / "saturday" / "gps.csv", infer_schema_length=None).select("t_s", "lat_deg", "lon_deg")
    back = fixes.reverse().with_columns(fixes["t_s"])
    (tmp_path / "back").mkdir()
    back.write_csv(tmp_path / "back" / "gps.csv")
    assert run(["compare", str(lapped / "saturday"), str(tmp_path / "back")]) == 0
    said = capsys.readouterr().err
    assert "back: was driven in the other direction; compare sessions of one direction" in said


def called(capsys: Captured, *sessions: Path) -> tuple[list[str], str]:
    """Names of the sessions of a comparison, and the lap that all are compared with."""
    assert run(["compare", *map(str, sessions), "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    return [one["session"] for one in document["sessions"]], document["reference"]


def test_sessions_in_folders_of_one_name_are_distinguished(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    places = [tmp_path / "day" / place for place in ("kart1/run1", "kart2/run2", "kart3/run1")]
    for place, name in zip(places, ("saturday", "sunday", "sunday"), strict=True):
        shutil.copytree(lapped / name, place)
    names, reference = called(capsys, *places)
    assert names == ["kart1/run1", "kart2/run2", "kart3/run1"]
    assert reference.split(" lap ")[0] in names
    page = (places[0] / "smoothed" / "comparison.html").read_text(encoding="utf-8")
    assert f'"against_name":"{reference}"' in page
    assert page.count('"is_against":true') == 1  # the best of all; the twins are two drives of equal times
    assert "<td>+0.000</td>" not in page
    assert run(["compare", *map(str, places)]) == 0
    said = capsys.readouterr().out
    assert f"lost against {reference}" in said
    assert any(set(line.split()[:-1]) == {"-"} for line in said.splitlines()), "what the best lost to itself"
    assert all(said.count(name) >= 3 for name in names)


def test_the_page_of_a_comparison_goes_to_out(lapped: Path, tmp_path: Path, capsys: Captured) -> None:
    sessions = [str(lapped / "saturday"), str(lapped / "sunday")]
    assert run(["compare", *sessions, "--out", str(tmp_path / "page.html")]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == str(tmp_path / "page.html")
    assert run(["compare", *sessions, "--out", str(tmp_path / "new folder" / "page.html")]) == 0
    capsys.readouterr()
    assert run(["compare", *sessions, "--out", str(tmp_path / "page.html" / "page.html")]) == 2
    assert "cannot be written" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["laps"], "no session given"),
        (["laps", "SESSION", "--line", "nowhere"], "neither a track file"),
        (["laps", "SESSION", "--line", "tinbran"], "did you mean tinbarn?"),
        (["laps", "SESSION", "--line", "gone.geojson"], "cannot be read"),
        (["laps", "SESSION", "--line", "1,2;1,2"], "the line is 0.0 m long"),
        (["compare", "SESSION"], "needs two sessions"),
        (["compare", "SESSION", "SESSION", "--against", "77"], "no lap 77"),
    ],
)
def test_what_cannot_be_done_is_reported_in_one_line(
    lapped: Path, arguments: list[str], message: str, capsys: Captured
) -> None:
    session = str(lapped / "saturday")
    assert run([session if word == "SESSION" else word for word in arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert len(error.strip().splitlines()) == 1


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(58.648, "58.648"), (62.3454, "1:02.345"), (119.9999, "2:00.000"), (None, "-"), (float("nan"), "-")],
)
def test_lap_times_are_written_as_racers_write_them(seconds: float | None, text: str) -> None:
    assert lap_clock(seconds) == text


def test_runs_from_a_start_to_a_finish_elsewhere_have_no_rolling_best(
    lapped: Path, tmp_path: Path, capsys: Captured
) -> None:
    shutil.copytree(lapped / "saturday", tmp_path / "sprint", ignore=shutil.ignore_patterns("smoothed"))
    (start, end) = (
        [[lon, lat] for lat, lon in line] for line in (TRACKS["tinbarn"].start_line_deg, sector_of(lapped / "saturday"))
    )
    lines = (("start", start), ("finish", end))
    features = [
        {"type": "Feature", "properties": {"line": n}, "geometry": {"type": "LineString", "coordinates": c}}
        for n, c in lines
    ]
    (tmp_path / "sprint" / "t.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    (tmp_path / "sprint" / "session.toml").write_text('[session]\ntrack = "t.geojson"\n')
    for command in ([], ["laps"], ["laps", "--corners"]):
        options = [] if command else ["--no-baseline"]
        assert run([*command, str(tmp_path / "sprint"), *options]) == 0
        said = capsys.readouterr().out
        assert "best " in said
        assert "rolling" not in said
    assert "Rolling best" not in (tmp_path / "sprint" / "smoothed" / "report.html").read_text()


def sector_of(session: Path) -> list[tuple[float, float]]:
    line = json.loads((session / "smoothed" / "summary.json").read_text())["lap_analysis"]["sector_lines"][0]
    return [(line[side]["lat_deg"], line[side]["lon_deg"]) for side in ("left", "right")]
