"""A kart stays upright and points along its path: what holds attitudes where the gyroscope can not.

A gyroscope that engine and steering wheel shake by tens of deg/s, sampled too slowly for that, loses the attitude by
degrees within a tenth of a second. Gravity and accelerations would have to tell it ten times a second, and are then
turned to suit the fixes whatever the delay: delay and arm go with the noise of the turn rate, far beyond their sigmas.
A kart itself leans and slips by a few degrees. So roll, pitch and slip beyond what goes with acceleration are a random
walk of WANDER, much slower than such a gyroscope's and quicker than any kart's. Only their changes are asked for: how
the box lies in the kart, and where the nose is, remain what they are.

Gyroscopes that tell more than this are believed alone: up to STEADY nothing is asked, from UNSTEADY on all of it.
"""

import math

import numpy as np

from smoother import so3
from smoother.arrays import Array
from smoother.estimate.graph.rows import Rows, empty_jacobians
from smoother.estimate.graph.slip import Slip
from smoother.estimate.graph.state import KEYFRAME_SIZE, ROTATION, SLIP, ChainState
from smoother.units import DEG

# rad/s/sqrt(Hz) of the rates about the motion: harsh simulated karts and real ones on the wheel have 2.4 to 3.2 deg/s,
# slow ones whose nose hardly shows, so that a slip would only hold it where it began, up to 4.3
STEADY, UNSTEADY = 5.0 * DEG, 8.0 * DEG
# rad/sqrt(s): leaning, kerbs and slides of karts, some degrees within a second or two
WANDER = 3.0 * DEG


def unsteadiness(gyro: float) -> float:
    """Share, 0 to 1, in which a kart's own steadiness is asked for where rates have the density `gyro`, rad/s/sqrt(Hz).

    By and by, lest sessions that are nearly alike have two kinds of solution.
    """
    return float(np.clip(math.log(max(gyro, 1e-12) / STEADY) / math.log(UNSTEADY / STEADY), 0.0, 1.0))


def upright_rows(state: ChainState, slip: Slip, share: float) -> Rows:
    """Rows of how far the kart leans ahead and to the left beside the keyframe before, rad, at speed.

    share, more than 0, as of :func:`unsteadiness`, of the information.
    """
    up_s, axes = state.R_ns[:, 2, :], state.constants.level_axes_s[:2]
    by_keyframe = np.zeros((len(up_s), 2, KEYFRAME_SIZE))
    for i, axis_s in enumerate(axes):
        by_keyframe[:, i, ROTATION] = -up_s @ so3.skew(axis_s)
    return _walk("upright", slip, up_s @ axes.T, by_keyframe, None, state.interval, share)


def along_path_rows(state: ChainState, slip: Slip, share: float) -> Rows:
    """Rows of how far slip beyond what goes with acceleration is from that of the keyframe before, rad, at speed."""
    level = slip.level[:, None]
    value, by_keyframe = slip.value[:, None] * level, (slip.by_keyframe * level)[:, None]
    return _walk("along_path", slip, value, by_keyframe, (slip.by_constants * level)[:, None], state.interval, share)


def _walk(
    name: str, slip: Slip, value: Array, by_keyframe: Array, by_slip: Array | None, interval: float, share: float
) -> Rows:
    """Rows of a random walk of value (K, r) rad; Jacobians by_keyframe (K, r, 18), by_slip (K, r, 4) or none."""
    k = slip.first_of_two
    left, right, constants = empty_jacobians(len(k), value.shape[1])
    left[:], right[:] = -by_keyframe[k], by_keyframe[k + 1]
    if by_slip is not None:
        constants[:, :, SLIP] = by_slip[k + 1] - by_slip[k]
    step = value[k + 1] - value[k]
    sigma = np.full_like(step, WANDER * math.sqrt(interval / share))
    return Rows(name, k, step, sigma, left, right, constants, np.ones(len(k)))
