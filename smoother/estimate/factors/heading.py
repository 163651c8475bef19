"""Heading of the magnetic field. It turns the kart about up alone: a disturbed field never tilts it."""

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.state import ROTATION, State
from smoother.frames import wrap_angle


def heading_rows(
    state: State, interval: IntArray, field_s: Array, field_yaw: float, sigma: float | Array, has_offset: bool
) -> Rows:
    """Residual: yaw of the field R field_s beside field_yaw and the heading offset, rad.

    At the left keyframes of the intervals (N,): corrected field_s (N, 3), any unit; field_yaw rad in n; sigma rad, one
    or (N,). has_offset: the readings have an unknown heading offset.
    """
    field_n = np.einsum("nij,nj->ni", state.R_ns[interval], field_s)
    offset = state.constant("heading_offset") if has_offset else 0.0
    residual = wrap_angle(np.arctan2(field_n[:, 1], field_n[:, 0]) - field_yaw - offset)[:, None]
    left, right = no_jacobian(len(interval), 1)
    left[:, 0, ROTATION] = state.R_ns[interval][:, 2, :]
    constants = {"heading_offset": np.full((len(interval), 1, 1), -1.0)} if has_offset else {}
    return rows_of("heading", interval, residual, np.reshape(sigma, (-1, 1)), left, right, constants)
