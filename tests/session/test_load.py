"""A directory, or a file of it, to a RawSession: what is chosen, what is said, what ends in one clear line."""

import functools
import gzip
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from smoother.errors import ConfigError, SessionError, SmootherError
from smoother.estimate.check import check
from smoother.frames import Origin
from smoother.samples import RawSession
from smoother.session.clock import regularize
from smoother.session.csv_form import read_imu
from smoother.session.files import WANTED, Role
from smoother.session.load import load_raw
from smoother.session.thesis import END_STRUCT, GPS_FLAG, IMU_STRUCT, MAG_STRUCT, RECORD_START
from smoother.session.truth import load_truth
from smoother.words import repeated

DATA = Path(__file__).parents[1] / "data"


def imu_csv(count: int = 1000, rate: float = 100.0, start: float = 0.0) -> str:
    rows = [
        f"{start + k / rate:.4f},0.1{k % 2},{0.01 * (k % 9):.2f},9.8{k % 3},"
        f"0.001{k % 2},0.002{k % 7},{0.003 * (k % 5):.3f}"
        for k in range(count)
    ]
    return "\n".join(["t_s,ax,ay,az,gx,gy,gz", *rows]) + "\n"


def gps_csv(count: int = 50, rate: float = 5.0, start: float = 0.0) -> str:
    speeds = [111_195 * rate * (1e-4 + 2e-8 * k) for k in range(count)]
    rows = [
        f"{start + k / rate:.2f},{45 + 1e-4 * k + 1e-8 * k * k:.9f},12.0,8.0,{speed:.2f},0.0"
        for k, speed in enumerate(speeds)
    ]
    return "\n".join(["t_s,lat_deg,lon_deg,alt_m,speed_mps,course_deg", *rows]) + "\n"


def nmea_epochs(count: int) -> list[str]:
    """RMC sentences at 5 Hz, moving north."""
    bursts = []
    for k in range(count):
        body = f"GPRMC,1000{k / 5:05.2f},A,45{2 + 0.001 * k:07.4f},N,01208.9400,E,18.0,0.0,310524,,,A"
        bursts.append(f"${body}*{functools.reduce(operator.xor, body.encode()):02X}\r\n")
    return bursts


