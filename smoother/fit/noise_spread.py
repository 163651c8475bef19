"""The uncertainty of variance components, identified as squared residuals over redundancy.

The uncertainty of a variance follows from the number of residuals of white noise. A source with a low redundancy is
identified only from its part in the residuals, which show less than its whole change. Where the noise changes over a
session, the scatter between blocks of time shows a larger uncertainty.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array

# Sigma of the logarithm of a noise that is not identified: receivers and loggers of one kind differ by a factor of two.
ANY_NOISE = 0.7
FEWEST = 5  # residuals in each
# Errors of the model, as sigmas of a logarithm. From 90 simulated karts with random parameters
# (benchmarks/random_karts.py, draws 1600 to 1689); 120 others are in docs/accuracy.md.
OF_FORCE, OF_FORCE_ALONE = 0.12, 0.3  # flexing, leaning, bumps; without Doppler also the wander of positions
OF_RATE = 0.06
OF_FIXES = 0.02
# The part outside the residuals is split between a noise, the wander of fixes and the motion between velocities by
# their models: error per ratio of both shares.
BY_WANDER, BY_FORCE, BY_JERK = 0.7, 0.2, 0.6
LEAST_SHARE = 0.01


def redundancy_as_white(share: float) -> float:
    """Part of a small change of white noise that residuals show, which leave `share` of it.

    Against a random walk: the mean over all frequencies of the square of what is left, over the mean. With w, the part
    that the walk takes over, and w = 1 - share these are (1 - w)^2 (1 + w / 2) and 1 - w.
    """
    return share * (1.5 - 0.5 * share)


def redundancy_as_walk(share: float) -> float:
    """Likewise of the noise of a random walk beside white noise: (w + w^3) / 2 over w = share."""
    return 0.5 * (1.0 + share**2)


@dataclass(frozen=True, eq=False)
class Residuals:
    """Residuals that identify a noise, in order of time (N,): their `squares` over their variances, and the `expected`
    values of these, with a sum below the `count` of residuals.
    """

    squares: Array
    expected: Array
    count: float

    @property
    def redundancy(self) -> float:
        """How many independent ones they amount to."""
        return float(np.sum(self.expected))

    @property
    def share(self) -> float:
        """Share, 0 to 1, of the noise that is left in them."""
        return min(1.0, max(self.redundancy, 0.0) / max(self.count, 1.0))


def of_positions(residuals: Residuals) -> float:
    """Sigma of the logarithm of the white noise of positions, beside a wander."""
    own, share = _spread(residuals, redundancy_as_white), max(residuals.share, LEAST_SHARE)
    return min(ANY_NOISE, math.hypot(own, OF_FIXES, BY_WANDER * ((1.0 - share) / share) ** 2))


def of_velocities(residuals: Residuals, by_path: float = BY_FORCE) -> float:
    """Likewise of velocities, beside samples or a smooth path that connect them."""
    own, share = _spread(residuals, redundancy_as_white), max(residuals.share, LEAST_SHARE)
    return min(ANY_NOISE, math.hypot(own, OF_FIXES, by_path * (1.0 - share) / share))


def of_force(residuals: Residuals, *, has_doppler: bool) -> float:
    """Likewise of the force that is measured between fixes."""
    own = _spread(residuals, redundancy_as_walk)
    return min(ANY_NOISE, math.hypot(own, OF_FORCE if has_doppler else OF_FORCE_ALONE))


def of_rate(residuals: Residuals) -> float:
    """Likewise of the rate."""
    return min(ANY_NOISE, math.hypot(_spread(residuals, redundancy_as_walk), OF_RATE))


def _spread(residuals: Residuals, redundancy_of: Callable[[float], float]) -> float:
    """Sigma of the logarithm of a sigma that was found as sqrt(squares / expected); ANY_NOISE if not observable.

    redundancy_of: part of a small change that residuals show, by their share. Sources: Foerstner 1979; Huber 1967
    (scatter of blocks).
    """
    redundancy = residuals.redundancy
    if redundancy < 1.0 or float(np.sum(residuals.squares)) <= 0.0:
        return ANY_NOISE
    shown = redundancy_of(residuals.share)
    relative = max(math.sqrt(2.0 * shown / redundancy), _scatter_of_blocks(residuals))
    return min(ANY_NOISE, 0.5 * relative / shown)


def _scatter_of_blocks(residuals: Residuals) -> float:
    """Sigma of squares over expected relative to it, by how blocks of time differ; 0 for too few of them."""
    squares, expected = residuals.squares, residuals.expected
    blocks = min(24, len(squares) // FEWEST)  # of time; their scatter is then accurate to a seventh
    if blocks < 2:
        return 0.0
    first = np.arange(blocks) * len(squares) // blocks
    found, of_them = np.add.reduceat(squares, first), np.add.reduceat(expected, first)
    difference = found - of_them * (np.sum(found) / np.sum(of_them))
    return math.sqrt(float(np.sum(difference**2)) * blocks / (blocks - 1)) / float(np.sum(found))
