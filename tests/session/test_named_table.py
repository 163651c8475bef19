"""Tables of programs without a reader of their own: RaceBox, TrackAddict, Harry's LapTimer, phones, self-made ones."""

import datetime as dt
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session.checks.imu import USABLE
from smoother.session.load import load_raw
from smoother.session.readers.foreign import ForeignReading
from smoother.session.readers.sets import read_tables as read_named_table
from smoother.units import DEG, STANDARD_GRAVITY

from .checked import checked
from .readers import assert_outlives_damage, assert_refused

START = 1_775_907_141.0  # 2026-04-11T11:32:21Z
RATE, COUNT, RADIUS = 10.0, 400, 40.0  # Hz, fixes, m
KMH, MPH, KNOTS = 3.6, 1.0 / 0.44704, 3600.0 / 1852.0


@dataclass(frozen=True)
class Fix:
    """Where a kart is on a circle that it drives round to the right, slower and faster, t s after the start."""

    t: float

    @property
    def angle(self) -> float:
        return 0.3 * self.t - 0.2 * np.cos(self.t)

    @property
    def speed(self) -> float:
        return RADIUS * (0.3 + 0.2 * np.sin(self.t))

    @property
    def course(self) -> float:
        return np.degrees(self.angle) % 360.0

    @property
    def lat(self) -> float:
        return 45.0 + RADIUS * np.sin(self.angle) / 111_195

    @property
    def lon(self) -> float:
        return -122.0 - RADIUS * np.cos(self.angle) / 111_195 / np.cos(np.pi / 4)

    @property
    def place(self) -> str:
        return f"{self.lat:.8f},{self.lon:.8f}"

    def moment(self, form: str) -> str:
        """UTC to the millisecond."""
        return dt.datetime.fromtimestamp(round(START + self.t, 3) + 1e-5, dt.UTC).strftime(form)[
            : -3 if "%f" in form else None
        ]


FIXES = [Fix(k / RATE) for k in range(COUNT)]
ISO, CLOCK = "%Y-%m-%dT%H:%M:%S.%f", "%H:%M:%S.%f"
PHONE = "time,seconds_elapsed,verticalAccuracy,horizontalAccuracy,speed,bearing,altitude,longitude,latitude"
RACEBOX = "Record,Time,Latitude,Longitude,Altitude,Speed,GForceX,GForceY,GForceZ,Lap,GyroX,GyroY,GyroZ"
RACEBOX_HEAD = ("Format,RaceBox CSV", "Track,Somewhere", "Lap 1, 36.6, sectors, 10.1,12.1,0,14.4", "")
TRACKADDICT = (
    '"Time","UTC Time","Lap","GPS_Update","Latitude","Longitude","Altitude (m)","Altitude (ft)","Speed (MPH)",'
    '"Heading","Accuracy (m)","Accel X","Accel Y","Accel Z"'
)
RACECHRONO_HEAD = (
    "This file is created using RaceChrono v7.4.2 ( http://racechrono.com/ ).",
    "",
    'Session title,"x"',
    "",
)
RACECHRONO = (
    "Time (s),Session fragment #,Lap #,Trap name,Speed (m/s),Altitude (m),Bearing (deg),Elapsed time (s),"
    "Latitude (deg),Longitude (deg),Satellites (sats),Fix type,Accuracy (m),Speed (m/s) *calc"
)
HARRY_OLD = (
    "LAPINDEX,DATE,TIME,LATITUDE[degrees],LONGITUDE[degrees],SPEED[km/h],HEIGHT[m],"
    "GPSFIX[NOFIX;2D;3D;UNKNOWN],SATELLITES,DIRECTION[degree],HOP,LATERALG,LATITUDEG[degree],LONGITUDEG[degree]"
)
HARRY = "INDEX,LAPINDEX,DATE,TIME,TIME_LAP,LATITUDE,LONGITUDE,SPEED_KPH,SPEED_MPH,HEIGHT_M,HEIGHT_FT,DIRECTION_DEG"
MOTEC_HEAD = ('"Format","MoTeC CSV File",,,"Workbook",""', '"Log Date","11/04/2026"', '"Sample Rate","10.000","Hz"', "")
MOTEC = (
    '"Time","GPS Latitude","GPS Longitude","GPS Altitude","GPS Speed","GPS Heading"\n"s","deg","deg","m","km/h","deg"\n'
)
GOPRO = '"cts","date","GPS (Lat.) [deg]","GPS (Long.) [deg]","GPS (Alt.) [m]","GPS (2D speed) [m/s]","fix","precision"'
TORQUE = "GPS Time, Device Time, Longitude, Latitude,GPS Speed (Meters/second), Altitude, Bearing, G(x), G(y)"
TRACCAR = "id,serverTime,deviceTime,fixTime,valid,latitude,longitude,altitude,speed,course,accuracy"
PHYPHOX = '"Time (s)";"Latitude (°)";"Longitude (°)";"Height (m)";"Velocity (m/s)";"Direction (°)"'

