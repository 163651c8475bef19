"""contracts.md 5: trajectory.csv and baseline.csv, their columns, frames, signs and units.

Signs are judged by physics (what moves west loses longitude, what speeds up is accelerated forward) or by truth.csv.
"""

import datetime as dt
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

TABLES_ONLY = ("--no-figures", "--no-baseline")
Read = Callable[[Path], pl.DataFrame]
COLUMNS = (
    "t_s,utc,lat_deg,lon_deg,alt_m,north_m,west_m,up_m,vel_north_mps,vel_west_mps,vel_up_mps,speed_mps,"
    "roll_deg,pitch_deg,yaw_deg,accel_forward_mps2,accel_left_mps2,accel_up_mps2,yaw_rate_dps,sigma_north_m,"
    "sigma_west_m,sigma_up_m,sigma_vel_north_mps,sigma_vel_west_mps,sigma_vel_up_mps,sigma_speed_mps,"
    "sigma_roll_deg,sigma_pitch_deg,sigma_yaw_deg,sigma_track_m,lap,lap_distance_m"
)
GRAVITY = 9.81
METRES_A_DEGREE = 111_200.0


def column(rows: pl.DataFrame, name: str) -> np.ndarray:
    return rows[name].cast(pl.Float64).to_numpy()


def columns(rows: pl.DataFrame, *names: str) -> np.ndarray:
    return np.stack([column(rows, name) for name in names], axis=-1)


def turn(degrees: np.ndarray) -> np.ndarray:
    """Angles brought into (-180, 180]."""
    return 180.0 - np.mod(180.0 - degrees, 360.0)


def at_times(t: np.ndarray, rows: pl.DataFrame, name: str) -> np.ndarray:
    return np.interp(t, column(rows, "t_s"), column(rows, name))


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def test_the_columns_are_those_of_the_contract_in_its_order(trajectory: pl.DataFrame) -> None:
    assert ",".join(trajectory.columns) == COLUMNS


def test_baseline_has_the_same_columns_and_rows_and_an_own_estimate(
    results: Path, trajectory: pl.DataFrame, read: Read
) -> None:
    baseline = read(results / "baseline.csv")
    assert baseline.columns == trajectory.columns
    np.testing.assert_array_equal(column(baseline, "t_s"), column(trajectory, "t_s"))
    apart = columns(baseline, "north_m", "west_m") - columns(trajectory, "north_m", "west_m")
    assert 0.1 < rms(apart) < 30.0


@pytest.mark.slow
def test_rows_run_from_the_first_to_the_last_fix_at_the_rate_without_a_hole_through_outages(
    short: Path, smooth: Any, read: Read
) -> None:
    fixes = read(short / "gps.csv")
    fixes.filter(~pl.col("t_s").is_between(12.0, 18.0)).write_csv(short / "gps.csv")
    assert smooth(short, "--rate", "20", *TABLES_ONLY).code in (0, 3)
    rows = read(short / "smoothed" / "trajectory.csv")
    t = column(rows, "t_s")
    np.testing.assert_allclose(np.diff(t), 0.05, atol=2e-6)
    assert t[0] == pytest.approx(fixes["t_s"][0], abs=1e-6)
    assert 0.0 <= fixes["t_s"][-1] - t[-1] < 0.05
    for name in ("lat_deg", "lon_deg", "alt_m", "north_m", "west_m", "up_m", "vel_north_mps", "sigma_north_m"):
        assert np.isfinite(column(rows, name)).all(), name


def test_the_rate_is_50_where_none_is_asked_for(trajectory: pl.DataFrame) -> None:
    np.testing.assert_allclose(np.diff(column(trajectory, "t_s")), 0.02, atol=2e-6)


def test_latitude_longitude_and_height_are_north_west_and_up_of_the_origin(
    trajectory: pl.DataFrame, summary: dict[str, Any]
) -> None:
    origin = summary["origin"]
    assert set(origin) == {"lat_deg", "lon_deg", "alt_m"}
    north = (column(trajectory, "lat_deg") - origin["lat_deg"]) * METRES_A_DEGREE
    shrink = np.cos(np.radians(origin["lat_deg"]))
    west = (origin["lon_deg"] - column(trajectory, "lon_deg")) * METRES_A_DEGREE * shrink
    assert np.ptp(north) > 50.0 and np.ptp(west) > 50.0
    np.testing.assert_allclose(column(trajectory, "north_m"), north, atol=0.01 * np.ptp(north))
    np.testing.assert_allclose(column(trajectory, "west_m"), west, atol=0.01 * np.ptp(west))
    np.testing.assert_allclose(column(trajectory, "alt_m") - origin["alt_m"], column(trajectory, "up_m"), atol=0.05)


