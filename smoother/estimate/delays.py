"""What the path through the fixes says, axis by axis, of how late it is behind what the box felt.

The forward and left acceleration and the yaw rate of the path, beside what the box felt of each, tell the delay at any
time. Slip, lean and a box that turns with the wheel shift single axes; what all three say alike is a matter of clocks.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.estimate.averages import WINDOW, Averages
from smoother.estimate.initial.align import Alignment

ROUNDS = 4  # of reweighting
TURN = 0.05  # s to either side, over which the slope of what was felt is read
BLOCK, BLOCKS = 10.0, 12  # s; errors of one block, or of a twelfth of the session, are independent of those of others
NO_GAIN = 1e-6


@dataclass(frozen=True, eq=False)
class Felt:
    """What the box felt along the axes of the kart."""

    averages: Averages
    alignment: Alignment

    def at(self, t: Array) -> Array:
        """Forward and left force m/s^2 and rate about up rad/s, (3, ...), around t (...) s."""
        force, rate = self.averages.around(t, WINDOW)
        R = self.alignment.R_bs
        return np.stack([force @ R[0], force @ R[1], (rate - self.alignment.gyro_bias_s) @ R[2]])

    def with_change(self, t: Array) -> tuple[Array, Array]:
        """What was felt around t (N,) s, and how it changes, both (3, N)."""
        return self.at(t), (self.at(t + TURN) - self.at(t - TURN)) / (2.0 * TURN)


@dataclass(frozen=True, eq=False)
class Said:
    """What one axis says: by how much each of k parts of the delay was off, and the covariance (k, k) of them."""

    off: Array
    covariance: Array


def said(told: Array, here: Array, parts: Array, since: Array, direction: Array) -> Said:
    """Fit told (N,) = gain * (here + parts (k, N) . off) + offset at `since` (N,) s, with Cauchy weights.

    Sigmas are from the scatter between blocks (the sandwich of White 1980), whatever the noise's colour; blocks are
    short or long, whichever scatter `direction` (k,) of the parts more: a receiver may be late now less, now more for a
    minute.
    """
    count = len(parts)
    design = np.concatenate([parts, [here, np.ones_like(here)]])
    scale = 1.0 / np.maximum(np.sqrt(np.mean(design**2, axis=1)), 1e-12)
    design = design * scale[:, None]
    weight = np.ones_like(here)
    for _ in range(ROUNDS):
        weighted = design * weight
        normal = weighted @ design.T
        found = np.linalg.lstsq(normal, weighted @ told, rcond=1e-12)[0]
        rest = told - found @ design
        weight = 1.0 / (1.0 + (rest / (3.0 * np.median(np.abs(rest)) + 1e-12)) ** 2)
    found = found * scale
    gain = float(found[count])
    if abs(gain) < NO_GAIN:
        return Said(np.zeros(count), np.full((count, count), np.inf))
    inverse = (np.linalg.pinv(normal, rcond=1e-12) * scale[:, None])[:count]
    longer = max(BLOCK, float(since[-1] - since[0]) / BLOCKS)
    covariances = [inverse @ _scatter(weighted * rest, since, block) @ inverse.T for block in (BLOCK, longer)]
    return Said(found[:count] / gain, max(covariances, key=lambda c: float(direction @ c @ direction)) / gain**2)


def _scatter(scores: Array, t: Array, block: float) -> Array:
    """Sum (k, k) of the squares of scores (k, N) at t (N,), rising, summed over blocks."""
    edges = np.flatnonzero(np.diff((t - t[0]) // block, prepend=-1.0))
    sums = np.add.reduceat(scores, edges, axis=1)
    return np.asarray(sums @ sums.T)


@dataclass(frozen=True, eq=False)
class Common:
    """What axes say together, its sigma, and what each is beyond it (n,), with the sigma (n,) of each."""

    mean: float
    sigma: float
    beyond: Array
    own: Array

    @property
    def sure(self) -> float:
        """Sigma that holds what axes contradict one another by, and what all have in common.

        An error of the path along the track is one of all axes: together they know no better than the best does.
        """
        at_odds = math.sqrt(float(np.sum((self.beyond / np.maximum(self.own, 1e-12)) ** 2)) / 2.0)
        return max(self.sigma * at_odds, float(np.min(self.own)))

    def are_alike(self, allowed: float) -> bool:
        """Whether no axis differs by more than `allowed`, unless by its own sigmas."""
        return bool(np.all(self.beyond < np.maximum(3.0 * self.own, allowed)))


def common(axes: list[Said], direction: Array) -> Common:
    """What axes say of `direction` (k,) of the parts, weighted by variance; infinite sigma where they say nothing."""
    told = np.array([axis.off @ direction for axis in axes])
    variance = np.array([_along(axis.covariance, direction) for axis in axes])
    own = np.sqrt(variance)
    weight = np.where(variance > 0.0, 1.0 / np.where(variance > 0.0, variance, 1.0), 0.0)
    if not weight.sum() > 0.0:
        return Common(0.0, math.inf, np.abs(told), own)
    mean = float(weight @ told / weight.sum())
    return Common(mean, 1.0 / math.sqrt(weight.sum()), np.abs(told - mean), own)


def _along(covariance: Array, direction: Array) -> float:
    return float(direction @ covariance @ direction) if np.isfinite(covariance).all() else math.inf
