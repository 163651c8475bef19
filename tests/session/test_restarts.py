"""A clock that starts again while both tables go on: parts of one run stay together."""

from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import RawSession
from smoother.session.load import load_raw
from smoother.session.restarts import pair_parts

Runs = tuple[tuple[float, float, float], ...]
RUNS: Runs = ((0.0, 60.0, 30.0), (0.0, 90.0, 5.0), (0.0, 50.0, 20.0))  # first and last sample, first fix, s
OFF = 40.0  # s for which the logger was off between them


def session(folder: Path, runs: Runs, *, utc: bool, without_fixes: int = -1) -> RawSession:
    """Runs of one drive on clocks of their own; of the one `without_fixes` gps.csv has none."""
    imu, fixes, mag, start = [], [], [], 0.0
    for number, (first, last, first_fix) in enumerate(runs):
        for t in np.arange(first, last, 0.02):
            k = round(50 * (start + t))
            imu.append(f"{t:.3f},0.{k % 7},0.{k % 5},9.8{k % 3},0.00{k % 4},0,{1e-5 * k:.5f}")
            mag.append(f"{t:.3f},{k},1,2")
        for t in np.arange(first_fix, last, 0.2) if number != without_fixes else ():
            place = start + t
            fixes.append(f"{t:.2f},{45 + 1e-4 * place:.8f},12.0" + (f",{1.7e9 + place:.2f}" if utc else ""))
        start += last + OFF
    header = "t_s,lat_deg,lon_deg" + (",unix_s" if utc else "")
    (folder / "imu.csv").write_text("\n".join(["t_s,ax,ay,az,gx,gy,gz", *imu]))
    (folder / "gps.csv").write_text("\n".join([header, *fixes]))
    (folder / "mag.csv").write_text("\n".join(["t_s,mx,my,mz", *mag]))
    return load_raw(folder)


def drive_time_of(raw: RawSession) -> tuple[Array, Array, Array]:
    """When on the one clock of the drive each sample, fix and reading of the compass was taken, by its value, s."""
    assert raw.imu is not None and raw.mag is not None
    return 2e3 * raw.imu.gyro[:, 2], 1e4 * (raw.gnss.lat_deg - 45.0), 0.02 * raw.mag.field[:, 0]


@pytest.mark.parametrize("runs", [RUNS[:2], RUNS])
def test_runs_are_joined_by_the_utc_of_their_fixes(tmp_path: Path, runs: Runs) -> None:
    raw = session(tmp_path, runs, utc=True)
    assert raw.imu is not None and raw.mag is not None
    for t, drive_time in zip((raw.imu.t, raw.gnss.t, raw.mag.t), drive_time_of(raw), strict=True):
        np.testing.assert_allclose(t, drive_time, atol=0.03)
    assert len(raw.imu.t) == sum(round(50 * last) for _, last, _ in runs)
    (said,) = [problem for problem in raw.problems if "clock" in problem.code]
    at = "60 s" if len(runs) == 2 else "60 s, 190 s"
    assert said.text == f"imu.csv and gps.csv: the clock started again at {at}; joined by UTC"
    assert said.count == len(runs) - 1


def test_without_utc_the_run_is_kept_in_which_both_ran_longest(tmp_path: Path) -> None:
    raw = session(tmp_path, RUNS, utc=False)
    assert raw.imu is not None and raw.mag is not None
    for t, drive_time in zip((raw.imu.t, raw.gnss.t, raw.mag.t), drive_time_of(raw), strict=True):
        np.testing.assert_allclose(t + RUNS[0][1] + OFF, drive_time, atol=0.03)
    (said,) = [problem for problem in raw.problems if "clock" in problem.code]
    assert said.code == "clock_restart" and "of 3 parts number 2 is used (0 to 90 s)" in said.text
    assert said.count == 5500 + 300


