"""Attitude of a logger at rest: roll and pitch from gravity, yaw from the magnetometer (thesis, eq. 2.17-2.32).

Errata of the thesis, each checked by a test:

    eq.   printed                                     right, and used here
    2.11  R_y with -sin in the upper right corner     its transpose, +sin there
    2.17  R_z(psi) R_z(theta) R_x(phi)                R_z(psi) R_y(theta) R_x(phi), of which 2.18 is the product
    2.28  west component +cos(dip) sin(declination)   minus that, declination being positive towards east
    2.32  yaw = atan2(..)                             minus that, and minus the declination

Signs: `R_ns = Rz(yaw) Ry(pitch) Rx(roll)`, yaw anticlockwise from north; at rest the specific force points up.
"""

import numpy as np

from smoother.arrays import Array
from smoother.fit.ellipsoid import FitError
from smoother.frames import rotation_from_euler, wrap_angle


def level_angles(specific_force: Array) -> tuple[float, float]:
    """Roll and pitch (rad) of axes in which the mean specific force at rest is (3,). Eq. 2.26, 2.27.

    Raises FitError when the force is zero or not finite, because then nothing says where up is.
    """
    force = np.asarray(specific_force, dtype=np.float64)
    if not np.all(np.isfinite(force)) or not np.any(force):
        raise FitError("the mean specific force is zero or not a number, so nothing says where up is")
    x, y, z = force
    return float(np.arctan2(y, z)), float(np.arctan2(-x, np.hypot(y, z)))


def levelled(specific_force: Array) -> Array:
    """Rotation (3, 3) from sensor axes to level ones with the same heading, `Ry(pitch) Rx(roll)`. Raises FitError."""
    roll, pitch = level_angles(specific_force)
    return rotation_from_euler(np.asarray(roll), np.asarray(pitch), np.asarray(0.0))


def yaw_from_field(field: Array, specific_force: Array, declination: float = 0.0) -> float:
    """Yaw (rad, anticlockwise from true north) of axes in which the field is (3,) and the force at rest (3,).

    `field` is calibrated, of any length; `declination` in rad, positive towards east. Eq. 2.32 with its sign mended.
    Raises FitError when the field has no horizontal part.
    """
    level = levelled(specific_force) @ np.asarray(field, dtype=np.float64)
    if not np.all(np.isfinite(level)) or np.hypot(level[0], level[1]) <= 1e-9 * np.linalg.norm(level):
        raise FitError("the magnetic field has no horizontal part, so nothing says where north is")
    # Level axes see the field at the angle atan2(west, north) = -declination - yaw.
    return float(wrap_angle(-declination - np.arctan2(level[1], level[0])))
