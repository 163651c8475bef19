"""VBO files: the real ones of two programs, what differs between programs, and what is damaged."""

import re
import tracemalloc
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from smoother.errors import SessionError
from smoother.samples import GnssFixes
from smoother.session.load import load_raw
from smoother.session.readers.foreign import ForeignReading
from smoother.session.readers.vbo import TimingLine, own_lines, read_vbo

from .readers import assert_outlives_damage, assert_refused

HEADER = ("satellites", "time", "latitude", "longitude", "velocity kmh", "heading", "height")
COLUMNS = ("sats", "time", "lat", "long", "velocity", "heading", "height")
LIGNANO, MASSA = (
    "kart_lignano_racebox/raw_racebox_lignano.vbo",
    "kart_massafinalese_racechrono/raw_racechrono_massa.vbo",
)


def row(k: int, clock: str = "", sats: str = "012", lon: float = -784.38) -> str:
    """10 Hz, north at 36 km/h; the longitude is positive to the west."""
    clock = clock or f"1000{k // 10:02d}.{k % 10}00"
    return f"{sats} {clock} {2743.97 + 5.4e-4 * k:+013.6f} {lon:+013.6f} 036.000 000.000 +00004.000"


def vbo(rows: list[str], head: str = "", header: tuple[str, ...] = HEADER, columns: tuple[str, ...] = COLUMNS) -> str:
    parts = ["File created on 11/04/2026 at 10:00:00", "", "[header]", *header, "", head, "[column names]"]
    return "\r\n".join([*parts, " ".join(columns), "", "[data]", *rows, ""])


def read(directory: Path, text: str | bytes, name: str = "x.vbo") -> ForeignReading:
    path = directory / name
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_vbo(path)


def codes(reading: ForeignReading) -> dict[str, int]:
    return {problem.code: problem.count for problem in reading.problems}


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
def test_a_file_in_two_bytes_a_character_is_read(tmp_path: Path, encoding: str) -> None:
    lap = "[laptiming]\r\nStart -784.38 2743.97 -784.36 2743.97 \u00ac Ziel\r\n"
    text = vbo([row(k) for k in range(60)], head=lap)
    plain, wide = read(tmp_path, text), read(tmp_path, text.encode(encoding))
    assert codes(wide) == codes(plain) and len(wide.gnss) == 60
    np.testing.assert_array_equal(wide.gnss.lat_deg, plain.gnss.lat_deg)
    np.testing.assert_array_equal(wide.gnss.unix_s, plain.gnss.unix_s)
    (tmp_path / "y.vbo").write_bytes(text.encode())
    assert own_lines(tmp_path / "x.vbo") == own_lines(tmp_path / "y.vbo") != ()
    assert load_raw(tmp_path / "x.vbo").inputs == ("x.vbo",)


def crossings(gnss: GnssFixes, line: TimingLine) -> np.ndarray:
    """Times at which the straight path between fixes crosses a line, between its ends, in the usual direction."""
    scale = np.array([111_195.0, 111_195.0 * np.cos(np.radians(gnss.lat_deg[0]))])
    path = np.stack([gnss.lat_deg, gnss.lon_deg], axis=-1) * scale
    a, b = np.array(line.first_deg) * scale, np.array(line.second_deg) * scale
    along, across = b - a, path - a
    side = along[0] * across[:, 1] - along[1] * across[:, 0]
    u = side[:-1] / (side[:-1] - side[1:] + 1e-300)
    place = (across[:-1] + u[:, None] * np.diff(across, axis=0)) @ along / (along @ along)
    found = (side[:-1] * side[1:] < 0.0) & (place > 0.0) & (place < 1.0)
    rising = side[1:] > side[:-1]
    usual = np.mean(rising[found]) > 0.5
    i = np.flatnonzero(found & (rising == usual))
    return gnss.t[i] + u[i] * np.diff(gnss.t)[i]


def test_the_laps_of_a_real_recording_come_out_with_its_own_line(data_directory: Path) -> None:
    reading, ((_, start),) = read_vbo(data_directory / LIGNANO), own_lines(data_directory / LIGNANO)
    wanted = pl.read_csv(data_directory / Path(LIGNANO).parent / "laps_from_gps.csv")["lap_time_s"].to_numpy()
    assert start.kind == "start"
    found = np.diff(crossings(reading.gnss, start))
    np.testing.assert_allclose(found, wanted, atol=0.02)