def test_the_origin_is_the_first_good_fix(drive: Path, summary: dict[str, Any], read: Read) -> None:
    first = read(drive / "gps.csv").row(0, named=True)
    assert summary["origin"] == pytest.approx({name: first[name] for name in ("lat_deg", "lon_deg", "alt_m")})


def test_velocities_are_those_of_the_positions(trajectory: pl.DataFrame) -> None:
    steps = np.diff(columns(trajectory, "north_m", "west_m", "up_m"), axis=0) / 0.02
    velocity = columns(trajectory, "vel_north_mps", "vel_west_mps", "vel_up_mps")
    apart = steps - 0.5 * (velocity[1:] + velocity[:-1])
    assert rms(velocity[:, :2]) > 5.0
    assert (np.sqrt(np.mean(apart**2, axis=0)) < 0.1).all()


def test_speed_is_horizontal_in_m_a_second(trajectory: pl.DataFrame) -> None:
    horizontal = np.hypot(column(trajectory, "vel_north_mps"), column(trajectory, "vel_west_mps"))
    np.testing.assert_allclose(column(trajectory, "speed_mps"), horizontal, atol=2e-4)


def test_yaw_is_anticlockwise_from_north_within_its_half_open_turn(trajectory: pl.DataFrame) -> None:
    yaw = column(trajectory, "yaw_deg")
    assert (yaw > -180.0).all() and (yaw <= 180.0).all()
    fast = column(trajectory, "speed_mps") > 8.0
    course = np.degrees(np.arctan2(column(trajectory, "vel_west_mps"), column(trajectory, "vel_north_mps")))
    sideslip = turn(yaw - course)[fast]
    assert np.ptp(course[fast]) > 300.0
    assert np.abs(np.median(sideslip)) < 1.0 and np.abs(sideslip).max() < 12.0


def test_yaw_rate_is_that_of_yaw_in_degrees_a_second(trajectory: pl.DataFrame) -> None:
    rate = column(trajectory, "yaw_rate_dps")
    steps = turn(np.diff(column(trajectory, "yaw_deg"))) / 0.02
    smoothed = np.convolve(rate[:-1] - steps, np.full(25, 0.04), "valid")
    assert rms(rate) > 15.0 and rms(smoothed) < 3.0


def test_accelerations_are_kinematic_in_forward_left_up_axes(trajectory: pl.DataFrame) -> None:
    """Gravity is removed; forward is what changes the speed, left what turns it to the left."""
    half_second = np.full(25, 0.04)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.convolve(values, half_second, "valid")

    forward, left, up = columns(trajectory, "accel_forward_mps2", "accel_left_mps2", "accel_up_mps2").T
    speed, rate = column(trajectory, "speed_mps"), np.radians(column(trajectory, "yaw_rate_dps"))
    speeding_up, turning = mean(np.gradient(speed, 0.02)), mean(speed * rate)
    assert rms(speeding_up) > 1.5 and rms(turning) > 4.0
    assert np.polyfit(speeding_up, mean(forward), 1)[0] == pytest.approx(1.0, abs=0.15)
    assert np.polyfit(turning, mean(left), 1)[0] == pytest.approx(1.0, abs=0.1)
    assert abs(np.mean(up)) < 0.5


def test_attitude_is_that_of_the_kart(drive: Path, trajectory: pl.DataFrame, read: Read) -> None:
    truth, t = read(drive / "truth.csv"), column(trajectory, "t_s")
    inside = t > 10.0
    for name, limit in (("roll_deg", 1.0), ("pitch_deg", 1.0)):
        assert rms((column(trajectory, name) - at_times(t, truth, name))[inside]) < limit, name
    yaw = np.degrees(np.unwrap(np.radians(column(truth, "yaw_deg"))))
    error = turn(column(trajectory, "yaw_deg") - np.interp(t, column(truth, "t_s"), yaw))
    assert rms(error[inside]) < 2.0


