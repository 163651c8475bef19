"""The CSV form and what may be wrong with a table and its rows."""

import gzip
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from smoother.errors import SessionError
from smoother.session.beside import read_mag
from smoother.session.csv_form import read_fixes, read_imu
from smoother.session.tables import read_header, read_table

IMU_HEADER = "t_s,ax,ay,az,gx,gy,gz"
GPS_HEADER = "t_s,lat_deg,lon_deg,alt_m,speed_mps,course_deg,hacc_m,num_sv,fix"


def save(directory: Path, text: str | bytes, name: str) -> Path:
    path = directory / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def imu_rows(count: int) -> list[str]:
    return [f"{0.01 * k:.3f},0.1,{0.01 * (k % 9):.2f},9.8,0.001,0.002,{0.003 * (k % 5):.3f}" for k in range(count)]


def gps_rows(count: int, speed: float = 10.0) -> list[str]:
    """5 Hz, north at `speed`."""
    return [f"{0.2 * k:.2f},{45 + 0.2 * k * speed / 111195:.9f},12.0,8.5,{speed},0.0,1.5,9,3" for k in range(count)]


def imu_table(rows: list[str]) -> str:
    return "\n".join([IMU_HEADER, *rows]) + "\n"


def gps_table(rows: list[str]) -> str:
    return "\n".join([GPS_HEADER, *rows]) + "\n"


def codes(problems: list) -> dict[str, int]:
    return {problem.code: problem.count for problem in problems}


def test_a_clean_table_is_read_as_it_stands(tmp_path: Path) -> None:
    imu, problems = read_imu(save(tmp_path, imu_table(imu_rows(300)), "imu.csv"))
    assert problems == [] and imu.t.size == 300
    np.testing.assert_array_equal(imu.accel[4], [0.1, 0.04, 9.8])
    np.testing.assert_array_equal(imu.gyro[4], [0.001, 0.002, 0.012])
    assert (imu.accel_scale, imu.gyro_scale) == (1.0, 1.0)


def test_byte_order_mark_spaces_capitals_line_ends_and_extra_columns_are_tolerated(tmp_path: Path) -> None:
    lines = ['T_S , AX,"ay",az,GX,gy,gz,note,', *(f" {row} ,x,y" for row in imu_rows(20))]
    plain, _ = read_imu(save(tmp_path, imu_table(imu_rows(20)), "plain.csv"))
    for name, text in {
        "crlf.csv": ("\ufeff" + "\r\n".join(lines) + "\r\n").encode(),
        "cr.csv": "\r".join(lines).encode(),
        "utf16.csv": "\n".join(lines).encode("utf-16"),
        "blank.csv": ("\n\n" + "\n\n".join(lines) + "\n\n\n").encode(),
    }.items():
        imu, problems = read_imu(save(tmp_path, text, name))
        assert problems == [], name
        np.testing.assert_array_equal(imu.t, plain.t)
        np.testing.assert_array_equal(imu.gyro, plain.gyro)


@pytest.mark.parametrize("begins_with_returns", [True, False])
def test_lines_that_end_in_different_ways_are_all_lines(tmp_path: Path, begins_with_returns: bool) -> None:
    lines = imu_table(imu_rows(30)).splitlines()
    ends = ["\r"] * 12 + ["\n"] * 19 if begins_with_returns else ["\n", "\r\n", "\r"] * 11
    mixed = "".join(line + end for line, end in zip(lines, ends, strict=False))
    imu, problems = read_imu(save(tmp_path, mixed, "imu.csv"))
    assert problems == [] and imu.t.size == 30


def test_columns_may_stand_in_any_order(tmp_path: Path) -> None:
    imu, _ = read_imu(save(tmp_path, "gz,gy,gx,az,ay,ax,t_s\n6,5,4,3,2,1,0.5\n6,5,4,3,2,1,0.6\n", "imu.csv"))
    np.testing.assert_array_equal(imu.accel[0], [1, 2, 3])
    np.testing.assert_array_equal(imu.gyro[0], [4, 5, 6])


