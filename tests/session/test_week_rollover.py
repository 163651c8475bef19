"""Receivers whose count of weeks ran over: their dates are 1024 weeks back."""

import datetime as dt

import numpy as np
import pytest

from smoother.fit.magnetic_model import session_date
from smoother.prepare import prepare
from smoother.samples import GnssFixes, Problem
from smoother.session.checks.times import DATES

from .checked import checked
from .folders import Folder, codes, gps_csv, imu_csv, nmea_epochs

WEEKS = dt.timedelta(weeks=1024)


def unix(year: int, month: int, day: int) -> float:
    return dt.datetime(year, month, day, 10, tzinfo=dt.UTC).timestamp()


def read(unix_s: np.ndarray, stated: str | None = None) -> tuple[np.ndarray, list[Problem]]:
    n = len(unix_s)
    place = np.full(n, 45.0)
    fixes = GnssFixes(np.arange(n) * 0.2, place, place, place, np.full((n, 3), np.nan), unix_s=unix_s)
    recording, problems = checked(DATES, fixes, date=stated)
    assert recording.gnss.unix_s is not None
    return recording.gnss.unix_s, problems


def dates(*written: float) -> np.ndarray:
    return np.repeat(written, 50) + 0.2 * np.arange(50 * len(written))


@pytest.mark.parametrize(("written", "true"), [((1999, 10, 30), (2019, 6, 15)), ((2006, 12, 7), (2026, 7, 23))])
def test_dates_that_are_weeks_back_are_put_on(written: tuple[int, int, int], true: tuple[int, int, int]) -> None:
    assert dt.date(*written) + WEEKS == dt.date(*true)
    made, (problem,) = read(dates(unix(*written)))
    np.testing.assert_array_equal(made, dates(unix(*true)))
    assert (problem.code, problem.count) == ("gps_week_rollover", 50)
    told = f"its dates ({dt.date(*written)}) are 1024 weeks back"
    assert told in problem.text and f"taken as {dt.date(*true)}" in problem.text


def test_dates_of_today_are_not_touched() -> None:
    made, problems = read(dates(unix(2010, 1, 1)))
    assert problems == []
    np.testing.assert_array_equal(made, dates(unix(2010, 1, 1)))
    made, problems = read(np.full(50, np.nan))
    assert problems == [] and np.isnan(made).all()


@pytest.mark.parametrize("written", [(1980, 1, 6), (1992, 4, 1), (2009, 8, 1)])
def test_an_old_date_that_no_rollover_explains_is_only_said(written: tuple[int, int, int]) -> None:
    """Of the week in which GPS time began, as of a receiver that knows none; one too early with more, or to come."""
    made, (problem,) = read(dates(unix(*written)))
    np.testing.assert_array_equal(made, dates(unix(*written)))
    assert problem.code == "gps_date_old" and str(dt.date(*written)) in problem.text


def test_a_date_that_a_person_states_decides() -> None:
    made, problems = read(dates(unix(2006, 12, 7)), "2006-12-07")
    assert problems == []
    np.testing.assert_array_equal(made, dates(unix(2006, 12, 7)))
    made, (problem,) = read(dates(unix(1994, 6, 5)), str(dt.date(1994, 6, 5) + WEEKS))
    np.testing.assert_array_equal(made, dates(unix(1994, 6, 5) + WEEKS.total_seconds()))
    assert problem.code == "gps_week_rollover"
    assert read(dates(unix(2006, 12, 7)), "some day")[1][0].code == "gps_week_rollover"


def test_a_receiver_that_finds_its_date_later_has_one_date() -> None:
    written = dates(unix(2006, 12, 7), unix(2026, 7, 23))
    made, (problem,) = read(written)
    np.testing.assert_array_equal(made, dates(unix(2026, 7, 23), unix(2026, 7, 23)))
    assert problem.count == 50


@pytest.mark.parametrize("form", ["csv", "nmea"])
@pytest.mark.parametrize("written", [dt.date(1999, 10, 30), dt.date(2006, 5, 4)])
def test_the_date_of_the_session_is_the_one_put_on(folder: Folder, form: str, written: dt.date) -> None:
    """Sentences have two digits of a year: 99 is none to come."""
    if form == "nmea":
        sentences = "".join(nmea_epochs(50)).replace("310524", f"{written:%d%m%y}").replace("*", "\r\n*")
        folder.write(rover__nmea=sentences)
    else:
        header, *rows = gps_csv().splitlines()
        table = [f"{header},utc", *(f"{row},{written}T10:00:{k / 5:05.2f}Z" for k, row in enumerate(rows))]
        folder.write(gps__csv="\n".join(table), imu__csv=imu_csv())
    session = folder.load()
    assert codes(session)["gps_week_rollover"] == 50
    assert session_date(prepare(session)) == written + WEEKS
    assert session.unix_at_zero == pytest.approx(unix(written.year, written.month, written.day) + WEEKS.total_seconds())
