"""out.txt and magcalib.txt: every ambiguity of the layout, and every way to lose a part of the file."""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session.thesis import (
    ACCEL_SCALE,
    END_STRUCT,
    GPS_FLAG,
    GYRO_SCALE,
    IMU_STRUCT,
    MAG_STRUCT,
    RECORD_START,
    find_records,
    read_magcalib,
    read_out,
)

BLOCK = 96


@dataclass
class Writer:
    """Writes records as the thesis' firmware does: 50 Hz, GPS every tenth record."""

    flag: bytes = b""
    block_length: int = BLOCK
    gps_every: int = 10
    start_ms: int = 1000
    busy_ms: int = 3
    counts: list[tuple[int, ...]] = field(default_factory=list)
    times: list[int] = field(default_factory=list)

    def record(self, k: int) -> bytes:
        ms = self.start_ms + 20 * k
        counts = (k % 300, -k % 300, 8192, 10 * (k % 7), -5, 3)
        self.counts.append(counts)
        self.times.append(ms)
        head = RECORD_START + IMU_STRUCT.pack(ms % 2**32, *counts)
        end = END_STRUCT.pack((ms + self.busy_ms) % 2**32)
        if self.gps_every == 0 or k % self.gps_every:
            return head + self.flag + end
        block = sentence(k // self.gps_every).ljust(self.block_length, b"\x00")[: self.block_length]
        return head + bytes([GPS_FLAG]) + MAG_STRUCT.pack(20 + k % 50, -30, 40) + block + end

    def write(self, count: int) -> bytes:
        return b"".join(self.record(k) for k in range(count))


def sentence(fix: int) -> bytes:
    tod = 36000.0 + 0.2 * fix
    clock = f"{int(tod // 3600):02d}{int(tod % 3600 // 60):02d}{tod % 60:05.2f}"
    body = f"GPRMC,{clock},A,4502.{70000 + fix:05d},N,01208.94000,E,10.0,45.0,310524,,,A"
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()


def save(directory: Path, data: bytes, name: str = "out.txt") -> Path:
    path = directory / name
    path.write_bytes(data)
    return path


def codes(problems: list) -> dict[str, int]:
    return {problem.code: problem.count for problem in problems}


@pytest.mark.parametrize("flag", [b"", b"\x00", b"\x01"])
def test_records_come_back_with_and_without_the_optional_flag_byte(tmp_path: Path, flag: bytes) -> None:
    writer = Writer(flag)
    out = read_out(save(tmp_path, writer.write(200)))
    assert out.problems == []
    np.testing.assert_allclose(out.imu.t, np.array(writer.times) / 1000.0, rtol=1e-12)
    np.testing.assert_array_equal(np.hstack([out.imu.accel, out.imu.gyro]), writer.counts)
    assert len(out.gnss) == 20
    np.testing.assert_allclose(out.gnss.t, out.imu.t[::10])
    np.testing.assert_allclose(out.gnss.speed, 10.0 * 1852 / 3600)


def test_scales_are_those_of_4_g_and_500_degrees_per_second(tmp_path: Path) -> None:
    imu = read_out(save(tmp_path, Writer().write(100))).imu
    assert imu.accel_scale == ACCEL_SCALE == 4 * 9.80665 / 32768
    assert imu.gyro_scale == GYRO_SCALE == pytest.approx(np.radians(500) / 32768)
    assert imu.accel_full_scale == pytest.approx(4 * 9.80665)


def test_magnetometer_triples_are_my_mx_and_minus_mz(tmp_path: Path) -> None:
    mag = read_out(save(tmp_path, Writer().write(100))).mag
    np.testing.assert_array_equal(mag.field[1], [-30.0, 20.0 + 10, -40.0])


@pytest.mark.parametrize("block_length", [75, 81, 82, 128, 255, 512])
def test_the_block_length_is_found_whatever_the_receivers_buffer(block_length: int) -> None:
    # 81 = 5 x 22 - 29: a record with GPS is then as long as five without, and only the count of records tells them
    records = find_records(Writer(block_length=block_length).write(300))
    assert records.block_length == block_length
    assert records.position.size == 300 and np.count_nonzero(records.has_gps) == 30
    assert (records.lost, records.tail) == (0, 0)


@pytest.mark.parametrize("flag", [b"", b"\x00"])
def test_an_end_time_whose_low_byte_is_the_gps_flag_is_not_taken_for_it(flag: bytes) -> None:
    writer = Writer(flag, start_ms=0x71 - 3)  # 20 ms steps come back to a low byte of 0x71 every 64 records
    records = find_records(writer.write(400))
    assert records.position.size == 400 and np.count_nonzero(records.has_gps) == 40
    assert records.lost == 0


def test_start_bytes_inside_the_data_do_not_start_a_record(tmp_path: Path) -> None:
    writer = Writer(start_ms=0x595900)  # the middle bytes of 13 start and end times in a row are YY
    data = bytearray(writer.write(100))
    for start in find_records(bytes(data)).position.tolist()[::3]:
        data[start + 6 : start + 18] = b"Y" * 12
    records = find_records(bytes(data))
    assert records.position.size == 100 and records.lost == 0
    assert len(read_out(save(tmp_path, bytes(data))).gnss) == 10


def test_a_file_cut_at_any_byte_loses_at_most_its_last_record() -> None:
    for flag in (b"", b"\x00"):
        data = Writer(flag).write(41)
        whole = find_records(data)
        ends = np.append(whole.position[1:], len(data))
        for size in range(int(ends[12]), len(data) + 1):
            records = find_records(data[:size])
            complete = int(np.count_nonzero(ends <= size))
            assert complete - records.position.size <= 0 or records.block_length is None
            np.testing.assert_array_equal(records.position, whole.position[: records.position.size])


def test_every_cut_of_a_small_file_gives_a_session_or_one_clear_error(tmp_path: Path) -> None:
    data = Writer(gps_every=4).write(9)
    for size in range(len(data)):
        try:
            out = read_out(save(tmp_path, data[:size]))
        except SessionError as error:
            assert str(error).startswith("out.txt: ") and "\n" not in str(error)
        else:
            assert out.imu.t.size <= 9 and 1 <= len(out.gnss) <= 3


def test_a_lost_sector_costs_its_records_and_is_counted(tmp_path: Path) -> None:
    data = Writer().write(500)
    out = read_out(save(tmp_path, data[:3000] + data[3512:]))
    assert codes(out.problems)["out_unresolved"] == 1
    lost_records = 512 / (len(data) / 500)
    assert 500 - out.imu.t.size <= lost_records + 8  # and the GPS record at either edge
    assert np.all(np.diff(out.imu.t) > 0)


def test_flipped_bytes_cost_little_and_never_the_order(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    data = bytearray(Writer().write(600))
    for place in rng.integers(0, len(data), 40):
        data[place] = rng.integers(0, 256)
    out = read_out(save(tmp_path, bytes(data)))
    assert out.imu.t.size > 540  # each flip costs at most its own record and the one before


def test_garbage_before_and_zeros_behind_the_records_are_passed_over(tmp_path: Path) -> None:
    data = Writer().write(200)
    out = read_out(save(tmp_path, b"\xff\x12Y\x00" * 9 + data + bytes(700)))
    assert 199 <= out.imu.t.size <= 200
    assert len(out.gnss) == 20


def test_what_the_buffer_held_before_is_not_read_again(tmp_path: Path) -> None:
    writer = Writer(block_length=200)
    data = writer.write(200)
    old = (sentence(3) * 4)[20:]  # starts inside a sentence, as the rest of an older, longer content does
    for start in find_records(data).position[find_records(data).has_gps].tolist():
        head = data[start : start + 25]
        text = data[start + 25 : start + 225].rstrip(b"\x00")
        data = data[:start] + head + (text + old)[:200] + data[start + 225 :]
    out = read_out(save(tmp_path, data))
    assert len(out.gnss) == 20 and out.problems == []


def test_a_file_without_gps_records_is_refused_in_one_line(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"^out.txt: .*no NMEA sentence"):
        read_out(save(tmp_path, Writer(gps_every=0).write(100)))


@pytest.mark.parametrize("data", [b"", b"hello", bytes(1000), b"Y" * 500])
def test_a_file_of_something_else_is_one_clear_error(tmp_path: Path, data: bytes) -> None:
    with pytest.raises(SessionError, match=r"^out.txt: "):
        read_out(save(tmp_path, data))


@pytest.mark.parametrize("marks", [b"Y", b"YY"])
@pytest.mark.parametrize("before_each", [True, False])
def test_magcalib_is_read_with_one_or_two_start_bytes_once_or_before_each(
    tmp_path: Path, marks: bytes, before_each: bool
) -> None:
    rng = np.random.default_rng(1)
    triples = rng.integers(-400, 400, (500, 3))
    packed = [struct.pack("<3h", *triple) for triple in triples.tolist()]
    data = b"".join(marks + p for p in packed) if before_each else marks + b"".join(packed)
    field_s, problems = read_magcalib(save(tmp_path, data, "magcalib.txt"))
    expected = np.stack([triples[:, 1], triples[:, 0], -triples[:, 2]], axis=1)
    np.testing.assert_array_equal(field_s, expected)
    assert problems == []


def test_a_cut_magcalib_loses_its_last_triple_with_a_problem(tmp_path: Path) -> None:
    data = b"YY" + struct.pack("<3h", 1, 2, 3) * 50
    field_s, problems = read_magcalib(save(tmp_path, data[:-1], "magcalib.txt"))
    assert field_s is not None and field_s.shape == (49, 3)
    assert codes(problems) == {"magcalib_truncated": 5}
