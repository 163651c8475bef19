"""Two days in one file."""

from pathlib import Path

import numpy as np
import pytest

from smoother.samples import RawSession
from smoother.session.load import load_raw
from smoother.units import DAY

from .folders import Folder, codes, gps_csv, imu_csv


def session(
    folder: Path,
    hole: float,
    *,
    imu: bool = True,
    imu_goes_on: bool = False,
    imu_until: float = 60.0,
    mag_until: float = 60.0,
) -> RawSession:
    """20 s of a drive, a hole, and 40 s more of it; the samples may go on through the hole once in a while.

    Samples and compass may end before the fixes do, s, the hole not counted.
    """
    samples = np.arange(0.0, imu_until, 0.02)
    fixes, mag = np.arange(0.1, 60.0, 0.2), np.arange(0.0, mag_until, 0.1)
    apart = [t + hole * (t > 20.0) for t in (samples, fixes, mag)]
    if imu_goes_on:
        apart[0] = np.sort(np.append(apart[0], 20.0 + hole * np.linspace(0.1, 0.9, 9)))
    tables = (
        ("imu.csv", "t_s,ax,ay,az,gx,gy,gz", "0.{0},0.{1},9.8{0},0.00{1},0,0.01{0}", apart[0]),
        ("gps.csv", "t_s,lat_deg,lon_deg", "{2:.7f},12.0", apart[1]),
        ("mag.csv", "t_s,mx,my,mz", "{0},{1},3", apart[2]),
    )
    for name, header, row, t in tables[0 if imu else 1 :]:
        rows = [f"{time:.3f}," + row.format(k % 7, k % 5, 45.0 + 1e-4 * k) for k, time in enumerate(t)]
        (folder / name).write_text("\n".join([header, *rows]))
    return load_raw(folder)


@pytest.mark.parametrize("imu", [True, False])
def test_of_two_days_in_one_file_the_longer_is_used_and_the_other_named(tmp_path: Path, imu: bool) -> None:
    raw = session(tmp_path, 80_000.0, imu=imu)
    assert len(raw.gnss) == 200 and raw.gnss.t[0] > 80_000.0
    assert raw.mag is not None and raw.mag.t[0] > 80_000.0 and len(raw.mag.t) in (399, 400)
    assert (raw.imu is not None) == imu
    if raw.imu is not None:
        assert raw.imu.t[0] > 80_000.0 and len(raw.imu.t) in (1999, 2000)
    (said,) = [problem for problem in raw.problems if problem.code == "recordings_apart"]
    assert said.count == 100
    assert said.text.startswith(
        "gps.csv: 2 recordings, with up to 22 h 13 min between them; number 2 is used, 100 fixes"
    )
    assert "Split the files at 20 s" in said.text


@pytest.mark.parametrize(("hole", "goes_on"), [(7200.0, False), (27_000.0, False), (27_000.0, True)])
def test_a_pause_between_heats_is_a_gap_and_so_is_a_night_that_was_recorded(
    tmp_path: Path, hole: float, goes_on: bool
) -> None:
    raw = session(tmp_path, hole, imu_goes_on=goes_on)
    assert len(raw.gnss) == 300 and "recordings_apart" not in [problem.code for problem in raw.problems]


@pytest.mark.parametrize("until", [20.0, 21.0])
def test_a_day_without_samples_enough_is_smoothed_from_gps_alone(tmp_path: Path, until: float) -> None:
    raw = session(tmp_path, 40_000.0, imu_until=until)
    assert raw.imu is None and len(raw.gnss) == 200
    assert [problem.text.endswith("smoothed from GPS alone") for problem in raw.problems].count(True) == 1


def test_a_day_without_compass_has_none(tmp_path: Path) -> None:
    raw = session(tmp_path, 40_000.0, mag_until=20.0)
    assert raw.mag is None and raw.imu is not None and len(raw.imu.t) in (1999, 2000)


def test_of_two_drives_a_week_apart_samples_and_fixes_are_of_the_same(folder: Folder) -> None:
    """The clock may have been set in mid-drive; each file for itself has most rows in another part."""
    week = 7.0 * DAY
    imu = imu_csv(2000) + imu_csv(1000, start=week).partition("\n")[2]
    gps = gps_csv(40) + gps_csv(60, start=week).partition("\n")[2]
    session = folder.write(imu__csv=imu, gps__csv=gps).load()
    assert session.imu is not None and len(session.gnss) == 60 and session.imu.t.size == 1000
    assert session.imu.t[0] >= week and "recordings_apart" in codes(session)
