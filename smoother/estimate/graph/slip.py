"""Wheels roll along and hardly sideways: where the path points in the kart, as a Gauss-Markov process.

It ties the turn about up, which inertial sensor and fixes tell only where the kart speeds up or slows down, to the
direction of the path, and in an outage the path to the turns. What slip has in common is among the session's constants:
how the axes of the alignment are turned in the kart, what goes with lateral acceleration and with its rate, and what
goes with curvature, since only the rear axle does not move sideways. The rest is the process; how much a corner differs
from another grows with how hard it is taken.

No slip is asked for before a solution without it was seen to agree (:func:`slip_noise`): a box on the steering wheel
turns with the hands, a loose one anyhow.
"""

import math
from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array
from smoother.units import DEG

MEMORY = 2.0  # s; a corner's worth
# Of the sigma that is found: that of how much corners differ, of what shows less, since its constants take over what
# they have in common, to what shows more, since tyres that answer late differ too; and rad. 90 karts with as much as
# nobody has seen, drawn at random, had rms 0.7 of that (benchmarks/random_karts.py, draws 1600 to 1689).
UNLIKE = 0.5, 5e-3
MOST = 4.0 * DEG  # of anything that is fixed to a chassis on wheels
ANY_SLIP = 0.5 * MOST  # how much it differs from corner to corner, beforehand
SLIP_COUNT = 5.0  # residuals that say that slip is FIRST
DIFFERENT = 12.0  # corners of a track, each of which has a slip of its own
ROUND_IT, OUT_OF_IT = 0.6, 0.3  # of a hard corner's lateral acceleration, between which one corner becomes another
FIT_SIGMA = 1.0 * DEG  # of a keyframe's slip about what the constants say, where these are fitted to a solution without
# Sigmas of the constants: rad, rad per m/s^2, rad per m/s^3, m. Cars had -0.004 to -0.007 rad per m/s^2, -0.001 to
# -0.003 rad per m/s^3, and the rear axle 1.2 m behind the box.
PRIOR = np.array([0.5, 0.01, 2e-3, 1.0])


@dataclass(frozen=True, eq=False)
class SlipNoise:
    """What is assumed of the slip. sigma rad of its process at HARD, no less than `least`; unsure, rad^2, is what
    attitudes of a solution without wheels leave unsure of it, in the mean.

    moments (4, 4): means of the products of slopes by its constants, over `different` times that are not alike. apart,
    rad: how far the nose, as the mean of all slip has it, is from where the process of the slip has it. shown: how many
    independent residuals tell `sigma`.
    """

    sigma: float
    least: float
    unsure: float
    moments: Array
    different: float
    apart: float = 0.0
    shown: float = 0.0

    @property
    def unsure_sigma(self) -> float:
        """Sigma, rad, of `sigma`, by how far it was from what simulated karts were given: see :data:`UNLIKE`."""
        guessed = SLIP_COUNT / (SLIP_COUNT + self.shown)
        return math.hypot(UNLIKE[0] * self.sigma, UNLIKE[1], guessed * ANY_SLIP)

    @property
    def nose_variance(self) -> float:
        """Variance, rad^2, of where the nose is, by what the constants miss of the slip in the same way in every lap.

        The process forgets in seconds, and a hundred laps would tell the nose ten times as well as one. But tyres are
        not linear, and a driver takes a corner in his way: what is missed comes back lap after lap. A track that turns
        to one side tells the nose by drawing a line on from its corners to none; how far off that is, is in here.

        The process believes how slip changes, a mean how much of it there is. Where the constants say all, both have
        the nose in one place (simulated karts: to 0.03 deg); where tyres answer late or not in proportion, not.
        """
        information = self.different * self.moments / self.sigma**2 + np.diag(PRIOR**-2.0)
        return float(np.linalg.inv(information)[0, 0]) + self.apart**2


def tells_nose(variance: float) -> bool:
    """Whether the slip that is always there, known to `variance` rad^2, says where the nose points."""
    return bool(variance < (0.5 * PRIOR[0]) ** 2)


def corners(lateral: Array) -> int:
    """How often a kart went into a corner, by its lateral accelerations (N,) m/s^2; a steady circle is one."""
    part = lateral / max(float(np.percentile(np.abs(lateral), 90)), 1e-9)
    turns = np.where(np.abs(part) > ROUND_IT, np.sign(part), 0.0)
    turns = turns[(turns != 0.0) | (np.abs(part) < OUT_OF_IT)]
    return max(1, int(np.count_nonzero((np.diff(turns, prepend=0.0) != 0.0) & (turns != 0.0))))
