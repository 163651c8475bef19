"""Fixes of a receiver that has just found its satellites, which converge from tens of metres.

After a start, or after a tunnel, positions may drift to the truth for a minute while the velocity is right at once.
Taken for a slow error they would bend the rest of the session: no Gauss-Markov offset goes so far, so that the bias of
the velocity and the path would. Positions minus the integrated velocity show how the error of the fixes changes. Where
it changes in the first minutes by far more than it ever does later, and for good, the receiver had not settled; an
error that comes and goes is another matter.
"""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.estimate.fixes.screen import beside_dead_reckoning, has_velocities, running_median, unbroken_runs
from smoother.samples import Problem, Session
from smoother.words import counted, span

UNSETTLED = "gps_settling"  # code of the problem that says so
LATER = 20.0  # s over which a change is looked at: positions wander less in it than a receiver settles by
AVERAGED = 3.0  # s, by a median
SETTLING, SETTLINGS = 6.0, 3.0  # m, and times the usual change; a Gauss-Markov error does it in 2 runs of 1000
LEAST = 5.0  # s; what is over sooner is a jump, LATER or now
STEPWISE = 0.7  # of the whole change within LEAST s: a step, as of false Doppler, and no settling
LOST = 5.0  # s without fixes, in which a receiver may lose its satellites; a shorter hole is one of the recording
EARLY = 120.0  # s, in which a receiver settles
FEWEST = 200  # fixes later than that, from which on they alone tell what is usual
COMES_AND_GOES = 0.1  # of the time: calm while it comes in, or as far astray after: an error that comes again and again
SETTLED = 1.2  # times the usual change, from which on a receiver wanders as it always does


def unsettled(session: Session) -> BoolArray:
    """Mask (N,) of the fixes whose positions still drift to where they should be; none without Doppler.

    A receiver may measure its velocity less often than its positions, but for most of the time it has to.
    """
    t, position_n, velocity_n = session.gnss.t, session.fix_position_n[:, :2], session.gnss.velocity_n[:, :2]
    out = np.zeros(len(t), dtype=np.bool_)
    known = np.flatnonzero(np.isfinite(position_n).all(axis=1) & has_velocities(velocity_n))
    unbroken = unbroken_runs(t, known)
    runs = [rows for rows in unbroken if t[rows[-1]] - t[rows[0]] > 2.0 * LATER]
    if 2 * sum(int(rows[-1] - rows[0]) + 1 for rows in unbroken) < len(t) or not runs:
        return out
    errors = [_error(t[rows], position_n[rows], velocity_n[rows]) for rows in runs]
    changes = [_changes(t[rows], error) for rows, error in zip(runs, errors, strict=True)]
    late = [change[t[rows[: len(change)]] - t[rows[0]] > EARLY] for rows, change in zip(runs, changes, strict=True)]
    usual = median(np.concatenate(late if sum(map(len, late)) > FEWEST else changes))
    for rows, error, change in zip(runs, errors, changes, strict=True):
        if rows[0] == known[0] or t[rows[0]] - t[known[known < rows[0]][-1]] >= LOST:
            out[rows[0] : rows[_settled_at(t[rows], error, change, usual)]] = True
    return out


def without_positions(session: Session, out: BoolArray) -> Session:
    """Return the session with the positions of the fixes `out` (N,) unknown, their velocities as they are."""
    gnss = session.gnss
    lat_deg, lon_deg, alt_m = (np.where(out, np.nan, v) for v in (gnss.lat_deg, gnss.lon_deg, gnss.alt_m))
    return replace(session, gnss=replace(gnss, lat_deg=lat_deg, lon_deg=lon_deg, alt_m=alt_m))


def settling_problems(t: Array, out: BoolArray) -> tuple[Problem, ...]:
    """Say so where positions of fixes at t (N,) s were left out."""
    if not out.any():
        return ()
    text = (
        f"the receiver had not settled {_when(out)}: for {span(_lasts(t, out))} its positions came in from many "
        f"metres off, against the speed it measured; {counted(int(out.sum()), 'position')} left out. Switch it on a "
        "minute before driving"
    )
    return (Problem(UNSETTLED, text, int(out.sum())),)


def _far(lasts: float, usual: float) -> float:
    """How far, m, an error has to go in so many s, for one that wanders by `usual` m in LATER s not to do it."""
    return max(SETTLING, SETTLINGS * usual * float(np.sqrt(max(1.0, lasts / LATER))))


def _settled_at(t: Array, error: Array, change: Array, usual: float) -> int:
    """Index of the first fix of a receiver that has settled, at t (M,) s with errors (M, 2) m; 0 if it always had.

    change (K,) m in the LATER s from each of the first K on, of which `usual` m is the session's median.
    """
    is_far, is_calm = change > max(SETTLING, SETTLINGS * usual), change <= SETTLED * usual
    early = np.flatnonzero(is_far & (t[: len(change)] - t[0] < EARLY))
    calm = np.flatnonzero(is_calm)
    calm = calm[calm > early[-1]] if early.size else calm[:0]
    if not calm.size or t[calm[0]] - t[0] < LEAST:
        return 0
    if max(np.mean(is_far[calm[0] :]), np.mean(is_calm[early[0] : early[-1] + 1])) > COMES_AND_GOES:
        return 0
    far = _far(float(t[calm[0]] - t[0]), usual)
    total = float(np.hypot(*(error[calm[0]] - error[0])))
    soon = np.minimum(np.searchsorted(t, t[: calm[0]] + LEAST), len(t) - 1)
    at_once = float(np.max(np.hypot(*(error[soon] - error[: calm[0]]).T)))
    return int(calm[0]) if total > far and at_once < STEPWISE * total else 0


def _error(t: Array, position: Array, velocity: Array) -> Array:
    """Errors (M, 2) m of positions (M, 2) m at t (M,) s, but for a constant, steadied."""
    interval = float(np.median(np.diff(t)))
    return running_median(beside_dead_reckoning(t, position, velocity), min(AVERAGED / interval, len(t)))


def _changes(t: Array, error: Array) -> Array:
    """How far, m, errors (M, 2) m go in the LATER s from each fix at t (M,) s on, of those that can."""
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
