"""What cells, dates and times of other programs mean: by the whole column, in five languages."""

import datetime as dt

import numpy as np
import polars as pl
import pytest

from smoother.session.readers.cells import degrees_of, hemispheres_of, numbers_of, qualities_of
from smoother.session.readers.times import day_of, put_together, read_days, read_moments, spread_evenly, zone_offset

DAY = dt.date(2026, 5, 16)
AT_TEN = 1_778_925_600.0  # 2026-05-16T10:00:00Z


@pytest.mark.parametrize(
    ("cells", "values", "unit"),
    [
        (["1.5", " 2", "-3e2"], [1.5, 2.0, -300.0], ""),
        (["15.862 km/h", "15 km/h", "-"], [15.862, 15.0, np.nan], "km/h"),
        (["80.5°C", "81°C"], [80.5, 81.0], "°C"),
        (["1,234.5", "12.5"], [1234.5, 12.5], ""),
        (["1.234,5", "12,5"], [1234.5, 12.5], ""),
        (["12,125", "9,250"], [12.125, 9.25], ""),
        (["9,000", "850", "10,100"], [9000.0, 850.0, 10100.0], ""),
        (["1 234 567,5", "12,5"], [1_234_567.5, 12.5], ""),
        (["4#.1", "45.1", "45.2x", "1", "2", "3"], [np.nan, 45.1, np.nan, 1.0, 2.0, 3.0], ""),
        (["−3.5", "2.0"], [-3.5, 2.0], ""),
    ],
)
def test_numbers_and_their_units(cells: list[str], values: list[float], unit: str) -> None:
    found = numbers_of(pl.Series(cells))
    np.testing.assert_array_equal(found.values, values)
    assert found.unit == unit
    assert found.unread == sum("#" in cell or "x" in cell for cell in cells)


@pytest.mark.parametrize(
    "cell",
    [
        "17.41W",
        "W 17.41",
        "17.41 West",
        "-17.41",
        "17°24'36\"W",
        "17 24 36 W",
        "17:24:36W",
        "W17°24.600'",
        "17°24.6′ W",
    ],
)
def test_degrees_with_letters_minutes_and_seconds(cell: str) -> None:
    assert degrees_of(pl.Series([cell, cell]), is_longitude=True)[0] == pytest.approx(-17.41, abs=1e-9)


@pytest.mark.parametrize("cell", ["17.41.2W", "17 61 00 W", "17.41X W", "1 2 3 4 W", "1" + " 1" * 4000 + "!"])
def test_what_is_no_angle_is_none_and_costs_no_time(cell: str) -> None:
    assert np.isnan(degrees_of(pl.Series([cell, cell]), is_longitude=True)).all()


def test_hemispheres_beside_turn_the_sign_and_show_degrees_and_minutes() -> None:
    west = hemispheres_of(pl.Series(["W", "W", ""]), is_longitude=True)
    assert west is not None
    plain = degrees_of(pl.Series(["17.41", "17.42", ""]), is_longitude=True, letters=west)
    np.testing.assert_allclose(plain, [-17.41, -17.42, np.nan])
    minutes = degrees_of(pl.Series(["01724.6", "01725.2", ""]), is_longitude=True, letters=west)
    np.testing.assert_allclose(minutes, [-17.41, -17.42, np.nan])
    assert hemispheres_of(pl.Series(["E", "A"]), is_longitude=True) is None
    assert hemispheres_of(pl.Series(["17.4"]), is_longitude=True) is None
    east = hemispheres_of(pl.Series(["O", "W"]), is_longitude=True)  # Ost and West
    west = hemispheres_of(pl.Series(["O", "E"]), is_longitude=True)  # ouest and est
    assert east is not None and west is not None and (east[0], west[0]) == (1.0, -1.0)


def test_words_of_quality() -> None:
    words = qualities_of(pl.Series(["SPS", "NO FIX", "", "DGPS", "invalid", "true", "false"]))
    np.testing.assert_array_equal(words, [1.0, 0.0, np.nan, 1.0, 0.0, 1.0, 0.0])


