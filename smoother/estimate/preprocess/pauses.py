"""Long pauses in which neither samples nor fixes were written: a session is estimated with their middle cut out.

Nothing tells what happens in a pause of an hour, and a chain of keyframes through it costs as much as an hour of
driving, with covariances that grow beyond the digits of a float. So time is closed up: a little of the pause is left on
either side, and what is estimated does not go on from one side to the other (:mod:`smoother.estimate.output.windows`).
Rows of the removed time keep the position of the kart, with a large sigma.
"""

from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.disc import pieces, release, roomy
from smoother.estimate.preprocess.clock import Retimed
from smoother.samples import Session
from smoother.trajectory import Sigmas, Trajectory
from smoother.units import ANY_ANGLE

LONGEST = 60.0  # s without anything that are bridged; the slow error of the fixes is forgotten after as long
LEFT = 30.0  # s, about, that are left of a pause: a path through the fixes can be anywhere on the premises after it
BESIDE = 50  # fixes on either side that tell how they fall on the grid of their spacing
COARSEST = 1.0  # s, of that grid; keyframes are closer


def _none() -> Array:
    return np.empty(0)


@dataclass(frozen=True, eq=False)
class Pauses:
    """Where time is cut out: cuts (P,) s, rising, on the closed time; removed (P,) s, how much of it there."""

    cuts: Array = field(default_factory=_none)
    removed: Array = field(default_factory=_none)

    def __len__(self) -> int:
        return len(self.cuts)

    @property
    def spans(self) -> Array:
        """From when to when time is cut out, on the session's clock, (P, 2) s; the end is no longer."""
        first = self.cuts + self._removed_until(np.arange(len(self)))
        return np.column_stack([first, first + self.removed])

    def opened(self, t: Array) -> Array:
        """Return closed times (N,) s on the session's clock."""
        return np.asarray(t + self._removed_until(np.searchsorted(self.cuts, t, side="right")))

    def closed(self, t: Array) -> Array:
        """Return times (N,) s of the session's clock on the closed time; those cut out are all at the cut."""
        passed = np.searchsorted(self.spans[:, 1], t, side="right")
        next_cut = np.append(self.cuts, np.inf)[passed]
        return np.asarray(np.minimum(t - self._removed_until(passed), next_cut))

    def are_cut_out(self, t: Array) -> BoolArray:
        """Mask (N,) of the times (N,) s of the session's clock that are cut out."""
        passed = np.searchsorted(self.spans[:, 1], t, side="right")
        return np.asarray(t >= np.append(self.spans[:, 0], np.inf)[passed])

    def between(self, t: Array) -> Array:
        """Seconds (K-1,) cut out between closed times t (K,), rising."""
        return np.diff(self._removed_until(np.searchsorted(self.cuts, t, side="right")))

    def stretches(self, t: Array) -> list[slice]:
        """Return which of the closed times t (N,), rising, lie between the cuts: P + 1 slices."""
        edges = [0, *np.searchsorted(t, self.cuts).tolist(), len(t)]
        return [slice(first, last) for first, last in pairwise(edges)]

    def _removed_until(self, count: IntArray) -> Array:
        """Seconds cut out by the first `count` (N,) cuts."""
        return np.asarray(np.append(0.0, np.cumsum(self.removed))[count])


NO_PAUSES = Pauses()


def pauses_of(session: Session) -> Pauses:
    """Return the long pauses of a session between its first and last fix, none without an inertial sensor.

    Samples alone in the midst of a pause tell no place, and are cut out with it.
    """
    if session.imu is None:
        return NO_PAUSES
    fixes, samples = session.gnss, session.imu.t
    cuts: list[float] = []
    removed: list[float] = []
    for i in np.flatnonzero(np.diff(fixes.t) > LONGEST).tolist():
        first, last = np.searchsorted(samples, fixes.t[[i, i + 1]])
        written = np.concatenate([fixes.t[[i]], samples[first:last], fixes.t[[i + 1]]])
        holes = np.flatnonzero(np.diff(written) > LONGEST)
        if len(holes):
            pause = float(written[holes[-1] + 1] - written[holes[0]])
            out = _removed(fixes.t, i, pause)
            cuts.append(float(written[holes[0]]) + 0.5 * (pause - out) - sum(removed))
            removed.append(out)
    return Pauses(np.array(cuts), np.array(removed)) if cuts else NO_PAUSES


def _removed(t: Array, i: int, pause: float) -> float:
    """How much, s, to cut out of the pause of `pause` s after the fix i of t (N,) s.

    After it the fixes go on as if there had been none: keyframes that lie on those before lie on those after it, too.
    """
    spacing = min(float(median(np.diff(t))), COARSEST)
    one, two = (
        float(np.angle(np.mean(np.exp(2j * np.pi * (beside - edge) / spacing))))
        for beside, edge in ((t[max(i + 1 - BESIDE, 0) : i + 1], t[i]), (t[i + 1 : i + 1 + BESIDE], t[i + 1]))
    )
    without = float(t[i + 1] - t[i])
    grid = without - spacing * (one - two) / (2.0 * np.pi)
    return grid - spacing * round((grid - (pause - LEFT)) / spacing)


def closed_up(session: Session, pauses: Pauses) -> Session:
    """Return the session without the pauses, on closed time. What was recorded in them is left out."""
    imu, mag, wheel = session.imu, session.mag, session.wheel_speed
    if imu is not None:
        keep = _outside(pauses, imu.t)
        force, rate = _kept(imu.specific_force_s, keep), _kept(imu.angular_rate_s, keep)
        imu = replace(imu, t=_kept(imu.t, keep, pauses.removed), specific_force_s=force, angular_rate_s=rate)
    if mag is not None:
        keep = _outside(pauses, mag.t)
        mag = replace(mag, t=_kept(mag.t, keep, pauses.removed), field_s=_kept(mag.field_s, keep))
    if wheel is not None:
        keep = _outside(pauses, wheel.t)
        wheel = replace(wheel, t=_kept(wheel.t, keep, pauses.removed), speed=_kept(wheel.speed, keep))
    gnss = replace(session.gnss, t=pauses.closed(session.gnss.t))
    return replace(session, gnss=gnss, imu=imu, mag=mag, wheel_speed=wheel)