Row = Callable[[int, Fix], str]


def quoted(row: str) -> str:
    return ",".join(f'"{cell}"' for cell in row.split(","))


def german(row: str) -> str:
    return row.replace(",", ";").replace(".", ",")


LAYOUTS: dict[str, tuple[Sequence[str], Row]] = {  # lines before the rows, and the row of a fix
    "racebox": (
        (*RACEBOX_HEAD, RACEBOX),
        lambda k, f: f"{k},{f.moment(ISO)}Z,{f.place},7.5,{KMH * f.speed:.3f},0.01,-0.02,1.0,1,0.1,0.2,-9.0",
    ),
    "racebox mph": ((RACEBOX,), lambda k, f: f"{k},{f.moment(ISO)}Z,{f.place},7.5,{MPH * f.speed:.3f},0,0,1,1,0,0,0"),
    "racechrono 1": (
        (*RACECHRONO_HEAD, RACECHRONO),
        lambda k, f: f"{START + f.t:.3f},0,1,,{f.speed:.4f},7.5,{f.course:.2f},{f.t:.2f},{f.place},12,3,1.1,99.0",
    ),
    "racechrono 2": (
        (RACECHRONO_HEAD[0], "Format,2", *RACECHRONO_HEAD[1:], RACECHRONO.replace("Time (s)", "Timestamp (s)", 1)),
        lambda k, f: f"{START + f.t:.3f},0,1,,{f.speed:.4f},7.5,{f.course:.2f},{f.t:.2f},{f.place},12,3,1.1,99.0",
    ),
    "racerender": (
        ("# RaceRender Data", "Time,Latitude,Longitude,Altitude,MPH,Heading,X,Y,GPS_Update"),
        lambda k, f: f"{f.t:.3f},{f.place},7.5,{MPH * f.speed:.3f},{f.course:.2f},0,0,1",
    ),
    "harry old": (
        (HARRY_OLD,),
        lambda k, f: (
            f"1,{f.moment('%d-%b-%Y')},{f.moment(CLOCK)},{f.place},{KMH * f.speed:.3f},"
            f"7.5,2,10,{f.course:.2f},0.9,0.1,0,0"
        ),
    ),
    "harry": (
        (HARRY,),
        lambda k, f: (
            f"{k},1,{f.moment('%Y/%m/%d')},{f.moment(CLOCK)},{f.t % 7:.2f},{f.place},{KMH * f.speed:.3f},"
            f"{MPH * f.speed:.3f},7.5,24,{f.course:.2f}"
        ),
    ),
    "motec": (
        (*MOTEC_HEAD, *MOTEC.split("\n")),
        lambda k, f: quoted(f"{f.t:.3f},{f.place},7.5,{KMH * f.speed:.3f},{f.course:.2f}"),
    ),
    "race studio gps": (
        ("time,itow,lat,lon,alt,speed,accuracy",),
        lambda k, f: f"{f.t:.3f},{round(1000 * f.t) + 208_000_000},{f.place},7.5,{f.speed:.4f},1.2",
    ),
    "gopro": ((GOPRO,), lambda k, f: f"{1000 * f.t:.2f},{f.moment(ISO)}Z,{f.place},7.5,{f.speed:.4f},3,150"),
    "torque": (
        (TORQUE,),
        lambda k, f: (
            f"{f.moment('%a %b %d %H:%M:%S GMT+00:00 %Y')},{f.moment('%d-%b-%Y %H:%M:%S.%f')},{f.lon:.8f},{f.lat:.8f},"
            f"{f.speed:.4f},7.5,{f.course:.2f},0.1,0.2"
        ),
    ),
    "traccar": (
        (TRACCAR,),
        lambda k, f: (
            f"{k},{f.moment('%Y-%m-%dT%H:%M:%S')}.000+00:00,,{f.moment(ISO)}+00:00,true,{f.place},7.5,"
            f"{KNOTS * f.speed:.4f},{f.course:.2f},3.0"
        ),
    ),
    "sensor logger": (
        (PHONE,),
        lambda k, f: (
            f"{round(1000 * (START + f.t))}000000,{f.t + 3:.6f},4,3,{f.speed:.4f},{f.course:.2f},7.5,"
            f"{f.lon:.8f},{f.lat:.8f}"
        ),
    ),
    "gpslogger": (
        ("time,lat,lon,elevation,accuracy,bearing,speed,satellites,provider,hdop",),
        lambda k, f: f"{f.moment(ISO)}Z,{f.place},7.5,4,{f.course:.2f},{f.speed:.4f},11,gps,0.9",
    ),
    "phyphox": ((PHYPHOX,), lambda k, f: german(f"{f.t:.3f},{f.place},7.5,{f.speed:.4f},{f.course:.2f}")),
    "german": (
        ("Zeit;Breite;Länge;Höhe (m);Geschwindigkeit (km/h);Kurs",),
        lambda k, f: german(f"{f.t:.3f},{f.place},7.5,{KMH * f.speed:.3f},{f.course:.2f}"),
    ),
    "matlab": (
        ("Timestamp,latitude,longitude,altitude,speed,course,hacc",),
        lambda k, f: f"{f.moment('%d-%b-%Y %H:%M:%S.%f')},{f.place},7.5,{f.speed:.4f},{f.course:.2f},3.0",
    ),
    "arduino": (
        ("millis,lat,lng,alt_m,speed_kmph,course_deg,sats,",),
        lambda k, f: f"{4000 + round(1000 * f.t)},{f.place},7.5,{KMH * f.speed:.3f},{f.course:.2f},9,",
    ),
    "digits of a clock": (
        ("time;lat;lon;alt;speed;course",),
        lambda k, f: f"{f.moment('%H%M%S.%f')},{f.place},7.5,{f.speed:.4f},{f.course:.2f}".replace(",", ";"),
    ),
    "afternoon": (
        ("Date,Time,Lat,Long,Alt(m),Speed(mph),Heading",),
        lambda k, f: (
            f"{f.moment('%Y-%m-%d')},{f.moment('%I:%M:%S.%f')} AM,{f.place},7.5,{MPH * f.speed:.3f},{f.course:.2f}"
        ),
    ),
}
WITHOUT_COURSE = ("racebox", "racebox mph", "race studio gps", "gopro")
WITHOUT_DATE = ("racerender", "motec", "race studio gps", "phyphox", "german", "arduino", "digits of a clock")