@pytest.mark.parametrize("angle", ["roll_deg", "pitch_deg"])
def test_roll_is_positive_right_side_down_and_pitch_nose_down(
    short: Path, short_results: Path, smooth: Any, read: Read, angle: str
) -> None:
    """Samples are turned as if the kart leaned by so much all the time, with a mounting that is stated and level."""
    lean = 3.0  # degrees; how much of it is found is not a matter of the contract
    samples, (sine, cosine) = read(short / "imu.csv"), (np.sin(np.radians(lean)), np.cos(np.radians(lean)))
    for kind in "ag":
        forward, left, up = columns(samples, f"{kind}x", f"{kind}y", f"{kind}z").T
        if angle == "roll_deg":  # the left side is raised: what is upwards is towards the left
            left, up = cosine * left + sine * up, cosine * up - sine * left
        else:  # the nose is lowered: what is upwards is towards the back
            forward, up = cosine * forward - sine * up, cosine * up + sine * forward
        turned = {f"{kind}x": forward, f"{kind}y": left, f"{kind}z": up}
        samples = samples.with_columns(**{name: pl.Series(values) for name, values in turned.items()})
    samples.write_csv(short / "imu.csv")
    (short / "mag.csv").unlink()
    (short / "session.toml").write_text('[mounting]\naxes = "forward-left-up"\nlever_arm_b = [0, 0, 0]\n')
    assert smooth(short, *TABLES_ONLY).code in (0, 3)
    leaning, level = read(short / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")
    assert 0.25 * lean < np.median(column(leaning, angle) - column(level, angle)) < 1.25 * lean


def test_times_are_on_the_clock_of_the_imu_so_that_a_truth_on_it_compares_directly(
    drive: Path, trajectory: pl.DataFrame, read: Read
) -> None:
    truth, t = read(drive / "truth.csv"), column(trajectory, "t_s")
    for name in ("vel_north_mps", "vel_west_mps"):
        assert rms(column(trajectory, name) - at_times(t, truth, name)) < 0.3
        assert rms(column(trajectory, name) - at_times(t - 0.1, truth, name)) > 0.6


@pytest.mark.slow
def test_a_session_whose_clock_starts_later_has_the_same_result_later(
    short: Path, short_results: Path, smooth: Any, read: Read
) -> None:
    for name in ("imu.csv", "gps.csv", "mag.csv"):
        rows = read(short / name)
        rows.with_columns(t_s=(pl.col("t_s") + 64.0).round(6)).write_csv(short / name)
    assert smooth(short, *TABLES_ONLY).code == 0
    later, first = read(short / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")
    np.testing.assert_allclose(column(later, "t_s") - 64.0, column(first, "t_s"), atol=2e-6)
    np.testing.assert_allclose(column(later, "north_m"), column(first, "north_m"), atol=0.02)
    assert later["utc"][0][:19] == first["utc"][0][:19]


def test_positions_are_of_the_antenna(drive: Path, trajectory: pl.DataFrame, read: Read) -> None:
    """truth.csv is of the antenna; what is left of the error is the wander of the receiver."""
    truth, t = read(drive / "truth.csv"), column(trajectory, "t_s")
    error = np.stack(
        [
            (column(trajectory, "lat_deg") - at_times(t, truth, "lat_deg")) * METRES_A_DEGREE,
            (column(trajectory, "lon_deg") - at_times(t, truth, "lon_deg"))
            * METRES_A_DEGREE
            * np.cos(np.radians(truth["lat_deg"][0])),
        ],
        axis=-1,
    )
    change = error[50:] - error[:-50]  # within a second
    assert rms(error) < 6.0 and rms(change) < 0.2


def test_sigmas_of_position_contain_the_offset_of_the_gps_and_that_of_the_track_does_not(
    trajectory: pl.DataFrame, summary: dict[str, Any]
) -> None:
    north, west, track = columns(trajectory, "sigma_north_m", "sigma_west_m", "sigma_track_m").T
    horizontal = np.sqrt(0.5 * (north**2 + west**2))
    assert (horizontal >= track - 2e-4).all()
    offset = summary["identified"]["gps_offset_sigma"]["value"]
    assert np.median(horizontal) > 0.5 * offset[0] > 0.5
    assert 0.0 < np.median(track) < 0.5 * np.median(horizontal)


def test_sigmas_are_positive_and_about_as_large_as_the_errors(
    drive: Path, trajectory: pl.DataFrame, read: Read
) -> None:
    for name in trajectory.columns:
        if name.startswith("sigma_"):
            assert (column(trajectory, name) > 0.0).all(), name
    truth, t = read(drive / "truth.csv"), column(trajectory, "t_s")
    for name, sigma in (("vel_north_mps", "sigma_vel_north_mps"), ("roll_deg", "sigma_roll_deg")):
        normalised = (column(trajectory, name) - at_times(t, truth, name)) / column(trajectory, sigma)
        assert 0.3 < rms(normalised) < 2.5, name


def test_utc_is_iso_8601_of_the_time_at_which_the_kart_was_there(
    drive: Path, trajectory: pl.DataFrame, summary: dict[str, Any], read: Read
) -> None:
    """A fix stamped `t_s` was true at `t_s` less its latency, and its UTC is of then."""
    fix = read(drive / "gps.csv").row(0, named=True)
    first, last = (dt.datetime.fromisoformat(trajectory["utc"][row]) for row in (0, -1))
    assert first.utcoffset() == dt.timedelta(0)
    span = trajectory["t_s"][-1] - trajectory["t_s"][0]
    assert (last - first).total_seconds() == pytest.approx(span, abs=0.05)
    latency = summary["identified"]["gps_position_latency"]["value"]
    assert first.timestamp() == pytest.approx(fix["unix_s"] + latency, abs=0.02)


def test_utc_is_empty_where_no_file_has_one(short: Path, smooth: Any, read: Read) -> None:
    read(short / "gps.csv").drop("unix_s").write_csv(short / "gps.csv")
    assert smooth(short, *TABLES_ONLY).code == 0
    lines = (short / "smoothed" / "trajectory.csv").read_text().splitlines()[1:]
    assert {line.split(",")[1] for line in lines} == {""}


def test_truth_is_never_read_by_the_smoother(short: Path, short_results: Path, smooth: Any) -> None:
    (short / "truth.csv").unlink()
    assert smooth(short, *TABLES_ONLY).code == 0
    for name in ("trajectory.csv", "laps.csv", "gps.csv"):
        assert (short / "smoothed" / name).read_bytes() == (short_results / name).read_bytes(), name


@pytest.mark.slow
def test_the_other_solver_gives_the_same_trajectory(short: Path, short_results: Path, smooth: Any, read: Read) -> None:
    assert smooth(short, "--solver", "isam2", *TABLES_ONLY).code == 0
    rows, wanted = read(short / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")
    assert rms(column(rows, "north_m") - column(wanted, "north_m")) < 0.1
    assert rms(turn(column(rows, "yaw_deg") - column(wanted, "yaw_deg"))) < 1.0


def test_every_row_has_its_lap_and_the_distance_driven_in_it(
    results: Path, trajectory: pl.DataFrame, read: Read
) -> None:
    laps = read(results / "laps.csv")
    assert laps.height >= 4
    for lap in laps.iter_rows(named=True):
        inside = trajectory.filter((pl.col("t_s") > lap["start_s"]) & (pl.col("t_s") < lap["end_s"]))
        assert inside["lap"].unique().to_list() == [lap["lap"]]
        if lap["valid"]:
            distance = column(inside, "lap_distance_m")
            assert (np.diff(distance) > -0.05).all() and distance[0] < 1.0
            assert distance[-1] == pytest.approx(596.0, rel=0.05)  # m, a lap of this track


def test_without_an_imu_attitude_is_nan_and_position_is_not(short: Path, smooth: Any, read: Read) -> None:
    for name in ("imu.csv", "mag.csv"):
        (short / name).unlink()
    assert smooth(short, *TABLES_ONLY).code == 0
    rows = read(short / "smoothed" / "trajectory.csv")
    assert np.isnan(column(rows, "yaw_deg")).all() and np.isnan(column(rows, "roll_deg")).all()
    assert np.isfinite(columns(rows, "north_m", "west_m", "vel_north_mps", "sigma_track_m")).all()
