import numpy as np
import polars as pl
import pynmea2
import pytest

from smoother.calibration import load_calibration
from smoother.errors import SessionError, UsageError
from smoother.frames import geodetic_to_nwu, rotation_from_euler
from smoother.session.beside import read_mag
from smoother.session.csv_form import read_fixes, read_imu
from smoother.session.load import load_raw
from smoother.session.nmea import read_nmea
from smoother.session.settings import load_settings
from smoother.session.thesis import read_magcalib, read_out
from smoother.sim.record import nmea_sentences, write_csv, write_settings, write_thesis, write_title
from smoother.sim.scenario import Interval
from smoother.sim.simulation import simulate_preset
from smoother.units import DEG

FIX_COLUMNS = ("t", "lat_deg", "lon_deg", "alt_m", "speed", "course_deg", "sigma_horizontal", "sigma_up")


@pytest.fixture(scope="module")
def simulation():
    return simulate_preset("kart", 4, track="tinbarn", duration=80.0)


@pytest.fixture(scope="module")
def csv(simulation, tmp_path_factory):
    directory = tmp_path_factory.mktemp("csv")
    write_csv(simulation, directory)
    return directory


@pytest.fixture(scope="module")
def thesis(tmp_path_factory):
    simulation = simulate_preset("white", 4, duration=80.0)
    directory = tmp_path_factory.mktemp("thesis")
    write_thesis(simulation, directory)
    return simulation, directory


def test_samples_come_back_from_the_csv_form(simulation, csv):
    imu, problems = read_imu(csv / "imu.csv")
    raw = simulation.raw.imu
    assert problems == []
    np.testing.assert_allclose(imu.t, raw.t, atol=1e-9)
    np.testing.assert_allclose(imu.accel, raw.accel * raw.accel_scale, atol=1e-6)  # written to 1e-6 m/s^2
    np.testing.assert_allclose(imu.gyro, raw.gyro * raw.gyro_scale, atol=1e-8)
    mag, problems = read_mag(csv / "mag.csv")
    assert problems == []
    np.testing.assert_allclose(mag.t, simulation.raw.mag.t, atol=1e-9)
    np.testing.assert_allclose(mag.field, simulation.raw.mag.field, atol=1e-4)


def test_fixes_come_back_from_the_csv_form(simulation, csv):
    fixes, problems = read_fixes(csv / "gps.csv")
    assert problems == []
    for name in (*FIX_COLUMNS, "sigma_velocity", "hdop", "unix_s", "num_sv", "fix"):
        np.testing.assert_allclose(getattr(fixes, name), getattr(simulation.raw.gnss, name), atol=1e-4, err_msg=name)
    np.testing.assert_allclose(fixes.lat_deg, simulation.raw.gnss.lat_deg, atol=1e-9)
    np.testing.assert_allclose(fixes.velocity_n, simulation.raw.gnss.velocity_n, atol=1e-5)


def test_vertical_velocity_comes_back_where_the_receiver_sends_it(tmp_path):
    simulation = simulate_preset("kart", 4, duration=20.0, gnss_has_vertical_velocity=True)
    write_csv(simulation, tmp_path)
    fixes, _ = read_fixes(tmp_path / "gps.csv")
    np.testing.assert_allclose(fixes.velocity_n, simulation.raw.gnss.velocity_n, atol=1e-5)
    assert np.all(np.isfinite(fixes.velocity_n))


@pytest.mark.parametrize("preset", ["white", "kart", "kart_harsh"])
def test_directory_loads_as_a_session(preset, tmp_path):
    simulation = simulate_preset(preset, 1, duration=60.0)
    write_csv(simulation, tmp_path)
    raw = load_raw(tmp_path)
    assert raw.imu is not None and raw.mag is not None
    assert len(raw.imu.t) == len(simulation.raw.imu.t) and len(raw.gnss) == len(simulation.raw.gnss)


def test_sensors_left_out_leave_no_file(tmp_path):
    write_csv(simulate_preset("kart", 1, duration=20.0, mag=None, gnss_velocity=False), tmp_path)
    assert not (tmp_path / "mag.csv").exists()
    header = (tmp_path / "gps.csv").read_text().splitlines()[0].split(",")
    assert not {"speed_mps", "course_deg", "sacc_mps"} & set(header)


def test_truth_file_holds_antenna_and_attitude(simulation, csv):
    table = pl.read_csv(csv / "truth.csv")
    t = table["t_s"].to_numpy()
    np.testing.assert_allclose(np.diff(t), 0.02, atol=1e-9)
    arm, truth = simulation.scenario.lever_arm_b, simulation.truth
    position = geodetic_to_nwu(*(table[name].to_numpy() for name in ("lat_deg", "lon_deg", "alt_m")), truth.origin)
    np.testing.assert_allclose(position, truth.antenna_position_n(t, arm), atol=5e-5)
    velocity = table.select("vel_north_mps", "vel_west_mps", "vel_up_mps").to_numpy()
    np.testing.assert_allclose(velocity, truth.antenna_velocity_n(t, arm), atol=1e-6)
    angles = table.select("roll_deg", "pitch_deg", "yaw_deg").to_numpy() * DEG
    np.testing.assert_allclose(rotation_from_euler(*angles.T), truth.at(t).R_nb, atol=1e-7)
    assert np.all((angles[:, 2] > -np.pi) & (angles[:, 2] <= np.pi))


