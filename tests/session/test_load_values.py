"""What is done on loading about values that cannot be: units, axes that stand still, heights, rates and gaps."""

import re
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.estimate.judge.check import check
from smoother.frames import Origin
from smoother.session.clock import regularize
from smoother.session.csv_form import read_imu
from smoother.session.load import load_raw
from smoother.units import STANDARD_GRAVITY

from .folders import Folder, codes, gps_csv, imu_csv


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


@pytest.mark.parametrize(
    ("imu", "code"),
    [
        (None, "imu_missing"),
        (imu_csv(99), "imu_missing"),
        (imu_csv(150, rate=19.0), "imu_too_slow"),
        (imu_csv().replace(",9.8", ",100."), "imu_implausible"),
        (imu_csv().replace(",9.8", ",0.001").replace(",0.1", ",0.0"), "imu_implausible"),
        (re.sub(r",9\.8\d,", ",nan,", imu_csv()), "imu_missing"),
    ],
)
def test_an_unusable_imu_leaves_a_gps_only_session_with_the_reason(folder: Folder, imu: str | None, code: str) -> None:
    session = folder.write(gps__csv=gps_csv(), **({} if imu is None else {"imu__csv": imu})).load()
    assert session.imu is None and len(session.gnss) == 50
    (text,) = [problem.text for problem in session.problems if problem.code == code]
    assert text.endswith("smoothed from GPS alone")


def test_turn_rates_of_a_kart_in_degrees_are_taken_for_such(folder: Folder) -> None:
    raw = folder.write(gps__csv=gps_csv(), imu__csv=imu_csv().replace(",0.002", ",40.0")).load()
    assert raw.imu is not None and np.median(raw.imu.gyro[:, 1]) * raw.imu.gyro_scale == pytest.approx(
        np.radians(40.0), rel=0.01
    )
    assert [problem.count for problem in raw.problems if problem.code == "imu_gyro_unit"] == [1]


