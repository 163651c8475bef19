"""How rows become factors of GTSAM: linear ones for the batch loop, CustomFactor for small graphs."""

from collections.abc import Callable, Sequence
from itertools import pairwise

import gtsam
import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import (
    CONSTANTS,
    CONSTANTS_SIZE,
    DIMENSIONS,
    KEYFRAME_SIZE,
    KEYS,
    State,
    keyframe_keys,
)

BLOCKS = [*DIMENSIONS, *DIMENSIONS, *(c.size for c in CONSTANTS), 1]
WIDTH = 2 * KEYFRAME_SIZE + CONSTANTS_SIZE + 1


def linear_factors(rows: Sequence[Rows], imu: Array) -> gtsam.GaussianFactorGraph:
    """One linear factor of GTSAM an interval, of all its rows; imu (K-1, 15, WIDTH) of factors/imu.py.

    All of them have the same keys, so that all cliques of the chain look alike. (In Python gtsam.JacobianFactor takes
    three keys at most; a GaussianConditional is one, and takes any number.)
    """
    interval = np.concatenate([np.repeat(np.arange(len(imu)), imu.shape[1])] + [_repeated(r) for r in rows])
    order = np.argsort(interval, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    A = np.zeros((len(order), WIDTH))
    begin = imu.shape[0] * imu.shape[1]
    A[place[:begin]] = imu.reshape(-1, WIDTH)
    for r in rows:
        n = r.residual.size
        r.put_whitened(A, place[begin : begin + n])
        begin += n
    bounds = np.searchsorted(interval[order], np.arange(len(imu) + 1)).tolist()
    graph, of_constants = gtsam.GaussianFactorGraph(), list(KEYS.values())
    for k, (begin, end) in enumerate(pairwise(bounds)):
        keys = [*keyframe_keys(k), *keyframe_keys(k + 1), *of_constants]
        graph.push_back(gtsam.GaussianConditional(keys, 1, gtsam.VerticalBlockMatrix(BLOCKS, A[begin:end])))
    return graph


def _repeated(rows: Rows) -> Array:
    return np.repeat(rows.interval, rows.residual.shape[1])


def custom_factors(build: Callable[[State], Rows], state: State) -> list[gtsam.CustomFactor]:
    """The same rows as gtsam.CustomFactor, one each, for GTSAM's own optimizers on small graphs.

    build: a factor's rows at a state; state: one that has the keyframes. A callback copies all values of the graph, so
    that the cost grows with the square of its length.
    """
    rows, columns = build(state), np.cumsum([0, *DIMENSIONS])
    names = list(rows.constants)

    def factor(i: int) -> gtsam.CustomFactor:
        k = int(rows.interval[i])
        known = np.isfinite(rows.sigma[i])

        def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            at = build(state.with_values(values))
            if jacobians is not None:
                sides = [(J[i], start) for J in (at.left, at.right) for start in range(len(DIMENSIONS))]
                for j, (J, b) in enumerate(sides):
                    jacobians[j] = np.asfortranarray(J[known, columns[b] : columns[b + 1]])
                for j, name in enumerate(names, len(sides)):
                    jacobians[j] = np.asfortranarray(at.constants[name][i][known])
            return np.asarray(at.residual[i][known])

        keys = [*keyframe_keys(k), *keyframe_keys(k + 1), *(KEYS[name] for name in names)]
        return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(rows.sigma[i][known]), keys, error)

    return [factor(i) for i in range(len(rows.interval)) if np.any(np.isfinite(rows.sigma[i]))]
