"""Formats of other loggers, from small files made here: RaceCapture, phones, cameras, FIT, TCX, KML, archives."""

import datetime as dt
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import RawSession
from smoother.session.load import load_raw
from smoother.session.readers.child import KINDS, sheets_in
from smoother.session.readers.sets import beacon_times
from smoother.units import DEG, STANDARD_GRAVITY

START = 1_778_925_600.0  # 2026-05-16T10:00:00Z
COUNT, RATE, IMU_RATE = 300, 10, 50
RADIUS = 40.0
T = np.arange(COUNT) / RATE
ANGLE = 0.3 * T - 0.2 * np.cos(T)
LAT = 52.0 + RADIUS * np.sin(ANGLE) / 111_195
LON = -17.0 - RADIUS * np.cos(ANGLE) / 111_195 / np.cos(52.0 * DEG)
SPEED = RADIUS * (0.3 + 0.2 * np.sin(T))
COURSE = np.degrees(ANGLE) % 360.0
IMU_T = np.arange(COUNT * IMU_RATE // RATE) / IMU_RATE
RNG = np.random.default_rng(5)
ACCEL = RNG.normal([0.5, -1.0, 9.8], 0.3, (IMU_T.size, 3))
GYRO = RNG.normal([0.02, 0.01, -0.3], 0.1, (IMU_T.size, 3))


def assert_drive(raw: RawSession, *, has_imu: bool = False, atol: float = 1e-3) -> None:
    """The fixes are those of the drive, and the samples too."""
    assert len(raw.gnss) == COUNT
    np.testing.assert_allclose(raw.gnss.lat_deg, LAT, atol=2e-7)
    np.testing.assert_allclose(raw.gnss.lon_deg, LON, atol=2e-7)
    np.testing.assert_allclose(raw.gnss.speed, SPEED, atol=0.02)
    np.testing.assert_allclose(raw.gnss.t - raw.gnss.t[0], T, atol=atol)
    assert (raw.imu is not None) == has_imu
    if raw.imu is not None:
        assert raw.imu.t.size == pytest.approx(IMU_T.size, abs=2)
        offset = float(raw.imu.t[0] - raw.gnss.t[0])
        np.testing.assert_allclose(raw.imu.t - raw.imu.t[0], IMU_T[: raw.imu.t.size], atol=0.02)
        first = int(np.argmin(np.abs(IMU_T - max(offset, 0.0))))
        np.testing.assert_allclose(raw.imu.accel[:100], ACCEL[first : first + 100], atol=2e-3)
        np.testing.assert_allclose(raw.imu.gyro[:100], GYRO[first : first + 100], atol=2e-3)


def iso(t: float, digits: int = 3) -> str:
    moment = dt.datetime.fromtimestamp(START + round(t, 6) + 1e-7, dt.UTC)
    return moment.strftime("%Y-%m-%dT%H:%M:%S") + (f".{moment.microsecond // 1000:03d}" if digits else "") + "Z"


def racecapture(folder: Path, accel: Array = ACCEL, turns: Array = GYRO[:, ::-1] / DEG) -> None:
    """A log with accelerations (N, 3) in m/s^2 and rates (N, 3) of yaw, pitch and roll in deg/s."""
    head = ['"Interval"|"ms"|0|0|1', '"Utc"|"ms"|0|0|1']
    head += [f'"Accel{axis}"|"G"|-3.0|3.0|50' for axis in "XYZ"]
    head += [f'"{name}"|"Deg/Sec"|-120|120|50' for name in ("Yaw", "Pitch", "Roll")]
    head += ['"Latitude"|"Degrees"|-180.0|180.0|10', '"Longitude"|"Degrees"|-180.0|180.0|10', '"Speed"|"MPH"|0|150|10']
    lines = [",".join(head)]
    for k, t in enumerate(IMU_T):
        force = [f"{x / STANDARD_GRAVITY:.6f}" for x in accel[k]]
        turn = [f"{x:.4f}" for x in turns[k]]
        i, is_fix = divmod(k, IMU_RATE // RATE)
        place = ["", "", ""] if is_fix else [f"{LAT[i]:.8f}", f"{LON[i]:.8f}", f"{SPEED[i] / 0.44704:.4f}"]
        utc = "" if is_fix else f"{1000 * (START + t):.0f}"
        lines.append(",".join([f"{60_000 + 1000 * t:.0f}", utc, *force, *turn, *place]))
    (folder / "rc_0.log").write_text("\n".join(lines) + "\n")


def sensor_logger(folder: Path) -> None:
    """Sensor Logger writes z, y, x, and an accelerometer without gravity beside that with it."""
    for name, values in (("TotalAcceleration", ACCEL), ("Accelerometer", ACCEL - [0, 0, 9.8]), ("Gyroscope", GYRO)):
        rows = [
            f"{round(1e9 * (START + t))},{t:.6f},{z:.6f},{y:.6f},{x:.6f}"
            for t, (x, y, z) in zip(IMU_T, values, strict=True)
        ]
        (folder / f"{name}.csv").write_text("\n".join(["time,seconds_elapsed,z,y,x", *rows]) + "\n")
    rows = [
        f"{round(1e9 * (START + t))},{t:.6f},1.0,0.3,3,3.3,{v:.4f},{c:.2f},95,{lon:.8f},{lat:.8f}"
        for t, lat, lon, v, c in zip(T, LAT, LON, SPEED, COURSE, strict=True)
    ]
    head = "time,seconds_elapsed,bearingAccuracy,speedAccuracy,verticalAccuracy,horizontalAccuracy,speed,bearing,"
    (folder / "Location.csv").write_text("\n".join([head + "altitude,longitude,latitude", *rows]) + "\n")


def phyphox(folder: Path) -> None:
    """Semicolons and decimal commas, as in a German phone."""
    tables = {
        "Accelerometer": ("Acceleration", "m/s^2", ACCEL),
        "Gyroscope": ("Gyroscope", "rad/s", GYRO),
    }
    for file, (name, unit, values) in tables.items():
        head = ['"Time (s)"', *(f'"{name} {axis} ({unit})"' for axis in "xyz")]
        rows = [";".join(f"{v:.6E}".replace(".", ",") for v in (t, *row)) for t, row in zip(IMU_T, values, strict=True)]
        (folder / f"{file}.csv").write_text("\n".join([";".join(head), *rows]) + "\n")
    head = '"Time (s)";"Latitude (°)";"Longitude (°)";"Height (m)";"Velocity (m/s)";"Direction (°)"'
    rows = [
        ";".join(f"{v:.9E}".replace(".", ",") for v in row)
        for row in zip(T, LAT, LON, np.full(COUNT, 95.0), SPEED, COURSE, strict=True)
    ]
    (folder / "Location.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def gopro_tables(folder: Path) -> None:
    stem = "GX010001_HERO9 Black"
    for key, name, unit, values in (("ACCL", "Accelerometer", "m/s²", ACCEL), ("GYRO", "Gyroscope", "rad/s", GYRO)):
        rows = [f"{1000 * t:.3f},x,{z:.5f},{x:.5f},{y:.5f}" for t, (x, y, z) in zip(IMU_T, values, strict=True)]
        head = f"cts,date,{name} (z) [{unit}],{name} (x) [{unit}],{name} (y) [{unit}]"
        (folder / f"{stem}-{key}.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    head = "cts,date,GPS (Lat.) [deg],GPS (Long.) [deg],GPS (Alt.) [m],GPS (2D speed) [m/s],fix,precision"
    rows = [
        f"{1000 * t:.3f},{iso(t)},{lat:.8f},{lon:.8f},95.0,{v:.4f},3,150"
        for t, lat, lon, v in zip(T, LAT, LON, SPEED, strict=True)
    ]
    (folder / f"{stem}-GPS5.csv").write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")


def test_pitch_turns_about_the_axis_across_whichever_that_is(tmp_path: Path) -> None:
    """RaceCapture's x is across in its older firmware and along in its newer; roll and pitch are called the same."""
    yaw = 0.3 + 0.2 * np.sin(IMU_T)
    across, noise = RADIUS * yaw**2, RNG.normal(0.0, 0.3, (IMU_T.size, 3))
    for axis, order in ((0, [1, 2, 0]), (1, [2, 1, 0])):
        accel = noise + np.array([0.0, 0.0, 9.8])
        accel[:, axis] += across
        turn = np.column_stack([yaw, noise[:, :2]]) / DEG
        racecapture(tmp_path, accel, turn)
        imu = load_raw(tmp_path).imu
        assert imu is not None
        np.testing.assert_allclose(imu.gyro, turn[:, order] * DEG, atol=2e-5)


@pytest.mark.parametrize("write", [racecapture, sensor_logger, phyphox, gopro_tables])
@pytest.mark.parametrize("packed", [False, True])
def test_the_sensors_of_a_recording_are_read_together(
    tmp_path: Path, write: Callable[[Path], None], packed: bool
) -> None:
    folder = tmp_path / "session"
    folder.mkdir()
    write(folder)
    if packed:
        archive = tmp_path / "shared.zip"
        with zipfile.ZipFile(archive, "w") as out:
            for path in folder.iterdir():
                out.write(path, f"2026/{path.name}")
        raw = load_raw(archive)
        assert raw.inputs == ("shared.zip",)
        assert_drive(raw, has_imu=True)
        return
    assert_drive(load_raw(folder), has_imu=True)


def test_the_sensors_of_another_video_are_not_taken(tmp_path: Path) -> None:
    gopro_tables(tmp_path)
    for path in list(tmp_path.iterdir()):
        later = tmp_path / path.name.replace("GX010001", "GX010002")
        later.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    inputs = load_raw(tmp_path / "GX010002_HERO9 Black-GPS5.csv").inputs
    assert sorted(name.rpartition("-")[2] for name in inputs) == ["ACCL.csv", "GPS5.csv", "GYRO.csv"]
    assert all(name.startswith("GX010002") for name in inputs)


def test_a_line_without_end_of_a_sensor_is_a_damaged_row(tmp_path: Path) -> None:
    sensor_logger(tmp_path)
    lines = (tmp_path / "Gyroscope.csv").read_text().splitlines()
    lines[20] += "9" * 200_000
    (tmp_path / "Gyroscope.csv").write_text("\n".join(lines) + "\n")
    assert load_raw(tmp_path).imu is not None


def tcx(t: float, lat: float, lon: float, speed: float) -> str:
    place = f"<LatitudeDegrees>{lat:.8f}</LatitudeDegrees><LongitudeDegrees>{lon:.8f}</LongitudeDegrees>"
    return (
        f"<Trackpoint><Time>{iso(t)}</Time><Position>{place}</Position><AltitudeMeters>95</AltitudeMeters>"
        f"<HeartRateBpm><Value>150</Value></HeartRateBpm><Extensions><TPX><Speed>{speed:.4f}</Speed></TPX></Extensions>"
        "</Trackpoint>"
    )


def track(kind: str) -> str:
    rows = list(zip(T, LAT, LON, SPEED, strict=True))
    if kind == "tcx":
        points = "\n".join(tcx(*row) for row in rows)
        space = "http://www.garmin.com/xmlschemas/TrainingCenterDatabase/v2"
        return f'<TrainingCenterDatabase xmlns="{space}"><Track>{points}</Track></TrainingCenterDatabase>'
    if kind == "kml":
        whens = "\n".join(f"<when>{iso(t)}</when>" for t in T)
        places = "\n".join(f"<gx:coord>{lon:.8f} {lat:.8f} 95.0</gx:coord>" for _, lat, lon, _ in rows)
        speeds = "".join(f"<gx:value>{v:.4f}</gx:value>" for v in SPEED)
        more = f'<ExtendedData><gx:SimpleArrayData name="speed">{speeds}</gx:SimpleArrayData></ExtendedData>'
        spaces = 'xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"'
        return f"<kml {spaces}><Placemark><gx:Track>{whens}{places}{more}</gx:Track></Placemark></kml>"
    points = "\n".join(
        f'<trkpt lat="{lat:.8f}" lon="{lon:.8f}"><time>{iso(t, 0)}</time><speed>{v:.4f}</speed></trkpt>'
        for t, lat, lon, v in rows
    )
    return f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>"


@pytest.mark.parametrize("kind", ["tcx", "kml", "gpx"])
def test_tracks_in_xml(tmp_path: Path, kind: str) -> None:
    """The GPX file has whole seconds, ten points each."""
    (tmp_path / f"run.{kind}").write_text(track(kind))
    raw = load_raw(tmp_path)
    assert_drive(raw)
    assert ("gps_whole_seconds" in {problem.code for problem in raw.problems}) == (kind == "gpx")
    assert raw.gnss.unix_at_zero == pytest.approx(START, abs=1e-3)


@pytest.mark.parametrize(
    ("head", "row"),
    [
        ("time,latitude,N/S,longitude,E/W,speed (km/h)", "{clock}.{tenth},{lat:.7f},N,{west:.7f},W,{kmh:.2f}"),
        ("date,time,ms,lat,lon,speed_kmh", "2026-05-16,{clock},{tenth}00,{lat:.7f},{lon:.7f},{kmh:.2f}"),
        (
            "year,month,day,hour,minute,second,lat,lon,speed_kmh",
            "2026,5,16,10,{minute},{second:.1f},{lat:.7f},{lon:.7f},{kmh:.2f}",
        ),
        ("Date;Time;Lat;Lon;Speed", "16-MAI-26;{clock},{tenth};{lat:.7f}N;{west:.7f}W;{kmh:.2f} km/h"),
        ("INDEX,DATE,TIME,MS,VALID,LATITUDE,N/S,LONGITUDE,E/W,SPEED(km/h)",
         "1,2026/05/16,{clock},{tenth}00,SPS,{lat:.7f},N,{west:.7f},W,{kmh:.2f} km/h"),
        ('"Time (s)","Note","Latitude","Longitude","Speed (km/h)"',
         '"{t:.1f}","turn 3, ""left""\nslow","{lat:.7f}","{lon:.7f}","{kmh:.2f}"'),
        ("serial,lat,lon,speed (kph)".replace("serial", "time"), "{serial:.9f},{lat:.7f},{lon:.7f},{kmh:.2f}"),
    ],
)  # fmt: skip
def test_tables_as_people_write_them(tmp_path: Path, head: str, row: str) -> None:
    rows = []
    for t, lat, lon, v in zip(T, LAT, LON, SPEED, strict=True):
        second, tenth = divmod(round(10 * t), 10)
        clock = f"10:{second // 60:02d}:{second % 60:02d}"
        serial = 46158 + (36_000 + t) / 86_400
        rows.append(
            row.format(
                t=t, clock=clock, tenth=tenth, minute=second // 60, second=second % 60 + tenth / 10, serial=serial,
                lat=lat, lon=lon, west=-lon, kmh=3.6 * v,
            )
        )  # fmt: skip
    (tmp_path / "session.csv").write_text("\n".join([head, *rows]) + "\n")
    assert_drive(load_raw(tmp_path), atol=2e-3)


def test_raw_counts_are_taken_for_the_ranges_of_gravity_and_of_the_path(tmp_path: Path) -> None:
    yaw = np.interp(IMU_T, T, np.gradient(ANGLE, T))
    gyro = np.column_stack([GYRO[:, :2], -yaw])
    counts = np.round(np.column_stack([ACCEL / STANDARD_GRAVITY * 8192.0, gyro / DEG * 65.6]))
    rows = [f"{t:.3f},{','.join(f'{v:.0f}' for v in row)}" for t, row in zip(IMU_T, counts, strict=True)]
    (tmp_path / "imu.csv").write_text("\n".join(["t_s,ax,ay,az,gx,gy,gz", *rows]) + "\n")
    rows = [f"{t:.2f},{lat:.8f},{lon:.8f},{v:.3f}" for t, lat, lon, v in zip(T, LAT, LON, SPEED, strict=True)]
    (tmp_path / "gps.csv").write_text("\n".join(["t_s,lat_deg,lon_deg,speed_mps", *rows]) + "\n")
    raw = load_raw(tmp_path)
    assert raw.imu is not None
    (said,) = [problem.text for problem in raw.problems if problem.code == "imu_counts"]
    assert "at 4 g" in said and "500 deg/s" in said
    np.testing.assert_allclose(raw.imu.gyro[:, 2] * raw.imu.gyro_scale, -yaw, atol=2e-3)
    np.testing.assert_allclose(np.mean(raw.imu.accel, axis=0) * raw.imu.accel_scale, np.mean(ACCEL, axis=0), atol=0.01)


def box(kind: bytes, *parts: bytes) -> bytes:
    body = b"".join(parts)
    return struct.pack(">I", 8 + len(body)) + kind + body


def klv(key: str, kind: str, size: int, data: bytes) -> bytes:
    head = key.encode() + (b"\0" if kind == "\0" else kind.encode())
    if kind == "\0":
        head += struct.pack(">BH", 1, len(data))
    else:
        head += struct.pack(">BH", size, len(data) // size)
    return head + data + b"\0" * (-len(data) % 4)


def stream(key: str, kind: str, scale: list[int], rows: np.ndarray, *more: bytes) -> bytes:
    code = {"l": ">i4", "s": ">i2"}[kind]
    scaled = np.round(rows * scale).astype(code)
    scales = klv("SCAL", kind, scaled.itemsize, np.array(scale, code).tobytes())
    values = klv(key, kind, scaled.itemsize * rows.shape[1], scaled.tobytes())
    return klv("STRM", "\0", 1, b"".join(more) + scales + values)


def gopro_video(first: int, last: int) -> bytes:
    """An MP4 with nothing but a track of telemetry, a payload for each second from `first` to `last`."""
    payloads = []
    for second in range(first, last):
        fixes = slice(second * RATE, (second + 1) * RATE)
        samples = slice(second * IMU_RATE, (second + 1) * IMU_RATE)
        gps = np.column_stack([LAT, LON, np.full(COUNT, 95.0), SPEED, SPEED])[fixes]
        utc = dt.datetime.fromtimestamp(START + second, dt.UTC).strftime("%y%m%d%H%M%S.000").encode()
        block = (klv("GPSF", "L", 4, struct.pack(">I", 3)), klv("GPSU", "U", 16, utc))
        streams = stream("ACCL", "s", [1000] * 3, ACCEL[samples]) + stream("GYRO", "s", [1000] * 3, GYRO[samples])
        streams += stream("GPS5", "l", [10**7, 10**7, 1000, 1000, 100], gps, *block,
                          klv("GPSP", "S", 2, struct.pack(">H", 150)))  # fmt: skip
        payloads.append(klv("DEVC", "\0", 1, streams))
    count = len(payloads)
    data = b"".join(payloads)
    ftyp = box(b"ftyp", b"mp41", bytes(4), b"mp41")
    offsets = np.cumsum([len(ftyp) + 8, *(len(p) for p in payloads[:-1])])
    name = b"\x0eGoPro MET  \0\0\0"
    table = box(
        b"stbl",
        box(b"stsd", bytes(4), struct.pack(">I", 1), box(b"gpmd", bytes(8))),
        box(b"stts", bytes(4), struct.pack(">III", 1, count, 1000)),
        box(b"stsc", bytes(4), struct.pack(">IIII", 1, 1, 1, 1)),
        box(b"stsz", bytes(4), struct.pack(">II", 0, count), np.array([len(p) for p in payloads], ">u4").tobytes()),
        box(b"stco", bytes(4), struct.pack(">I", count), offsets.astype(">u4").tobytes()),
    )
    media = box(
        b"mdia",
        box(b"mdhd", bytes(4), struct.pack(">IIIII", 0, 0, 1000, 1000 * count, 0)),
        box(b"hdlr", bytes(8), b"meta", bytes(12), name),
        box(b"minf", box(b"gmhd", box(b"gmin", bytes(16))), table),
    )
    tkhd = box(b"tkhd", bytes(4), struct.pack(">IIIII", 0, 0, 1, 0, 1000 * count), bytes(60))
    mvhd = box(b"mvhd", bytes(4), struct.pack(">IIII", 0, 0, 1000, 1000 * count), bytes(80))
    return ftyp + box(b"mdat", data) + box(b"moov", mvhd, box(b"trak", tkhd, media))


def test_chapters_of_a_video_are_one_recording(tmp_path: Path) -> None:
    seconds = COUNT // RATE
    (tmp_path / "GX010042.MP4").write_bytes(gopro_video(0, seconds // 2))
    (tmp_path / "GX020042.MP4").write_bytes(gopro_video(seconds // 2, seconds))
    (tmp_path / "GX010043.MP4").write_bytes(gopro_video(0, 5))
    for named in (tmp_path / "GX010042.MP4", tmp_path / "GX020042.MP4", tmp_path):
        raw = load_raw(named)
        assert raw.inputs == ("GX010042.MP4", "GX020042.MP4")
        assert_drive(raw, has_imu=True)
        assert raw.gnss.hdop is not None and raw.gnss.hdop[0] == 1.5
        assert raw.gnss.unix_at_zero == pytest.approx(START, abs=0.06)


def fit_file() -> bytes:
    """Records of position in semicircles, enhanced speed and heart rate, ten in a second of whole seconds."""
    fields = ((253, 4, 0x86), (0, 4, 0x85), (1, 4, 0x85), (73, 4, 0x86), (3, 1, 0x02))
    data = bytes([0x40, 0, 0]) + struct.pack("<HB", 20, len(fields)) + b"".join(bytes(field) for field in fields)
    for t, lat, lon, speed in zip(T, LAT, LON, SPEED, strict=True):
        seconds = int(START - 631_065_600 + t + 1e-9)
        place = (round(angle * 2**31 / 180.0) for angle in (lat, lon))
        data += b"\0" + struct.pack("<IiiIB", seconds, *place, round(1000 * speed), 150)
    head = struct.pack("<BBHI4s", 14, 0x20, 2132, len(data), b".FIT")
    head += struct.pack("<H", crc(head))
    return head + data + struct.pack("<H", crc(head + data))


def crc(data: bytes) -> int:
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value


def test_a_fit_file(tmp_path: Path) -> None:
    (tmp_path / "ride.fit").write_bytes(fit_file())
    assert_drive(load_raw(tmp_path))


@pytest.mark.parametrize("kind", list(KINDS))
def test_without_the_extra_one_line_names_the_one_to_install(
    tmp_path: Path, kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        SessionError, match=rf"^x\.bin: .*; to read it: pip install 'kart-smoother\[{KINDS[kind].extra}\]'$"
    ):
        sheets_in(kind, [tmp_path / "x.bin"])


@pytest.mark.parametrize(("kind", "name"), [("xrk", "a.xrk"), ("fit", "a.fit"), ("gopro", "GX010001.MP4")])
@pytest.mark.parametrize("data", [b"", b"<hCNF\0 and nothing else", bytes(100_000)])
def test_what_a_library_cannot_read_is_one_line(tmp_path: Path, kind: str, name: str, data: bytes) -> None:
    (tmp_path / name).write_bytes(data)
    with pytest.raises(SessionError, match=rf"^{name}: [^\n]+$"):
        sheets_in(kind, [tmp_path / name])


def test_passages_of_the_beacon_in_an_aim_table_are_lap_times(tmp_path: Path) -> None:
    rows = [f'"{t:.1f}","{lat:.8f}","{lon:.8f}"' for t, lat, lon in zip(T, LAT, LON, strict=True)]
    head = ['"Format","AiM CSV File"', '"Duration","29.900"', '"Beacon Markers","5.250","15.500","26.000","29.900"']
    (tmp_path / "a.csv").write_text(
        "\n".join([*head, '"Time","GPS Latitude","GPS Longitude"', '"s","deg","deg"', *rows])
    )
    assert beacon_times("table", tmp_path / "a.csv") == pytest.approx((10.25, 10.5))
    assert beacon_times("vbo", tmp_path / "a.csv") == () and beacon_times("table", tmp_path / "none.csv") == ()