@pytest.mark.parametrize(
    "text",
    [
        *("16-MAY-26", "16-Mai-2026", "16. Mai 2026", "16 de mayo de 2026", "sabato 16 maggio 2026", "May 16, 2026"),
        *(
            "samedi 16 mai 2026",
            "Saturday, May 16, 2026",
            "16.05.26",
            "05/16/26",
            "2026-05-16",
            "20260516",
            "16MAY2026",
        ),
    ],
)
def test_dates_in_words_and_numbers(text: str) -> None:
    assert day_of(text) == DAY


@pytest.mark.parametrize(
    ("text", "month"),
    [
        ("11 août 2026", 8),
        ("1er juin 2026", 6),
        ("11 juil. 2026", 7),
        ("11-Dez-26", 12),
        ("11 März 2026", 3),
        ("11 gennaio 2026", 1),
        ("11 ene 2026", 1),
        ("mar 11 giu 2026", 6),
        ("11 Okt. 2026", 10),
        ("11 set 2026", 9),
    ],
)
def test_months_of_five_languages(text: str, month: int) -> None:
    day = day_of(text)
    assert day is not None and day.month == month


@pytest.mark.parametrize("text", ["04/05/2026", "160526", "31 April 2026", "sabato 11 aprile", "1.5", "16/05"])
def test_dates_that_can_be_read_two_ways_are_none(text: str) -> None:
    assert day_of(text) is None


@pytest.mark.parametrize(
    ("zone", "hours"),
    [("Z", 0), ("MESZ", 2), ("CEST", 2), ("pdt", -7), ("+02:00", 2), ("UTC+2", 2), ("-0330", -3.5), ("XYZ", None)],
)
def test_zones_by_name_and_offset(zone: str, hours: float | None) -> None:
    assert zone_offset(zone) == (None if hours is None else 3600.0 * hours)


@pytest.mark.parametrize(
    "text",
    [
        *("2026-05-16T10:00:00.5Z", "2026-05-16 12:00:00.5 MESZ", "05/16/2026 3:00:00.5 AM PDT", "20260516T100000.5Z"),
        *("2026-05-16T12:00:00,5+02:00", "16 mai 2026 12:00:00.5 UTC+2", "Sat May 16 10:00:00.5 GMT+00:00 2026"),
    ],
)
def test_moments_with_date_and_zone(text: str) -> None:
    found = read_moments(pl.Series([text, text]), "")
    assert found is not None and found.has_date and found.has_zone
    assert found.seconds[0] == AT_TEN + 0.5


@pytest.mark.parametrize("text", ["10:00:00.5", "10:00:00:500", "10h00m00.5s", "10:00:00.5 AM", "10:00:00,5"])
def test_times_of_the_day(text: str) -> None:
    found = read_moments(pl.Series([text, text]), "")
    assert found is not None and found.is_of_day and not found.has_zone
    assert found.seconds[0] == 36_000.5


def test_the_zone_may_stand_in_the_name_of_the_column() -> None:
    found = read_moments(pl.Series(["12:00:00", "12:00:01"]), "cest")
    assert found is not None and found.has_zone and found.seconds[0] == 36_000.0


def test_days_of_a_spreadsheet_and_fractions_of_one() -> None:
    rows = np.arange(40)
    serial = read_moments(pl.Series([f"{46158 + (36_000 + 0.1 * k) / 86_400:.9f}" for k in rows]), "")
    assert serial is not None and serial.has_date
    np.testing.assert_allclose(serial.seconds, AT_TEN + 0.1 * rows, atol=1e-3)
    parts = read_moments(pl.Series([f"{(36_000 + 0.1 * k) / 86_400:.9f}" for k in rows]), "")
    assert parts is not None and parts.is_of_day
    clock, utc = put_together([parts], read_days(pl.Series(["46158"] * 40)))
    assert utc is clock
    np.testing.assert_allclose(clock.seconds, AT_TEN + 0.1 * rows, atol=1e-3)


def test_whole_seconds_that_rows_share_are_spread() -> None:
    t = np.floor(np.arange(0.4, 30.0, 0.1) + 1e-9)
    spread, rate = spread_evenly(t)
    assert rate == 10
    np.testing.assert_allclose(spread, np.arange(0.4, 30.0, 0.1), atol=1e-9)
    assert spread_evenly(np.arange(30.0))[1] == 1 and spread_evenly(t + 0.5)[1] == 1
