"""Runs and windows of rows, and the sentences that say where they are."""

from collections.abc import Sequence

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release
from smoother.words import span

HOLE = 1.0  # s without rows: what stands before and after it did not stand meanwhile

Span = tuple[int, int]  # first and last row


def constant_runs(t: Array, *values: Array) -> list[Span]:
    """First and last row of each run of rows at t (N,) s in which none of values (N, ..) changes; pauses end a run."""
    same = np.zeros(t.size + 1, dtype=np.bool_)  # as the one before; behind the last one comes another
    for part in pieces(max(0, t.size - 1)):
        before, now = slice(part.start, part.stop), slice(part.start + 1, part.stop + 1)
        alike = t[now] - t[before] <= HOLE
        for x in values:
            equal = x[now] == x[before]
            alike &= equal if equal.ndim == 1 else _all_of_row(equal)
        same[now] = alike
        release(t, *values)
    edges = np.flatnonzero(np.diff(same))
    return list(zip(edges[0::2].tolist(), edges[1::2].tolist(), strict=True))


def _all_of_row(mask: BoolArray) -> BoolArray:
    """Whether all columns of (N, M) are; ten times faster than numpy's all along such a short axis."""
    out = mask[:, 0]
    for column in range(1, mask.shape[1]):
        out = out & mask[:, column]
    return np.asarray(out)


def mask_of(found: Sequence[Span], n: int) -> BoolArray:
    """Mask (n,) of the rows of runs but for the first row of each, which was measured."""
    mask = np.zeros(n, dtype=np.bool_)
    for first, last in found:
        mask[first + 1 : last + 1] = True
    return mask


def where(t: Array, found: Sequence[Span]) -> str:
    """Say for how long runs last, rows at t (N,) s, and when."""
    lasts, begin = span(sum(float(t[last] - t[first]) for first, last in found)), f"{t[found[0][0]]:.1f} s"
    return f"for {lasts} {f'from {begin} on' if len(found) == 1 else f'in {len(found)} parts, the first at {begin}'}"
