"""Gauss-Newton on a graph of GTSAM: linearise, eliminate, move, until a step no longer matters."""

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, block, columns_of, linear_factors, put_in_blocks
from smoother.estimate.factors.graph import Graph
from smoother.estimate.factors.imu import imu_rows
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import CONSTANTS_SIZE, KEYFRAME_SIZE, KEYS, State, vector_values
from smoother.estimate.solvers.covariance import Chain, IndeterminateError


@dataclass(frozen=True, eq=False)
class Step:
    """One Gauss-Newton step from `state`: all rows there, and how far all unknowns move, keyframes (K, 18) and
    constants (C,). unknown: names of the constants that are solved for; priors (C,): variances of the others.
    """

    state: State
    rows: dict[str, Rows]
    keyframes: Array
    constants: Array
    net: gtsam.GaussianBayesNet
    moved: gtsam.Values
    unknown: tuple[str, ...]
    priors: Array

    @cached_property
    def after(self) -> State:
        """The state after the step."""
        return self.state.with_values(self.moved)

    def chain(self) -> Chain:
        """What the elimination left, for covariances."""
        return Chain.of(self.net, columns_of(self.unknown), self.priors)


def step(graph: Graph, values: gtsam.Values, free: Collection[str] = KEYS) -> Step:
    """Linearise `graph` at `values` and eliminate. Raises IndeterminateError where an unknown is not determined.

    free: names of the constants that may move; the others are held, and cost nothing.
    """
    state = graph.state.with_values(values)
    n = len(state.t)
    try:
        rows = [
            imu_rows(graph.imu.linearize(values), graph.sampled, state, graph.shaken, rectified=graph.rectified),
            *graph.rows(state),
        ]
        unknown = tuple(name for name in KEYS if name in free and any(name in r.constants for r in rows))
        system = linear_factors(rows, n - 1, unknown)
        prior = graph.prior.linearize(values)
        for i in range(prior.size()):
            put_in_blocks(prior.at(i), unknown, system)
        constants_last = [CONSTANTS_BLOCK] if unknown else []
        net = _eliminated(system, gtsam.Ordering([*map(block, range(n)), *constants_last]))
        solution = net.optimize()
    except RuntimeError as error:  # what GTSAM's exceptions are in Python
        reason = str(error).strip().partition("\n")[0] or "a number is not finite"
        raise IndeterminateError(reason) from error
    keyframes = solution.vector([block(k) for k in range(n)]).reshape(n, KEYFRAME_SIZE)
    constants = np.zeros(CONSTANTS_SIZE)
    if unknown:
        constants[columns_of(unknown)] = solution.at(CONSTANTS_BLOCK)
    if not (np.isfinite(np.sum(keyframes)) and np.isfinite(np.sum(constants))):
        raise IndeterminateError("the solution holds a number that is not finite")
    moved = values.retract(vector_values(keyframes, constants))
    return Step(state, {r.name: r for r in rows}, keyframes, constants, net, moved, unknown, graph.prior_variances())


def _eliminated(system: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianBayesNet:
    """Eliminate by Cholesky, and where that fails by QR, which takes three times as long and squares no condition."""
    try:
        return system.eliminateSequential(ordering)
    except RuntimeError:
        return system.eliminateSequential(ordering, gtsam.EliminateQR)
