"""Verdicts on made-up results, and what is done to the files of a hard session."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

from golden_command import Outcome, Table, read_table
from golden_hard import (
    QUANTITIES,
    SESSIONS,
    coming_in,
    compare,
    compass_reversed,
    low_passed,
    one_fix_south,
    rattling_after,
    rotation,
    samples_on_a_clock_of_their_own,
    speed_behind_low_pass,
    turned_after,
    velocity_off,
    verdict,
)

T = np.arange(0.0, 60.0, 0.02)
ERROR = {"_m": 0.5, "_mps": 0.05, "_deg": 0.5}  # of the made-up trajectory, by unit


def unit(column: str) -> float:
    """The error of a column."""
    return next(error for ending, error in ERROR.items() if column.endswith(ending))


def tables(sigma: float = 1.0, **changed: float) -> tuple[Table, Table, Table]:
    """Trajectory, truth and fixes; errors are 1 in units of `ERROR`, of a column named what is named, sigmas `sigma`.

    The fixes are 2 m off.
    """
    zero = np.zeros_like(T)
    truth = {"t_s": T, **dict.fromkeys(QUANTITIES.values(), zero)}
    truth["yaw_deg"] = (10.0 * T + 180.0) % 360.0 - 180.0
    trajectory = {"t_s": T + 0.007}
    for column in QUANTITIES.values():
        error = unit(column) * changed.get(column, 1.0)
        true = 10.0 * trajectory["t_s"] if column == "yaw_deg" else 0.0
        wrapped = (true + error + 180.0) % 360.0 - 180.0 if column == "yaw_deg" else error + zero
        trajectory |= {column: wrapped, f"sigma_{column}": sigma * unit(column) + zero}
    t = np.arange(0.0, 60.0, 0.2)
    fixes = {"t_s": t, "north_m": np.full_like(t, 2.0), "west_m": np.zeros_like(t)}
    return trajectory, truth, fixes | {name: np.zeros_like(t) for name in ("vel_north_mps", "vel_west_mps")}


def outcome(code: int = 0, **document: Any) -> Outcome:
    return Outcome(code, json.dumps(document), "")


def test_errors_within_their_sigmas_are_right() -> None:
    compared = compare(*tables())
    assert compared.horizontal == pytest.approx(0.5 * np.sqrt(2))
    assert compared.horizontal_gps == pytest.approx(2.0)
    assert verdict(outcome(), compared) == "right"


@pytest.mark.parametrize(("name", "column"), QUANTITIES.items())
def test_a_sigma_that_is_too_small_is_silently_wrong(name: str, column: str) -> None:
    assert verdict(outcome(), compare(*tables(**{column: 2.1}))) == f"silently wrong: sigma of {name} too small"


def test_sigmas_a_third_of_the_errors_are_silently_wrong() -> None:
    assert verdict(outcome(), compare(*tables(sigma=1 / 3))).startswith("silently wrong: sigma of")


def test_positions_worse_than_the_fixes_are_silently_wrong_however_wide_the_sigma() -> None:
    compared = compare(*tables(sigma=10.0, north_m=5.0))
    assert verdict(outcome(), compared) == "silently wrong: position worse than the fixes alone"


def test_a_share_of_a_fifth_outside_is_the_limit() -> None:
    trajectory, truth, fixes = tables()
    for outside, expected in ((0.19, "right"), (0.21, "silently wrong: sigma of pitch too small")):
        pitch = np.where(outside * 60.0 > T, 5.0, 0.5)
        assert verdict(outcome(), compare({**trajectory, "pitch_deg": pitch}, truth, fixes)) == expected


def test_unknown_sigmas_and_a_truth_elsewhere_are_silently_wrong() -> None:
    trajectory, truth, fixes = tables()
    nan = {f"sigma_{column}": np.full_like(T, np.nan) for column in QUANTITIES.values()}
    assert verdict(outcome(), compare({**trajectory, **nan}, truth, fixes)) == "silently wrong: no quantity has a sigma"
    later = {**trajectory, "t_s": T + 1000.0}
    assert verdict(outcome(), compare(later, truth, fixes)) == "silently wrong: results do not overlap the truth"
    assert verdict(outcome(), None) == "silently wrong: exit 0 without results"


def test_refusals_are_named_by_exit_code_and_first_reason() -> None:
    quality = {"reasons": ["the kart leans by 4.2 deg: did the logger move?", "more"]}
    far = compare(*tables(north_m=50.0))
    assert verdict(outcome(3, quality=quality), far) == "exit 3: the kart leans by # deg: did the logger move?"
    assert verdict(outcome(2), None) == "exit 2"
    assert verdict(outcome(1), None) == "exit 1"


def test_names_are_unique_words_and_six_are_quick() -> None:
    names = [session.name for session in SESSIONS]
    assert len(set(names)) == len(names)
    assert not any(" " in name for name in names)
    assert sum(session.quick for session in SESSIONS) == 6


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session of 20 s, 10 samples a second, with fixes of 1 Hz going north at 10 m/s; gps.csv is a link."""
    folder, cache = tmp_path / "session", tmp_path / "cache"
    folder.mkdir()
    cache.mkdir()
    t = np.arange(200) / 10.0
    samples = {"t_s": t, "ax": 1.0 + 0.0 * t, "ay": 2.0 + 0.0 * t, "az": 9.8 + 0.0 * t}
    pl.DataFrame({**samples, "gx": 0.1 + 0.0 * t, "gy": 0.2 + 0.0 * t, "gz": 0.3 + 0.0 * t}).write_csv(
        folder / "imu.csv"
    )
    pl.DataFrame({"t_s": t, "mx": 20.0 + 0.0 * t, "my": 1.0 + 0.0 * t, "mz": 40.0 + 0.0 * t}).write_csv(
        folder / "mag.csv"
    )
    at = 0.5 + np.arange(19.0)
    fixes = {"t_s": at, "lat_deg": 45.0 + at * 1e-4, "lon_deg": 13.0 + 0.0 * at, "speed_mps": 10.0 + 0.0 * at}
    pl.DataFrame({**fixes, "course_deg": 358.0 + 0.0 * at, "alt_m": [None] * 19}).write_csv(cache / "gps.csv")
    (folder / "gps.csv").symlink_to(cache / "gps.csv")
    velocity = np.where(t < 10.0, 0.0, 10.0)
    pl.DataFrame({"t_s": t, "vel_north_mps": velocity, "vel_west_mps": 0.0 * t}).write_csv(folder / "truth.csv")
    return folder


