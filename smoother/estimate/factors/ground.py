"""Level ground, where no fix has a height."""

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.rows import Rows, no_jacobian, rows_of
from smoother.estimate.model.state import OFFSET, TRANSLATION, State

FAR_FROM_HEIGHT = 20.0  # s; for so long the samples alone carry a height
HEIGHTS_AROUND = np.arange(-2, 3)  # whose median is the nearest height: one of them may be wild
LEVEL_GROUND = 2.0  # m/sqrt(Hz); much less than tracks are level to, since heights are near one another for seconds


def ground_rows(state: State, at: IntArray, height: Array) -> Rows:
    """Residual: height of the keyframes `at` (N,) beside the slow error upwards and `height` (N,), m in n.

    The samples alone would let the height run away by kilometres. The slow error stands for the hills.
    """
    left, right = no_jacobian(len(at), 1)
    left[:, 0, TRANSLATION], left[:, 0, OFFSET.start + 2] = state.R_ns[at, 2, :], 1.0
    residual = (state.position_n[at, 2] + state.offset_n[at, 2] - height)[:, None]
    return rows_of("ground", at, residual, LEVEL_GROUND / np.sqrt(state.interval), left, right)


def far_from_heights(heights: Array, t: Array) -> tuple[IntArray, Array]:
    """Keyframes of t (K,) s, but the last, that are far from any of the heights (H, 2), and the nearest one (n,) m.

    That of the origin where there is none at all.
    """
    if not len(heights):
        return np.arange(len(t) - 1), np.zeros(len(t) - 1)
    times = heights[:, 0]
    after = np.clip(np.searchsorted(times, t[:-1]), 0, len(times) - 1)
    before = np.maximum(after - 1, 0)
    near = np.where(np.abs(times[after] - t[:-1]) < np.abs(times[before] - t[:-1]), after, before)
    far = np.flatnonzero(np.abs(times[near] - t[:-1]) > FAR_FROM_HEIGHT)
    around = np.clip(near[far, None] + HEIGHTS_AROUND, 0, len(times) - 1)
    return far, np.median(heights[around, 1], axis=1)
