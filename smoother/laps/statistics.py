"""Statistics of all laps: best, theoretical and rolling best, consistency; comparison with official times."""

import numpy as np

from smoother.arrays import Array
from smoother.fit.plan_path import PlanPath
from smoother.laps.reference import Curve
from smoother.laps.results import Lap, Line, OfficialTime, SigmaSource, Statistics, Traces
from smoother.laps.rolling import rolling_best
from smoother.laps.theoretical import theoretical_best
from smoother.trajectory import JointPosition

ALIKE = 0.1  # s, plausible difference of two times of one lap
SAME_LAP = 1.5  # s, largest difference between an official time and that of a lap


def statistics_of(
    laps: tuple[Lap, ...],
    gates: tuple[Line, ...],
    traces: Traces | None,
    curve: Curve,
    path: PlanPath,
    errors: JointPosition | None,
    source: SigmaSource,
) -> Statistics:
    """Return the statistics of the laps that count; gates: start, the ends of the sectors in driving order, finish."""
    counting = [i for i, lap in enumerate(laps) if lap.is_valid]
    times = np.array([laps[i].time for i in counting])
    sigmas = np.array([laps[i].sigma for i in counting])
    flying = np.array([laps[i].is_comparable for i in counting], dtype=np.bool_)
    best = counting[int(np.argmin(times))] if counting else None
    theoretical, theoretical_sigma, raw = theoretical_best([laps[i] for i in counting], gates, path, errors)
    rolling = rolling_best(laps, traces, curve, path, errors)
    is_measured = source in ("joint", "stored") and bool(np.isfinite(sigmas).all())
    return Statistics(
        best_lap=best,
        best=float(times.min()) if len(times) else np.nan,
        best_sigma=laps[best].sigma if best is not None else np.nan,
        theoretical=theoretical,
        theoretical_sigma=theoretical_sigma,
        theoretical_raw=raw,
        rolling=rolling.time,
        rolling_sigma=rolling.sigma,
        rolling_raw=rolling.raw,
        rolling_from=rolling.distance,
        mean=float(times.mean()) if len(times) else np.nan,
        median=float(np.median(times)) if len(times) else np.nan,
        spread=_spread(times[flying], sigmas[flying] if is_measured else np.zeros(np.count_nonzero(flying))),
        within_tenth=int(np.count_nonzero(times <= times.min() + 0.1)) if len(times) else 0,  # s
        counted=len(counting),
    )


def _spread(times: Array, sigmas: Array) -> float:
    """Standard deviation s of lap times (K,) without the variance of timing them; NaN of fewer than two."""
    if len(times) < 2:
        return np.nan
    seen, noise = float(np.var(times, ddof=1)), float(np.mean(sigmas**2))
    return float(np.sqrt(max(seen - noise, 0.0)))


def official_times(times: tuple[float, ...], laps: tuple[Lap, ...]) -> tuple[OfficialTime, ...]:
    """Return official times, in driving order, each with its lap.

    The lists may start and end at different laps: the shift with most agreeing times is used.
    """
    timed = [i for i, lap in enumerate(laps) if lap.is_timed]
    ours, theirs = np.array([laps[i].time for i in timed]), np.array(times)
    shifts = range(1 - len(theirs), len(ours))
    best_shift = max(shifts, key=lambda shift: _agreement(ours, theirs, shift), default=0)
    out = []
    for number, time in enumerate(times):
        place = number + best_shift
        is_there = 0 <= place < len(timed) and abs(laps[timed[place]].time - time) < SAME_LAP
        lap = timed[place] if is_there else None
        difference = np.nan if lap is None else laps[lap].time - time
        out.append(OfficialTime(number + 1, time, lap, difference, np.nan if lap is None else laps[lap].sigma))
    return tuple(out)


def _agreement(ours: Array, theirs: Array, shift: int) -> float:
    """Number of official times that agree with those of laps `shift` later; one that differs by ALIKE counts half."""
    k = np.arange(len(theirs)) + shift
    inside = (k >= 0) & (k < len(ours))
    away = theirs[inside] - ours[k[inside]]
    return float(np.sum(1.0 / (1.0 + (away / ALIKE) ** 2)))