@pytest.mark.parametrize("file", [LIGNANO, MASSA])
def test_a_real_recording_has_the_fixes_and_samples_of_its_tables(data_directory: Path, file: str) -> None:
    reading = read_vbo(data_directory / file)
    folder = data_directory / Path(file).parent
    fixes, imu = pl.read_csv(folder / "gps.csv"), pl.read_csv(folder / "imu.csv")
    gnss = reading.gnss
    assert fixes.height - len(gnss) <= 1  # RaceBox writes its first row before it counts satellites
    at = np.searchsorted(fixes["t_s"].to_numpy() + 5e-3, gnss.t)
    for name, column, tolerance in (
        ("lat_deg", gnss.lat_deg, 1e-8),
        ("lon_deg", gnss.lon_deg, 1e-8),
        ("alt_m", gnss.alt_m, 1e-6),
        ("speed_mps", gnss.speed, 1e-4),
        ("course_deg", gnss.course_deg, 1e-6),
    ):
        np.testing.assert_allclose(column, fixes[name].to_numpy()[at], atol=tolerance, err_msg=name)
    assert reading.imu is not None
    np.testing.assert_allclose(reading.imu.accel, imu.select("ax", "ay", "az").to_numpy(), atol=1e-3)
    np.testing.assert_allclose(reading.imu.gyro, imu.select("gx", "gy", "gz").to_numpy(), atol=1e-4)


def test_a_folder_with_nothing_but_a_real_recording_is_a_session(data_directory: Path, tmp_path: Path) -> None:
    (tmp_path / "raw.vbo").symlink_to(data_directory / LIGNANO)
    raw = load_raw(tmp_path)
    assert raw.inputs == ("raw.vbo",) and raw.imu is not None
    assert raw.unix_at_zero == pytest.approx(1_775_907_141.0, abs=0.01)  # 11/04/2026 11:32:21 UTC


def test_a_plain_file_is_read_in_degrees_east_and_metres_a_second(tmp_path: Path) -> None:
    reading = read(tmp_path, vbo([row(k) for k in range(50)]))
    gnss = reading.gnss
    np.testing.assert_allclose(gnss.t, 0.1 * np.arange(50), atol=1e-9)
    assert gnss.lat_deg[0] == pytest.approx(2743.97 / 60, abs=1e-9) and gnss.lon_deg[0] == pytest.approx(13.073)
    np.testing.assert_allclose(gnss.velocity_n[:, :2], [[10.0, 0.0]] * 50, atol=1e-12)
    assert gnss.num_sv[0] == 12 and reading.imu is None
    assert gnss.unix_s[0] == pytest.approx(1_775_901_600.0)
    assert codes(reading) == {"gps_date_assumed": 1}


def test_brake_and_dgps_bits_are_no_satellites_and_none_is_no_fix(tmp_path: Path) -> None:
    counts = ["010"] * 30 + ["074"] * 5 + ["138"] * 5 + ["202"] * 5 + ["000"] * 3 + ["064"] * 2
    reading = read(tmp_path, vbo([row(k, sats=count) for k, count in enumerate(counts)]))
    assert set(reading.gnss.num_sv) == {10} and len(reading.gnss) == 45
    assert codes(reading)["gps_no_fix"] == 5


def test_a_program_that_never_counts_satellites_has_fixes_all_the_same(tmp_path: Path) -> None:
    reading = read(tmp_path, vbo([row(k, sats="000") for k in range(30)]))
    assert len(reading.gnss) == 30 and set(reading.gnss.num_sv) == {-1}


def test_time_runs_on_over_midnight_and_the_date_is_that_of_the_first_row(tmp_path: Path) -> None:
    clocks = [f"2359{58 + k // 10}.{k % 10}00" if k < 20 else f"0000{k // 10 - 2:02d}.{k % 10}00" for k in range(60)]
    rows = [row(k, clock) for k, clock in enumerate(clocks)]
    for head in (
        "",
        "[comments]\r\nUTC Date Started : 11/04/2026 23:59",
        "[comments]\r\nUTC Date Started : 12/04/2026 00:00",
    ):
        gnss = read(tmp_path, vbo(rows, head)).gnss
        np.testing.assert_allclose(np.diff(gnss.t), 0.1, atol=1e-6)
        assert gnss.unix_s[0] == pytest.approx(1_775_951_998.0)


def test_times_that_are_none_are_refused_and_not_half_of_them_used(tmp_path: Path) -> None:
    rows = [row(k, f"{175_000 + 0.1 * k:010.3f}") for k in range(1200)]
    with pytest.raises(SessionError, match=r"^x.vbo: 32% of its times, as 175061, are no UTC \(HHMMSS.sss\)$"):
        read(tmp_path, vbo(rows))


@pytest.mark.parametrize("start", [41_541.0, 86_390.0])
def test_seconds_of_the_day_are_refused(tmp_path: Path, start: float) -> None:
    rows = [row(k, f"{(start + 0.1 * k) % 86400:09.3f}") for k in range(1200)]
    with pytest.raises(SessionError, match=r"^x.vbo: \d+% of its times, as \S+, are no UTC"):
        read(tmp_path, vbo(rows))


