"""A Gauss-Newton step on a GTSAM graph: linearise, eliminate, back-substitute."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import gtsam
import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, block, columns_of, linear_factors, put_in_blocks
from smoother.estimate.factors.graph import Graph
from smoother.estimate.factors.imu import imu_rows
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import CONSTANTS_SIZE, KEYS, State, vector_values
from smoother.estimate.solvers.covariance import Chain, IndeterminateError


@dataclass(frozen=True, eq=False)
class Step:
    """One Gauss-Newton step from `state`: all rows there, and the step of keyframes (K, 18) and
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
        """The chain of conditionals, for covariances."""
        return Chain.of(self.net, columns_of(self.unknown), self.priors)


def step(graph: Graph, values: gtsam.Values, free: Collection[str] = KEYS) -> Step:
    """Linearise `graph` at `values` and eliminate. Raises IndeterminateError where an unknown is not determined.

    free: names of the constants that are solved for; the others are held and have no columns.
    """
    state = graph.state.with_values(values)
    try:
        inertial = graph.imu.linearize(values)
    except RuntimeError as error:  # what GTSAM's exceptions are in Python
        raise IndeterminateError(str(error).strip().partition("\n")[0]) from error
    rows = [
        imu_rows(inertial, graph.sampled, state),
        *graph.rows(state),
    ]
    unknown = tuple(name for name in KEYS if name in free and any(name in r.constants for r in rows))
    prior = graph.prior.linearize(values)
    keyframes, constants, net = solve_rows(rows, len(state.t), unknown, map(prior.at, range(prior.size())))
    moved = values.retract(vector_values(keyframes, constants))
    return Step(state, {r.name: r for r in rows}, keyframes, constants, net, moved, unknown, graph.prior_variances())


def solve_rows(
    rows: Sequence[Rows], keyframes: int, unknown: Sequence[str], priors: Iterable[gtsam.GaussianFactor] = ()
) -> tuple[Array, Array, gtsam.GaussianBayesNet]:
    """Eliminate the rows of a chain of keyframes, constants last. Returns how far all unknowns move, keyframes (K, c)
    and constants (C,), and the Bayes net.

    unknown: names of the constants that are solved for; priors: linear factors of one variable, of GTSAM's own.
    Raises IndeterminateError where an unknown is not determined.
    """
    try:
        system = linear_factors(rows, keyframes - 1, unknown)
        for factor in priors:
            put_in_blocks(factor, unknown, system)
        blocks = [block(k) for k in range(keyframes)]
        net = _eliminated(system, gtsam.Ordering([*blocks, *([CONSTANTS_BLOCK] if unknown else [])]))
        solution = net.optimize()
    except RuntimeError as error:  # what GTSAM's exceptions are in Python
        reason = str(error).strip().partition("\n")[0] or "a number is not finite"
        raise IndeterminateError(reason) from error
    moved, constants = solution.vector(blocks).reshape(keyframes, -1), np.zeros(CONSTANTS_SIZE)
    if unknown:
        constants[columns_of(unknown)] = solution.at(CONSTANTS_BLOCK)
    if not (np.isfinite(np.sum(moved)) and np.isfinite(np.sum(constants))):
        raise IndeterminateError("the solution holds a number that is not finite")
    return moved, constants, net


def _eliminated(system: gtsam.GaussianFactorGraph, ordering: gtsam.Ordering) -> gtsam.GaussianBayesNet:
    """Eliminate by Cholesky, and where that fails by QR, which takes three times as long and squares no condition."""
    try:
        return system.eliminateSequential(ordering)
    except RuntimeError:
        return system.eliminateSequential(ordering, gtsam.EliminateQR)
