"""What the tests of readers share: recordings of the logger, some seconds of every kind of record."""

from pathlib import Path

import numpy as np
import pytest

from smoother.session.log_format import Event, Gap, LogRecords, SelfTest, Setup, Stop

from .folders import Folder

SENTENCES = {
    "RMC": "GPRMC,{clock},A,4502.{place:05d},N,01208.94000,E,10.0,45.0,310524,,,A",
    "GGA": "GPGGA,{clock},4502.{place:05d},N,01208.94000,E,1,09,0.95,21.4,M,43.1,M,,",
    "GST": "GPGST,{clock},12,,,,1.9,1.7,3.2",
}


def sentence(kind: str, fix: int) -> bytes:
    """Sentence of fix number `fix` at 5 Hz, with its checksum."""
    seconds = 36000.0 + 0.2 * fix
    clock = f"{int(seconds // 3600):02d}{int(seconds % 3600 // 60):02d}{seconds % 60:05.2f}"
    body = SENTENCES[kind].format(clock=clock, place=70000 + fix)
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    directory = tmp_path / "heat2"
    directory.mkdir()
    return Folder(directory)


@pytest.fixture(scope="session")
def make_records():
    """A function that makes a recording; see _records."""
    return _records


@pytest.fixture(scope="session")
def assert_same():
    """A function that compares two recordings."""
    return _assert_same


def _records(duration: float = 3.0, rate: int = 200, seed: int = 1, start_us: int = 2_000_000) -> LogRecords:
    """A recording of `duration` s: lying nearly level, at 10 knots to the north-east."""
    rng = np.random.default_rng(seed)
    period = 1_000_000 // rate
    t = start_us + period * np.arange(int(duration * rate))
    imu = rng.integers(-300, 300, (len(t), 6)).astype(np.int16)
    imu[:, 2] += 2048
    mag_t = t[:: max(1, rate // 100)]
    mag = rng.integers(-400, 400, (len(mag_t), 3)).astype(np.int16)
    sentences = []
    for fix in range(int(5 * duration)):
        at = start_us + 200_000 * fix + 100_000
        for k, kind in enumerate(SENTENCES):
            sentences.append((at + 14_000 * k, sentence(kind, fix)))
    end = int(t[-1])
    return LogRecords(
        setup=Setup(imu_period_us=period, gyro_delay_us=3900, mag_adjustment=bytes([178, 180, 170])),
        config="imu_rate=200\naccel_range=16\n",
        imu_t=t,
        imu=imu,
        mag_t=mag_t,
        mag=mag,
        mag_flags=np.zeros(len(mag_t), dtype=np.uint8),
        temperature_t=t[:: max(1, rate // 10)],
        temperature=np.full(len(t[:: max(1, rate // 10)]), 1335, dtype=np.int16),
        sentences=tuple(sentences),
        gaps=(Gap(0x81, 3, 2, start_us + 500_000, start_us + 700_000),),
        events=(Event(start_us + 10, 7, 57600),),
        self_tests=(SelfTest(start_us + 20, (1, 2, 3, -4, -5, -6), b"abcdef", 63),),
        stop=Stop(end, 1, len(t), 0, len(sentences), 3, 0),
    )


ARRAYS = ("imu_t", "imu", "mag_t", "mag", "mag_flags", "temperature_t", "temperature")
VALUES = ("setup", "config", "sentences", "gaps", "events", "self_tests", "stop")


def _assert_same(have: LogRecords, want: LogRecords) -> None:
    """Fail unless two recordings hold the same records."""
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(have, name), getattr(want, name), err_msg=name)
    for name in VALUES:
        assert getattr(have, name) == getattr(want, name), name
