import numpy as np
import pytest

from smoother.errors import UsageError
from smoother.session.load import load_raw
from smoother.session.log import list_recordings, read_records
from smoother.sim.record_log import CALIBRATION_FILE, DRIVE_FILE, write_klg
from smoother.sim.scenario import Interval
from smoother.sim.simulation import simulate_preset


@pytest.fixture(scope="module")
def kart(tmp_path_factory):
    simulation = simulate_preset("kart", 4, track="tinbarn", duration=60.0)
    directory = tmp_path_factory.mktemp("klg")
    write_klg(simulation, directory)
    return simulation, directory


def records_of(path):
    return read_records(list_recordings([path])[0])


def test_counts_and_times_come_back_exactly(kart):
    simulation, directory = kart
    imu, (records, losses) = simulation.raw.imu, records_of(directory / DRIVE_FILE)
    np.testing.assert_array_equal(records.imu_t, np.round(imu.t * 1e6))
    np.testing.assert_array_equal(records.imu, np.hstack([imu.accel, imu.gyro]))  # ranges of the chip: 16 g, 1000 deg/s
    assert losses.blocks == losses.samples == 0
    assert records.stop.imu_records == len(imu.t)


def test_the_session_is_that_of_the_simulation(kart):
    simulation, directory = kart
    raw, true = load_raw(directory), simulation.raw
    np.testing.assert_allclose(raw.imu.accel * raw.imu.accel_scale, true.imu.accel * true.imu.accel_scale)
    np.testing.assert_allclose(raw.mag.field, true.mag.field, atol=0.076)  # half a count
    np.testing.assert_allclose(raw.gnss.t, true.gnss.t, atol=1e-6)
    for name, tolerance in (("lat_deg", 1e-9), ("alt_m", 1e-6), ("speed", 1e-6), ("sigma_horizontal", 0.051)):
        np.testing.assert_allclose(getattr(raw.gnss, name), getattr(true.gnss, name), atol=tolerance, err_msg=name)
    assert np.all(np.isnan(raw.gnss.sigma_velocity))  # without a vertical velocity there is no NAV-VELNED
    assert (directory / "truth.csv").exists() and (directory / "truth_laps.csv").exists()


def test_velocity_with_its_accuracy_is_that_of_the_simulation(tmp_path):
    simulation = simulate_preset("kart", 4, track="tinbarn", duration=20.0, gnss_has_vertical_velocity=True)
    write_klg(simulation, tmp_path)
    fixes, true = load_raw(tmp_path).gnss, simulation.raw.gnss
    np.testing.assert_allclose(fixes.velocity_n, true.velocity_n, atol=0.0051)
    np.testing.assert_allclose(fixes.sigma_velocity, true.sigma_velocity, atol=0.0051)
    np.testing.assert_allclose(fixes.t, true.t, atol=1e-6)


@pytest.mark.parametrize(("preset", "accel", "gyro"), [("white", 16, 2000), ("kart", 16, 1000), ("kart_harsh", 8, 500)])
def test_ranges_are_the_smallest_of_the_sensor_that_hold_the_simulation(tmp_path, preset, accel, gyro):
    write_klg(simulate_preset(preset, 1, duration=6.0), tmp_path)
    setup = records_of(tmp_path / DRIVE_FILE)[0].setup
    assert (setup.accel_range_g, setup.gyro_range_dps) == (accel, gyro)
    assert (setup.gyro_lowpass_hz, setup.imu_period_us, setup.gps_period_us) == (92, 5000, 200000)


def test_the_same_simulation_writes_the_same_bytes(kart, tmp_path):
    _, directory = kart
    write_klg(simulate_preset("kart", 4, track="tinbarn", duration=60.0), tmp_path)
    assert (tmp_path / DRIVE_FILE).read_bytes() == (directory / DRIVE_FILE).read_bytes()


def test_readings_for_the_calibration_are_a_recording_of_their_own(tmp_path):
    simulation = simulate_preset("white", 2, duration=30.0)
    write_klg(simulation, tmp_path)
    raw = load_raw(tmp_path)
    assert raw.inputs == (DRIVE_FILE, CALIBRATION_FILE)
    np.testing.assert_allclose(raw.mag_calibration_field, simulation.raw.mag_calibration_field, atol=0.076)


def test_a_stretch_without_samples_is_a_gap_with_its_count(tmp_path):
    gaps = (Interval(10.0, 0.25), Interval(20.0, 0.05))
    write_klg(simulate_preset("white", 2, duration=30.0, imu_gaps=gaps), tmp_path)
    records, losses = records_of(tmp_path / DRIVE_FILE)
    assert [gap.count for gap in records.gaps] == [50, 10]
    assert len(records.imu_t) == 30 * 200 - 60
    assert losses.samples == 0


@pytest.mark.parametrize(
    "changes", [{"imu": None}, {"mag": None}, {"gnss_velocity": False}, {"gnss_hacc_factor": None}]
)
def test_what_the_simulation_leaves_out_the_log_leaves_out(tmp_path, changes):
    simulation = simulate_preset("kart", 2, duration=20.0, **changes)
    write_klg(simulation, tmp_path)
    raw = load_raw(tmp_path)
    assert (raw.imu is None, raw.mag is None) == (simulation.raw.imu is None, simulation.raw.mag is None)
    assert np.isnan(raw.gnss.speed).all() == np.isnan(simulation.raw.gnss.speed).all()
    assert np.isnan(raw.gnss.sigma_horizontal).all() == np.isnan(simulation.raw.gnss.sigma_horizontal).all()


@pytest.mark.parametrize(
    ("changes", "said"), [({"imu_rate": 2000.0}, "at most 1000"), ({"imu_clock_offset": -50.0}, "starts at 0")]
)
def test_what_the_logger_cannot_record_is_refused(tmp_path, changes, said):
    with pytest.raises(UsageError, match=said):
        write_klg(simulate_preset("kart", 1, duration=5.0, **changes), tmp_path)
