"""Where the antenna is beside the IMU: the lever arm in n, on the frame of the kart or with the box on the wheel."""

import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.rows import Between
from smoother.estimate.model.state import State

HEADED = 2.0  # m/s; below, the course is that between the times at which the kart last and next was faster


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


def course_of(state: State) -> Array:
    """Course (K,) rad of the keyframes, anticlockwise from north, continuous."""
    velocity_n = state.velocity_n
    fast = np.flatnonzero(np.hypot(velocity_n[:, 0], velocity_n[:, 1]) > HEADED)
    if not len(fast):
        return np.zeros(len(velocity_n))
    course = np.unwrap(np.arctan2(velocity_n[fast, 1], velocity_n[fast, 0]))
    return np.asarray(np.interp(np.arange(len(velocity_n)), fast, course))
