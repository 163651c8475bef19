"""Degrees to metres and back by the equirectangular projection (thesis, eq. 2.5-2.6).

Erratum: eq. 2.5 gives metres towards east, longitude growing that way, while the second axis of North-West-Up points
west; so it is taken with a minus sign. The Earth is a sphere here, which stretches distances by up to 0.3 %; because
the way back is the same formula, that error leaves the result again and only scales velocities.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.frames import wrap_angle
from smoother.units import DEG

EARTH_RADIUS = 6371008.8  # m, mean radius


@dataclass(frozen=True)
class Projection:
    """Metres about a centre, the mean position of the fixes (degrees)."""

    lat_deg: float
    lon_deg: float

    @staticmethod
    def about_mean(lat_deg: Array, lon_deg: Array) -> "Projection":
        """Projection centred on the mean of positions (N,), also across the 180 degree meridian."""
        offset = wrap_angle((lon_deg - lon_deg[0]) * DEG) / DEG
        return Projection(float(np.mean(lat_deg)), float(lon_deg[0] + np.mean(offset)))

    def to_metres(self, lat_deg: Array, lon_deg: Array) -> Array:
        """North and west (N, 2) m of positions (N,) in degrees."""
        north = EARTH_RADIUS * (lat_deg - self.lat_deg) * DEG
        east = EARTH_RADIUS * wrap_angle((lon_deg - self.lon_deg) * DEG) * np.cos(self.lat_deg * DEG)
        return np.stack([north, -east], axis=-1)

    def to_degrees(self, metres: Array) -> tuple[Array, Array]:
        """Latitude and longitude (N,) in degrees of north and west (N, 2) m."""
        lat = self.lat_deg + metres[:, 0] / EARTH_RADIUS / DEG
        lon = self.lon_deg - metres[:, 1] / (EARTH_RADIUS * np.cos(self.lat_deg * DEG)) / DEG
        return lat, wrap_angle(lon * DEG) / DEG
