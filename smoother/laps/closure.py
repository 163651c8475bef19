"""Loop closure: on a closed track every lap passes the same line, so a lap that lies beside it shows an error.

Each lap has a translation against the line that all laps have in common. It is the mean error of the path over that lap
plus the driver's own scatter, which a jackknife over blocks of the track finds (`smoother.fit.lap_registration`). One
two-dimensional factor a lap says so. All of them together involve every keyframe of the session and are few:
eliminated last they are an update of the path by the joint covariance of its positions,

    path -= P H' (H P H' + N)^-1 z,    P -= P H' (H P H' + N)^-1 H P.

The mean over all laps is not observable: an error common to all of them stays. The trajectory itself keeps to the
fixes; laps, lines and their sigmas are those of the tied path.

Source: Gelb 1974, 4.2 (the update); Grisetti et al. 2010 (loop closure as a factor).
"""

from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array
from smoother.disc import roomy
from smoother.estimate.output.resample import between_rows, bracket, hermite, hermite_slope
from smoother.fit.lap_registration import LapRegistration, register_laps
from smoother.trajectory import JointPosition, Trajectory

MOST = 480  # times of a session, as long as laps have two


@dataclass(frozen=True, eq=False)
class LapClosure:
    """Correction of a path at times t (G,) s, level: moved_n (G, 2) m, and its rate of change faster_n (G, 2) m/s.

    gone (2G, 2G) m^2: by how much the covariance of the path shrinks, north of all times before west.
    """

    t: Array
    moved_n: Array
    faster_n: Array
    gone: Array

    def at(self, t: Array) -> tuple[Array, Array]:
        """Correction m and its rate of change m/s, (N, 2) each, at t (N,) s; constant before the first and after the
        last lap."""
        place = bracket(self.t, t)
        is_inside = (t >= self.t[0]) & (t <= self.t[-1])
        slope = hermite_slope(self.moved_n, self.faster_n, place)
        return hermite(self.moved_n, self.faster_n, place), np.where(is_inside[:, None], slope, 0.0)


@dataclass(frozen=True, eq=False)
class TiedLaps:
    """The JointPosition of a path whose laps are tied; joint: that of the path before."""

    joint: JointPosition
    closure: LapClosure

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        share = between_rows(np.eye(len(self.closure.t)), bracket(self.closure.t, t))
        share = np.concatenate([share * direction_n[:, :1], share * direction_n[:, 1:2]], axis=1)
        return np.asarray(self.joint.covariance(t, direction_n) - share @ self.closure.gone @ share.T)


def tie_laps(trajectory: Trajectory, joint: JointPosition) -> tuple[Trajectory, JointPosition]:
    """Return a trajectory with its laps tied to their common line, and its joint covariance.

    joint: of the trajectory as it is. Both as they are where there are fewer than four laps of one track.
    """
    laps = register_laps(trajectory.t, trajectory.position_n[:, :2])
    if laps is None:
        return trajectory, joint
    closure = close_laps(joint, laps)
    moved_n, faster_n = closure.at(trajectory.t)
    position_n, velocity_n = _plus(trajectory.position_n, moved_n), _plus(trajectory.velocity_n, faster_n)
    return replace(trajectory, position_n=position_n, velocity_n=velocity_n), TiedLaps(joint, closure)


def _plus(values: Array, level: Array) -> Array:
    """Values (N, 3) with (N, 2) added in the level, of a day on the disc."""
    out: Array = roomy(values.shape)
    out[:] = values
    out[:, :2] += level
    return out


def close_laps(joint: JointPosition, laps: LapRegistration) -> LapClosure:
    """Return what the translations of `laps` of a path show of its error, which has the covariance `joint`."""
    crossed = laps.crossing_time
    within = min(6, max(2, MOST // len(crossed)))  # times of a lap that stand for all of it
    at = np.nanquantile(crossed, (np.arange(within) + 0.5) / within, axis=1).T.ravel()
    P = joint.covariance(np.tile(at, 2), np.repeat(np.eye(3)[:2], len(at), axis=0))
    n = len(crossed)
    contrasts = np.linalg.svd(np.eye(n) - 1.0 / n)[0][:, : n - 1]  # free of the mean over all laps
    H = np.kron(np.eye(2), np.repeat(contrasts.T, within, axis=1) / within)
    HP = H @ P
    S = HP @ H.T + laps.noise**2 * np.eye(len(H))
    seen = (contrasts.T @ laps.translation_n).T.ravel()
    moved_n: Array = -(HP.T @ np.linalg.solve(S, seen)).reshape(2, -1).T
    gone = HP.T @ np.linalg.solve(S, HP)
    return LapClosure(at, moved_n, np.asarray(np.gradient(moved_n, at, axis=0)), gone)
