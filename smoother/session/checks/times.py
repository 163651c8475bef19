"""Checks of times: dates, UTC against the stamps of the rows, gaps, and what of a recording runs together."""

import datetime as dt
import time
from collections.abc import Iterator
from functools import partial

import numpy as np

from smoother.arrays import Array, median
from smoother.samples import IMU_AFTER_FIXES, IMU_BEFORE_FIXES
from smoother.session.checks.table import Check, Finding
from smoother.session.clock import LARGEST_DRIFT, are_fix_gaps
from smoother.session.recorded import Recording
from smoother.session.utc_leaps import leaps
from smoother.units import DAY
from smoother.words import counted, span

ROLLOVER = 1024.0 * 7.0 * DAY  # s; GPS sends its week as ten bits, and the firmware of old receivers guesses the rest
OLD = 1262304000.0  # s since 1970, the year 2010: recordings before it are rarer than receivers that lost count
EARLIEST = 1420070400.0  # s since 1970, the year 2015: an older recording of an even older receiver is as likely real
AHEAD = 366.0 * DAY  # s by which the clock of the machine that reads may be behind
SAME_DAY = 2.0 * DAY  # s from its noon; a date that a person states may be of another zone of time
FEWEST_FIXES = 32  # that tell how UTC and stamps go together
LEAST_AT_ODDS, FEW_AT_ODDS = 10.0, 0.01  # s beyond what clocks drift, and share of the fixes, worth a word
KNOT, FEWEST_OF_KNOT, FEWEST_KNOTS = 5.0, 4, 8  # s over which a lead is averaged; fixes of each; of them
LEAST_LEAD = 0.15  # s; what stamps of the arrival come to in the mean of a knot is less
SLOWEST_FIXES = 20.0  # s from one to the next; a kart is somewhere else by then
LONGEST_PAUSE = 8.0 * 3600.0  # s without a fix within one recording; heats of one day are nearer
FEW_OUTSIDE = 0.01  # share of the fixes
LEAST_UNFIXED = (10.0, 0.05)  # s and share of the IMU's recording, before the first fix or after the last


def week_rollover(r: Recording) -> Finding | None:
    """Dates before 2010 that are plausible 1024 weeks later; a stated date decides where it agrees with one of them."""
    if (old := _old_dates(r)) is None or not _is_rolled_over(old[0], r.date):
        return None
    written, count = old
    text = (
        f"its dates ({_date(written)}) are 1024 weeks back, as firmware has them that is too old for its "
        f"week numbers; taken as {_date(written + ROLLOVER)}. If they are right, state `date` in session.toml"
    )
    return Finding(text, count, shift={"unix_s": np.where(_unix_s(r) < OLD, ROLLOVER, 0.0)})


def old_dates(r: Recording) -> Finding | None:
    """Other dates before 2010 that nobody stated."""
    if (old := _old_dates(r)) is None:
        return None
    text = f"its dates ({_date(old[0])}) are before 2010; is the receiver's firmware too old?"
    return Finding(f"{text} State `date` in session.toml", old[1])


def utc_at_odds(r: Recording) -> Finding | None:
    """UTC of some fixes that is of another time than the others', by their stamps."""
    t, unix_s = _timed(r)
    if t.size < FEWEST_FIXES:
        return None
    ahead = unix_s - t - np.median(unix_s - t)
    odd = np.abs(ahead) > LEAST_AT_ODDS + 2.0 * LARGEST_DRIFT * (t[-1] - t[0])
    count = int(np.count_nonzero(odd))
    if count <= FEW_AT_ODDS * odd.size:
        return None
    text = f"UTC of {counted(count, 'fix')} is {np.median(ahead[odd]):+.0f} s off that of the others by their times"
    return Finding(f"{text}; one of the two clocks was set anew", count)