def out_txt(count: int) -> bytes:
    """Records at 50 Hz, every tenth with the magnetometer and a sentence."""
    records = b""
    for k, sentence in enumerate(np.repeat(nmea_epochs(-(-count // 10)), 10)[:count].tolist()):
        gps = bytes([GPS_FLAG]) + MAG_STRUCT.pack(1, 2, 3) + sentence.encode().ljust(90, b"\0")
        records += RECORD_START + IMU_STRUCT.pack(20 * k, 5, 6, 8192, k % 7, 8, 9)
        records += (b"" if k % 10 else gps) + END_STRUCT.pack(20 * k + 3)
    return records


@dataclass
class Folder:
    """A session directory to be filled."""

    path: Path

    def write(self, **files: str | bytes) -> "Folder":
        for name, content in files.items():
            target = self.path / name.replace("__", ".")
            target.write_bytes(content.encode() if isinstance(content, str) else content)
        return self

    def load(self, file: str = "") -> RawSession:
        return load_raw(self.path / file if file else self.path)


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    directory = tmp_path / "heat2"
    directory.mkdir()
    return Folder(directory)


def codes(session: RawSession) -> dict[str, int]:
    return {problem.code: problem.count for problem in session.problems}


def test_columns_make_a_session_without_a_word(folder: Folder) -> None:
    session = folder.write(imu__csv=imu_csv(), gps__csv=gps_csv(), mag__csv="t_s,mx,my,mz\n0,1,2,3\n1,1,2,4\n").load()
    assert session.name == "heat2" and session.problems == ()
    assert session.inputs == ("imu.csv", "gps.csv", "mag.csv")
    assert session.imu is not None and session.mag is not None
    assert (session.imu.t.size, len(session.gnss), session.mag.t.size) == (1000, 50, 2)
    assert session.unix_at_zero is None


def test_samples_tell_from_which_step_on_some_were_lost(folder: Folder) -> None:
    session = folder.write(imu__csv=imu_csv(), gps__csv=gps_csv()).load()
    assert session.imu is not None and session.imu.longest_step == pytest.approx(0.015)


@pytest.mark.parametrize("file", ["imu.csv", "gps.csv", "session.toml"])
def test_a_file_of_a_session_stands_for_the_session(folder: Folder, file: str) -> None:
    folder.write(imu__csv=imu_csv(), gps__csv=gps_csv(), session__toml="")
    session = folder.load(file)
    assert session.name == "heat2" and session.inputs == ("imu.csv", "gps.csv", "session.toml")


@pytest.mark.parametrize("file", ["truth.csv", "truth.csv.gz"])
def test_the_truth_is_not_smoothed_as_if_it_were_fixes(folder: Folder, file: str) -> None:
    content = gps_csv().encode()
    folder.write(gps__csv=gps_csv(), **{file: gzip.compress(content) if file.endswith("gz") else content})
    with pytest.raises(SessionError, match=r"the truth is no recording; name its folder: smooth evaluate "):
        folder.load(file)


def test_names_may_be_in_capitals_as_cards_write_them(folder: Folder) -> None:
    assert folder.write(IMU__CSV=imu_csv(), GPS__CSV=gps_csv()).load().inputs == ("IMU.CSV", "GPS.CSV")


def test_settings_are_applied_and_listed(folder: Folder) -> None:
    folder.write(gps__csv=gps_csv(), session__toml="[session]\ntitle = 'Heat'\n")
    session = folder.load()
    assert session.config.title == "Heat" and "session.toml" in session.inputs
    folder.write(session__toml="[session]\ntitel = 'Heat'\n")
    with pytest.raises(ConfigError, match="did you mean title"):
        folder.load()


def test_gps_csv_wins_over_sentences_and_says_so(folder: Folder) -> None:
    session = folder.write(gps__csv=gps_csv(), rover__nmea="".join(nmea_epochs(50))).load()
    assert session.inputs == ("gps.csv",) and "gps_csv_preferred" in codes(session)


def test_sentences_that_are_named_win_over_gps_csv(folder: Folder) -> None:
    folder.write(gps__csv=gps_csv(), rover__nmea="".join(nmea_epochs(50)))
    session = folder.load("rover.nmea")
    assert session.inputs == ("rover.nmea",) and session.name == "rover"
    assert session.unix_at_zero == pytest.approx(1717149600.0)


def test_of_several_logs_the_largest_is_used_and_the_others_are_named(folder: Folder) -> None:
    session = folder.write(a__nmea="".join(nmea_epochs(20)), b__nmea="".join(nmea_epochs(40))).load()
    assert session.inputs == ("b.nmea",) and codes(session)["gps_other_logs"] == 1


def test_every_kind_that_is_read_is_named_where_none_is_found(folder: Folder) -> None:
    assert list(WANTED) == list(get_args(Role))
    folder.write(notes__md="nothing")
    for file in ("", "notes.md"):
        with pytest.raises(SessionError, match=r"\*\.klg, out\.txt, gps\.csv, .*\*\.vbo, .* or \*\.gpx$"):
            folder.load(file)


@pytest.mark.parametrize("name", ["day.zip", "day.tar.gz", "DAY.7Z"])
def test_what_is_packed_is_to_be_unpacked_first(folder: Folder, name: str) -> None:
    folder.write(**{name: b"PK\3\4 and the rest"})
    for file in ("", name):
        with pytest.raises(SessionError, match=f"{re.escape(name)}.* packed; unpack it first"):
            folder.load(file)


def test_commands_that_are_suggested_can_be_pasted(tmp_path: Path) -> None:
    place = tmp_path / "Büro Ordner"
    (place / "run 1").mkdir(parents=True)
    for table in ("gps.csv", "truth.csv"):
        (place / "run 1" / table).write_text(gps_csv())
    with pytest.raises(SessionError, match=rf": smooth batch '{re.escape(str(place))}'$"):
        load_raw(place)
    with pytest.raises(SessionError, match=rf": smooth evaluate '{re.escape(str(place / 'run 1'))}'$"):
        load_raw(place / "run 1" / "truth.csv")


def test_a_folder_of_session_folders_is_for_batch(folder: Folder) -> None:
    for place in (".hidden", "kart7/run3/smoothed", "kart7/run3", "smoothed"):
        (folder.path / place).mkdir(parents=True, exist_ok=True)
    for place in (".hidden", "smoothed", "kart7/run3/smoothed"):
        (folder.path / place / "gps.csv").write_text(gps_csv())
    for place in ("smoothed", "kart7/run3/smoothed"):
        (folder.path / place / "trajectory.csv").touch()
        (folder.path / place / "summary.json").touch()
    with pytest.raises(SessionError, match="no recording found; wanted"):  # results and hidden ones are none
        folder.load()
    (folder.path / "kart7" / "run3" / "gps.csv").write_text(gps_csv())
    with pytest.raises(SessionError, match=r"but in folders of it \(kart7/run3\); .*: smooth batch .*heat2$"):
        folder.load()


GPX_POINTS = "".join(
    f'<trkpt lat="{45 + 1e-4 * k:.6f}" lon="12.0"><time>2024-05-01T10:00:{k:02d}Z</time></trkpt>' for k in range(50)
)
GPX = f"<gpx><trk><trkseg>{GPX_POINTS}</trkseg></trk></gpx>"
VBO = "[column names]\ntime lat long\n[data]\n"


@pytest.mark.parametrize(
    ("used", "content"),
    [("gps.csv", gps_csv()), ("rover.nmea", "".join(nmea_epochs(50))), ("out.txt", out_txt(500))],
)
def test_recordings_of_another_kind_that_are_left_out_are_named(
    folder: Folder, used: str, content: str | bytes
) -> None:
    folder.write(**{used.replace(".", "__"): content, "heat__vbo": VBO, "heat__gpx": GPX, "other__csv": "a,b\n1,2\n"})
    (problem,) = [p for p in folder.load().problems if p.code == "recordings_unused"]
    assert problem.text == f"{used} is used, not 2 others: heat.vbo, heat.gpx; name a file to have that one"
    assert "recordings_unused" not in codes(folder.load("heat.gpx"))


def test_sentences_beside_a_log_of_the_logger_are_named(folder: Folder) -> None:
    folder.write(heat__KLG=(DATA / "golden.klg").read_bytes(), rover__nmea="".join(nmea_epochs(50)))
    assert "heat.KLG is used, not rover.nmea; name a file to have that one" in [p.text for p in folder.load().problems]


@pytest.mark.parametrize(
    ("columns", "named"),
    [
        ((5,), "y of the gyroscope"),
        ((3,), "z of the accelerometer"),
        ((4, 5, 6), "x of the gyroscope, y of the gyroscope, z of the gyroscope"),
    ],
)
def test_axes_that_never_change_while_others_do_are_named(folder: Folder, columns: tuple[int, ...], named: str) -> None:
    rows = [line.split(",") for line in imu_csv().splitlines()]
    dead = [rows[0], *([rows[1][i] if i in columns else cell for i, cell in enumerate(row)] for row in rows[1:])]
    session = folder.write(imu__csv="\n".join(map(",".join, dead)), gps__csv=gps_csv()).load()
    (problem,) = session.problems
    assert problem.code == "imu_axis_dead" and problem.text.startswith(f"imu.csv: {named} never changes")
    found = check(session)
    assert not found.is_good and sum("never changes" in finding.text for finding in found.findings) == len(columns)


def test_how_many_logs_are_left_out_is_said_as_such_and_not_as_times(folder: Folder) -> None:
    logs = {f"{name}__nmea": "".join(nmea_epochs(count)) for name, count in (("a", 40), ("b", 30), ("c", 20))}
    (problem,) = [p for p in folder.write(**logs).load().problems if p.code == "gps_other_logs"]
    assert problem.count == 2
    said = "a.nmea, the largest log, is used, not 2 others: b.nmea, c.nmea; name a file to have that one"
    assert repeated(problem.text, problem.count) == problem.text == said


def test_sentences_without_receive_times_beside_an_imu_are_said_to_be_a_guess(folder: Folder) -> None:
    folder.write(imu__csv=imu_csv(), rover__nmea="".join(nmea_epochs(50)))
    assert "gps_clock_assumed" in codes(folder.load())
    timed = "".join(f"{0.2 * k:.3f},{burst}" for k, burst in enumerate(nmea_epochs(50)))
    assert "gps_clock_assumed" not in codes(folder.write(rover__nmea=timed).load())


def test_out_txt_is_preferred_and_brings_its_magnetometer_calibration(folder: Folder) -> None:
    magcalib = b"YY" + np.random.default_rng(1).integers(-300, 300, (500, 3)).astype("<i2").tobytes()
    folder.write(OUT__TXT=out_txt(400), MAGCALIB__TXT=magcalib, gps__csv=gps_csv())
    session = folder.load()
    assert session.inputs == ("OUT.TXT", "MAGCALIB.TXT")
    assert session.mag_calibration_field is not None and session.mag_calibration_field.shape == (500, 3)
    assert session.imu is not None and session.imu.accel_full_scale == pytest.approx(4 * 9.80665)
    assert session.mag is not None and session.mag.t.size == 40
    assert folder.load("gps.csv").inputs == ("gps.csv",)


@pytest.mark.parametrize(
    ("imu", "code"),
    [
        (None, "imu_missing"),
        (imu_csv(99), "imu_missing"),
        (imu_csv(150, rate=19.0), "imu_too_slow"),
        (imu_csv().replace(",9.8", ",1.0"), "imu_implausible"),
        (imu_csv().replace(",0.002", ",40.0"), "imu_implausible"),
        (re.sub(r",9\.8\d,", ",nan,", imu_csv()), "imu_missing"),
    ],
)
def test_an_imu_of_no_use_leaves_a_gps_only_session_that_says_why(folder: Folder, imu: str | None, code: str) -> None:
    session = folder.write(gps__csv=gps_csv(), **({} if imu is None else {"imu__csv": imu})).load()
    assert session.imu is None and len(session.gnss) == 50
    (text,) = [problem.text for problem in session.problems if problem.code == code]
    assert text.endswith("smoothed from GPS alone")


@pytest.mark.parametrize("form", ["10:00:{:06.3f}", "2026-05-16T10:00:{:06.3f}Z"])
@pytest.mark.parametrize("table", ["gps.csv", "imu.csv"])
def test_times_that_are_no_numbers_are_shown(folder: Folder, table: str, form: str) -> None:
    tables = {"gps.csv": gps_csv(), "imu.csv": imu_csv()}
    header, *rows = tables[table].splitlines()
    cells = (row.partition(",") for row in rows)
    tables[table] = "\n".join([header, *(f"{form.format(float(t))},{rest}" for t, _, rest in cells)]) + "\n"
    with pytest.raises(SessionError, match=rf"^{table}: t_s is {form.format(0.0)}; it has to be in seconds, as a num"):
        folder.write(**tables).load()


@pytest.mark.parametrize(("up", "is_said"), [(9.8, False), (0.0, True)])
def test_acceleration_without_gravity_is_asked_about(folder: Folder, up: float, is_said: bool) -> None:
    """Five metres a second squared to and fro, as in bends."""
    t = np.arange(0.0, 10.0, 0.01)
    rng = np.random.default_rng(1)
    values = np.column_stack([t, 0.1 * rng.standard_normal((t.size, 6))])
    values[:, 2] += 5.0 * np.sin(2.0 * t)
    values[:, 3] += up
    rows = "\n".join(",".join(f"{value:.4f}" for value in row) for row in values)
    raw = folder.write(gps__csv=gps_csv(), imu__csv=f"t_s,ax,ay,az,gx,gy,gz\n{rows}\n").load()
    told = {problem.code: problem.text for problem in raw.problems}
    assert (raw.imu is None) == is_said
    assert ("no gravity in ax, ay, az; is it linear acceleration?" in told.get("imu_implausible", "")) == is_said


@pytest.mark.parametrize(
    ("imu", "said"),
    [
        ("", "imu.csv: the file is empty"),
        ("t_s,ax,ay,az,gx,gy,gz\n", "imu.csv: a header line, but no rows"),
        (None, "imu.csv: a folder, where a table is wanted"),
    ],
)
def test_an_imu_table_with_nothing_in_it_leaves_the_fixes_and_is_said(
    folder: Folder, imu: str | None, said: str
) -> None:
    folder.write(gps__csv=gps_csv())
    if imu is None:
        (folder.path / "imu.csv").mkdir()
    else:
        folder.write(imu__csv=imu)
    session = folder.load()
    assert session.imu is None and len(session.gnss) == 50 and "imu_missing" in codes(session)
    assert session.problems[0].text.startswith(said)


def test_spikes_of_a_sensor_and_jumps_of_the_height_are_mended_and_said(folder: Folder) -> None:
    imu, gps = imu_csv().splitlines(), gps_csv().splitlines()
    for row in range(100, 1000, 300):
        imu[row] = imu[row].replace(",9.8", ",-156.9")
    gps[20] = gps[20].replace(",8.0,", ",408.0,")
    session = folder.write(imu__csv="\n".join(imu), gps__csv="\n".join(gps)).load()
    assert codes(session) == {"imu_spikes": 3, "gps_height_jump": 1}
    assert session.imu is not None and np.ptp(session.imu.accel[:, 2]) < 0.1
    assert session.imu.t.size == 1000 and len(session.gnss) == 50


def test_milliseconds_for_seconds_are_recognised_by_the_rate_of_the_imu(folder: Folder) -> None:
    right = folder.write(imu__csv=imu_csv(), gps__csv=gps_csv()).load()
    read = folder.write(imu__csv=imu_csv(1000, rate=0.1), gps__csv=gps_csv(50, rate=0.005)).load()
    told = {problem.code: problem.text for problem in read.problems}
    assert told["imu_time_unit"] == "imu.csv: its times are in milliseconds; taken as such"
    assert told["gps_time_unit"] == "gps.csv: its times are in milliseconds; taken as such"
    assert read.imu is not None and right.imu is not None
    np.testing.assert_allclose(read.imu.t, right.imu.t, atol=1e-9)
    np.testing.assert_allclose(read.gnss.t, right.gnss.t, atol=1e-9)


@pytest.mark.parametrize("rate", [0.2, 0.5, 0.8])
def test_a_sensor_that_is_really_slow_is_not_taken_for_one_in_milliseconds(folder: Folder, rate: float) -> None:
    """It lasts as long as its fixes, not a second; a slow compass likewise."""
    count = round(900 * rate)
    slow = "\n".join(["t_s,mx,my,mz", *(f"{k / rate:.2f},20.{k % 5},3.{k % 7},40.{k % 3}" for k in range(count))])
    read = folder.write(imu__csv=imu_csv(count, rate=rate), gps__csv=gps_csv(4500), mag__csv=slow + "\n").load()
    told = codes(read)
    assert "imu_too_slow" in told and not {"imu_time_unit", "mag_time_unit", "gps_outside_imu"} & set(told)
    assert read.imu is None and read.mag is not None and read.mag.t[-1] > 890.0


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_a_compass_has_the_unit_of_the_imu_beside_it(folder: Folder, rate: float) -> None:
    """A period of 500 alone would be 0.5 ms."""
    count = round(10 * rate)
    mag = "\n".join(["t_s,mx,my,mz", *(f"{1e3 * k / rate:.1f},20.{k % 5},3.{k % 7},40.{k % 3}" for k in range(count))])
    files = {"imu__csv": imu_csv(1000, rate=0.1), "gps__csv": gps_csv(50, rate=0.005), "mag__csv": mag + "\n"}
    read = folder.write(**files).load()
    assert read.mag is not None and read.mag.t[-1] == pytest.approx(10.0 - 1.0 / rate)


@pytest.mark.parametrize("size", [1e3, 1e6])
def test_a_compass_may_be_in_seconds_beside_an_imu_that_is_not(folder: Folder, size: float) -> None:
    mag = "\n".join(["t_s,mx,my,mz", *(f"{k / 10:.1f},0.3,0.{k % 7},-0.4" for k in range(100))])
    files = {"imu__csv": imu_csv(1000, rate=100.0 / size), "gps__csv": gps_csv(), "mag__csv": mag + "\n"}
    read = folder.write(**files).load()
    assert read.mag is not None and read.mag.t[-1] == pytest.approx(9.9)
    assert "imu_time_unit" in codes(read) and "mag_time_unit" not in codes(read)


def test_an_imu_of_a_kilohertz_may_be_in_milliseconds(folder: Folder) -> None:
    read = folder.write(imu__csv=imu_csv(10_000, rate=1.0), gps__csv=gps_csv(50, rate=0.005)).load()
    assert read.imu is not None and read.imu.t[-1] == pytest.approx(9.999)


def test_fixes_at_a_high_rate_have_the_unit_of_the_imu(folder: Folder) -> None:
    read = folder.write(imu__csv=imu_csv(1000, rate=0.1), gps__csv=gps_csv(500, rate=0.05)).load()
    assert read.gnss.t[-1] == pytest.approx(9.98)


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9])
def test_the_unit_of_fixes_is_told_by_their_utc(folder: Folder, size: float) -> None:
    header, *rows = gps_csv().replace("\n", ",\n").splitlines()
    rows = [f"{size * k / 5:.0f},{row.partition(',')[2]}{1.7e9 + k / 5:.1f}" for k, row in enumerate(rows)]
    read = folder.write(gps__csv="\n".join([header + "unix_s", *rows]) + "\n").load()
    assert "gps_time_unit" in {problem.code for problem in read.problems}
    np.testing.assert_allclose(read.gnss.t, np.arange(50) / 5, atol=1e-6)


@pytest.mark.parametrize("imu", [None, imu_csv()])
def test_fixes_of_an_unknown_unit_end_in_one_line_with_the_remedy(folder: Folder, imu: str | None) -> None:
    folder.write(gps__csv=gps_csv(50, rate=0.005), **({} if imu is None else {"imu__csv": imu}))
    with pytest.raises(SessionError, match=r"^gps.csv: by t_s a fix only every 200 s, .* divide milliseconds by 1000"):
        folder.load()


def test_an_axis_that_stops_half_way_is_named_with_its_time(folder: Folder) -> None:
    rows = imu_csv(4000).splitlines()
    rows[2000:] = [row.rpartition(",")[0] + ",0.006" for row in rows[2000:]]
    problems = folder.write(imu__csv="\n".join(rows) + "\n", gps__csv=gps_csv(200)).load().problems
    (text,) = [problem.text for problem in problems if problem.code == "imu_axis_stuck"]
    assert text.startswith("imu.csv: z of the gyroscope does not change from 20 to 40 s; attitude")


def test_an_axis_that_says_0_on_every_straight_is_not_stuck(folder: Folder) -> None:
    """Some modules write 0 for whatever turns slower than their noise."""
    rows = imu_csv(8000).splitlines()
    turn = [max(0.0, np.sin(np.pi * k / 1200)) + 0.003 * (k % 7) for k in range(8000)]
    turn = [rate if rate > 0.05 else 0.0 for rate in turn]
    rows[1:] = [f"{row.rpartition(',')[0]},{rate:.3f}" for row, rate in zip(rows[1:], turn, strict=True)]
    raw = folder.write(imu__csv="\n".join(rows) + "\n", gps__csv=gps_csv(400)).load()
    assert raw.problems == () and raw.imu is not None and raw.imu.t.size == 8000


def test_a_pause_between_two_rests_is_not_a_stuck_axis(folder: Folder) -> None:
    """At rest a coarse gyroscope says 0, before lunch and after it, at another place."""
    rows = imu_csv(4000).splitlines()
    fields = [row.split(",") for row in rows[1:]]
    for k, field in enumerate(fields):
        field[0] = f"{float(field[0]) + 1800.0 * (k >= 2000):.4f}"
        if 1200 <= k < 2800:
            field[-1] = "0.000"
    fixes = [
        f"{k / 5 + 1800.0 * (k >= 100):.1f},{45 + 1e-4 * min(k, 60) + 2e-3 * (k >= 100):.8f},12.0,8.0"
        for k in range(200)
    ]
    table = "\n".join(["t_s,lat_deg,lon_deg,alt_m", *fixes]) + "\n"
    folder.write(imu__csv="\n".join([rows[0], *map(",".join, fields)]) + "\n", gps__csv=table)
    assert "imu_axis_stuck" not in codes(folder.load())


def test_an_axis_that_shows_nothing_at_rest_is_not_stuck_though_the_fixes_settle(folder: Folder) -> None:
    """The steps of a sensor may be coarser than its noise, and a receiver comes from 100 m off after its start."""
    rows = imu_csv(6000).splitlines()
    rows[:4000] = [rows[0], *(row.rpartition(",")[0] + ",0.006" for row in rows[1:4000])]
    places = [45 + 1e-3 * np.exp(-k / 25) + 1e-4 * max(0, k - 200) for k in range(300)]
    fixes = [f"{k / 5:.1f},{lat:.8f},12.0,8.0,{50.0 * (k > 200) + 0.05},0.0" for k, lat in enumerate(places)]
    table = "\n".join(["t_s,lat_deg,lon_deg,alt_m,speed_mps,course_deg", *fixes]) + "\n"
    folder.write(imu__csv="\n".join(rows) + "\n", gps__csv=table)
    assert "imu_axis_stuck" not in codes(folder.load())


@pytest.mark.parametrize(("rate", "enough"), [(25.0, True), (20.0, True), (19.7, True), (19.0, False)])
def test_20_samples_a_second_are_enough(folder: Folder, rate: float, enough: bool) -> None:
    raw = folder.write(gps__csv=gps_csv(), imu__csv=imu_csv(200, rate=rate)).load()
    assert (raw.imu is not None) == enough and ("imu_too_slow" in codes(raw)) == (not enough)


def test_a_magnetometer_file_that_cannot_be_read_does_not_stop_the_session(folder: Folder) -> None:
    session = folder.write(gps__csv=gps_csv(), mag__csv="t_s,mx,my,mz\n").load()
    assert session.mag is None and codes(session)["mag_unusable"] == 1


def test_heights_and_climbs_of_nothing_but_zeros_were_not_measured(folder: Folder) -> None:
    rows = [f"{k / 5:.2f},{45 + 1e-4 * k:.9f},12.0,0.0,50.0,0.0,0.0" for k in range(50)]
    table = "\n".join(["t_s,lat_deg,lon_deg,alt_m,vel_n_mps,vel_e_mps,vel_u_mps", *rows])
    raw = folder.write(imu__csv=imu_csv(), gps__csv=table).load()
    assert np.isnan(raw.gnss.alt_m).all()
    assert np.isnan(raw.gnss.velocity_n[:, 2]).all()
    np.testing.assert_allclose(raw.gnss.velocity_n[:, 0], 50.0)
    one = folder.write(gps__csv=table.replace("50.0,0.0,0.0", "50.0,0.0,0.1", 1)).load()
    assert one.gnss.velocity_n[0, 2] == 0.1


def test_a_height_that_never_changes_was_measured_once_at_most(folder: Folder) -> None:
    constant = folder.write(imu__csv=imu_csv(count=1400), gps__csv=gps_csv(count=60)).load()
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(constant.gnss.alt_m)), [0])
    rows = gps_csv(count=60).splitlines()
    for row in (1, 30):  # where one is missing, no other was measured
        rows[row] = rows[row].replace("12.0,8.0,", "12.0,,")
    holes = folder.write(gps__csv="\n".join(rows)).load()
    np.testing.assert_array_equal(np.flatnonzero(np.isfinite(holes.gnss.alt_m)), [1])
    rough = folder.write(gps__csv=gps_csv(count=60).replace("12.0,8.0", "12.0,8.1", 1)).load()
    assert np.isfinite(rough.gnss.alt_m).all()


