"""UBX: fixes of NAV-PVT among other messages, what is unknown in them, and what is damaged."""

import struct
from pathlib import Path

import numpy as np
import pytest

from smoother.errors import SessionError
from smoother.session.load import load_raw
from smoother.session.readers.ubx import read_ubx

from .folders import nmea_epochs

COUNT = 60
HEAD = b"\xb5\x62\x01\x07\x5c\x00"  # class, number, length; u-blox, Interface Description M8, UBX-NAV-PVT
NAV_PVT = np.dtype(
    [
        *(("itow_ms", "<u4"), ("year", "<u2"), ("month", "u1"), ("day", "u1"), ("hour", "u1"), ("minute", "u1")),
        *(("second", "u1"), ("valid", "u1"), ("time_accuracy_ns", "<u4"), ("nano", "<i4"), ("fix", "u1")),
        *(("flags", "u1"), ("flags2", "u1"), ("satellites", "u1"), ("lon_1e7", "<i4"), ("lat_1e7", "<i4")),
        *(("ellipsoid_mm", "<i4"), ("height_mm", "<i4"), ("hacc_mm", "<u4"), ("vacc_mm", "<u4"), ("north_mm", "<i4")),
        *(("east_mm", "<i4"), ("down_mm", "<i4"), ("speed_mm", "<i4"), ("course_1e5", "<i4"), ("sacc_mm", "<u4")),
        *(("course_accuracy_1e5", "<u4"), ("pdop", "<u2"), ("rest", "V14")),
    ]
)
ACK = b"\xb5\x62\x05\x01\x02\x00\x06\x01\x0f\x38"
WEEK_MS = 604_800_000


