"""Where time was lost: the largest real losses, and the differences in driving there.

Where no loss is real, the likeliest are ranked and marked as uncertain: those above their own sigma, by the excess.

A difference is listed if it is beyond two sigma, in the direction that loses time: braked earlier, or slower into, in
or out of the corner. It accompanies the loss and need not be its cause.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from smoother.arrays import Array
from smoother.laps.results import Corner, LapAnalysis

MOST, FEW = 5, 3  # that are shown: real ones, uncertain ones; the table has all

Kind = Literal["braking", "entry", "minimum", "exit"]


@dataclass(frozen=True)
class Difference:
    """A difference from the reference lap: `by` m earlier (braking) or m/s slower, and its sigma."""

    kind: Kind
    by: float
    sigma: float


@dataclass(frozen=True)
class Loss:
    """A real loss: lap, index in `LapAnalysis.laps`; the corner; s lost and its sigma; the differences."""

    lap: int
    corner: Corner
    lost: float
    sigma: float
    differences: tuple[Difference, ...]


def largest_losses(laps: LapAnalysis, most: int = MOST) -> tuple[Loss, ...]:
    """Return the largest real losses, largest first."""
    found = [loss for loss in _losses(laps) if loss.corner.is_real[loss.lap]]
    return tuple(sorted(found, key=lambda loss: -loss.lost)[:most])


def likely_losses(laps: LapAnalysis, most: int = FEW) -> tuple[Loss, ...]:
    """Return the likeliest losses, by loss minus sigma, where none is real; else nothing."""
    found = list(_losses(laps))
    if any(loss.corner.is_real[loss.lap] for loss in found):
        return ()
    return tuple(sorted((x for x in found if x.lost > x.sigma), key=lambda loss: loss.sigma - loss.lost)[:most])


def _losses(laps: LapAnalysis) -> Iterator[Loss]:
    """All losses of the laps that are compared, real or not, whose sigma is known."""
    for corner in laps.corners:
        for i, lap in enumerate(laps.laps):
            lost, sigma = float(corner.time_lost[i]), float(corner.time_lost_sigma[i])
            if lap.is_comparable and lost > 0.0 and (corner.is_real[i] or sigma > 0.0):
                yield Loss(i, corner, lost, sigma, _differences(corner, i, laps))


def _differences(corner: Corner, lap: int, laps: LapAnalysis) -> tuple[Difference, ...]:
    """Differences of lap `lap` from the reference lap in a corner; none where that is of another session."""
    reference = laps.reference_lap
    if reference is None:
        return ()

    def by(kind: Kind, values: Array, sigma: Array) -> Difference:
        less = float(values[reference] - values[lap])
        return Difference(kind, less, float(np.hypot(sigma[reference], sigma[lap])))

    all_of_them = (
        by("braking", corner.braking_point, corner.braking_sigma),
        by("entry", corner.entry_speed, corner.entry_speed_sigma),
        by("minimum", corner.min_speed, corner.min_speed_sigma),
        by("exit", corner.exit_speed, corner.exit_speed_sigma),
    )
    return tuple(each for each in all_of_them if each.by > 2.0 * each.sigma)  # sigmas
