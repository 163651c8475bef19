"""Stamps of fixes that have not enough decimals, and clocks that were set on the way, beside the receiver's UTC."""

from pathlib import Path

import numpy as np
import pytest

from smoother.samples import RawSession
from smoother.session.load import load_raw

from .folders import codes

START = 1.7e9  # s since 1970
RATE = 5.0  # Hz
LATE = 0.137  # s, of the stamps


def written(folder: Path, t: np.ndarray, unix_s: np.ndarray) -> RawSession:
    """A session of fixes alone, moving north ever faster."""
    number = np.arange(t.size)
    lat = 45.0 + 1e-5 * number + 1e-8 * number**2
    rows = [f"{a:.6g},{b:.3f},{c:.9f},12.0" for a, b, c in zip(t, unix_s, lat, strict=True)]
    (folder / "gps.csv").write_text("\n".join(["t_s,unix_s,lat_deg,lon_deg", *rows]) + "\n")
    return load_raw(folder)


def seconds(count: int = 600) -> np.ndarray:
    return np.arange(count) / RATE


@pytest.mark.parametrize("rounded", [np.round, np.floor])
def test_stamps_of_whole_seconds_are_those_of_utc(tmp_path: Path, rounded: np.ufunc) -> None:
    true = seconds()
    raw = written(tmp_path, rounded(true + LATE), START + true)
    assert len(raw.gnss) == true.size
    assert codes(raw)["gps_coarse_time"] == true.size - np.unique(rounded(true + LATE)).size
    off = raw.gnss.t - true
    assert np.ptp(off) < 2e-3 and abs(np.mean(off) - np.median(rounded(true + LATE) - true)) < 2e-3


def test_single_stamps_that_were_written_twice_are_left_out_as_before(tmp_path: Path) -> None:
    true = seconds()
    stamps = true + LATE
    stamps[100::100] = stamps[99:-1:100]
    raw = written(tmp_path, stamps, START + true)
    assert "gps_coarse_time" not in codes(raw) and "gps_repeated_time" in codes(raw)


@pytest.mark.parametrize("by", [0.3, -0.4, 3.0, 9.0])
def test_utc_that_was_set_on_the_way_is_said(tmp_path: Path, by: float) -> None:
    true = seconds()
    raw = written(tmp_path, true + LATE, START + true + by * (true > 60.0))
    (text,) = [problem.text for problem in raw.problems if problem.code == "gps_utc_set"]
    assert f"UTC leaps by {by:+.2f} s at 60 s, and t_s does not" in text
    assert not any(code.startswith("clock_") for code in codes(raw))


@pytest.mark.parametrize("by", [0.5, 3.0])
def test_stamps_that_were_set_on_the_way_are_said(tmp_path: Path, by: float) -> None:
    true = seconds()
    raw = written(tmp_path, true + LATE + by * (true > 60.0), START + true)
    (text,) = [problem.text for problem in raw.problems if problem.code == "gps_clock_set"]
    assert f"t_s leaps by {by:+.2f} s" in text and "the lap across is off by it" in text


def test_neither_is_said_of_stamps_that_come_now_sooner_now_later(tmp_path: Path) -> None:
    true = seconds()
    late = np.abs(np.random.default_rng(3).normal(0.0, 0.06, true.size))
    raw = written(tmp_path, np.maximum.accumulate(true + late) + 1e-4 * np.arange(true.size), START + true)
    assert not {"gps_utc_set", "gps_clock_set", "gps_coarse_time", "clock_pace"} & set(codes(raw))
