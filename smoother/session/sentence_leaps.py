"""Where the UTC of NMEA sentences was set by whole seconds in mid-file: the order of the file tells, not UTC.

A receiver that learns its leap seconds, or the time, goes on from one fix to the next, and only its clock steps. Where
it falls, times come again with other places: a line that was written twice has the same ones, and one out of order a
time that no other has. Where it leaps forwards, the kart moved by one step between two fixes, not by as many as would
be lost. Receive times before the sentences tell a fall too.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, median
from smoother.session.fix_columns import fix_columns, metres
from smoother.session.utc_leaps import leaps

QUANTUM = 1e-3  # s; times equal to a millisecond are one
MOST_SECONDS = 20  # by which a clock is set; 18 are the leap seconds since 2017
WHOLE = 0.1  # s; how near to whole seconds the step is, over one period that is not quite even
BESIDE = 5  # bursts on either side that go on evenly
EVEN = 3.5  # periods; up to three from burst to burst are even, since some are lost
LEAST_ODD = 0.5  # s from the usual step
BASE = 0.25  # s over which the velocity beside a step is taken, from one burst to at most four
LEAST_MOVED = 2.0  # m in the seconds of the step; a kart that stands does not tell
NOISE = 0.5  # m, by which a fix may be off the place where the last ones led to
BEND = 0.5  # of the way to it, likewise
CLEAR = 0.5  # of the way in the seconds of the step, which the place has to be nearer than
SAME_PLACE = 1e-9  # degrees
MOSTLY = 0.5


@dataclass(frozen=True, eq=False)
class _Bursts:
    """B bursts of sentences of one time and place, in file order: those that have a place.

    first, last (B,) are rows of their sentences; utc, received (B,) s, NaN where unknown; north, east (B,) m.
    """

    first: IntArray
    last: IntArray
    utc: Array
    received: Array
    lat_deg: Array
    lon_deg: Array
    north: Array
    east: Array


def clock_set_by(utc: Array, stream: IntArray, places: Array, received: Array) -> tuple[Array, int]:
    """By how much UTC (N,) s of sentences in file order is ahead (N,) s since it was set, against how it began.

    stream (N,) : talker and kind as a number. places (N, 2) : latitude and longitude in degrees, received (N,) s, both
    NaN where unknown. Returns also in how many places motion alone told it.
    """
    ahead = np.zeros(utc.size)
    if utc.size < 2 * BESIDE:
        return ahead, 0
    bursts = _bursts(utc, stream, places, received)
    known = np.isfinite(bursts.received)
    stamped = 2 * np.count_nonzero(known) > known.size
    steps = _by_stamps(bursts, np.flatnonzero(known)) if stamped else _by_motion(bursts)
    for burst, by in steps:
        ahead[_first_row(utc, bursts, burst) :] += by
    return ahead, 0 if stamped else len(steps)


def _bursts(utc: Array, stream: IntArray, places: Array, received: Array) -> _Bursts:
    number = _burst_of(utc, stream, places)
    first = np.flatnonzero(np.diff(number, prepend=-1))
    burst = np.cumsum(np.diff(number, prepend=-1) != 0) - 1
    last = np.append(first[1:], utc.size) - 1
    with_place = np.flatnonzero(np.all(np.isfinite(places), axis=1))[::-1]  # of several the first is written last
    place = np.full((first.size, 2), np.nan)
    place[burst[with_place]] = places[with_place]
    arrived = np.full(first.size, np.nan)
    np.fmin.at(arrived, burst, received)
    used = np.flatnonzero(np.isfinite(place[:, 0]))
    lat_deg, lon_deg = place[used].T
    north, east = metres(fix_columns(utc[first[used]], lat_deg, lon_deg))
    return _Bursts(first[used], last[used], utc[first[used]], arrived[used], lat_deg, lon_deg, north, east)


def _burst_of(utc: Array, stream: IntArray, places: Array) -> IntArray:
    """Number (N,), rising, of the burst of each sentence: a new time, or a kind once more with another place.

    With one fix a second a clock that is set back by one says the same second twice.
    """
    run = np.cumsum(np.diff(np.round(utc / QUANTUM), prepend=-1.0) != 0.0)
    kinds = int(stream.max()) + 1
    key = run * kinds + stream
    order = np.argsort(key, kind="stable")
    again = np.append(False, np.diff(key[order]) == 0)
    if not again.any():
        return run
    with np.errstate(invalid="ignore"):
        elsewhere = np.append(False, np.any(np.abs(np.diff(places[order], axis=0)) > SAME_PLACE, axis=1)) & again
    count = np.cumsum(elsewhere)
    group = np.cumsum(~again) - 1
    which = np.empty(utc.size, dtype=np.int64)
    which[order] = count - count[np.flatnonzero(~again)][group]
    return np.maximum.accumulate(run * (utc.size + 1) + which)


def _first_row(utc: Array, bursts: _Bursts, burst: int) -> int:
    """Row of the first sentence on the clock of a burst: those before it without a place may be on it too."""
    begin, end = int(bursts.last[burst - 1]) + 1, int(bursts.first[burst])
    between = utc[begin:end]
    nearer = np.abs(between - utc[end]) < np.abs(between - bursts.utc[burst - 1])
    return begin + int(np.argmax(nearer)) if nearer.any() else end


def _by_stamps(bursts: _Bursts, known: IntArray) -> list[tuple[int, float]]:
    """The bursts from which on UTC has fallen while receive times go on, and by what it leaps, s; known (K,) have one.

    UTC that leaps forwards does no harm here: such fixes stay in their order.
    """
    t, utc = bursts.received[known], bursts.utc[known]
    if t.size < 2 * BESIDE:
        return []
    steps = []
    for leap in leaps(t, utc):
        falls = -MOST_SECONDS - WHOLE < leap.by < 0.0 and utc[leap.row] - utc[leap.row - 1] < WHOLE
        if leap.set == "utc" and falls and t[leap.row] > t[leap.row - 1]:
            by = round(leap.by) if abs(leap.by - round(leap.by)) < WHOLE else leap.by
            steps.append((int(known[leap.row]), float(by)))
    return steps


def _by_motion(bursts: _Bursts) -> list[tuple[int, float]]:
    """The bursts from which on UTC was set while the kart went on, and by what, s."""
    step = np.diff(bursts.utc)
    if step.size < 2 * BESIDE or not np.any(step > 0.0):
        return []
    usual = median(step[step > 0.0])
    found: list[tuple[int, float]] = []
    for burst in np.flatnonzero(_may_be_set(step, usual)).tolist():
        if (by := _step_at(bursts, burst, usual)) is not None:
            found.append((burst, by))
    return found


def _may_be_set(step: Array, usual: float) -> BoolArray:
    """Mask (B,) of the bursts with an odd step of UTC before them and even ones beside it."""
    uneven = np.append(0, np.cumsum(~((step > 0.0) & (step < EVEN * usual))))
    mask = np.zeros(step.size + 1, dtype=np.bool_)
    row = np.arange(BESIDE, step.size + 2 - BESIDE)
    are_even = (uneven[row - 1] == uneven[row - BESIDE]) & (uneven[row + BESIDE - 1] == uneven[row])
    odd = (step[row - 1] <= 0.0) | (np.abs(step[row - 1] - usual) > LEAST_ODD)
    mask[row] = are_even & odd & (np.abs(step[row - 1]) < MOST_SECONDS + EVEN * usual)
    return mask


def _step_at(b: _Bursts, burst: int, usual: float) -> float | None:
    """By what whole seconds UTC was set before a burst, None if it was not."""
    utc_step = float(b.utc[burst] - b.utc[burst - 1])
    side = int(np.clip(round(BASE / usual), 1, BESIDE - 1))
    before, after = _velocity(b, burst - 1 - side, burst - 1), _velocity(b, burst, burst + side)
    speed = float(min(np.hypot(*before), np.hypot(*after)))
    for elapsed in (usual, 2.0 * usual, 3.0 * usual):  # some may be lost there, too
        by = float(round(utc_step - elapsed))
        if by == 0.0 or abs(utc_step - elapsed - by) > WHOLE or abs(by) > MOST_SECONDS:
            continue
        off = float(np.hypot(*(_way(b, burst - 1, burst) - 0.5 * elapsed * (before + after))))
        if off > NOISE + BEND * speed * elapsed:
            continue
        tells = speed * abs(by) > LEAST_MOVED and off < CLEAR * speed * abs(by)
        if by < 0.0:
            return by if _times_again(b, burst, by, usual) >= (1 if tells else BESIDE) else None
        if tells and np.dot(before, after) > 0.0:  # on the way back from a hairpin it is where it was seconds ago
            return by
    return None


def _way(b: _Bursts, first: int, last: int) -> Array:
    """From burst to burst, north and east (2,) m."""
    return np.array([b.north[last] - b.north[first], b.east[last] - b.east[first]])


def _velocity(b: _Bursts, first: int, last: int) -> Array:
    """From burst to burst, north and east (2,) m/s."""
    return np.asarray(_way(b, first, last) / (b.utc[last] - b.utc[first]))


def _times_again(b: _Bursts, burst: int, by: float, usual: float) -> int:
    """How many times from a burst on were before it too; 0 unless most within that were, and mostly at other places."""
    many = int(np.ceil((abs(by) + 1.0) / usual))
    old = np.arange(max(0, burst - 2 * many), burst)
    old = old[np.argsort(b.utc[old], kind="stable")]
    new = np.arange(burst, min(burst + many, b.utc.size))
    new = new[(b.utc[new] >= b.utc[old[0]] - QUANTUM) & (b.utc[new] <= b.utc[burst - 1] + QUANTUM)]
    right = np.clip(np.searchsorted(b.utc[old], b.utc[new]), 1, old.size - 1)
    is_left = b.utc[new] - b.utc[old[right - 1]] < b.utc[old[right]] - b.utc[new]
    twin = old[right - is_left]
    near = np.abs(b.utc[twin] - b.utc[new]) < usual
    same = np.hypot(b.lat_deg[twin] - b.lat_deg[new], b.lon_deg[twin] - b.lon_deg[new]) < SAME_PLACE
    again = int(np.count_nonzero(near))
    return again if again > MOSTLY * new.size and np.count_nonzero(near & same) < MOSTLY * again else 0