def clock_set(which: str, r: Recording) -> Finding | None:
    """One of the two clocks, stamps or UTC, leapt against the other for good: which says that it was this one."""
    t, unix_s = _timed(r)
    if t.size < FEWEST_FIXES or utc_at_odds(r) is not None:
        return None
    found = [leap for leap in leaps(t, unix_s) if (leap.set == "stamps") == (which == "stamps")]
    if not found:
        return None
    first = found[0]
    at = f"at {t[first.row]:.0f} s" + (f", and {len(found) - 1} more" if len(found) > 1 else "")
    if which == "stamps":
        text = f"t_s leaps by {-first.by:+.2f} s {at}, and UTC does not; if not taken out, the lap across is off by it"
    elif first.set == "utc":
        text = f"UTC leaps by {first.by:+.2f} s {at}, and t_s does not; times of day are off by as much there"
    else:
        text = f"UTC leaps by {first.by:+.2f} s against t_s in the gap {at}: one of the two was set anew"
        text += "; if it was t_s and is not taken out, the lap across is off by as much"
    return Finding(text, len(found))


def pace(r: Recording) -> Finding | None:
    """Stamps that gain or lose time against UTC otherwise than evenly, and not in a leap."""
    t, unix_s = _timed(r)
    if t.size < FEWEST_KNOTS * FEWEST_OF_KNOT or any(True for _ in leaps(t, unix_s)) or utc_at_odds(r) is not None:
        return None
    knot = np.floor((t - t[0]) / KNOT)
    starts = np.flatnonzero(np.diff(knot, prepend=-1.0))
    parts = [part for part in np.split(np.arange(t.size), starts[1:]) if part.size >= FEWEST_OF_KNOT]
    if len(parts) < FEWEST_KNOTS:
        return None
    at, lead = (np.array([median(x[part]) for part in parts]) for x in (t - t[0], t - unix_s - (t[0] - unix_s[0])))
    off = lead - np.polyval(np.polyfit(at, lead, 1), at)
    if np.ptp(off) < LEAST_LEAD:
        return None
    first, last = sorted((int(np.argmin(off)), int(np.argmax(off))))
    text = (
        f"t_s gains {off[last] - off[first]:+.2f} s on UTC between {t[0] + at[first]:.0f} and {t[0] + at[last]:.0f} s"
    )
    return Finding(f"{text}; if fixes did not only wait, laps there are off by as much: mend t_s by UTC")


def gaps(r: Recording) -> Finding | None:
    """Fixes that are missing."""
    steps = np.diff(r.gnss.t)
    found = steps[are_fix_gaps(steps)] if steps.size else steps
    if not found.size:
        return None
    return Finding(f"{counted(found.size, 'gap')} in the fixes, the longest {span(found.max())}", int(found.size))


def too_rare(r: Recording) -> Finding | None:
    """Fixes between which the motion of a kart is not known."""
    steps = np.diff(r.gnss.t)
    usual = float(np.median(steps)) if steps.size else 0.0
    return Finding(f"a fix only every {usual:.0f} s; is t_s in seconds?") if usual > SLOWEST_FIXES else None


def apart(r: Recording) -> Finding | None:
    """Drives of several days: the one with most fixes is used. A trajectory of the night between says nothing."""
    t = r.gnss.t
    cuts = np.flatnonzero(np.diff(t) > LONGEST_PAUSE) + 1
    if not cuts.size:
        return None
    bounds = np.concatenate([[0], cuts, [t.size]])
    most = int(np.argmax(np.diff(bounds)))
    lost = np.ones(t.size, dtype=np.bool_)
    lost[bounds[most] : bounds[most + 1]] = False
    count, longest = int(np.count_nonzero(lost)), float(np.max(np.diff(t)))
    at = ", ".join(f"{t[cut - 1]:.0f} s" for cut in cuts[:5].tolist())
    text = f"{cuts.size + 1} recordings, with up to {span(longest)} between them; number {most + 1} is used"
    return Finding(f"{text}, {counted(count, 'fix')} of the others left out. Split the files at {at}", count, drop=lost)


