"""Which mistake in the axes of a motion sensor would explain what no mounting of a box does.

Directions of the kart in the axes of the accelerometer and of the gyroscope are found each by itself. A sign that is
wrong, or two axes that are exchanged, on either sensor or on both, turns them into what was found; undone, they have to
be right-handed, and what is up by both has to agree.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from smoother.arrays import Array
from smoother.units import DEG

HANDED = 0.8  # of 1, the determinant of three directions; real and simulated boxes have 0.96 or more
FITS = 15.0 * DEG  # between what is up by forces and by turns once a mistake is undone; 8 deg is the most there is
MOST_NAMED = 3  # of so many mistakes that would explain it, naming them still helps
AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Mistake:
    """A mistake in words, and what (3, 3) undoes it for force and rate."""

    words: str
    force: Array
    rate: Array


def handedness(along: Array, aside: Array, gravity: Array) -> float:
    """Determinant of the directions of three vectors (3,): 1 right-handed, -1 left-handed."""
    return float(np.linalg.det([_unit(along), _unit(aside), _unit(gravity)]))


def apart(one: Array, other: Array) -> float:
    """Angle, rad, between two vectors (3,)."""
    return float(np.arccos(np.clip(_unit(one) @ _unit(other), -1.0, 1.0)))


def advice(along: Array, aside: Array, gravity: Array, upward: Array) -> str:
    """Return a sentence that names the mistakes that would explain these slopes; "" where none does, or many.

    along, aside, gravity (3,): what the accelerometer feels ahead, to the left and upwards; upward (3,): what the
    gyroscope turns about to the left.
    """
    fitting = [
        mistake.words
        for mistake in MISTAKES
        if handedness(*(mistake.force @ vector for vector in (along, aside, gravity))) > HANDED
        and apart(mistake.force @ gravity, mistake.rate @ upward) < FITS
    ]
    if not fitting or len(fitting) > MOST_NAMED:
        return ""
    return remedy(*fitting)


def remedy(*fitting: str) -> str:
    """Return the end of a sentence that names mistakes, each of which would explain what is found."""
    return f"; it all fits once {' or '.join(fitting)}"


def _mistakes() -> Iterator[Mistake]:
    """One axis or two of either sensor; of both sensors, every mirror image is made right by one sign, whichever."""
    eye, mirror = np.eye(3), np.diag([-1.0, 1.0, 1.0])
    yield Mistake("the signs of ax and gx are changed", mirror, mirror)
    for i, axis in enumerate(AXES):
        flipped = np.diag(np.where(np.arange(3) == i, -1.0, 1.0))
        yield Mistake(f"the sign of g{axis} is changed", eye, flipped)
        yield Mistake(f"the sign of a{axis} is changed", flipped, eye)
    for name, force, rate in (("g", eye, -eye), ("a", -eye, eye)):
        yield Mistake(f"the signs of {name}x, {name}y and {name}z are changed", force, rate)
    for i, j in combinations(range(3), 2):
        order = np.arange(3)
        order[[i, j]] = j, i
        exchanged, of_force, of_rate = eye[order], f"a{AXES[i]} and a{AXES[j]}", f"g{AXES[i]} and g{AXES[j]}"
        yield Mistake(f"{of_rate} are exchanged", eye, exchanged)
        yield Mistake(f"{of_force} are exchanged", exchanged, eye)


MISTAKES = tuple(_mistakes())


def _unit(vector: Array) -> Array:
    return np.asarray(vector / max(float(np.linalg.norm(vector)), 1e-9))
