"""One linear system of a chain, solved by GTSAM: rows in, how far every unknown moves out."""

from collections.abc import Iterable, Sequence

import gtsam
import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.gaussian import CONSTANTS_BLOCK, block, columns_of, linear_factors, put_in_blocks
from smoother.estimate.factors.rows import Rows
from smoother.estimate.model.state import CONSTANTS_SIZE
from smoother.estimate.solvers.covariance import IndeterminateError


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
