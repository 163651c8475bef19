"""Covariances out of GTSAM's Bayes tree of a chain, exact: one sweep back, and the joint of any functions of keyframes.

Given the next keyframe and the constants, a keyframe is `x_k = G_k x_{k+1} + H_k c + noise of covariance Q_k`: that is
what its clique says, `R x_k + S (x_{k+1}, c) = d`. All else follows by propagation of covariance. gtsam.Marginals gives
the same numbers one key at a time, which costs 2 to 7 ms each and grows with the length of the session.
"""

from dataclasses import dataclass, replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from smoother.arrays import Array, IntArray
from smoother.estimate.model.state import CONSTANTS, CONSTANTS_SIZE, DIMENSIONS, KEYFRAME_SIZE, KEYS, keyframe_keys

NONE = slice(0, 0)  # of the constants


class IndeterminateError(ArithmeticError):
    """The measurements do not determine every unknown."""


@dataclass(frozen=True, eq=False)
class Covariances:
    """keyframes (K, 18, 18); neighbours (K-1, 18, 18) of each keyframe with the next; constants (C, C);
    with_constants (K, 18, C). In the tangent of the state that the graph was linearised at.
    """

    keyframes: Array
    neighbours: Array
    constants: Array
    with_constants: Array


@dataclass(frozen=True, eq=False)
class Chain:
    """gain (K-1, 18, 18): G; influence (K, 18, C) of the constants in all; root (K, 18, 18): W with W W' = Q;
    constants (C, C): their covariance.
    """

    gain: Array
    influence: Array
    root: Array
    constants: Array

    @staticmethod
    def of(tree: gtsam.GaussianBayesTree, n: int) -> "Chain":
        """Read the Bayes tree of n keyframes, eliminated in their order with the constants last."""
        m, size = CONSTANTS_SIZE, KEYFRAME_SIZE
        cliques = [tree[X(k)].conditional() for k in range(n - 2)]
        root, gain, influence = np.empty((n, size, size)), np.empty((n - 1, size, size)), np.empty((n, size, m))
        if cliques:
            separator = np.empty((n - 2, size, size + m))
            columns = _columns(cliques[0].keys()[len(DIMENSIONS) :], [*keyframe_keys(1), *KEYS.values()])
            root[: n - 2] = np.linalg.inv(np.array([c.R() for c in cliques]))
            separator[:, :, columns] = np.array([c.S() for c in cliques])
            by_others = -root[: n - 2] @ separator
            gain[: n - 2], influence[: n - 2] = by_others[:, :, :size], by_others[:, :, size:]
        R, a, b, c = (
            _last_two(tree[X(n - 1)].conditional(), n),
            slice(0, size),
            slice(size, 2 * size),
            slice(2 * size, None),
        )
        root[-2], root[-1], of_constants = (np.linalg.inv(R[part, part]) for part in (a, b, c))
        gain[-1], influence[-1] = -root[-2] @ R[a, b], -root[-1] @ R[b, c]
        influence[-2] = -root[-2] @ R[a, c] + gain[-1] @ influence[-1]
        for k in range(n - 3, -1, -1):
            influence[k] += gain[k] @ influence[k + 1]
        return Chain(gain, influence, root, of_constants @ of_constants.T)

    def covariances(self) -> Covariances:
        """The blocks at and beside the diagonal, and those with the constants."""
        P = self.root @ self.root.transpose(0, 2, 1)
        cross = np.empty_like(self.gain)
        for k in range(len(self.gain) - 1, -1, -1):
            np.matmul(self.gain[k], P[k + 1], out=cross[k])
            P[k] += cross[k] @ self.gain[k].T
        with_constants, by_constants = self.influence @ self.constants, self.influence.transpose(0, 2, 1)
        cross += with_constants[:-1] @ by_constants[1:]
        P += with_constants @ by_constants
        return Covariances(P, cross, self.constants, with_constants)

    def joint(self, first: IntArray, left: Array, right: Array, constants: Array) -> Array:
        """Covariance (q, q) of q linear functions of keyframes `first` and `first + 1` (q,) and of the constants.

        left, right (q, 18), constants (q, C): their coefficients. Each function is carried forwards through the chain,
        where it adds up the noise of the keyframes that it passes.
        """
        by_constants = constants + np.einsum("qi,qim->qm", left, self.influence[first])
        by_constants += np.einsum("qi,qim->qm", right, self.influence[first + 1])
        out = by_constants @ self.constants @ by_constants.T
        order = np.argsort(first, kind="stable")
        begins = first[order]
        carried, inner, added = np.zeros((len(first), KEYFRAME_SIZE)), np.zeros((len(first), len(first))), 0
        for k in range(int(begins[0]), len(self.root)):
            fresh = slice(added, int(np.searchsorted(begins, k, side="right")))
            carried[fresh] += left[order[fresh]]
            noise = carried[: fresh.stop] @ self.root[k]
            inner[: fresh.stop, : fresh.stop] += noise @ noise.T
            if k + 1 < len(self.root):
                carried[: fresh.stop] = carried[: fresh.stop] @ self.gain[k]
                carried[fresh] += right[order[fresh]]
            added = fresh.stop
        out[np.ix_(order, order)] += inner
        return np.asarray(out)

    def thinned(self, every: int) -> "Chain":
        """The chain of the first, the `every`-th .. keyframe alone."""
        n = len(self.root)
        at = np.arange(0, n, every)
        whole = at[:-1]  # from each of these to the next one that is kept
        gain, noise = self.gain[whole].copy(), _squared(self.root[whole])
        for i in range(1, every):
            noise += gain @ _squared(self.root[whole + i]) @ gain.transpose(0, 2, 1)
            gain = gain @ self.gain[whole + i]
        last = _squared(self.root[n - 1])
        for k in range(n - 2, int(at[-1]) - 1, -1):
            last = _squared(self.root[k]) + self.gain[k] @ last @ self.gain[k].T
        root = np.linalg.cholesky(np.concatenate([noise, last[None]]))
        return Chain(gain, self.influence[at], root, self.constants)

    def with_constants(self, covariance: Array, free: slice = NONE) -> "Chain":
        """The chain beside constants of another covariance (C, C); those that are free follow the others as in its own.

        The others were held when it was solved: x_free = A x_others + what its own covariance leaves of them.
        """
        others = np.delete(np.arange(CONSTANTS_SIZE), np.arange(CONSTANTS_SIZE)[free])
        own, out = self.constants, covariance.copy()
        follow = np.linalg.solve(own[np.ix_(others, others)], own[others, free]).T
        known = own[free, free] - follow @ own[others, free]
        out[free, :] = 0.0
        out[free, others] = follow @ covariance[np.ix_(others, others)]
        out[:, free] = out[free, :].T
        out[free, free] = known + follow @ covariance[np.ix_(others, others)] @ follow.T
        return replace(self, constants=out)


def _squared(root: Array) -> Array:
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def _columns(keys: list[int], wanted: list[int]) -> IntArray:
    """Where the columns of `keys`, in their order, belong among those of `wanted`."""
    widths = dict(zip(wanted, _widths(wanted), strict=True))
    starts = dict(zip(wanted, np.cumsum([0, *widths.values()]), strict=False))
    return np.concatenate([starts[key] + np.arange(widths[key]) for key in keys])


def _widths(keys: list[int]) -> list[int]:
    keyframes = (len(keys) - len(CONSTANTS)) // len(DIMENSIONS)
    return [*DIMENSIONS * keyframes, *(c.size for c in CONSTANTS)]


def _last_two(root: gtsam.GaussianConditional, n: int) -> Array:
    """Square-root information (36 + C, 36 + C), triangular, of the last two keyframes and the constants.

    They are the root of the tree, in an order of GTSAM's.
    """
    at = _columns(root.keys(), [*keyframe_keys(n - 2), *keyframe_keys(n - 1), *KEYS.values()])
    R = np.empty((len(at), len(at)))
    R[:, at] = root.R()
    return np.asarray(np.linalg.qr(R, mode="r"))