def test_true_laps_are_in_true_seconds(tmp_path):
    simulation = simulate_preset("kart", 2, track="tinbarn", duration=170.0, imu_clock_drift=0.01)
    write_csv(simulation, tmp_path)
    laps = pl.read_csv(tmp_path / "truth_laps.csv")
    assert laps["lap"].to_list() == [1, 2, 3, 4]
    np.testing.assert_allclose(laps["start_s"], simulation.lap_crossings()[:-1], atol=1e-6)
    stretched = (laps["end_s"] - laps["start_s"]).to_numpy()
    np.testing.assert_allclose(laps["lap_time_s"], stretched / 1.01, atol=3e-6)


def test_session_without_a_lap_has_an_empty_lap_table(tmp_path):
    write_csv(simulate_preset("white", 1, duration=10.0), tmp_path)
    assert pl.read_csv(tmp_path / "truth_laps.csv").height == 0


def test_calibrated_magnetometer_brings_its_calibration(tmp_path):
    simulation = simulate_preset("white", 1, duration=20.0, mag_noise=0.0)
    write_csv(simulation, tmp_path)
    mag = load_calibration(tmp_path / "calibration.toml").apply_to_mag(simulation.raw.mag)
    np.testing.assert_allclose(np.linalg.norm(mag.field_s, axis=1), 1.0, atol=1e-9)


def test_uncalibrated_magnetometer_has_none(csv):
    assert not (csv / "calibration.toml").exists()


def test_settings_state_the_true_values(simulation, tmp_path):
    write_settings(simulation, tmp_path / "session.toml")
    config, scenario = load_settings(tmp_path / "session.toml"), simulation.scenario
    np.testing.assert_allclose(config.mounting.lever_arm_b, scenario.lever_arm_b)
    np.testing.assert_allclose(config.mounting.R_bs, scenario.R_bs)
    assert config.imu.gyro_noise == scenario.imu.gyro_noise
    assert config.gps.velocity_latency == scenario.gnss.velocity_latency
    assert (config.track, config.date) == ("tinbarn", "2026-05-16")


def test_a_table_comes_with_what_the_low_pass_of_its_samples_delays(simulation, tmp_path):
    """As a log of the logger holds it; a delay beyond that is for the smoother to find."""
    path = tmp_path / "session.toml"
    for write in (write_title, write_settings):
        write(simulation, path, states_delay=True)
        assert load_settings(path).imu_delay == simulation.raw.config.imu_delay == 0.5 / simulation.scenario.imu.rate
        write(simulation, path)
        assert load_settings(path).imu_delay is None
    late = simulate_preset("kart", 1, duration=20.0, imu_latency=0.03)
    write_title(late, path, states_delay=True)
    assert load_settings(path).imu_delay is None


def test_fixes_come_back_from_sentences(simulation, tmp_path):
    path, fixes = tmp_path / "gps.nmea", simulation.raw.gnss
    lines = [f"{t:.6f},{s}\r\n" for i, t in enumerate(fixes.t) for s in nmea_sentences(fixes, ("RMC", "GGA"), i)]
    path.write_text("".join(lines), encoding="ascii", newline="")
    reading = read_nmea(path)
    assert len(reading.gnss) == len(fixes)
    np.testing.assert_allclose(reading.gnss.t, fixes.t, atol=1e-6)
    np.testing.assert_allclose(reading.gnss.lat_deg, fixes.lat_deg, atol=1e-9)  # the fixes were rounded already
    np.testing.assert_allclose(reading.gnss.lon_deg, fixes.lon_deg, atol=1e-9)
    np.testing.assert_allclose(reading.gnss.alt_m, fixes.alt_m, atol=1e-6)
    np.testing.assert_allclose(reading.gnss.speed, fixes.speed, atol=1e-6)
    np.testing.assert_allclose(reading.gnss.unix_s, fixes.unix_s, atol=1e-3)


@pytest.mark.parametrize("track", ["larkfield", "tinbarn", "longmeadow"])
def test_sentences_are_read_alike_by_an_independent_parser(track):
    fixes = simulate_preset("kart", 0, track=track, duration=5.0).raw.gnss
    for kind in ("RMC", "GGA"):
        message = pynmea2.parse(nmea_sentences(fixes, (kind,), 3)[0], check=True)
        assert message.latitude == pytest.approx(fixes.lat_deg[3], abs=1e-8)
        assert message.longitude == pytest.approx(fixes.lon_deg[3], abs=1e-8)
    vtg = pynmea2.parse(nmea_sentences(fixes, ("VTG",), 3)[0], check=True)
    assert vtg.spd_over_grnd_kmph == pytest.approx(fixes.speed[3] * 3.6, abs=1e-3)


