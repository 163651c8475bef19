"""Session directories to be filled, with small good tables to fill them with."""

import functools
import operator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from smoother.samples import RawSession
from smoother.session.load import load_raw
from smoother.session.thesis import END_STRUCT, GPS_FLAG, IMU_STRUCT, MAG_STRUCT, RECORD_START


def imu_csv(count: int = 1000, rate: float = 100.0, start: float = 0.0) -> str:
    rows = [
        f"{start + k / rate:.4f},0.1{k % 2},{0.01 * (k % 9):.2f},9.8{k % 3},"
        f"0.001{k % 2},0.002{k % 7},{0.003 * (k % 5):.3f}"
        for k in range(count)
    ]
    return "\n".join(["t_s,ax,ay,az,gx,gy,gz", *rows]) + "\n"


def gps_csv(count: int = 50, rate: float = 5.0, start: float = 0.0) -> str:
    speeds = [111_195 * rate * (1e-4 + 2e-8 * k) for k in range(count)]
    rows = [
        f"{start + k / rate:.2f},{45 + 1e-4 * k + 1e-8 * k * k:.9f},12.0,8.0,{speed:.2f},0.0"
        for k, speed in enumerate(speeds)
    ]
    return "\n".join(["t_s,lat_deg,lon_deg,alt_m,speed_mps,course_deg", *rows]) + "\n"


def nmea_epochs(count: int) -> list[str]:
    """RMC sentences at 5 Hz, moving north."""
    bursts = []
    for k in range(count):
        body = f"GPRMC,1000{k / 5:05.2f},A,45{2 + 0.001 * k:07.4f},N,01208.9400,E,18.0,0.0,310524,,,A"
        bursts.append(f"${body}*{functools.reduce(operator.xor, body.encode()):02X}\r\n")
    return bursts


def out_txt(count: int) -> bytes:
    """Records at 50 Hz, every tenth with the magnetometer and a sentence."""
    records = b""
    for k, sentence in enumerate(np.repeat(nmea_epochs(-(-count // 10)), 10)[:count].tolist()):
        gps = bytes([GPS_FLAG]) + MAG_STRUCT.pack(1, 2, 3) + sentence.encode().ljust(90, b"\0")
        records += RECORD_START + IMU_STRUCT.pack(20 * k, 5, 6, 8192, k % 7, 8, 9)
        records += (b"" if k % 10 else gps) + END_STRUCT.pack(20 * k + 3)
    return records


@dataclass
class Folder:
    """A session directory to be filled."""

    path: Path

    def write(self, **files: str | bytes) -> "Folder":
        for name, content in files.items():
            target = self.path / name.replace("__", ".")
            target.write_bytes(content.encode() if isinstance(content, str) else content)
        return self

    def load(self, file: str = "") -> RawSession:
        return load_raw(self.path / file if file else self.path)


def codes(session: RawSession) -> dict[str, int]:
    return {problem.code: problem.count for problem in session.problems}
