"""contracts.md 4: out.txt and magcalib.txt, written here as the thesis describes them."""

import struct
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

TABLES_ONLY = ("--no-figures", "--no-baseline", "--rate", "10")
Read = Callable[[Path], pl.DataFrame]
ACCEL, GYRO = 4.0 * 9.80665 / 32768.0, np.radians(500.0) / 32768.0  # SI a count: 4 g and 500 deg/s full scale
BLOCK = 96  # bytes, the receiver's buffer


def sentence(fix: dict[str, Any]) -> bytes:
    hour, rest = divmod(fix["unix_s"] % 86_400.0, 3600.0)
    clock = f"{int(hour):02d}{int(rest // 60):02d}{rest % 60:05.2f}"
    (lat, south), (lon, west) = ((abs(fix[name]), fix[name] < 0.0) for name in ("lat_deg", "lon_deg"))
    place = f"{int(lat):02d}{60.0 * (lat % 1.0):08.5f},{'NS'[south]},{int(lon):03d}{60.0 * (lon % 1.0):08.5f}"
    motion = f"{fix['speed_mps'] * 3600.0 / 1852.0:.2f},{fix['course_deg']:.2f}"
    body = f"GPRMC,{clock},A,{place},{'EW'[west]},{motion},160526,,,A"
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode().ljust(BLOCK, b"\x00")


def write_out(session: Path, path: Path, flag: bytes, start_ms: int) -> int:
    """Every second sample of a session as a record, the fixes with the record of their time; return the records."""
    samples = pl.read_csv(session / "imu.csv", infer_schema_length=None)[::2]
    fixes = {round(fix["t_s"], 2): fix for fix in pl.read_csv(session / "gps.csv").iter_rows(named=True)}
    scale = np.array([ACCEL] * 3 + [GYRO] * 3)
    counts = np.rint(samples.select("ax", "ay", "az", "gx", "gy", "gz").to_numpy() / scale).clip(-32768, 32767)
    data = bytearray()
    for t, row in zip(
        np.round(samples["t_s"].to_numpy() - 0.005, 2).tolist(), counts.astype(int).tolist(), strict=True
    ):
        ms = start_ms + round(1000.0 * t)
        fix = fixes.get(t)
        data += b"YY" + struct.pack("<I6h", ms, *row)
        data += flag if fix is None else b"\x71" + struct.pack("<3h", 10, -30, 40) + sentence(fix)
        data += struct.pack("<I", ms + 2)
    path.write_bytes(data)
    return len(counts)


@pytest.mark.slow
@pytest.mark.parametrize(("flag", "start_ms"), [(b"", 0x71 - 2), (b"\x00", 0x595900)], ids=["5.D", "5.E"])
def test_out_txt_is_read_with_and_without_the_flag_byte_whatever_bytes_its_times_have(
    simulated: Path, short_results: Path, smooth: Any, read: Read, tmp_path: Path, flag: bytes, start_ms: int
) -> None:
    """Start and end times of many records hold 0x71 in their low byte, or `YY`."""
    records = write_out(simulated, tmp_path / "out.txt", flag, start_ms)
    printed = smooth(tmp_path, "--json", *TABLES_ONLY)
    assert printed.code == 0
    document = printed.document
    assert document["counts"]["imu_samples"] == records and document["mode"] == "full"
    assert document["counts"]["fixes"] == read(simulated / "gps.csv").height - 1  # that before the first sample
    rows, wanted = read(tmp_path / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")
    t = rows["t_s"].to_numpy() - start_ms / 1000.0
    north = 111_200.0 * (
        rows["lat_deg"].to_numpy() - np.interp(t, wanted["t_s"].to_numpy(), wanted["lat_deg"].to_numpy())
    )
    assert np.sqrt(np.mean(north**2)) < 2.0
    for name in ("speed_mps", "accel_forward_mps2", "yaw_rate_dps"):
        first = np.interp(t, wanted["t_s"].to_numpy(), wanted[name].to_numpy())
        assert np.corrcoef(first, rows[name].to_numpy())[0, 1] > 0.8, name
        assert np.std(rows[name].to_numpy()) == pytest.approx(np.std(first), rel=0.15), name


def test_counts_are_of_4_g_and_500_degrees_a_second_at_full_scale(simulated: Path, smooth: Any, tmp_path: Path) -> None:
    """Smoothing would see through a wrong unit, so `check` is asked for the slow force and turn rate."""
    write_out(simulated, tmp_path / "out.txt", b"", 1000)
    found, wanted = (smooth("check", path, "--json").document["measures"] for path in (tmp_path, simulated))
    for name in ("slow_force_mps2", "slow_turn_rate_dps"):
        assert found[name] == pytest.approx(wanted[name], rel=0.1), name


@pytest.mark.slow
def test_a_record_that_cannot_be_resolved_is_counted(simulated: Path, smooth: Any, tmp_path: Path) -> None:
    records = write_out(simulated, tmp_path / "out.txt", b"\x00", 1000)
    data = bytearray((tmp_path / "out.txt").read_bytes())
    data[20_000:20_512] = b"\xff" * 512  # a lost sector
    (tmp_path / "out.txt").write_bytes(data)
    printed = smooth(tmp_path, "--json", *TABLES_ONLY)
    assert printed.code == 0
    document = printed.document
    lost = records - document["counts"]["imu_samples"]
    assert 10 < lost < 30
    assert any(problem["count"] > 0 and "out.txt" in problem["text"] for problem in document["problems"])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["magcalib.txt", "mag_calib.txt"])
@pytest.mark.parametrize("start", [b"Y", b"YY"])
@pytest.mark.parametrize("before_each", [True, False])
def test_magcalib_is_triples_of_my_mx_minus_mz_behind_its_start_bytes(
    smooth: Any, tmp_path: Path, name: str, start: bytes, before_each: bool
) -> None:
    """What `calibrate` finds of it is the centre, in the sensor's own axes."""
    rng = np.random.default_rng(1)
    direction = rng.normal(size=(800, 3))
    field = 300.0 * direction / np.linalg.norm(direction, axis=1, keepdims=True) + [60.0, -40.0, 20.0]
    mx, my, mz = np.rint(field).astype(int).T.tolist()
    triples = [struct.pack("<3h", y, x, -z) for x, y, z in zip(mx, my, mz, strict=True)]
    packed = b"".join(start + triple for triple in triples) if before_each else start + b"".join(triples)
    (tmp_path / name).write_bytes(packed)
    printed = smooth("calibrate", tmp_path, "--place", "45,12", "--date", "2026-05-16", "--no-figures", "--json")
    assert printed.code == 0
    found = tomllib.loads((tmp_path / "calibration.toml").read_text())["magnetometer"]["hard_iron"]
    np.testing.assert_allclose(found, [60.0, -40.0, 20.0], atol=1.0)
