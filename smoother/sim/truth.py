"""Truth: the exact motion of a simulated kart, at any time, with derivatives that belong together.

Position, Euler angles and the engine are one quintic B-spline over time. Velocity, acceleration and rates are its
exact derivatives, so that integrating specific force and rate gives the position back to rounding error; nothing is
differentiated numerically. The body is at the IMU; an antenna sits at a lever arm from it.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from smoother.arrays import Array, freeze
from smoother.frames import GRAVITY_N, Origin, geodetic_to_nwu, nwu_to_geodetic, rotation_from_euler
from smoother.trajectory import Trajectory
from smoother.units import DEG

_DEGREE = 5
_POSITION, _EULER = slice(0, 3), slice(3, 6)
_REVOLUTIONS, _THROTTLE, _RUNNING = 6, 7, 8
CHANNELS = 9


@dataclass(frozen=True)
class Clock:
    """The logger's clock: `session = offset + (1 + drift) * true`; drift is a fraction (50 ppm = 50e-6)."""

    offset: float = 0.0
    drift: float = 0.0

    def to_session(self, true_time: Array) -> Array:
        """Session time (N,) s of true times (N,) s since the start of the recording."""
        return np.asarray(self.offset + (1.0 + self.drift) * np.asarray(true_time))

    def to_true(self, session_time: Array) -> Array:
        """True time (N,) s since the start of the recording of session times (N,) s."""
        return np.asarray((np.asarray(session_time) - self.offset) / (1.0 + self.drift))


@dataclass(frozen=True, eq=False)
class TruthStates:
    """The IMU's motion. t (N,) s; position_n, velocity_n, acceleration_n (N, 3); R_nb (N, 3, 3) of the kart.

    angular_rate_b (N, 3) rad/s, angular_acceleration_b (N, 3) rad/s^2, both resolved in b.
    """

    t: Array
    position_n: Array
    velocity_n: Array
    acceleration_n: Array
    R_nb: Array
    angular_rate_b: Array
    angular_acceleration_b: Array

    @property
    def specific_force_b(self) -> Array:
        """What an ideal accelerometer at the IMU reads, (N, 3) m/s^2."""
        return np.asarray(np.einsum("nji,nj->ni", self.R_nb, self.acceleration_n - GRAVITY_N))

    def antenna_position_n(self, lever_arm_b: Array) -> Array:
        """Position (N, 3) m of a point at `lever_arm_b` (3,) m from the IMU."""
        return np.asarray(self.position_n + self.R_nb @ lever_arm_b)

    def antenna_velocity_n(self, lever_arm_b: Array) -> Array:
        """Velocity (N, 3) m/s of a point at `lever_arm_b` (3,) m from the IMU."""
        spin_b = np.cross(self.angular_rate_b, lever_arm_b)
        return np.asarray(self.velocity_n + np.einsum("nij,nj->ni", self.R_nb, spin_b))


