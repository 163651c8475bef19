"""A directory, or a file of it, to a RawSession: what is chosen, what is said, what ends in one clear line."""

import gzip
import re
from collections.abc import Callable
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from smoother.errors import ConfigError, SessionError, SmootherError
from smoother.frames import Origin
from smoother.session.files import WANTED, Role
from smoother.session.load import load_raw
from smoother.session.truth import load_truth
from smoother.words import repeated

from .folders import Folder, codes, gps_csv, imu_csv, nmea_epochs, out_txt

DATA = Path(__file__).parents[1] / "data"


def stopped(table: str) -> str:
    """The same with a clock that stands at 7 s."""
    header, *rows = table.splitlines()
    return "\n".join([header, *(f"7.0,{row.partition(',')[2]}" for row in rows)]) + "\n"


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


def test_a_stated_delay_of_the_samples_is_taken_off_beyond_the_half_period_that_every_mean_has(folder: Folder) -> None:
    folder.write(imu__csv=imu_csv(), gps__csv=gps_csv())
    plain = folder.load().imu
    delayed = folder.write(session__toml="[imu]\ndelay = 0.02").load().imu
    assert plain is not None and delayed is not None
    period = np.median(np.diff(plain.t))
    np.testing.assert_allclose(plain.t - delayed.t, 0.02 - 0.5 * period, atol=1e-9)


def test_gps_csv_wins_over_sentences_with_a_problem(folder: Folder) -> None:
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
    assert set(WANTED) == {role for part in get_args(Role) for role in get_args(part)}
    folder.write(notes__md="nothing")
    for file in ("", "notes.md"):
        with pytest.raises(
            SessionError,
            match=r"\*\.klg, out\.txt, gps\.csv, .*\*\.vbo, .*\.ubx, .* or a \.csv with latitude, longitude and time$",
        ):
            folder.load(file)


@pytest.mark.parametrize("name", ["day.tar.gz", "DAY.7Z"])
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


def test_left_out_logs_are_counted_as_logs_and_not_as_times(folder: Folder) -> None:
    logs = {f"{name}__nmea": "".join(nmea_epochs(count)) for name, count in (("a", 40), ("b", 30), ("c", 20))}
    (problem,) = [p for p in folder.write(**logs).load().problems if p.code == "gps_other_logs"]
    assert problem.count == 2
    said = "a.nmea, the largest log, is used, not 2 others: b.nmea, c.nmea; name a file to have that one"
    assert repeated(problem.text, problem.count) == problem.text == said


def test_sentences_without_receive_times_beside_an_imu_are_reported_as_assumed(folder: Folder) -> None:
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


