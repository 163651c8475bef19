"""Axes of the gyroscope against those of the accelerometer, by the rates at which a vehicle leans.

A vehicle rolls out of a bend by k times the acceleration to the left, and pitches back by c times that ahead. With the
rate w about up, both angles show in the level rates,

    rate ahead = k d(left)/dt + w c ahead,     rate to the left = -c d(ahead)/dt + w k left,

with accelerations of the path, so that of the accelerometer only its mounting is needed. In right axes k and c are each
one number in both lines, and c is positive. An axis with the wrong sign, or two that are exchanged, puts k into the
wrong line or gives it two signs. All 48 signed permutations of the axes are compared.
"""

from dataclasses import dataclass
from itertools import permutations, product

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, IntArray, median
from smoother.units import DEG

AROUND = 1.0  # s over which rates are averaged: bends last longer; engines and kerbs shake for less
WITHIN = np.linspace(-0.4, 0.4, 5) * AROUND  # s, nodes of the mean of the path
SPACING = 0.55  # s between fixes at the most; rarer ones hardly show a change of acceleration
BLOCK = 5.0  # s; errors of one corner are independent of those of others
ROUNDS = 6  # of reweighting
FEWEST = 100  # windows
# power of the lean over that of its noise: simulated karts have 12 to 150 in minutes, real karts and cars 15 to 220
OBSERVABLE = 8.0
LEAST = 0.8e-3  # rad per m/s^2, half a degree at 1 g; whatever leans at all does so by more
# share of that power which lean does not explain: 0.2 at the most in right axes, 0.6 or more with one mistake
EXPLAINED, UNEXPLAINED = 0.3, 0.55
UPRIGHT, ASKEW = 10.0 * DEG, 20.0 * DEG  # from up to the axis of turn: in right axes; at most, of axes as they are
LEANING, TURNING = slice(0, 4), 4  # rows of the coefficients


@dataclass(frozen=True, eq=False)
class LeanRates:
    """Coefficients (6, 3) of the rate in sensor axes, their sigma (6, 3), and the scatter (6,) of the regressors.

    Regressors: change of acceleration to the left and back, turn times acceleration to the left and ahead, turn, one.
    """

    lines: Array
    sigma: Array
    scatter: Array

    def unexplained(self, R_bs: Array, upright: float = UPRIGHT) -> float:
        """Share, 0 to 1, of the level rates' dependence on acceleration that no vehicle shows; 1 where up differs."""
        x, y, up = R_bs @ self.lines[TURNING]
        if not np.arctan2(np.hypot(x, y), up) < upright:
            return 1.0
        _, power, rest = self._lean(R_bs)
        return rest / max(power, 1e-30)

    def is_observable(self, R_bs: Array) -> bool:
        """Whether the vehicle leans by more than the noise."""
        size, power, _ = self._lean(R_bs)
        noise = 2.0 / 3.0 * float(np.sum((self.sigma[LEANING] * self.scatter[LEANING, None]) ** 2))
        return power > OBSERVABLE * noise and size > LEAST

    def _lean(self, R_bs: Array) -> tuple[float, float, float]:
        """Lean, rad per m/s^2; power of the level rates by acceleration, rad^2/s^2, and what lean leaves of it."""
        scatter = self.scatter[LEANING]
        found = (self.lines[LEANING] @ R_bs[:2].T * scatter[:, None]).T.ravel()
        by_left, by_ahead = np.zeros((2, len(found)))
        by_left[[0, 5]], by_ahead[[6, 3]] = scatter[[0, 1]], scatter[[2, 3]]
        left = float(by_left @ found / (by_left @ by_left))
        ahead = max(float(by_ahead @ found / (by_ahead @ by_ahead)), 0.0)
        rest = found - left * by_left - ahead * by_ahead
        return float(np.hypot(left, ahead)), float(found @ found), float(rest @ rest)


def lean_rates(t: Array, axes: Array, at: Array, rate: Array) -> LeanRates | None:
    """Fit mean rates (M, 3) rad/s over AROUND at times `at` (M,) s by the motion along the path.

    axes (N, 3): acceleration ahead and to the left, m/s^2, and yaw rate, rad/s, at t (N,) s. None for few or rare ones.
    """
    if len(at) < FEWEST or float(median(np.diff(t))) > SPACING:
        return None

    def path(shift: float) -> Array:
        return np.stack([np.interp(at + shift, t, values) for values in axes.T])

    change = (path(0.5 * AROUND) - path(-0.5 * AROUND)) / AROUND
    along = np.array([path(shift) for shift in WITHIN])
    ahead, left = np.mean(along[:, :2] * along[:, 2:], axis=0)
    design = np.stack([change[1], left, -change[0], ahead, np.mean(along[:, 2], axis=0), np.ones(len(at))], axis=1)
    lines, sigma = _fitted(design, rate, ((at - at[0]) / BLOCK).astype(np.intp))
    return LeanRates(lines, sigma, np.std(design, axis=0))


def wrong_columns(rates: LeanRates, R_bs: Array) -> str:
    """Return from which columns gx, gy, gz are to be filled; "" where the axes are right or lean does not show it.

    R_bs (3, 3): the mounting of the accelerometer, which right axes of the gyroscope share.
    """
    if rates.unexplained(R_bs, ASKEW) < UNEXPLAINED:
        return ""
    tried = [(order, signs) for order in permutations(range(3)) for signs in product((1.0, -1.0), repeat=3)]
    true = [np.eye(3)[list(order)] * np.array(signs)[:, None] for order, signs in tried]
    left, best = min((rates.unexplained(R_bs @ one), i) for i, one in enumerate(true))
    if left > EXPLAINED or not rates.is_observable(R_bs @ true[best]):
        return ""
    return ", ".join("-" * (sign < 0.0) + "g" + "xyz"[source] for source, sign in zip(*tried[best], strict=True))


def _fitted(design: Array, values: Array, block: IntArray) -> tuple[Array, Array]:
    """Lines (p, 3) by least squares with Cauchy weights, and their sigmas from scores summed over blocks (N,).

    Source: White 1980, of clusters.
    """
    weight = np.ones(len(design))
    for _ in range(ROUNDS):
        weighted = (design * weight[:, None]).T
        inverse = np.linalg.pinv(weighted @ design)
        lines = inverse @ (weighted @ values)
        rest = values - design @ lines
        usual = MAD_TO_SIGMA * median(np.abs(rest).ravel()) + 1e-9
        weight = 1.0 / (1.0 + np.sum(rest**2, axis=1) / (8.0 * usual**2))
    sigma = np.empty_like(lines)
    for i, own in enumerate((rest * weight[:, None]).T):
        score = np.stack([np.bincount(block, own * column) for column in design.T], axis=1)
        sigma[:, i] = np.sqrt(np.sum((score @ inverse) ** 2, axis=0))
    return lines, sigma
