"""Exact covariances from GTSAM's Bayes net of a chain: one backward sweep, and the joint of any functions of keyframes.

Given the next keyframe and the constants, a keyframe is `x_k = G_k x_{k+1} + H_k c + noise of covariance Q_k`: this is
its conditional, `R x_k + S (x_{k+1}, c) = d`. Everything else follows by propagation of covariance. gtsam.Marginals
gives the same numbers one key at a time, which costs 2 to 7 ms each and grows with the length of the session.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import gtsam
import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, block
from smoother.estimate.model.state import CONSTANTS_SIZE

NONE = np.empty(0, np.int64)


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
    def of(net: gtsam.GaussianBayesNet, columns: IntArray, priors: Array) -> "Chain":
        """Read the Bayes net of a chain: a conditional for each keyframe, given the next, and one for the constants.

        columns (m,): those of the constants that were solved for; priors (C,): variances of all others.
        """
        m = len(columns)
        n = net.size() - bool(m)
        conditionals = [net.at(k) for k in range(n)]
        root: Array = np.asarray(np.linalg.inv(np.array([c.R() for c in conditionals])))
        size = root.shape[1]
        of_next, of_constants = _columns(conditionals[0].keys()[1:], {block(1): size, CONSTANTS_BLOCK: m})
        gain, influence = np.empty((n - 1, size, size)), np.empty((n, size, m))
        for k, conditional in enumerate(conditionals[:-1]):
            separator = conditional.S()
            gain[k], influence[k] = separator[:, of_next], separator[:, of_constants]
        influence[-1] = conditionals[-1].S().reshape(size, m)
        gain, influence = np.negative(root[:-1] @ gain), np.negative(root @ influence)
        for k in range(n - 2, -1, -1):
            influence[k] += gain[k] @ influence[k + 1]
        constants, of_all = np.diag(priors), np.zeros((n, size, CONSTANTS_SIZE))
        of_all[:, :, columns] = influence
        if m:
            of_free: Array = np.asarray(np.linalg.inv(net.at(n).R()))
            constants[np.ix_(columns, columns)] = _squared(of_free)
        return Chain(gain, of_all, root, constants)

    @cached_property
    def given_constants(self) -> Array:
        """Covariances (K, 18, 18) of the keyframes given the constants."""
        P = self.root @ self.root.transpose(0, 2, 1)
        for k in range(len(self.gain) - 1, -1, -1):
            P[k] += self.gain[k] @ P[k + 1] @ self.gain[k].T
        return np.asarray(P)

    def covariances(self) -> Covariances:
        """The blocks at and beside the diagonal, and those with the constants."""
        P, cross = self.given_constants, self.gain @ self.given_constants[1:]
        with_constants, by_constants = self.influence @ self.constants, self.influence.transpose(0, 2, 1)
        cross += with_constants[:-1] @ by_constants[1:]
        return Covariances(P + with_constants @ by_constants, cross, self.constants, with_constants)

    def joint(self, first: IntArray, left: Array, right: Array, constants: Array) -> Array:
        """Covariance (q, q) of q linear functions of keyframes `first` and `first + 1` (q,) and of the constants.

        left, right (q, 18), constants (q, C): their coefficients. A function is the next keyframe's share in it and
        noise of its own; that share is carried forwards through the chain to the functions that come later.
        """
        by_constants = constants + np.einsum("qi,qim->qm", left, self.influence[first])
        by_constants += np.einsum("qi,qim->qm", right, self.influence[first + 1])
        order = np.argsort(first, kind="stable")
        starts = np.flatnonzero(np.diff(first[order], prepend=-1))
        P, carried, at = self.given_constants, np.empty((len(first), self.root.shape[1])), 0
        inner = np.empty((len(first), len(first)))
        for begin, end in pairwise([*starts.tolist(), len(first)]):
            k, some = int(first[order[begin]]), order[begin:end]
            carried[:begin] = self._through(carried[:begin], at, k)
            ahead = left[some] @ self.gain[k] + right[some]
            own = left[some] @ self.root[k]
            of_next = ahead @ P[k + 1]
            earlier = carried[:begin] @ (left[some] @ P[k] + right[some] @ P[k + 1] @ self.gain[k].T).T
            inner[:begin, begin:end], inner[begin:end, :begin] = earlier, earlier.T
            inner[begin:end, begin:end] = of_next @ ahead.T + own @ own.T
            carried[:begin], carried[begin:end], at = carried[:begin] @ self.gain[k], ahead, k + 1
        out = by_constants @ self.constants @ by_constants.T
        out[np.ix_(order, order)] += inner
        return np.asarray(out)

    def _through(self, carried: Array, begin: int, end: int) -> Array:
        """Rows (q, 18) times the gains of keyframes begin .. end - 1, by products of 2, 4, 8 .. of them."""
        while len(carried) and begin < end:
            level = min((begin & -begin).bit_length() - 1 if begin else 63, (end - begin).bit_length() - 1)
            carried, begin = carried @ self._products[level][begin >> level], begin + (1 << level)
        return carried

    @cached_property
    def _products(self) -> list[Array]:
        """Of each level l the products of 2^l gains in a row, from multiples of 2^l on."""
        out = [self.gain]
        while len(out[-1]) > 1:
            even = len(out[-1]) // 2 * 2
            out.append(out[-1][0:even:2] @ out[-1][1:even:2])
        return out

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

    def with_constants(self, covariance: Array, free: IntArray = NONE) -> "Chain":
        """The chain beside constants of another covariance (C, C); `free` (f,) follow the others as in its own.

        The others were held when it was solved: x_free = A x_others + what its own covariance leaves of them.
        """
        others = np.delete(np.arange(CONSTANTS_SIZE), free)
        own, out = self.constants, covariance.copy()
        follow = np.linalg.solve(own[np.ix_(others, others)], own[np.ix_(others, free)]).T
        out[free, :] = 0.0
        out[np.ix_(free, others)] = follow @ covariance[np.ix_(others, others)]
        out[:, free] = out[free, :].T
        left = own[np.ix_(free, free)] - follow @ own[np.ix_(others, free)]
        out[np.ix_(free, free)] = left + follow @ covariance[np.ix_(others, others)] @ follow.T
        return replace(self, constants=out)


def _squared(root: Array) -> Array:
    return np.asarray(root @ np.swapaxes(root, -1, -2))


def _columns(keys: list[int], sizes: dict[int, int]) -> list[slice]:
    """Where the columns of each of `sizes`, in its order, are among those of `keys`."""
    starts = dict(zip(keys, np.cumsum([0, *(sizes[key] for key in keys)]).tolist(), strict=False))
    return [slice(starts.get(key, 0), starts.get(key, 0) + size) for key, size in sizes.items()]
