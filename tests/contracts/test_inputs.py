"""contracts.md 1 to 3: a session directory, session.toml, and tables and sentences of other loggers."""

import datetime as dt
import gzip
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest

TABLES_ONLY = ("--no-figures", "--no-baseline")
Read = Callable[[Path], pl.DataFrame]


def codes(document: dict[str, Any]) -> list[str]:
    for problem in document["problems"]:
        assert set(problem) == {"code", "text", "count"}
        assert problem["text"] and "\n" not in problem["text"] and problem["count"] >= 1
    return [problem["code"] for problem in document["problems"]]


def sentences(fixes: pl.DataFrame, received: bool) -> str:
    """The fixes as RMC and GGA, with receive times in front if wanted."""
    lines = []
    for fix in fixes.iter_rows(named=True):
        hour, rest = divmod(fix["unix_s"] % 86_400.0, 3600.0)
        clock = f"{int(hour):02d}{int(rest // 60):02d}{rest % 60:05.2f}"
        (lat, south), (lon, west) = ((abs(fix[name]), fix[name] < 0.0) for name in ("lat_deg", "lon_deg"))
        place = f"{int(lat):02d}{60.0 * (lat % 1.0):09.6f},{'NS'[south]},{int(lon):03d}{60.0 * (lon % 1.0):09.6f},"
        place += "EW"[west]
        speed, course = fix["speed_mps"] * 3600.0 / 1852.0, fix["course_deg"]
        for body in (
            f"GPRMC,{clock},A,{place},{speed:.4f},{course:.4f},160526,,,A",
            f"GPGGA,{clock},{place},1,10,{fix['hdop']},{fix['alt_m']:.3f},M,0.0,M,,",
        ):
            checksum = 0
            for byte in body.encode():
                checksum ^= byte
            lines.append((f"{fix['t_s']:.3f}," if received else "") + f"${body}*{checksum:02X}\r\n")
    return "".join(lines)


def apart(first: pl.DataFrame, second: pl.DataFrame) -> float:
    """Root mean square of the horizontal distance in m."""
    north, west = (first[name].to_numpy() - second[name].to_numpy() for name in ("lat_deg", "lon_deg"))
    shrink = np.cos(np.radians(first["lat_deg"][0]))
    return float(111_200.0 * np.sqrt(np.mean(north**2 + (shrink * west) ** 2)))


@pytest.mark.parametrize("name", ["gps.csv", "imu.csv"])
def test_a_session_is_a_directory_or_one_file_of_it(short: Path, short_results: Path, smooth: Any, name: str) -> None:
    assert smooth(short / name, *TABLES_ONLY).code == 0
    assert (short / "smoothed" / "trajectory.csv").read_bytes() == (short_results / "trajectory.csv").read_bytes()


def test_columns_may_be_in_any_order_beside_others_and_packed(
    short: Path, short_results: Path, smooth: Any, read: Read
) -> None:
    for name in ("imu.csv", "gps.csv", "mag.csv"):
        header, *rows = [line.split(",") for line in (short / name).read_text().splitlines()]
        text = "".join(
            ",".join([*row[::-1], mine]) + "\n" for row, mine in [(header, "mine"), *[(r, "7") for r in rows]]
        )
        with gzip.open(short / f"{name}.gz", "wt") as file:
            file.write(text)
        (short / name).unlink()
    assert smooth(short, *TABLES_ONLY).code == 0
    assert (short / "smoothed" / "trajectory.csv").read_bytes() == (short_results / "trajectory.csv").read_bytes()


@pytest.mark.slow
def test_two_rows_that_changed_places_change_nothing(short: Path, short_results: Path, smooth: Any) -> None:
    lines = (short / "gps.csv").read_text().splitlines(keepends=True)
    lines[60], lines[61] = lines[61], lines[60]
    (short / "gps.csv").write_text("".join(lines))
    assert smooth(short, *TABLES_ONLY).code == 0
    assert (short / "smoothed" / "trajectory.csv").read_bytes() == (short_results / "trajectory.csv").read_bytes()