@dataclass(frozen=True, eq=False)
class Truth:
    """Exact motion in n, whose origin is the track's. All times are on the session's clock, as in its files.

    control (K, CHANNELS): control points of the B-spline, every `step` s of true time from `start` on: position n (m),
    roll, pitch, unwrapped yaw (rad), engine revolutions, throttle 0..1, engine running under load 0..1.
    Velocities and rates are per true second: with a drifting clock they are what a perfect sensor reads, not the
    slope over session time. Times outside [first, last] give NaN.
    """

    origin: Origin
    control: Array
    start: float
    step: float
    clock: Clock = field(default_factory=Clock)
    _spline: Any = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if self.control.ndim != 2 or self.control.shape[1] != CHANNELS or len(self.control) <= _DEGREE:
            raise ValueError(f"control has shape {self.control.shape}, wanted (more than {_DEGREE}, {CHANNELS})")
        freeze(self, control=(None, CHANNELS))
        knots = self.start + self.step * (np.arange(len(self.control) + _DEGREE + 1) - 3.0)
        object.__setattr__(self, "_spline", BSpline(knots, self.control, _DEGREE, extrapolate=False))

    @property
    def first(self) -> float:
        """First session time that has a truth, s."""
        return float(self.clock.to_session(np.asarray(self.start + 2.0 * self.step)))

    @property
    def last(self) -> float:
        """Last session time that has a truth, s."""
        return float(self.clock.to_session(np.asarray(self.start + (len(self.control) - 3.0) * self.step)))

    def at(self, t: Array) -> TruthStates:
        """States of the IMU at session times t (N,) s."""
        values, rates, seconds = (self._evaluate(t, derivative) for derivative in range(3))
        roll, pitch, yaw = values[:, _EULER].T
        euler = values[:, _EULER]
        return TruthStates(
            t=np.asarray(t, dtype=np.float64),
            position_n=values[:, _POSITION],
            velocity_n=rates[:, _POSITION],
            acceleration_n=seconds[:, _POSITION],
            R_nb=rotation_from_euler(roll, pitch, yaw),
            angular_rate_b=_rate(euler, rates[:, _EULER]),
            angular_acceleration_b=_angular_acceleration(euler, rates[:, _EULER], seconds[:, _EULER]),
        )

    def euler(self, t: Array) -> Array:
        """Roll, pitch and yaw of the kart, (N, 3) rad, yaw unwrapped."""
        return np.asarray(self._evaluate(t, 0)[:, _EULER])

    def specific_force_b(self, t: Array) -> Array:
        """What an ideal accelerometer at the IMU reads, (N, 3) m/s^2."""
        return self.at(t).specific_force_b

    def antenna_position_n(self, t: Array, lever_arm_b: Array) -> Array:
        """Position (N, 3) m in n of the antenna at `lever_arm_b` (3,) m from the IMU."""
        values = self._evaluate(t, 0)
        return np.asarray(values[:, _POSITION] + rotation_from_euler(*values[:, _EULER].T) @ lever_arm_b)

    def antenna_velocity_n(self, t: Array, lever_arm_b: Array) -> Array:
        """Velocity (N, 3) m/s in n of the antenna at `lever_arm_b` (3,) m from the IMU."""
        return self.at(t).antenna_velocity_n(lever_arm_b)

    def antenna_geodetic(self, t: Array, lever_arm_b: Array) -> tuple[Array, Array, Array]:
        """Latitude, longitude (deg) and height (m) of the antenna, each (N,)."""
        return nwu_to_geodetic(self.antenna_position_n(t, lever_arm_b), self.origin)

    def trajectory(self, t: Array, lever_arm_b: Array, origin: Origin | None = None) -> Trajectory:
        """Truth at t (N,) as a Trajectory of the antenna, in the n of `origin` (the track's if None)."""
        states = self.at(t)
        position_n, velocity_n = states.antenna_position_n(lever_arm_b), states.antenna_velocity_n(lever_arm_b)
        R_nb = states.R_nb
        if origin is not None:
            position_n = geodetic_to_nwu(*nwu_to_geodetic(position_n, self.origin), origin)
            turn = _axes_e(origin).T @ _axes_e(self.origin)  # the Earth is round: 1e-4 rad for 1 km
            velocity_n, R_nb = velocity_n @ turn.T, turn @ R_nb
        acceleration_b = np.einsum("nji,nj->ni", states.R_nb, states.acceleration_n)
        return Trajectory(states.t, position_n, velocity_n, R_nb, acceleration_b, states.angular_rate_b)

    def engine_revolutions(self, t: Array) -> Array:
        """Revolutions of the crankshaft since some time before the start, (N,)."""
        return np.asarray(self._evaluate(t, 0)[:, _REVOLUTIONS])

    def engine_rpm(self, t: Array) -> Array:
        """Engine speed, (N,) revolutions per minute."""
        return np.asarray(60.0 * self._evaluate(t, 1)[:, _REVOLUTIONS])

    def throttle(self, t: Array) -> Array:
        """Throttle, (N,) 0..1."""
        return np.asarray(self._evaluate(t, 0)[:, _THROTTLE])

    def running(self, t: Array) -> Array:
        """How much the engine shakes the kart, (N,): 0 standing, 1 driving."""
        return np.asarray(self._evaluate(t, 0)[:, _RUNNING])

    def crossings(self, line: Array, lever_arm_b: Array | None = None) -> Array:
        """Session times (K,) s at which the antenna (without lever arm: the IMU) crosses `line` forwards.

        line : (2, 2) m, north and west in n of its left and right end as the driver sees it. Exact to a microsecond:
        bisection of the analytic path.
        """
        arm = np.zeros(3) if lever_arm_b is None else np.asarray(lever_arm_b, dtype=np.float64)
        t = np.arange(self.first, self.last, 0.02)  # s; a kart does not pass a line twice within this
        along, across = self._line_coordinates(t, line, arm)
        hit = (along[:-1] < 0.0) & (along[1:] >= 0.0) & (np.abs(across[:-1]) < 2.0)
        low, high = t[:-1][hit], t[1:][hit]
        for _ in range(40):  # 0.02 s / 2^40: below the resolution of a float64 time
            middle = 0.5 * (low + high)
            before = self._line_coordinates(middle, line, arm)[0] < 0.0
            low, high = np.where(before, middle, low), np.where(before, high, middle)
        crossing = 0.5 * (low + high)
        across = self._line_coordinates(crossing, line, arm)[1]
        return np.asarray(crossing[np.abs(across) <= 1.0])

    def _line_coordinates(self, t: Array, line: Array, arm: Array) -> tuple[Array, Array]:
        """Distance (m) past the line and place across it (-1 left end .. 1 right end), each (N,)."""
        left, right = np.asarray(line, dtype=np.float64)
        span = left - right
        forward = np.array([span[1], -span[0]]) / np.linalg.norm(span)  # the driver's left is 90 deg anticlockwise
        offset = self.antenna_position_n(t, arm)[:, :2] - 0.5 * (left + right)
        return np.asarray(offset @ forward), np.asarray(-2.0 * (offset @ span) / (span @ span))

    def _evaluate(self, t: Array, derivative: int) -> Array:
        return np.asarray(self._spline(self.clock.to_true(np.atleast_1d(t)), nu=derivative))