@pytest.mark.parametrize("kept", [1.0, 0.6])
def test_gzip_is_read_and_a_cut_archive_gives_what_is_whole(tmp_path: Path, kept: float) -> None:
    packed = gzip.compress(imu_table(imu_rows(3000)).encode())
    imu, _ = read_imu(save(tmp_path, packed[: int(kept * len(packed))], "imu.csv.gz"))
    assert 3000 * kept * 0.8 < imu.t.size <= 3000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"^imu.csv: the file is empty; expected a header line with t_s, ax"),
        ("\n\n", r"^imu.csv: the file is empty"),
        (IMU_HEADER, r"^imu.csv: a header line, but no rows"),
        (IMU_HEADER + "\n\n", r"^imu.csv: a header line, but no rows"),
        ("t_s,ax,ay,az,gx,gy\n0,1,2,3,4,5\n", r"^imu.csv: no column gz; has t_s, ax, ay, az, gx, gy$"),
        ("t_s|ax|ay\n0|1|2\n", r"^imu.csv: no column t_s; has t_s\|ax\|ay; write commas between the columns$"),
        (IMU_HEADER.replace(",", " ") + "\n0 1 2 3 4 5 6\n", "; write commas between the columns$"),
        ("t_s [s],ax [m/s^2]\n0,1\n", r"has t_s \[s\], ax \[m/s\^2\]; write names alone, as t_s$"),
        (b"\x00\x01\xff" * 300, r"^imu.csv: not a text table, but a file of another kind; wanted t_s, ax, "),
    ],
)
def test_a_file_that_cannot_be_used_is_one_line_with_file_and_what_it_has(
    tmp_path: Path, text: str | bytes, message: str
) -> None:
    with pytest.raises(SessionError, match=message) as error:
        read_imu(save(tmp_path, text, "imu.csv"))
    assert "\n" not in str(error.value) and len(str(error.value)) < 400


def test_bad_rows_are_dropped_and_counted_by_kind(tmp_path: Path) -> None:
    rows = imu_rows(500)
    rows[10] = rows[10].replace("9.8", "")
    rows[20] = rows[20].replace("9.8", "nan")
    rows[30] = rows[30].replace("9.8", "x7")
    rows[40] = "0.4,0.1"  # cut
    rows[50] = rows[50].replace("9.8", "9e9")
    rows[60] = rows[60].replace("0.002", "-1000")
    rows[70] = rows[69]
    rows[80] = "0.123," + rows[80].partition(",")[2]
    rows[90] = '"' + rows[90]  # a mark without a partner is none
    imu, problems = read_imu(save(tmp_path, imu_table(rows), "imu.csv"))
    assert codes(problems) == {
        "imu_row_damaged": 1,
        "imu_invalid": 3,
        "imu_repeated_time": 1,
        "imu_out_of_order": 1,
    }
    assert imu.t.size == 494
    assert all(problem.text.startswith("imu.csv: ") and problem.text.endswith("; dropped") for problem in problems)


def test_every_optional_column_of_fixes_reaches_its_place(tmp_path: Path) -> None:
    header = (
        "t_s,lat_deg,lon_deg,alt_m,speed_mps,course_deg,vel_n_mps,vel_e_mps,vel_u_mps,hacc_n_m,hacc_e_m,vacc_m,"
        "sacc_n_mps,sacc_e_mps,hdop,num_sv,fix,utc"
    )
    row = "1.0,45.0,12.0,7.0,5.0,53.13,3.0,4.0,0.5,3.0,4.0,6.0,0.1,0.1,0.8,11,1,2024-05-31T10:00:00.250Z"
    fixes, problems = read_fixes(save(tmp_path, f"{header}\n{row}\n", "gps.csv"))
    assert problems == []
    np.testing.assert_array_equal(fixes.velocity_n[0], [3.0, -4.0, 0.5])
    assert fixes.sigma_horizontal[0] == pytest.approx(np.sqrt(12.5)) and fixes.sigma_up[0] == 6.0
    assert fixes.sigma_velocity[0] == pytest.approx(0.1) and fixes.hdop[0] == 0.8
    assert (fixes.num_sv[0], fixes.fix[0], fixes.alt_m[0]) == (11, 1, 7.0)
    assert fixes.unix_s[0] == pytest.approx(1717149600.25, abs=1e-6)


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("utc", "2024-05-31 10:00:00.25"),
        ("utc", "2024-05-31T12:00:00.25+02:00"),
        ("utc", "2024-05-31T10:00:00.250000Z"),
        ("utc", "20240531T100000.250Z"),
        ("utc", "20240531T120000.25+0200"),
        ("unix_s", "1717149600.25"),
        ("utc_ms", "1717149600250"),
    ],
)
def test_utc_comes_in_several_forms(tmp_path: Path, column: str, value: str) -> None:
    fixes, _ = read_fixes(save(tmp_path, f"t_s,lat_deg,lon_deg,{column}\n0,45,12,{value}\n", "gps.csv"))
    assert fixes.unix_s[0] == pytest.approx(1717149600.25, abs=1e-6)


