"""Where the antenna is beside the IMU: the lever arm in n, on the frame of the kart or with the box on the wheel."""

import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.rows import Between
from smoother.estimate.model.motion import course_of


def arm_axes(between: Between) -> Array:
    """Rotations (N, 3, 3) that take the lever arm from s to n.

    With a box on the steering wheel the arm keeps to the course of the path: an arm that turned with the wheel would
    swing the antenna by decimetres that are not there.
    """
    geometry = between.state.geometry
    if not geometry.is_steered:
        return between.R_ns
    course = between.linear(course_of(between.state)[:, None])[:, 0]
    R_nb = np.zeros((len(course), 3, 3))
    R_nb[:, 0, 0] = R_nb[:, 1, 1] = np.cos(course)
    R_nb[:, 1, 0] = np.sin(course)
    R_nb[:, 0, 1] = -R_nb[:, 1, 0]
    R_nb[:, 2, 2] = 1.0
    return np.asarray(R_nb @ geometry.level_axes_s)
