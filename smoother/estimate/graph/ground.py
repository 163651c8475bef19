"""What of an angle belongs to the ground: the part that comes back whenever the kart comes by again.

Noise, drift and the driver differ from lap to lap, the ground does not. Owns what counts as the same place; which angle
it is, and what it says of the mounting, is up to others.
"""

import numpy as np

from smoother.arrays import Array, IntArray

CELL = 15.0  # m; a bank is longer. From 6 to 30 m the variance of simulated ground is the same within 4 %
DIRECTIONS = 8  # that a place is driven in: the way back, or a crossing, falls to another side
AWAY = 10.0  # s; whoever comes back later has been elsewhere. From 4 to 40 s the same


def variance_of_places(t: Array, position_n: Array, velocity_n: Array, angle: Array) -> tuple[float, int]:
    """Variance, rad^2, of what `angle` has of the place, and how many rows are at places that were driven twice.

    t (N,) s, position_n (N, 3) m, velocity_n (N, 3) m/s, angle (N,) rad with a mean of about zero. The mean product of
    two visits to one place, in which what differs from visit to visit cancels out; below zero where chance has it so.
    """
    place = _places(position_n, velocity_n)
    order = np.lexsort((t, place))
    place, at, angle = place[order], t[order], angle[order]
    begins = np.concatenate([[True], (np.diff(place) != 0) | (np.diff(at) > AWAY)])
    visit, of_visit = np.cumsum(begins) - 1, place[begins]
    mean = np.bincount(visit, angle) / np.bincount(visit)
    visits, total, squares = np.bincount(of_visit), np.bincount(of_visit, mean), np.bincount(of_visit, mean**2)
    again = visits > 1
    rows = np.bincount(place)[again]
    if not len(rows):
        return 0.0, 0
    product = (total[again] ** 2 - squares[again]) / (visits[again] * (visits[again] - 1))
    return float(np.average(product, weights=rows)), int(np.sum(rows))


def _places(position_n: Array, velocity_n: Array) -> IntArray:
    """Number of the place of each row (N,): a square of CELL by CELL, driven through in one of DIRECTIONS."""
    course = np.arctan2(velocity_n[:, 1], velocity_n[:, 0])
    direction = np.mod(np.round(course * (DIRECTIONS / (2.0 * np.pi))), DIRECTIONS)
    where = np.column_stack([np.floor(position_n[:, :2] / CELL), direction])
    return np.asarray(np.unique(where, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)
