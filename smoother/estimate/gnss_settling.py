"""Fixes of a receiver that has just found its satellites: they come in from tens of metres off, by and by.

After a start, or after a tunnel, positions may drift to the truth for a minute while the velocity is right at once.
Taken for a slow error they would bend the rest of the session: no Gauss-Markov offset goes so far, so that the bias of
the velocity and the path would. Positions minus the integrated velocity show how fast the error of the fixes changes;
where it changes at the beginning by far more than it ever does later, the receiver had not settled.
"""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.estimate.gnss_screen import beside_dead_reckoning, running_median, unbroken_runs
from smoother.samples import Problem, Session
from smoother.words import counted, span

UNSETTLED = "gps_settling"  # code of the problem that says so
LATER = 20.0  # s over which a change is looked at: positions wander less in it than a receiver settles by
AVERAGED = 3.0  # s, by a median
SETTLING, SETTLINGS = 6.0, 3.0  # m, and times the usual change; a Gauss-Markov error does it in 2 runs of 1000
LEAST = 5.0  # s; what is over sooner is a jump, LATER or now
SETTLED = 1.2  # times the usual change, from which on a receiver wanders as it always does


def settled(session: Session) -> tuple[Session, tuple[Problem, ...]]:
    """Return the session without the positions of fixes before the receiver had settled, and what to say of it."""
    out = unsettled(session)
    if not out.any():
        return session, ()
    gnss = session.gnss
    lat_deg, lon_deg, alt_m = (np.where(out, np.nan, v) for v in (gnss.lat_deg, gnss.lon_deg, gnss.alt_m))
    text = (
        f"the receiver had not settled {_when(out)}: for {span(_lasts(gnss.t, out))} its positions came in from many "
        f"metres off, against the speed it measured; {counted(int(out.sum()), 'position')} left out. Switch it on a "
        "minute before driving"
    )
    return replace(session, gnss=replace(gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m)), (
        Problem(UNSETTLED, text, int(out.sum())),
    )


def unsettled(session: Session) -> BoolArray:
    """Mask (N,) of the fixes whose positions still drift to where they should be; none without Doppler."""
    t, position_n, velocity_n = session.gnss.t, session.fix_position_n[:, :2], session.gnss.velocity_n[:, :2]
    out = np.zeros(len(t), dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(position_n).all(axis=1) & np.isfinite(velocity_n).all(axis=1))
    runs = [rows for rows in unbroken_runs(t, known) if t[rows[-1]] - t[rows[0]] > 2.0 * LATER]
    if 2 * known.size < len(t) or not runs:
        return out
    changes = [_changes(t[rows], position_n[rows], velocity_n[rows]) for rows in runs]
    usual = median(np.concatenate(changes))
    for rows, change in zip(runs, changes, strict=True):
        if change[0] > max(SETTLING, SETTLINGS * usual):
            calm = np.flatnonzero(change <= SETTLED * usual)
            if calm.size and t[rows[calm[0]]] - t[rows[0]] > LEAST:
                out[rows[0] : rows[calm[0]]] = True
    return out


def _changes(t: Array, position: Array, velocity: Array) -> Array:
    """How far, m, the error of positions (M, 2) goes in the LATER s from each fix at t (M,) s on, of those that can."""
    interval = float(np.median(np.diff(t)))
    error = running_median(beside_dead_reckoning(t, position, velocity), min(AVERAGED / interval, len(t)))
    later = np.searchsorted(t, t + LATER)
    later = later[later < len(t)]
    return np.asarray(np.hypot(*(error[later] - error[: len(later)]).T))


def _when(mask: BoolArray) -> str:
    """When the receiver had not settled."""
    times = int(np.count_nonzero(np.diff(mask.astype(np.int8), prepend=0) > 0))
    if times > 1:
        return f"{times} times"
    return "at the start" if mask[0] else "after a gap"


def _lasts(t: Array, mask: BoolArray) -> float:
    """How long, s, the runs of true values last at t (N,) s, to the first that is false again."""
    after = np.append(t[1:], t[-1])
    return float(np.sum((after - t)[mask]))