@pytest.mark.parametrize(
    ("column", "value", "code"),
    [
        ("utc", "0001-01-01T00:00:01Z", "gps_utc_unread"),
        ("utc", "9999-12-31T23:59:59Z", "gps_utc_unread"),
        ("unix_s", "4.7e9", "gps_utc_absurd"),
    ],
)
def test_utc_of_a_receiver_that_has_no_date_is_not_used(tmp_path: Path, column: str, value: str, code: str) -> None:
    rows = [f"{0.2 * k:.1f},{45 + 1e-5 * k:.6f},12,{value}" for k in range(9)]
    fixes, problems = read_fixes(save(tmp_path, f"t_s,lat_deg,lon_deg,{column}\n" + "\n".join(rows) + "\n", "gps.csv"))
    assert len(fixes) == 9 and np.all(np.isnan(fixes.unix_s)) and fixes.unix_at_zero is None
    assert codes(problems) == {code: 9}


@pytest.mark.parametrize("count", [1, 5])
def test_utc_without_fractions_of_less_than_a_second_is_used(tmp_path: Path, count: int) -> None:
    rows = [f"{0.2 * k:.1f},{45 + 1e-5 * k:.6f},12,1717149600" for k in range(count)]
    fixes, problems = read_fixes(save(tmp_path, "t_s,lat_deg,lon_deg,unix_s\n" + "\n".join(rows) + "\n", "gps.csv"))
    assert fixes.unix_s is not None and fixes.unix_s[0] == 1717149600 and problems == []


