"""Rows that an exporter put between fixes: found whatever the rates, and never where all rows were measured."""

import numpy as np
import pytest

from smoother.arrays import Array
from smoother.session.interpolated import between_samples, on_drawn_lines


def drive(rate: float, duration: float = 120.0) -> tuple[Array, list[Array]]:
    """Fixes round an oval: times, latitude, longitude, height and speed."""
    rng = np.random.default_rng(2)
    t = np.arange(0.0, duration, 1.0 / rate)
    course, speed = t / 5.0 + 0.3 * np.sin(t), 14.0 + 4.0 * np.sin(t / 4.0) + 0.05 * rng.standard_normal(t.size)
    north, east = np.cumsum(speed * np.array([np.cos(course), np.sin(course)]), axis=1) / rate
    return t, [45 + north / 111_195, 12 + east / 78_600, 8.0 + 0.1 * rng.standard_normal(t.size), speed]


def test_samples_at_the_stamps_of_other_sensors_are_distinguished_from_measured_ones() -> None:
    rng = np.random.default_rng(4)
    measured = np.round(np.arange(0.0, 60.0, 0.02), 3)
    t = np.unique(np.round(np.concatenate([measured, rng.uniform(0.0, 59.9, 900)]), 3))
    samples = np.round(rng.standard_normal((6, measured.size)), 3)
    channels = [np.round(np.interp(t, measured, x), 5) for x in samples]
    between = between_samples(t, channels)
    np.testing.assert_array_equal(t[~between], measured)
    assert not np.any(between_samples(measured, list(samples)))
    assert not np.any(between_samples(t, [np.full(t.size, 0.5)] * 6))  # a sensor that stands still


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
