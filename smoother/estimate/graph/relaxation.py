"""How much of its steps a session's constants go, so that they come to rest where full ones swing to and fro.

Some columns of the graph are no derivatives, and slopes are made of what is being solved: of a box whose samples fit
the drive badly, a full step goes too far by as much as it was to go and more, turn for turn.
"""

import numpy as np

from smoother.arrays import Array
from smoother.estimate.graph.chain import ChainSolution
from smoother.estimate.graph.state import POSITION_LATENCY, VELOCITY_LATENCY, VELOCITY_RESPONSE

LATENCIES = slice(POSITION_LATENCY.start, VELOCITY_LATENCY.stop)
SWINGING = slice(POSITION_LATENCY.start, VELOCITY_RESPONSE.stop)  # of the constants: all that rows multiply motion by
TURNED = 0.3  # of the step before, from which on one that goes back is a swing
HALF = 0.5  # of a step of latencies that turn back once, as with few fixes, whose errors the samples bend
SWINGS = 2  # one after another, that are no chance: a better noise turns a step back too
NEAR = 0.25  # of a sigma, rms: what swings by less is at rest
LEAST, ONWARD = 0.1, 1.5  # share of the steps of what swings, and its growth where they go on


class Relaxation:
    """The share that is gone of each step of one solution, whole until something turns back.

    Source: the secant through two steps of all constants, each over its sigma (Irons & Tuck 1969, "A version of the
    Aitken accelerator for computer iteration").
    """

    def __init__(self) -> None:
        self._step: Array | None = None
        self._share, self._damped, self._swings = 1.0, 1.0, 0

    def share(self, solution: ChainSolution) -> float:
        """Return the share, 0 to 1, to be gone of the step of `solution`, which comes after those asked for before."""
        step, last = solution.constants[SWINGING], self._step
        if last is not None:
            sigma = np.sqrt(np.diag(solution.constants_covariance)[SWINGING])
            self._swings = self._swings + 1 if _turns(step / sigma, last / sigma) else 0
            self._share = self._next_share(step, last, sigma)
        self._step = step
        return self._share

    def _next_share(self, step: Array, last: Array, sigma: Array) -> float:
        if self._swings >= SWINGS and float(np.mean((step / sigma) ** 2)) > NEAR**2:
            change = (last - step) / sigma
            secant = float(last / sigma @ change) / float(change @ change)
            self._damped = max(LEAST, min(self._damped, self._share * secant))
            return self._damped
        self._damped = min(1.0, ONWARD * self._damped)
        turns = _turns(step[LATENCIES], self._share * last[LATENCIES])
        return min(self._damped, HALF if turns else 1.0)


def _turns(step: Array, last: Array) -> bool:
    """Whether a step goes back by nearly as much as the last one went on."""
    return bool(-float(step @ last) > TURNED * float(last @ last) > 0.0)
