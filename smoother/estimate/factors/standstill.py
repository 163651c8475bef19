"""A kart at rest: no velocity, and no turn to the next keyframe."""

import numpy as np

from smoother import so3
from smoother.arrays import IntArray
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.state import ROTATION, VELOCITY, State

SPEED = 0.02  # m/s; a chassis on its tyres with the engine idling
TURN = 3e-4  # rad between keyframes, likewise


def standstill_rows(state: State, interval: IntArray) -> Rows:
    """Residual: velocity of the left keyframe, m/s, and turn to the right one, rad, of the intervals (N,) at rest."""
    turn = state.R_ns[interval].transpose(0, 2, 1) @ state.R_ns[interval + 1]
    left, right = no_jacobian(len(interval), 6)
    left[:, 0:3, VELOCITY] = np.eye(3)
    left[:, 3:6, ROTATION], right[:, 3:6, ROTATION] = -turn.transpose(0, 2, 1), np.eye(3)
    residual = np.concatenate([state.velocity_n[interval], so3.log(turn)], axis=1)
    return rows_of("standstill", interval, residual, np.repeat([SPEED, TURN], 3), left, right)
