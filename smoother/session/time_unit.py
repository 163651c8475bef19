"""Times in another unit than seconds, recognised where it is certain: by UTC, or by a rate nothing else explains."""

import math

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces
from smoother.errors import SessionError
from smoother.samples import Problem

LONGER_UNITS = {"minutes": 60.0, "hours": 3600.0}  # s
FASTEST = {"samples": 10_000.0, "fixes": 100.0}  # a second on average; no logger of a kart, and no receiver, makes more
ENOUGH_TIMES = 1000  # evenly taken, to know the usual rate
UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}  # in a second
SAME_UNIT = 0.05  # share; a clock is better by far
LONGEST_PERIOD = 1.0  # s; no inertial or magnetic sensor of a vehicle is as slow
SENSOR_RATES = (4.0, 4000.0)  # Hz; a factor of 1000, so that one unit at most explains a period
SLOWEST_FIXES = 30.0  # s between fixes; a kart is somewhere else by then
FEWEST_ROWS = 8
ENOUGH_ROWS_FOR_RATE = 32
SECONDS = {"seconds": 1.0}
SHARED = 0.1  # of the rows have the time of the one before
ENOUGH_ROWS = 1 << 20  # to know the usual period
IN_NO_ORDER = 0.2  # share of steps backwards; a clock that starts anew makes hardly any


def unit_by_utc(t: Array, unix_s: Array) -> str | None:
    """The unit of t (N,) by the UTC (N,) s of the same rows, NaN where unknown; None for seconds, or where unknown."""
    return _unit_by_utc(t, unix_s, UNITS)


def _unit_by_utc(t: Array, unix_s: Array, units: dict[str, float]) -> str | None:
    """Which of `units`, by how many are in a second."""
    known = np.flatnonzero(np.isfinite(t) & np.isfinite(unix_s))
    if known.size < FEWEST_ROWS:
        return None
    early, late = known[: known.size // 4], known[-(known.size // 4) :]  # medians: single rows may be damaged
    run, utc_run = (float(np.median(x[late]) - np.median(x[early])) for x in (t, unix_s))
    fits = (name for name, size in units.items() if utc_run > 0.0 and abs(run / utc_run / size - 1.0) < SAME_UNIT)
    return next(fits, None)


def unit_by_rate(t: Array) -> str | None:
    """The unit of the times t (N,) of a sensor's samples, None for seconds: a period of 5 is 5 ms, and never 5 s."""
    period = _usual_step(t)
    if not period >= LONGEST_PERIOD or _are_whole_seconds(t, period):
        return None
    low, high = SENSOR_RATES
    return next((name for name, size in UNITS.items() if low < size / period <= high), None)


def require_seconds(file: str, t: Array, noun: str, unix_s: Array | None = None) -> None:
    """Raise SessionError where times t (N,) are in minutes or hours: by UTC, or where the `noun` come impossibly fast.

    noun : a key of FASTEST. unix_s (N,) s : UTC, NaN where unknown.
    """
    longer = None if unix_s is None else _unit_by_utc(t, unix_s, {name: 1.0 / s for name, s in LONGER_UNITS.items()})
    if longer is not None:
        times = f"multiply by {LONGER_UNITS[longer]:.0f}, in every file of the session"
        raise SessionError(f"{file}: by its UTC, t_s is in {longer}; it has to be in seconds: {times}")
    rate = _usual_rate(t)
    if rate > FASTEST[noun]:
        raise SessionError(
            f"{file}: by t_s {rate:.0f} {noun} a second, which nothing makes; "
            "t_s has to be in seconds: multiply minutes by 60, hours by 3600"
        )


def _usual_rate(t: Array) -> float:
    """Rows a second in the middle half of the times t (N,) s, whatever their order; NaN for too few."""
    step = max(1, t.size // ENOUGH_TIMES)
    some = t[::step]
    some = some[np.isfinite(some)]
    if some.size < ENOUGH_ROWS_FOR_RATE:
        return float("nan")
    early, late = np.percentile(some, [25.0, 75.0])
    return float(0.5 * some.size * step / (late - early)) if late > early else float("nan")


def lasts_like(t: Array, fixes_t: Array, unit: str) -> bool:
    """Whether times t (N,) of samples, read as `unit`, last about as long as the fixes (M,) s beside them.

    If they would rather as seconds, it was a slow sensor that looked like another unit.
    """
    if t.size < 2 or fixes_t.size < 2 or not (lasts := float(np.ptp(fixes_t))) > 0.0:
        return True
    share = float(t[-1] - t[0]) / lasts
    return share * math.sqrt(UNITS[unit]) >= 1.0  # nearer to 1 than what it would be in seconds, as factors go


def unit_of_fixes(file: str, t: Array, unix_s: Array, imu_unit: str | None) -> str | None:
    """The unit of the times t (N,) of fixes, None for seconds: by UTC, else that of the inertial samples beside them.

    Raises SessionError where fixes without UTC come so rarely that another unit is likely, and nothing tells which.
    """
    require_seconds(file, t, "fixes", unix_s)
    step = _usual_step(t)
    if (unit := unit_by_utc(t, unix_s)) is not None or _unit_by_utc(t, unix_s, SECONDS) is not None:
        return unit
    if imu_unit is not None and 1.0 / FASTEST["fixes"] <= step / UNITS[imu_unit] < SLOWEST_FIXES:
        return imu_unit
    if not step > SLOWEST_FIXES or np.any(np.isfinite(unix_s)):
        return None
    raise SessionError(
        f"{file}: by t_s a fix only every {step:.3g} s, which is no kart's track; "
        "t_s has to be in seconds: divide milliseconds by 1000, microseconds by 1000000"
    )


def in_seconds(t: Array, unit: str | None, prefix: str, file: str) -> tuple[Array, list[Problem]]:
    """Times t (N,) in seconds, and what to say of it."""
    if unit is None:
        return t, []
    return t / UNITS[unit], [Problem(f"{prefix}_time_unit", f"{file}: its times are in {unit}; taken as such")]


def _are_whole_seconds(t: Array, period: float) -> bool:
    """Whether times t (N,), a second apart where they differ, are those of samples that share them; none do in ms."""
    return period == LONGEST_PERIOD and bool(np.mean(np.diff(t[:ENOUGH_ROWS]) == 0.0) > SHARED)


def _usual_step(t: Array) -> float:
    """Median of the steps that are forward, NaN without any; of rows in no order, of their times put in order."""
    part = t[next(iter(pieces(t.size, ENOUGH_ROWS)))] if t.size else t
    known = part[np.isfinite(part)]
    steps = np.diff(known)
    if steps.size and np.mean(steps < 0.0) > IN_NO_ORDER:
        steps = np.diff(np.sort(known))
    steps = steps[steps > 0.0]
    return float(np.median(steps)) if steps.size >= FEWEST_ROWS else float("nan")
