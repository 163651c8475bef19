"""A kart stays upright and points along its path: what holds attitudes where the gyroscope can not.

A gyroscope that engine and steering wheel shake by tens of deg/s, sampled too slowly for that, loses the attitude by
degrees within a tenth of a second. Gravity and accelerations would have to tell it ten times a second, and are then
turned to suit the fixes whatever the delay: delay and arm go with the noise of the turn rate, far beyond their sigmas.
A kart itself leans and slips by a few degrees. So roll, pitch and slip beyond what goes with acceleration are a random
walk of WANDER, much slower than such a gyroscope's and quicker than any kart's. Only their changes are asked for: how
the box lies in the kart, and where the nose is, remain what they are.

Gyroscopes that tell more than this are believed alone: up to STEADY nothing is asked, from UNSTEADY on all of it.
"""

import math

import numpy as np

from smoother.units import DEG

# rad/s/sqrt(Hz) of the rates about the motion: harsh simulated karts and real ones on the wheel have 2.4 to 3.2 deg/s,
# slow ones whose nose hardly shows, so that a slip would only hold it where it began, up to 4.3
STEADY, UNSTEADY = 5.0 * DEG, 8.0 * DEG


def unsteadiness(gyro: float) -> float:
    """Share, 0 to 1, in which a kart's own steadiness is asked for where rates have the density `gyro`, rad/s/sqrt(Hz).

    By and by, lest sessions that are nearly alike have two kinds of solution.
    """
    return float(np.clip(math.log(max(gyro, 1e-12) / STEADY) / math.log(UNSTEADY / STEADY), 0.0, 1.0))