def test_that_no_fix_has_a_height_is_said(folder: Folder) -> None:
    without = gps_csv().replace("alt_m", "other")
    raw = load_raw(folder.write(**{"imu.csv": imu_csv(), "gps.csv": without}).path)
    assert "gps_no_height" in [problem.code for problem in raw.problems]


def frozen(begin: int, end: int, values: str | None = None) -> str:
    """An imu.csv whose samples begin to end, exclusive, repeat the first of them, or have these values."""
    lines = imu_csv().splitlines()
    for k in range(begin, end):
        stamp, _, first = lines[1 + k].partition(",")[0], "", lines[1 + begin].partition(",")[2]
        lines[1 + k] = f"{stamp},{values or first}"
    return "\n".join(lines) + "\n"


def test_samples_that_stand_still_while_the_fixes_move_on_are_left_out_and_counted(folder: Folder) -> None:
    raw = folder.write(imu__csv=frozen(400, 700, "0.5,1.5,9.0,0.1,0.2,0.3"), gps__csv=gps_csv()).load()
    assert raw.imu is not None
    assert raw.imu.t.size == 1000 - 299
    assert [(p.code, p.count) for p in raw.problems] == [("imu_frozen", 299)]


def test_a_gyroscope_that_stops_at_once_leaves_a_session_of_fixes_alone(folder: Folder) -> None:
    rows = imu_csv().splitlines()
    of_gyro = rows[61].split(",")[4:]
    rows[61:] = [",".join([*row.split(",")[:4], *of_gyro]) for row in rows[61:]]
    raw = folder.write(imu__csv="\n".join(rows), gps__csv=gps_csv()).load()
    assert raw.imu is None and codes(raw) == {"imu_sensor_frozen": 939, "imu_missing": 1}
    assert "imu.csv: only 61 usable samples in which neither sensor stands still" in raw.problems[-1].text