def text_of(name: str, fixes: Sequence[Fix] = FIXES) -> str:
    head, row = LAYOUTS[name]
    return "\n".join([*head, *(row(k, fix) for k, fix in enumerate(fixes))]) + "\n"


def read(directory: Path, text: str) -> ForeignReading:
    path = directory / "session.csv"
    path.write_text(text, encoding="utf-8")
    return read_named_table(path)


@pytest.mark.parametrize("name", LAYOUTS)
def test_times_places_and_velocities_are_read_by_their_names(tmp_path: Path, name: str) -> None:
    text = text_of(name)
    reading = read(tmp_path, text)
    gnss = reading.gnss
    assert load_raw(tmp_path).inputs == ("session.csv",) and len(gnss) == COUNT
    np.testing.assert_allclose(gnss.t, [fix.t for fix in FIXES], atol=1e-3)
    np.testing.assert_allclose(gnss.lat_deg, [fix.lat for fix in FIXES], atol=1e-8)
    np.testing.assert_allclose(gnss.lon_deg, [fix.lon for fix in FIXES], atol=1e-8)
    np.testing.assert_allclose(gnss.speed, [fix.speed for fix in FIXES], atol=0.002)
    np.testing.assert_allclose(gnss.alt_m, 7.5)
    if name in WITHOUT_COURSE:
        assert np.isnan(gnss.velocity_n).all()  # the speed is a measurement of its own
    else:
        off = (gnss.course_deg - [fix.course for fix in FIXES] + 180.0) % 360.0 - 180.0
        assert np.nanmax(np.abs(off[10:-10])) < 0.02
        assert np.isfinite(gnss.velocity_n[10:-10, :2]).all()
    if name in WITHOUT_DATE:
        assert np.isnan(gnss.unix_s).all()
    else:
        np.testing.assert_allclose(gnss.unix_s, START + gnss.t, atol=1e-3)
    codes = {problem.code for problem in reading.problems}
    assert codes <= {
        "gps_speed_unit_assumed",
        "gps_speed_unit",
        "gps_no_course",
        "gps_date_assumed",
        "gps_time_unit",
    }


