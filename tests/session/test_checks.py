"""The table of checks: what a finding changes, what is said of it, and what no check is asked about."""

from collections.abc import Callable

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.errors import SessionError
from smoother.samples import GnssFixes, RawImu
from smoother.session.checks.fixes import PATH_CHECKS, ROW_CHECKS
from smoother.session.checks.imu import IMU_CHECKS, USABLE
from smoother.session.checks.table import Check, Finding, run
from smoother.session.checks.times import GAPS, TOGETHER, WHEEL_CHECKS
from smoother.session.fix_columns import FixColumns, FixRows, fix_columns
from smoother.session.recorded import Recording

from .checked import checked
from .folders import Folder, codes, gps_csv, imu_csv

N = 6
START = 1_700_000_000.0  # UTC


def rows() -> FixRows:
    t: Array = np.linspace(0.0, 1.0, N)
    return FixRows("fixes", "gps.csv", fix_columns(t, 45.0 + t, 12.0 + t, speed=t + 1.0, alt_m=t + 100.0))


def found(finding: Finding | None, needs: tuple[str, ...] = ()) -> tuple[FixColumns, list[str]]:
    """Columns as a finding leaves them, and what is said."""
    made, problems = run([Check("gps_odd", "fixes", needs, lambda _: finding)], rows())
    return made.columns, [f"{problem.code} {problem.count} {problem.text}" for problem in problems]


def test_a_finding_drops_rows_of_every_column_and_is_reported() -> None:
    columns, said = found(Finding("2 rows that are odd; dropped", 2, drop=np.arange(N) < 2))
    assert (
        columns.t.tolist() == rows().columns.t[2:].tolist() and columns.lat_deg.size == columns.is_blank.size == N - 2
    )
    assert said == ["gps_odd 2 gps.csv: 2 rows that are odd; dropped"]


@pytest.mark.parametrize(
    ("finding", "column", "want"),
    [
        (Finding(blank={"speed": np.arange(N) > 3}), "speed", lambda x: np.where(np.arange(N) > 3, np.nan, x)),
        (Finding(scale={"speed": 0.5}), "speed", lambda x: 0.5 * x),
    ],
)
def test_a_finding_changes_its_columns_and_nothing_else(
    finding: Finding, column: str, want: Callable[[Array], Array]
) -> None:
    before = rows().columns
    columns, said = found(finding)
    np.testing.assert_allclose(getattr(columns, column), want(getattr(before, column)))
    np.testing.assert_array_equal(columns.lon_deg, before.lon_deg)
    assert said == [], "nothing is said without a sentence"


def test_no_check_is_asked_about_what_is_not_there() -> None:
    odd = Finding("odd", drop=np.ones(N, dtype=np.bool_))
    assert found(odd, needs=("velocity_up",))[1] == [] and found(odd, needs=("speed",))[1] != []
    assert found(None)[1] == []
    ask = Check[Recording]("imu_odd", "imu", (), lambda r: Finding(f"{len(r.samples.t)} samples"))
    assert checked([ask], fixes())[1] == []


def test_each_check_sees_what_the_one_before_has_left() -> None:
    half = Check[FixRows]("gps_half", "fixes", (), lambda f: Finding("half", drop=np.arange(f.columns.t.size) % 2 == 0))
    assert run([half, half], rows())[0].columns.t.tolist() == [rows().columns.t[3]]


def test_codes_begin_with_what_they_are_about() -> None:
    tables = (*ROW_CHECKS, *PATH_CHECKS), (*USABLE, *IMU_CHECKS, *GAPS, *TOGETHER, *WHEEL_CHECKS)
    for check in (*tables[0], *tables[1]):
        assert check.code.partition("_")[0] in ("gps", "imu", "clock", "recordings", "wheel"), check.code


def fixes(pace: float = 0.0, leap: float = 0.0) -> GnssFixes:
    """Fixes of five minutes whose stamps run faster by `pace` for a minute, or leap."""
    true = np.arange(0.0, 300.0, 0.2)
    t = true + pace * np.clip(true - 100.0, 0.0, 60.0) + leap * (true > 150.0)
    return GnssFixes(t, 45.0 + 1e-5 * true, 0.0 * true + 12.0, 0.0 * true, np.zeros((t.size, 3)), unix_s=START + true)


def test_samples_of_any_reader_are_in_si_by_their_scale_and_not_copied() -> None:
    rng = np.random.default_rng(1)
    force = rng.normal([0.0, 0.0, 1.0], 0.05, (2000, 3))
    imu = RawImu(np.arange(2000) / 100.0, force, 0.1 * rng.standard_normal((2000, 3)))
    recording, problems = checked(USABLE, fixes(), imu)
    assert [problem.code for problem in problems] == ["imu_accel_unit"]
    assert recording.samples.accel_scale == pytest.approx(9.80665) and recording.samples.accel is imu.accel


def test_a_clock_that_started_again_in_both_tables_is_refused_with_what_to_do(folder: Folder) -> None:
    imu = imu_csv(900) + imu_csv(1100, start=0.003).partition("\n")[2]
    gps = gps_csv(45) + gps_csv(55, start=0.05).partition("\n")[2]
    with pytest.raises(SessionError, match="t_s starts again in both; split both files there, a session each"):
        folder.write(imu__csv=imu, gps__csv=gps).load()


def test_a_compass_whose_clock_started_again_is_not_used_and_reported(folder: Folder) -> None:
    mag = [f"{t:.2f},{1 + k % 3},2,3" for k, t in enumerate([*np.arange(0.0, 6.0, 0.1), *np.arange(0.03, 4.0, 0.1)])]
    raw = folder.write(imu__csv=imu_csv(), gps__csv=gps_csv(), mag__csv="\n".join(["t_s,mx,my,mz", *mag])).load()
    assert raw.mag is None and codes(raw) == {"mag_unusable": 1}
    assert "split it there; smoothed without magnetometer" in raw.problems[0].text