@pytest.mark.parametrize(
    ("imu", "why"),
    [
        (frozen(400, 450, "0.5,1.5,9.0,0.1,0.2,0.3"), "for half a second"),
        (frozen(400, 700, "0,0,9.80665,0,0,0"), "at one speed straight ahead"),
        (frozen(0, 1000, "0.5,1.5,9.0,0.1,0.2,0.3"), "none ever changes: the smoother sees what they are worth"),
    ],
)
def test_samples_may_repeat_one_another(folder: Folder, imu: str, why: str) -> None:
    raw = folder.write(imu__csv=imu, gps__csv=gps_csv()).load()
    assert raw.imu is not None and raw.imu.t.size == 1000, why


def test_fixes_without_imu_around_them_are_counted(folder: Folder) -> None:
    session = folder.write(imu__csv=imu_csv(500), gps__csv=gps_csv()).load()
    assert codes(session) == {"gps_outside_imu": 25}


def fixes_at(*steps: tuple[int, float]) -> str:
    """A gps.csv of so many fixes, each so many seconds from the one before, one after the other; with UTC."""
    t = np.cumsum(np.concatenate([np.full(count, step) for count, step in steps]))
    rows = [f"{time + 0.003 * (k % 3):.3f},{45 + 1e-4 * time:.8f},12.0,{1.7e9 + time:.3f}" for k, time in enumerate(t)]
    return "\n".join(["t_s,lat_deg,lon_deg,unix_s", *rows]) + "\n"