def column(folder: Path, file: str, *names: str) -> np.ndarray:
    table = read_table(folder / file)
    return np.stack([table[name] for name in names], axis=1)


def test_a_turn_of_the_logger_keeps_sizes_and_what_was_before(session: Path) -> None:
    turned_after(10.0, (0.0, 90.0, 0.0))(session)
    accel = column(session, "imu.csv", "ax", "ay", "az")
    np.testing.assert_allclose(accel[100], [1.0, 2.0, 9.8])  # not yet at 10 s
    np.testing.assert_allclose(accel[101], [9.8, 2.0, -1.0], atol=1e-6)
    np.testing.assert_allclose(column(session, "mag.csv", "mx", "my", "mz")[150], [40.0, 1.0, -20.0], atol=1e-4)
    np.testing.assert_allclose(column(session, "imu.csv", "gx", "gy", "gz")[150], [0.3, 0.2, -0.1], atol=1e-8)


def test_a_rotation_is_one() -> None:
    R = rotation(np.array([0.3, -0.2, 0.5]))
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(R @ [0.3, -0.2, 0.5], [0.3, -0.2, 0.5])
    assert np.trace(R) == pytest.approx(1.0 + 2.0 * np.cos(np.linalg.norm([0.3, -0.2, 0.5])))


def test_a_loose_logger_swings_and_is_fastened_again(session: Path) -> None:
    rattling_after(5.0, 4.0)(session)
    gyro, accel = (column(session, "imu.csv", *names) for names in (("gx", "gy", "gz"), ("ax", "ay", "az")))
    still = np.r_[0:51, 90:200]
    np.testing.assert_allclose(gyro[still, 0], 0.1)
    np.testing.assert_allclose(accel[still], np.tile([1.0, 2.0, 9.8], (len(still), 1)))
    moving = np.arange(51, 90)
    assert np.ptp(gyro[moving, 0]) == pytest.approx(2 * np.radians(15.0) * 2 * np.pi, rel=0.05)
    np.testing.assert_allclose(np.linalg.norm(accel[moving], axis=1), np.sqrt(1 + 4 + 9.8**2), atol=1e-5)


def test_one_fix_goes_south_and_the_cache_stays(session: Path) -> None:
    before = (session.parent / "cache" / "gps.csv").read_bytes()
    one_fix_south(session)
    lat = column(session, "gps.csv", "lat_deg")
    assert np.flatnonzero(lat < 0.0).tolist() == [9]
    assert (session.parent / "cache" / "gps.csv").read_bytes() == before
    assert np.isnan(column(session, "gps.csv", "alt_m")).all()


def test_the_field_is_mirrored(session: Path) -> None:
    compass_reversed(session)
    np.testing.assert_allclose(column(session, "mag.csv", "mx", "my", "mz")[0], [-20.0, -1.0, 40.0])


def test_clocks_begin_together_and_part(session: Path) -> None:
    samples_on_a_clock_of_their_own(0.01)(session)
    for name in ("imu.csv", "mag.csv"):
        np.testing.assert_allclose(column(session, name, "t_s")[[5, 105], 0], [0.5, 10.6])


def test_positions_come_in_from_the_north(session: Path) -> None:
    coming_in(40.0, 5.0)(session)
    off = (column(session, "gps.csv", "lat_deg")[:, 0] - 45.0 - (0.5 + np.arange(19.0)) * 1e-4) * 111_200.0
    np.testing.assert_allclose(off[[0, 5]], [40.0, 40.0 / np.e], atol=1e-4)


def test_velocities_turn_to_the_right_past_north_and_grow(session: Path) -> None:
    velocity_off(4.0, 1.03)(session)
    np.testing.assert_allclose(column(session, "gps.csv", "speed_mps", "course_deg")[3], [10.3, 2.0])


def test_a_low_pass_is_late_by_its_time_constant() -> None:
    t = np.arange(0.0, 5.0, 0.005)
    assert t[-1] - low_passed(t, 0.005, 0.5)[-1] == pytest.approx(0.5, abs=0.01)


def test_smoothed_speeds_lag_a_step(session: Path) -> None:
    speed_behind_low_pass(2.0, 0.0)(session)
    speed = column(session, "gps.csv", "speed_mps")[:, 0]
    np.testing.assert_allclose(speed[:9], 10.0)  # nothing changes before the step at 10 s
    assert speed[10] == pytest.approx(10.0 - 10.0 * np.exp(-0.55 / 2.0), abs=0.2)
    assert speed[-1] == pytest.approx(10.0, abs=0.2)
