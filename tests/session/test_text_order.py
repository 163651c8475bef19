"""Tables that a spreadsheet sorted by their times as texts: 0.1, 1.2, 10.3, 100.4, 11.1."""

from pathlib import Path

import numpy as np
import pytest

from smoother.session.beside import read_mag
from smoother.session.csv_form import read_fixes, read_imu
from tests.session.folders import Folder, codes, gps_csv, imu_csv


def sorted_as_text(table: str) -> str:
    header, *rows = table.splitlines()
    return "\n".join([header, *sorted(rows)]) + "\n"


def with_utc(table: str) -> str:
    header, *rows = table.splitlines()
    return "\n".join([f"{header},unix_s", *(f"{row},{1.7e9 + float(row.split(',')[0]):.2f}" for row in rows)]) + "\n"


def save(directory: Path, text: str, name: str) -> Path:
    path = directory / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("start", [0.0, 3.7])
@pytest.mark.parametrize("count", [300, 1000])
def test_samples_sorted_as_text_are_put_in_time_order(tmp_path: Path, start: float, count: int) -> None:
    text = imu_csv(count * 10, 20.0, start)
    clean, _ = read_imu(save(tmp_path, text, "clean.csv"))
    imu, problems = read_imu(save(tmp_path, sorted_as_text(text), "imu.csv"))
    np.testing.assert_array_equal(imu.t, clean.t)
    np.testing.assert_array_equal(imu.accel, clean.accel)
    assert [problem.code for problem in problems] == ["imu_sorted_as_text"]
    assert problems[0].text.startswith("imu.csv: rows sorted by t_s as text (0.1, 10.3, 11.1, 2.2); ")


@pytest.mark.parametrize("utc", [False, True])
def test_fixes_sorted_as_text_with_a_hole_in_them_are_put_in_time_order(tmp_path: Path, utc: bool) -> None:
    header, *rows = gps_csv(900).splitlines()
    text = "\n".join([header, *rows[:61], *rows[90:]]) + "\n"  # 12.2 to 18 s
    text = with_utc(text) if utc else text
    clean, _ = read_fixes(save(tmp_path, text, "clean.csv"))
    fixes, problems = read_fixes(save(tmp_path, sorted_as_text(text), "gps.csv"))
    np.testing.assert_array_equal(fixes.t, clean.t)
    np.testing.assert_array_equal(fixes.lat_deg, clean.lat_deg)
    assert [problem.code for problem in problems] == ["gps_sorted_as_text"]


def test_a_compass_sorted_as_text_is_put_in_time_order(tmp_path: Path) -> None:
    text = "t_s,mx,my,mz\n" + "".join(f"{k / 10:.1f},{k},2,3\n" for k in range(3000))
    mag, problems = read_mag(save(tmp_path, sorted_as_text(text), "mag.csv"))
    np.testing.assert_array_equal(mag.field[:, 0], np.arange(3000))
    assert [problem.code for problem in problems] == ["mag_sorted_as_text"]


def test_two_drives_sorted_into_one_another_are_not_one(tmp_path: Path) -> None:
    header, *rows = with_utc(gps_csv(600)).splitlines()
    cells = [row.split(",") for row in rows]
    later = [f"{float(t) + 0.07:.2f},{','.join(values)},{float(utc) + 500:.2f}" for t, *values, utc in cells]
    _, problems = read_fixes(save(tmp_path, sorted_as_text("\n".join([header, *rows, *later])), "gps.csv"))
    assert "gps_sorted_as_text" not in [problem.code for problem in problems]


@pytest.mark.parametrize("starts", [(100.0, 20.0), (100.0, 20.0, 3.0)])
def test_clocks_that_started_again_are_not_taken_for_texts(tmp_path: Path, starts: tuple[float, ...]) -> None:
    tables = [imu_csv(400, 50.0, start).splitlines() for start in starts]
    text = "\n".join([tables[0][0], *(row for table in tables for row in table[1:])]) + "\n"
    _, problems = read_imu(save(tmp_path, text, "imu.csv"))
    assert [problem.code for problem in problems] == ["imu_clock_restart"]


def test_a_session_sorted_as_text_is_the_same_session(tmp_path: Path) -> None:
    folder = Folder(tmp_path).write(gps__csv=sorted_as_text(gps_csv(600)), imu__csv=sorted_as_text(imu_csv(12000)))
    session = folder.load()
    assert len(session.gnss) == 600 and session.imu is not None and session.imu.t.size == 12000
    assert {"gps_sorted_as_text", "imu_sorted_as_text"} <= codes(session).keys()
