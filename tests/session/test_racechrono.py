"""RaceChrono CSV of version 3: repeated names, units, sensors in rows of their own, and what is damaged."""

from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session.load import load_raw
from smoother.session.readers.sets import read_tables as read_racechrono

from .readers import assert_outlives_damage, assert_refused

PREAMBLE = """This file is created using RaceChrono v9.1.3 ( http://racechrono.com/ ).
Format,3
Session title,"Lignano, ""wet"" run"
Session type,Lap timing
Track name,"Lignano"
Driver name,
Created,11/04/2026,11:32
Note,

"""
NAMES = (
    "timestamp,fragment_id,lap_number,elapsed_time,accuracy,altitude,bearing,fix_type,latitude,longitude,satellites,"
    "speed,speed,lateral_acc,lateral_acc,x_acc,y_acc,z_acc,x_rate_of_rotation,y_rate_of_rotation,z_rate_of_rotation"
)
UNITS = "unix time,,,s,m,m,deg,,deg,deg,sats,km/h,m/s,G,G,G,G,G,deg/s,deg/s,deg/s"
SOURCES = ",,,,100: gps,100: gps,100: gps,100: gps,100: gps,100: gps,100: gps,calc,100: gps,calc,100: gps" + (
    ",101: acc" * 3 + ",102: gyro" * 3
)
START = 1_775_907_141.0


def fix_row(k: int) -> str:
    """10 Hz, north at 10 m/s by the receiver."""
    place = f"{45.0 + k * 1.0 / 111195:.9f},13.073000000"
    return f"{START + 0.1 * k:.3f},0,,{0.1 * k:.3f},0.42,4.5,0.0,3,{place},16,99.0,10.0,0.1,0.2,,,,,,"


def imu_row(k: int) -> str:
    return f"{START + 0.01 * k + 0.003:.3f},0,1,{0.01 * k:.3f},,,,,,,,,,,,0.1,-0.2,1.0,1.0,2.0,-90.0"


def csv(rows: list[str], names: str = NAMES) -> str:
    return PREAMBLE + "\n".join([names, UNITS, SOURCES, *rows]) + "\n"


def read(directory: Path, text: str):
    path = directory / "session.csv"
    path.write_text(text, encoding="utf-8")
    return read_racechrono(path)


def test_a_file_in_two_bytes_a_character_is_read(tmp_path: Path) -> None:
    text = csv([fix_row(k) for k in range(60)])
    (tmp_path / "session.csv").write_text(text, encoding="utf-16")
    raw = load_raw(tmp_path)
    assert raw.inputs == ("session.csv",)
    np.testing.assert_array_equal(raw.gnss.lat_deg, read(tmp_path, text).gnss.lat_deg)


def test_of_repeated_names_that_of_the_receiver_is_taken_with_its_unit(tmp_path: Path) -> None:
    gnss = read(tmp_path, csv([fix_row(k) for k in range(60)])).gnss
    np.testing.assert_allclose(gnss.speed, 10.0)
    np.testing.assert_allclose(gnss.t, 0.1 * np.arange(60), atol=1e-6)
    assert gnss.unix_s[0] == START and gnss.sigma_horizontal[0] == 0.42 and gnss.num_sv[0] == 16
    np.testing.assert_allclose(gnss.velocity_n[:, 0], 10.0)


def test_a_lone_speed_is_in_the_unit_of_its_row(tmp_path: Path) -> None:
    text = csv([fix_row(k).replace(",99.0,", ",36.5,") for k in range(60)])
    text = text.replace("100: gps,calc,100: gps,calc", "100: gps,100: gps,calc,calc")
    np.testing.assert_allclose(read(tmp_path, text).gnss.speed, 36.5 / 3.6)


def test_inertial_samples_in_rows_of_their_own_are_no_failed_fixes(tmp_path: Path) -> None:
    rows = sorted([fix_row(k) for k in range(60)] + [imu_row(k) for k in range(600)])
    reading = read(tmp_path, csv(rows))
    assert len(reading.gnss) == 60 and reading.problems == []
    assert reading.imu is not None and reading.imu.t.size == 600
    np.testing.assert_allclose(reading.imu.accel[0], np.array([0.1, -0.2, 1.0]) * 9.80665)
    np.testing.assert_allclose(reading.imu.gyro[0], np.radians([1.0, 2.0, -90.0]))


