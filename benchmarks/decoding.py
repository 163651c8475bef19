"""Speed of reading the logger's log: by default one hour at 1 kHz, compass at 100 Hz, three sentences at 5 Hz.

    python benchmarks/decoding.py [--minutes 60] [--rate 1000]

`records` is what has to be done for any log: finding the blocks with their CRC, and decoding all records into arrays.
`session` is everything up to calibrated units and fixes, as `smooth` does it: times put in order, sentences parsed,
stamps evened. Best of three, CPU seconds in brackets; `peak` is the process's memory.
"""

import argparse
import os
import resource
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before numpy is imported
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np

from cost import best_of
from smoother.session.load import load_raw
from smoother.session.log import list_recordings, read_records
from smoother.session.log_encode import encode
from smoother.session.log_format import LogRecords, Setup, Stop

A_FEW_SECONDS = 3.0  # CPU s that an hour at 1 kHz may take to decode


def main() -> int:
    """Write a log, read it, print the seconds; exit code 1 if an hour at 1 kHz takes more than a few of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--rate", type=int, default=1000)
    options = parser.parse_args()
    records = make_records(60.0 * options.minutes, options.rate, np.random.default_rng(1))
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "LOG00001.KLG"
        path.write_bytes(encode(records, 1))
        size = path.stat().st_size / 1e6
        print(f"{options.minutes:g} min at {options.rate} Hz: {size:.0f} MB, {len(records.imu_t)} samples")
        decoding = timed("records", lambda: read_records(list_recordings([path])[0]))
        timed("session", lambda: load_raw(path))
    print(f"peak     {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6:6.2f} GB")
    hours = options.minutes / 60.0 * options.rate / 1000.0
    return 0 if decoding <= A_FEW_SECONDS * max(hours, 1.0) else 1


def timed(name: str, work: Callable[[], object]) -> float:
    """Time `work`, print it and return the CPU seconds."""
    cost = best_of(3, work)
    print(f"{name:8} {cost.wall:6.2f} s ({cost.cpu:.2f})")
    return cost.cpu


def make_records(duration: float, rate: int, rng: np.random.Generator) -> LogRecords:
    """A logger that lies still for `duration` s, with the noise of its sensors."""
    period = 1_000_000 // rate
    t = period * (1 + np.arange(int(duration * rate))) + rng.integers(0, period // 50 + 1, int(duration * rate))
    imu = rng.integers(-60, 60, (len(t), 6)).astype(np.int16)
    imu[:, 2] += 2048
    few, rare = slice(None, None, max(1, rate // 100)), slice(None, None, max(1, rate // 10))
    sentences = [pair for fix in range(int(5 * duration)) for pair in sentences_of(fix)]
    return LogRecords(
        setup=Setup(imu_period_us=period, gyro_delay_us=3900),
        config=f"imu_rate={rate}\n",
        imu_t=t,
        imu=imu,
        mag_t=t[few],
        mag=rng.integers(-400, 400, (len(t[few]), 3)).astype(np.int16),
        mag_flags=np.zeros(len(t[few]), dtype=np.uint8),
        temperature_t=t[rare],
        temperature=np.full(len(t[rare]), 1335, dtype=np.int16),
        sentences=tuple(sentences),
        stop=Stop(int(t[-1]), 1, len(t), 0, len(sentences), 3, 0),
    )


def sentences_of(fix: int) -> list[tuple[int, bytes]]:
    """RMC, GGA and GST of a fix, each with the time in us of its first byte."""
    tenths = 360_000 + 2 * fix
    clock = f"{tenths // 36000 % 24:02d}{tenths // 600 % 60:02d}{tenths % 600 / 10:05.2f}"
    place = f"4502.{70000 + fix % 100:05d},N,01208.94000,E"
    bodies = (
        f"GPRMC,{clock},A,{place},10.0,45.0,310524,,,A",
        f"GPGGA,{clock},{place},1,09,0.95,21.4,M,43.1,M,,",
        f"GPGST,{clock},12,,,,1.9,1.7,3.2",
    )
    return [(200_000 * fix + 100_000 + 14_000 * k, with_checksum(body)) for k, body in enumerate(bodies)]


def with_checksum(body: str) -> bytes:
    """The sentence with `$`, checksum and line end."""
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()


if __name__ == "__main__":
    sys.exit(main())
