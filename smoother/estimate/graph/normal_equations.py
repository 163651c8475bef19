"""From rows to normal equations: rows are whitened, multiplied with themselves, and added to the system of the chain.

The functions that add change the system they are given: it is the largest thing there is, and is built up from parts.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.graph.chain import ChainSystem
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.state import KEYFRAME_SIZE, ROW_CONSTANTS_SIZE

DENSE = 0.25  # share of intervals from which on rows are added to all of them
PIECE = 128  # intervals whose products stay in the processor's cache
# columns of whitened rows: Jacobians by the keyframe on the left, on the right, by the constants; the residual
_LEFT, _RIGHT = slice(0, KEYFRAME_SIZE), slice(KEYFRAME_SIZE, 2 * KEYFRAME_SIZE)
_RESIDUAL = 2 * KEYFRAME_SIZE + ROW_CONSTANTS_SIZE
_CONSTANTS, _OWN = slice(_RIGHT.stop, _RESIDUAL), slice(0, ROW_CONSTANTS_SIZE)


def add_constants_prior(system: ChainSystem, residual: Array, sigma: Array) -> None:
    """Add a prior on all constants to the system, in place. residual (value minus mean), sigma (31,)."""
    np.einsum("ii->i", system.corner)[...] += 1.0 / sigma**2
    system.rhs_constants[...] -= residual / sigma**2


def add_rows(system: ChainSystem, rows: Sequence[Rows]) -> None:
    """Add the normal equations of `rows` to the system, in place.

    Kinds of rows that most intervals have are laid on one another, so that one matrix product an interval serves all of
    them, and whole blocks are added.
    """
    n_intervals = len(system.upper)
    layers = []
    for r in rows:
        if r.are_alike and len(r.interval) == n_intervals:
            _add_alike(system, r)
            continue
        for once in _without_repeats(r.interval):
            interval = r.interval[once]
            if len(once) > DENSE * n_intervals:
                layers.append(_Layer(r, once, interval))
            else:
                whitened = _whiten(r, once, np.empty((len(once), r.residual.shape[1], _RESIDUAL + 1)))
                _add(system, whitened, interval, interval + 1, _products(len(once)))
    if not layers:
        return
    n = min(PIECE, n_intervals)
    stack, products = np.empty((n, sum(layer.rows.residual.shape[1] for layer in layers), _RESIDUAL + 1)), _products(n)
    for first in range(0, n_intervals, PIECE):
        last = min(first + PIECE, n_intervals)
        _stack(stack, layers, first, last)
        _add(system, stack[: last - first], slice(first, last), slice(first + 1, last + 1), products)


def _add_alike(system: ChainSystem, rows: Rows) -> None:
    """Add rows of all intervals in turn that do not touch the constants, whose products are the same in all of them."""
    of_left, of_right = used_columns(rows.left), used_columns(rows.right)
    information = 1.0 / rows.sigma[0, :, None] ** 2
    left, right = rows.left[0, :, of_left], rows.right[0, :, of_right]
    system.diagonal[:-1, of_left, of_left] += left.T @ (information * left)
    system.diagonal[1:, of_right, of_right] += right.T @ (information * right)
    system.upper[:, of_left, of_right] += left.T @ (information * right)
    system.rhs[:-1, of_left] -= rows.residual @ (information * left)
    system.rhs[1:, of_right] -= rows.residual @ (information * right)


def used_columns(jacobian: Array) -> slice:
    """Columns of a Jacobian (N, r, n) that are not all zero, and those between them."""
    different = jacobian[:1] if jacobian.strides[0] == 0 else jacobian
    used = np.flatnonzero(np.any(different, axis=(0, 1)))
    return slice(int(used[0]), int(used[-1]) + 1) if used.size else slice(0, 0)


@dataclass(frozen=True, eq=False)
class _Layer:
    """Rows `once` (N,), of the intervals `interval` (N,), which rise."""

    rows: Rows
    once: IntArray
    interval: IntArray


def _stack(stack: Array, layers: Sequence[_Layer], first: int, last: int) -> None:
    """Lay the rows of the intervals first to last, exclusive, on one another, whitened; zeros where there are none."""
    begin = 0
    for layer in layers:
        part = slice(begin, begin + layer.rows.residual.shape[1])
        begin = part.stop
        some = slice(*np.searchsorted(layer.interval, [first, last]).tolist())
        at, use = layer.interval[some] - first, layer.once[some]
        if len(at) == last - first:
            _whiten(layer.rows, use, stack[: last - first, part])
        else:
            stack[:, part] = 0.0
            stack[at, part] = _whiten(layer.rows, use, np.empty((len(at), part.stop - part.start, _RESIDUAL + 1)))


def _whiten(rows: Rows, use: IntArray, out: Array) -> Array:
    """Jacobians by left, right and constants, and residual, (N, r, 52), of the rows `use` (N,), each over its sigma."""
    ordered = len(use) > 0 and use[-1] - use[0] + 1 == len(use) and bool(np.all(np.diff(use) == 1))
    chosen = slice(int(use[0]), int(use[-1]) + 1) if ordered else use  # a slice needs no copy
    share = np.sqrt(rows.weight[chosen, None] / rows.sigma[chosen] ** 2)
    for columns, jacobian in ((_LEFT, rows.left), (_RIGHT, rows.right), (_CONSTANTS, rows.constants)):
        np.multiply(jacobian[chosen], share[:, :, None], out=out[:, :, columns])
    np.multiply(rows.residual[chosen], share, out=out[:, :, _RESIDUAL])
    return out


def _products(n: int) -> tuple[Array, Array]:
    """Room for products of n intervals: of the left keyframes' columns with all, of the right ones' with the rest."""
    return np.empty((n, KEYFRAME_SIZE, _RESIDUAL + 1)), np.empty((n, KEYFRAME_SIZE, _RESIDUAL + 1 - KEYFRAME_SIZE))


def _add(
    system: ChainSystem,
    whitened: Array,
    left: IntArray | slice,
    right: IntArray | slice,
    products: tuple[Array, Array],
) -> None:
    """Add whitened rows (N, r, 52), each between one of the keyframes `left` and the next one, `right`."""
    n, others = KEYFRAME_SIZE, whitened[:, :, _RIGHT.start :]
    product = np.matmul(whitened[:, :, _LEFT].transpose(0, 2, 1), whitened, out=products[0][: len(whitened)])
    system.diagonal[left] += product[:, :, _LEFT]
    system.upper[left] += product[:, :, _RIGHT]
    system.border[left, :, _OWN] += product[:, :, _CONSTANTS]
    system.rhs[left] -= product[:, :, _RESIDUAL]
    product = np.matmul(others[:, :, :n].transpose(0, 2, 1), others, out=products[1][: len(whitened)])
    system.diagonal[right] += product[:, :, :n]
    system.border[right, :, _OWN] += product[:, :, n:-1]
    system.rhs[right] -= product[:, :, -1]
    own = others[:, :, n:].reshape(-1, ROW_CONSTANTS_SIZE + 1)
    corner = own.T @ own
    system.corner[_OWN, _OWN] += corner[:-1, :-1]
    system.rhs_constants[_OWN] -= corner[:-1, -1]


def _without_repeats(interval: np.ndarray) -> list[np.ndarray]:
    """Split row numbers into sets in which no interval comes twice, so that they can be added at once."""
    order = np.argsort(interval, kind="stable")
    ordered = interval[order]
    first = np.searchsorted(ordered, ordered)
    rank = np.arange(len(interval)) - first
    return [order[rank == r] for r in range(int(rank.max()) + 1)] if len(interval) else []
