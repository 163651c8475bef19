"""Every finding of the fuzzers, as the smallest file that shows it."""

import gzip
import os
import tracemalloc
import zlib
from pathlib import Path

import numpy as np
import pytest
from fuzz_corpus import CORPUS, FIXES, gpx_points, write_files

from smoother.calibration import load_calibration
from smoother.errors import ConfigError, SessionError
from smoother.laps.tracks import load_tracks, named_tracks
from smoother.session.files import list_files
from smoother.session.load import load_raw
from smoother.session.readers.tracks import read_track as read_gpx
from smoother.session.readers.vbo import read_vbo
from smoother.session.settings import load_settings

LONG = "1" * 400  # a whole number of TOML and JSON may be longer than any float
DEEP = 100_000


def damaged(form: str, directory: Path, old: bytes, new: bytes) -> Path:
    """A good session of a format in which `old` became `new` at its first place; returns its directory."""
    files = {name: data.replace(old, new, 1) for name, data in CORPUS[form]().items()}
    assert files != CORPUS[form]()
    return write_files(directory / "session", files)


def test_a_comma_within_a_row_of_a_vbo_costs_at_most_that_row(tmp_path: Path) -> None:
    raw = load_raw(damaged("vbo", tmp_path, b"036.000", b"036,0,00"))
    assert len(raw.gnss) >= FIXES - 1


def test_decimal_commas_of_a_vbo_are_numbers(tmp_path: Path) -> None:
    path = tmp_path / "x.vbo"
    head, _, rows = CORPUS["vbo"]()["run.vbo"].partition(b"[data]")
    path.write_bytes(head + b"[data]" + rows.replace(b".", b","))
    np.testing.assert_allclose(read_vbo(path).gnss.speed, 10.0)


@pytest.mark.parametrize("time", [b"1e308", b"-1e308", b"1e300"])
def test_a_time_beyond_all_numbers_costs_one_row(time: bytes, tmp_path: Path) -> None:
    assert len(load_raw(damaged("vbo", tmp_path / "a", b" 100010.000", b" " + time)).gnss) == FIXES - 1
    assert len(load_raw(damaged("racechrono", tmp_path / "b", b"\n1775907141.000", b"\n" + time)).gnss) == FIXES - 1


@pytest.mark.parametrize(
    ("old", "new", "lost"),
    [
        (b"<time>2026-04-11T11:32:10.000Z</time>", b"<ti\x00me>2026-04-11T11:32:10.000Z</time>", 1),
        (b"<time>2026-04-11T11:32:10.000Z</time>", b"<time>2026-04-11T11:32:10.000Z<&;/time>", 1),
        (b"</gpx>", b"", 0),
        (b"<trk>", b"<trk", 0),
        (b"<?xml", b"<xml", 0),
    ],
)
def test_damage_in_a_gpx_costs_the_points_it_hit(old: bytes, new: bytes, lost: int, tmp_path: Path) -> None:
    raw = load_raw(damaged("gpx", tmp_path, old, new))
    assert len(raw.gnss) == FIXES - lost
    assert "gps_file_cut" in {problem.code for problem in raw.problems}


def test_points_of_a_broken_gpx_keep_speeds_with_prefixes_declared_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "x.gpx"
    points = "".join(gpx_points()).replace("speed>", "gpxtpx:speed>")
    path.write_text(f"<gpx xmlns:gpxtpx='x'><trk><trkseg>{points}", encoding="utf-8")
    reading = read_gpx(path)
    assert len(reading.gnss) == FIXES
    np.testing.assert_allclose(reading.gnss.speed, 10.0)


