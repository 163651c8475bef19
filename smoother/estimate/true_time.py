"""Sessions whose clock is off by more than any crystal: estimated in true seconds, with times told in their own.

The receiver's UTC shows it. Metres per wrong second would be wrong velocities, and forces that do not fit the path.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from smoother.arrays import Array
from smoother.estimate.preprocess.clock import Retimed, with_samples_at
from smoother.samples import GnssFixes, Problem, Session
from smoother.trajectory import Trajectory
from smoother.utc_clock import UtcClock

CRYSTAL = 2e-3  # more is not the drift of a crystal, which is small enough to be left alone
BEYOND_BELIEF = 0.1  # more is not a clock
FEWEST_FIXES, SHORTEST = 50, 20.0  # s
ENOUGH = 200  # fixes, evenly taken
STEADY = 0.05  # s; how far typical fixes may lie off the line
WORTH_SAYING = 3e-4  # 16 ms of a lap of 53 s, as much as lap times are unsure; crystals are better than that
READABLE = 0.06  # s over a session, which stamps that jitter by some ms show


def clock_scale(session: Session) -> float:
    """Return how many seconds of the session pass in a true one; 1 where its clock is good, or nothing tells."""
    slope, _ = _against_utc(session)
    return slope if CRYSTAL < abs(slope - 1.0) < BEYOND_BELIEF else 1.0


def utc_clock(session: Session, smoothed: Trajectory) -> UtcClock | None:
    """UTC of the motion, from the first row on, which is to the millisecond as results store it.

    None where nothing tells it. Wherever a time of day is shown it is reckoned from here, so that it is the same in all
    places. A receiver says when a fix was true, and the clock of the session stamps it when it comes: later by the
    delay, where the session tells that.
    """
    if (stamped := clock_of_fixes(session)) is None:
        return None
    start, late = float(smoothed.t[0]), 0.0
    latency = smoothed.report.identified.get("gps_position_latency")
    if latency is not None and latency.observable and isinstance(latency.value, float) and _is_told(session.gnss):
        late = latency.value
    return UtcClock(start, round(stamped.at(start) + late, 3), stamped.rate)


def clock_of_fixes(session: Session) -> UtcClock | None:
    """UTC at which fixes were true, by their stamps; None where nothing tells it."""
    unix_s, t = session.gnss.unix_s, session.gnss.t
    if unix_s is None or not _is_told(session.gnss):
        return None if session.unix_at_zero is None else UtcClock(0.0, session.unix_at_zero)
    slope, _ = _against_utc(session)
    rate = 1.0 / slope if abs(slope - 1.0) < BEYOND_BELIEF else 1.0
    return UtcClock(float(t[0]), float(np.nanmedian(unix_s - rate * (t - t[0]))), rate)


def _is_told(fixes: GnssFixes) -> bool:
    """Whether fixes say when they were true."""
    return fixes.unix_s is not None and bool(np.isfinite(fixes.unix_s).any())


def clock_problems(session: Session) -> tuple[Problem, ...]:
    """What is to be said of a clock that makes laps look longer or shorter than they were."""
    slope, lasts = _against_utc(session)
    off = abs(slope - 1.0)
    if not max(WORTH_SAYING, READABLE / lasts) < off < BEYOND_BELIEF:
        return ()
    runs = f"{100.0 * off:.2g} % {'fast' if slope > 1.0 else 'slow'}"
    mended = "; taken out of speeds and places" if off > CRYSTAL else ""
    text = f"the recording's clock runs {runs} against the receiver's UTC{mended}; t_s and lap times are in its seconds"
    return (Problem("clock_scale", f"{text}, of which a minute has {60.0 * slope:.2f}"),)


def _against_utc(session: Session) -> tuple[float, float]:
    """Seconds of the session in one of UTC, and how many of UTC it lasts; (1, infinite) where nothing tells."""
    unix_s, t = session.gnss.unix_s, session.gnss.t
    if unix_s is None:
        return 1.0, np.inf
    known = np.flatnonzero(np.isfinite(unix_s))
    if known.size < FEWEST_FIXES or abs(unix_s[known[-1]] - unix_s[known[0]]) < SHORTEST:
        return 1.0, np.inf
    some = known[:: -(-known.size // ENOUGH)]
    utc, t = unix_s[some] - unix_s[some[0]], t[some]
    slope = _slope(utc, t)
    rest = t - slope * utc
    scatter = float(np.median(np.abs(rest - np.median(rest))))
    return (slope, float(abs(utc[-1]))) if scatter < STEADY else (1.0, np.inf)


def _slope(x: Array, y: Array) -> float:
    """Median slope of all pairs of points with different x. Source: Sen 1968."""
    i, j = np.triu_indices(x.size, 1)
    apart = np.abs(x[j] - x[i]) > 1.0
    return float(np.median((y[j] - y[i])[apart] / (x[j] - x[i])[apart])) if apart.any() else 1.0


def in_true_time(session: Session, scale: float) -> Session:
    """Return the session with its times in true seconds since its zero."""
    change = partial(np.multiply, 1.0 / scale)
    return replace(with_samples_at(session, change), gnss=replace(session.gnss, t=change(session.gnss.t)))


def in_session_time(trajectory: Trajectory, scale: float) -> Trajectory:
    """Return the trajectory with its times on the clock of the session; all else stays in true seconds."""
    report, joint = trajectory.report, trajectory.joint
    if report.keyframes is not None:
        report = replace(report, keyframes=replace(report.keyframes, t=report.keyframes.t * scale))
    if joint is not None:
        joint = Retimed(joint, partial(np.multiply, 1.0 / scale))
    return replace(trajectory, t=trajectory.t * scale, report=report, joint=joint)
