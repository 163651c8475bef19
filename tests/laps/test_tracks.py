"""Track files, the library, lines typed in, official times."""

import json
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import ConfigError, SessionError
from smoother.frames import Origin
from smoother.laps.analysis import LapOptions, analyse
from smoother.laps.circuit import Circuit, find_circuit
from smoother.laps.official import load_official, parse_time
from smoother.laps.path import plan_path
from smoother.laps.results import FixPath, Lap
from smoother.laps.statistics import official_times
from smoother.laps.tracks import layout_on, library, line_from_text, load_tracks, named_tracks
from smoother.sim.track import TRACKS
from smoother.trajectory import Trajectory

A, B = [45.0, 12.0], [45.0001, 12.0001]


def geojson(*lines: tuple[str, list[float], list[float]], track: str = "") -> dict[str, object]:
    features = [
        {
            "type": "Feature",
            "properties": {"line": name, "track": track},
            "geometry": {"type": "LineString", "coordinates": [a[::-1], b[::-1]]},
        }
        for name, a, b in lines
    ]
    return {"type": "FeatureCollection", "features": features}


def written(path: Path, document: object) -> Path:
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def pairs(lat: float, **more: float) -> dict[str, float]:
    return {"start_a_lat": lat, "start_a_lng": 12.0, "start_b_lat": lat + 1e-4, "start_b_lng": 12.0, **more}


def test_the_library_has_the_simulators_tracks_where_the_simulator_has_them() -> None:
    known = library()
    assert set(known) == set(TRACKS)
    for name, track in TRACKS.items():
        np.testing.assert_allclose(known[name].start, track.start_line_deg, atol=1e-8)


def test_geojson_holds_start_sectors_in_order_and_finish(tmp_path: Path) -> None:
    lines = (("sector 2", [45.3, 12.0], [45.3001, 12.0]), ("start", A, B), ("sector 1", [45.2, 12.0], [45.2001, 12.0]))
    (track,) = load_tracks(written(tmp_path / "t.geojson", geojson(*lines, ("finish", A, B), track="hill")))
    assert track.name == "hill"
    np.testing.assert_array_equal(track.start, [A, B])
    assert [sector[0, 0] for sector in track.sectors] == [45.2, 45.3]
    assert track.finish is not None


def test_a_line_called_start_finish_is_both(tmp_path: Path) -> None:
    (track,) = load_tracks(written(tmp_path / "t.json", geojson(("Start/Finish", A, B))))
    assert track.finish is None
    np.testing.assert_array_equal(track.start, [A, B])


def test_pairs_of_points_know_their_sectors_and_several_tracks(tmp_path: Path) -> None:
    long = pairs(45.0, sector_2_a_lat=45.1, sector_2_a_lng=12.0, sector_2_b_lat=45.1001, sector_2_b_lng=12.0)
    path = written(tmp_path / "t.json", {"Long": {**long, "lengthFt": 3280.84}, "Short": pairs(45.2)})
    first, second = load_tracks(path)
    assert (first.name, second.name) == ("Long", "Short")
    assert first.length == pytest.approx(1000.0, abs=0.01)
    assert len(first.sectors) == 1
    assert [track.name for track in load_tracks(path, "short")] == ["Short"]
    assert [track.name for track in named_tracks("t.json#Short", tmp_path)] == ["Short"]
    with pytest.raises(ConfigError, match="no track 'Shrot'; there are Long, Short"):
        load_tracks(path, "Shrot")


