"""How well a session tells its noise: by the residuals that were left of it, see `smoother.fit.noise_spread`."""

from collections.abc import Callable

import numpy as np

from smoother.arrays import Array
from smoother.estimate.graph.batch import Solved
from smoother.estimate.graph.inertial import VarianceComponent
from smoother.estimate.graph.inputs import Noise, Told
from smoother.estimate.graph.row_components import RowComponent
from smoother.estimate.graph.rows import Rows
from smoother.estimate.graph.state import OFFSET
from smoother.estimate.noise_of_fixes import hidden_wander
from smoother.fit.noise_spread import Residuals, of_force, of_positions, of_rate, of_velocities


def told_by(
    solved: Solved,
    noise: Noise,
    samples: tuple[VarianceComponent, VarianceComponent],
    fixes: tuple[RowComponent, RowComponent],
) -> Told:
    """Return how well `noise`, with which the graph was solved, is told by what is left of it in the residuals.

    samples: of force and rate; fixes: positions and velocities, of which those at rest may count for nothing.
    """
    force, rate = samples
    positions, velocities = fixes
    t, rows = solved.state.t, solved.rows["gps_position"]
    lasts = float(t[-1] - t[0])
    return Told(
        of_force(_in_time(force), has_doppler=_have_doppler(positions, velocities)),
        of_rate(_in_time(rate)),
        _per_axis(positions, of_positions),
        _per_axis(velocities, of_velocities),
        _wandered(rows, noise, solved.state.interval),
        hidden_wander(noise.position, noise.velocity, lasts / max(len(rows.residual), 1), lasts, noise.offset_tau),
    )


def _in_time(component: VarianceComponent) -> Residuals:
    return Residuals(component.squares_of, component.redundancy_of, 3.0 * len(component.squares_of))


def _per_axis(component: RowComponent, spread: Callable[[Residuals], float]) -> Array:
    """Sigma (3,) of the logarithm of the sigma of rows per axis, horizontal ones in common."""
    level, up = (_of_axes(component, axes) for axes in (slice(0, 2), slice(2, 3)))
    return np.array([spread(level)] * 2 + [spread(up)])


def _of_axes(component: RowComponent, axes: slice) -> Residuals:
    squares, expected = component.squares[:, axes], component.expected[:, axes]
    return Residuals(squares.sum(axis=1), expected.sum(axis=1), float(np.count_nonzero(expected)))


def _have_doppler(positions: RowComponent, velocities: RowComponent) -> bool:
    """Whether most fixes have a velocity that tells of force."""
    counts = (np.count_nonzero(component.expected[:, 0]) for component in (velocities, positions))
    return bool(next(counts) > 0.5 * next(counts))


def _wandered(positions: Rows, noise: Noise, interval: float) -> Array:
    """Variance (3,) m^2, in the mean over `positions`, of the offset about the line from keyframe to keyframe.

    A Gauss-Markov process is a random walk over an `interval`, s, that is much shorter than its time: between both ends
    it is away from the line between them by walk * interval * share * (1 - share), share being the part gone by.
    Source: the bridge of a Wiener process.
    """
    between = np.mean(positions.left[:, 0, OFFSET.start] * positions.right[:, 0, OFFSET.start])
    return np.asarray(2.0 * noise.offset_sigma**2 / noise.offset_tau * interval * between)
