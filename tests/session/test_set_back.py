"""A clock that is set back by an hour, or a day, in the midst of a recording."""

from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import RawSession
from smoother.session.load import load_raw

FALL = 40.0  # s
T_IMU, T_FIX = 3600.0 + np.arange(8000) / 100.0, 3600.1 + np.arange(400) / 5.0


def session(folder: Path, fall: float, utc: Array | None) -> RawSession:
    """A session whose clock falls by `fall` s after FALL."""
    imu_t, fix_t = (np.where(t - 3600.0 < FALL, t, t - fall) for t in (T_IMU, T_FIX))
    imu = [f"{t:.4f},0.{k % 7},0.{k % 5},9.8{k % 3},0.00{k % 4},0,0.01{k % 9}" for k, t in enumerate(imu_t)]
    fixes = [f"{t:.2f},{45 + 1e-4 * k:.7f},12.0" for k, t in enumerate(fix_t)]
    if utc is not None:
        fixes = [f"{fix},{unix:.2f}" for fix, unix in zip(fixes, utc, strict=True)]
    (folder / "imu.csv").write_text("\n".join(["t_s,ax,ay,az,gx,gy,gz", *imu]))
    mag = [f"{t:.4f},{k},1,2" for k, t in enumerate(imu_t)]
    (folder / "mag.csv").write_text("\n".join(["t_s,mx,my,mz", *mag]))
    (folder / "gps.csv").write_text("\n".join(["t_s,lat_deg,lon_deg" + ("" if utc is None else ",unix_s"), *fixes]))
    return load_raw(folder)


@pytest.mark.parametrize(
    ("fall", "said"),
    [(3600.0, "set back by an hour at 3640 s"), (86400.0, "times of day start again at midnight, after 3640 s")],
)
@pytest.mark.parametrize("utc", [None, 1.7e9 + T_FIX])
def test_what_follows_a_clock_that_was_set_back_is_joined_and_said(
    tmp_path: Path, utc: Array | None, fall: float, said: str
) -> None:
    raw = session(tmp_path, fall, utc)
    assert [p.code for p in raw.problems if "clock" in p.code] == [
        f"{file}_clock_set_back" for file in ("imu", "gps", "mag")
    ]
    assert said in raw.problems[0].text
    assert raw.imu is not None and raw.mag is not None
    np.testing.assert_allclose(raw.mag.t, T_IMU, atol=1e-3)
    np.testing.assert_allclose(raw.imu.t, T_IMU, atol=1e-3)
    np.testing.assert_allclose(raw.gnss.t, T_FIX, atol=2e-2)


@pytest.mark.parametrize(
    ("fall", "utc"),
    [
        (3500.0, None),  # as when it is started again
        (86300.0, None),
        (3600.0, 1.7e9 + np.where(T_FIX - 3600.0 < FALL, T_FIX, T_FIX - 3600.0)),  # UTC does not know better
    ],
)
def test_a_clock_that_was_started_again_is_not_joined(tmp_path: Path, fall: float, utc: Array | None) -> None:
    raw = session(tmp_path, fall, utc)
    assert {p.code for p in raw.problems if "clock" in p.code} == {"clock_restart"}


def test_single_stamps_an_hour_early_are_dropped(tmp_path: Path) -> None:
    session(tmp_path, 0.0, None)
    rows = (tmp_path / "imu.csv").read_text().splitlines()
    for row in (500, 700):
        time, _, values = rows[row].partition(",")
        rows[row] = f"{float(time) - 3600.0:.4f},{values}"
    (tmp_path / "imu.csv").write_text("\n".join(rows))
    raw = load_raw(tmp_path)
    assert raw.imu is not None and raw.imu.t.size == 7998
    assert {p.code: p.count for p in raw.problems if "order" in p.code} == {"imu_out_of_order": 2}
