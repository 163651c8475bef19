"""Gains of specific force and angular rate against the motion of the path, and what they show of axes and units; and
whether the sensor is on the steering wheel.

The regression of the alignment gives the gain of the force along, to the left and upwards, and of the rate about up,
each as a vector in sensor axes. No two of them are forced to be orthogonal or of unit length. A left-handed triple is
a mirrored accelerometer (or a mirrored track); an axis of turn far from the axis of gravity is a gyroscope whose axes
are not those of the accelerometer. The mistakes that explain it are the signed permutations of axes that undo it.

A driver turns the wheel within a second, a kart turns slower. The column leans to the driver, so a sensor on the wheel
yaws and rolls together. A sensor on the frame yaws alone and rolls to the other side, by a tenth of that."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.fit.running import running_mean
from smoother.samples import GnssFixes, ImuSamples, Problem
from smoother.trajectory import MIRRORED_AXES, UNLIKE_AXES
from smoother.units import DEG, STANDARD_GRAVITY

LEAST_GAIN, LEAST_SHARE = 0.4, 0.5  # of 1 in both; karts and cars have 0.55 and 0.78 or more, noise alone 0.2 and 0.1
HANDED = 0.8  # of 1, the determinant of three directions; real and simulated sensors have 0.96 or more
APART = 45.0 * DEG  # between up by forces and by turns; real and simulated sensors have 8 deg or less
APART_ON_WHEEL = 100.0 * DEG  # likewise of sensors on steering wheels
FITS = 15.0 * DEG  # the same once a mistake is undone
MOST_NAMED = 3  # mistakes that explain it equally well
MIRRORED = (
    "ax, ay, az are not right-handed: the forces fit a mirrored sensor and no rotated one; one axis has the wrong "
    "sign, two are exchanged, or longitude or latitude has the wrong sign{}. Correct the recording; attitude and "
    "accelerations are wrong"
)
DISAGREE = (
    "the axis about which the gyroscope turns is {:.0f} deg from the axis of gravity: the axes of gyroscope and "
    "accelerometer are not the same, one has the wrong sign, or two are exchanged{}. Correct the recording; attitude "
    "is wrong"
)


@dataclass(frozen=True, eq=False)
class Gains:
    """Gains in sensor axes: force (3, 3), columns along, to the left, and up; turn (3,) of the rate about up.

    1 where units are right. force_share, rate_share: shares of force and rate that the path explains, 0 to 1.
    """

    force: Array
    turn: Array
    force_share: float
    rate_share: float

    @classmethod
    def of(cls, force_lines: Array, rate_lines: Array, force_share: float, rate_share: float) -> "Gains":
        """From slopes and intercepts: force_lines (3, 3) by acceleration along and left; rate_lines (2, 3) by turn."""
        along, left, gravity = force_lines
        return cls(np.column_stack([along, left, gravity / STANDARD_GRAVITY]), rate_lines[0], force_share, rate_share)

    @property
    def up(self) -> Array:
        """Gain (3,) of gravity."""
        return self.force[:, 2]

    @property
    def has_force(self) -> bool:
        """Whether the path explains the force well enough for its axes."""
        level = np.linalg.norm(self.force[:, :2], axis=0)
        return bool(np.min(level) > LEAST_GAIN) and self.force_share > LEAST_SHARE

    @property
    def has_turn(self) -> bool:
        """Whether the path explains the rate well enough for its axes."""
        return bool(np.linalg.norm(self.turn) > LEAST_GAIN) and self.rate_share > LEAST_SHARE

    @property
    def force_scale(self) -> float:
        """How many times the standard gravity the accelerometer reads; NaN where the path does not explain it."""
        return float(np.linalg.norm(self.up)) if self.force_share > LEAST_SHARE else np.nan

    @property
    def turn_scale(self) -> float:
        """How many times as fast as the course the gyroscope turns; NaN where the path does not explain it."""
        return float(np.linalg.norm(self.turn)) if self.rate_share > LEAST_SHARE else np.nan

    @property
    def is_beyond_wheel(self) -> bool:
        """Whether the axis of turn is farther from up than the column of a steering wheel."""
        return self.has_turn and _angle(self.turn, self.up) > APART_ON_WHEEL

    def problems(self) -> tuple[Problem, ...]:
        """Report axes that no mounting of a sensor explains, with the mistakes that would."""
        out, hint = [], self._remedy() if self.has_force and self.has_turn else ""
        if self.has_force and _handedness(self.force) < -HANDED:
            out.append(Problem(MIRRORED_AXES, MIRRORED.format(hint)))
        if self.has_turn and (angle := _angle(self.turn, self.up)) > APART:
            out.append(Problem(UNLIKE_AXES, DISAGREE.format(angle / DEG, hint)))
        return tuple(out)

    def _remedy(self) -> str:
        """End of a sentence that names the mistakes which explain the gains; "" where none does, or many."""
        fitting = [
            words
            for words, force, rate in MISTAKES
            if _handedness(force @ self.force) > HANDED and _angle(force @ self.up, rate @ self.turn) < FITS
        ]
        return f"; it all fits once {' or '.join(fitting)}" if 0 < len(fitting) <= MOST_NAMED else ""


def _mistakes() -> Iterator[tuple[str, Array, Array]]:
    """Each mistake in words, and the matrices (3, 3) that undo it for force and rate.

    One sign or one exchange of one sensor, or all its signs; of both sensors, one sign undoes every mirror image.
    """
    eye, mirror = np.eye(3), np.diag([-1.0, 1.0, 1.0])
    changes = [(f"the sign of {{0}}{axis} is changed", np.diag(1.0 - 2.0 * eye[i])) for i, axis in enumerate("xyz")]
    changes += [("the signs of {0}x, {0}y and {0}z are changed", -eye)]
    for i, j in combinations(range(3), 2):
        order = np.arange(3)
        order[[i, j]] = j, i
        changes.append((f"{{0}}{'xyz'[i]} and {{0}}{'xyz'[j]} are exchanged", eye[order]))
    yield "the signs of ax and gx are changed", mirror, mirror
    for words, change in changes:
        yield words.format("g"), eye, change
        yield words.format("a"), change, eye


MISTAKES = tuple(_mistakes())


def _handedness(directions: Array) -> float:
    """Determinant of three directions, columns (3, 3): 1 right-handed, -1 left-handed."""
    return float(np.linalg.det(directions / np.maximum(np.linalg.norm(directions, axis=0), 1e-9)))


def _angle(one: Array, other: Array) -> float:
    """Angle, rad, between two vectors (3,)."""
    size = max(float(np.linalg.norm(one) * np.linalg.norm(other)), 1e-9)
    return float(np.arccos(np.clip(one @ other / size, -1.0, 1.0)))


QUICK_TURN, SLOW_TURN = 0.3, 2.0  # s over which turns are averaged, and beyond which they are the kart's
MIN_SPEED, FEWEST = 4.5, 500  # m/s, and samples at it
# roll in parts of the yaw, and their correlation. Two real loggers on wheels have -1.0 and -1.5, and -0.9; simulated
# ones whose wheel turns by 10 deg -1.0 to -1.2 and -0.8 to -0.9. On frames simulated karts have -0.14 to 0.01, four
# cars -0.04 to 0.01, or -0.1 to 0.1 together
LEAST_ROLL, LEAST_TOGETHER = 0.5, 0.7
# largest share of aliased vibration in the power of those turns. Real loggers on wheels have 0.04 and 0.2, vibrating
# ones at 25 Hz 0.6 and more; on frames, where an engine is aliased to the frequencies of a hand at 100 Hz, 0.23 to 0.45
MOST_FOLDED = 0.3
SHORTEST = 4e-3  # s between samples; quicker ones are averaged
# samples that are analysed, from the first fix at speed on
MOST = 1 << 20


def is_on_wheel(imu: ImuSamples, fixes: GnssFixes) -> bool:
    """Whether the quick turns of a logger of any mounting are those of a steering wheel."""
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
    """Power of vibration in turns between means of `slow` and of `quick` samples, by what is quicker (N,).

    Aliased vibration has on average as much per Hz there.
    """
    return float(shaking @ shaking) * (1.0 / quick - 1.0 / slow) / (1.0 - 1.0 / quick)


def without_the_wheels(problems: tuple[Problem, ...]) -> tuple[Problem, ...]:
    """Return the problems of the alignment of a logger on the wheel that the wheel does not explain.

    The wheel turns about its column as the path bends, so that axes of turn and of gravity differ.
    """
    if any(problem.code == MIRRORED_AXES for problem in problems):
        return problems
    return tuple(problem for problem in problems if problem.code != UNLIKE_AXES)


def _in_means(t: Array, force: Array, rate: Array) -> tuple[Array, Array, Array]:
    """Means of samples at t (N,) s, each (N, 3), no more often than every SHORTEST s."""
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
    """Unit vectors (3,) in s: the mean force is up, and in bends to the left the force is to the left."""
    up = force.mean(axis=0)
    up /= np.linalg.norm(up) or 1.0
    push = (rate @ up) @ force
    left = push - (push @ up) * up
    return np.cross(left / (np.linalg.norm(left) or 1.0), up), up
