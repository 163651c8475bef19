"""Times in another unit than seconds, recognised where it is certain: by UTC, or by a rate nothing else explains."""

import math

import numpy as np

from smoother.arrays import Array
from smoother.disc import pieces
from smoother.samples import Problem

FIX_PERIODS = (0.01, 30.0)  # s from fix to fix; a kart is somewhere else by then
UNITS = {"milliseconds": 1e3, "microseconds": 1e6, "nanoseconds": 1e9}  # in a second
SAME_UNIT = 0.05  # share; a clock is better by far
LONGEST_PERIOD = 1.0  # s; no inertial or magnetic sensor of a vehicle is as slow
SENSOR_RATES = (4.0, 4000.0)  # Hz; a factor of 1000, so that one unit at most explains a period
FEWEST_ROWS = 8
SHARED = 0.1  # of the rows have the time of the one before
ENOUGH_ROWS = 1 << 20  # to know the usual period
IN_NO_ORDER = 0.2  # share of steps backwards; a clock that starts anew makes hardly any


def unit_by_utc(t: Array, unix_s: Array) -> str | None:
    """The unit of t (N,) by the UTC (N,) s of the same rows, NaN where unknown; None for seconds, or where unknown."""
    known = np.flatnonzero(np.isfinite(t) & np.isfinite(unix_s))
    if known.size < FEWEST_ROWS:
        return None
    early, late = known[: known.size // 4], known[-(known.size // 4) :]  # medians: single rows may be damaged
    run, utc_run = (float(np.median(x[late]) - np.median(x[early])) for x in (t, unix_s))
    fits = (name for name, size in UNITS.items() if utc_run > 0.0 and abs(run / utc_run / size - 1.0) < SAME_UNIT)
    return next(fits, None)


def unit_by_rate(t: Array) -> str | None:
    """The unit of the times t (N,) of a sensor's samples, None for seconds: a period of 5 is 5 ms, and never 5 s."""
    period = _usual_step(t)
    if not period >= LONGEST_PERIOD or _are_whole_seconds(t, period):
        return None
    low, high = SENSOR_RATES
    return next((name for name, size in UNITS.items() if low < size / period <= high), None)


def unit_of_fixes(t: Array, unix_s: Array, imu_unit: str | None) -> str | None:
    """The unit of the times t (N,) of fixes, None for seconds: by UTC, else that of the samples beside them."""
    unit = unit_by_utc(t, unix_s)
    if unit is not None or imu_unit is None:
        return unit
    return imu_unit if FIX_PERIODS[0] <= _usual_step(t) / UNITS[imu_unit] < FIX_PERIODS[1] else None


def lasts_like(t: Array, fixes_t: Array, unit: str) -> bool:
    """Whether times t (N,) of samples, read as `unit`, last about as long as the fixes (M,) s beside them.

    If they would rather as seconds, it was a slow sensor that looked like another unit.
    """
    if t.size < 2 or fixes_t.size < 2 or not (lasts := float(np.ptp(fixes_t))) > 0.0:
        return True
    share = float(t[-1] - t[0]) / lasts
    return share * math.sqrt(UNITS[unit]) >= 1.0  # nearer to 1 than what it would be in seconds, as factors go


def in_seconds(t: Array, unit: str | None, prefix: str, file: str) -> tuple[Array, list[Problem]]:
    """Times t (N,) in seconds, and what to say of it."""
    if unit is None:
        return t, []
    return t / UNITS[unit], [Problem(f"{prefix}_time_unit", f"{file}: its times are in {unit}; converted")]


def _are_whole_seconds(t: Array, period: float) -> bool:
    """Whether times t (N,) with steps of a second are those of samples that share them; none do in ms."""
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
