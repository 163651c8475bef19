"""AiM CSV: units, separators, repeated names, other channels, and what is damaged."""

import datetime as dt
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from smoother.session.load import load_raw
from smoother.session.readers.sets import read_tables as read_aim

from .readers import assert_outlives_damage, assert_refused

PREAMBLE = (
    ("Format", "AiM CSV File"),
    ("Session", "Circuit"),
    ("Vehicle", "KZ2"),
    ("Racer", "A. Driver"),
    ("Date", "Saturday, April 11, 2026"),
    ("Time", "11:32 AM"),
    ("Sample Rate", "1e99"),
    ("Beacon Markers", "12.500", "60.100"),
    ("Segment Times", "0:12.500", "0:47.600"),
)
NAMES = ("Time", "GPS Speed", "GPS Nsat", "GPS Heading", "GPS Altitude", "GPS PosAccuracy", "GPS SpdAccuracy")
NAMES = (*NAMES, "GPS Latitude", "GPS Longitude", "RPM", "RPM", "InlineAcc", "LateralAcc", "YawRate")
UNITS = ("s", "km/h", "#", "deg", "m", "mm", "km/h", "deg", "deg", "rpm", "rpm", "g", "g", "deg/s")


def values(k: int) -> tuple[str, ...]:
    """20 Hz, west at 36 km/h; heading is within 180 degrees."""
    place = ("45.7000000", f"{13.07 - 0.5 * k / 77660:.7f}")
    return (f"{0.05 * k:.3f}", "36.00", "16", "-90.0", "4.5", "420", "1.8", *place, "9000", "9001", "0", "0", "0")


def table(rows: list[tuple[str, ...]], separator: str = ",", names: tuple[str, ...] = NAMES) -> str:
    def line(cells: tuple[str, ...]) -> str:
        return separator.join(f'"{cell}"' for cell in cells)

    text = "\r\n".join(
        [*(line(row) for row in PREAMBLE), "", line(names), line(UNITS), "", *(line(row) for row in rows)]
    )
    return text + "\r\n"


def read(directory: Path, text: str):
    path = directory / "aim.csv"
    path.write_text(text, encoding="utf-8")
    return read_aim(path)


def test_every_channel_of_the_receiver_reaches_its_place_in_its_unit(tmp_path: Path) -> None:
    reading = read(tmp_path, table([values(k) for k in range(80)]))
    gnss = reading.gnss
    np.testing.assert_allclose(gnss.t, 0.05 * np.arange(80), atol=1e-9)
    np.testing.assert_allclose(gnss.velocity_n[:, :2], [[0.0, 10.0]] * 80, atol=1e-9)
    assert (gnss.lat_deg[0], gnss.lon_deg[0], gnss.alt_m[0], gnss.num_sv[0]) == (45.7, 13.07, 4.5, 16)
    assert gnss.sigma_horizontal[0] == pytest.approx(0.42) and gnss.sigma_velocity[0] == pytest.approx(0.5)
    assert np.isnan(gnss.unix_s).all()  # the time of day in the file is the box's, not the receiver's
    assert [problem.code for problem in reading.problems] == ["gps_date_assumed", "imu_axes_unknown"]
    assert reading.imu is None


def test_a_file_in_two_bytes_a_character_is_read(tmp_path: Path) -> None:
    text = table([values(k) for k in range(80)])
    (tmp_path / "aim.csv").write_text(text, encoding="utf-16", newline="")
    raw = load_raw(tmp_path)
    assert raw.inputs == ("aim.csv",)
    np.testing.assert_array_equal(raw.gnss.lon_deg, read(tmp_path, text).gnss.lon_deg)


