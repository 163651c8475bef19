"""What is left of each kind of factor in a solved graph, in a few figures: whether its noise was taken as it is.

Rows have residuals in units of their own. Those of the IMU factors, whose errors of rotation, position and velocity are
correlated, are whitened: in sigmas.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from smoother.arrays import Array
from smoother.estimate.factors.graph import TABLE
from smoother.estimate.factors.rows import Rows
from smoother.trajectory import WHITENED, ResidualStatistics

INERTIAL = {"inertial": slice(0, 9), "bias_walk": slice(9, 15)}  # rotation, position and velocity; biases
REJECTED_WEIGHT = 0.1  # a fix whose robust weight is below this counts as rejected


def row_statistics(rows: Mapping[str, Rows]) -> dict[str, ResidualStatistics]:
    """Return what is left of the kinds of rows that were measured, by their names."""
    return {name: _of_rows(rows[name], unit) for factor in TABLE for name, unit in factor.units.items() if name in rows}


def inertial_statistics(rows: Rows, intervals: slice) -> dict[str, ResidualStatistics]:
    """Return what is left of the IMU factors of some intervals, whitened rows of 15, by the names of INERTIAL."""
    first, end = intervals.start or 0, np.inf if intervals.stop is None else intervals.stop
    use = (rows.interval >= first) & (rows.interval < end)
    return {name: _whitened(rows.residual[use, part]) for name, part in INERTIAL.items()}


def joined(parts: Sequence[Mapping[str, ResidualStatistics]]) -> dict[str, ResidualStatistics]:
    """Return what is left of the IMU factors of several parts of a session."""
    out = {}
    for name in INERTIAL:
        own = [part[name] for part in parts if name in part]
        counts = np.array([one.count for one in own])
        if counts.sum():
            mean = float(np.average([one.mean for one in own], weights=counts))
            rms = float(np.sqrt(np.average([one.rms**2 for one in own], weights=counts)))
            out[name] = ResidualStatistics(WHITENED, int(counts.sum()), mean, rms, rms, 0)
    return out


def _whitened(residual: Array) -> ResidualStatistics:
    """Of residuals (n, r) in sigmas; none of them is rejected."""
    if residual.size == 0:
        return ResidualStatistics(WHITENED, 0, 0.0, 0.0, 0.0, 0)
    rms = float(np.sqrt(np.mean(residual**2)))
    return ResidualStatistics(WHITENED, len(residual), float(np.mean(residual)), rms, rms, 0)


def _of_rows(rows: Rows, unit: str) -> ResidualStatistics:
    known = np.isfinite(rows.sigma)
    residual = rows.residual[known]
    if residual.size == 0:
        return ResidualStatistics(unit, 0, 0.0, 0.0, 0.0, 0)
    weight = np.broadcast_to(rows.weight[:, None], known.shape)[known]
    normalised = residual / rows.sigma[known] * np.sqrt(weight)
    return ResidualStatistics(
        unit,
        int(np.count_nonzero(np.any(known, axis=1))),
        float(np.average(residual, weights=weight)),
        float(np.sqrt(np.average(residual**2, weights=weight))),
        float(np.sqrt(np.mean(normalised**2))),
        int(np.count_nonzero(rows.weight < REJECTED_WEIGHT)),
    )
