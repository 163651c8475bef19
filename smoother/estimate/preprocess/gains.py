"""Gains of specific force and angular rate against the motion of the path, and what they show of axes and units.

The regression of the alignment gives the gain of the force along, to the left and upwards, and of the rate about up,
each as a vector in sensor axes. No two of them are forced to be orthogonal or of unit length. A left-handed triple is
a mirrored accelerometer (or a mirrored track); an axis of turn far from the axis of gravity is a gyroscope whose axes
are not those of the accelerometer. The mistakes that explain it are the signed permutations of axes that undo it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from smoother.arrays import Array
from smoother.samples import Problem
from smoother.trajectory import MIRRORED_AXES, UNLIKE_AXES
from smoother.units import DEG, STANDARD_GRAVITY

LEAST_GAIN, LEAST_SHARE = 0.4, 0.5  # of 1 in both; karts and cars have 0.55 and 0.78 or more, noise alone 0.2 and 0.1
HANDED = 0.8  # of 1, the determinant of three directions; real and simulated sensors have 0.96 or more
APART = 45.0 * DEG  # between up by forces and by turns; real and simulated sensors have 8 deg or less
APART_ON_WHEEL = 100.0 * DEG  # likewise of sensors on steering wheels
FITS = 15.0 * DEG  # the same once a mistake is undone
MOST_NAMED = 3  # mistakes that explain it equally well; a longer list does not help
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
