"""Rows that an exporter put between fixes: found whatever the rates, and never where all rows were measured."""

from pathlib import Path

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.session.csv_form import read_fixes
from smoother.session.interpolated import between_samples, measured_rows, on_drawn_lines
from smoother.session.load import load_raw

FOLDERS = (
    *("kart_lignano_racebox", "kart_massafinalese_racechrono", "kart_adria_first_half", "kart_okc_doves"),
    *("nmea_kart_okc", "bicycle_neo6m", "car_hi600_rtk"),
)
DIGITS = (8, 8, 2, 4)  # of degrees, metres and m/s, as exporters write them


def drive(rate: float, duration: float = 120.0) -> tuple[Array, list[Array]]:
    """Fixes round an oval: times, latitude, longitude, height and speed."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, duration, 1.0 / rate)
    course, speed = t / 5.0 + 0.3 * np.sin(t), 14.0 + 4.0 * np.sin(t / 4.0) + 0.05 * rng.standard_normal(t.size)
    north, east = np.cumsum(speed * np.array([np.cos(course), np.sin(course)]), axis=1) / rate
    return t, [45 + north / 111_195, 12 + east / 78_600, 8.0 + 0.1 * rng.standard_normal(t.size), speed]


def exported(rate: float, row_rate: float, late: float = 0.0) -> tuple[Array, list[Array]]:
    """The same with straight lines between fixes, at rows that begin `late` s after the first of them."""
    t, channels = drive(rate)
    rows = np.round(np.arange(late, t[-1], 1.0 / row_rate), 6)
    return rows, [np.round(np.interp(rows, t, x), digits) for x, digits in zip(channels, DIGITS, strict=True)]


@pytest.mark.parametrize("late", [0.0, 0.003])
@pytest.mark.parametrize(("rate", "row_rate"), [(1, 100), (5, 20), (10, 50), (10, 100), (18, 100), (25, 100)])
def test_rows_between_fixes_are_left_out_whatever_the_rates(rate: float, row_rate: float, late: float) -> None:
    t, channels = exported(rate, row_rate, late)
    rows = measured_rows(t, channels)
    assert rows is not None
    assert abs(rows.size - drive(rate)[0].size) <= 2
    phase = np.mod(t[rows] * rate + 0.5, 1.0) - 0.5
    assert np.percentile(np.abs(phase), 90) <= 0.55 * rate / row_rate  # the row nearest to each fix


def test_every_second_row_is_left_out_where_rows_come_twice_as_often() -> None:
    t, channels = exported(10.0, 20.0)
    rows = measured_rows(t, channels)
    assert rows is not None and np.all(np.diff(rows) == 2)


@pytest.mark.parametrize(("rate", "row_rate"), [(1, 5), (1, 10), (2, 10)])
def test_stamps_in_tenths_of_milliseconds_add_no_fixes(rate: float, row_rate: float) -> None:
    """They bend the lines a little at rows that are none, by which fixes seemed to come twice as often."""
    t, channels = exported(rate, row_rate)
    rows = measured_rows(np.round(t * (1.0 + 37e-6), 4), channels[:3])
    assert rows is not None
    np.testing.assert_array_equal(np.mod(rows, round(row_rate / rate)), 0)


def road(rate: float, duration: float = 600.0) -> tuple[Array, list[Array]]:
    """Fixes on a road that leads north-east, so that no latitude comes near another."""
    t = np.arange(0.0, duration, 1.0 / rate)
    noise = 0.02 * np.random.default_rng(3).standard_normal((2, t.size))
    course, speed = 0.8 + 0.4 * np.sin(t / 15.0) + 0.2 * np.sin(t / 4.0), 20.0 + 5.0 * np.sin(t / 9.0)
    north, east = np.cumsum(speed * np.array([np.cos(course), np.sin(course)]), axis=1) / rate + noise
    return t, [45 + north / 111_195, 12 + east / 78_600]


def test_they_are_left_out_of_a_road_that_never_comes_back() -> None:
    t, channels = road(1.0)
    rows = np.round(np.arange(0.0, t[-1], 0.1), 6)
    found = measured_rows(rows, [np.round(np.interp(rows, t, x), 7) for x in channels])
    assert found is not None and abs(found.size - t.size) <= 2
    for digits in (5, 6, 7, 9):
        assert measured_rows(t, [np.round(x, digits) for x in channels]) is None
        quick, measured = road(10.0)
        assert measured_rows(quick, [np.round(x, digits) for x in measured]) is None


def test_a_gentle_bend_without_any_noise_is_no_row_of_lines() -> None:
    angle = 4.3 / 250.0 * np.arange(81) / 10.0
    lat, lon = 0.4 + 250.0 * np.sin(angle) / 110_575, 4.3 - 250.0 * (1.0 - np.cos(angle)) / 111_319.7
    assert measured_rows(np.arange(81) / 10.0, [np.round(lat, 9), np.round(lon, 9)]) is None


@pytest.mark.parametrize("rate", [7.5, 50.0])
def test_nor_are_those_of_any_bend_at_stamps_in_milliseconds(rate: float) -> None:
    """At 7.5 Hz their rounding comes back every third row; and a bend may be off its chord by hardly a digit."""
    rng = np.random.default_rng(3)
    for _ in range(500):
        begin, radius, speed = rng.uniform([0.0, 60.0, 3.0], [1.0, 400.0, 20.0])
        exact = begin + np.arange(rng.integers(60, 120)) / rate
        lat = rng.uniform(-1.0, 1.0) + radius * np.sin(exact * speed / radius) / 110_575
        lon = rng.uniform(-180.0, 180.0) - radius * (1.0 - np.cos(exact * speed / radius)) / 111_319.7
        assert measured_rows(np.round(exact, 3), [np.round(lat, 9), np.round(lon, 9)]) is None


@pytest.mark.parametrize("rate", [1.0, 5.0, 10.0, 25.0])
@pytest.mark.parametrize("digits", [5, 6, 7, 9])
def test_measured_rows_stay_whatever_their_digits(rate: float, digits: int) -> None:
    t, (lat, lon, *others) = drive(rate, 600.0)
    for speed_digits in (1, 3):
        channels = [np.round(lat, digits), np.round(lon, digits), *(np.round(x, speed_digits) for x in others)]
        assert measured_rows(t, channels) is None


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("step", [1e-310, 1e-9, 1e9])
def test_absurd_times_neither_warn_nor_fill_the_memory(step: float) -> None:
    t, channels = exported(5, 50)
    t = np.where(np.arange(t.size) % 1000 < 900, t, t + step).cumsum()
    rows = measured_rows(t, [*channels, np.linspace(0.0, 1e308, t.size)])
    assert rows is None or rows.size <= t.size


@pytest.mark.parametrize("folder", FOLDERS)
@pytest.mark.parametrize("digits", [5, 6, 7, 9])
def test_fixes_of_real_receivers_stay_whatever_their_digits(data_directory: Path, folder: str, digits: int) -> None:
    raw = load_raw(data_directory / folder)
    assert "gps_interpolated" not in {problem.code for problem in raw.problems}
    gnss = raw.gnss
    positions = [np.round(gnss.lat_deg, digits), np.round(gnss.lon_deg, digits)]
    assert measured_rows(gnss.t, positions) is None
    assert measured_rows(gnss.t, [*positions, np.round(gnss.speed, 1 if digits < 7 else 3)]) is None


def test_a_table_of_interpolated_fixes_has_as_many_as_were_measured(tmp_path: Path) -> None:
    t, channels = exported(5, 50)
    rows = np.column_stack([t, *channels])
    np.savetxt(tmp_path / "gps.csv", rows, "%.10f", ",", header="t_s,lat_deg,lon_deg,alt_m,speed_mps", comments="")
    fixes, problems = read_fixes(tmp_path / "gps.csv")
    assert abs(len(fixes) - 600) <= 2
    (said,) = [problem for problem in problems if problem.code == "gps_interpolated"]
    assert said.count == t.size - len(fixes)
    assert said.text == (
        f"gps.csv: positions between fixes were made up along straight lines, by exporter or receiver; "
        f"{said.count} rows left out"
    )


def test_velocities_that_were_interpolated_by_their_parts_hide_no_rows(tmp_path: Path) -> None:
    """The size of a velocity between two others is not between theirs in a bend; positions tell alone."""
    fixed, (lat, lon, alt, speed) = drive(5.0)
    course = fixed / 5.0 + 0.3 * np.sin(fixed)
    t = np.round(np.arange(0.0, fixed[-1], 0.1), 6)
    lat, lon, alt, north, east = (
        np.interp(t, fixed, values) for values in (lat, lon, alt, speed * np.cos(course), speed * np.sin(course))
    )
    heading = np.degrees(np.arctan2(east, north)) % 360.0
    table = np.column_stack([t, np.round(lat, 8), np.round(lon, 8), np.round(alt, 2), np.hypot(north, east), heading])
    header = "t_s,lat_deg,lon_deg,alt_m,speed_mps,course_deg"
    np.savetxt(tmp_path / "gps.csv", table, fmt="%.8f", delimiter=",", header=header, comments="")
    fixes, problems = read_fixes(tmp_path / "gps.csv")
    assert "gps_interpolated" in {problem.code for problem in problems}
    assert len(fixes) == pytest.approx(t.size / 2, abs=2)


def test_samples_at_the_stamps_of_other_sensors_are_told_from_those_that_were_measured() -> None:
    rng = np.random.default_rng(4)
    measured = np.round(np.arange(0.0, 60.0, 0.02), 3)
    t = np.unique(np.round(np.concatenate([measured, rng.uniform(0.0, 59.9, 900)]), 3))
    samples = np.round(rng.standard_normal((6, measured.size)), 3)
    channels = [np.round(np.interp(t, measured, x), 5) for x in samples]
    between = between_samples(t, channels)
    np.testing.assert_array_equal(t[~between], measured)
    assert not np.any(between_samples(measured, list(samples)))
    assert not np.any(between_samples(t, [np.full(t.size, 0.5)] * 6))  # a sensor that stands still


def test_rows_between_fixes_are_found_by_utc_where_stamps_are_those_of_the_arrival(tmp_path: Path) -> None:
    t, channels = exported(1, 10)
    stamps = t + 0.08 + np.random.default_rng(1).exponential(0.01, t.size)
    table = np.column_stack([stamps, 1_779_000_000.0 + t, *channels])
    header = "t_s,unix_s,lat_deg,lon_deg,alt_m,speed_mps"
    np.savetxt(tmp_path / "gps.csv", table, fmt="%.8f", delimiter=",", header=header, comments="")
    fixes, problems = read_fixes(tmp_path / "gps.csv")
    assert "gps_interpolated" in {problem.code for problem in problems}
    assert len(fixes) == pytest.approx(t.size / 10, abs=2)
    np.testing.assert_allclose(fixes.unix_s % 1.0, 0.0, atol=1e-3)


def lines_over(first: int, last: int, *, still: bool = False, rate: float = 10.0) -> tuple[Array, list[Array], Array]:
    """Fixes with a straight line in place of those between two, and the way from each to the next."""
    t, (lat, lon, _, speed) = drive(rate)
    for values in (lat, lon, speed):
        values[first : last + 1] = np.interp(t[first : last + 1], t[[first, last]], values[[first, last]])
        if still:
            values[first : last + 1] = values[first]
    way = np.append(0.0, 111_195.0 * np.hypot(np.diff(lat), np.diff(lon) * np.cos(np.radians(lat[0]))))
    return t, [np.round(lat, 8), np.round(lon, 8), np.round(speed, 4)], way


def test_fixes_on_a_line_drawn_over_an_outage_are_found() -> None:
    drawn = on_drawn_lines(*lines_over(300, 340))
    assert np.flatnonzero(drawn).tolist() == list(range(301, 340))


@pytest.mark.parametrize(("last", "still"), [(310, False), (340, True)])
def test_a_short_line_and_a_kart_at_rest_stay(last: int, still: bool) -> None:
    assert not on_drawn_lines(*lines_over(300, last, still=still)).any()


def test_where_lines_tell_nothing_all_stay() -> None:
    """Straight on at constant speed, or with digits as coarse as the noise, every fix is on a line."""
    t, channels, way = lines_over(300, 340)
    coarse = [np.round(channel, digits) for channel, digits in zip(channels, (4, 4, 0), strict=True)]
    assert not on_drawn_lines(t, coarse, way).any()
    assert not on_drawn_lines(t, [1e-4 * t, 1e-4 * t, np.full(t.size, 15.0)], np.full(t.size, 1.5)).any()