def _axes_e(origin: Origin) -> Array:
    """R_en (3, 3): north, west and up at a place, in Earth-fixed axes."""
    lat, lon = origin.lat_deg * DEG, origin.lon_deg * DEG
    up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
    west = np.array([np.sin(lon), -np.cos(lon), 0.0])
    return np.stack([np.cross(west, up), west, up], axis=1)


def _rate(euler: Array, rate: Array) -> Array:
    """Angular rate in b, (N, 3) rad/s, from Euler angles and their derivatives. Source: kinematics of Rz Ry Rx."""
    roll, pitch, _ = euler.T
    d_roll, d_pitch, d_yaw = rate.T
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    return np.stack([d_roll - d_yaw * sp, d_pitch * cr + d_yaw * cp * sr, d_yaw * cp * cr - d_pitch * sr], axis=-1)


def _angular_acceleration(euler: Array, rate: Array, second: Array) -> Array:
    """Derivative of :func:`_rate` with respect to time, (N, 3) rad/s^2."""
    roll, pitch, _ = euler.T
    d_roll, d_pitch, d_yaw = rate.T
    sr, cr, sp, cp = np.sin(roll), np.cos(roll), np.sin(pitch), np.cos(pitch)
    convective = [
        -d_yaw * d_pitch * cp,
        -d_pitch * d_roll * sr - d_yaw * d_pitch * sp * sr + d_yaw * d_roll * cp * cr,
        -d_pitch * d_roll * cr - d_yaw * d_pitch * sp * cr - d_yaw * d_roll * cp * sr,
    ]
    return np.asarray(_rate(euler, second) + np.stack(convective, axis=-1))