@pytest.fixture
def rome(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with monkeypatch.context() as patch:
        patch.setenv("TZ", "Europe/Rome")
        time.tzset()
        yield
    time.tzset()


@pytest.mark.parametrize(
    ("date", "clock", "utc"),
    [
        ("Saturday, April 11, 2026", "11:32 AM", "2026-04-11T09:32:00Z"),
        ("Saturday, January 3, 2026", "12:05:09 AM", "2026-01-02T23:05:09Z"),
        ("11 Apr 2026", "23:59:59.4", "2026-04-11T21:59:59Z"),
        ("2026-04-11", "12:32 pm", "2026-04-11T10:32:00Z"),
        ("11.04.2026", "11:32", "2026-04-11T09:32:00Z"),
        ("04/13/2026", "11:32", "2026-04-13T09:32:00Z"),
        ("04/04/2026", "11:32", "2026-04-04T09:32:00Z"),
    ],
)
@pytest.mark.usefixtures("rome")
def test_the_log_began_at_the_time_of_day_in_it_here(tmp_path: Path, date: str, clock: str, utc: str) -> None:
    text = table([values(k) for k in range(80)]).replace("Saturday, April 11, 2026", date).replace("11:32 AM", clock)
    read(tmp_path, text)
    raw = load_raw(tmp_path)
    assert raw.unix_at_zero == dt.datetime.fromisoformat(utc).timestamp()
    (problem,) = [problem for problem in raw.problems if problem.code == "gps_date_assumed"]
    assert "local" in problem.text and "this computer's (CE" in problem.text


@pytest.mark.parametrize(
    ("date", "clock"),
    [("04/05/2026", "11:32"), ("sabato 11 aprile", "11:32"), ("Saturday, April 31, 2026", "11:32"), ("", "")]
    + [("Saturday, April 11, 2026", clock) for clock in ("25:00", "14:00 PM", "noon")],
)
def test_an_ambiguous_date_is_reported_and_no_time(tmp_path: Path, date: str, clock: str) -> None:
    text = table([values(k) for k in range(80)]).replace("Saturday, April 11, 2026", date).replace("11:32 AM", clock)
    reading = read(tmp_path, text)
    assert reading.unix_at_zero is None and "laps have none" in reading.problems[0].text


@pytest.mark.usefixtures("rome")
def test_a_zone_that_the_file_names_needs_no_guess(tmp_path: Path) -> None:
    text = table([values(k) for k in range(80)]).replace('"Session"', '"Comment","Smoothed; Time is UTC."\r\n"Session"')
    reading = read(tmp_path, text)
    assert reading.unix_at_zero == dt.datetime(2026, 4, 11, 11, 32, tzinfo=dt.UTC).timestamp()
    assert [problem.code for problem in reading.problems] == ["imu_axes_unknown"]


def test_semicolons_with_decimal_commas_read_the_same(tmp_path: Path) -> None:
    rows = [values(k) for k in range(80)]
    plain = read(tmp_path, table(rows)).gnss
    commas = read(tmp_path, table([tuple(v.replace(".", ",") for v in row) for row in rows], ";")).gnss
    np.testing.assert_array_equal(commas.lon_deg, plain.lon_deg)
    np.testing.assert_array_equal(commas.speed, plain.speed)


def test_underscores_in_names_and_tabs_read_the_same(tmp_path: Path) -> None:
    rows = [values(k) for k in range(80)]
    plain = read(tmp_path, table(rows)).gnss
    names = tuple(name.replace(" ", "_") for name in NAMES)
    blank_at_end = [(*row[:-1], "") for row in rows]
    for text in (table(rows, names=names), table(rows, "\t"), table(blank_at_end, "\t").replace('"', "")):
        np.testing.assert_array_equal(read(tmp_path, text).gnss.velocity_n, plain.velocity_n)


def test_a_folder_with_the_file_is_a_session_of_fixes(tmp_path: Path) -> None:
    read(tmp_path, table([values(k) for k in range(80)]))
    raw = load_raw(tmp_path)
    assert raw.inputs == ("aim.csv",) and raw.imu is None and len(raw.gnss) == 80


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table([]), "a header line, but no rows"),
        (table([values(k)[:9] for k in range(9)]), "rows have 9 values, but 14 columns are named"),
        (table([values(0)] * 50), "rows repeat the time of another"),
        (table([(f"{1e-5 * k:.5f}", *values(k)[1:]) for k in range(50)]), "fixes a second, which no receiver makes"),
    ],
)
def test_an_unusable_file_is_one_line_and_exit_code_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, message: str
) -> None:
    assert_refused(read_aim, tmp_path / "aim.csv", text, message, capsys)


@pytest.mark.parametrize("seed", range(30))
def test_random_damage_raises_nothing_but_a_session_error(tmp_path: Path, seed: int) -> None:
    assert_outlives_damage(read_aim, tmp_path / "aim.csv", table([values(k) for k in range(40)]), seed)
