"""The logger's files as sessions: units and axes, several files and recordings, and what is said about flaws."""

from dataclasses import replace

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session.load import load_raw, recordings
from smoother.session.log import imu_samples, list_recordings, mag_samples
from smoother.session.log_encode import encode
from smoother.session.log_format import (
    BLOCK_BYTES,
    GAP_NO_ROOM,
    IMU,
    MAG_OVERFLOW,
    PURPOSE_MAG_CALIBRATION,
    STOP_SUPPLY_LOW,
    Event,
    Gap,
    LogRecords,
    Setup,
)

G = 9.80665


def codes(raw):
    return [problem.code for problem in raw.problems]


def save(directory, name, records, session=1):
    (directory / name).write_bytes(encode(records, session))


def test_a_recording_is_a_session(tmp_path, make_records):
    records = make_records(duration=20.0)
    save(tmp_path, "LOG00001.KLG", records)
    raw = load_raw(tmp_path)
    assert raw.inputs == ("LOG00001.KLG",)
    assert len(raw.imu.t) == 4000 and len(raw.gnss) == 100
    assert raw.imu.accel_full_scale == pytest.approx(16 * G)
    assert raw.gnss.sigma_horizontal[0] == pytest.approx(np.sqrt(0.5 * (1.9**2 + 1.7**2)))  # of GST
    np.testing.assert_allclose(raw.gnss.t, 2.1 + 0.2 * np.arange(100), atol=1e-6)
    assert raw.name == tmp_path.name


def test_counts_become_physical_units(make_records):
    records = make_records()
    imu, problems = imu_samples(records, "x.klg")
    assert problems == []
    np.testing.assert_allclose(imu.accel[:, 2] * imu.accel_scale, records.imu[:, 2] / 2048 * G)
    np.testing.assert_allclose(imu.gyro[:, 0] * imu.gyro_scale, np.radians(records.imu[:, 3] * (1000 / 32768)))
    np.testing.assert_allclose(imu.temperature, 21 + 1335 / 333.87)


def test_samples_are_dated_back_by_the_delay_of_the_low_pass(make_records):
    """Read at t it is the mean around t - 3.9 ms; the mean that a sample of RawImu holds is around t - period / 2."""
    records = make_records(rate=200)
    imu, _ = imu_samples(records, "x.klg")
    np.testing.assert_allclose(imu.t - records.imu_t / 1e6, -0.0039 + 0.0025, atol=1e-9)


def test_a_delay_that_is_stated_beside_a_log_is_not_taken_off_twice(tmp_path, make_records):
    save(tmp_path, "LOG00001.KLG", make_records(duration=20.0))
    plain = load_raw(tmp_path)
    (tmp_path / "session.toml").write_text("[imu]\ndelay = 0.0039\n")
    stated = load_raw(tmp_path)
    np.testing.assert_array_equal(stated.imu.t, plain.imu.t)
    assert [p.code for p in stated.problems if p not in plain.problems] == ["imu_delay_known"]


def test_the_compass_is_turned_to_the_axes_of_the_imu_and_adjusted():
    setup = Setup(mag_adjustment=bytes([128, 192, 64]))
    records = LogRecords(
        setup, mag_t=np.array([10]), mag=np.array([[100, 200, 300]], np.int16), mag_flags=np.zeros(1, np.uint8)
    )
    mag, _ = mag_samples(records, "x.klg")
    x, y, z = 100 * 1.0 * 0.15, 200 * 1.25 * 0.15, 300 * 0.75 * 0.15
    np.testing.assert_allclose(mag.field, [[y, x, -z]])


def test_overflowed_readings_of_the_compass_are_dropped_and_counted(make_records):
    records = make_records()
    flags = records.mag_flags.copy()
    flags[5:8] = MAG_OVERFLOW
    mag, problems = mag_samples(replace(records, mag_flags=flags), "x.klg")
    assert len(mag.t) == len(records.mag_t) - 3
    assert [(p.code, p.count) for p in problems] == [("mag_overflow", 3)]


