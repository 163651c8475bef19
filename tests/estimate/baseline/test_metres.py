import numpy as np
import pytest

from smoother.estimate.baseline.metres import EARTH_RADIUS, Projection
from smoother.frames import Origin, geodetic_to_nwu
from smoother.units import DEG

LAT, LON = np.array([45.000, 45.003, 44.998]), np.array([10.000, 10.004, 9.997])


def test_the_mean_position_is_the_origin():
    metres = Projection.about_mean(LAT, LON).to_metres(LAT, LON)
    np.testing.assert_allclose(np.mean(metres, axis=0), 0.0, atol=1e-6)


def test_north_grows_with_latitude_and_west_against_longitude():
    # eq. 2.5 as printed grows with longitude: that is east
    metres = Projection(45.0, 10.0).to_metres(np.array([45.001]), np.array([10.001]))
    np.testing.assert_allclose(metres[0, 0], EARTH_RADIUS * 0.001 * DEG)
    np.testing.assert_allclose(metres[0, 1], -EARTH_RADIUS * 0.001 * DEG * np.cos(45.0 * DEG))


@pytest.mark.parametrize("lat", [-55.0, 0.0, 45.0, 65.0])
def test_it_stretches_distances_by_less_than_a_percent(lat):
    lats, lons = lat + np.array([-0.002, 0.002]), np.array([-0.003, 0.003])
    metres = Projection.about_mean(lats, lons).to_metres(lats, lons)
    exact = geodetic_to_nwu(lats, lons, np.zeros(2), Origin(lat, 0.0, 0.0))
    np.testing.assert_allclose(metres, exact[:, :2], rtol=0.01, atol=0.05)


def test_the_way_back_gives_the_degrees_again():
    projection = Projection.about_mean(LAT, LON)
    lat, lon = projection.to_degrees(projection.to_metres(LAT, LON))
    np.testing.assert_allclose(lat, LAT, atol=1e-12)
    np.testing.assert_allclose(lon, LON, atol=1e-12)


def test_a_track_across_the_date_line_stays_in_one_piece():
    lat, lon = np.full(3, -16.5), np.array([179.999, -179.999, 179.998])
    projection = Projection.about_mean(lat, lon)
    metres = projection.to_metres(lat, lon)
    assert np.max(np.abs(metres)) < 500.0
    np.testing.assert_allclose(projection.to_degrees(metres)[1], lon, atol=1e-9)
