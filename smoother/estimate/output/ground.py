"""What of an angle belongs to the ground: the part that comes back whenever the kart comes by again.

Noise, drift and the driver differ from lap to lap, the ground does not. Owns what counts as the same place; which angle
it is, and what it says of the mounting, is up to others.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray

CELL = 15.0  # m; a bank is longer. From 6 to 30 m the variance of simulated ground is the same within 4 %
DIRECTIONS = 8  # that a place is driven in: the way back, or a crossing, falls to another side
AWAY = 10.0  # s; whoever comes back later has been elsewhere. From 4 to 40 s the same


@dataclass(frozen=True, eq=False)
class Visits:
    """Which rows belong to one visit to one place: order (N,) of the rows, by place and time, visit (N,) of each in
    that order, and place (V,) of each visit.
    """

    order: IntArray
    visit: IntArray
    place: IntArray

    @staticmethod
    def of(t: Array, position_n: Array, velocity_n: Array) -> "Visits":
        """Of rows at t (N,) s, position_n (N, 3) m, velocity_n (N, 3) m/s."""
        place = _places(position_n, velocity_n)
        order = np.lexsort((t, place))
        place, at = place[order], t[order]
        begins = np.ones(len(t), dtype=np.bool_)
        begins[1:] = (np.diff(place) != 0) | (np.diff(at) > AWAY)
        return Visits(order, np.cumsum(begins) - 1, place[begins])

    @property
    def rows(self) -> int:
        """How many rows are at places that were driven twice."""
        return int(np.sum(self._rows))

    @property
    def each(self) -> float:
        """How often such a place was driven, on average over its rows; once where there is none."""
        again = self._visits[self._visits > 1]
        return float(np.average(again, weights=self._rows)) if len(again) else 1.0

    def variance(self, angle: Array) -> float:
        """Variance, rad^2, of what `angle` (N,) rad, with a mean of about zero, has of the place.

        The mean product of two visits to one place, in which what differs from visit to visit cancels out; below zero
        where chance has it so, zero where no place was driven twice.
        """
        mean = np.bincount(self.visit, angle[self.order]) / np.bincount(self.visit)
        total, squares = np.bincount(self.place, mean), np.bincount(self.place, mean**2)
        visits, again = self._visits, self._visits > 1
        if not np.any(again):
            return 0.0
        product = (total[again] ** 2 - squares[again]) / (visits[again] * (visits[again] - 1))
        return float(np.average(product, weights=self._rows))

    @property
    def _visits(self) -> IntArray:
        """Number of visits to each place."""
        return np.bincount(self.place)

    @property
    def _rows(self) -> IntArray:
        """Number of rows at each place that was driven twice."""
        return np.asarray(np.bincount(self.place[self.visit])[self._visits > 1])


def _places(position_n: Array, velocity_n: Array) -> IntArray:
    """Number of the place of each row (N,): a square of CELL by CELL, driven through in one of DIRECTIONS."""
    course = np.arctan2(velocity_n[:, 1], velocity_n[:, 0])
    direction = np.mod(np.round(course * (DIRECTIONS / (2.0 * np.pi))), DIRECTIONS)
    where = np.column_stack([np.floor(position_n[:, :2] / CELL), direction])
    return np.asarray(np.unique(where, axis=0, return_inverse=True)[1].ravel(), dtype=np.int64)