def straight(directory: Path, factor: float, as_components: bool = False):
    """Fixes of a minute to the north, with speeds `factor` times the true ones; and these."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, 60.0, 0.2)
    speed = 14.0 + 6.0 * np.sin(t / 3.0)
    north = 14.0 * t - 18.0 * np.cos(t / 3.0) + 0.3 * rng.standard_normal(t.size)
    lines = ["t_s,lat_deg,lon_deg," + ("vel_n_mps,vel_e_mps" if as_components else "speed_mps,course_deg")]
    lines += [f"{a:.1f},{45 + n / 111_132:.8f},12,{factor * v:.4f},0" for a, n, v in zip(t, north, speed, strict=True)]
    fixes, problems = read_fixes(save(directory, "\n".join(lines) + "\n", "gps.csv"))
    return fixes, problems, speed


@pytest.mark.parametrize(
    ("factor", "unit"),
    [
        *((1.0, ""), (3.6, "km/h"), (2.23694, "mph"), (1.94384, "knots"), (0.27778, "m/s, read as km/h")),
        *((0.62137, "mph, read as km/h"), (0.53996, "knots, read as km/h"), (1.60934, "km/h, read as mph")),
    ],
)
@pytest.mark.parametrize("as_components", [False, True])
def test_speed_in_another_unit_is_found_by_the_positions_and_converted(
    tmp_path: Path, factor: float, unit: str, as_components: bool
) -> None:
    fixes, problems, speed = straight(tmp_path, factor, as_components)
    np.testing.assert_allclose(fixes.velocity_n[:, 0], speed, rtol=1e-4)
    assert [p.code for p in problems] == (["gps_speed_unit"] if unit else [])
    assert all(f"times those of its positions, as if in {unit}; converted" in p.text for p in problems)


@pytest.mark.parametrize("factor", [0.3, 0.7, 0.8, 1.25, 3.3])
def test_speeds_that_contradict_the_positions_as_no_unit_does_are_left_out(tmp_path: Path, factor: float) -> None:
    fixes, problems, _ = straight(tmp_path, factor)
    assert np.isnan(fixes.velocity_n[:, :2]).all() and np.isnan(fixes.speed).all()
    (problem,) = problems
    assert "times those of its positions; not used. What is their unit?" in problem.text


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_speeds_that_nearly_fit_the_positions_are_left_as_they_are(tmp_path: Path, factor: float) -> None:
    fixes, problems, speed = straight(tmp_path, factor)
    np.testing.assert_allclose(fixes.speed, factor * speed, rtol=1e-4)
    assert problems == []


def test_times_of_day_that_are_not_understood_are_reported_and_empty_ones_are_not(tmp_path: Path) -> None:
    rows = [f"{0.2 * k:.1f},45.0000{k},12,2024-05-31T10:00:0{k}.0Z" for k in range(3)]
    rows += ["0.6,45.00003,12,31.5.2024 10:00", "0.8,45.00004,12,"]
    _, problems = read_fixes(save(tmp_path, "t_s,lat_deg,lon_deg,utc\n" + "\n".join(rows) + "\n", "gps.csv"))
    assert [(problem.code, problem.count) for problem in problems] == [("gps_utc_unread", 1)]
    assert "utc of 1 row is no ISO 8601 time since 1990" in problems[0].text


def test_a_column_with_a_unit_in_each_cell_or_words_is_reported_as_unread(tmp_path: Path) -> None:
    rows = [f"{0.2 * k:.1f},45,12,{h},{speed},3D" for k, (h, speed) in enumerate([("99 m", 3), ("n/a", ""), ("-", 4)])]
    fixes, problems = read_fixes(
        save(tmp_path, "t_s,lat_deg,lon_deg,alt_m,speed_mps,fix\n" + "\n".join(rows) + "\n", "gps.csv")
    )
    assert [(problem.code, problem.text) for problem in problems if problem.code == "gps_unread"] == [
        ("gps_unread", "gps.csv: alt_m of 1 row is no number; not used"),
        ("gps_unread", "gps.csv: fix of 3 rows is no number; not used"),
    ]
    assert np.all(np.isnan(fixes.alt_m))


def test_a_row_with_some_of_the_names_is_a_damaged_row(tmp_path: Path) -> None:
    _, problems = read_fixes(save(tmp_path, gps_table([*gps_rows(40), "t_s,lat_deg,lon_deg,8,1,0,1,9,3"]), "gps.csv"))
    assert codes(problems) == {"gps_invalid": 1}


@pytest.mark.parametrize("cell", ["52.1177N", "52.1177°", "52° 7' 3"])
def test_positions_that_are_no_numbers_are_shown(tmp_path: Path, cell: str) -> None:
    table = save(tmp_path, f"t_s,lat_deg,lon_deg\n0,{cell},12\n1,{cell},12\n", "gps.csv")
    with pytest.raises(SessionError, match=f"^gps.csv: lat_deg is {cell}; it has to be in degrees, as a number$"):
        read_fixes(table)


@pytest.mark.parametrize("cell", ["", "nan", "--"])
def test_positions_that_were_never_there_are_only_counted(tmp_path: Path, cell: str) -> None:
    fixes, problems = read_fixes(save(tmp_path, f"t_s,lat_deg,lon_deg\n0,{cell},{cell}\n", "gps.csv"))
    assert len(fixes) == 0 and sum(problem.count for problem in problems) == 1


def test_what_a_file_does_not_say_is_unknown(tmp_path: Path) -> None:
    fixes, _ = read_fixes(save(tmp_path, "t_s,lat_deg,lon_deg\n0,45,12\n1,45.0001,12\n", "gps.csv"))
    assert np.all(np.isnan(fixes.velocity_n)) and np.all(np.isnan(fixes.alt_m)) and np.all(np.isnan(fixes.unix_s))
    assert list(fixes.num_sv) == [-1, -1] and list(fixes.fix) == [1, 1]


def test_speed_and_course_make_a_velocity_where_components_are_missing(tmp_path: Path) -> None:
    fixes, _ = read_fixes(
        save(tmp_path, gps_table([row.replace(",0.0,1.5", ",90.0,1.5") for row in gps_rows(3)]), "gps.csv")
    )
    np.testing.assert_allclose(fixes.velocity_n[:, :2], [[0.0, -10.0]] * 3, atol=1e-12)
    assert np.all(np.isnan(fixes.velocity_n[:, 2]))


def test_a_climb_counts_beside_speed_and_course_but_not_alone(tmp_path: Path) -> None:
    rows = "0,45.0,12.0,10.0,90.0,0.5\n1,45.0,12.0001,,,0.5\n2,45.0,12.0002,10.0,,0.5\n"
    header = "t_s,lat_deg,lon_deg,speed_mps,course_deg,vel_u_mps\n"
    fixes, _ = read_fixes(save(tmp_path, header + rows, "gps.csv"))
    np.testing.assert_allclose(fixes.velocity_n[0], [0.0, -10.0, 0.5], atol=1e-12)
    assert np.all(np.isnan(fixes.velocity_n[1:]))


def test_rows_that_are_no_fix_are_dropped_and_counted_by_kind(tmp_path: Path) -> None:
    rows = gps_rows(400)
    rows[5] = rows[5].removesuffix("3") + "0"  # quality 0
    rows[6] = "1.20,,,,,,,,"  # no position yet
    rows[7] = "1.40,0.0,0.0,0,0,0,1,9,3"
    rows[8] = rows[8].replace("12.0", "500.0", 1)
    rows[9] = rows[9].replace(",12.0", ",twelve", 1)
    rows[10] = rows[10].replace(",10.0,0.0", ",900.0,0.0")
    rows[11] = rows[11].replace(",1.5,", ",4294967.0,")  # a receiver that has no idea
    rows[12] = rows[12].replace("45.", "54.")  # digits swapped: 1000 km away
    fixes, problems = read_fixes(save(tmp_path, gps_table(rows), "gps.csv"))
    assert codes(problems) == {
        "gps_no_fix": 3,
        "gps_null_island": 1,
        "gps_absurd": 1,
        "gps_invalid": 1,
        "gps_too_fast": 1,
        "gps_jump": 1,
    }
    assert len(fixes) == 392


def test_a_column_of_speeds_that_is_wrong_throughout_costs_the_column_and_not_the_fixes(tmp_path: Path) -> None:
    rows = [row.replace(",10.0,", f",{10000 + k}.0,") for k, row in enumerate(gps_rows(100))]
    fixes, problems = read_fixes(save(tmp_path, gps_table(rows), "gps.csv"))
    assert len(fixes) == 100 and np.all(np.isnan(fixes.speed)) and codes(problems) == {"gps_speed_absurd": 100}


@pytest.mark.parametrize("left", [",12.000", ",12", ",12.0,8", ",12.0,8.5,10.0,0.0,1.5,9,"])
@pytest.mark.parametrize("zeros", [0, 3 << 20])
def test_a_last_row_cut_by_a_loss_of_power_is_no_fix(tmp_path: Path, left: str, zeros: int) -> None:
    rows = [row.replace(",12.0,", f",12.0{k:05d},") for k, row in enumerate(gps_rows(100))]
    rows[-1] = ",".join(rows[-1].split(",")[:2]) + left
    fixes, problems = read_fixes(save(tmp_path, gps_table(rows).rstrip("\n").encode() + bytes(zeros), "gps.csv"))
    assert len(fixes) == 99 and codes(problems) == {"gps_row_cut": 1}


def test_a_last_row_without_end_that_is_whole_is_kept(tmp_path: Path) -> None:
    for text in (gps_table(gps_rows(100)).rstrip("\n"), gps_table(gps_rows(100)) + "\0" * 5000):
        fixes, problems = read_fixes(save(tmp_path, text, "gps.csv"))
        assert len(fixes) == 100 and problems == []


def test_jumps_of_50_m_are_left_to_the_estimator(tmp_path: Path) -> None:
    rows = gps_rows(100)
    rows[50] = rows[50].replace(",12.0", ",12.0006", 1)
    fixes, problems = read_fixes(save(tmp_path, gps_table(rows), "gps.csv"))
    assert len(fixes) == 100 and problems == []


def test_a_block_in_another_country_is_dropped_whole_whichever_end_it_stands_at(tmp_path: Path) -> None:
    rows = gps_rows(100)
    for block in (slice(0, 20), slice(80, 100)):
        moved = rows.copy()
        moved[block] = [row.replace("45.", "35.") for row in rows[block]]
        fixes, problems = read_fixes(save(tmp_path, gps_table(moved), "gps.csv"))
        assert len(fixes) == 80 and codes(problems) == {"gps_jump": 20}


def test_a_position_written_again_while_moving_is_stale_but_not_while_standing(tmp_path: Path) -> None:
    moving, standing = gps_rows(50), gps_rows(50, speed=0.0)
    for k in range(5, 50, 5):
        moving[k] = f"{0.2 * k:.2f}," + moving[k - 1].partition(",")[2]
    fixes, problems = read_fixes(save(tmp_path, gps_table(moving), "gps.csv"))
    assert len(fixes) == 41 and codes(problems) == {"gps_repeated": 9}
    fixes, problems = read_fixes(save(tmp_path, gps_table(standing), "gps.csv"))
    assert len(fixes) == 50 and problems == []


def test_of_a_position_that_hangs_while_the_kart_starts_only_the_moving_rows_are_stale(tmp_path: Path) -> None:
    rows = gps_rows(60)
    for k in range(20, 40):
        speed = "0.0" if k < 35 else "8.0"  # 3 s of standing, then 1 s under way with the position still held
        rows[k] = f"{0.2 * k:.2f}," + rows[19].partition(",")[2].replace(",10.0,", f",{speed},")
    rows[40:] = [f"{0.2 * k:.2f}," + gps_rows(60)[k - 15].partition(",")[2] for k in range(40, 60)]  # from there on
    fixes, problems = read_fixes(save(tmp_path, gps_table(rows), "gps.csv"))
    assert codes(problems) == {"gps_repeated": 5}
    assert np.count_nonzero((fixes.t > 3.9) & (fixes.t < 6.9)) == 15


def test_stale_positions_are_found_without_a_speed_too(tmp_path: Path) -> None:
    rows = [",".join(row.split(",")[:3]) for row in gps_rows(50)]
    rows[20] = "4.00," + rows[19].partition(",")[2]
    rows[30:40] = [f"{6.0 + 0.2 * k:.2f}," + rows[29].partition(",")[2] for k in range(10)]
    rows[40:] = [",".join(row.split(",")[:3]) for row in gps_rows(50)[30:40]]
    rows[40:] = [f"{8.0 + 0.2 * k:.2f}," + row.partition(",")[2] for k, row in enumerate(rows[40:])]
    fixes, problems = read_fixes(save(tmp_path, "t_s,lat_deg,lon_deg\n" + "\n".join(rows), "gps.csv"))
    assert codes(problems) == {"gps_repeated": 1}  # the one while moving, not the two seconds of standing
    assert len(fixes) == 49


def test_coarse_positions_that_repeat_for_lack_of_decimals_are_kept(tmp_path: Path) -> None:
    rows = [
        f"{0.1 * k:.1f},{round((45 + 0.1 * k * 2.0 / 111195) / 5.73e-6) * 5.73e-6:.9f},12.0,,2.0,0.0,,,"
        for k in range(200)
    ]
    fixes, problems = read_fixes(save(tmp_path, gps_table(rows), "gps.csv"))
    assert len(fixes) == 200 and problems == []


def test_longitude_may_run_to_360_and_is_continuous_across_180(tmp_path: Path) -> None:
    rows = [f"{0.2 * k:.1f},10.0,{(179.9999 + 1e-5 * k):.6f},,5.0,90.0,,," for k in range(40)]
    fixes, problems = read_fixes(save(tmp_path, gps_table(rows), "gps.csv"))
    assert problems == [] and len(fixes) == 40
    assert fixes.lon_deg[0] == pytest.approx(179.9999) and fixes.lon_deg[-1] == pytest.approx(-179.99971)


def test_a_magnetometer_that_reads_nothing_is_dropped(tmp_path: Path) -> None:
    mag, problems = read_mag(save(tmp_path, "t_s,mx,my,mz\n0,1,2,3\n1,0,0,0\n2,1,2,4\n", "mag.csv"))
    assert mag.t.size == 2 and codes(problems) == {"mag_zero": 1}


def test_a_field_beyond_any_unit_is_dropped(tmp_path: Path) -> None:
    """In counts, nanotesla or tesla none is that large; squares of 1e200 overflow."""
    text = "t_s,mx,my,mz\n0,1,2,3\n1,1,-1e200,3\n2,48000,2,4\n3,1,nan,1e12\n"
    mag, problems = read_mag(save(tmp_path, text, "mag.csv"))
    assert mag.t.tolist() == [0.0, 2.0] and codes(problems) == {"mag_absurd": 1, "mag_invalid": 1}


def test_a_header_is_read_from_any_kind_of_file(tmp_path: Path) -> None:
    assert read_header(save(tmp_path, "\ufeffA, b ,\n1,2\n", "x.csv")) == ("a", "b", " #1")
    assert read_header(save(tmp_path, b"", "y.csv")) == ()


def test_a_table_of_millions_of_rows_is_read_without_holding_its_text(tmp_path: Path) -> None:
    t = np.arange(200_000) * 0.005
    frame = pl.DataFrame({"t_s": t, **{name: np.sin(t) for name in ("ax", "ay", "az", "gx", "gy", "gz")}})
    path = tmp_path / "imu.csv"
    frame.write_csv(path)
    table = read_table(path, IMU_HEADER.split(","))
    np.testing.assert_array_equal(table.column("gz"), np.sin(t))


@pytest.mark.parametrize("cell", ["", "x", "1.5 ", "nan", '"1.5"', "1e999"])
def test_one_odd_cell_changes_no_number_of_another_row(tmp_path: Path, cell: str) -> None:
    rows = imu_rows(200)
    clean = read_table(save(tmp_path, imu_table(rows), "clean.csv"), IMU_HEADER.split(","))
    rows[70] = ",".join([*rows[70].split(",")[:3], cell, *rows[70].split(",")[4:]])
    odd = read_table(save(tmp_path, imu_table(rows), "odd.csv"), IMU_HEADER.split(","))
    others = np.delete(np.arange(200), 70)
    for name in IMU_HEADER.split(","):
        np.testing.assert_array_equal(odd.column(name)[others], clean.column(name)[others])
    np.testing.assert_array_equal(odd.column("az")[70], 1.5 if "1.5" in cell else np.nan)


_CSV_BYTES = gps_table(gps_rows(30)).encode()


@pytest.mark.slow
@settings(max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_random_damage_raises_nothing_but_a_session_error(tmp_path: Path, data: st.DataObject) -> None:
    for name, read, text in (
        ("gps.csv", read_fixes, _CSV_BYTES),
        ("imu.csv", read_imu, imu_table(imu_rows(30)).encode()),
    ):
        damaged = bytearray(text)
        for _ in range(data.draw(st.integers(0, 40))):
            damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
        path = save(tmp_path, bytes(damaged[: data.draw(st.integers(0, len(damaged)))]), name)
        try:
            samples, _ = read(path)
        except SessionError as error:
            assert str(error).startswith(name) and "\n" not in str(error)
        else:
            assert np.all(np.diff(samples.t) > 0)


def test_infinite_values_of_optional_columns_are_reported(tmp_path: Path) -> None:
    rows = [f"{k / 5:.1f},{45 + 1e-4 * k:.6f},12.0,{'inf' if k % 9 == 0 else 100}" for k in range(50)]
    (tmp_path / "gps.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,alt_m", *rows]) + "\n")
    _, problems = read_fixes(tmp_path / "gps.csv")
    assert "gps.csv: alt_m of 6 rows is no number; not used" in [problem.text for problem in problems]