def message(k: int, start_ms: int = 208_000_000, **other: int) -> bytes:
    """10 Hz, on 11 April 2026 from 10:00:00, north-east at 10 m/s, climbing."""
    pvt = np.zeros(1, NAV_PVT)
    values = {
        **{"itow_ms": (start_ms + 100 * k) % WEEK_MS, "year": 2026, "month": 4, "day": 11, "hour": 10},
        **{"second": k // 10, "nano": k % 10 * 100_000_000, "valid": 0x37, "fix": 3, "flags": 1, "satellites": 12},
        **{"lat_1e7": 450_000_000 + 64 * k, "lon_1e7": -1_220_000_000 + 90 * k, "height_mm": 96_000 + 10 * k},
        **{"hacc_mm": 1200, "vacc_mm": 2000, "sacc_mm": 300, "north_mm": 7071, "east_mm": 7071, "down_mm": -100},
        **{"speed_mm": 10_000, "course_1e5": 4_500_000},
    }
    for name, value in (values | other).items():
        pvt[name] = value
    body = HEAD[2:] + pvt.tobytes()
    first = second = 0
    for byte in body:
        first = (first + byte) % 256
        second = (second + first) % 256
    return HEAD[:2] + body + bytes([first, second])


def write(directory: Path, *parts: bytes) -> Path:
    path = directory / "log.ubx"
    path.write_bytes(b"".join(parts))
    return path


def test_fixes_come_with_velocities_heights_and_what_they_are_sure_by(tmp_path: Path) -> None:
    path = write(tmp_path, b"\x62\xb5\xb5", ACK, *(message(k) + ACK for k in range(COUNT)))
    for named in (tmp_path, path):
        assert len(load_raw(named).gnss) == COUNT
    reading = read_ubx(path)
    gnss = reading.gnss
    np.testing.assert_allclose(gnss.t, 0.1 * np.arange(COUNT), atol=1e-9)
    np.testing.assert_allclose(gnss.lat_deg, 45.0 + 6.4e-6 * np.arange(COUNT), atol=1e-9)
    np.testing.assert_allclose(gnss.lon_deg, -122.0 + 9.0e-6 * np.arange(COUNT), atol=1e-9)
    np.testing.assert_allclose(gnss.velocity_n, [[7.071, -7.071, 0.1]] * COUNT, atol=1e-9)
    np.testing.assert_allclose(gnss.unix_s, 1_775_901_600.0 + gnss.t, atol=1e-6)
    np.testing.assert_allclose(gnss.alt_m, 96.0 + 0.01 * np.arange(COUNT), atol=1e-9)
    assert gnss.sigma_horizontal[0] == 1.2 and gnss.sigma_up[0] == 2.0 and gnss.sigma_velocity[0] == 0.3
    assert gnss.num_sv[0] == 12 and gnss.fix[0] == 3 and reading.problems == []


@pytest.mark.parametrize("other", [{"fix": 0}, {"fix": 5}, {"flags": 0}, {"fix": 1}])
def test_what_is_no_fix_is_none(tmp_path: Path, other: dict[str, int]) -> None:
    path = write(tmp_path, *(message(k, **(other if k < 10 else {})) for k in range(COUNT)))
    assert len(read_ubx(path).gnss) == COUNT - 10


def test_messages_that_were_written_twice_cost_nothing(tmp_path: Path) -> None:
    every = [message(k) for k in range(COUNT)]
    twice = every[: COUNT // 2] + every + every[COUNT // 4 :]
    assert len(read_ubx(write(tmp_path, *twice)).gnss) == COUNT
    others = [message(k // 3, lat_1e7=450_000_000 + 64 * k) for k in range(3 * COUNT)]
    with pytest.raises(SessionError, match="repeat the time of another"):
        read_ubx(write(tmp_path, *others))


def test_the_week_ends_and_utc_is_not_known_yet(tmp_path: Path) -> None:
    start = WEEK_MS - 3000
    path = write(tmp_path, *(message(k, start, valid=0x37 if k > 20 else 0x01) for k in range(COUNT)))
    gnss = read_ubx(path).gnss
    np.testing.assert_allclose(gnss.t, 0.1 * np.arange(COUNT), atol=1e-6)
    assert np.isnan(gnss.unix_s[:21]).all() and np.isfinite(gnss.unix_s[21:]).all()


def test_damaged_messages_are_counted_and_a_cut_one_left(tmp_path: Path) -> None:
    messages = [message(k) for k in range(COUNT)]
    messages[7] = messages[7][:50] + b"\xff" + messages[7][51:]
    reading = read_ubx(write(tmp_path, *messages, messages[0][:60]))
    assert len(reading.gnss) == COUNT - 1
    assert [problem.text for problem in reading.problems] == ["log.ubx: 1 UBX message with a wrong checksum; left out"]


def framed(kind: int, number: int, payload: bytes) -> bytes:
    """A message of a class and number, with its checksum."""
    body = bytes([kind, number]) + struct.pack("<H", len(payload)) + payload
    first = second = 0
    for byte in body:
        first = (first + byte) % 256
        second = (second + first) % 256
    return b"\xb5\x62" + body + bytes([first, second])


def test_old_receivers_send_place_velocity_and_quality_apart(tmp_path: Path) -> None:
    """NAV-POSLLH, NAV-VELNED and NAV-SOL of one moment are one fix, whichever comes first; without a place none."""
    parts = []
    for k in range(COUNT):
        itow = 208_000_000 + 200 * k
        place = struct.pack(
            "<IiiiiII", itow, -1_220_000_000 + 180 * k, 450_000_000 + 128 * k, 60_000, 12_000, 2500, 4000
        )
        velocity = struct.pack("<IiiiIIiII", itow, 707, 707, 10, 1000, 1000, 4_500_000, 40, 100_000)
        quality = struct.pack("<IihBBiiiIiiiIHBBI", itow, 0, 2000, 3, 0x0D, 0, 0, 0, 0, 0, 0, 0, 0, 120, 0, 9, 0)
        sent = [framed(1, 2, place), framed(1, 0x12, velocity), framed(1, 6, quality)]
        parts += sent[::-1] if k % 2 else sent
    parts.append(framed(1, 0x12, velocity))
    gnss = read_ubx(write(tmp_path, *parts)).gnss
    assert len(gnss) == COUNT
    np.testing.assert_allclose(gnss.t, 0.2 * np.arange(COUNT), atol=1e-9)
    np.testing.assert_allclose(gnss.velocity_n, [[7.07, -7.07, -0.1]] * COUNT, atol=1e-9)
    np.testing.assert_allclose(gnss.lon_deg, -122.0 + 1.8e-5 * np.arange(COUNT), atol=1e-9)
    assert gnss.sigma_horizontal[0] == 2.5 and gnss.sigma_velocity[0] == 0.4 and gnss.alt_m[0] == 12.0
    assert gnss.num_sv[0] == 9 and gnss.fix[0] == 3


def test_sentences_beside_the_messages_are_read(tmp_path: Path) -> None:
    sentences = [sentence.encode() for sentence in nmea_epochs(COUNT)]
    path = write(tmp_path, *(ACK + sentence for sentence in sentences))
    assert len(load_raw(path).gnss) == COUNT


def test_a_file_without_fixes_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(SessionError, match=r"log.ubx: no fix in it; have the receiver send NAV-PVT, or NMEA"):
        load_raw(write(tmp_path, ACK * 20))
    with pytest.raises(SessionError, match=r"log.ubx: no known kind of recording"):
        load_raw(write(tmp_path, b""))


@pytest.mark.parametrize("seed", range(20))
def test_damage_leaves_the_rest(tmp_path: Path, seed: int) -> None:
    rng = np.random.default_rng(seed)
    data = np.frombuffer(b"".join(message(k) for k in range(COUNT)), np.uint8).copy()
    data[rng.integers(0, data.size, rng.integers(1, 60))] = rng.integers(0, 256)
    path = write(tmp_path, data[: rng.integers(1, data.size + 1)].tobytes())
    try:
        gnss = read_ubx(path).gnss
    except SessionError as error:
        assert "\n" not in str(error)
    else:
        assert np.all(np.diff(gnss.t) > 0.0)