def test_of_columns_with_one_name_the_first_counts(tmp_path: Path) -> None:
    columns = (*COLUMNS, "velocity", "latacc", "latacc")
    reading = read(tmp_path, vbo([f"{row(k)} 099.000 +0.1 +0.2" for k in range(20)], columns=columns))
    np.testing.assert_allclose(reading.gnss.speed, 10.0)


@pytest.mark.parametrize(("unit", "speed"), [("kmh", 10.0), ("mph", 16.09344), ("knots", 18.52), ("m/s", 36.0)])
def test_the_unit_of_the_velocity_stands_in_the_header(tmp_path: Path, unit: str, speed: float) -> None:
    header = tuple(name.replace("velocity kmh", f"velocity {unit}") for name in HEADER)
    np.testing.assert_allclose(read(tmp_path, vbo([row(k) for k in range(20)], header=header)).gnss.speed, speed)


def oval(unit: float, east: float) -> str:
    """Fixes of a minute round an oval at 10 Hz, their positions in `unit` (60 minutes, or 1 degree)."""
    rows = []
    for k in range(600):
        angle = 0.02 * k
        lat, lon = 45.7 + 3e-4 * np.sin(angle), 13.07 + 3e-4 * np.cos(angle) / np.cos(np.radians(45.7))
        speed, course = 3e-4 * 111.195e3 * 0.2 * 3.6, -np.degrees(angle) % 360.0
        clock = f"1000{k // 10:02d}.{k % 10}00"
        rows.append(f"012 {clock} {lat * unit:.7f} {east * lon * unit:.7f} {speed:.3f} {course:.2f} 4.0")
    return vbo(rows)


@pytest.mark.parametrize(
    ("unit", "east", "said"),
    [
        (60.0, -1.0, None),
        (60.0, 1.0, "longitudes count to the east"),
        (1.0, 1.0, "positions are in degrees, not minutes, and longitudes count to the east"),
        (1.0, -1.0, "positions are in degrees, not minutes"),
    ],
)
def test_positions_are_taken_in_the_form_that_the_velocities_fit(
    tmp_path: Path, unit: float, east: float, said: str | None
) -> None:
    reading = read(tmp_path, oval(unit, east))
    assert reading.gnss.lat_deg[0] == pytest.approx(45.7, abs=1e-6)
    assert reading.gnss.lon_deg[0] == pytest.approx(13.07043, abs=1e-5)
    told = [problem.text for problem in reading.problems if problem.code == "gps_position_form"]
    assert told == ([] if said is None else [f"x.vbo: by its speeds and courses, {said}; read so"])


@pytest.mark.parametrize(
    ("label", "said"), [("velocity", "does not say in which unit"), ("velocity furlongs", "furlongs, is")]
)
def test_a_unit_of_speeds_that_has_to_be_assumed_is_reported(tmp_path: Path, label: str, said: str) -> None:
    header = tuple(name.replace("velocity kmh", label) for name in HEADER)
    reading = read(tmp_path, vbo([row(k) for k in range(20)], header=header))
    (problem,) = [problem for problem in reading.problems if problem.code == "gps_speed_unit_assumed"]
    assert said in problem.text and problem.text.endswith("taken as km/h")


def test_without_column_names_the_header_names_them(tmp_path: Path) -> None:
    text = vbo([row(k) for k in range(20)])
    text = re.sub(r"\[column names\]\r\n.*\r\n", "", text)
    np.testing.assert_allclose(read(tmp_path, text).gnss.speed, 10.0)


@pytest.mark.parametrize(
    ("line", "order"),
    [
        ("Start   -000784.380000 +02743.975000 -000784.390000 +02743.975000 ¬ Start / Finish", 0),
        ("Start   +02743.975000 -000784.380000 +02743.975000 -000784.390000 ¬   Start / Finish", 1),
    ],
)
def test_laptiming_is_read_with_longitude_first_and_with_latitude_first(tmp_path: Path, line: str, order: int) -> None:
    path = tmp_path / "x.vbo"
    path.write_bytes(vbo([row(k) for k in range(50)], f"[laptiming]\r\n{line}\r\n").encode())
    (orders,) = own_lines(path)
    found = orders[order]
    assert found.kind == "start" and found.name == "Start / Finish"
    assert found.first_deg == pytest.approx((45.7329166667, 13.073))
    assert found.second_deg == pytest.approx((45.7329166667, 13.0731666667))


