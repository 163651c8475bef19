"""Corners: bends of the reference line, and time and speed of every lap in them.

A corner is a stretch of curvature to one side, above thresholds of curvature and of total turn. Between two corners the
lap is divided where it is fastest, so that braking belongs to the following corner and acceleration to the previous.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from smoother.arrays import Array, BoolArray, IntArray, runs_of
from smoother.fit.plan_path import PlanPath
from smoother.laps.braking import braking_points
from smoother.laps.corner_speeds import SmoothSpeed, corner_speeds, smooth_speed
from smoother.laps.reference import Curve
from smoother.laps.results import Corner, Traces
from smoother.laps.sideslip import outward
from smoother.laps.sigma import Crossed, are_real, sigma_of, significance_threshold, time_covariances
from smoother.trajectory import JointPosition, Trajectory
from smoother.units import DEG

TIGHTEST_STRAIGHT = 1.0 / 70.0  # 1/m; a bend must be tighter than this somewhere
BEND_ENDS = 1.0 / 160.0  # 1/m, or a third of the bend's own greatest curvature
MOST_LAPS = 60  # whose losses enter the covariance; more change nothing
OF_MEDIAN = 0.5 * np.pi  # variance of a median of normal values over that of their mean, of three or more


@dataclass(frozen=True)
class Bend:
    """Extent of a corner: start, apex, end m; curvature 1/m at the apex, positive to the left."""

    start: float
    apex: float
    end: float
    curvature: float


def find_bends(curve: Curve) -> tuple[Bend, ...]:
    """Return the corners of a track in driving order from the line."""
    curvature, spacing = curve.line.curvature, curve.length / max(1, len(curve.line.distance))
    bends: list[Bend] = []
    for side in (1.0, -1.0):
        bends += _bends_to(side * curvature, side, spacing, curve)
    return tuple(sorted(bends, key=lambda bend: bend.apex))


def _bends_to(curvature: Array, side: float, spacing: float, curve: Curve) -> list[Bend]:
    # m; two bends to the same side closer than this are one corner
    bent = _joined(curvature > BEND_ENDS, round(8.0 / spacing))
    found = []
    for a, b in zip(*runs_of(bent), strict=True):
        inside = curvature[a:b]
        peak = float(inside.max())
        tight = np.flatnonzero(inside > max(BEND_ENDS, peak / 3.0))
        first, last = a + tight[0], a + tight[-1]
        turn = float(curvature[first : last + 1].sum() * spacing)
        if peak < TIGHTEST_STRAIGHT or turn < 20.0 * DEG:  # rad
            continue
        apex = float(np.average(np.arange(a, b), weights=np.where(inside > 0.9 * peak, inside, 0.0)))
        d = curve.line.distance
        found.append(Bend(float(d[first]), float(np.interp(apex, np.arange(len(d)), d)), float(d[last]), side * peak))
    return found


def _joined(mask: BoolArray, gap: int) -> BoolArray:
    """Close gaps of up to `gap` points."""
    known = np.flatnonzero(mask)
    out = mask.copy()
    for a, b in pairwise(known):
        if 1 < b - a <= gap:
            out[a:b] = True
    return out


def make_corners(
    curve: Curve,
    traces: Traces,
    trajectory: Trajectory,
    path: PlanPath,
    reference: int | None,
    elapsed: Array | None,
    counting: BoolArray,
    errors: JointPosition | None,
) -> tuple[Corner, ...]:
    """Return all corners with the values of every lap.

    reference: index of the reference lap, None if it is from another session; elapsed (M,) s of the reference lap.
    """
    bends = find_bends(curve)
    if not bends:
        return ()
    speed = _mean_speed(traces, counting)
    bounds = _bounds(bends, traces.distance, speed)
    at_bounds = _at(traces.t, traces.distance, bounds)
    spent = np.diff(at_bounds, axis=1)
    lost = np.full(spent.shape, np.nan)
    if elapsed is not None:
        lost = spent - np.diff(np.interp(bounds, traces.distance, elapsed))
    sigma = _lost_sigma(curve, bounds, at_bounds, path, reference, errors)
    losses = _with_significance(lost, sigma, counting, reference)
    others = np.array([lap for lap in np.flatnonzero(counting) if lap != reference], dtype=np.int64)
    usual = _usual_with_significance(
        lost[others], _usual_sigma(curve, bounds, at_bounds, path, reference, others, errors)
    )
    steady = smooth_speed(trajectory)
    return tuple(_corner(i, bend, bounds, traces, steady, spent[:, i], losses, usual) for i, bend in enumerate(bends))


@dataclass(frozen=True, eq=False)
class _Losses:
    """Time lost (L, C) or (C,) s, its sigma, and whether it is real, that is beyond `threshold` sigmas."""

    lost: Array
    sigma: Array
    is_real: BoolArray
    threshold: float


def _with_significance(lost: Array, sigma: Array, counting: BoolArray, reference: int | None) -> _Losses:
    """Losses (L, C) with their significance; the laps that count determine the threshold."""
    compared = counting.copy() if counting.any() else np.ones(len(lost), dtype=np.bool_)
    if reference is not None:
        compared[reference] = False
    threshold = significance_threshold(lost[compared], sigma[compared])
    return _Losses(lost, sigma, are_real(lost, sigma, threshold), threshold)


def _usual_with_significance(lost: Array, sigma: Array) -> _Losses:
    """Medians (C,) of the losses (K, C) of some laps, with their sigma (C,)."""
    known = np.isfinite(lost)
    usual = np.full(lost.shape[1], np.nan)
    for i in np.flatnonzero(known.any(axis=0)):
        usual[i] = np.median(lost[known[:, i], i])
    threshold = significance_threshold(usual, sigma)
    return _Losses(usual, sigma, are_real(usual, sigma, threshold), threshold)


def _mean_speed(traces: Traces, counting: BoolArray) -> Array:
    speed = traces.speed[counting] if counting.any() else traces.speed
    known = np.isfinite(speed)
    mean = np.where(known, speed, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    have = known.any(axis=0)
    return np.asarray(np.interp(traces.distance, traces.distance[have], mean[have])) if have.any() else mean


def _bounds(bends: tuple[Bend, ...], distance: Array, speed: Array) -> Array:
    """Ends (C + 1,) of the segments: the line, the fastest places between neighbours, the line again."""
    bounds = [0.0]
    for before, after in pairwise(bends):
        between = np.flatnonzero((distance >= before.end) & (distance <= after.start))
        fastest = distance[between[np.argmax(speed[between])]] if between.size else 0.5 * (before.end + after.start)
        bounds.append(float(fastest))
    bounds.append(float(distance[-1]))
    return np.maximum.accumulate(np.array(bounds))


def _at(values: Array, distance: Array, wanted: Array) -> Array:
    """Rows of values (L, M) at distances (B,), (L, B); NaN beside a NaN."""
    return np.stack([np.interp(wanted, distance, row) for row in values])


def _lost_sigma(
    curve: Curve,
    bounds: Array,
    at_bounds: Array,
    path: PlanPath,
    reference: int | None,
    errors: JointPosition | None,
) -> Array:
    """Sigma (L, C) of the time lost in each segment; a reference of another session is assumed to have the same."""
    out = np.full((len(at_bounds), len(bounds) - 1), np.nan)
    if errors is None:
        return out
    normal, laps = curve.tangent(bounds), np.flatnonzero(np.isfinite(at_bounds).any(axis=1))
    step = np.eye(len(bounds))[1:] - np.eye(len(bounds))[:-1]
    groups, usable, weights = [], [], []
    for lap in laps:
        both = reference is not None and reference != lap
        times = np.concatenate([at_bounds[lap], at_bounds[reference]]) if both else at_bounds[lap]
        weights.append(np.concatenate([step, -step], axis=1) if both else step)
        usable.append(np.all(np.isfinite(times)[None, :] | (weights[-1] == 0.0), axis=1))
        filled = np.where(np.isfinite(times), times, path.t[0])
        groups.append(Crossed(filled, np.tile(normal, (2 if both else 1, 1)), path.at(filled)[1]))
    alike = 1.0 if reference is not None else np.sqrt(2.0)
    for i, covariance in enumerate(time_covariances(errors, groups)):
        sigma = np.zeros(len(step)) if laps[i] == reference else alike * sigma_of(covariance, weights[i])
        out[laps[i]] = np.where(usable[i], sigma, np.nan)
    return out


def _usual_sigma(
    curve: Curve,
    bounds: Array,
    at_bounds: Array,
    path: PlanPath,
    reference: int | None,
    others: IntArray,
    errors: JointPosition | None,
) -> Array:
    """Sigma (C,) of the median of the losses of the laps `others` (K,) in each segment.

    The median does not reduce the error that their losses have in common, mostly that of the reference lap. A reference
    from another session is assumed to have the same sigma.
    """
    corners = len(bounds) - 1
    out = np.full(corners, np.nan)
    if errors is None or not others.size:
        return out
    normal = curve.tangent(bounds)
    groups, places = [], []
    for i in range(corners):
        known = others[np.isfinite(at_bounds[others, i : i + 2]).all(axis=1)]
        if known.size == 0 or (reference is not None and not np.isfinite(at_bounds[reference, i : i + 2]).all()):
            continue
        taken = known[np.linspace(0, len(known) - 1, min(MOST_LAPS, len(known))).round().astype(np.int64)]
        times = at_bounds[taken if reference is None else np.append(taken, reference), i : i + 2].ravel()
        groups.append(Crossed(times, np.tile(normal[i : i + 2], (len(times) // 2, 1)), path.at(times)[1]))
        places.append((i, len(known)))
    for (i, count), covariance in zip(places, time_covariances(errors, groups), strict=True):
        out[i] = np.sqrt(_median_variance(_covariance_of_lost(covariance, reference is not None), count))
    return out


def _covariance_of_lost(covariance: Array, has_reference: bool) -> Array:
    """Covariance (K, K) s^2 of the losses of K laps, from that of the times at which they, and last the reference lap
    if it is of this session, crossed both ends of a segment."""
    laps = len(covariance) // 2
    spent = np.kron(np.eye(laps), np.array([[-1.0, 1.0]]))
    if has_reference:
        spent = spent[:-1] - spent[-1:]
    lost = spent @ covariance @ spent.T
    return lost if has_reference else lost + np.mean(np.diag(lost))


def _median_variance(covariance: Array, count: int) -> float:
    """Variance of the median of `count` values, of some of which this is the covariance (K, K)."""
    each, laps = float(np.mean(np.diag(covariance))), len(covariance)
    if laps < 2:
        return each
    shared = min(max((float(covariance.sum()) - laps * each) / (laps * (laps - 1)), 0.0), each)
    return shared + (OF_MEDIAN if count > 2 else 1.0) * (each - shared) / count


def _corner(
    i: int,
    bend: Bend,
    bounds: Array,
    traces: Traces,
    speed: SmoothSpeed,
    spent: Array,
    losses: _Losses,
    usual: _Losses,
) -> Corner:
    inside = (traces.distance >= bend.start) & (traces.distance <= bend.end)
    braking, braking_sigma = braking_points(traces, bounds[i], bend.apex)
    slide, slide_sigma = outward(traces.sideslip, traces.sideslip_sigma, inside, bend.curvature > 0.0)
    return Corner(
        number=i + 1,
        start=bend.start,
        apex=bend.apex,
        end=bend.end,
        turns_left=bend.curvature > 0.0,
        radius=1.0 / abs(bend.curvature),
        segment=(float(bounds[i]), float(bounds[i + 1])),
        **vars(corner_speeds(speed, traces, bend.start, bend.end)),
        braking_point=braking,
        braking_sigma=braking_sigma,
        time=spent,
        time_lost=losses.lost[:, i],
        time_lost_sigma=losses.sigma[:, i],
        is_real=losses.is_real[:, i],
        real_from=losses.threshold,
        slide=slide,
        slide_sigma=slide_sigma,
        usual_lost=float(usual.lost[i]),
        usual_lost_sigma=float(usual.sigma[i]),
        usual_is_real=bool(usual.is_real[i]),
    )