def test_files_of_one_recording_are_joined_whatever_their_order(tmp_path, make_records):
    image = encode(make_records(duration=20.0), 9)
    cut = 60 * BLOCK_BYTES
    (tmp_path / "B.KLG").write_bytes(image[:cut])
    (tmp_path / "a.klg").write_bytes(image[cut:])
    raw = load_raw(tmp_path)
    assert raw.inputs == ("B.KLG", "a.klg")
    assert len(raw.imu.t) == 4000
    assert "log_blocks_lost" not in codes(raw)
    assert len(load_raw(tmp_path / "a.klg").imu.t) == 4000


def test_several_recordings_are_listed_and_one_has_to_be_named(tmp_path, make_records):
    for number in (1, 2, 3):
        save(tmp_path, f"LOG0000{number}.KLG", make_records(duration=10.0 + number), number)
    assert [files.name for files in recordings(tmp_path)] == ["LOG00001", "LOG00002", "LOG00003"]
    with pytest.raises(SessionError, match=r"holds 3 recordings \(LOG00001.KLG, LOG00002.KLG, LOG00003.KLG\)"):
        load_raw(tmp_path)
    raw = load_raw(tmp_path / "LOG00002.KLG")
    assert raw.name == "LOG00002" and len(raw.imu.t) == 2400


def test_blocks_of_an_older_recording_behind_the_end_are_left_out(tmp_path, make_records):
    older = encode(make_records(duration=30.0, seed=2), 1)
    image = encode(replace(make_records(duration=15.0), stop=None), 2)
    (tmp_path / "LOG00009.KLG").write_bytes(image + older[len(image) :])
    raw = load_raw(tmp_path)
    assert len(raw.imu.t) == 3000
    assert codes(raw) == ["log_serial_lost", "log_not_stopped"]


def test_a_calibration_gives_the_field_and_is_no_drive(tmp_path, make_records):
    drive = make_records(duration=10.0)
    early, late = (replace(make_records(duration=5.0, seed=s), sentences=()) for s in (5, 6))
    save(tmp_path, "LOG00001.KLG", replace(early, setup=Setup(PURPOSE_MAG_CALIBRATION, boot_number=1)), 1)
    save(tmp_path, "LOG00002.KLG", replace(drive, setup=replace(drive.setup, boot_number=2)), 2)
    save(tmp_path, "LOG00003.KLG", replace(late, setup=Setup(PURPOSE_MAG_CALIBRATION, boot_number=3)), 3)
    raw = load_raw(tmp_path)
    assert raw.inputs == ("LOG00002.KLG", "LOG00001.KLG")
    np.testing.assert_allclose(raw.mag_calibration_field[:, 0], early.mag[:, 1] * 0.15)
    (tmp_path / "LOG00002.KLG").unlink()
    with pytest.raises(SessionError, match="only calibrations of the magnetometer"):
        load_raw(tmp_path)


def test_what_the_logger_lost_is_reported_with_its_cause(tmp_path, make_records):
    records = make_records(duration=20.0)
    gap = Gap(IMU, GAP_NO_ROOM, 100, int(records.imu_t[1000]), int(records.imu_t[1099]))
    keep = np.r_[0:1000, 1100 : len(records.imu_t)]
    events = (Event(3_000_000, 1, 5), Event(4_000_000, 9, 3), Event(5_000_000, 13, 1))
    stop = replace(records.stop, reason=STOP_SUPPLY_LOW)
    holed = replace(records, imu_t=records.imu_t[keep], imu=records.imu[keep], gaps=(gap,), events=events, stop=stop)
    save(tmp_path, "LOG.KLG", holed)
    raw = load_raw(tmp_path)
    texts = {problem.code: (problem.count, problem.text) for problem in raw.problems}
    assert texts["log_card_stalled"][0] == 100
    assert (
        "100 IMU samples lost because the card did not take them in time (1 gap, the longest 0.495 s)"
        in (texts["log_card_stalled"][1])
    )
    assert {"log_card_lost", "log_config_rejected", "log_stopped", "imu_gap"} <= set(texts)
    assert "log_button" not in texts


def test_damage_is_counted_in_blocks_and_samples(tmp_path, make_records):
    image = bytearray(encode(make_records(duration=20.0), 1))
    image[20 * BLOCK_BYTES + 100] ^= 4
    (tmp_path / "LOG.KLG").write_bytes(image)
    raw = load_raw(tmp_path)
    (problem,) = (problem for problem in raw.problems if problem.code == "log_blocks_lost")
    assert problem.count == 1
    assert f"1 block damaged or missing, {4000 - len(raw.imu.t)} IMU samples in them" in problem.text


