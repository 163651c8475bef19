"""A box on the steering wheel, seen in a recording as it was read, before anything is smoothed.

A hand turns the wheel to and fro within a second, a kart turns slower. The column leans to the driver, so that each
such turn to the left is one about up and about what points backwards, together. A box on the frame turns about up
alone and leans to the other side, by a tenth of that, and late.
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.running import running_mean
from smoother.samples import GnssFixes, ImuSamples, Problem
from smoother.trajectory import MIRRORED_AXES, UNLIKE_AXES

QUICK_TURN, SLOW_TURN = 0.3, 2.0  # s over which turns are averaged, and beyond which they are the kart's
MIN_SPEED, FEWEST = 4.5, 500  # m/s, and samples at it
# roll in parts of the yaw, and their correlation. Two real boxes on wheels have -1.0 and -1.5, and -0.9; simulated ones
# whose wheel turns by 10 deg -1.0 to -1.2 and -0.8 to -0.9. On frames simulated karts have -0.14 to 0.01, four cars
# -0.04 to 0.01, or -0.1 to 0.1 together
LEAST_ROLL, LEAST_TOGETHER = 0.5, 0.7
# Share of the power of those turns which may be vibration that the sampling folds: a tone, that all axes have in
# common in any proportion. Real boxes on wheels have 0.04 and 0.2, shaken ones whose wheel does not show 0.6 and more
# at 25 Hz. At 100 Hz an engine that turns as often is folded to turns as slow as a hand's: frames have 0.23 to 0.45
MOST_FOLDED = 0.3
SHORTEST = 4e-3  # s between samples: a hand needs no quicker ones, and means of them fold less
# samples that tell a wheel, from where the kart drives off on: ten copies of them are in memory at once
MOST = 1 << 20


def is_on_wheel(imu: ImuSamples, fixes: GnssFixes) -> bool:
    """Whether the quick turns of a box are those of a steering wheel. No mounting is asked for, nor is it told."""
    part = _where_driven(imu.t, fixes)
    t, force, rate = _in_means(imu.t[part], imu.specific_force_s[part], imu.angular_rate_s[part])
    driving = _at_speed(t, fixes)
    if np.count_nonzero(driving) < FEWEST:
        return False
    step = float(np.median(np.diff(t)))
    rate = rate - np.median(rate, axis=0)
    widths = [2 * max(1, round(0.5 * seconds / step)) for seconds in (SLOW_TURN, QUICK_TURN)]
    slow, quicker = (running_mean(rate, width) for width in widths)
    quick = (quicker - slow)[driving]
    ahead, up = _ahead_and_up(force[driving], slow[driving])
    yaw, roll = quick @ up, quick @ ahead
    power = float(yaw @ yaw)
    if power == 0.0 or not np.any(roll):
        return False
    if _folded((rate - quicker)[driving] @ up, *widths) > MOST_FOLDED * power:
        return False
    shared = float(roll @ yaw)
    return shared / power < -LEAST_ROLL and shared / np.sqrt(power * float(roll @ roll)) < -LEAST_TOGETHER


def _folded(shaking: Array, slow: int, quick: int) -> float:
    """Power that turns between means of `slow` and of `quick` samples have of vibration, by what is quicker (N,).

    Hands hardly turn a wheel more quickly; what the sampling folds is there too, and on average as much per Hz.
    """
    return float(shaking @ shaking) * (1.0 / quick - 1.0 / slow) / (1.0 - 1.0 / quick)


def without_the_wheels(problems: tuple[Problem, ...]) -> tuple[Problem, ...]:
    """Return problems of an alignment of a box on the wheel, without what the wheel explains.

    A hand turns the wheel as the path bends: the box turns about the column then as much as about up. Axes that are
    mirrored are so on a wheel too, and turn the other way.
    """
    if any(problem.code == MIRRORED_AXES for problem in problems):
        return problems
    return tuple(problem for problem in problems if problem.code != UNLIKE_AXES)


def _in_means(t: Array, force: Array, rate: Array) -> tuple[Array, Array, Array]:
    """Means of so many samples, at t (N,) s, each (N, 3), that they come no more often than every SHORTEST s."""
    several = int(SHORTEST / max(float(np.median(np.diff(t))), 1e-6) + 1e-3) if len(t) > FEWEST else 1
    if several < 2:
        return t, force, rate
    whole = len(t) // several * several
    means = (values[:whole].reshape(-1, several, values.shape[1]).mean(axis=1) for values in (t[:, None], force, rate))
    times, forces, rates = means
    return times[:, 0], forces, rates


def _where_driven(t: Array, fixes: GnssFixes) -> slice:
    """Samples at t (N,) s, MOST at most, from the first fix at speed on."""
    quick = np.hypot(fixes.velocity_n[:, 0], fixes.velocity_n[:, 1]) > MIN_SPEED
    if len(t) <= MOST or not quick.any():
        return slice(0, MOST)
    begin = min(int(np.searchsorted(t, fixes.t[np.argmax(quick)])), len(t) - MOST)
    return slice(begin, begin + MOST)


def _at_speed(t: Array, fixes: GnssFixes) -> BoolArray:
    speed = np.hypot(fixes.velocity_n[:, 0], fixes.velocity_n[:, 1])
    known = np.isfinite(speed)
    return np.interp(t, fixes.t[known], speed[known]) > MIN_SPEED if known.any() else np.zeros(len(t), dtype=np.bool_)


def _ahead_and_up(force: Array, rate: Array) -> tuple[Array, Array]:
    """Unit vectors (3,) of the box: gravity is felt upwards, and in bends to the left the push is to the left."""
    up = force.mean(axis=0)
    up /= np.linalg.norm(up) or 1.0
    push = (rate @ up) @ force
    left = push - (push @ up) * up
    return np.cross(left / (np.linalg.norm(left) or 1.0), up), up
