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
        bend = _bend_of_closed(x, values) if is_closed else _bend_of_open(x, values)
        h = np.diff(x)[:, None]
        slope = np.diff(values, axis=0) / h - h * (2.0 * bend[:-1] + bend[1:]) / 6.0
        self._x = x
        powers = (values[:-1], slope, 0.5 * bend[:-1], np.diff(bend, axis=0) / (6.0 * h))
        self._powers = np.ascontiguousarray(np.stack(powers).transpose(0, 2, 1))  # (4, c, K - 1)

    def __call__(self, x: Array) -> Array:
        """Value (N, c) at x (N,), within the points."""
        d, powers = self._piece(x)
        return _value(d, *powers).T

    def with_slope(self, x: Array) -> tuple[Array, Array]:
        """Value and first derivative, each (N, c), at x (N,), within the points."""
        d, powers = self._piece(x)
        value, (_, linear, quadratic, slope) = _value(d, *powers), powers
        slope *= 3.0  # in place from here on, as in _value: long arrays cost more to come by than to multiply
        slope *= d
        quadratic *= 2.0
        slope += quadratic
        slope *= d
        slope += linear
        return value.T, slope.T

    def integral(self) -> Array:
        """Integral (K, c) from the first of the points to each."""
        h, (constant, linear, quadratic, cubic) = np.diff(self._x), self._powers
        pieces = h * (constant + h * (linear / 2.0 + h * (quadratic / 3.0 + h * cubic / 4.0)))
        return np.concatenate([np.zeros((1, len(pieces))), np.cumsum(pieces.T, axis=0)])

    def _piece(self, x: Array) -> tuple[Array, Array]:
        """Distance (N,) from the point before x (N,), and the coefficients (4, c, N) of its powers there."""
        k = np.clip(np.searchsorted(self._x, x, side="right") - 1, 0, len(self._x) - 2)
        return x - self._x[k], self._powers.take(k, axis=2)


def _value(d: Array, constant: Array, linear: Array, quadratic: Array, cubic: Array) -> Array:
    """The cubics (c, N) at d (N,)."""
    value = cubic * d
    value += quadratic
    value *= d
    value += linear
    value *= d
    value += constant
    return value


def _bend_of_closed(x: Array, values: Array) -> Array:
    """Second derivative (K, c) at each point."""
    after = np.diff(x)
    before = np.roll(after, 1)
    slope = np.diff(values, axis=0) / after[:, None]
    wanted = 3.0 * (slope - np.roll(slope, 1, axis=0)) / (before + after)[:, None]
    by_before, by_after = (_beside(0.5 * part / (before + after), wanted) for part in (before, after))
    bend = np.concatenate([wanted[-1:], wanted, wanted[:1]])  # with the neighbours of both ends
    for _ in range(ITERATIONS):
        bend[1:-1] = wanted - by_before * bend[:-2] - by_after * bend[2:]
        bend[0], bend[-1] = bend[-2], bend[1]
    return bend[1:].copy()


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
    wanted = wanted / middle[:, None]
    by_before, by_after = (_beside(part / middle, wanted) for part in (before, after))
    bend = np.zeros((len(x), values.shape[1]))
    for _ in range(ITERATIONS):
        bend[1:-1] = wanted - by_before * bend[:-2] - by_after * bend[2:]
    bend[0] = bend[1] - h[0] / h[1] * (bend[2] - bend[1])
    bend[-1] = bend[-2] + h[-1] / h[-2] * (bend[-2] - bend[-3])
    return bend


def _beside(factor: Array, values: Array) -> Array:
    """The factor (K,) for each of the values (K, c): numpy multiplies arrays of one shape twice as fast."""
    return np.repeat(factor, values.shape[1]).reshape(values.shape)
