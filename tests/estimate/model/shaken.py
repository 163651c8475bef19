"""A box that cones and sculls on top of a drive, in closed form, and the samples that an ideal sensor gives of it."""

from collections.abc import Callable

import numpy as np

from smoother.frames import rotation_from_euler
from smoother.samples import ImuSamples

NO_BIAS = np.zeros(3)
Motion = Callable[[np.ndarray], np.ndarray]


class Shaken:
    """Coning and sculling at one frequency on top of a drive: attitude and force in s, closed form.

    Roll and pitch swing a quarter of a period apart, so that the box cones; the force shakes in step with the roll,
    so that the mean of the force in n is not the force of the mean.
    """

    def __init__(self, frequency: float, swing: float, shake: float, turn: float = 0.6) -> None:
        self.w, self.swing, self.shake, self.turn = 2.0 * np.pi * frequency, swing, shake, turn

    def attitude(self, t: np.ndarray) -> np.ndarray:
        return rotation_from_euler(
            self.swing * np.sin(self.w * t), self.swing * np.cos(self.w * t), self.turn * t + 0.2 * np.sin(t)
        )

    def rate_s(self, t: np.ndarray) -> np.ndarray:
        roll, pitch = self.swing * np.sin(self.w * t), self.swing * np.cos(self.w * t)
        d_roll, d_pitch = self.w * self.swing * np.cos(self.w * t), -self.w * self.swing * np.sin(self.w * t)
        d_yaw = self.turn + 0.2 * np.cos(t)
        return np.stack(
            [
                d_roll - d_yaw * np.sin(pitch),
                d_pitch * np.cos(roll) + d_yaw * np.cos(pitch) * np.sin(roll),
                d_yaw * np.cos(pitch) * np.cos(roll) - d_pitch * np.sin(roll),
            ],
            axis=-1,
        )

    def force_s(self, t: np.ndarray) -> np.ndarray:
        steady = np.stack([2.0 * np.sin(0.7 * t), 5.0 * np.cos(0.4 * t), np.full(t.shape, 9.8)], axis=-1)
        return steady + self.shake * np.stack([np.cos(self.w * t), np.sin(self.w * t), np.sin(self.w * t)], axis=-1)

    def samples(self, rate: float, start: float, end: float) -> ImuSamples:
        """Means over the interval that ends at each time, as an ideal sensor gives them."""
        t = np.arange(round(start * rate) + 1, round(end * rate) + 1) / rate
        return ImuSamples(t, mean(self.force_s, t, 1.0 / rate), mean(self.rate_s, t, 1.0 / rate))

    def velocity_gain(self, t0: float, t1: float) -> tuple[np.ndarray, np.ndarray]:
        """Integrals of the force in axes of s at t0: velocity and position gained without gravity, by quadrature."""
        n = 20_000
        h = (t1 - t0) / n
        middle = t0 + h * (np.arange(n) + 0.5)
        start = self.attitude(np.array([t0]))[0]
        acceleration = np.einsum("ji,njk,nk->ni", start, self.attitude(middle), self.force_s(middle))
        return acceleration.sum(axis=0) * h, ((t1 - middle)[:, None] * acceleration).sum(axis=0) * h


def mean(function: Motion, end: np.ndarray, width: float | np.ndarray) -> np.ndarray:
    """Mean of `function` over `width` before `end`, by Gauss-Legendre on eight pieces: exact to rounding here."""
    nodes, weights = np.polynomial.legendre.leggauss(4)
    parts = [
        function(end - width * (i + 0.5 - 0.5 * x) / 8.0) * w / 16.0
        for i in range(8)
        for x, w in zip(nodes, weights, strict=True)
    ]
    return np.sum(parts, axis=0)
