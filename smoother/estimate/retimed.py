"""Times on another clock: of what a session has measured, and of the joint covariance of what is asked of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace

from smoother.arrays import Array
from smoother.disc import pieces, release, roomy
from smoother.samples import Session
from smoother.trajectory import JointPosition

Change = Callable[[Array], Array]


def with_samples_at(session: Session, change: Change) -> Session:
    """Return the session with the times of its inertial samples and its magnetometer's changed; fixes stay."""
    imu, mag = session.imu, session.mag
    return replace(
        session,
        imu=None if imu is None else replace(imu, t=_changed(imu.t, change)),
        mag=None if mag is None else replace(mag, t=_changed(mag.t, change)),
    )


def _changed(t: Array, change: Change) -> Array:
    """Times (N,) s changed, a piece at a time: those of a day are in a file."""
    out = roomy(t.shape)
    for part in pieces(len(t)):
        out[part] = change(t[part])
        release(t, out)
    return out


@dataclass(frozen=True, eq=False)
class Retimed:
    """A JointPosition that is asked on another clock; `own` takes times of that to those of the joint."""

    joint: JointPosition
    own: Change

    def covariance(self, t: Array, direction_n: Array) -> Array:
        """See :class:`smoother.trajectory.JointPosition`."""
        return self.joint.covariance(self.own(t), direction_n)