def union(fix_rate: float = 5.0, imu_rate: float = 50.0) -> str:
    """A minute with a row at every stamp of every source: all is interpolated there, and only the bearing is held."""
    rng = np.random.default_rng(1)
    fix_t, imu_t = np.arange(0.0, 60.0, 1.0 / fix_rate), np.arange(0.0, 60.0, 1.0 / imu_rate)
    t = np.unique(np.round(np.concatenate([fix_t, imu_t, np.arange(0.013, 59.7, 0.05)]), 3))
    t = t[t <= fix_t[-1]]
    course, speed = np.degrees(fix_t / 5.0) % 360.0, 12.0 + 3.0 * np.sin(fix_t / 4.0)
    way = np.cumsum(speed * np.array([np.cos(np.radians(course)), np.sin(np.radians(course))]), axis=1) / fix_rate
    lat, lon = (np.interp(t, fix_t, x) for x in (45 + way[0] / 111_195, 13 + way[1] / 78_600))
    bearing = course[np.searchsorted(fix_t, t + 1e-6) - 1]
    samples = np.array([[0.1], [-0.2], [1.0], [1.0], [2.0], [-90.0]]) + 0.1 * rng.standard_normal((6, imu_t.size))
    imu = np.column_stack([np.interp(t, imu_t, x) for x in samples])
    rows = [
        f"{START + s:.3f},0,,{s:.3f},0.42,4.5,{b:.3f},3,{a:.7f},{o:.7f},16,99.0,{v:.3f},0.1,0.2,"
        + ",".join(f"{x:.5f}" for x in values)
        for s, b, a, o, v, values in zip(t, bearing, lat, lon, np.interp(t, fix_t, speed), imu, strict=True)
    ]
    return csv(rows)


@pytest.mark.parametrize("fix_rate", [1.0, 5.0, 10.0, 25.0])
def test_rows_at_the_stamps_of_other_sensors_are_neither_fixes_nor_samples(tmp_path: Path, fix_rate: float) -> None:
    reading = read(tmp_path, union(fix_rate))
    gnss = reading.gnss
    np.testing.assert_allclose(gnss.t[:-1], np.arange(len(gnss) - 1) / fix_rate, atol=2e-3)
    assert abs(len(gnss) - 60 * fix_rate) <= 1
    (said,) = reading.problems
    assert said.code == "gps_interpolated" and "positions between fixes were interpolated" in said.text
    assert reading.imu is not None and abs(reading.imu.t.size - 50 * reading.imu.t[-1]) <= 3