def _outside(pauses: Pauses, t: Array) -> list[slice]:
    """Return which of the times t (N,) s, rising, are before, between and after the spans cut out: P + 1 slices."""
    edges = [0, *np.searchsorted(t, pauses.spans).ravel().tolist(), len(t)]
    return [slice(first, last) for first, last in zip(edges[0::2], edges[1::2], strict=True)]


def _kept(values: Array, keep: list[slice], removed: Array | None = None) -> Array:
    """Rows `keep` of values (N, ...), a piece at a time: a day of samples is in a file, and does not fit in memory.

    removed (P,): times removed between one slice and the next.
    """
    rows = roomy((sum(part.stop - part.start for part in keep), *values.shape[1:]))
    shifts = np.zeros(len(keep)) if removed is None else np.append(0.0, np.cumsum(removed))
    to = 0
    for part, shift in zip(keep, shifts, strict=True):
        for some in pieces(part.stop - part.start):
            count = some.stop - some.start
            rows[to : to + count] = values[part.start + some.start : part.start + some.stop] - shift
            to += count
            release(rows, values)
    rows.flags.writeable = False
    return rows


def opened_up(trajectory: Trajectory, pauses: Pauses, t: Array) -> Trajectory:
    """Return the trajectory of a closed session with rows at t (N,) s: its own, and those of the times cut out.

    In those the kart is on the line from the last row before to the first one after, and at either end for all that is
    known; it is as it stood, and points anywhere.
    """
    fill = _Filling.of(pauses, t)
    assert len(trajectory) == fill.own[-1].stop - sum(fill.lengths)
    report, joint, sigmas = trajectory.report, trajectory.joint, trajectory.sigmas
    if report.keyframes is not None:
        report = replace(report, keyframes=replace(report.keyframes, t=pauses.opened(report.keyframes.t)))
    ends = fill.ends(trajectory.position_n)
    apart = ends[:, 1] - ends[:, 0]
    lasts = np.array([t[min(part.stop, len(t) - 1)] - t[part.start - 1] for part in fill.out])[:, None]
    return Trajectory(
        t,
        fill.rows(trajectory.position_n, ends[:, 0], apart),
        fill.rows(trajectory.velocity_n, apart / lasts),
        fill.rows(trajectory.R_nb, fill.ends(trajectory.R_nb)[:, 0]),
        fill.rows(trajectory.acceleration_b, np.zeros_like(apart)),
        fill.rows(trajectory.angular_rate_b, np.zeros_like(apart)),
        None if sigmas is None else _opened_sigmas(sigmas, fill, apart),
        report,
        None if joint is None else Retimed(joint, pauses.closed),
    )


def _opened_sigmas(sigmas: Sigmas, fill: "_Filling", apart: Array) -> Sigmas:
    """Sigmas of all rows: in the times cut out the larger ones of both ends, which are `apart` (P, 3) m."""
    larger = {name: fill.ends(values).max(axis=1) for name, values in vars(sigmas).items()}
    larger["position_n"] = np.hypot(larger["position_n"], apart)
    larger["track"] = np.hypot(larger["track"], np.hypot(apart[:, 0], apart[:, 1]))
    larger["attitude"] = np.full_like(apart, ANY_ANGLE)
    return Sigmas(**{name: fill.rows(values, larger[name]) for name, values in vars(sigmas).items()})


@dataclass(frozen=True, eq=False)
class _Filling:
    """Which of N rows are a trajectory's own, P + 1 slices, and which are cut out between them, P slices."""

    own: list[slice]
    out: list[slice]

    @staticmethod
    def of(pauses: Pauses, t: Array) -> "_Filling":
        """For rows at t (N,) s. Pauses that no row falls into have none."""
        own = _outside(pauses, t)
        return _Filling(own, [slice(one.stop, two.start) for one, two in pairwise(own)])

    @property
    def lengths(self) -> list[int]:
        """How many rows are cut out in each of the pauses."""
        return [part.stop - part.start for part in self.out]

    def ends(self, values: Array) -> Array:
        """The last of the rows `values` (N - M, ...) before each pause and the first one after it, (P, 2, ...)."""
        first = np.cumsum([part.stop - part.start for part in self.own])[:-1]
        return np.asarray(values[np.stack([first - 1, np.minimum(first, len(values) - 1)], axis=1)])

    def rows(self, values: Array, between: Array, change: Array | None = None) -> Array:
        """Values (N, ...) of all rows: of (N - M, ...) values, and in each pause those `between` (P, ...).

        change (P, ...): what is added to that evenly on the way to the other end.
        """
        rows, at = roomy((self.own[-1].stop, *values.shape[1:])), 0
        for part in self.own:
            for some in pieces(part.stop - part.start):
                count = some.stop - some.start
                rows[part.start + some.start : part.start + some.stop] = values[at : at + count]
                at += count
                release(rows, values)
        for k, part in enumerate(self.out):
            for some in pieces(length := part.stop - part.start):
                way = np.arange(some.start + 1, some.stop + 1) / (length + 1)
                moved = 0.0 if change is None else np.multiply.outer(way, change[k])
                rows[part.start + some.start : part.start + some.stop] = between[k] + moved
                release(rows)
        rows.flags.writeable = False
        return rows