def rows_apart(stream: str, r: Recording) -> Finding | None:
    """Rows of those other drives, of which the fixes are left out."""
    t, first, last = r.stream(stream).t, r.gnss.t[0], r.gnss.t[-1]
    if len(t) == 0 or (t[0] > first - LONGEST_PAUSE and t[-1] < last + LONGEST_PAUSE):
        return None
    lost = (t < first - LONGEST_PAUSE) | (t > last + LONGEST_PAUSE)
    none_left = stream == "imu" and np.all(lost)
    return Finding("no sample in the recording that is used: smoothed from GPS alone" if none_left else "", drop=lost)


def outside(r: Recording) -> Finding | None:
    """Fixes beside which no samples were recorded."""
    t, imu_t = r.gnss.t, r.samples.t
    count = int(np.count_nonzero((t < imu_t[0]) | (t > imu_t[-1])))
    if count <= FEW_OUTSIDE * t.size:
        return None
    return Finding(f"{count} of {t.size} fixes lie before or after the IMU's recording", count)


def unfixed(when: str, r: Recording) -> Finding | None:
    """Samples long before the first fix or after the last: no result is given there."""
    t, imu_t = r.gnss.t, r.samples.t
    lasts = t[0] - imu_t[0] if when == "before" else imu_t[-1] - t[-1]
    if lasts <= max(LEAST_UNFIXED[0], LEAST_UNFIXED[1] * (imu_t[-1] - imu_t[0])):
        return None
    if when == "before":
        text = f"the first fix comes {lasts:.0f} s after the IMU's first sample; nothing is smoothed before it"
    else:
        text = f"the last fix comes {lasts:.0f} s before the IMU's last sample; nothing is smoothed after it"
        text += "; did the GPS stop?"
    return Finding(text)


def _unix_s(r: Recording) -> Array:
    assert r.gnss.unix_s is not None
    return r.gnss.unix_s


def _timed(r: Recording) -> tuple[Array, Array]:
    """Stamps and UTC (N,) s of the fixes that have one."""
    known = np.isfinite(_unix_s(r))
    return r.gnss.t[known], _unix_s(r)[known]


def _old_dates(r: Recording) -> tuple[float, int] | None:
    """The middle of dates before 2010 that nobody stated, s since 1970, and how many."""
    unix_s = _unix_s(r)
    old = unix_s[unix_s < OLD]
    if not old.size or any(abs(median(old) - day) < SAME_DAY for day in _noon(r.date)):
        return None
    return median(old), int(old.size)


def _is_rolled_over(written: float, stated: str | None) -> bool:
    present = written + ROLLOVER
    return EARLIEST <= present <= time.time() + AHEAD or any(abs(present - day) < SAME_DAY for day in _noon(stated))


def _noon(date: str | None) -> Iterator[float]:
    """Noon of a date (ISO 8601), s since 1970, if it can be read."""
    try:
        if date is not None:
            yield (dt.date.fromisoformat(date) - dt.date(1970, 1, 1)).days * DAY + 0.5 * DAY
    except ValueError:
        return


def _date(unix: float) -> str:
    return (dt.date(1970, 1, 1) + dt.timedelta(days=unix // DAY)).isoformat()


DATES = (
    Check("gps_week_rollover", "fixes", ("unix_s",), week_rollover),
    Check("gps_date_old", "fixes", ("unix_s",), old_dates),
)
CLOCKS = (
    Check("gps_utc_at_odds", "fixes", ("unix_s",), utc_at_odds),
    Check("gps_utc_set", "fixes", ("unix_s",), partial(clock_set, "utc")),
    Check("gps_clock_set", "fixes", ("unix_s",), partial(clock_set, "stamps")),
    Check("clock_pace", "fixes", ("unix_s",), pace),
)
GAPS = (
    Check("gps_too_slow", "fixes", (), too_rare),
    Check("gps_gap", "fixes", (), gaps),
    Check("recordings_apart", "fixes", (), apart),
    *(Check("recordings_apart", stream, (), partial(rows_apart, stream)) for stream in ("imu", "mag", "wheel_speed")),
)
TOGETHER = (
    Check("gps_outside_imu", "fixes", (), outside),
    Check(IMU_BEFORE_FIXES, "fixes", (), partial(unfixed, "before")),
    Check(IMU_AFTER_FIXES, "fixes", (), partial(unfixed, "after")),
)
