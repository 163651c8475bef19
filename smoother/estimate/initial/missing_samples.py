"""What the inertial samples would have been where they are missing, as far as the fixes and the samples beside tell.

Force and rate of a kart that follows the path of the fixes, level and nose ahead, plus what the samples at both edges
of the hole differ from that, which is forgotten within half a second: a line from edge to edge in short holes, the path
in long ones. A single sample at an edge would be mostly vibration. How far off that may be is for
:func:`smoother.estimate.model.inertial_noise.interval_noise` to say, from how long nothing told of the motion.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.estimate.gnss_path import GnssPath
from smoother.estimate.initial.align import Alignment
from smoother.estimate.path_motion import MIN_SPEED
from smoother.samples import GnssFixes, ImuSamples
from smoother.units import STANDARD_GRAVITY

EDGE = 0.1  # s of samples beside a hole that are averaged; an engine turns ten times in it
FORGOTTEN = 0.5  # s after which a kart's force and rate no longer say what they will be
TOLD = 0.2, 0.4  # s in which fixes with a speed tell a mean acceleration, and a turn: a nose slides to and fro as well
SPACINGS = 0.5, 1.0  # of such fixes, likewise
WITHOUT_SPEEDS = 4.0  # times as long, where positions alone tell it


@dataclass(frozen=True, eq=False)
class MissingSamples:
    """Samples for holes of `imu`, from the path of the fixes `gnss`.

    latency s: the path's time of what the sensor felt at t is t + latency. A stated latency is taken out of the path's
    times, and not of the stamps of the fixes.
    """

    imu: ImuSamples
    path: GnssPath
    alignment: Alignment
    latency: float
    gnss: GnssFixes

    def at(self, t: Array) -> tuple[Array, Array]:
        """Force, m/s^2, and rate, rad/s, at t (M,) s in holes; each (M, 3) in s."""
        out = self._by_path(t) + self._beside(t)
        return out[:, :3], out[:, 3:]

    def blind(self, t: Array, hole: Array) -> Array:
        """How long nothing tells of force and rate between the keyframes t (K,), which lie in holes of `hole` (K-1,) s.

        Returns (K-1, 2) s. Fixes tell both of a kart that drives, and the force at any speed.
        """
        middle = 0.5 * (t[:-1] + t[1:]) + self.latency
        between = self._between_fixes(middle + self.path.position_latency)
        force, rate = (
            np.minimum(hole, np.maximum(*figures))
            for figures in zip(TOLD, np.multiply.outer(SPACINGS, between), strict=True)
        )
        velocity_n = self.path.at(middle).velocity_n
        turns = (np.hypot(velocity_n[:, 0], velocity_n[:, 1]) > MIN_SPEED) & (not self.alignment.is_level_only)
        return np.column_stack([force, np.where(turns, rate, hole)])

    def _between_fixes(self, t: Array) -> Array:
        """Time from the fix stamped before t (N,) s to the one after it, (N,) s, of those with a speed if any has."""
        speeds = np.isfinite(self.gnss.velocity_n[:, 0])
        fixes, count = (self.gnss.t[speeds], 1.0) if np.any(speeds) else (self.gnss.t, WITHOUT_SPEEDS)
        after = np.clip(np.searchsorted(fixes, t), 1, len(fixes) - 1)
        return np.asarray(count * (np.maximum(fixes[after], t) - np.minimum(fixes[after - 1], t)))

    def _by_path(self, t: Array) -> Array:
        """Force and rate (M, 6) in s of a level kart on the path; of one at rest where its nose may point anywhere."""
        motion = self.path.at(t + self.latency)
        (vx, vy), (ax, ay) = motion.velocity_n[:, :2].T, motion.acceleration_n[:, :2].T
        speed = np.hypot(vx, vy)
        told = (speed > MIN_SPEED) & (not self.alignment.is_level_only)
        forward, left = (
            (told * part) / np.maximum(speed, MIN_SPEED) for part in (vx * ax + vy * ay, vx * ay - vy * ax)
        )
        turn = left / np.maximum(speed, MIN_SPEED)
        zero, R_bs = np.zeros_like(turn), self.alignment.R_bs
        force_b = np.column_stack([forward, left, zero + STANDARD_GRAVITY])
        return np.hstack([force_b @ R_bs, np.column_stack([zero, zero, turn]) @ R_bs + self.alignment.gyro_bias_s])

    def _beside(self, t: Array) -> Array:
        """What the edges of the holes differ by from the path, carried to t (M,) s in them: (M, 6)."""
        times = self.imu.t
        ends, hole = np.unique(np.searchsorted(times, t), return_inverse=True)  # the sample that ends each hole
        before, after = np.maximum(ends - 1, 0), np.minimum(ends, len(times) - 1)
        since, until = t - times[before][hole], times[after][hole] - t
        share = np.clip(since / np.maximum(times[after] - times[before], 1e-9)[hole], 0.0, 1.0)
        share[(ends == 0)[hole]], share[(ends == len(times))[hole]] = 1.0, 0.0  # nothing on the other side
        fades = [np.exp(-np.maximum(passed, 0.0) / FORGOTTEN) for passed in (since, until)]
        last = self._differences(np.searchsorted(times, times[before] - EDGE), before + 1)
        first = self._differences(after, np.searchsorted(times, times[after] + EDGE, side="right"))
        return np.asarray(((1.0 - share) * fades[0])[:, None] * last[hole] + (share * fades[1])[:, None] * first[hole])

    def _differences(self, first: IntArray, last: IntArray) -> Array:
        """Means of the samples first to last (H,), exclusive, less those of the path, (H, 6)."""
        count = last - first
        begin = np.cumsum(count) - count
        samples = np.arange(int(count.sum())) + np.repeat(first - begin, count)
        measured = np.hstack([self.imu.specific_force_s[samples], self.imu.angular_rate_s[samples]])
        return np.asarray(np.add.reduceat(measured - self._by_path(self.imu.t[samples]), begin) / count[:, None])