def test_of_several_layouts_the_one_that_was_driven_is_taken(tmp_path: Path, driven: Trajectory) -> None:
    track = TRACKS["larkfield"]
    (a_lat, a_lon), (b_lat, b_lon) = track.start_line_deg
    start = {"start_a_lat": a_lat, "start_a_lng": a_lon, "start_b_lat": b_lat, "start_b_lng": b_lon}
    foot = 0.3048
    path = written(
        tmp_path / "t.json",
        {"half": {**start, "lengthFt": 0.5 * track.length / foot}, "whole": {**start, "lengthFt": track.length / foot}},
    )
    circuit = find_circuit(plan_path(driven), None, None, 100.0)
    assert isinstance(circuit, Circuit)
    lines = layout_on(load_tracks(path), track.origin, circuit.curve)
    assert lines is not None and lines.name == "whole"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "not valid JSON"),
        ("[]", "no track file"),
        ('{"Normal": {"lengthFt": 3000}}', "no start line"),
        ('{"start_a_lat": 45.0, "start_a_lng": 12.0, "start_b_lat": "x", "start_b_lng": 12.0}', "two points"),
        ('{"start_a_lat": 12.0, "start_a_lng": 145.0, "start_b_lat": 145.0, "start_b_lng": 12.0}', "out of range"),
        ('{"start_a_lat": 45.0, "start_a_lng": 12.0, "start_b_lat": 46.0, "start_b_lng": 12.0}', "the line is 111"),
        ('{"type": "FeatureCollection", "features": []}', "no LineString"),
    ],
)
def test_a_file_that_cannot_be_used_is_refused_with_the_reason(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "t.json"
    path.write_text(text)
    with pytest.raises(ConfigError, match=message):
        load_tracks(path)


def test_a_missing_file_is_an_error_and_an_unknown_name_is_only_a_name(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="cannot be read"):
        named_tracks("gone.json", tmp_path)
    assert named_tracks("Some Raceway", tmp_path) == ()
    assert [track.name for track in named_tracks("Larkfield", tmp_path)] == ["larkfield"]


def test_a_typed_line_is_two_points() -> None:
    np.testing.assert_array_equal(line_from_text("45.0,12.0; 45.0001,12.0001").start, [A, B])
    for text in ("45.0,12.0", "45,12;45.1", "a,b;c,d", "45,12;45,12"):
        with pytest.raises(ConfigError, match="line"):
            line_from_text(text)


def test_lines_come_out_where_they_are_in_n() -> None:
    origin = Origin(45.0, 12.0, 100.0)
    lines = line_from_text("45.0,12.0;45.0001,12.0").lines(origin)
    np.testing.assert_allclose(lines.start, [[0.0, 0.0], [11.113, 0.0]], atol=2e-3)


@pytest.mark.parametrize(("text", "seconds"), [("62.345", 62.345), ("1:02.345", 62.345), (" 1:02,345 ", 62.345)])
def test_a_lap_time_is_read_as_people_write_it(text: str, seconds: float) -> None:
    assert parse_time(text) == pytest.approx(seconds)


@pytest.mark.parametrize("text", ["", "lap", "-3", "nan", "inf", "1:xx", "99999"])
def test_what_is_no_lap_time_is_left_out(text: str) -> None:
    assert parse_time(text) is None


def test_official_times_come_from_their_column_or_the_last(tmp_path: Path) -> None:
    path = tmp_path / "official.csv"
    path.write_text("lap;lap_time;driver\n1;1:02.345;A\n2;;A\n3;61.5;A\n")
    assert load_official(path) == pytest.approx((62.345, 61.5))
    path.write_text("# from the timekeeper\n58.648\n57.320\n")
    assert load_official(path) == (58.648, 57.320)
    path.write_text("lap,driver\n1,A\n")
    with pytest.raises(SessionError, match="no lap times"):
        load_official(path)


def lap(number: int, time: float) -> Lap:
    nothing = np.empty(0)
    return Lap(number, 0.0, time, time, 0.02, (), nothing, nothing, nothing, time, 1000.0, 20.0, 10.0)


@pytest.mark.parametrize(
    "text",
    [
        "62,345\n61,5\n",
        "1:02,345\n1:01,5\n",
        "lap_time_s\n62,345\n61,5\n",
        "lap,lap_time,driver\n1,62,345,A\n2,61,5,B\n",
        'lap,lap_time\n1,"62,345"\n2,61.5\n',
        "lap;lap_time\n1;62,345\n2;1:01,5\n",
    ],
)
def test_official_times_may_have_a_decimal_comma(tmp_path: Path, text: str) -> None:
    path = tmp_path / "official.csv"
    path.write_text(text)
    assert load_official(path) == pytest.approx((62.345, 61.5))


def test_whole_seconds_beside_the_number_of_the_lap_are_no_decimals(tmp_path: Path) -> None:
    path = tmp_path / "official.csv"
    path.write_text("1,62\n2,61\n3,62\n")
    assert load_official(path) == (62.0, 61.0, 62.0)


def test_a_damaged_row_of_official_times_costs_itself_alone(tmp_path: Path) -> None:
    path = tmp_path / "official.csv"
    path.write_text('lap,lap_time_s\n1,"62.0\n' + "2,61.0\n" * 9_000 + "7" * 200_000 + "\n3,62.0\n")
    assert load_official(path) == (62.0, *([61.0] * 9_000), 62.0)


def test_official_times_may_be_written_as_unicode_text(tmp_path: Path) -> None:
    path = tmp_path / "official.csv"
    path.write_bytes("lap\tlap_time_s\r\n1\t1:02,345\r\n2\t61,5\r\n".encode("utf-16"))
    assert load_official(path) == pytest.approx((62.345, 61.5))


def test_what_is_no_table_of_official_times_is_refused_in_a_line(tmp_path: Path) -> None:
    path = tmp_path / "official.csv"
    path.write_bytes(np.random.default_rng(1).bytes(100_000))
    with pytest.raises(SessionError, match="no lap times"):
        load_official(path)
    path.write_bytes(b"lap_time_s\n" + b"62.0\n" * 100_000)
    with pytest.raises(SessionError, match=r"100000 lap times, more than anybody drives"):
        load_official(path)
    path.write_bytes(b"lap_time_s\n" + b"62.0\n" * 4_000_000)
    with pytest.raises(SessionError, match=r"larger than 16 MB; this is no table of lap times"):
        load_official(path)


def test_official_times_stand_beside_the_laps_they_belong_to() -> None:
    laps = (lap(0, np.nan), lap(1, 58.60), lap(2, 57.31), lap(3, 56.49), lap(4, 55.90))
    found = official_times((57.320, 56.479, 55.889, 55.834), laps)  # theirs begins a lap later and goes on longer
    assert [one.lap for one in found] == [2, 3, 4, None]
    assert [one.difference for one in found[:3]] == pytest.approx([-0.010, 0.011, 0.011], abs=1e-9)
    assert np.isnan(found[3].difference)


def test_official_times_of_another_session_belong_to_no_lap(circle: Trajectory) -> None:
    path = FixPath(circle.t[::10], circle.position_n[::10, :2])
    found = analyse(circle, path, LapOptions(official=(90.0, 91.0)))
    assert [one.lap for one in found.official] == [None, None]
    assert [problem.code for problem in found.problems] == ["official_unmatched"]