def test_minutes_carry_into_the_degree():
    fixes = simulate_preset("white", 0, duration=2.0, gnss_white_horizontal=0.0).raw.gnss
    almost = type(fixes)(**{**vars(fixes), "lat_deg": np.full(len(fixes), 51.9999999999)})
    assert pynmea2.parse(nmea_sentences(almost, ("RMC",), 0)[0]).lat == "5200.00000"


def test_receiver_without_doppler_leaves_speed_and_course_empty():
    fixes = simulate_preset("kart", 0, duration=5.0, gnss_velocity=False).raw.gnss
    message = pynmea2.parse(nmea_sentences(fixes, ("RMC",), 0)[0], check=True)
    assert message.spd_over_grnd is None and message.true_course is None


def test_samples_come_back_from_the_thesis_files(thesis):
    simulation, directory = thesis
    out = read_out(directory / "out.txt")
    raw = simulation.raw
    assert out.problems == [] and len(out.imu.t) == len(raw.imu.t)
    late = raw.imu.t - out.imu.t
    assert np.min(late) > -1e-9 and np.max(late) < 1e-3 + 1e-9  # whole milliseconds, rounded down
    inside = np.max(np.abs(raw.imu.accel), axis=1) < 39.0
    np.testing.assert_allclose(
        (out.imu.accel * out.imu.accel_scale)[inside], raw.imu.accel[inside], atol=0.51 * out.imu.accel_scale
    )
    np.testing.assert_allclose(out.imu.gyro * out.imu.gyro_scale, raw.imu.gyro, atol=0.51 * out.imu.gyro_scale)


def test_fixes_and_field_come_back_from_the_thesis_files(thesis):
    simulation, directory = thesis
    out, raw = read_out(directory / "out.txt"), simulation.raw
    assert len(raw.gnss) - 1 <= len(out.gnss) <= len(raw.gnss)  # a fix after the last sample is not written
    n = len(out.gnss)
    np.testing.assert_allclose(out.gnss.lat_deg, raw.gnss.lat_deg[:n], atol=1e-7)  # 1e-5 minutes
    np.testing.assert_allclose(out.gnss.speed, raw.gnss.speed[:n], atol=3e-4)  # 0.001 knots
    assert np.max(np.abs(out.gnss.t - raw.gnss.t[:n])) < 0.0061  # carried by the next sample, whole milliseconds
    latest = np.searchsorted(raw.mag.t, raw.gnss.t[1:n], side="right") - 1
    np.testing.assert_allclose(out.mag.field[1:] * 0.15, raw.mag.field[latest], atol=0.076)


def test_calibration_readings_come_back_from_magcalib(thesis):
    simulation, directory = thesis
    field, problems = read_magcalib(directory / "magcalib.txt")
    assert problems == []
    np.testing.assert_allclose(field * 0.15, simulation.raw.mag_calibration_field, atol=0.076)


def test_heights_come_back_where_gga_is_asked_for(tmp_path):
    simulation = simulate_preset("kart", 1, duration=20.0)
    write_thesis(simulation, tmp_path, sentences=("RMC", "GGA"))
    out = read_out(tmp_path / "out.txt")
    np.testing.assert_allclose(out.gnss.alt_m, simulation.raw.gnss.alt_m[: len(out.gnss)], atol=1e-6)


def test_thesis_stamps_stay_in_order_under_strong_jitter(tmp_path):
    simulation = simulate_preset("kart_harsh", 1, duration=30.0)
    write_thesis(simulation, tmp_path)
    out = read_out(tmp_path / "out.txt")
    assert len(out.imu.t) == len(simulation.raw.imu.t)
    assert np.max(np.abs(out.imu.t - np.maximum(simulation.raw.imu.t, 0.0))) < 0.01


def test_session_the_thesis_format_cannot_hold_is_refused(tmp_path):
    for changes in ({"imu": None}, {"imu_rate": 2000.0}):
        with pytest.raises(UsageError, match="thesis' format"):
            write_thesis(simulate_preset("white", 1, duration=5.0, **changes), tmp_path)


def test_a_receiver_that_never_has_a_fix_writes_a_header_line(tmp_path):
    write_csv(simulate_preset("white", 4, duration=10.0, **{"gnss.outages": (Interval(-9.0, 99.0),)}), tmp_path)
    assert (tmp_path / "gps.csv").read_text().startswith("t_s,lat_deg,lon_deg")
    with pytest.raises(SessionError, match=r"^gps.csv: a header line, but no rows"):
        load_raw(tmp_path)
