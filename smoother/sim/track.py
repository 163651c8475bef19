"""Three closed kart tracks of our own invention, and the type that describes one.

A track is drawn as a polygon whose corners are rounded by arcs; points along it every few metres become the control
points of a periodic quintic B-spline, so that the centre line has four continuous derivatives and no overshoot.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from scipy.interpolate import BSpline, CubicSpline

from smoother.arrays import Array, frozen
from smoother.frames import Origin, nwu_to_geodetic, to_left
from smoother.units import DEG

_DEGREE = 5
_CONTROL_SPACING = 4.0  # m; the spline turns the step of curvature at an arc's end into a ramp of about 10 m


@dataclass(frozen=True, eq=False)
class Corner:
    """A vertex of the drawn polygon: north, west (m) and the radius (m) of the arc that rounds it."""

    north: float
    west: float
    radius: float


@dataclass(frozen=True, eq=False)
class Track:
    """A closed track in n, centred on `origin`. `corners` in driving order; distance zero is the start/finish line.

    hills : (amplitude m, waves per lap, phase rad) of each term of the height profile. width m, of the asphalt.
    start_fraction : where on the straight from the last corner to the first the line stands, 0..1.
    """

    name: str
    origin: Origin
    corners: Sequence[Corner]
    hills: Sequence[tuple[float, int, float]] = ()
    width: float = 8.0
    start_fraction: float = 0.5

    @cached_property
    def length(self) -> float:
        """Length of the centre line in plan, m."""
        return float(self._distance_table[1][-1])

    def centre(self, distance: Array) -> Array:
        """Position on the centre line, (N, 3) m in n, at distances (N,) m; distances wrap around."""
        u = self._parameter(distance)
        plan = self._spline(u)
        return np.concatenate([plan, self._height(distance)[:, None]], axis=1)

    def tangent(self, distance: Array) -> Array:
        """Unit tangent of the centre line in plan, (N, 2): north, west."""
        tangent = self._spline(self._parameter(distance), nu=1)
        return np.asarray(tangent / np.linalg.norm(tangent, axis=1, keepdims=True))

    def curvature(self, distance: Array) -> Array:
        """Curvature of the centre line in plan, (N,) 1/m, positive to the left."""
        u = self._parameter(distance)
        first, second = self._spline(u, nu=1), self._spline(u, nu=2)
        return np.asarray(to_left(first, second) / np.linalg.norm(first, axis=1) ** 3)

    def slope(self, distance: Array) -> Array:
        """Rise of the centre line per metre, (N,)."""
        wave = 2.0 * np.pi / self.length
        phase = wave * np.asarray(distance)
        terms = (a * k * wave * np.cos(k * phase + p) for a, k, p in self.hills)
        return np.asarray(sum(terms, start=np.zeros_like(phase)))

    @cached_property
    def start_line(self) -> Array:
        """Left and right end of the start/finish line as the driver sees it, (2, 2) m: north, west in n."""
        centre = self.centre(np.zeros(1))[0, :2]
        tangent = self.tangent(np.zeros(1))[0]
        left = np.array([-tangent[1], tangent[0]])
        half = self.width / 2.0 + 1.0  # a metre beyond either edge: a line that no car passes by
        return frozen(np.stack([centre + half * left, centre - half * left]), (2, 2), "start_line")

    @cached_property
    def start_line_deg(self) -> Array:
        """The same ends as latitude and longitude, (2, 2) deg."""
        ends = np.concatenate([self.start_line, np.zeros((2, 1))], axis=1)
        lat, lon, _ = nwu_to_geodetic(ends, self.origin)
        return frozen(np.stack([lat, lon], axis=1), (2, 2), "start_line_deg")

    def _height(self, distance: Array) -> Array:
        phase = 2.0 * np.pi * np.asarray(distance) / self.length
        return np.asarray(sum((a * np.sin(k * phase + p) for a, k, p in self.hills), start=np.zeros_like(phase)))

    @cached_property
    def _spline(self) -> Any:
        control = _rounded_polygon(self.corners, self.start_fraction)
        wrapped = np.concatenate([control, control[:_DEGREE]])
        knots = np.arange(len(wrapped) + _DEGREE + 1, dtype=np.float64) - 3.0  # parameter k is nearest to point k
        return BSpline(knots, wrapped, _DEGREE, extrapolate="periodic")

    @cached_property
    def _distance_table(self) -> tuple[Array, Array]:
        spans = len(_rounded_polygon(self.corners, self.start_fraction))
        # m, of the table that turns distance into the spline's parameter
        u = np.linspace(0.0, spans, int(spans * _CONTROL_SPACING / 0.25) + 1)
        nodes, weights = np.polynomial.legendre.leggauss(3)
        step = u[1] - u[0]
        inner = u[:-1, None] + 0.5 * step * (nodes + 1.0)
        speed = np.linalg.norm(self._spline(inner.ravel(), nu=1), axis=1).reshape(inner.shape)
        return u, np.concatenate([[0.0], np.cumsum(0.5 * step * speed @ weights)])

    @cached_property
    def _parameter_of_distance(self) -> Any:
        u, distance = self._distance_table
        return CubicSpline(distance, u)

    def _parameter(self, distance: Array) -> Array:
        return np.asarray(self._parameter_of_distance(np.mod(distance, self.length)))


def _rounded_polygon(corners: Sequence[Corner], start_fraction: float) -> Array:
    """Points every `_CONTROL_SPACING` or so along the polygon with rounded corners, (K, 2), closed."""
    vertices = np.array([[c.north, c.west] for c in corners])
    pieces: list[Array] = []
    entries, exits = [], []
    for i, corner in enumerate(corners):
        entry, arc, leave = _fillet(vertices[i - 1], vertices[i], vertices[(i + 1) % len(corners)], corner.radius)
        entries.append(entry)
        exits.append(leave)
        pieces.append(arc)
    start = exits[-1] + start_fraction * (entries[0] - exits[-1])
    outline = [start[None, :]]
    for arc in pieces:
        outline.append(arc)
    polyline = np.concatenate([*outline, start[None, :]])
    distance = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(polyline, axis=0), axis=1))])
    count = round(distance[-1] / _CONTROL_SPACING)
    at = np.arange(count) * distance[-1] / count
    return np.stack([np.interp(at, distance, polyline[:, axis]) for axis in range(2)], axis=1)


def _fillet(before: Array, vertex: Array, after: Array, radius: float) -> tuple[Array, Array, Array]:
    """Arc of `radius` that rounds `vertex`: its first point, points along it (K, 2), its last point."""
    back, ahead = before - vertex, after - vertex
    back, ahead = back / np.linalg.norm(back), ahead / np.linalg.norm(ahead)
    half_angle = 0.5 * np.arccos(np.clip(back @ ahead, -1.0, 1.0))
    cut = radius / np.tan(half_angle)
    bisector = back + ahead
    centre = vertex + bisector / np.linalg.norm(bisector) * radius / np.sin(half_angle)
    first, last = vertex + cut * back, vertex + cut * ahead
    start, turn = first - centre, np.pi - 2.0 * half_angle
    sign = np.sign(-back[0] * ahead[1] + back[1] * ahead[0])
    angle = sign * np.linspace(0.0, turn, max(3, int(np.ceil(turn * radius / 0.25))))
    cos, sin = np.cos(angle), np.sin(angle)
    arc = centre + np.stack([cos * start[0] - sin * start[1], sin * start[0] + cos * start[1]], axis=1)
    return first, arc, last


def _corners(turn_deg: float, *east_north_radius: tuple[float, float, float]) -> tuple[Corner, ...]:
    """Corners from (east, north, radius) triples, m, turned clockwise so that no straight is along an axis."""
    cos, sin = np.cos(turn_deg * DEG), np.sin(turn_deg * DEG)
    return tuple(
        Corner(float(cos * north - sin * east), float(-cos * east - sin * north), radius)
        for east, north, radius in east_north_radius
    )


_LARKFIELD = Track(
    name="larkfield",  # club track, clockwise: two hairpins, straights 32 m apart, a chicane
    origin=Origin(52.1174, 17.4082, 96.0),
    corners=_corners(
        37.0,
        *((0, 205, 14), (33, 212, 14), (37, 98, 16), (84, 88, 20), (96, 176, 34), (150, 214, 24)),
        *((212, 190, 22), (192, 96, 45), (230, 34, 26), (206, -46, 16), (128, -30, 30), (104, 6, 13)),
        *((70, -42, 15), (38, -34, 25), (0, -66, 14)),
    ),
    hills=((1.6, 1, 0.4), (0.5, 3, 2.0)),
)
_TINBARN = Track(
    name="tinbarn",  # short and tight like a hall, anticlockwise: mostly hairpins, nearly flat
    origin=Origin(-34.2719, -60.8925, 71.0),
    corners=_corners(
        -22.0,
        *((125, 0, 10), (134, 21, 8.5), (53, 24, 9), (48, 45, 9), (130, 48, 9), (137, 75, 11), (103, 82, 11)),
        *((89, 67, 11), (67, 72, 9), (70, 101, 11), (17, 106, 11), (12, 74, 17), (26, 43, 17), (-10, 22, 10)),
        *((-5, 0, 9),),
    ),
    hills=((0.15, 1, 1.0),),
    width=6.0,
)
_LONGMEADOW = Track(
    name="longmeadow",  # fast and open, clockwise: a 350 m straight, sweepers, a slow hairpin, some height
    origin=Origin(38.6113, -99.3307, 655.0),
    corners=_corners(
        -118.0,
        *((0, 262, 30), (66, 300, 34), (132, 262, 30), (126, 176, 38), (206, 150, 32), (236, 246, 30), (304, 250, 26)),
        *((316, 140, 90), (286, 50, 55), (330, -40, 13), (300, -62, 13), (214, 24, 45), (118, -6, 24), (92, -100, 24)),
        *((0, -128, 20),),
    ),
    hills=((3.2, 1, 2.6), (0.8, 2, 0.3)),
    width=10.0,
)

TRACKS: Mapping[str, Track] = MappingProxyType({t.name: t for t in (_LARKFIELD, _TINBARN, _LONGMEADOW)})