@pytest.mark.parametrize("rate", ["0.002", "40.0"])
def test_accelerations_in_g_are_taken_for_such_whatever_the_rates_are_in(folder: Folder, rate: str) -> None:
    table = imu_csv().replace(",9.8", ",1.0").replace(",0.002", f",{rate}")
    raw = folder.write(gps__csv=gps_csv(), imu__csv=table).load()
    assert raw.imu is not None
    assert np.median(raw.imu.accel[:, 2]) * raw.imu.accel_scale == pytest.approx(1.01 * STANDARD_GRAVITY, abs=0.1)
    told = {problem.code: problem.text for problem in raw.problems}
    assert list(told) == ["imu_accel_unit", "imu_gyro_unit"][: 1 + (rate == "40.0")]
    assert told["imu_accel_unit"].startswith("imu.csv: typically 1 m/s^2, where gravity alone gives 9.8, as with g")


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
def test_an_imu_table_with_nothing_in_it_leaves_the_fixes_and_is_reported(
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


@pytest.mark.parametrize("name", ["imu.csv", "session.toml", "mag.csv", "calibration.toml"])
@pytest.mark.parametrize("leads_to", ["nowhere", "itself"])
def test_a_link_that_leads_nowhere_is_reported(folder: Folder, name: str, leads_to: str) -> None:
    folder.write(**{"gps__csv": gps_csv(), **({} if name == "imu.csv" else {"imu__csv": imu_csv()})})
    (folder.path / name).symlink_to(name if leads_to == "itself" else leads_to)
    session = folder.load()
    said = [problem.text for problem in session.problems if problem.code in ("imu_folder", "not_a_file")]
    assert len(said) == 1 and said[0].startswith(f"{name}: a link that leads nowhere, where a ")


def test_a_link_that_leads_nowhere_is_named_where_there_is_nothing_else(folder: Folder) -> None:
    (folder.path / "LOG00001.KLG").symlink_to("card/LOG00001.KLG")
    with pytest.raises(SessionError, match=r"no recording found \(LOG00001.KLG is a link that leads nowhere\); wanted"):
        folder.load()


def test_fixes_that_are_a_folder_are_named_where_there_are_no_others(folder: Folder) -> None:
    folder.write(imu__csv=imu_csv())
    (folder.path / "gps.csv").mkdir()
    with pytest.raises(SessionError, match=r"neither gps.csv nor \*.nmea \(gps.csv is a folder\)"):
        folder.load()


@pytest.mark.filterwarnings("error")
def test_positions_beyond_any_unit_cost_themselves_alone(folder: Folder) -> None:
    lines = gps_csv(100).splitlines()
    lines[9::20] = [re.sub(r",4\d\.\d+,", ",1e308,", line) for line in lines[9::20]]
    session = folder.write(gps__csv="\n".join(lines)).load()
    assert len(session.gnss) == 95 and codes(session)["gps_absurd"] == 5


def test_milliseconds_for_seconds_are_recognised_by_the_rate_of_the_imu(folder: Folder) -> None:
    right = folder.write(imu__csv=imu_csv(), gps__csv=gps_csv()).load()
    read = folder.write(imu__csv=imu_csv(1000, rate=0.1), gps__csv=gps_csv(50, rate=0.005)).load()
    told = {problem.code: problem.text for problem in read.problems}
    assert told["imu_time_unit"] == "imu.csv: its times are in milliseconds; converted"
    assert told["gps_time_unit"] == "gps.csv: its times are in milliseconds; converted"
    assert read.imu is not None and right.imu is not None
    np.testing.assert_allclose(read.imu.t, right.imu.t, atol=1e-9)
    np.testing.assert_allclose(read.gnss.t, right.gnss.t, atol=1e-9)


@pytest.mark.parametrize("rate", [0.2, 0.5, 0.8])
def test_a_sensor_that_is_really_slow_is_not_taken_for_one_in_milliseconds(folder: Folder, rate: float) -> None:
    """It lasts as long as its fixes, not a second."""
    count = round(900 * rate)
    read = folder.write(imu__csv=imu_csv(count, rate=rate), gps__csv=gps_csv(4500)).load()
    told = codes(read)
    assert "imu_too_slow" in told and not {"imu_time_unit", "gps_outside_imu"} & set(told)
    assert read.imu is None


@pytest.mark.parametrize("rate", [1.0, 2.0])
def test_a_compass_has_the_unit_of_the_imu_beside_it(folder: Folder, rate: float) -> None:
    """A period of 500 alone would be 0.5 ms."""
    count = round(10 * rate)
    mag = "\n".join(["t_s,mx,my,mz", *(f"{1e3 * k / rate:.1f},20.{k % 5},3.{k % 7},40.{k % 3}" for k in range(count))])
    files = {"imu__csv": imu_csv(1000, rate=0.1), "gps__csv": gps_csv(50, rate=0.005), "mag__csv": mag + "\n"}
    read = folder.write(**files).load()
    assert read.mag is not None and read.mag.t[-1] == pytest.approx(10.0 - 1.0 / rate)


def test_an_imu_of_a_kilohertz_may_be_in_milliseconds(folder: Folder) -> None:
    read = folder.write(imu__csv=imu_csv(10_000, rate=1.0), gps__csv=gps_csv(50, rate=0.005)).load()
    assert read.imu is not None and read.imu.t[-1] == pytest.approx(9.999)


def test_fixes_at_a_high_rate_have_the_unit_of_the_imu(folder: Folder) -> None:
    read = folder.write(imu__csv=imu_csv(1000, rate=0.1), gps__csv=gps_csv(500, rate=0.05)).load()
    assert read.gnss.t[-1] == pytest.approx(9.98)


@pytest.mark.parametrize("size", [1e3, 1e6])
def test_a_compass_may_be_in_seconds_beside_an_imu_that_is_not(folder: Folder, size: float) -> None:
    mag = "\n".join(["t_s,mx,my,mz", *(f"{k / 10:.1f},0.3,0.{k % 7},-0.4" for k in range(100))])
    files = {"imu__csv": imu_csv(1000, rate=100.0 / size), "gps__csv": gps_csv(), "mag__csv": mag + "\n"}
    read = folder.write(**files).load()
    assert read.mag is not None and read.mag.t[-1] == pytest.approx(9.9)
    assert "imu_time_unit" in codes(read) and "mag_time_unit" not in codes(read)


@pytest.mark.parametrize("size", [1e3, 1e6, 1e9])
def test_the_time_unit_of_fixes_follows_from_their_utc(folder: Folder, size: float) -> None:
    header, *rows = gps_csv().replace("\n", ",\n").splitlines()
    rows = [f"{size * k / 5:.0f},{row.partition(',')[2]}{1.7e9 + k / 5:.1f}" for k, row in enumerate(rows)]
    read = folder.write(gps__csv="\n".join([header + "unix_s", *rows]) + "\n").load()
    assert "gps_time_unit" in {problem.code for problem in read.problems}
    np.testing.assert_allclose(read.gnss.t, np.arange(50) / 5, atol=1e-6)


def test_an_axis_that_reads_0_on_every_straight_is_not_stuck(folder: Folder) -> None:
    """Some modules write 0 for whatever turns slower than their noise."""
    rows = imu_csv(8000).splitlines()
    turn = [max(0.0, np.sin(np.pi * k / 1200)) + 0.003 * (k % 7) for k in range(8000)]
    turn = [rate if rate > 0.05 else 0.0 for rate in turn]
    rows[1:] = [f"{row.rpartition(',')[0]},{rate:.3f}" for row, rate in zip(rows[1:], turn, strict=True)]
    raw = folder.write(imu__csv="\n".join(rows) + "\n", gps__csv=gps_csv(400)).load()
    assert raw.problems == () and raw.imu is not None and raw.imu.t.size == 8000


@pytest.mark.parametrize(("rate", "enough"), [(25.0, True), (20.0, True), (19.7, True), (19.0, False)])
def test_20_samples_a_second_are_enough(folder: Folder, rate: float, enough: bool) -> None:
    raw = folder.write(gps__csv=gps_csv(), imu__csv=imu_csv(200, rate=rate)).load()
    assert (raw.imu is not None) == enough and ("imu_too_slow" in codes(raw)) == (not enough)


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


def test_that_no_fix_has_a_height_is_reported(folder: Folder) -> None:
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
def test_an_imu_that_runs_on_long_without_fixes_is_reported(
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


def test_rows_in_no_order_at_all_are_those_in_order(folder: Folder) -> None:
    """From row to row they leap by a third of the session, which passed for a period in milliseconds."""
    rng = np.random.default_rng(0)
    rows = [f"{0.01 * i:.2f},{0.1 * i % 3:.3f},0,9.8,0,0,0.1\n" for i in range(12_000)]
    places = [f"{0.2 * i:.1f},{45 + 1e-5 * i:.7f},12\n" for i in range(600)]
    loaded = []
    for order in (False, True):
        if order:
            rng.shuffle(rows)
            rng.shuffle(places)
        imu, gps = "t_s,ax,ay,az,gx,gy,gz\n" + "".join(rows), "t_s,lat_deg,lon_deg\n" + "".join(places)
        loaded.append(folder.write(imu__csv=imu, gps__csv=gps).load())
    assert {"imu_reordered", "gps_reordered"} == set(codes(loaded[1])) - set(codes(loaded[0]))
    for ordered, shuffled in ((loaded[0].imu, loaded[1].imu), (loaded[0].gnss, loaded[1].gnss)):
        assert ordered is not None and shuffled is not None
        np.testing.assert_array_equal(shuffled.t, ordered.t)


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
        ("bicycle_neo6m", 2404, 0, {"imu_too_slow", "gps_gap", "recordings_unused"}),
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
