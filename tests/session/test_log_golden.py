"""The golden log: bytes that must mean the same for ever (tests/data/README.md)."""

from pathlib import Path

import numpy as np
import pytest

from smoother.session.log_decode import Losses, decode, find_blocks
from smoother.session.log_format import GAP_SENSOR, IMU, Event, Gap, SelfTest, Setup, Stop

GOLDEN = Path(__file__).resolve().parents[1] / "data" / "golden.klg"
START = 5_000_000  # us


@pytest.fixture(scope="module")
def blocks():
    found, damaged = find_blocks(GOLDEN.read_bytes())
    assert damaged == 0
    return found


@pytest.fixture(scope="module")
def records(blocks):
    have, losses = decode(blocks)
    assert losses == Losses()
    return have


def test_heads_of_the_blocks(blocks):
    assert set(blocks.head["session"].tolist()) == {0x12345678}
    assert blocks.head["sequence"].tolist() == list(range(len(blocks)))
    assert blocks.base_us[0] == START
    assert blocks.head["imu_number"].tolist() == [0, 11, 41, 62, 89, 118]


def test_samples(records):
    k = np.delete(np.arange(130), [57, 58, 59])
    np.testing.assert_array_equal(records.imu_t, START + 1000 * (k + 1) + k * 7 % 5)
    expected = [
        k * 37 % 200 - 100,
        k * 53 % 200 - 100,
        2048 + k % 9,
        k * 11 % 64 - 32,
        k * 13 % 64 - 32,
        k * 17 % 64 - 32,
    ]
    expected[5][k == 64] = 32767
    expected[5][k == 65] = -32768
    np.testing.assert_array_equal(records.imu, np.stack(expected, axis=1))


def test_compass_and_temperature(records):
    k = np.arange(0, 130, 10)
    np.testing.assert_array_equal(records.mag, np.stack([120 + k, -300 + k, k - 400], axis=1))
    np.testing.assert_array_equal(records.mag_flags, k == 90)
    assert records.temperature.tolist() == [1335, 1435]


def test_sentences_have_the_time_of_their_first_byte(records):
    kinds = [text[1:6] for _, text in records.sentences]
    assert kinds == [b"GPRMC", b"GPGGA", b"GPGST"]
    for k, (t_us, text) in zip((40, 54, 69), records.sentences, strict=True):
        assert text.endswith(b"\r\n")
        assert t_us == START + 1000 * (k + 1) + k * 7 % 5 - 174 * len(text)


def test_everything_else(records):
    assert records.setup == Setup(
        flags=0x0B,
        mag_adjustment=bytes([178, 180, 170]),
        reset_cause=0x0C,
        boot_number=3,
        config_crc=0x12345678,
        firmware=bytes.fromhex("0123456789abcdef"),
        device=bytes(range(12)),
    )
    assert records.config.startswith("imu_rate=1000\naccel_range=16\n")
    assert records.config.endswith("stream_baud=115200\n")
    assert records.self_tests == (SelfTest(START, (600, -610, 650, 12000, -12100, 11900), b"z{|mno", 63),)
    assert records.events == (Event(START + 1, 7, 57600), Event(START + 101_000, 13, 1))
    first, last = START + 61_000 - 3000, START + 61_000 - 1000
    assert records.gaps == (Gap(IMU, GAP_SENSOR, 3, first, last),)
    assert records.stop == Stop(START + 131_000, 1, 127, 3, 3, 5, 2)