@pytest.mark.parametrize(
    ("steps", "gaps"),
    [
        (((110, 1.001), (1500, 0.1)), 0),
        (((500, 0.2), (60, 1.001), (500, 0.2)), 0),
        (((110, 1.0), (1, 3.0), (1500, 0.1), (1, 1.3), (100, 0.1)), 2),
        (((500, 0.2), (60, 4.0), (500, 0.2)), 60),  # it hardly sees its satellites
        (((100, 5.0), (1, 11.0), (100, 5.0)), 1),
    ],
)
def test_a_receiver_that_changes_its_rate_has_no_gaps(
    folder: Folder, steps: tuple[tuple[int, float], ...], gaps: int
) -> None:
    assert codes(folder.write(gps__csv=fixes_at(*steps)).load()).get("gps_gap", 0) == gaps


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        (0.0, 100.0, {"imu_after_fixes"}),
        (50.0, 199.8, {"imu_before_fixes"}),
        (50.0, 150.0, {"imu_before_fixes", "imu_after_fixes"}),
        (9.0, 191.0, set()),
    ],
)
def test_an_imu_that_runs_on_long_without_fixes_is_said(
    folder: Folder, start: float, end: float, expected: set[str]
) -> None:
    imu, gps = imu_csv(5000, rate=25.0), gps_csv(int(5 * (end - start)) + 1, start=start)
    session = folder.write(imu__csv=imu, gps__csv=gps).load()
    assert set(codes(session)) == expected
    if "imu_after_fixes" in expected:
        assert f"last fix comes {200 - end:.0f} s before" in session.problems[-1].text


