"""A box on the steering wheel, seen in a recording as it was read, before anything is smoothed.

A hand turns the wheel to and fro within a second, a kart turns slower. The column leans to the driver, so that each
such turn to the left is one about up and about what points backwards, together. A box on the frame turns about up
alone and leans to the other side, by a tenth of that, and late.

Where vibration that the sampling folds hides those turns, the path tells them apart (:func:`turns_with_bends`): a wheel
is turned as the path bends, and vibration knows nothing of the fixes.
"""

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.estimate.averages import averages_of
from smoother.estimate.path_motion import PathMotion, path_axes, sampled_at_speed, thinned
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
# rad m, by which the box leans inwards with the bend's curvature, and sigmas of that: simulated wheels have 0.6 to 3.4,
# boxes on frames -0.5 to 0.2, at three sigmas of their own or less. And the turn about up, in parts of it
LEAST_TURN, CERTAIN, TURNS_TOO = 0.5, 4.0, (0.3, 3.0)
WINDOW, BLOCK, ENOUGH = 0.3, 5.0, 4000  # s over which turns are averaged; s that what is left lasts for; windows
SHORTEST = 4e-3  # s between samples: a hand needs no quicker ones, and means of them fold less
SLOWEST = 3.0  # m/s, lest a course at a walk counts for a bend
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


def turns_with_bends(imu: ImuSamples, path: PathMotion, R_bs: Array, delay: float) -> bool:
    """Whether the box leans and turns with how the path bends, as a steering wheel is turned.

    R_bs (3, 3): rough mounting. delay s of the path behind the samples, not that by which the box turns most alike: a
    wheel turns before the kart does. Roll and yaw are fitted by the change of curvature, the turn of the path, and the
    jerk to the left, which a kart leans and slips with; sigmas are from the scatter between blocks of BLOCK.
    """
    use = thinned(sampled_at_speed(imu, path), ENOUGH)
    if use.size < FEWEST:
        return False
    _, left, turn = path_axes(path).T
    change = np.gradient(turn / np.maximum(path.speed, SLOWEST), path.t)
    design = np.column_stack([change, turn, np.gradient(left, path.t), np.ones(len(turn))])[use]
    _, rate = averages_of(imu).around(path.t[use] - delay, WINDOW)
    inverse = np.linalg.pinv(design.T @ design)
    turned = rate @ R_bs[[0, 2]].T
    lines = inverse @ design.T @ turned
    roll, yaw = lines[0]
    rest = turned[:, 0] - design @ lines[:, 0]
    score = np.zeros((int((path.t[use[-1]] - path.t[use[0]]) / BLOCK) + 1, design.shape[1]))
    np.add.at(score, ((path.t[use] - path.t[use[0]]) / BLOCK).astype(np.intp), design * rest[:, None])
    sigma = float(np.linalg.norm(score @ inverse[0]))
    return bool(-roll > max(LEAST_TURN, CERTAIN * sigma) and TURNS_TOO[0] < yaw / -roll < TURNS_TOO[1])


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