def test_six_inertial_channels_make_an_imu_and_two_accelerations_do_not(tmp_path: Path) -> None:
    names = ("x_acc-acc", "y_acc-acc", "z_acc-acc", *(f"{axis}_rate_of_rotation-gyro" for axis in "xyz"))
    rows = [f"{row(k)} +0.100 +0.200 +1.000 +1.0 +2.0 -90.0" for k in range(20)]
    imu = read(tmp_path, vbo(rows, columns=(*COLUMNS, *names))).imu
    assert imu is not None
    np.testing.assert_allclose(imu.accel[0], np.array([0.1, 0.2, 1.0]) * 9.80665)
    np.testing.assert_allclose(imu.gyro[0], np.radians([1.0, 2.0, -90.0]))
    rows = [f"{row(k)} +0.100 +0.200" for k in range(20)]
    assert read(tmp_path, vbo(rows, columns=(*COLUMNS, "longacc", "latacc"))).imu is None


@pytest.mark.parametrize(
    ("names", "code", "said"),
    [
        ("PitchRate RollRate Z_Accel YawRate X_Accel Y_Accel", "imu_axes_unknown", "yawrate) are not used: their axes"),
        (
            "LongAcc VertAcc x-rotation-gyroscope y-rotation-gyroscope z-rotation-gyroscope lean-angle",
            "imu_incomplete",
            "of the six channels of a motion sensor ay is missing; the others are not used",
        ),
        ("x_acc y_acc z_acc a b c", "imu_incomplete", "gx, gy, gz are missing; the others are not used"),
        ("longacc latacc a b c d", "", ""),
    ],
)
def test_why_a_motion_sensor_that_is_there_is_not_used_is_reported(
    tmp_path: Path, names: str, code: str, said: str
) -> None:
    rows = [f"{row(k)} +0.1 +0.2 +1.0 +1.0 +2.0 -90.0" for k in range(40)]
    read(tmp_path, vbo(rows, columns=(*COLUMNS, *names.split())))
    told = {problem.code: problem.text for problem in load_raw(tmp_path).problems}
    if code:
        assert said in told[code] and told["imu_missing"] == "no IMU that can be used: smoothed from GPS alone"
    else:
        assert "imu_incomplete" not in told and told["imu_missing"] == "no IMU recorded: smoothed from GPS alone"


def test_rows_with_too_many_or_too_few_values_are_dropped_and_counted(tmp_path: Path) -> None:
    rows = [row(k) for k in range(60)]
    rows[10], rows[20], rows[30] = rows[10].rpartition(" ")[0], rows[20] + " 1.0", "garbage"
    rows[40] = rows[40].replace("+02743", "+0x743")
    reading = read(tmp_path, vbo(rows))
    assert len(reading.gnss) == 56
    assert codes(reading) == {"gps_row_damaged": 3, "gps_unread": 1, "gps_invalid": 1, "gps_date_assumed": 1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "the file is empty; expected VBO"),
        ("hello\nworld\n", "no rows; not, or not a whole, VBO"),
        (vbo([]), "a header line, but no rows"),
        (vbo([row(k) + " 7 8" for k in range(9)]), "rows have 9 values, but 7 columns are named"),
        (vbo([row(k) for k in range(9)], columns=("sats", "time", "lat")), "no column for lon"),
        (vbo([row(k, f"100000.{k // 40:03d}") for k in range(400)]), "rows repeat the time of another"),
        (vbo([row(k, "100000.000") for k in range(40)]), "rows repeat the time of another"),
        (vbo([row(0, f"{10 + k:02d}0000.000") for k in range(9)]), "a fix every 3.6e+03 s only"),
    ],
)
def test_an_unusable_file_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    assert_refused(read_vbo, tmp_path / "x.vbo", text, message, capsys)


@pytest.mark.parametrize("start", [vbo([]), vbo([row(k) for k in range(9)]), "File created on 11/04/2026", ""])
def test_an_endless_line_ends_the_reading_with_little_memory(tmp_path: Path, start: str) -> None:
    path = tmp_path / "x.vbo"
    with path.open("wb") as file:
        file.write(start.encode())
        file.seek(1 << 30)  # zeros as far as a gigabyte, without room on the disk
        file.write(b"\r\n")
    tracemalloc.start()
    with pytest.raises(SessionError, match=r"characters; this is no table|no rows; not, or|the file is empty"):
        read_vbo(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 40e6  # some blocks of 4 MB


@pytest.mark.parametrize("seed", range(30))
def test_random_damage_raises_nothing_but_a_session_error(tmp_path: Path, seed: int) -> None:
    text = vbo([row(k) for k in range(60)], "[laptiming]\r\nStart 1 2 3 4 ¬ x\r\n")
    assert_outlives_damage(read_vbo, tmp_path / "x.vbo", text, seed)
