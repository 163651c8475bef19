"""Frames, units and angles of this project, stated once, and every conversion between them.

Frames
    n   navigation: North-West-Up, fixed to the Earth at the session's origin. The Earth's rotation (15 deg/h) lies
        below the bias of the sensors and is not modelled.
    b   body: Forward-Left-Up of the kart, at the IMU.
    s   axes of one sensor as it was mounted in the logger. `R_bs` takes s to b; it is a constant of the session, and as
        long as it is unknown everything is estimated in s and turned into b at the end.
    e   Earth-fixed (WGS-84).

Letters
    `v_n` is a vector resolved in n, `R_nb` takes b to n: `v_n = R_nb @ v_b`. Inner letters cancel: `R_nb @ R_bs`.
    Level and at rest, `specific_force_b = (0, 0, +g)`; gravity is `(0, 0, -g)` in n.

Angles
    `R_nb = Rz(yaw) Ry(pitch) Rx(roll)`. Yaw is anticlockwise from north in (-pi, pi]; course is clockwise from north,
    so `yaw = -course`. With forward-left-up axes pitch is positive nose down, roll positive right side down.

Units are SI and radians; names with another unit carry it as a suffix.
"""

from dataclasses import dataclass

import numpy as np
import pymap3d

from smoother.arrays import Array
from smoother.units import DEG, STANDARD_GRAVITY

GRAVITY_N = np.array([0.0, 0.0, -STANDARD_GRAVITY])
GRAVITY_N.flags.writeable = False
UP_N = np.array([0.0, 0.0, 1.0])
UP_N.flags.writeable = False


@dataclass(frozen=True)
class Origin:
    """Geodetic position (WGS-84) of the origin of n: latitude and longitude in degrees, height in metres."""

    lat_deg: float
    lon_deg: float
    alt_m: float


def geodetic_to_nwu(lat_deg: Array, lon_deg: Array, alt_m: Array, origin: Origin) -> Array:
    """Position in n of geodetic positions. Each input (N,), degrees and metres. Returns (N, 3) m."""
    north, east, down = pymap3d.geodetic2ned(lat_deg, lon_deg, alt_m, origin.lat_deg, origin.lon_deg, origin.alt_m)
    return np.stack([north, -np.asarray(east), -np.asarray(down)], axis=-1)


def nwu_to_geodetic(position_n: Array, origin: Origin) -> tuple[Array, Array, Array]:
    """Latitude, longitude (deg) and height (m), each (N,), of positions in n : (N, 3) m."""
    lat, lon, alt = pymap3d.ned2geodetic(
        position_n[..., 0], -position_n[..., 1], -position_n[..., 2], origin.lat_deg, origin.lon_deg, origin.alt_m
    )
    return np.asarray(lat), np.asarray(lon), np.asarray(alt)


def velocity_n_from_course(speed: Array, course_deg: Array) -> Array:
    """Horizontal velocity (N, 3) m/s in n, Up NaN because a course does not say it. speed (N,) m/s, course_deg (N,)."""
    yaw = -np.asarray(course_deg) * DEG  # course turns clockwise from north, yaw about Up does not
    return np.stack([speed * np.cos(yaw), speed * np.sin(yaw), np.full(np.shape(yaw), np.nan)], axis=-1)


def to_left(forward: Array, vector_n: Array) -> Array:
    """Level component (...) of vectors in n to the left of `forward`, times its level length; both (..., 2 or 3)."""
    return np.asarray(forward[..., 0] * vector_n[..., 1] - forward[..., 1] * vector_n[..., 0])


def wrap_angle(angle: Array) -> Array:
    """Angle in (-pi, pi] rad."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle), 2.0 * np.pi))


def rotation_from_euler(roll: Array, pitch: Array, yaw: Array) -> Array:
    """R_nb = Rz(yaw) Ry(pitch) Rx(roll), each (...,) rad. Returns (..., 3, 3)."""
    cr, sr, cp, sp, cy, sy = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch), np.cos(yaw), np.sin(yaw)
    rows = [
        [cp * cy, sr * sp * cy - cr * sy, cr * sp * cy + sr * sy],
        [cp * sy, sr * sp * sy + cr * cy, cr * sp * sy - sr * cy],
        [-sp, sr * cp, cr * cp],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def euler_from_rotation(R_nb: Array) -> tuple[Array, Array, Array]:
    """Roll, pitch, yaw (rad), each (...,), of R_nb : (..., 3, 3); roll is zero by choice at pitch = +-90 deg."""
    R = np.asarray(R_nb, dtype=np.float64)
    pitch = np.arcsin(np.clip(-R[..., 2, 0], -1.0, 1.0))
    vertical = np.abs(R[..., 2, 0]) > 1.0 - 1e-12
    roll = np.where(vertical, 0.0, np.arctan2(R[..., 2, 1], R[..., 2, 2]))
    yaw = np.where(vertical, np.arctan2(-R[..., 0, 1], R[..., 1, 1]), np.arctan2(R[..., 1, 0], R[..., 0, 0]))
    return roll, pitch, wrap_angle(yaw)


def euler_jacobian(R_nb: Array) -> Array:
    """Derivative of (roll, pitch, yaw) with respect to a rotation vector in b, `R_nb @ exp(w)`. Returns (..., 3, 3).

    Source: kinematics of Rz Ry Rx. Singular at pitch = +-90 deg, where the pitch is held 1e-6 rad away.
    """
    roll, pitch, _ = euler_from_rotation(R_nb)
    limit = 0.5 * np.pi - 1e-6
    pitch = np.clip(pitch, -limit, limit)
    sr, cr, tp, cp = np.sin(roll), np.cos(roll), np.tan(pitch), np.cos(pitch)
    one, zero = np.ones_like(roll), np.zeros_like(roll)
    rows = [[one, sr * tp, cr * tp], [zero, cr, -sr], [zero, sr / cp, cr / cp]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
