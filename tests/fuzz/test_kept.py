"""What damage did not touch is kept: samples and fixes before and after a hole, whatever filled it."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from fuzz_corpus import CORPUS, write_files

from smoother.samples import RawSession
from smoother.session.load import load_raw

HOLE = 300  # bytes


def noise(data: bytes, rng: np.random.Generator) -> bytes:
    return rng.bytes(len(data))


def zeros(data: bytes, rng: np.random.Generator) -> bytes:
    return bytes(len(data))


def ones(data: bytes, rng: np.random.Generator) -> bytes:
    return b"\xff" * len(data)


def nothing(data: bytes, rng: np.random.Generator) -> bytes:
    return b""


def samples(raw: RawSession) -> set[tuple[float, ...]]:
    assert raw.imu is not None
    return {tuple(row) for row in np.hstack([raw.imu.accel, raw.imu.gyro]).tolist()}


def fixes(raw: RawSession) -> set[tuple[float, ...]]:
    return set(zip(raw.gnss.lat_deg.tolist(), raw.gnss.lon_deg.tolist(), strict=True))


# format, its file, what is counted, bytes that are lost with any byte of them: a block, a record, a row
TARGETS = [
    ("log", ".klg", samples, 512),
    ("thesis", "out.txt", samples, 256),
    ("columns", "imu.csv", samples, 90),
    ("columns", "gps.csv", fixes, 120),
    ("sentences", ".nmea", fixes, 300),
    ("vbo", ".vbo", fixes, 80),
    ("racechrono", ".csv", fixes, 80),
    ("aim", ".csv", fixes, 90),
    ("gpx", ".gpx", fixes, 180),
]


@pytest.mark.parametrize("fill", [noise, zeros, ones, nothing])
@pytest.mark.parametrize(("form", "ending", "kept", "unit"), TARGETS, ids=[f"{t[0]} {t[1]}" for t in TARGETS])
def test_a_hole_costs_what_it_covers_and_no_more(
    form: str,
    ending: str,
    kept: Callable[[RawSession], set[tuple[float, ...]]],
    unit: int,
    fill: Callable[[bytes, np.random.Generator], bytes],
    tmp_path: Path,
) -> None:
    files = CORPUS[form]()
    name = max((n for n in files if n.lower().endswith(ending)), key=lambda n: len(files[n]))
    whole = kept(load_raw(write_files(tmp_path / "whole", files)))
    share = (HOLE + 2 * unit) / len(files[name])
    rng = np.random.default_rng(8)
    for k in range(4):
        start = int(rng.uniform(0.3, 0.9) * len(files[name]))
        data = files[name]
        holed = data[:start] + fill(data[start : start + HOLE], rng) + data[start + HOLE :]
        left = kept(load_raw(write_files(tmp_path / str(k), {**files, name: holed})))
        assert len(whole - left) <= 1.5 * share * len(whole) + 1, f"hole at byte {start}"
