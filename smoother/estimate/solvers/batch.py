"""Gauss-Newton on a graph of GTSAM: linearise, eliminate, move, until a step no longer matters."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, block, linear_factors, put_in_blocks
from smoother.estimate.factors.graph import Graph
from smoother.estimate.factors.imu import whitened_imu
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import COLUMNS, CONSTANTS_SIZE, KEYFRAME_SIZE, State, vector_values
from smoother.estimate.solvers.covariance import Chain, IndeterminateError


@dataclass(frozen=True, eq=False)
class Step:
    """One Gauss-Newton step from `state`: the rows and the whitened IMU factors (K-1, 15, 36 + C + 1) there, and how
    far all unknowns move, keyframes (K, 18) and constants (C,). free: columns of the constants that are solved for;
    held (C,): variances of the others, of their priors.
    """

    state: State
    rows: dict[str, Rows]
    imu: Array
    keyframes: Array
    constants: Array
    tree: gtsam.GaussianBayesTree
    moved: gtsam.Values
    free: IntArray
    held: Array

    @cached_property
    def after(self) -> State:
        """The state after the step."""
        return self.state.with_values(self.moved)

    def chain(self) -> Chain:
        """What the elimination left, for covariances."""
        return Chain.of(self.tree, len(self.state.t), self.free, self.held)


def step(graph: Graph, values: gtsam.Values) -> Step:
    """Linearise `graph` at `values` and eliminate. Raises IndeterminateError where an unknown is not determined."""
    state = graph.state.with_values(values)
    n = len(state.t)
    try:
        linear = graph.nonlinear.linearize(values)
        imu = whitened_imu(linear, n - 1, state, graph.shaken)
        rows = graph.rows(state)
        free = _measured(rows, imu)
        system = linear_factors(rows, imu, free)
        for i in range(n - 1, linear.size()):
            put_in_blocks(linear.at(i), free, system)
        tree = system.eliminateMultifrontal(gtsam.Ordering([*map(block, range(n)), CONSTANTS_BLOCK]))
        solution = tree.optimize()
    except RuntimeError as error:  # what GTSAM's exceptions are in Python
        reason = str(error).strip().partition("\n")[0] or "a number is not finite"
        raise IndeterminateError(reason) from error
    keyframes = solution.vector([block(k) for k in range(n)]).reshape(n, KEYFRAME_SIZE)
    constants = np.zeros(CONSTANTS_SIZE)
    constants[free] = solution.at(CONSTANTS_BLOCK)
    if not (np.isfinite(np.sum(keyframes)) and np.isfinite(np.sum(constants))):
        raise IndeterminateError("the solution holds a number that is not finite")
    moved = values.retract(vector_values(keyframes, constants))
    return Step(state, {r.name: r for r in rows}, imu, keyframes, constants, tree, moved, free, graph.prior_variances())


def _measured(rows: Sequence[Rows], imu: Array) -> IntArray:
    """Columns of the constants that a factor depends on; all others stay at their priors."""
    used = np.any(imu[:, :, 2 * KEYFRAME_SIZE : -1], axis=(0, 1))
    for r in rows:
        for name in r.constants:
            used[COLUMNS[name]] = True
    return np.flatnonzero(used)
