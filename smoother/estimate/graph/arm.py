"""Which way the arm from the box to the antenna points: with the box, or with the kart where the box is on the wheel.

On a frame the arm has one direction in the box's axes. A box on the steering wheel turns by tens of degrees beside the
kart that the antenna stays with: an arm that turned along would swing an antenna half a metre away by decimetres. The
fixes do not show that, so that the arm would be found to be short, and what it does to velocities in bends, as a delay
does, would be looked for in the delays. There the arm keeps to the course of the path: the nose is beside that by the
slip, some degrees. An antenna in the box itself has no arm either way.
"""

import numpy as np

from smoother.arrays import Array
from smoother.estimate.graph.state import ChainState, Constants
from smoother.estimate.model.imu import DensePath

HEADED = 2.0  # m/s; below, the course is that between the times at which the kart last and next was faster


def arm_axes(state: ChainState) -> Array:
    """Rotations (K, 3, 3) that take the arm to n at the keyframes."""
    if not state.constants.is_steered:
        return state.R_ns
    return _along(course(state.velocity_n), state.constants)


def turning_arm(state: ChainState) -> Array:
    """Rotations (K, 3, 3) by which errors of the box's attitude turn the arm at the keyframes; zero where none does."""
    return np.zeros_like(state.R_ns) if state.constants.is_steered else state.R_ns


def arm_axes_along(path: DensePath, constants: Constants) -> Array:
    """Rotations (M, 3, 3) that take the arm to n at the edges of a path."""
    return path.R_ns if not constants.is_steered else _along(course(path.velocity_n), constants)


def arm_axes_at(path: DensePath, constants: Constants, t: Array, R_ns: Array) -> Array:
    """Rotations (N, 3, 3) that take the arm to n at t (N,) s, where the box has the attitude R_ns (N, 3, 3)."""
    return R_ns if not constants.is_steered else _along(np.interp(t, path.t, course(path.velocity_n)), constants)


def course(velocity_n: Array) -> Array:
    """Direction of travel (N,) rad, anticlockwise from north and without leaps, of velocities (N, 3) in order."""
    fast = np.flatnonzero(np.hypot(velocity_n[:, 0], velocity_n[:, 1]) > HEADED)
    if not len(fast):
        return np.zeros(len(velocity_n))
    headed = np.unwrap(np.arctan2(velocity_n[fast, 1], velocity_n[fast, 0]))
    return np.asarray(np.interp(np.arange(len(velocity_n)), fast, headed))


def _along(headed: Array, constants: Constants) -> Array:
    """Rotations (N, 3, 3) from s, as the box stands while the wheel is straight, to n on a course of `headed` (N,)."""
    R_nb = np.zeros((len(headed), 3, 3))
    R_nb[:, 0, 0] = R_nb[:, 1, 1] = np.cos(headed)
    R_nb[:, 1, 0] = np.sin(headed)
    R_nb[:, 0, 1] = -R_nb[:, 1, 0]
    R_nb[:, 2, 2] = 1.0
    return np.asarray(R_nb @ constants.level_axes_s)
