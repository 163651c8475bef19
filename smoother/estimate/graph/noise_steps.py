"""Steps of a session's noise from turn to turn, which come to rest where full ones go to and fro.

A step of scoring counts on residuals that answer to a change of the noise as those of white noise do. Where velocities
are much better than the samples between them, those of real karts answer twice as strongly and more: full steps jump
over the place where the two agree, for ever, and where they end is luck.
"""

import numpy as np

from smoother.estimate.graph.inputs import LEVELS_SIZE, Noise

BACK, ONWARD = 0.5, 1.2  # of the step before, the most by which a level turns back, and goes on once it turned back
LEAST = 0.02  # of a logarithm, that it may always go


class NoiseSteps:
    """The steps of one noise; each of its densities and sigmas is free until it turns back for the first time.

    Source: the step sizes of Rprop, Riedmiller & Braun 1993.
    """

    def __init__(self) -> None:
        self._before, self._most = np.zeros(LEVELS_SIZE), np.full(LEVELS_SIZE, np.inf)

    def towards(self, better: Noise, noise: Noise) -> Noise:
        """Return `better`, or what lies as far towards it from `noise`, where the step before ended, as it may go."""
        step = better.step_from(noise)
        turned = step * self._before < 0.0
        near = np.maximum(np.where(turned, BACK, ONWARD) * np.abs(self._before), LEAST)
        self._most = np.where(turned | np.isfinite(self._most), near, np.inf)
        self._before = np.clip(step, -self._most, self._most)
        return better.moved_by(self._before - step)
