"""GPX with times: versions, extensions, points without time, and what is damaged."""

import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session.load import load_raw
from smoother.session.readers.tracks import read_track as read_gpx

from .readers import assert_outlives_damage, assert_refused

HEAD = (
    '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1">'
)
FOOT = "</trkseg></trk></gpx>\n"
EXTENSION = (
    '<extensions><g:TrackPointExtension xmlns:g="http://www.garmin.com/xmlschemas/TrackPointExtension/v2">'
    "<g:speed>10.0</g:speed><g:course>0.0</g:course></g:TrackPointExtension></extensions>"
)


def point(k: int, time: str = "", extra: str = EXTENSION) -> str:
    """5 Hz, north at 10 m/s."""
    time = time or f"<time>2026-04-11T11:32:{21 + k // 5:02d}.{k % 5 * 200:03d}Z</time>"
    return f'<trkpt lat="{45 + 2.0 * k / 111195:.9f}" lon="13.073"><ele>4.5</ele>{time}{extra}</trkpt>\n'


def gpx(points: list[str]) -> str:
    return f"{HEAD}<metadata><time>2020-01-01T00:00:00Z</time></metadata><trk><trkseg>" + "".join(points) + FOOT


def read(directory: Path, text: str):
    path = directory / "track.gpx"
    path.write_text(text, encoding="utf-8")
    return read_gpx(path)


def test_points_come_with_time_height_and_the_speed_of_the_extension(tmp_path: Path) -> None:
    reading = read(tmp_path, gpx([point(k) for k in range(50)]))
    gnss = reading.gnss
    np.testing.assert_allclose(gnss.t, 0.2 * np.arange(50), atol=1e-6)
    np.testing.assert_allclose(gnss.velocity_n[:, :2], [[10.0, 0.0]] * 50, atol=1e-9)
    assert gnss.unix_s[0] == 1_775_907_141.0 and gnss.alt_m[0] == 4.5 and reading.problems == []


def test_speeds_without_a_course_are_kept(tmp_path: Path) -> None:
    reading = read(tmp_path, gpx([point(k, extra="<speed>10.0</speed>") for k in range(190)]))
    np.testing.assert_allclose(reading.gnss.speed, 10.0)
    assert np.isnan(reading.gnss.course_deg).all() and np.isnan(reading.gnss.velocity_n).all()
    assert {problem.code for problem in reading.problems} == {"gps_no_course"}


def test_the_older_version_has_speed_and_course_in_the_point(tmp_path: Path) -> None:
    plain = gpx([point(k, extra="<course>0.0</course><speed>10.0</speed>") for k in range(50)])
    gnss = read(tmp_path, plain.replace("GPX/1/1", "GPX/1/0")).gnss
    np.testing.assert_allclose(gnss.speed, 10.0)


def test_segments_and_tracks_follow_one_another(tmp_path: Path) -> None:
    points = [point(k) for k in range(50)]
    points[20] = f"</trkseg><trkseg>{points[20]}"
    points[35] = f"</trkseg></trk><trk><trkseg>{points[35]}"
    assert len(read(tmp_path, gpx(points)).gnss) == 50


def test_points_without_time_are_dropped_and_counted(tmp_path: Path) -> None:
    points = [point(k) for k in range(50)]
    points[7], points[9] = point(7, "<time/>"), point(9, "<time>soon</time>")
    reading = read(tmp_path, gpx(points))
    assert len(reading.gnss) == 48
    assert {problem.code: problem.count for problem in reading.problems} == {"gps_no_time": 2}


def test_a_file_that_was_cut_gives_what_is_whole(tmp_path: Path) -> None:
    text = gpx([point(k) for k in range(50)])
    reading = read(tmp_path, text[: len(text) // 2])
    assert 20 <= len(reading.gnss) <= 26
    assert [problem.code for problem in reading.problems] == ["gps_file_cut"]


@pytest.mark.parametrize("encoding", ["UTF-90.0001", "rot13", "big5"])
def test_points_of_an_unknown_encoding_are_read_as_they_are(tmp_path: Path, encoding: str) -> None:
    text = gpx([point(k) for k in range(50)])
    declared = f'<?xml version="1.0" encoding="{encoding}"?>' + text.partition("?>")[2]
    reading = read(tmp_path, declared)
    assert len(reading.gnss) == 50
    assert [problem.code for problem in reading.problems] == ["gps_file_cut"]


def test_a_folder_with_the_file_is_a_session_of_fixes(tmp_path: Path) -> None:
    read(tmp_path, gpx([point(k) for k in range(50)]))
    raw = load_raw(tmp_path)
    assert raw.inputs == ("track.gpx",) and raw.imu is None


BOMB = (
    '<?xml version="1.0"?><!DOCTYPE gpx [<!ENTITY a "ha">'
    + "".join(f'<!ENTITY {chr(98 + i)} "{10 * f"&{chr(97 + i)};"}">' for i in range(9))
    + "]><gpx>&j;</gpx>"
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "broken XML"),
        ("hello", "broken XML"),
        (gpx([]), "no track points in it"),
        (gpx([point(k, "<time/>") for k in range(9)]), "9 points without time, which cannot be smoothed"),
        (gpx([point(0)] * 50), "rows repeat the time of another"),
        (
            gpx([point(0, f"<time>2026-04-{k + 1:02d}T00:00:00Z</time>") for k in range(20)]),
            "a fix every 8.64e+04 s only",
        ),
        (BOMB, "broken XML"),
    ],
)
def test_an_unusable_file_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    assert_refused(read_gpx, tmp_path / "track.gpx", text, message, capsys)


@pytest.mark.parametrize("start", [HEAD, gpx([point(0)])[: -len(FOOT)], HEAD + "<trk><name>"])
def test_an_endless_line_ends_the_reading_with_little_memory(tmp_path: Path, start: str) -> None:
    path = tmp_path / "track.gpx"
    with path.open("wb") as file:
        file.write(start.encode())
        for _ in range(64):
            file.write(b"a" * (1 << 20))
    tracemalloc.start()
    with pytest.raises(SessionError, match="characters without an element"):
        read_gpx(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 20e6


def test_a_long_track_is_read_point_by_point(tmp_path: Path) -> None:
    path = tmp_path / "track.gpx"
    with path.open("w") as file:
        file.write(f"{HEAD}<trk><trkseg>")
        for k in range(4000):
            clock = f"{k // 18000:02d}:{k // 300 % 60:02d}:{k // 5 % 60:02d}.{k % 5 * 200:03d}"
            file.write(point(k, f"<time>2026-04-11T{clock}Z</time>"))
        file.write(FOOT)
    tracemalloc.start()
    gnss = read_gpx(path).gnss
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(gnss) == 4000
    assert peak < 4000 * 1500  # a document in memory takes some 5000 bytes a point


@pytest.mark.parametrize("seed", range(30))
def test_random_damage_raises_nothing_but_a_session_error(tmp_path: Path, seed: int) -> None:
    assert_outlives_damage(read_gpx, tmp_path / "track.gpx", gpx([point(k) for k in range(40)]), seed, most=20)