def test_samples_of_a_run_without_a_fix_are_left_out(tmp_path: Path) -> None:
    raw = session(tmp_path, RUNS, utc=True, without_fixes=0)
    assert raw.imu is not None and raw.mag is not None
    for t, drive_time in zip((raw.imu.t, raw.gnss.t, raw.mag.t), drive_time_of(raw), strict=True):
        np.testing.assert_allclose(t + RUNS[0][1] + OFF, drive_time, atol=0.03)
    (said,) = [problem for problem in raw.problems if "clock" in problem.code]
    assert said.text.endswith("at 90 s; joined by UTC; 3000 rows left out, of parts that only one file has")


def test_parts_of_one_run_are_those_that_begin_and_end_alike(tmp_path: Path) -> None:
    """Fixes of the third run share more time with the samples of the second, which lasts longer than either."""
    raw = session(tmp_path, ((0.0, 60.0, 0.0), (0.0, 120.0, 0.0), (20.0, 90.0, 0.0)), utc=True, without_fixes=1)
    assert raw.imu is not None and raw.mag is not None
    for t, drive_time in zip((raw.imu.t, raw.gnss.t, raw.mag.t), drive_time_of(raw), strict=True):
        np.testing.assert_allclose(t, drive_time, atol=0.03)
    assert len(raw.imu.t) == 50 * 130


@pytest.mark.parametrize("missing", [0, 1, 2])
def test_a_compass_may_be_missing_in_a_run(tmp_path: Path, missing: int) -> None:
    session(tmp_path, RUNS, utc=True)
    header, *rows = (tmp_path / "mag.csv").read_text().splitlines()
    bounds = np.cumsum([1, *(round(50 * last) for _, last, _ in RUNS)]) - 1
    del rows[bounds[missing] : bounds[missing + 1]]
    (tmp_path / "mag.csv").write_text("\n".join([header, *rows]))
    raw = load_raw(tmp_path)
    assert raw.mag is not None and len(raw.mag.t) == len(rows)
    np.testing.assert_allclose(raw.mag.t, drive_time_of(raw)[2], atol=0.03)


def test_a_compass_whose_clock_went_on_is_left_out(tmp_path: Path) -> None:
    session(tmp_path, RUNS[:2], utc=True)
    rows = [f"{0.05 * k:.3f},{k},1,2" for k in range(3000)]
    (tmp_path / "mag.csv").write_text("\n".join(["t_s,mx,my,mz", *rows]))
    raw = load_raw(tmp_path)
    (said,) = [problem.text for problem in raw.problems if problem.code == "mag_unusable"]
    assert raw.mag is None and "its clock did not start again when that of the samples did" in said


def test_rows_without_a_time_are_counted_though_the_clock_started_again(tmp_path: Path) -> None:
    session(tmp_path, RUNS[:2], utc=True)
    for name in ("imu.csv", "gps.csv"):
        rows = (tmp_path / name).read_text().splitlines()
        rows[100] = "," + rows[100].partition(",")[2]
        (tmp_path / name).write_text("\n".join(rows))
    said = {problem.code: problem.count for problem in load_raw(tmp_path).problems}
    assert said["imu_invalid"] == said["gps_invalid"] == 1 and "clock_joined" in said


@pytest.mark.parametrize(("parts", "is_restarted"), [(20, True), (21, False)])
def test_a_clock_that_falls_all_the_time_is_no_clock_that_starts_again(parts: int, is_restarted: bool) -> None:
    t, unix_s = np.tile(np.arange(0.0, 50.0, 0.5), parts), 1.7e9 + 0.5 * np.arange(100 * parts)
    assert (pair_parts(t, t, unix_s, "imu.csv and gps.csv") is not None) == is_restarted


def test_a_stray_stamp_before_the_clock_starts_again_does_not_keep_runs_apart(tmp_path: Path) -> None:
    session(tmp_path, RUNS[:2], utc=True)
    rows = (tmp_path / "imu.csv").read_text().splitlines()
    rows[3000] = "100000000," + rows[3000].partition(",")[2]  # the last one of the first run
    (tmp_path / "imu.csv").write_text("\n".join(rows))
    raw = load_raw(tmp_path)
    assert raw.imu is not None and len(raw.imu.t) == 7499
    assert "clock_joined" in [problem.code for problem in raw.problems]
