"""How rows become factors of GTSAM: linear ones for the batch loop, CustomFactor for small graphs.

In the linear system a keyframe is one block of 18 columns, in the order of its tangent, and the constants that are
solved for are one more: GTSAM eliminates few large blocks in half the time of many small ones.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import gtsam
import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import (
    COLUMNS,
    CONSTANTS,
    CONSTANTS_SIZE,
    DIMENSIONS,
    KEYFRAME_SIZE,
    KEYS,
    State,
    keyframe_keys,
)

WIDTH = 2 * KEYFRAME_SIZE + CONSTANTS_SIZE + 1
CONSTANTS_BLOCK = gtsam.symbol("c", len(CONSTANTS))


def block(k: int) -> int:
    """Key of keyframe k in the linear system."""
    return gtsam.symbol("k", k)


def linear_factors(rows: Sequence[Rows], imu: Array, free: IntArray) -> gtsam.GaussianFactorGraph:
    """One linear factor of GTSAM an interval, of all its rows; imu (K-1, 15, WIDTH) of factors/imu.py.

    free: columns of the constants that are solved for. (In Python a GaussianConditional is the cheapest way to hand
    GTSAM a Jacobian factor: one array that is copied once.)
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
    if len(free) < CONSTANTS_SIZE:
        A = A[:, np.concatenate([np.arange(2 * KEYFRAME_SIZE), 2 * KEYFRAME_SIZE + free, [WIDTH - 1]])]
    bounds = np.searchsorted(interval[order], np.arange(len(imu) + 1)).tolist()
    graph, sizes = gtsam.GaussianFactorGraph(), [KEYFRAME_SIZE, KEYFRAME_SIZE, len(free), 1]
    for k, (begin, end) in enumerate(pairwise(bounds)):
        keys = [block(k), block(k + 1), CONSTANTS_BLOCK]
        graph.push_back(gtsam.GaussianConditional(keys, 1, gtsam.VerticalBlockMatrix(sizes, A[begin:end])))
    return graph


def put_in_blocks(factor: gtsam.JacobianFactor, free: IntArray, system: gtsam.GaussianFactorGraph) -> None:
    """Add a linear factor of one variable, as GTSAM makes of a prior, to the system of blocks."""
    (key,) = factor.keys()
    A, b = factor.jacobian()
    if key in _OF_CONSTANTS:
        wide = np.zeros((len(b), CONSTANTS_SIZE))
        wide[:, COLUMNS[_OF_CONSTANTS[key]]] = A
        if np.any(wide[:, free]):
            system.add(CONSTANTS_BLOCK, wide[:, free], b, gtsam.noiseModel.Unit.Create(len(b)))
        return
    k = gtsam.Symbol(key).index()
    start = _STARTS[keyframe_keys(k).index(key)]
    wide = np.zeros((len(b), KEYFRAME_SIZE))
    wide[:, start : start + A.shape[1]] = A
    system.add(block(k), wide, b, gtsam.noiseModel.Unit.Create(len(b)))


_OF_CONSTANTS = {key: name for name, key in KEYS.items()}
_STARTS = np.cumsum([0, *DIMENSIONS]).tolist()


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
