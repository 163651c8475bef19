"""The logger's record format in Python's words: firmware/FORMAT.md as constants, layouts and types.

Times are integer microseconds on the logger's clock, values are counts as recorded. What they mean in physical units
is for `log.py`; how records lie in blocks and frames for `log_decode.py` and `log_encode.py`.
"""

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from smoother.arrays import IntArray

MAGIC = b"KLG\x01"
BLOCK_BYTES, RECORDS_AT, CRC_AT = 512, 24, 508
CAPACITY = CRC_AT - RECORDS_AT
HEAD_LAYOUT = np.dtype(
    [
        *(("magic", "S4"), ("session", "<u4"), ("sequence", "<u4")),
        *(("base_low", "<u4"), ("base_high", "<u2"), ("used", "<u2"), ("imu_number", "<u4")),
    ]
)

FRAME_SYNC = b"\xa5\x5a"
FRAME_HEAD = struct.Struct("<2sBHIH")  # sync, bytes of records, number, base (32 low, 16 high bits)
FRAME_CAPACITY = 240
CRC_STRUCT = struct.Struct("<I")

IMU, MAG, TEMPERATURE = 0x01, 0x02, 0x03
GPS, GAP, SETUP, CONFIG, EVENT, SELF_TEST, STOP = 0x81, *range(0x83, 0x89)
FIRST_LONG = 0x80
LONGEST_SHORT_TIME, LONGEST_LONG_TIME = 65535, 2**31 - 1  # us
SHORT_LAYOUTS = {
    IMU: np.dtype([("type", "u1"), ("since", "<u2"), ("counts", "<i2", (6,))]),
    MAG: np.dtype([("type", "u1"), ("since", "<u2"), ("counts", "<i2", (3,)), ("flags", "u1")]),
    TEMPERATURE: np.dtype([("type", "u1"), ("since", "<u2"), ("counts", "<i2")]),
}
LONG_LAYOUT = np.dtype([("type", "u1"), ("length", "u1"), ("since", "<i4")])
LONG_STRUCT = struct.Struct("<BBi")

GAP_STRUCT = struct.Struct("<BBIIHIH")  # source, reason, count, first and last (32 low, 16 high bits each)
SETUP_STRUCT = struct.Struct("<4B3sBI6H5I8s12s")
CONFIG_STRUCT = struct.Struct("<HH")  # offset, total
EVENT_STRUCT = struct.Struct("<HI")
SELF_TEST_STRUCT = struct.Struct("<6h6sB")
STOP_STRUCT = struct.Struct("<BIIIHH")
CONFIG_PIECE, LONGEST_SENTENCE = 128, 128

MAG_OVERFLOW, MAG_MISSED = 0x01, 0x02
GAP_NO_ROOM, GAP_SENSOR, GAP_SERIAL = 1, 2, 3
PURPOSE_DRIVE, PURPOSE_MAG_CALIBRATION = 0, 1
SETUP_CONFIG_READ = 0x08
STOP_BUTTON, STOP_CARD_FULL, STOP_SUPPLY_LOW, STOP_CALIBRATED, STOP_FAULT = range(1, 6)
EVENTS = {
    1: "CARD_LOST",
    2: "CARD_BACK",
    3: "CARD_RETRY",
    4: "IMU_LOST",
    5: "IMU_BACK",
    6: "GPS_SILENT",
    7: "GPS_CONFIGURED",
    8: "GPS_NOT_CONFIGURED",
    9: "CONFIG_REJECTED",
    10: "MAG_ABSENT",
    11: "SUPPLY_LOW",
    12: "WATCHDOG",
    13: "BUTTON",
    14: "RECOVERED",
    15: "FAULT_PC",
    16: "FAULT_LR",
    17: "FAULT_STATUS",
}


@dataclass(frozen=True)
class Setup:
    """What a SETUP record says. Periods and delays in us, ranges in g and deg/s, low-pass in Hz, 0 for none."""

    purpose: int = PURPOSE_DRIVE
    flags: int = SETUP_CONFIG_READ
    imu_who_am_i: int = 0x71
    mag_who_am_i: int = 0x48
    mag_adjustment: bytes = b"\x80\x80\x80"
    reset_cause: int = 0
    imu_period_us: int = 1000
    accel_range_g: int = 16
    gyro_range_dps: int = 1000
    accel_lowpass_hz: int = 99
    gyro_lowpass_hz: int = 92
    accel_delay_us: int = 2880
    gyro_delay_us: int = 3900
    mag_period_us: int = 10000
    gps_period_us: int = 200000
    gps_baud: int = 57600
    boot_number: int = 1
    config_crc: int = 0
    firmware: bytes = bytes(8)
    device: bytes = bytes(12)

    def pack(self) -> bytes:
        """Return the data of the record."""
        return SETUP_STRUCT.pack(*(getattr(self, name) for name in _SETUP_ORDER))

    @staticmethod
    def unpack(data: bytes) -> "Setup":
        """Read the data of a record; what later versions append is left aside. Raises struct.error if it is short."""
        return Setup(**dict(zip(_SETUP_ORDER, SETUP_STRUCT.unpack_from(data), strict=True)))


_SETUP_ORDER = tuple(Setup.__dataclass_fields__)


@dataclass(frozen=True)
class Gap:
    """Records of type `source` (0: any other) that were lost, the times in us of the first and the last."""

    source: int
    reason: int
    count: int
    first_us: int
    last_us: int


@dataclass(frozen=True)
class Event:
    """Something that happened: t_us, one of EVENTS, and its value."""

    t_us: int
    code: int
    value: int


@dataclass(frozen=True)
class SelfTest:
    """Self-test: response (6,) counts and factory code (6,), accel x y z, gyro x y z; bit i of passed for axis i."""

    t_us: int
    response: tuple[int, ...]
    factory_code: bytes
    passed: int


@dataclass(frozen=True)
class Stop:
    """The last record of a recording that was ended on purpose: why, and the logger's own counts."""

    t_us: int
    reason: int
    imu_records: int
    imu_lost: int
    gps_records: int
    most_blocks: int
    card_retries: int


def _no_times() -> IntArray:
    return np.zeros(0, dtype=np.int64)


def _no_counts(columns: int) -> npt.NDArray[np.int16]:
    return np.zeros((0, columns), dtype=np.int16)


@dataclass(frozen=True, eq=False)
class LogRecords:
    """The records of one recording, by type, in the order in which they were recorded.

    imu_t (N,) us, imu (N, 6) counts accel x y z, gyro x y z; mag_t (K,) us, mag (K, 3) counts in the magnetometer's
    axes as read, mag_flags (K,); temperature_t (M,) us, temperature (M,) counts; sentences are (us, text) pairs.
    """

    setup: Setup | None = None
    config: str = ""
    imu_t: IntArray = field(default_factory=_no_times)
    imu: npt.NDArray[np.int16] = field(default_factory=lambda: _no_counts(6))
    mag_t: IntArray = field(default_factory=_no_times)
    mag: npt.NDArray[np.int16] = field(default_factory=lambda: _no_counts(3))
    mag_flags: npt.NDArray[np.uint8] = field(default_factory=lambda: np.zeros(0, dtype=np.uint8))
    temperature_t: IntArray = field(default_factory=_no_times)
    temperature: npt.NDArray[np.int16] = field(default_factory=lambda: np.zeros(0, dtype=np.int16))
    sentences: Sequence[tuple[int, bytes]] = ()
    gaps: tuple[Gap, ...] = ()
    events: tuple[Event, ...] = ()
    self_tests: tuple[SelfTest, ...] = ()
    stop: Stop | None = None