@pytest.mark.parametrize("name", ["racebox", "harry old"])
def test_lines_may_end_as_old_macs_ended_them(tmp_path: Path, name: str) -> None:
    text = text_of(name)
    as_written = read(tmp_path, text).gnss
    np.testing.assert_array_equal(read(tmp_path, text.replace("\r\n", "\n").replace("\n", "\r")).gnss.t, as_written.t)


def test_rows_without_a_new_fix_are_none(tmp_path: Path) -> None:
    """TrackAddict writes rows 20 times a second, with the last fix, and marks those in which a new one came."""
    rows = []
    for fix in FIXES[::10]:
        for k in range(20):
            now, last = Fix(fix.t + 0.05 * k), fix
            values = f"7.5,24,{MPH * last.speed:.2f},{last.course:.2f},3.0,0.1,-0.2,0.0"
            rows.append(f"{now.t:.3f},{START + now.t:.3f},0,{int(k == 0)},{last.place},{values}")
    head = ("# RaceRender Data: TrackAddict 4.3.5 on Android 9 (Mode: 0)", "# End Point: 51.9, 13.6  @ -1.00 deg")
    rows.insert(300, "# Lap 0: 00:00:15.20")
    gnss = (reading := read(tmp_path, "\n".join([*head, TRACKADDICT, *rows, "# Session End", ""]))).gnss
    np.testing.assert_allclose(gnss.t, np.arange(40.0), atol=1e-6)
    np.testing.assert_allclose(gnss.speed, [fix.speed for fix in FIXES[::10]], atol=0.01)
    assert reading.imu is None and [problem.code for problem in reading.problems] == ["imu_incomplete"]


