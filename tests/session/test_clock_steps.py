"""A clock that was set back by a moment while it recorded: found, mended where it is alone, seen nowhere else."""

from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.samples import RawSession
from smoother.session.clock_steps import find_step_back
from smoother.session.load import load_raw
from smoother.session.rows import in_time_order

NUMBER = np.arange(2000)
PLACE = np.sin(0.37 * NUMBER) + 1e-3 * NUMBER  # of a row, another for each


def set_back(by: float, row: int = 900, late: float = 0.0) -> Array:
    """Times of rows ten a second, late by up to some s, of which those from a row on are early by `by` s."""
    t = 100.0 + 0.1 * NUMBER + late * np.random.default_rng(1).random(NUMBER.size)
    return np.asarray(np.round(np.where(row > NUMBER, t, t - by), 3))


@pytest.mark.parametrize("late", [0.0, 0.004, 0.03])
@pytest.mark.parametrize("by", [0.25, 0.5, 1.3])
def test_a_clock_set_back_by_a_moment_is_found(by: float, late: float) -> None:
    found = find_step_back(set_back(by, late=late), [PLACE])
    assert found is not None and found.is_even and found.row == 900
    assert found.by == pytest.approx(by, abs=0.001 + 0.5 * late)


def test_where_rows_are_missing_nearby_or_the_clock_is_set_right_again_it_is_not_sure_by_how_much() -> None:
    t = np.delete(set_back(1.3), [895, 907])
    found = find_step_back(t, [np.delete(PLACE, [895, 907])])
    assert found is not None and not found.is_even
    t = np.where(NUMBER < 1500, set_back(1.3), set_back(0.0))
    found = find_step_back(t, [PLACE])
    assert found is not None and not found.is_even


@pytest.mark.parametrize(
    "rows",
    [
        [*range(905), *range(900, 2000)],  # written again
        [*range(950), *range(940, 950), *range(950, 2000)],
        [*range(900), *range(910, 920), *range(900, 910), *range(920, 2000)],  # in another order
        [*range(2000), *range(1990, 2000)],
        [*range(900), *range(880, 890), *range(910, 2000)],  # older ones in place of others
        np.arange(2000).reshape(-1, 10)[:, ::-1].ravel(),
    ],
)
def test_rows_written_again_or_in_another_order_are_no_clock_that_was_set(rows: list[int]) -> None:
    assert find_step_back(set_back(0.0)[rows], [PLACE[rows]]) is None


@pytest.mark.parametrize("by", [30.0, 5000.0])
def test_a_stray_time_and_a_restart_are_none_either(by: float) -> None:
    assert find_step_back(set_back(by), [PLACE]) is None
    t = set_back(0.0)
    t[900] -= by
    assert find_step_back(t, [PLACE]) is None


@pytest.mark.parametrize("is_alone", [True, False])
def test_rows_are_joined_only_where_nothing_else_keeps_to_their_clock(is_alone: bool) -> None:
    ordered = in_time_order(set_back(1.3), PLACE, file="gps.csv", prefix="gps", is_alone=is_alone)
    time, index, problem = ordered.t, ordered.index, ordered.problems[0]
    assert problem.code == "gps_clock_behind" and "its clock was set back by 1.30 s at 190 s" in problem.text
    if is_alone:
        np.testing.assert_allclose(time, set_back(0.0), atol=1e-6)
        assert index.size == NUMBER.size and len(ordered.problems) == 1
    else:
        assert "what follows stands so much too early" in problem.text and index.size < NUMBER.size


def session(folder: Path, has_imu: bool) -> RawSession:
    t, fixes = set_back(1.3), ["t_s,lat_deg,lon_deg"]
    fixes += [f"{time:.3f},{45.0 + 1e-5 * k:.7f},{12.0 + 1e-5 * np.sin(k):.7f}" for k, time in enumerate(t)]
    (folder / "gps.csv").write_text("\n".join(fixes))
    if has_imu:
        times = np.where(NUMBER.repeat(10) < 900, 0.0, -1.3) + 100.0 + 0.01 * np.arange(20_000)
        imu = [f"{time:.3f},0.{k % 7},0.{k % 5},9.8{k % 3},0.00{k % 4},0,0.01{k % 9}" for k, time in enumerate(times)]
        (folder / "imu.csv").write_text("\n".join(["t_s,ax,ay,az,gx,gy,gz", *imu]))
    return load_raw(folder)


def test_fixes_alone_are_joined_where_their_clock_was_set_back(tmp_path: Path) -> None:
    raw = session(tmp_path, has_imu=False)
    np.testing.assert_allclose(raw.gnss.t, set_back(0.0), atol=1e-3)
    assert [p.text for p in raw.problems if p.code == "gps_clock_behind"] == [
        "gps.csv: its clock was set back by 1.30 s at 190 s, while rows went on evenly; what follows is joined to what "
        "was before"
    ]


def test_fixes_beside_samples_of_the_same_clock_stay_with_them(tmp_path: Path) -> None:
    raw = session(tmp_path, has_imu=True)
    assert raw.imu is not None
    assert raw.gnss.t[-1] == pytest.approx(set_back(1.3)[-1], abs=1e-3)
    assert raw.imu.t[-1] == pytest.approx(raw.gnss.t[-1], abs=0.1)
    assert {"imu_clock_behind", "gps_clock_behind"} <= {p.code for p in raw.problems}
