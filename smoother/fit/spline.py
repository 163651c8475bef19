"""Cubic splines through points, closed or open.

SciPy has them too, in a package that takes longer to import than all laps of a session take to be analysed.
"""

import numpy as np

from smoother.arrays import Array

ITERATIONS = 50  # each at least halves the error, whatever the spacing: the neighbours weigh half of the middle


class CubicSpline:
    """The curve through points that is twice continuously differentiable.

    An open one has one cubic over the first two intervals and one over the last two (not-a-knot); a closed one goes on
    from its last point, which equals the first, as it left it.
    Source: de Boor, A Practical Guide to Splines, chapter IV.
    """

    def __init__(self, x: Array, values: Array, *, is_closed: bool = False) -> None:
        """x (K,) increasing, K >= 4; values (K, c)."""
        self._x, self._values = x, values
        self._bend = _bend_of_closed(x, values) if is_closed else _bend_of_open(x, values)

    def __call__(self, x: Array, derivative: int = 0) -> Array:
        """Value, or first derivative, at x (N,), within the points. Returns (N, c)."""
        k = np.clip(np.searchsorted(self._x, x, side="right") - 1, 0, len(self._x) - 2)
        h = (self._x[k + 1] - self._x[k])[:, None]
        right = (x - self._x[k])[:, None] / h
        left, low, high = 1.0 - right, self._values[k], self._values[k + 1]
        bend_low, bend_high = self._bend[k], self._bend[k + 1]
        if derivative == 0:
            bent = (left**3 - left) * bend_low + (right**3 - right) * bend_high
            return np.asarray(left * low + right * high + bent * h**2 / 6.0)
        bent = (3.0 * right**2 - 1.0) * bend_high - (3.0 * left**2 - 1.0) * bend_low
        return np.asarray((high - low) / h + bent * h / 6.0)


def _bend_of_closed(x: Array, values: Array) -> Array:
    """Second derivative (K, c) at each point."""
    after = np.diff(x)
    before = np.roll(after, 1)
    slope = np.diff(values, axis=0) / after[:, None]
    wanted = 3.0 * (slope - np.roll(slope, 1, axis=0)) / (before + after)[:, None]
    by_before, by_after = (0.5 * part[:, None] / (before + after)[:, None] for part in (before, after))
    bend = wanted
    for _ in range(ITERATIONS):
        bend = wanted - by_before * np.roll(bend, 1, axis=0) - by_after * np.roll(bend, -1, axis=0)
    return np.concatenate([bend, bend[:1]])


def _bend_of_open(x: Array, values: Array) -> Array:
    """Second derivative (K, c) at each point; that of either end is on the line through the next two."""
    h = np.diff(x)
    before, after = h[:-1].copy(), h[1:].copy()
    middle = 2.0 * (before + after)
    wanted = 6.0 * np.diff(np.diff(values, axis=0) / h[:, None], axis=0)
    for near, far, i in ((before, after, 0), (after, before, -1)):  # the ends, put into the equations beside them
        middle[i] += near[i] * (1.0 + near[i] / far[i])
        far[i] -= near[i] ** 2 / far[i]
        near[i] = 0.0
    wanted, by_before, by_after = (part.reshape(len(h) - 1, -1) / middle[:, None] for part in (wanted, before, after))
    bend = np.zeros((len(x), values.shape[1]))
    for _ in range(ITERATIONS):
        bend[1:-1] = wanted - by_before * bend[:-2] - by_after * bend[2:]
    bend[0] = bend[1] - h[0] / h[1] * (bend[2] - bend[1])
    bend[-1] = bend[-2] + h[-1] / h[-2] * (bend[-2] - bend[-3])
    return bend
