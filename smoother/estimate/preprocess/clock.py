"""The samples' clock against that of the fixes: an offset, a drift, and as few steps as the lags ask for.

One box stamps both by one clock. Others count samples at their nominal rate, which a sensor's own oscillator keeps to a
per cent, or stamp fixes by the receiver's UTC; a logger loses samples and counts on, stalls, or joins two files; a
phone's radio takes longer from some moment on. All of these are one clock that is a line with steps, and shift the lags
of forward force, left force and yaw rate alike. What shifts one of them or two is slip, lean, or a wheel.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePath

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.disc import pieces, release, roomy
from smoother.samples import Problem, Session
from smoother.trajectory import ClockMove, Identified, JointPosition

Change = Callable[[Array], Array]

CLOCK_OFFSET = "clock_offset"  # code of the problem that says so
UNPLACED = 20.0  # s; a step whose moment is known no better is not taken out: an outage as long costs less
USUAL_DRIFT = 5e-5  # of a quartz against GPS, beforehand
DELAYS = ("gps_position_latency", "gps_velocity_latency")


@dataclass(frozen=True)
class ClockStep:
    """From `t` s on, by the clock of the fixes, they are `size` s later behind the samples than before.

    It was between `first` and `last` s. move: what takes it out.
    """

    t: float
    size: float
    sigma: float
    first: float
    last: float
    move: ClockMove

    @property
    def is_placed(self) -> bool:
        """Whether the moment is known well enough to take the step out."""
        return self.last - self.first <= UNPLACED


@dataclass(frozen=True)
class Clock:
    """offset s that the samples' clock is ahead of that of the fixes at `zero` s, and drift, s per s, that it gains.

    Offset is but for the delay of a receiver. drifts: whether the drift is significant, and taken out.
    """

    offset: float = 0.0
    drift: float = 0.0
    drift_sigma: float = math.inf
    drifts: bool = False
    zero: float = 0.0
    steps: tuple[ClockStep, ...] = ()

    @property
    def moves(self) -> tuple[ClockMove, ...]:
        """What takes steps out; those that are not placed stay."""
        return tuple(step.move for step in self.steps if step.is_placed)

    def does_as(self, other: "Clock") -> bool:
        """Whether both take out the same."""
        return (self.offset, self.drift * self.drifts, self.moves) == (
            other.offset,
            other.drift * other.drifts,
            other.moves,
        )

    def and_beyond(
        self, drift: float, sigma: float, steps: tuple[ClockStep, ...], session: Session, *, is_drifting: bool
    ) -> "Clock":
        """Return this clock with what was found of a session from which it was taken out."""
        steps = tuple(replace(step, move=self._as_given(step.move)) for step in steps)
        zero = float(session.gnss.t[0]) if self == ONE_CLOCK else self.zero
        if self.drifts and not is_drifting:
            return replace(self, drift_sigma=sigma, steps=self.steps + steps)
        both = (1.0 + self.drift * self.drifts) * (1.0 + drift) - 1.0
        return Clock(self.offset, both, sigma, is_drifting, zero, self.steps + steps)

    def not_beyond(self, other: "Clock") -> "Clock":
        """Return this clock, knowing of its drift what another one did, which was wrong."""
        drift = self.drift if self.drifts else other.drift
        return replace(self, drift=drift, drift_sigma=other.drift_sigma)

    def _as_given(self, move: ClockMove) -> ClockMove:
        """A move of times from which this clock was taken out, of those as given."""
        if move.moves_fixes:
            return move
        return replace(move, at=self.zero + self.offset + (move.at - self.zero) * (1.0 + self.drift * self.drifts))

    def taken_out(self, session: Session) -> Session:
        """Return a session as given on one clock, that of its fixes."""
        session = moved(session, self.moves)
        if self.offset == 0.0 and not self.drifts:
            return session
        return with_samples_at(session, partial(_of_fixes, clock=self))

    def unsure(self, t: Array) -> BoolArray:
        """Mask (N,) of the fixes at t (N,) s, as given, that came before or after a step, nobody knows which."""
        out = np.zeros(len(t), dtype=np.bool_)
        for step in self.steps:
            out |= step.is_placed & (t > step.first) & (t < step.last)
        return out

    def identified(self) -> Identified:
        """What to report of the drift, ppm: what was taken out, or 0 and how far off that may be."""
        if self.drifts:
            return Identified(1e6 * self.drift, 1e6 * self.drift_sigma, "ppm", True, "identified")
        shown = math.hypot(self.drift, self.drift_sigma)
        sigma = 1.0 / math.hypot(1.0 / shown, 1.0 / USUAL_DRIFT) if shown > 0.0 else USUAL_DRIFT
        return Identified(0.0, 1e6 * sigma, "ppm", False, "default")

    def on_both_sides(self, identified: dict[str, Identified]) -> dict[str, Identified]:
        """What was identified, with latencies as unsure as of a session put together at steps known so well.

        Of a step that was not taken out the latency is half of it off on either side.
        """
        off = 0.5 * math.sqrt(sum(step.sigma**2 if step.is_placed else step.size**2 for step in self.steps))
        return identified | {name: _less_sure(identified[name], off) for name in DELAYS if name in identified}

    def problems(self, session: Session) -> tuple[Problem, ...]:
        """What was found, and what was done, of a session as given."""
        return (*self._offset_problems(), *self._drift_problems(session), *_step_problems(self.steps, session))

    def _offset_problems(self) -> tuple[Problem, ...]:
        if self.offset == 0.0:
            return ()
        text = (
            f"the samples' clock is {abs(self.offset):.1f} s {'ahead of' if self.offset > 0.0 else 'behind'} that of "
            "the fixes; taken out, so that times are those of the fixes and delays are what is left"
        )
        return (Problem(CLOCK_OFFSET, text),)

    def _drift_problems(self, session: Session) -> tuple[Problem, ...]:
        if not self.drifts:
            return ()
        runs = "fast" if self.drift > 0.0 else "slow"
        apart = abs(self.drift) * float(session.gnss.t[-1] - session.gnss.t[0])
        text = (
            f"the samples' clock runs {1e6 * abs(self.drift):.0f} ppm {runs} against that of the fixes, "
            f"{apart:.2f} s over the session; taken out"
        )
        return (Problem("clock_drift", text),)


ONE_CLOCK = Clock()


def _of_fixes(t: Array, clock: Clock) -> Array:
    """Times t (N,) s of the samples on the clock of the fixes."""
    return np.asarray(clock.zero + (t - clock.offset - clock.zero) / (1.0 + clock.drift * clock.drifts))


def _less_sure(value: Identified, off: float) -> Identified:
    return replace(value, sigma=math.hypot(value.sigma, off)) if isinstance(value.sigma, float) else value


def _step_problems(steps: tuple[ClockStep, ...], session: Session) -> tuple[Problem, ...]:
    return tuple(Problem("clock_step", _text(step, session)) for step in steps)


def _text(step: ClockStep, session: Session) -> str:
    file, of_it = ("gps.csv", "fixes") if step.move.moves_fixes else ("imu.csv", "samples")
    named = f"{file}: " if any(PurePath(name).name == file for name in session.inputs) else ""
    text = (
        f"{named}{step.t - float(session.gnss.t[0]):.1f} s after the first fix stamps step: from there on fixes come "
        f"{abs(step.size):.2f} ± {step.sigma:.2f} s {'later' if step.size > 0.0 else 'earlier'} behind the samples"
    )
    if step.is_placed:
        return f"{text}; taken out of the times of the {of_it}. With columns of your own, stamp both by one clock"
    lasts = step.last - step.first
    return f"{text}, sometime in {lasts:.0f} s, so it is not taken out. Smooth what is before and after each for itself"


# Times that change


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
