"""Conversion of rows to GTSAM factors: linear ones for the batch loop, CustomFactor for small graphs.

In the linear system a keyframe is one block of 18 columns, in the order of its tangent, and the constants that are
solved for are one more: GTSAM eliminates few large blocks in half the time of many small ones.
"""

from collections.abc import Callable, Iterator, Sequence

import gtsam
import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import (
    COLUMNS,
    CONSTANTS,
    DIMENSIONS,
    KEYFRAME_SIZE,
    KEYS,
    SIZES,
    State,
    keyframe_keys,
)

AT_ONCE = 128  # intervals
CONSTANTS_BLOCK = gtsam.symbol("c", len(CONSTANTS))


def block(k: int) -> int:
    """Key of keyframe k in the linear system."""
    return gtsam.symbol("k", k)


def linear_factors(rows: Sequence[Rows], intervals: int, unknown: Sequence[str]) -> gtsam.GaussianFactorGraph:
    """One linear factor of GTSAM an interval, of all rows of it, which are in the order of the intervals.

    unknown: names of the constants that are solved for. (In Python a GaussianConditional is the cheapest way to
    pass a Jacobian to GTSAM: one array that is copied once.)
    """
    (_, size), own = places(unknown), rows[0].left.shape[2]
    graph, sizes = gtsam.GaussianFactorGraph(), [own, own, *([size] if size else []), 1]
    blocks = [block(k) for k in range(intervals + 1)]
    for k, A in by_interval(rows, 0, intervals, unknown):
        keys = [blocks[k], blocks[k + 1], CONSTANTS_BLOCK][: len(sizes) - 1]
        graph.push_back(gtsam.GaussianConditional(keys, 1, gtsam.VerticalBlockMatrix(sizes, A)))
    return graph


def by_interval(rows: Sequence[Rows], begin: int, end: int, unknown: Sequence[str]) -> Iterator[tuple[int, Array]]:
    """The intervals from `begin` to `end`, exclusive, each with all its rows whitened: both keyframes, the constants
    `unknown` and the right-hand side. A few intervals at a time stay in the processor's cache.
    """
    (starts, size), own = places(unknown), rows[0].left.shape[2]
    starts, width = {name: 2 * own + k for name, k in starts.items()}, 2 * own + size + 1
    for first in range(begin, end, AT_ONCE):
        last = min(first + AT_ONCE, end)
        some = [r.take(slice(*np.searchsorted(r.interval, (first, last)))) for r in rows]
        interval = np.concatenate([np.repeat(r.interval, r.residual.shape[1]) for r in some])
        order = np.argsort(interval, kind="stable")
        A = np.concatenate([r.whitened(starts, width) for r in some])[order]
        bounds = np.searchsorted(interval[order], np.arange(first, last + 1)).tolist()
        for k, start, stop in zip(range(first, last), bounds[:-1], bounds[1:], strict=True):
            yield k, A[start:stop]


def places(unknown: Sequence[str]) -> tuple[dict[str, int], int]:
    """First columns of constants in their block, and its size."""
    ends = np.cumsum([0, *(SIZES[name] for name in unknown)]).tolist()
    return dict(zip(unknown, ends, strict=False)), ends[-1]


def columns_of(unknown: Sequence[str]) -> IntArray:
    """Columns of constants among those of all, in the order of their block."""
    return np.concatenate([np.arange(0), *(np.arange(COLUMNS[name].start, COLUMNS[name].stop) for name in unknown)])


def put_in_blocks(factor: gtsam.GaussianFactor, unknown: Sequence[str], system: gtsam.GaussianFactorGraph) -> None:
    """Add a linear factor of GTSAM's own, as of a prior, to the system of blocks. Held constants have no column."""
    keys, (A, b), end = factor.keys(), factor.jacobian(), 0
    starts, size = places(unknown)
    blocks: dict[int, Array] = {}
    for key in keys:
        if key in _OF_CONSTANTS:
            name = _OF_CONSTANTS[key]
            own, start, width, length = CONSTANTS_BLOCK, starts.get(name), SIZES[name], size
        else:
            k = gtsam.Symbol(key).index()
            i = keyframe_keys(k).index(key)
            own, start, width, length = block(k), _STARTS[i], DIMENSIONS[i], KEYFRAME_SIZE
        end += width
        if start is not None:
            wide = blocks.setdefault(own, np.zeros((len(b), length)))
            wide[:, start : start + width] = A[:, end - width : end]
    if blocks:
        sizes, Ab = [*(wide.shape[1] for wide in blocks.values()), 1], np.column_stack([*blocks.values(), b])
        system.push_back(gtsam.GaussianConditional(list(blocks), 1, gtsam.VerticalBlockMatrix(sizes, Ab)))


_OF_CONSTANTS = {key: name for name, key in KEYS.items()}
_STARTS = np.cumsum([0, *DIMENSIONS]).tolist()


def custom_factors(build: Callable[[State], Rows], state: State) -> list[gtsam.CustomFactor]:
    """The same rows as gtsam.CustomFactor, one each, for GTSAM's own optimizers on small graphs.

    build: a factor's rows at a state; state: has the keyframes, and defines the robust weights. A callback
    copies all values of the graph, so that the cost grows with the square of its length.
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
        sigma = rows.sigma[i][known] / np.sqrt(rows.weight[i])
        return gtsam.CustomFactor(gtsam.noiseModel.Diagonal.Sigmas(sigma), keys, error)

    return [factor(i) for i in range(len(rows.interval)) if np.any(np.isfinite(rows.sigma[i]))]