def test_a_bearing_that_does_not_change_on_the_straight_costs_no_fix(tmp_path: Path) -> None:
    bearings = [10.0 * (k // 40 if k % 80 < 40 else k // 40 + k % 40) for k in range(600)]  # straights, and bends
    rows = [fix_row(k).replace(",0.0,3,", f",{bearing % 360:.1f},3,") for k, bearing in enumerate(bearings)]
    rows[0] = rows[0].replace(",13.073000000,", ",13.073000001,")  # one that never changes was not measured
    assert len(read(tmp_path, csv(rows)).gnss) == 600


def test_accelerations_and_rates_in_rows_of_their_own_make_samples(tmp_path: Path) -> None:
    """The rates, 90 deg/s faster every second, are interpolated to the accelerations; not across a second without."""
    rng = np.random.default_rng(3)
    blank = ",0,,," + "," * 11
    rows = [fix_row(k) for k in range(60)]
    rows += [f"{START + 0.01 * k:.3f}{blank}0.1,-0.2,{1 + 0.01 * rng.standard_normal():.4f},,," for k in range(600)]
    rows += [
        f"{START + 0.01 * k + 0.004:.3f}{blank},,,{rng.standard_normal():.3f},2.0,{90 * (0.01 * k + 0.004):.3f}"
        for k in range(600)
        if not 200 <= k < 300
    ]
    imu = read(tmp_path, csv(sorted(rows))).imu
    assert imu is not None
    inside = (imu.t < 2.0) | (imu.t > 3.0)
    np.testing.assert_allclose(imu.gyro[:, 2], np.radians(90.0 * imu.t), atol=1e-4)
    assert imu.t.size == pytest.approx(500, abs=3) and np.count_nonzero(inside) >= imu.t.size - 2


def test_what_a_motion_sensor_lacks_is_reported(tmp_path: Path) -> None:
    rows = [fix_row(k) for k in range(60)]
    reading = read(tmp_path, csv(rows, NAMES.replace("z_rate_of_rotation", "x")))
    assert reading.imu is None
    (problem,) = reading.problems
    assert problem.code == "imu_incomplete" and "gz is missing" in problem.text


def test_a_folder_with_the_file_is_a_session_and_the_file_too(tmp_path: Path) -> None:
    rows = sorted([fix_row(k) for k in range(60)] + [imu_row(k) for k in range(600)])
    read(tmp_path, csv(rows))
    (tmp_path / "imu.csv").write_text("t_s,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n")
    raw = load_raw(tmp_path)
    assert raw.inputs == ("session.csv",) and raw.imu is not None
    assert "imu_unused" in {problem.code for problem in raw.problems}
    assert load_raw(tmp_path / "session.csv").name == "session"


def test_gps_csv_wins_over_a_recording_of_another_program(tmp_path: Path) -> None:
    read(tmp_path, csv([fix_row(k) for k in range(60)]))
    rows = "".join(f"{k},45.0,{13 + k * 1e-4}\n" for k in range(9))
    (tmp_path / "gps.csv").write_text(f"t_s,lat_deg,lon_deg\n{rows}")
    assert load_raw(tmp_path).inputs == ("gps.csv",)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (csv([]), "a header line, but no rows"),
        (csv([fix_row(k) + ",1,2" for k in range(9)]), "rows have 23 values, but 21 columns are named"),
        (csv([fix_row(0)] * 50), "rows repeat the time of another"),
        (csv([fix_row(0).replace(f"{START:.3f}", f"{START + 1e-5 * k:.5f}") for k in range(90)]), "fixes a second"),
        (csv([fix_row(36_000 * k) for k in range(9)]), "a fix every 3.6e+03 s only"),
    ],
)
def test_an_unusable_file_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    assert_refused(read_racechrono, tmp_path / "session.csv", text, message, capsys)


def test_an_endless_line_ends_the_reading(tmp_path: Path) -> None:
    path = tmp_path / "session.csv"
    path.write_text(csv([fix_row(0)]))
    with path.open("r+b") as file:
        file.seek(1 << 30)
        file.write(b"\n")
    with pytest.raises(SessionError, match="characters; this is no table"):
        read_racechrono(path)


@pytest.mark.parametrize("seed", range(30))
def test_random_damage_raises_nothing_but_a_session_error(tmp_path: Path, seed: int) -> None:
    assert_outlives_damage(
        read_racechrono, tmp_path / "session.csv", csv([fix_row(k) for k in range(40)] + [imu_row(9)]), seed
    )


def test_cells_that_are_no_numbers_are_reported(tmp_path: Path) -> None:
    """Where both coordinates are damaged, the row would pass for one of another sensor, and be missed by nobody."""
    rows = [fix_row(k) for k in range(60)]
    latitude = rows[0].split(",").index(next(cell for cell in rows[0].split(",") if cell.startswith("45")))
    for k in range(10, 40, 3):
        cells = rows[k].split(",")
        cells[latitude] = cells[latitude + 1] = "4#.1"
        rows[k] = ",".join(cells)
    reading = read(tmp_path, csv(rows))
    assert len(reading.gnss) == 50
    said = [problem.text for problem in reading.problems if problem.code == "gps_unread"]
    assert [text.partition(": ")[2] for text in said] == [
        "latitude of 10 rows is no number; not used",
        "longitude of 10 rows is no number; not used",
    ]