def test_without_settings_the_defaults_are_taken_and_reported(tmp_path, make_records):
    save(tmp_path, "LOG.KLG", replace(make_records(duration=10.0), setup=None))
    assert "log_setup_missing" in codes(load_raw(tmp_path))


def test_a_log_without_imu_is_smoothed_from_gps(tmp_path, make_records):
    records = make_records(duration=10.0)
    save(tmp_path, "LOG.KLG", replace(records, imu_t=records.imu_t[:0], imu=records.imu[:0]))
    raw = load_raw(tmp_path)
    assert raw.imu is None and "imu_missing" in codes(raw)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "no whole block of a recording"),
        (bytes(5000), "no whole block of a recording"),
        (b"KLG\x01" * 400, "no whole block of a recording"),
    ],
)
def test_a_file_without_a_block_is_one_clear_line(tmp_path, content, said):
    (tmp_path / "LOG.KLG").write_bytes(content)
    for path in (tmp_path, tmp_path / "LOG.KLG"):
        with pytest.raises(SessionError, match=said):
            load_raw(path)


def test_a_file_without_a_block_beside_a_recording_is_reported(tmp_path, make_records):
    save(tmp_path, "LOG00001.KLG", make_records(duration=10.0))
    (tmp_path / "LOG00002.KLG").write_bytes(bytes(4096))
    texts = [problem.text for problem in load_raw(tmp_path).problems if problem.code == "log_unusable"]
    assert texts == ["LOG00002.KLG: no whole block of a recording; left out"]


def test_a_log_without_sentences_is_one_clear_line(tmp_path, make_records):
    save(tmp_path, "LOG.KLG", replace(make_records(), sentences=()))
    with pytest.raises(SessionError, match=r"LOG.KLG: no NMEA sentence"):
        load_raw(tmp_path)


def test_a_damaged_head_does_not_hide_the_recording(tmp_path, make_records):
    image = bytearray(encode(make_records(duration=60.0), 5))
    image[: 600 * BLOCK_BYTES] = bytes(600 * BLOCK_BYTES)
    (tmp_path / "LOG.KLG").write_bytes(image)
    (files,) = list_recordings([tmp_path / "LOG.KLG"])
    assert files.session == 5 and files.setup is not None
    assert len(load_raw(tmp_path).gnss) > 20


def test_a_log_of_any_name_is_known_by_its_content(tmp_path, make_records):
    save(tmp_path, "backup.bin", make_records(duration=10.0))
    assert len(load_raw(tmp_path / "backup.bin").imu.t) == 2000


def test_every_cut_of_a_file_gives_a_session_or_one_line(tmp_path, make_records):
    image = encode(make_records(duration=3.0), 1)
    loaded = 0
    for size in range(0, len(image) + 1, 499):  # no divisor of a block: every part of one is cut
        (tmp_path / "LOG.KLG").write_bytes(image[:size])
        try:
            load_raw(tmp_path)
            loaded += 1
        except SessionError as error:
            assert "\n" not in str(error)
    assert loaded > 20


@pytest.mark.parametrize("of_older", [slice(64, 128), slice(3, 67)])
def test_an_older_cluster_in_place_of_the_first_costs_that_cluster_alone(tmp_path, make_records, of_older):
    image = encode(make_records(duration=60.0), 2)
    older = encode(make_records(duration=60.0), 1)
    size = BLOCK_BYTES * 64
    begin = BLOCK_BYTES * of_older.start
    (tmp_path / "LOG00002.KLG").write_bytes(older[begin : begin + size] + image[size:])
    raw = load_raw(tmp_path)
    assert raw.imu.t[-1] - raw.imu.t[0] > 50.0 and raw.imu.t[0] > 3.0


def test_damage_of_another_kind_is_not_taken_for_a_transfer_as_text(tmp_path, make_records):
    data = bytearray(encode(make_records(duration=20.0), 1))
    data[300 :: 2 * BLOCK_BYTES] = bytes(1 ^ byte for byte in data[300 :: 2 * BLOCK_BYTES])
    (tmp_path / "LOG00001.KLG").write_bytes(data)
    assert "log_blocks_lost" in codes(load_raw(tmp_path)) and "log_copied_as_text" not in codes(load_raw(tmp_path))