def test_stamps_are_evened_and_fixes_put_on_the_receivers_clock(folder: Folder) -> None:
    rng = np.random.default_rng(3)
    true_imu, true_fix = np.arange(12_000) * 0.005, np.arange(300) * 0.2
    stamps = np.sort(true_imu + 0.001 * rng.standard_normal(true_imu.size))
    arrival = np.maximum.accumulate(true_fix + 0.1 + rng.exponential(0.02, true_fix.size))
    imu = "t_s,ax,ay,az,gx,gy,gz\n" + "".join(f"{t:.6f},0,0,9.8,0,0,0\n" for t in stamps)
    gps = "t_s,lat_deg,lon_deg,unix_s\n" + "".join(
        f"{t:.6f},{45 + 1e-5 * k + 1e-8 * k * k:.9f},12,{1.7e9 + 0.2 * k:.3f}\n" for k, t in enumerate(arrival)
    )
    session = folder.write(imu__csv=imu, gps__csv=gps).load()
    assert session.imu is not None
    assert np.std(session.imu.t - true_imu) < 0.0003
    assert np.std(session.gnss.t - true_fix) < 0.0015
    assert session.unix_at_zero == pytest.approx(1.7e9 - 0.114, abs=0.005)  # latency and median delay


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (lambda f: f, r"no recording found; wanted \*.klg, out.txt, gps.csv, .*\*.nmea"),
        (lambda f: f.write(imu__csv=imu_csv()), r"an IMU table, but neither gps.csv nor \*.nmea"),
        (lambda f: f.write(gps__csv=""), r"^gps.csv: the file is empty"),
        (lambda f: f.write(gps__csv="t_s,lat_deg,lon_deg\n"), r"^gps.csv: a header line, but no rows"),
        (
            lambda f: f.write(gps__csv=gps_csv().replace("lat_deg", "lat")),
            r"^gps.csv: no column lat_deg; has t_s, lat, ",
        ),
        (
            lambda f: f.write(gps__csv="t_s,lat_deg,lon_deg,fix\n0,45,12,0\n"),
            r"^gps.csv: no usable fix \(1 row without a fix",
        ),
        (
            lambda f: f.write(gps__csv=gps_csv(), imu__csv=imu_csv().partition("\n")[2]),
            r"^imu.csv: the first line is numbers, and no header; put .* \(t_s, ax, ay, az, gx, gy, gz\)$",
        ),
        (
            lambda f: f.write(gps__csv=gps_csv().partition("\n")[2]),
            r"^gps.csv: the first line is numbers, and no header; put .* \(t_s, lat_deg, lon_deg, ..\)$",
        ),
        (
            lambda f: f.write(gps__csv=gps_csv(start=1000.0), imu__csv=imu_csv()),
            r"^imu.csv \(0.0 to 10.0 s\) and gps.csv \(1000.0 to 1009.8 s\) do not overlap in time",
        ),
        (lambda f: f.write(out__txt=b"nothing"), r"^out.txt: no record"),
        (lambda f: f.write(x__nmea=b"nothing"), r"^x.nmea: no NMEA sentence"),
    ],
)
def test_what_cannot_be_used_ends_in_one_line_with_file_and_remedy(
    folder: Folder, prepare: Callable[[Folder], Folder], message: str
) -> None:
    prepare(folder)
    with pytest.raises(SessionError, match=message) as error:
        folder.load()
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["missing", "notes.pdf"])
def test_a_path_that_is_no_recording_is_one_clear_line(folder: Folder, name: str) -> None:
    folder.write(notes__pdf=b"%PDF")
    with pytest.raises(SessionError, match=r"no such file|no known kind of recording"):
        folder.load(name)


