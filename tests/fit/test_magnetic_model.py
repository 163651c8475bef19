import datetime
from dataclasses import replace

import numpy as np
import pytest

from smoother.config import MagnetometerUse, SessionConfig
from smoother.fit.magnetic_model import earth_field, field_n, session_date, session_declination
from smoother.frames import Origin
from smoother.samples import GnssFixes, Session
from smoother.units import DEG

MADRID = Origin(40.4168, -3.7038, 650.0)


def session(unix=None, config=None, unix_at_zero=None):
    one = np.array([1.0])
    unix_s = None if unix is None else np.array([unix])
    fixes = GnssFixes(one, 40.0 * one, -3.0 * one, 600.0 * one, np.full((1, 3), np.nan), unix_s=unix_s)
    return Session("s", fixes, MADRID, config=config or SessionConfig(), unix_at_zero=unix_at_zero)


@pytest.mark.parametrize(
    ("year", "lat", "lon", "north", "east", "down"),
    [
        # test values published with WMM2025 and WMM2020, at height zero, nT
        (2025.0, 80.0, 0.0, 6521.6, 145.9, 54791.5),
        (2025.0, 0.0, 120.0, 39677.8, -109.6, -10580.2),
        (2025.0, -80.0, 240.0, 6117.5, 15751.9, -52022.5),
        (2020.0, 80.0, 0.0, 6570.4, -146.3, 54606.0),
        # and of the independent implementation of space-physics/wmm2025
        (2026.5, 65.0, 85.0, 8739.6, 2229.25, 60367.16),
    ],
)
def test_the_field_equals_published_test_values(year, lat, lon, north, east, down):
    field = earth_field(Origin(lat, lon, 0.0), year)
    np.testing.assert_allclose(field.field_n * 1e9, [north, -east, -down], atol=0.1)  # published to a tenth
    assert abs(np.tan(field.declination) - east / north) < 1e-4
    assert field.note == ""


def test_the_vector_in_n_points_east_of_north_for_a_positive_declination_and_down_in_the_north():
    field = earth_field(Origin(47.6205, -122.3493, 0.0), 2025.25)
    assert abs(field.declination - 15.0656 * DEG) < 1e-3 * DEG
    assert field.field_n[1] < 0.0  # west is positive
    assert field.field_n[2] < 0.0  # up is positive
    np.testing.assert_allclose(np.linalg.norm(field.field_n), field.strength)
    np.testing.assert_allclose(field.field_n, field_n(field.declination, field.inclination, field.strength))


@pytest.mark.parametrize(("year", "used"), [(2003.0, 2010.0), (2041.5, 2030.0)])
def test_a_date_outside_the_models_is_clipped_and_reported(year, used):
    field = earth_field(MADRID, year)
    assert field.year == used
    assert f"{used:.0f} was used" in field.note


@pytest.mark.parametrize("year", [2010.0, 2014.999, 2015.0, 2020.0, 2024.999, 2025.0, 2030.0])
def test_every_year_of_the_models_has_a_field(year):
    assert earth_field(MADRID, year).note == ""


def test_a_place_near_a_magnetic_pole_is_reported():
    assert "pole" in earth_field(Origin(86.0, -170.0, 0.0), 2026.0).note


def test_the_date_of_a_session_comes_from_the_fixes_then_the_clock_then_the_settings():
    settings = SessionConfig(date="2018-07-14")
    may_2026, june_2022 = 1778925600.0, 1655000000.0
    assert session_date(session(may_2026, settings, june_2022)) == datetime.date(2026, 5, 16)
    assert session_date(session(None, settings, june_2022)) == datetime.date(2022, 6, 12)
    assert session_date(session(None, settings)) == datetime.date(2018, 7, 14)
    assert session_date(session()) is None


def test_the_settings_know_better_than_a_receiver_that_is_years_back():
    january_1980 = 316000800.0
    assert session_date(session(january_1980, SessionConfig(date="2018-07-14"))) == datetime.date(2018, 7, 14)
    assert session_date(session(january_1980)) == datetime.date(1980, 1, 6)


@pytest.mark.parametrize("unix", [1e18, -5.0, np.inf])
def test_a_damaged_date_counts_as_none(unix):
    assert session_date(session(unix)) is None


def test_a_damaged_date_in_the_settings_counts_as_none():
    assert session_date(session(config=SessionConfig(date="14.7.2018"))) is None


def test_a_configured_declination_wins_over_the_model():
    config = SessionConfig(magnetometer=MagnetometerUse(declination_deg=-7.5))
    declination, problems = session_declination(session(1778925600.0, config))
    assert declination == -7.5 * DEG
    assert problems == ()


def test_the_declination_comes_from_place_and_date():
    declination, problems = session_declination(session(1778925600.0))
    assert abs(declination - earth_field(MADRID, 2026.37).declination) < 1e-4
    assert problems == ()


def test_a_session_without_a_date_or_outside_the_models_reports_the_assumption():
    _, problems = session_declination(session())
    assert [problem.code for problem in problems] == ["magnetic_model_date"]
    _, problems = session_declination(replace(session(), config=SessionConfig(date="1999-01-01")))
    assert [problem.code for problem in problems] == ["magnetic_model"]
