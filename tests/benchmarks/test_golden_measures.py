"""What the golden table measures, on figures known by construction: laps, gates, errors, changes of a session."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from golden_command import Array, Table, columns, read_table
from golden_continuity import CHANGES, trajectory_change
from golden_laps import change_of_line, crossings, lap_times, slow_change
from golden_measures import KINDS, to_n, truth_columns
from golden_recordings import matched
from golden_thinned import kept_fixes, scored, with_one_more

RADIUS, LAP = 80.0, 40.0  # m, s
MOVES = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0], [-1.0, 1.0], [0.0, 0.0]])  # m, of each lap


def laps_of_circle(moves: Array) -> tuple[Array, Array, Array, Array]:
    """Times, path, starts and ends of laps on an ellipse, each moved (m); moved smoothly from one to the next."""
    t = np.arange(0.0, len(moves) * LAP, 0.1)
    angle = 2 * np.pi * t / LAP
    lap = np.minimum((t / LAP).astype(int), len(moves) - 1)
    path = np.stack([RADIUS * np.cos(angle), 0.6 * RADIUS * np.sin(angle)], axis=1) + moves[lap]
    starts = LAP * np.arange(len(moves))
    return t, path, starts, starts + LAP


def test_change_of_the_line_is_that_of_the_laps() -> None:
    found = change_of_line(*laps_of_circle(MOVES))
    assert found == pytest.approx(np.sqrt(np.mean(np.diff(MOVES, axis=0) ** 2)), rel=0.03)


def test_a_driver_who_runs_wide_in_one_corner_moves_no_lap() -> None:
    t, path, starts, ends = laps_of_circle(np.zeros((5, 2)))
    wide = (t % LAP > 4) & (t % LAP < 8) & (t // LAP == 2)
    path[wide] *= 1.04
    assert change_of_line(t, path, starts, ends) == pytest.approx(0.0, abs=0.1)


@pytest.mark.parametrize("sigma", [0.5, 2.0])
def test_the_slow_change_is_that_of_the_process_that_moved_the_laps(sigma: float) -> None:
    tau, found = 80.0, []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        t, path, starts, ends = laps_of_circle(np.zeros((12, 2)))
        keep = np.exp(-0.1 / tau)
        steps = sigma * np.sqrt(1 - keep**2) * rng.standard_normal(path.shape)
        steps[0] = sigma * rng.standard_normal(2)
        found.append(slow_change(t, path + lfilter([1.0], [1.0, -keep], steps, axis=0), starts, ends))
    true = sigma * np.sqrt(2 * (1 - np.exp(-LAP / tau)))
    assert np.exp(np.mean(np.log(found))) == pytest.approx(true, rel=0.25)


def test_what_a_driver_does_in_a_corner_is_hardly_a_slow_change() -> None:
    t, path, starts, ends = laps_of_circle(np.zeros((8, 2)))
    rng = np.random.default_rng(2)
    for lap in range(8):
        corner = (t // LAP == lap) & (t % LAP > 8) & (t % LAP < 14)
        path[corner] *= 1.0 + 0.006 * rng.standard_normal()  # half a metre
    found = slow_change(t, path, starts, ends)
    assert found is not None and found < 0.15


def test_two_laps_have_no_change() -> None:
    assert change_of_line(*laps_of_circle(MOVES[:2])) is None
    assert slow_change(*laps_of_circle(MOVES[:2])) is None


def test_a_gate_is_crossed_once_a_lap() -> None:
    t, path, _, _ = laps_of_circle(np.zeros((4, 2)))
    gate = np.array([[RADIUS - 5.0, 0.5], [RADIUS + 5.0, 0.5]])
    times = crossings(t, path, gate)
    np.testing.assert_allclose(np.diff(times), LAP, atol=1e-3)


def test_lap_times_are_scored_over_their_sigma() -> None:
    lap = {"valid": True, "start_s": 1.0, "end_s": 41.1, "lap_time_s": 40.1, "lap_time_sigma_s": 0.05}
    errors, scores = lap_times([lap, lap | {"valid": False}], np.array([1.2, 41.2]))
    np.testing.assert_allclose(errors, [0.1])
    np.testing.assert_allclose(scores, [2.0])


def test_laps_are_matched_as_sequences() -> None:
    pairs = matched(np.array([99.0, 50.1, 51.0, 52.0]), np.array([50.0, 51.0, 52.1, 60.0]))
    assert pairs.tolist() == [[1, 0], [2, 1], [3, 2]]


def test_a_site_is_a_tangent_plane() -> None:
    origin = {"lat_deg": 52.0, "lon_deg": 17.0, "alt_m": 100.0}
    n = to_n(np.array([52.001, 52.0]), np.array([17.0, 17.001]), np.array([100.0, 101.0]), origin)
    np.testing.assert_allclose(n, [[111.27, 0.0, 0.0], [0.0, -68.68, 1.0]], atol=0.02)


def trajectory(error: float = 0.0, delay: float = 0.0) -> Table:
    """A drive in a circle, every sigma 0.1, moved by `error` (m, m/s, degrees) and `delay` (s)."""
    t = np.arange(0.0, 60.0, 0.02)
    at = 0.3 * (t - delay)
    known = {
        "north_m": 20 * np.sin(at),
        "west_m": 20 * np.cos(at),
        "up_m": 0 * t,
        "vel_north_mps": 6 * np.cos(at),
        "vel_west_mps": -6 * np.sin(at),
        "vel_up_mps": 0 * t,
        "roll_deg": 0 * t,
        "pitch_deg": 0 * t,
        "yaw_deg": (np.degrees(at) + 180) % 360 - 180,
    }
    table = {name: values + error for name, values in known.items()}
    return {"t_s": t, **table, **{f"sigma_{name}": 0 * t + 0.1 for name in known}, "sigma_track_m": 0 * t + 0.1}


ORIGIN = {"origin": {"lat_deg": 52.0, "lon_deg": 17.0, "alt_m": 100.0}}


def test_errors_and_shares_within_sigma() -> None:
    found = truth_columns(trajectory(0.15), trajectory(), ORIGIN)
    for kind, names in KINDS.items():
        assert found[f"error.{kind}"] == pytest.approx(0.15 * np.sqrt(len(names)), rel=1e-6)
        assert (found[f"within1.{kind}"], found[f"within2.{kind}"]) == (0.0, 1.0)
    assert found["error.horizontal_shape"] == pytest.approx(0.0, abs=1e-9)
    assert found["error.relative_1s"] == pytest.approx(0.0, abs=1e-9)


def test_the_lag_of_a_truth_is_found() -> None:
    truth = trajectory(delay=0.4)
    assert "lag.position" not in truth_columns(trajectory(), truth, ORIGIN)
    found = truth_columns(trajectory(), truth, ORIGIN, fit_lag=True)
    assert found["lag.position"] == pytest.approx(0.4, abs=0.002)
    assert found["lag.velocity"] == pytest.approx(0.4, abs=0.002)
    assert found["error.horizontal"] == pytest.approx(0.0, abs=0.01)


def test_change_of_a_result_is_over_its_own_sigma() -> None:
    found = trajectory_change(trajectory(), trajectory(0.05))
    assert found["change.velocity"] == pytest.approx(0.5)
    assert found["change.yaw"] == pytest.approx(0.5)
    assert found["change.line"] == pytest.approx(0.0, abs=1e-9)


def session(folder: Path) -> Path:
    """Write ten seconds of samples and of fixes, four a second."""
    t = np.arange(0.0, 10.0, 0.25)
    random = np.random.default_rng(1)
    for name, header in (("gps", "t_s,lat_deg,lon_deg"), ("imu", "t_s,ax,ay,az,gx,gy,gz"), ("mag", "t_s,mx,my,mz")):
        width = header.count(",")
        values = np.stack([t, *random.uniform(1.0, 2.0, (width, len(t)))], axis=1)
        np.savetxt(folder / f"{name}.csv", values, "%.6f", ",", header=header, comments="")
    return folder


@pytest.mark.parametrize("change", CHANGES)
def test_a_change_changes_the_files_as_its_name(change: str, tmp_path: Path) -> None:
    before = {name: read_table(session(tmp_path) / f"{name}.csv") for name in ("gps", "imu", "mag")}
    CHANGES[change](tmp_path)
    after = {name: read_table(tmp_path / f"{name}.csv") for name in before}
    fixes, moved = before["gps"], after["gps"]
    match change:
        case "fix_dropped":
            assert len(moved["t_s"]) == len(fixes["t_s"]) - 1
        case "rows_swapped":
            order = np.argsort(moved["t_s"])
            assert np.flatnonzero(order != np.arange(len(order))).tolist() == [20, 21]
        case "first_second_cut":
            assert moved["t_s"][0] == 0.0
            assert after["imu"]["t_s"][0] == after["mag"]["t_s"][0] == 1.0
        case "times_moved":
            for name, table in after.items():
                np.testing.assert_allclose(table["t_s"], before[name]["t_s"] + 1000.0)
        case "site_moved":
            np.testing.assert_allclose(moved["lon_deg"], fixes["lon_deg"] + 50.0)
        case "box_turned":
            pairs = [("imu", ("ax", "ay", "az")), ("imu", ("gx", "gy", "gz")), ("mag", ("mx", "my", "mz"))]
            turns = [np.linalg.lstsq(columns(before[f], *n), columns(after[f], *n))[0].T for f, n in pairs]
            np.testing.assert_allclose(turns[0] @ turns[0].T, np.eye(3), atol=1e-6)
            assert np.linalg.det(turns[0]) == pytest.approx(1.0)
            np.testing.assert_allclose(turns[1:], [turns[0]] * 2, atol=1e-6)
        case "columns_reordered":
            assert list(moved) == list(fixes)[::-1]
            assert all(np.array_equal(moved[name], fixes[name]) for name in fixes)
        case _:
            pytest.fail(f"{change}: nothing is checked")


def test_fixes_are_thinned_by_phase() -> None:
    t = np.arange(0.0, 20.0, 0.25)
    fixes = {"t_s": t, "lat_deg": 52 + 1e-6 * t, "lon_deg": 17 + 0 * t, "hacc_m": 0 * t + 1.0}
    kept = kept_fixes(fixes, 5.0, 0.0)
    assert t[kept].tolist() == [0.0, 5.0, 10.0, 15.0]
    assert t[kept_fixes(fixes, 5.0, 0.5)].tolist() == [2.5, 7.5, 12.5, 17.5]
    assert t[with_one_more(fixes, kept)].tolist() == [0.0, 5.0, 10.0, 15.0, 15.25]
    left_out = t[scored(fixes, kept)]
    assert left_out.min() > 1.0 and left_out.max() < 15.0 and not set(left_out) & {5.0, 10.0}


def test_repeated_and_poor_fixes_are_not_scored() -> None:
    t = np.arange(0.0, 20.0, 0.25)
    fixes = {"t_s": t, "lat_deg": 52 + 1e-6 * t, "lon_deg": 17 + 0 * t, "hacc_m": 0 * t + 1.0}
    fixes["lat_deg"][30] = fixes["lat_deg"][29]
    fixes["hacc_m"][33] = 4.0
    assert {30, 33}.isdisjoint(scored(fixes, kept_fixes(fixes, 5.0, 0.0)).tolist())