RACEBOX = "Format,RaceBox CSV\nLaps,1\nRecord,Time,Latitude,Longitude,Speed\n1,10:00:00.000,45.0,12.0,36.0\n"


@pytest.mark.parametrize("beside", ["", "a.nmea", "gps.csv"])
def test_a_table_that_no_reader_knows_is_named_with_its_columns_and_what_is_wanted(folder: Folder, beside: str) -> None:
    folder.write(**{"racebox.csv": RACEBOX}, **({beside: gps_csv()} if beside else {}))
    columns = (
        r"its columns are Record, Time, Latitude, Longitude, Speed; wanted t_s \(seconds\), lat_deg and lon_deg: "
        r"rename Latitude and Longitude and the times, and leave out the 2 lines before the names"
    )
    with pytest.raises(SessionError, match=rf"racebox.csv: no known kind of recording; {columns}"):
        folder.load("racebox.csv")
    if not beside:
        with pytest.raises(SessionError, match=rf"heat2: no recording found, but racebox.csv; {columns}"):
            folder.load()


def test_a_table_without_places_is_named_too(folder: Folder) -> None:
    folder.write(gps__csv=gps_csv(), **{"Gyroscope.csv": "time,z,y,x\n0,0,0,0\n", "empty.csv": ""})
    with pytest.raises(SessionError, match=r"Gyroscope.csv: .*its columns are time, z, y, x; wanted t_s .* gx, gy, gz"):
        folder.load("Gyroscope.csv")
    with pytest.raises(SessionError, match=r"empty.csv: .*it is empty"):
        folder.load("empty.csv")


@pytest.mark.parametrize("name", ["mag.csv", "official.csv"])
def test_a_table_that_belongs_to_a_session_stands_for_it(folder: Folder, name: str) -> None:
    folder.write(imu__csv=imu_csv(), gps__csv=gps_csv(), **{name: "lap,time_s\n1,50.1\n"})
    assert "gps.csv" in folder.load(name).inputs


def test_sentences_in_a_file_of_another_name_are_pointed_at(folder: Folder) -> None:
    folder.write(**{"gps.txt": "".join(nmea_epochs(50)), "notes.txt": "hot, 30 degrees"})
    with pytest.raises(SessionError, match=r"gps.txt holds NMEA sentences; name the file, smooth .*gps.txt, or call"):
        folder.load()
    assert len(folder.load("gps.txt").gnss) == 50