@pytest.mark.parametrize(
    "damage",
    [
        lambda line: line + line,
        lambda line: "nan" + line[line.index(",") :],
        lambda line: line.replace(line.split(",")[2], "nan"),
        lambda line: line.replace(line.split(",")[2], "1234.5"),
        lambda line: line[: len(line) // 8] + "\n",
    ],
    ids=["repeated", "no time", "NaN", "absurd", "cut"],
)
def test_a_bad_row_is_dropped_counted_and_reported_but_never_fatal(
    fixes_alone: Path, short_results: Path, smooth: Any, read: Read, damage: Callable[[str], str]
) -> None:
    lines = (fixes_alone / "gps.csv").read_text().splitlines(keepends=True)
    for row in (50, 75):
        lines[row] = damage(lines[row])
    (fixes_alone / "gps.csv").write_text("".join(lines))
    printed = smooth(fixes_alone, "--json", *TABLES_ONLY)
    assert printed.code == 0
    assert codes(printed.document)
    assert any("2" in problem["text"] and "gps.csv" in problem["text"] for problem in printed.document["problems"])
    assert apart(read(fixes_alone / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")) < 3.0


@pytest.mark.slow
def test_samples_that_are_nan_are_dropped_counted_and_reported(short: Path, smooth: Any) -> None:
    lines = (short / "imu.csv").read_text().splitlines(keepends=True)
    for row in (1000, 2000, 3000):
        lines[row] = lines[row].replace(lines[row].split(",")[3], "nan")
    (short / "imu.csv").write_text("".join(lines))
    printed = smooth(short, "--json", *TABLES_ONLY)
    assert printed.code == 0 and codes(printed.document)
    assert any("imu.csv" in problem["text"] and problem["count"] == 3 for problem in printed.document["problems"])


@pytest.mark.parametrize("keep", [0, 20])
def test_without_a_usable_imu_fixes_alone_are_smoothed_and_that_is_a_problem(
    short: Path, short_results: Path, smooth: Any, read: Read, keep: int
) -> None:
    """Absent, or one row in 20 of 200 a second, which is under 20 Hz."""
    if keep:
        read(short / "imu.csv")[::keep].write_csv(short / "imu.csv")
    else:
        (short / "imu.csv").unlink()
    printed = smooth(short, "--json", *TABLES_ONLY)
    assert printed.code == 0
    assert any("GPS alone" in problem["text"] for problem in printed.document["problems"])
    assert apart(read(short / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")) < 3.0


def test_units_of_csv_are_m_s_rad_and_degrees(short: Path, short_results: Path, smooth: Any, read: Read) -> None:
    """Velocities north and east (not west) stand for speed and course."""
    fixes = read(short / "gps.csv")
    course = pl.col("course_deg").radians()
    north, east = pl.col("speed_mps") * course.cos(), pl.col("speed_mps") * course.sin()
    fixes.with_columns(vel_n_mps=north, vel_e_mps=east).drop("speed_mps", "course_deg").write_csv(short / "gps.csv")
    assert smooth(short, *TABLES_ONLY).code == 0
    assert apart(read(short / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")) < 0.2


def test_utc_may_be_iso_8601_instead_of_unix_s(fixes_alone: Path, short_results: Path, smooth: Any, read: Read) -> None:
    fixes = read(fixes_alone / "gps.csv")
    utc = pl.from_epoch((pl.col("unix_s") * 1000.0).round().cast(pl.Int64), time_unit="ms")
    fixes.with_columns(utc=utc.dt.strftime("%Y-%m-%dT%H:%M:%S%.3fZ")).drop("unix_s").write_csv(fixes_alone / "gps.csv")
    assert smooth(fixes_alone, *TABLES_ONLY).code == 0
    rows, wanted = read(fixes_alone / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")
    first, second = (dt.datetime.fromisoformat(one["utc"][700]).timestamp() for one in (rows, wanted))
    assert first == pytest.approx(second, abs=0.1)


def test_fix_0_is_none_and_fix_1_usable(fixes_alone: Path, smooth: Any, read: Read) -> None:
    fixes = read(fixes_alone / "gps.csv")
    none = pl.col("t_s").is_between(10.0, 11.0)
    moved = fixes.with_columns(
        fix=pl.when(none).then(0).otherwise(pl.col("fix")),
        lat_deg=pl.when(none).then(pl.col("lat_deg") + 0.01).otherwise(pl.col("lat_deg")),
    )
    moved.write_csv(fixes_alone / "gps.csv")
    printed = smooth(fixes_alone, "--json", *TABLES_ONLY)
    assert printed.code == 0
    assert printed.document["counts"]["fixes"] == fixes.height - 6
    assert read(fixes_alone / "smoothed" / "trajectory.csv")["north_m"].abs().max() < 300.0


def test_gps_csv_wins_over_sentences_with_a_problem(short: Path, short_results: Path, smooth: Any, read: Read) -> None:
    (short / "walk.nmea").write_text(sentences(read(short / "gps.csv"), received=True))
    printed = smooth(short, "--json", *TABLES_ONLY)
    assert printed.code == 0
    assert any("walk.nmea" in problem["text"] for problem in printed.document["problems"])
    assert (short / "smoothed" / "trajectory.csv").read_bytes() == (short_results / "trajectory.csv").read_bytes()


@pytest.mark.slow
def test_lines_of_nmea_may_begin_with_the_receive_time_on_the_imu_s_clock(
    short: Path, short_results: Path, smooth: Any, read: Read
) -> None:
    (short / "walk.nmea").write_text(sentences(read(short / "gps.csv"), received=True))
    (short / "gps.csv").unlink()
    printed = smooth(short, "--json", *TABLES_ONLY)
    assert printed.code == 0 and printed.document["mode"] == "full"
    assert "walk.nmea" in printed.document["inputs"]
    rows, wanted = read(short / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")
    assert apart(rows, wanted) < 1.5


def test_sentences_alone_are_a_session_whose_times_count_from_the_first(
    short: Path, smooth: Any, read: Read, tmp_path: Path
) -> None:
    alone = tmp_path / "alone"
    alone.mkdir()
    fixes = read(short / "gps.csv")
    (alone / "walk.nmea").write_text(sentences(fixes, received=False))
    printed = smooth(alone, "--json", *TABLES_ONLY)
    assert printed.code == 0 and printed.document["mode"] == "gps-only"
    t = read(alone / "smoothed" / "trajectory.csv")["t_s"].to_numpy()
    assert t[0] == pytest.approx(0.0, abs=1e-3)
    assert t[-1] == pytest.approx(fixes["t_s"][-1] - fixes["t_s"][0], abs=0.05)


def test_every_key_of_session_toml_is_known_and_used(short: Path, smooth: Any) -> None:
    (short / "session.toml").write_text("""
        [session]
        title = "Heat 2"
        driver = "N. N."
        kart = "7"
        track = "tinbarn"
        date = 2026-05-16
        notes = "damp"
        [mounting]
        lever_arm_b = [0.01, 0.02, 0.03]
        R_bs = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
        [imu]
        accel_noise = 0.05
        gyro_noise = 0.004
        accel_bias_walk = 1e-3
        gyro_bias_walk = 1e-4
        [gps]
        position_latency = 0.01
        velocity_latency = 0.02
        [magnetometer]
        use = false
        declination_deg = -3.5
    """)
    printed = smooth(short, "--json", *TABLES_ONLY)
    assert printed.code == 0
    about, identified = printed.document["session"], printed.document["identified"]
    assert [about[name] for name in ("title", "driver", "kart")] == ["Heat 2", "N. N.", "7"]
    for name, value in (
        ("gps_position_latency", 0.01),
        ("gps_velocity_latency", 0.02),
        ("lever_arm_b", [0.01, 0.02, 0.03]),
        ("accel_noise", 0.05),
        ("gyro_noise", 0.004),
    ):
        assert identified[name]["value"] == pytest.approx(value, rel=1e-3), name
        assert identified[name]["source"] != "identified", name


def test_what_session_toml_does_not_state_is_estimated(summary: dict[str, Any]) -> None:
    for name in ("gps_position_latency", "gps_velocity_latency", "R_bs", "accel_noise", "gyro_noise"):
        assert summary["identified"][name]["source"] == "identified", name


def test_axes_say_where_the_sensor_s_axes_point(short: Path, short_results: Path, smooth: Any, read: Read) -> None:
    samples = read(short / "imu.csv")  # made with forward, left, up
    samples = samples.rename({"ax": "ay", "ay": "ax", "gx": "gy", "gy": "gx"})
    samples.with_columns(-pl.col("ax"), -pl.col("gx")).write_csv(short / "imu.csv")
    (short / "mag.csv").unlink()
    (short / "session.toml").write_text('[mounting]\naxes = "right-forward-up"\n')
    printed = smooth(short, "--json", *TABLES_ONLY)
    assert printed.code == 0
    stated = np.array(printed.document["identified"]["R_bs"]["value"])
    np.testing.assert_allclose(stated, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=0.03)
    rows, wanted = read(short / "smoothed" / "trajectory.csv"), read(short_results / "trajectory.csv")
    error = np.mod(rows["yaw_deg"].to_numpy() - wanted["yaw_deg"].to_numpy() + 180.0, 360.0) - 180.0
    assert np.sqrt(np.mean(error[200:] ** 2)) < 2.0


@pytest.mark.parametrize(
    ("text", "unknown", "nearest"),
    [
        ("[session]\ntitel = 1\n", "titel", "title"),
        ("[mounting]\nlever_arm = [1, 2, 3]\n", "lever_arm", "lever_arm_b"),
        ("[gps]\nposition_latancy = 0.1\n", "position_latancy", "position_latency"),
        ("[magnetometr]\nuse = true\n", "magnetometr", "magnetometer"),
    ],
)
def test_an_unknown_key_is_an_error_that_names_it_and_the_nearest_known_one(
    short: Path, smooth: Any, text: str, unknown: str, nearest: str
) -> None:
    (short / "session.toml").write_text(text)
    printed = smooth(short)
    assert printed.code == 2 and printed.err.count("\n") == 1
    assert "session.toml" in printed.err and unknown in printed.err and nearest in printed.err


@pytest.mark.slow
@pytest.mark.parametrize("stated", ["mine.geojson#b", "{folder}/mine.geojson#b"])
def test_a_track_is_a_name_or_a_path_relative_or_absolute_with_the_name_of_one_of_several(
    drive: Path, smooth: Any, tmp_path: Path, stated: str
) -> None:
    session = Path(shutil.copytree(drive, tmp_path / "monday", ignore=lambda *_: ["smoothed"]))
    fixes = pl.read_csv(session / "gps.csv", infer_schema_length=None)
    places = fixes.filter(pl.col("speed_mps") > 12.0).row(40, named=True)
    lat, lon, course = places["lat_deg"], places["lon_deg"], np.radians(places["course_deg"])
    across = 15.0 / 111_200.0 * np.array([-np.sin(course), np.cos(course) / np.cos(np.radians(lat))])
    ends = [[lon - across[1], lat - across[0]], [lon + across[1], lat + across[0]]]

    def feature(name: str, shift: float) -> dict[str, Any]:
        line = [[x + shift, y] for x, y in ends]
        about = {"line": "start", "track": name}
        return {"type": "Feature", "properties": about, "geometry": {"type": "LineString", "coordinates": line}}

    for name in ("imu.csv", "mag.csv"):  # fixes alone are smoothed sooner
        (session / name).unlink()
    features = [feature("a", 1.0), feature("b", 0.0)]
    (session / "mine.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    (session / "session.toml").write_text(f"[session]\ntrack = {json.dumps(stated.format(folder=session))}\n")
    printed = smooth(session, "--json", "--rate", "10", *TABLES_ONLY)
    assert printed.code == 0
    assert sum(lap["valid"] for lap in printed.document["laps"]) >= 1
    line = printed.document["lap_analysis"]["start_line"]
    assert line["left"]["lat_deg"] == pytest.approx(lat, abs=3e-4)


@pytest.mark.slow
def test_of_a_card_with_several_recordings_each_gets_its_folder_or_one_is_chosen(smooth: Any, tmp_path: Path) -> None:
    card = tmp_path / "card"
    card.mkdir()
    for number in (1, 2):
        made = ["simulate", tmp_path / f"k{number}", "--duration", "20", "--format", "klg", "--track", "tinbarn"]
        assert smooth(*made, "--standstill", "2", "--seed", number).code == 0
        (recording,) = sorted((tmp_path / f"k{number}").glob("*.KLG"))[-1:]
        shutil.copy(recording, card / f"LOG0000{number}.KLG")
    printed = smooth(card, *TABLES_ONLY)
    assert printed.code == 0
    assert "LOG00001" in printed.err and "LOG00002" in printed.err
    for name in ("LOG00001", "LOG00002"):
        assert (card / "smoothed" / name / "trajectory.csv").exists()
    chosen = smooth(card, "--recording", "2", "--json", "--out", tmp_path / "one", *TABLES_ONLY)
    assert chosen.code == 0 and chosen.document["session"]["name"] == "LOG00002"
    assert smooth(card, "--recording", "3").code == 2


def test_the_date_of_the_magnetic_model_is_that_of_the_fixes_or_of_session_toml_or_missed(
    short: Path, smooth: Any, read: Read
) -> None:
    missing = "magnetic_model_date"
    assert missing not in codes(smooth(short, "--json", *TABLES_ONLY).document)
    read(short / "gps.csv").drop("unix_s").write_csv(short / "gps.csv")
    assert missing in codes(smooth(short, "--json", *TABLES_ONLY).document)
    settings = (short / "session.toml").read_text()
    (short / "session.toml").write_text(settings.replace("[session]", '[session]\ndate = "2026-05-16"', 1))
    assert missing not in codes(smooth(short, "--json", *TABLES_ONLY).document)
