"""The rolling best: the fastest lap from any point of the track to the same point, without selection bias.

The least of many noisy times is below the least of the true ones, and there are many more starting points than laps. As
for the theoretical best, true times are sampled given the measured ones and the covariance of their errors, and each
sample has its own least time. Overlapping windows are correlated like moving sums over one lap. Sources: as in
:mod:`smoother.laps.theoretical`.
"""

from dataclasses import dataclass

import numpy as np

from smoother.arrays import Array, IntArray
from smoother.fit.plan_path import PlanPath
from smoother.laps.reference import Curve
from smoother.laps.results import Lap, Traces
from smoother.laps.sigma import Crossed, sigma_of, time_covariance
from smoother.laps.theoretical import SAMPLES, SEED, SPREADS, slowed, spreads
from smoother.trajectory import JointPosition

BROKEN: frozenset[str] = frozenset({"gap", "off-track", "short-cut"})  # laps over which no rolling lap is timed
ROUGH = 1e-6  # share of the variance of true times that is uncorrelated, against rounding errors


@dataclass(frozen=True)
class RollingBest:
    """Fastest lap from any point to the same point: time s without selection bias, its sigma s; as measured: raw s, the
    track distance m of its start, and its time t s. All NaN where there is none."""

    time: float = np.nan
    sigma: float = np.nan
    raw: float = np.nan
    distance: float = np.nan
    t: float = np.nan


def rolling_best(
    laps: tuple[Lap, ...], traces: Traces | None, curve: Curve, path: PlanPath, errors: JointPosition | None
) -> RollingBest:
    """Return the rolling best: never above the best lap that counts, which is one of the windows, nor below the raw."""
    if traces is None or not curve.line.is_closed or len(laps) < 2:
        return RollingBest()
    seen = _fastest(laps, traces)
    if errors is None or not np.isfinite(seen.raw):
        return RollingBest(seen.raw, np.nan, seen.raw, seen.distance, seen.t)
    counting = np.array([lap.time for lap in laps if lap.is_valid])
    windows = _windows(laps, traces)
    if len(counting) < 2 or not windows.lap.size:
        return RollingBest(seen.raw, _sigma(seen, curve, path, errors), seen.raw, seen.distance, seen.t)
    least, sigma = _least(windows, curve, path, errors, laps, traces)
    value = min(max(least, seen.raw), float(counting.min()))
    return RollingBest(value, float(np.hypot(sigma, least - value)), seen.raw, seen.distance, seen.t)


def _fastest(laps: tuple[Lap, ...], traces: Traces) -> RollingBest:
    """The fastest window as measured; a lap from line to line is one."""
    best = RollingBest(raw=np.inf)
    for i in _pairs(laps):
        around = traces.t[i + 1] - traces.t[i]
        if np.isfinite(around).any():
            k = int(np.nanargmin(around))
            if around[k] < best.raw:
                best = RollingBest(np.nan, np.nan, float(around[k]), float(traces.distance[k]), float(traces.t[i, k]))
    for lap in laps:
        if lap.is_valid and lap.time < best.raw:
            best = RollingBest(np.nan, np.nan, lap.time, 0.0, lap.start)
    return best if np.isfinite(best.raw) else RollingBest()


def _pairs(laps: tuple[Lap, ...]) -> list[int]:
    """Laps on which a window may start, ending on the next."""
    return [i for i in range(len(laps) - 1) if not BROKEN & set(laps[i].reasons) | BROKEN & set(laps[i + 1].reasons)]


def _sigma(seen: RollingBest, curve: Curve, path: PlanPath, errors: JointPosition) -> float:
    ends = np.array([seen.t, seen.t + seen.raw])
    normal = np.tile(curve.tangent(np.array([seen.distance])), (2, 1))
    covariance = time_covariance(errors, Crossed(ends, normal, path.at(ends)[1]))
    return float(sigma_of(covariance, np.array([[-1.0, 1.0]]))[0])


@dataclass(frozen=True, eq=False)
class _Windows:
    """The quickest windows (W,): index of the lap of its start and of the point of the traces."""

    lap: IntArray
    place: IntArray


def _windows(laps: tuple[Lap, ...], traces: Traces) -> _Windows:
    # starting points of a lap; neighbouring ones are highly correlated
    places = np.linspace(0, len(traces.distance) - 1, 24, endpoint=False).round().astype(np.int64)
    begins = np.array(_pairs(laps), dtype=np.int64)
    around = traces.t[np.ix_(begins + 1, places)] - traces.t[np.ix_(begins, places)]
    known = np.argwhere(np.isfinite(around))
    # that may be the best; slower ones are not used
    quickest = known[np.argsort(around[known[:, 0], known[:, 1]], kind="stable")[:144]]
    return _Windows(begins[quickest[:, 0]], places[quickest[:, 1]])


def _least(
    windows: _Windows, curve: Curve, path: PlanPath, errors: JointPosition, laps: tuple[Lap, ...], traces: Traces
) -> tuple[float, float]:
    """Mean and standard deviation, s, of the least true time of the windows."""
    start, end = (traces.t[windows.lap + later, windows.place] for later in (0, 1))
    ends = np.concatenate([start, end])
    normal = np.tile(curve.tangent(traces.distance[windows.place]), (2, 1))
    step = np.concatenate([-np.eye(len(start)), np.eye(len(start))], axis=1)
    noise = step @ time_covariance(errors, Crossed(ends, normal, path.at(ends)[1])) @ step.T
    times = np.array([lap.time for lap in laps if lap.is_valid])
    variance = float(np.mean([lap.sigma**2 for lap in laps if lap.is_valid]))
    usual = times[~slowed(times[:, None], np.sqrt(np.array([variance])))[:, 0]]
    begins = windows.lap + traces.distance[windows.place] / curve.length  # laps
    together = np.maximum(1.0 - np.abs(begins[:, None] - begins[None, :]), 0.0)  # of two moving sums over one lap
    least = _true_times(end - start, noise, together, usual, variance).min(axis=-1)
    return float(least.mean()), float(least.std())


def _true_times(seen: Array, noise: Array, together: Array, usual: Array, variance: float) -> Array:
    """Samples (SPREADS, SAMPLES, W) s of the true times of measured windows (W,) with a covariance of errors `noise`
    (W, W) and correlations of true times `together` (W, W). usual (K,) s: lap times, timed with `variance` s^2.

    In the axes in which both covariances are diagonal, a spread only weighs one against the other.
    """
    rng = np.random.default_rng(SEED)
    spread = spreads(usual, variance)
    expected = usual.mean() + rng.standard_normal((SPREADS, SAMPLES)) * (spread / np.sqrt(len(usual)))[:, None]
    root = np.linalg.cholesky(together + ROUGH * np.eye(len(seen)))
    whitening = np.linalg.inv(root)
    of_noise, axes = np.linalg.eigh(whitening @ noise @ whitening.T)
    of_noise, axes, back = np.maximum(of_noise, 0.0), whitening.T @ axes, root @ axes
    drawn = rng.standard_normal((2, SPREADS, SAMPLES, len(seen)))
    drawn[0] *= spread[:, None, None]
    drawn[1] *= np.sqrt(of_noise)
    missed = (seen - expected[..., None]) @ axes - drawn[0] - drawn[1]
    share = spread[:, None] ** 2 / (spread[:, None] ** 2 + of_noise)
    return np.asarray(expected[..., None] + (drawn[0] + share[:, None, :] * missed) @ back.T)
