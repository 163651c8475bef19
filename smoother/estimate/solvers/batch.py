"""Gauss-Newton on a graph of GTSAM: linearise, eliminate, move, until a step no longer matters."""

from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.gaussian import linear_factors
from smoother.estimate.factors.graph import Graph
from smoother.estimate.factors.imu import whitened_imu
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import KEYFRAME_SIZE, KEYS, State, keyframe_keys
from smoother.estimate.solvers.covariance import Chain, IndeterminateError


@dataclass(frozen=True, eq=False)
class Step:
    """One Gauss-Newton step from `state`: the rows and the whitened IMU factors (K-1, 15, 36 + C + 1) there, and how
    far all unknowns move, keyframes (K, 18) and constants (C,).
    """

    state: State
    rows: dict[str, Rows]
    imu: Array
    keyframes: Array
    constants: Array
    tree: gtsam.GaussianBayesTree
    moved: gtsam.Values

    @cached_property
    def after(self) -> State:
        """The state after the step."""
        return self.state.with_values(self.moved)

    def chain(self) -> Chain:
        """What the elimination left, for covariances."""
        return Chain.of(self.tree, len(self.state.t))


def step(graph: Graph, values: gtsam.Values) -> Step:
    """Linearise `graph` at `values` and eliminate. Raises IndeterminateError where an unknown is not determined."""
    state = graph.state.with_values(values)
    n = len(state.t)
    try:
        linear = graph.nonlinear.linearize(values)
        imu = whitened_imu(linear, n - 1, state, graph.shaken)
        rows = graph.rows(state)
        system = linear_factors(rows, imu)
        for i in range(n - 1, linear.size()):
            system.push_back(linear.at(i))
        tree = system.eliminateMultifrontal(graph.ordering)
        delta = tree.optimize()
    except RuntimeError as error:  # what GTSAM's exceptions are in Python
        reason = str(error).strip().partition("\n")[0] or "a number is not finite"
        raise IndeterminateError(reason) from error
    keyframes = delta.vector([key for k in range(n) for key in keyframe_keys(k)]).reshape(n, KEYFRAME_SIZE)
    constants = np.concatenate([delta.at(key) for key in KEYS.values()])
    if not (np.isfinite(np.sum(keyframes)) and np.isfinite(np.sum(constants))):
        raise IndeterminateError("the solution holds a number that is not finite")
    return Step(state, {r.name: r for r in rows}, imu, keyframes, constants, tree, values.retract(delta))
