"""Delay of the fixes by how strongly a box is pushed, whatever way it is turned.

Specific force is gravity and the acceleration of the path in the axes of the box. Its direction there goes with the
box: on a steering wheel that turns before the kart does, and where rates do not tell attitudes these are turned to suit
any delay. Its size has neither fault. On level ground its square is that of g and that of the path's acceleration, and
a fit of one to the other at shifted times tells how late the fixes are: as if the antenna was above the box, which one
that is ahead by l passes l/V later. What biases, scale and a mean slope add goes with the acceleration itself or is a
constant, and is fitted too. Vibration hardly adds: it is the mean force of WINDOW whose size is taken.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, IntArray, median
from smoother.estimate.averages import WINDOW, averages_of
from smoother.estimate.path_motion import LAGS, PathMotion, path_axes, peak, sampled_at_speed, thinned
from smoother.samples import ImuSamples

ENOUGH_FOR_DELAY, ENOUGH, FEWEST = 300, 1500, 100  # windows, evenly taken: to find it roughly, to tell it, and to try
FINER = np.array([-0.1, -0.05, 0.0, 0.05, 0.1])  # s about the rough delay
ROUNDS = 4  # of reweighting
BLOCK = 5.0  # s; what a corner leaves is independent of what others do
# s of a short lap: folded vibration goes with the speed, and is the same in each. Of 11 sessions of which it was a
# quarter or more of what was felt, delays were off by 3.5 times what blocks that are all independent say
LAP = 25.0
WORST = 0.1  # s, of sigma, beyond which nothing is told
# parts of the path's own square, and share explained: simulated boxes that are shaken by 60 to 150 deg/s in samples of
# 25 and 100 Hz have 0.93 to 1.08 and 0.5 or more
SCALES, LEAST_SHARE = (0.7, 1.3), 0.4
# s, rms, by which delays are off however small their scatter, for vibration that goes with the speed, slip, and an
# antenna for which l/V is not one number: simulated karts 3 ms, harsh ones 8, on shaken wheels 10, harsh and shaken 20
MODEL = 0.015


@dataclass(frozen=True)
class SizeDelay:
    """delay s of positions behind the samples, of an antenna above the box, and its sigma; is_seen: it shows."""

    delay: float
    sigma: float
    is_seen: bool


UNSEEN = SizeDelay(0.0, math.inf, False)


def size_delay(imu: ImuSamples, path: PathMotion) -> SizeDelay:
    """Return how late the fixes of `path` are by the size of the force."""
    use = sampled_at_speed(imu, path)
    if use.size < FEWEST:
        return UNSEEN
    averages, design = averages_of(imu), _design(path)
    few, use = thinned(use, ENOUGH_FOR_DELAY), thinned(use, ENOUGH)

    def fits(tried: Array, rows: IntArray) -> list[_Fit]:
        force, _ = averages.around(path.t[rows] - tried[:, None], WINDOW)
        return [_fitted(design[rows], squares) for squares in np.einsum("ijk,ijk->ij", force, force)]

    rough = float(LAGS[int(np.argmax([fit.share for fit in fits(LAGS, few)]))])
    delay = peak(rough + FINER, np.array([fit.share for fit in fits(rough + FINER, use)]))
    fit = fits(np.array([delay]), use)[0]
    steeper = fit.lines[0] * np.gradient(design[:, 0], path.t)[use]
    laps = max(float(path.t[use[-1]] - path.t[use[0]]) / LAP, 1.0)
    sigma = math.hypot(math.sqrt(laps) * _scatter(path.t[use], design[use], steeper, fit), MODEL)
    is_seen = fit.share > LEAST_SHARE and SCALES[0] < fit.lines[0] < SCALES[1] and sigma < WORST
    return SizeDelay(delay, sigma, bool(is_seen))


def _design(path: PathMotion) -> Array:
    """What the squared force is made of at the fixes, (N, 4): acceleration squared, ahead and to the left, and one."""
    ahead, left, _ = path_axes(path).T
    return np.column_stack([ahead**2 + left**2, ahead, left, np.ones(len(ahead))])


@dataclass(frozen=True, eq=False)
class _Fit:
    """lines (4,) of the design; left (N,) of squared forces and its weight (N,); share of them that is explained."""

    lines: Array
    left: Array
    weight: Array
    share: float


def _fitted(design: Array, squares: Array) -> _Fit:
    """Fit squared forces (N,) m^2/s^4 by the design (N, 4), by least squares with Cauchy weights."""
    weight, lines, left = np.ones(len(squares)), np.zeros(design.shape[1]), squares
    for _ in range(ROUNDS):
        lines = _solved(design, weight, squares)
        left = squares - design @ lines
        usual = MAD_TO_SIGMA * median(np.abs(left)) + 1e-9
        weight = 1.0 / (1.0 + (left / (2.0 * usual)) ** 2)
    spread = squares - (weight @ squares) / np.sum(weight)
    return _Fit(lines, left, weight, 1.0 - float(weight @ left**2) / max(float(weight @ spread**2), 1e-9))


def _solved(design: Array, weight: Array, values: Array) -> Array:
    """Weighted least squares (4,) of values (N,)."""
    weighted = (design * weight[:, None]).T
    return np.asarray(np.linalg.lstsq(weighted @ design, weighted @ values, rcond=None)[0])


def _scatter(t: Array, design: Array, steeper: Array, fit: _Fit) -> float:
    """Sigma of the delay, s, from scores summed over blocks; steeper (N,): what the fit changes by per second of it.

    Source: White 1980, of clusters.
    """
    own = steeper - design @ _solved(design, fit.weight, steeper)
    information = float(fit.weight @ own**2)
    score = np.bincount(((t - t[0]) / BLOCK).astype(np.intp), fit.weight * own * fit.left)
    return math.sqrt(float(score @ score)) / information if information > 0.0 else math.inf
