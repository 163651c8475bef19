"""Long pauses in which neither samples nor fixes were written: a session is estimated with their middle cut out.

A chain of keyframes through a pause of an hour costs as much as an hour of driving, and its covariances exceed the
digits of a float. So time is closed up: a little of the pause is left on either side, and no state goes on from one
side to the other (:mod:`smoother.estimate.output.windows`).
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

LONGEST = 60.0  # s without anything that are bridged: as long as the slow error of the fixes lasts
LEFT = 30.0  # s, about, that are left of a pause: in that time a path can reach any place of the premises
BESIDE = 50  # fixes on either side that determine the phase of the grid of their spacing
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

    Samples without fixes in the middle of a pause are cut out with it.
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
    """Slices (P + 1) of times t (N,) s, rising, before, between and after the spans cut out."""
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

    In those the kart moves evenly from the last row before to the first one after. Its attitude is unknown, and its
    position as uncertain as both ends are far from each other.
    """
    out = pauses.are_cut_out(t)
    row = np.cumsum(~out) - 1  # the own one at or before each
    assert row[-1] + 1 == len(trajectory)
    before, own_t = row[out], t[~out]
    after = np.minimum(before + 1, len(own_t) - 1)
    lasts = (own_t[after] - own_t[before])[:, None]
    change = trajectory.position_n[after] - trajectory.position_n[before]

    def rows(values: Array, between: Array | float) -> Array:
        """Values (N, ...) of all rows: of own ones (M, ...), and those in between (N - M, ...)."""
        all_rows = roomy((len(t), *values.shape[1:]))
        for part in pieces(len(t)):
            all_rows[part] = values[row[part]]
            release(all_rows, values)
        all_rows[out] = between
        all_rows.flags.writeable = False
        return all_rows

    report, joint, sigmas = trajectory.report, trajectory.joint, trajectory.sigmas
    if report.keyframes is not None:
        report = replace(report, keyframes=replace(report.keyframes, t=pauses.opened(report.keyframes.t)))
    if sigmas is not None:
        larger = {name: np.maximum(values[before], values[after]) for name, values in vars(sigmas).items()}
        larger["position_n"] = np.hypot(larger["position_n"], change)
        larger["track"] = np.hypot(larger["track"], np.hypot(change[:, 0], change[:, 1]))
        larger["attitude"] = np.full_like(change, ANY_ANGLE)
        sigmas = Sigmas(**{name: rows(values, larger[name]) for name, values in vars(sigmas).items()})
    share = (t[out] - own_t[before])[:, None] / lasts
    return Trajectory(
        t,
        rows(trajectory.position_n, trajectory.position_n[before] + share * change),
        rows(trajectory.velocity_n, change / lasts),
        rows(trajectory.R_nb, trajectory.R_nb[before]),
        rows(trajectory.acceleration_b, 0.0),
        rows(trajectory.angular_rate_b, 0.0),
        sigmas,
        report,
        None if joint is None else Retimed(joint, pauses.closed),
    )
