"""Force and rate of one time: an accelerometer that is late behind its gyroscope, taken to the gyroscope's time.

Which of the two is late by how much against the world, the samples do not tell; the GPS delays that are identified
afterwards are therefore those against the gyroscope.
"""

import math
from dataclasses import replace

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces, release, roomy
from smoother.fit.force_delay import ForceDelay, force_delay
from smoother.samples import ImuSamples, Session
from smoother.trajectory import Identified

# s, beforehand: sensors of one chip, as loggers have them, are within 3 ms by its filters, which
# is what the sigmas of the GPS delays count on. (Of two chips it may be ten times that, and then those are off by it.)
USUAL = 3e-3


def in_step(session: Session) -> tuple[Session, ForceDelay]:
    """Return the session with its force at the time of its rate, and what was found; as it is where nothing was.

    Its stamps are as unsure as that leaves them (:attr:`ForceDelay.unsure`).
    """
    assert session.imu is not None
    imu = session.imu
    found = force_delay(imu.t, imu.specific_force_s, imu.angular_rate_s)
    if found.is_found:
        imu = advanced(imu, found.delay)
    if found.unsure > 0.0:
        imu = replace(imu, stamp_sigma=math.hypot(imu.stamp_sigma, found.unsure))
    return session if imu is session.imu else replace(session, imu=imu), found


def advanced(imu: ImuSamples, delay: float) -> ImuSamples:
    """Return the samples with the force of `delay` s later; at the last ones, that have none, what is there last.

    Between samples by cubics with slopes from the samples on either side, which at 25 Hz keep 98 % of what changes four
    times a second where straight lines keep 88 %; beside a gap the force stays near what it is at the edge.
    """
    force = roomy(imu.specific_force_s.shape)
    for part in pieces(len(imu.t)):
        force[part] = _cubic(imu.t, imu.specific_force_s, np.clip(imu.t[part] + delay, imu.t[0], imu.t[-1]))
        release(imu, force)
    return replace(imu, specific_force_s=force)


def _cubic(t: Array, values: Array, at: Array) -> Array:
    """Values (M, c) at times `at` (M,) within t (N,), of `values` (N, c). Source: Catmull & Rom 1974.

    Stamps may be uneven: slopes are those of the chords from neighbour to neighbour, which beside a gap are gentle.
    """
    k = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 2, len(t) - 1)
    step = t[k + 1] - t[k]
    u = ((at - t[k]) / step)[:, None]
    first, second = values[k], values[k + 1]
    rise = (second - values[before]) * (step / (t[k + 1] - t[before]))[:, None]
    later_rise = (values[after] - first) * (step / (t[after] - t[k]))[:, None]
    change = second - first
    bend, twist = 3.0 * change - 2.0 * rise - later_rise, rise + later_rise - 2.0 * change
    return np.asarray(first + u * (rise + u * (bend + u * twist)))


def identified(found: ForceDelay) -> Identified:
    """What to report: the delay taken out; 0 where there is none, and how far off that may be."""
    if found.is_found:
        return Identified(found.delay, found.sigma, "s", True, "identified")
    told = math.hypot(found.delay, found.sigma) if found.is_seen else math.inf
    sigma = 1.0 / math.hypot(1.0 / told, 1.0 / USUAL) if told > 0.0 else USUAL
    return Identified(0.0, sigma, "s", sigma < 0.5 * USUAL, "default")