def test_a_magnetometer_file_that_cannot_be_read_does_not_stop_the_session(folder: Folder) -> None:
    session = folder.write(gps__csv=gps_csv(), mag__csv="t_s,mx,my,mz\n").load()
    assert session.mag is None and codes(session)["mag_unusable"] == 1


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
        (
            lambda f: f.write(gps__csv=gps_csv(), imu__csv=stopped(imu_csv())),
            r"^imu.csv: t_s is 7 in all 1000 rows; write when each was taken, in seconds$",
        ),
        (
            lambda f: f.write(gps__csv=stopped(gps_csv()), imu__csv=imu_csv()),
            r"^gps.csv: t_s is 7 in all 50 rows; write when each was taken, in seconds$",
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


def test_a_compass_without_a_clock_is_left_out(folder: Folder) -> None:
    mag = "\n".join(["t_s,mx,my,mz", *(f"7.0,20.{k % 5},3.{k % 7},40.{k % 3}" for k in range(500))])
    session = folder.write(gps__csv=gps_csv(), imu__csv=imu_csv(), mag__csv=mag + "\n").load()
    (said,) = [problem.text for problem in session.problems if problem.code == "mag_unusable"]
    assert session.mag is None and said.startswith("mag.csv: t_s is 7 in all 500 rows; ")


@pytest.mark.parametrize("name", ["missing", "notes.pdf"])
def test_a_path_that_is_no_recording_is_one_clear_line(folder: Folder, name: str) -> None:
    folder.write(notes__pdf=b"%PDF")
    with pytest.raises(SessionError, match=r"no such file|no known kind of recording"):
        folder.load(name)


UNKNOWN = "Format,some CSV\nLaps,1\nRecord,Stamp,Latitude,Longitude,Speed\n1,10:00:00.000,45.0,12.0,36.0\n"


@pytest.mark.parametrize("beside", ["", "a.nmea", "gps.csv"])
def test_an_unknown_table_is_named_with_its_columns_and_those_expected(folder: Folder, beside: str) -> None:
    folder.write(**{"heat.csv": UNKNOWN}, **({beside: gps_csv()} if beside else {}))
    columns = (
        r"its columns are Record, Stamp, Latitude, Longitude, Speed: no column says when; add one called time, "
        r"in seconds or as 10:00:00.2"
    )
    with pytest.raises(SessionError, match=rf"heat.csv: no known kind of recording; {columns}"):
        folder.load("heat.csv")
    if not beside:
        with pytest.raises(SessionError, match=rf"heat2: no recording found, but heat.csv; {columns}"):
            folder.load()


def test_a_table_without_places_is_named_too(folder: Folder) -> None:
    folder.write(gps__csv=gps_csv(), **{"Gyroscope.csv": "time,z,y,x\n0,0,0,0\n", "empty.csv": ""})
    with pytest.raises(SessionError, match=r"Gyroscope.csv: .*its columns are time, z, y, x: none says where; expor"):
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


SENTENCES = "".join(nmea_epochs(100))
RECEIVED = "".join(f"{0.2 * k + 3.0:.2f},{sentence}" for k, sentence in enumerate(nmea_epochs(100)))


@pytest.mark.parametrize(
    "text", [SENTENCES, SENTENCES[30:], "t_s,sentence\n" + RECEIVED, "\n$PUBX,00*33\r\n" + SENTENCES]
)
def test_sentences_in_a_file_called_gps_csv_are_read_as_such(folder: Folder, text: str) -> None:
    session = folder.write(gps__csv=text).load()
    assert len(session.gnss) >= 99 and session.inputs == ("gps.csv",)
    assert codes(session)["gps_sentences"] == 1
    assert len(folder.load("gps.csv").gnss) == len(session.gnss)


def test_sentences_in_gps_csv_have_the_clock_of_the_samples_beside_them(folder: Folder) -> None:
    session = folder.write(gps__csv=RECEIVED, imu__csv=imu_csv(2500)).load()
    assert session.imu is not None and session.inputs == ("imu.csv", "gps.csv")
    assert session.gnss.t[0] - session.imu.t[0] == pytest.approx(3.0, abs=0.05)
    assert "gps_clock_assumed" not in codes(session)


def test_sentences_in_a_column_of_a_table_of_fixes_leave_it_one(folder: Folder) -> None:
    header, *rows = gps_csv(50).splitlines()
    sentences = [sentence.strip().replace(",", " ") for sentence in nmea_epochs(50)]
    table = "\n".join([f"{header},raw", *(f"{row},{raw}" for row, raw in zip(rows, sentences, strict=True))]) + "\n"
    session = folder.write(gps__csv=table).load()
    assert len(session.gnss) == 50 and "gps_sentences" not in codes(session)


def test_a_table_of_fixes_by_another_name_is_named(tmp_path: Path) -> None:
    (tmp_path / "monday.csv").write_text("t_s,lat_deg,lon_deg\n" + "".join(f"{k},45.{k:04},1\n" for k in range(20)))
    with pytest.raises(SessionError, match=r"no recording found, but monday\.csv, .*; name the file, smooth .*, or"):
        load_raw(tmp_path)
