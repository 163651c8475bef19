"""A state of keyframes at rest where a test says nothing else."""

import numpy as np

from smoother.arrays import Array
from smoother.estimate.model.state import CONSTANTS, Geometry, State


def state_of(
    t: Array,
    R_ns: Array,
    velocity_n: Array | None = None,
    position_n: Array | None = None,
    axes_s: Array | None = None,
    *,
    is_steered: bool = False,
    **constants: Array,
) -> State:
    """A state at t (K,) s; everything that is not given is zero, level axes are those of s."""
    zeros = np.zeros((len(t), 3))
    return State(
        t,
        R_ns,
        zeros if position_n is None else position_n,
        zeros if velocity_n is None else velocity_n,
        zeros,
        zeros,
        zeros,
        {c.name: np.zeros(c.size) for c in CONSTANTS} | constants,
        Geometry(np.eye(3) if axes_s is None else axes_s, is_steered),
    )