@pytest.mark.parametrize(
    "text",
    [
        f"[gps]\nposition_latency = {LONG}",
        f"[mounting]\nlever_arm_b = [{LONG}, 0, 0]",
        f"[session]\nx = {'[' * DEEP}",
        f"[imu]\naccel_noise = {'9' * 5000}",
        "[session]\ntitle = '" + "x" * (17 << 20) + "'",
    ],
    ids=["long number", "long arm", "deep", "too long to be a number", "large"],
)
def test_settings_no_person_writes_are_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "session.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_settings(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    "text",
    [
        f"[accelerometer]\noffset = [{LONG}, 0, 0]",
        "[gyroscope]\nbias_per_kelvin = [1, 1, 1]\ntemperature = 20\ntemperature_span = [{a = 1}, 2]",
        "[gyroscope]\nbias_per_kelvin = [1, 1, 1]\ntemperature = 20\ntemperature_span = [1979-05-27, 2]",
        "[gyroscope]\nbias_per_kelvin = [1, 1, 1]\ntemperature = 20\ntemperature_span = [nan, 2]",
        f"[gyroscope]\nbias_per_kelvin = [1, 1, 1]\ntemperature = 20\ntemperature_span = [{LONG}, {LONG}]",
        f"x = {'[' * DEEP}",
    ],
)
def test_calibrations_no_program_writes_are_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "calibration.toml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_calibration(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    [
        "[" * DEEP,
        '{"type": "FeatureCollection", "features": 5}',
        '{"type": "FeatureCollection", "features": [1, null, "x", []]}',
        '{"type": "Feature", "properties": [1], "geometry": "x"}',
        '{"type": "Feature", "geometry": {"type": "LineString", "coordinates": {"a": 1, "b": 2}}}',
        '{"type": "Feature", "geometry": {"type": "LineString", "coordinates": [{"a": 1}, 2]}}',
        '{"type": "Feature", "geometry": {"type": "LineString", "coordinates": ["ab", "cd"]}}',
        f'{{"type": "Feature", "geometry": {{"type": "LineString", "coordinates": [[{LONG}, 1], [1, 2]]}}}}',
        f'{{"start_a_lat": {LONG}, "start_a_lng": 1, "start_b_lat": 1, "start_b_lng": 1}}',
        '{"start_a_lat": {}, "start_a_lng": [], "start_b_lat": "x", "start_b_lng": null}',
    ],
)
def test_track_files_of_any_shape_are_refused_in_one_line(text: str, tmp_path: Path) -> None:
    path = tmp_path / "track.json"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_tracks(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("sector", ["9" * 5000, "2"])
def test_a_sector_of_any_number_is_no_trouble(sector: str, tmp_path: Path) -> None:
    path = tmp_path / "track.geojson"
    path.write_bytes(CORPUS["columns"]()["track.geojson"].replace(b"sector 2", f"sector {sector}".encode()))
    assert len(load_tracks(path)[0].sectors) == 1


def test_settings_reach_no_file_outside_the_session(tmp_path: Path) -> None:
    inside = tmp_path / "session"
    (inside / "tracks").mkdir(parents=True)
    track = CORPUS["columns"]()["track.geojson"]
    for path in (tmp_path / "track.json", inside / "track.json", inside / "tracks" / "track.json"):
        path.write_bytes(track)
    (inside / "link.json").symlink_to(tmp_path / "track.json")
    for name in ("../track.json", str(tmp_path / "track.json"), "tracks/../../track.json", "link.json", "\0.json"):
        with pytest.raises(ConfigError, match="outside the folder"):
            named_tracks(name, inside)
    for name in ("track.json", "tracks/track.json", "tracks/../track.json"):
        assert named_tracks(name, inside)


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "gps.csv")
    with pytest.raises(SessionError, match="pipe"):
        list_files(tmp_path / "gps.csv")
    with pytest.raises(SessionError):
        load_raw(tmp_path)


def test_an_archive_that_unpacks_without_end_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("smoother.session.text.LARGEST_UNPACKED", 5 << 20)
    head = b"t_s,lat_deg,lon_deg\n0.0,45.0,13.0\n"
    (tmp_path / "gps.csv.gz").write_bytes(gzip.compress(head + b"0.1,45.0,13.0\n" * 1_000_000))
    tracemalloc.start()
    with pytest.raises(SessionError, match="unpack"):
        load_raw(tmp_path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 40e6  # the limit, one step, and the growth of a buffer


def test_a_damaged_archive_gives_all_rows_before_the_damage(tmp_path: Path) -> None:
    rows = [f"{0.1 * k:.1f},{45 + 1e-6 * k:.6f},13.0\n".encode() for k in range(2000)]
    data = bytearray(gzip.compress(b"t_s,lat_deg,lon_deg\n" + b"".join(rows)))
    decoder = zlib.decompressobj(wbits=zlib.MAX_WBITS | 16)
    whole = decoder.decompress(bytes(data[:6000])).count(b"\n") - 1
    data[6000:6040] = bytes(40)
    (tmp_path / "gps.csv.gz").write_bytes(data)
    assert len(load_raw(tmp_path).gnss) >= whole - 5  # the last codes of a block are unpacked with what follows
