"""Times on another clock: of what a session has measured, and of the joint covariance of what is asked of it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release, roomy
from smoother.samples import Session
from smoother.trajectory import ClockMove, JointPosition

Change = Callable[[Array], Array]


def with_samples_at(session: Session, change: Change) -> Session:
    """Return the session with the times of its inertial samples and of its other sensors changed; fixes stay."""
    imu, mag, wheel = session.imu, session.mag, session.wheel_speed
    return replace(
        session,
        imu=None if imu is None else replace(imu, t=_changed(imu.t, change)),
        mag=None if mag is None else replace(mag, t=_changed(mag.t, change)),
        wheel_speed=None if wheel is None else replace(wheel, t=_changed(wheel.t, change)),
        channels=tuple(replace(channel, t=_changed(channel.t, change)) for channel in session.channels),
    )


def moved(session: Session, moves: tuple[ClockMove, ...]) -> Session:
    """Return the session with the times of samples and fixes moved; the same where there are no moves."""
    fixes, samples = (tuple(move for move in moves if move.moves_fixes == which) for which in (True, False))
    if samples:
        session = with_samples_at(_without_late(session, samples), partial(_moved, moves=samples))
    return replace(session, gnss=replace(session.gnss, t=_moved(session.gnss.t, fixes))) if fixes else session


def _without_late(session: Session, moves: tuple[ClockMove, ...]) -> Session:
    """The session without readings of magnetometer, wheel and channels that a move takes behind later ones."""
    mag, wheel = session.mag, session.wheel_speed
    if mag is not None and len(mag.t):
        keep = _in_order(mag.t, moves)
        mag = replace(mag, t=mag.t[keep], field_s=mag.field_s[keep])
    if wheel is not None and len(wheel.t):
        keep = _in_order(wheel.t, moves)
        wheel = replace(wheel, t=wheel.t[keep], speed=wheel.speed[keep])
    kept = [(channel, _in_order(channel.t, moves)) for channel in session.channels if len(channel.t)]
    channels = tuple(replace(channel, t=channel.t[keep], values=channel.values[keep]) for channel, keep in kept)
    return replace(session, mag=mag, wheel_speed=wheel, channels=channels)


def _in_order(t: Array, moves: tuple[ClockMove, ...]) -> BoolArray:
    """Mask (N,) of the times t (N,) s that come before all later ones when they are moved."""
    t = _moved(t, moves)
    return np.asarray(t < np.append(np.minimum.accumulate(t[::-1])[::-1][1:], np.inf))


def _moved(t: Array, moves: tuple[ClockMove, ...]) -> Array:
    """Times t (N,) s moved by those of their moves that are before them."""
    return np.asarray(t + sum(move.by * (t > move.at) for move in moves))


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