@pytest.mark.parametrize(
    ("names", "g", "deg"),
    [
        ("GForceX,GForceY,GForceZ,GyroX,GyroY,GyroZ", 1.0, 1.0),
        ("GForceX (g),GForceY (g),GForceZ (g),GyroX (deg/s),GyroY (deg/s),GyroZ (deg/s)", 1.0, 1.0),
        ("X acceleration (G) *acc,Y acceleration (G) *acc,Z acceleration (G) *acc,X rate of rotation (deg/s) *gyro,"
         "Y rate of rotation (deg/s) *gyro,Z rate of rotation (deg/s) *gyro", 1.0, 1.0),
        ("ax,ay,az,gx,gy,gz", STANDARD_GRAVITY, DEG),
        ("AccX_g,AccY_g,AccZ_g,GyroX_dps,GyroY_dps,GyroZ_dps", 1.0, 1.0),
        ("accel_x,accel_y,accel_z,gyro_x,gyro_y,gyro_z", 1.0, 1.0),
    ],
)  # fmt: skip
def test_six_axes_in_the_same_rows_are_a_motion_sensor(tmp_path: Path, names: str, g: float, deg: float) -> None:
    """At 50 Hz, with each fix in five rows; where nothing says the unit, what stays of accelerations does."""
    rng = np.random.default_rng(3)
    accel = rng.normal([0.1, -0.2, 1.0], 0.05, (5 * COUNT, 3))
    gyro = rng.normal([1.0, 2.0, -40.0], 5.0, (5 * COUNT, 3))
    rows = []
    for k in range(5 * COUNT):
        fix = FIXES[k // 5]
        motion = ",".join(f"{value:.6f}" for value in (*(g * accel[k]), *(deg * gyro[k])))
        rows.append(f"{20 * k},{fix.place},{KMH * fix.speed:.3f},{fix.course:.2f},{motion}")
    reading = read(tmp_path, "\n".join([f"millis,lat,lng,Speed (km/h),course,{names}", *rows, ""]))
    assert reading.imu is not None and len(reading.imu.t) == 5 * COUNT and len(reading.gnss) == COUNT
    np.testing.assert_allclose(reading.imu.t, 0.02 * np.arange(5 * COUNT), atol=1e-6)
    imu = checked(USABLE, reading.gnss, reading.imu)[0].samples
    np.testing.assert_allclose(imu.accel * imu.accel_scale, STANDARD_GRAVITY * accel, atol=1e-3)
    np.testing.assert_allclose(imu.gyro * imu.gyro_scale, DEG * gyro, atol=1e-5)
    np.testing.assert_allclose(reading.gnss.t, 0.1 * np.arange(COUNT), atol=1e-6)


def racechrono_rows(fixes: Sequence[Fix]) -> str:
    """A row 100 times a second: positions are interpolated between fixes, the bearing is that of the fix before."""
    rows = []
    for before, after in itertools.pairwise(fixes):
        steps = round(100 * (after.t - before.t))
        for k in range(steps):
            t = before.t + k / 100
            ends = zip((before.lat, before.lon, before.speed), (after.lat, after.lon, after.speed), strict=True)
            lat, lon, speed = (a + k / steps * (b - a) for a, b in ends)
            values = f"{speed:.4f},7.5,{before.course:.2f},{t:.2f},{lat:.8f},{lon:.8f},12,3,1.1,99.0"
            rows.append(f"{START + t:.3f},0,1,,{values}")
    return "\n".join([*RACECHRONO_HEAD, RACECHRONO, *rows, ""])


def test_racechrono_rows_of_other_sensors_are_no_fixes(tmp_path: Path) -> None:
    reading = read(tmp_path, racechrono_rows(FIXES))
    np.testing.assert_allclose(reading.gnss.t, 0.1 * np.arange(COUNT - 1), atol=1e-3)
    assert [problem.code for problem in reading.problems] == ["gps_interpolated"]


def test_a_line_drawn_over_an_outage_is_no_fixes(tmp_path: Path) -> None:
    """Neither the places nor that they were measured: a motion sensor would have to follow them."""
    gnss = (reading := read(tmp_path, racechrono_rows([*FIXES[:150], *FIXES[185:]]))).gnss
    gap = int(np.argmax(np.diff(gnss.t)))
    assert gnss.t[gap] == pytest.approx(14.9, abs=0.11) and gnss.t[gap + 1] == pytest.approx(18.5, abs=0.11)
    assert len(gnss) == pytest.approx(COUNT - 36, abs=2)
    assert [problem.code for problem in reading.problems] == ["gps_interpolated", "gps_drawn"]


def test_midnight_and_zones(tmp_path: Path) -> None:
    """Times of day run on over midnight; a zone is taken off."""
    late = 86_395.0 - 41_541.0  # s after the start
    rows = [
        f"{dt.datetime.fromtimestamp(START + late + fix.t, dt.UTC).strftime(CLOCK)[:-5]},{fix.place},{fix.speed:.3f}"
        for fix in FIXES
    ]
    gnss = read(tmp_path, "\n".join(["time,lat,lon,speed", *rows, ""])).gnss
    np.testing.assert_allclose(gnss.t, [fix.t for fix in FIXES], atol=1e-6)
    zoned = text_of("gpslogger").replace("T11:", "T13:").replace("Z,", "+02:00,")
    reading = read(tmp_path, zoned)
    np.testing.assert_allclose(reading.gnss.unix_s, START + reading.gnss.t, atol=1e-3)
    assert "gps_date_assumed" not in {problem.code for problem in reading.problems}


def test_an_unknown_zone_is_reported(tmp_path: Path) -> None:
    (said,) = [p.text for p in read(tmp_path, text_of("afternoon")).problems if p.code == "gps_date_assumed"]
    assert said == "session.csv: its times of day have no zone; taken as UTC"


def test_a_table_called_gps_csv_is_read_by_its_names_where_no_samples_lie_beside_it(tmp_path: Path) -> None:
    (tmp_path / "gps.csv").write_text(text_of("gpslogger"))
    assert len(load_raw(tmp_path).gnss) == len(load_raw(tmp_path / "gps.csv").gnss) == COUNT
    (tmp_path / "imu.csv").write_text("t_s,ax,ay,az,gx,gy,gz\n0,0,0,9.8,0,0,0\n")
    with pytest.raises(SessionError, match=r"gps.csv: no column t_s; has time, lat, lon"):
        load_raw(tmp_path)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
@pytest.mark.parametrize("name", ["racebox", "phyphox"])
def test_marks_and_two_bytes_a_character(tmp_path: Path, name: str, encoding: str) -> None:
    (tmp_path / "x.csv").write_text(text_of(name).replace("\n", "\r\n"), encoding=encoding)
    assert len(load_raw(tmp_path).gnss) == COUNT


def test_german_names_that_lost_their_letters(tmp_path: Path) -> None:
    """As Excel saves them, in one byte a character."""
    (tmp_path / "x.csv").write_text(text_of("german"), encoding="cp1252")
    assert len(load_raw(tmp_path).gnss) == COUNT
    np.testing.assert_allclose(read_named_table(tmp_path / "x.csv").gnss.alt_m, 7.5)


def test_a_table_in_a_text_file_is_read_too(tmp_path: Path) -> None:
    (tmp_path / "DATALOG.TXT").write_text(text_of("arduino"))
    assert len(load_raw(tmp_path).gnss) == len(load_raw(tmp_path / "DATALOG.TXT").gnss) == COUNT


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Time,Latitude,Longitude\nnow,45.0,12.0\nthen,45.1,12.0\n", "its times, as now, are not understood"),
        ("Time,Latitude,Longitude\n", "a header line, but no rows; was the recording started?"),
        ("Time,Latitude,Longitude\n1,45.0,12.0,7,7\n", "rows have 5 values, but 3 columns are named; mend the line"),
        ("Time,Latitude,Longitude\n1,north,east\n", "no known kind of recording"),
        ("Lap,Latitude,Longitude\n1,45.0,12.0\n", "no known kind of recording"),
    ],
)
def test_what_cannot_be_used_is_one_clear_line(
    tmp_path: Path, text: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    if "no known kind" not in message:
        assert_refused(read_named_table, tmp_path / "x.csv", text, message, capsys)
        return
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(SessionError, match=message):
        load_raw(tmp_path / "x.csv")


@pytest.mark.parametrize("name", ["trajectory.csv", "session.csv"])
def test_results_are_no_recording(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text("utc,time,lat_deg,lon_deg,latitude,longitude\n1,1,45,12,45,12\n")
    with pytest.raises(SessionError, match="no recording found"):
        load_raw(tmp_path)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("name", ["racebox", "harry", "phyphox", "torque"])
def test_damage_leaves_the_rest(tmp_path: Path, name: str, seed: int) -> None:
    assert_outlives_damage(read_named_table, tmp_path / "x.csv", text_of(name), seed)


@pytest.mark.parametrize("written", [b"\xff", b"\0"])
@pytest.mark.parametrize("sectors", [1, 8])
def test_rows_that_are_lost_right_below_the_names_leave_the_rest(tmp_path: Path, written: bytes, sectors: int) -> None:
    rows = "".join(f"{i},{f.moment(ISO)}Z,{f.lat:.7f},{f.lon:.7f},{f.speed:.2f}\n" for i, f in enumerate(FIXES))
    names = b"Record,Time,Latitude,Longitude,Speed (m/s)\n"
    data, lost = names + rows.encode(), 512 * sectors
    (tmp_path / "RaceBox.csv").write_bytes(names + written * lost + data[len(names) + lost :])
    raw = load_raw(tmp_path)
    assert len(raw.gnss.t) > COUNT - lost // 40
    assert {"gps_row_damaged"} <= {problem.code for problem in raw.problems}


def test_a_unit_in_every_cell_is_the_unit_of_the_column(tmp_path: Path) -> None:
    rows = [f"{fix.t:.1f},{fix.place},{KMH * fix.speed:.3f} km/h" for fix in FIXES]
    reading = read(tmp_path, "\n".join(["time,lat,lon,speed", *rows]) + "\n")
    np.testing.assert_allclose(reading.gnss.speed, [fix.speed for fix in FIXES], atol=0.002)
    assert {problem.code for problem in reading.problems} <= {"gps_no_course"}