def test_sentences_behind_a_long_header_are_found(folder: Folder) -> None:
    """As Android's GnssLogger writes them, with the names of its columns and raw measurements before."""
    raw = "".join(f"Raw,{k},$,G,{'1.5,' * 30}\n" for k in range(400))
    sentences = "".join(f"NMEA,{line.strip()},{1717149600000 + 200 * k}\n" for k, line in enumerate(nmea_epochs(50)))
    folder.write(**{"gnss_log.txt": f"# Raw,utcTimeMillis\n{raw}{sentences}"})
    assert len(folder.load("gnss_log.txt").gnss) == 50
    with pytest.raises(SessionError, match=r"gnss_log.txt holds NMEA sentences; name the file"):
        folder.load()


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-le", "utf-16-be"])
@pytest.mark.parametrize("name", ["rover.nmea", "rover.txt"])
def test_sentences_in_two_bytes_a_character_are_read(folder: Folder, encoding: str, name: str) -> None:
    folder.write(**{name: "".join(nmea_epochs(50)).encode(encoding)})
    assert len(folder.load(name).gnss) == 50


def test_every_cut_of_both_tables_gives_a_session_or_one_line(folder: Folder) -> None:
    imu, gps = imu_csv(120), gps_csv(6)
    for size in range(0, len(gps), 7):
        folder.write(imu__csv=imu[: len(imu) * size // len(gps)], gps__csv=gps[:size])
        try:
            folder.load()
        except SmootherError as error:
            assert "\n" not in str(error)


def test_truth_by_latitude_is_placed_by_the_origin_and_by_north_as_it_stands(folder: Folder) -> None:
    origin = Origin(45.0, 12.0, 5.0)
    folder.write(
        truth__csv="t_s,lat_deg,lon_deg,alt_m,yaw_deg,pitch_deg,roll_deg\n0,45.001,12,7,90,0,0\n1,45.001,12,,90,0,0\n"
    )
    truth = load_truth(folder.path, origin)
    np.testing.assert_allclose(truth.position_n[0], [111.13, 0.0, 2.0], atol=0.01)
    assert np.isnan(truth.position_n[1, 2]) and np.all(np.isnan(truth.velocity_n))
    np.testing.assert_allclose(truth.R_nb[0] @ [1, 0, 0], [0, 1, 0], atol=1e-12)  # nose west
    folder.write(
        truth__csv="t_s,north_m,west_m,up_m,vel_north_mps,vel_west_mps,vel_up_mps\n0,1,2,3,4,5,6\nx,1,2,3,4,5,6\n"
    )
    truth = load_truth(folder.path, origin)
    assert len(truth) == 1
    np.testing.assert_array_equal(np.hstack([truth.position_n, truth.velocity_n]), [[1, 2, 3, 4, 5, 6]])
    assert np.all(np.isnan(truth.R_nb))


def test_missing_truth_is_one_clear_line(folder: Folder) -> None:
    with pytest.raises(SessionError, match=r"no truth.csv"):
        load_truth(folder.path, Origin(0, 0, 0))
    folder.write(truth__csv="t_s,lat_deg\n0,1\n")
    with pytest.raises(SessionError, match=r"^truth.csv: no usable row"):
        load_truth(folder.path, Origin(0, 0, 0))


@pytest.mark.parametrize(
    ("name", "fixes", "samples", "expected"),
    [
        ("kart_adria_first_half", 2626, 33708, {"imu_gap", "imu_jitter"}),
        ("kart_lignano_racebox", 31527, 31527, {"imu_gap", "recordings_unused"}),
        ("kart_massafinalese_racechrono", 10390, 0, {"imu_too_slow", "recordings_unused"}),
        ("kart_okc_doves", 22691, 0, {"imu_missing"}),
        ("car_hi600_rtk", 867, 86716, set()),
        ("car_hi600_twin_a", 9841, 98413, {"imu_gap", "gps_gap"}),
        ("car_hi600_twin_b", 9696, 96960, {"imu_gap", "gps_gap"}),
        ("car_comma2k19", 579, 6256, set()),
        ("bicycle_neo6m", 2404, 0, {"imu_too_slow", "gps_gap"}),
        ("nmea_kart_okc", 15866, 0, {"imu_missing", "gps_gap", "gps_bad_sentence", "gps_other_logs"}),
    ],
)
def test_real_recordings_lose_no_row_and_tell_their_flaws(
    data_directory: Path, name: str, fixes: int, samples: int, expected: set[str]
) -> None:
    session = load_raw(data_directory / name)
    assert len(session.gnss) == fixes
    assert (0 if session.imu is None else session.imu.t.size) == samples
    assert {problem.code for problem in session.problems} == expected
    assert check(session).measures.get("imu_gaps", 0) == codes(session).get("imu_gap", 0)  # one page shows both


def test_stamps_rounded_to_10_ms_agree_with_doppler_once_they_are_evened(data_directory: Path) -> None:
    """RaceBox exports round their stamps: at 25 Hz a step of the position then disagrees by a quarter."""
    session = load_raw(data_directory / "kart_lignano_racebox")
    gnss = session.gnss
    assert gnss.speed is not None
    step = np.linalg.norm(np.diff(gnss.position_n(Origin(45.7, 13.07, 0.0))[:, :2], axis=0), axis=1)
    fast = gnss.speed[1:] > 8.0
    error = (step - gnss.speed[1:] * np.diff(gnss.t))[fast]
    assert np.std(error) < 0.02  # 0.063 m with the stamps as written


def test_samples_that_arrived_in_bursts_are_spread_at_their_rate(data_directory: Path) -> None:
    imu, _ = read_imu(data_directory / "calib_mpu6050_static" / "imu.csv")
    base = regularize(imu.t)
    assert 1.0 / base.period == pytest.approx(99.3, abs=0.5)
    assert np.percentile(np.diff(base.t), 99) < 0.011
