"""The quality gate: whether a trajectory is valid, by its own sigmas and residuals and by the fixes.

The gate rejects results that are wrong, not results that are poor: a trajectory of bad data with wide sigmas passes.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray, are_near, median, runs_of
from smoother.disc import release
from smoother.estimate.fixes.path import GnssPathOptions
from smoother.estimate.output.resample import between_rows, bracket, position_at
from smoother.fit.running import gaussian_mean
from smoother.samples import DEAD_AXES, Session
from smoother.trajectory import (
    MIRRORED_AXES,
    UNLIKE_AXES,
    Trajectory,
)
from smoother.units import DEG
from smoother.words import counted

# residuals without a limit: a kart may slide for long, and the noise of the samples is identified
NOT_JUDGED = ("slip", "inertial", "bias_walk")
USUAL_WANDER = GnssPathOptions.offset_sigma[0]  # m, slow error of receivers in general
ROW = 0.1  # s between the rows whose attitude is checked


@dataclass(frozen=True)
class QualityLimits:
    """Limits of the gate. A fix is far when its distance exceeds near_fix and near_fix_sigmas times its reported
    accuracy and the sigma of the trajectory, which contains the slow error of the receiver.

    fix_sigma: limit of the identified slow error and noise of the fixes that count as their accuracy too.
    far_share: of all fixes; ten real jumps of some seconds in ten minutes stay below it. In a short session far_seconds
    in all are permitted, of at most short_far_share of the fixes.
    far_seconds: the longest unbroken stretch of far fixes; longer than any multipath jump on real recordings.
    stands: speed of the trajectory below which fixes slower than strolls are ignored.
    top_speed: above any kart or road car. sigma_horizontal: median.
    normalised_rms: of the residuals of any factor but NOT_JUDGED. rejected_share: of the measurements of any of them.
    sigma_yaw: median, of a session of at least parked_seconds with less than least_driving of its rows driven. Of fixes
    alone, a session counts as not driven where so few rows are faster than stood_speed by `clearly` sigmas, and 95 %
    lie within stood_radius of their middle.
    lean_step: difference of the mean roll, pitch relative to the path, or sideslip before and after any moment, each at
    least lean_seconds of driving, with lean_significance sigmas of its means over block_seconds: a logger that moved
    shows both. (Real karts and cars had up to 6.6 sigma and 3 deg, not both.) lean_creep: likewise of a steady change.
    rattle: rms of roll or pitch about their running mean over rattle_span, for rattle_seconds in all, beyond
    rattle_ratio times the usual.
    sideways: sideslip that no kart holds, for sideways_share of the driving faster than driving_speed.
    overturned: median of roll or pitch relative to the path, of the session or of any lean_seconds, beyond any banked
    track.
    near_seconds: rows farther from any fix are ignored. fewest_fixes: least number for a path.
    """

    near_fix: float = 5.0  # m
    near_fix_sigmas: float = 3.0
    fix_sigma: float = 4.0  # m
    far_share: float = 0.10
    short_far_share: float = 0.25
    far_seconds: float = 15.0  # s
    stands: float = 0.1  # m/s
    strolls: float = 2.0  # m/s
    top_speed: float = 110.0  # m/s
    sigma_horizontal: float = 50.0  # m
    normalised_rms: float = 5.0
    rejected_share: float = 0.30
    fewest_residuals: int = 20
    sigma_yaw: float = 30.0 * DEG
    least_driving: float = 0.01
    parked_seconds: float = 45.0  # s; a shorter recording is a trial
    stood_speed: float = 2.0  # m/s
    stood_radius: float = 15.0  # m
    clearly: float = 3.0
    lean_step: float = 2.5 * DEG
    lean_significance: float = 8.0
    far_lean_step: float = 6.0 * DEG  # likewise with far_lean_seconds on either side
    far_lean_seconds: float = 20.0  # s
    lean_creep: float = 5.0 * DEG
    unsure: float = 2.5 * DEG  # sigma of roll and pitch beyond which they do not show the mounting
    lean_seconds: float = 60.0  # s
    block_seconds: float = 20.0  # s
    rattle: float = 5.0 * DEG
    rattle_ratio: float = 5.0
    rattle_span: float = 2.0  # s
    rattle_seconds: float = 3.0  # s
    driving_speed: float = 5.0  # m/s
    sideways: float = 35.0 * DEG
    sideways_share: float = 0.20
    overturned: float = 25.0 * DEG
    near_seconds: float = 5.0
    fewest_fixes: int = 5


@dataclass(frozen=True)
class Quality:
    """Verdict of the gate; `reasons` are sentences, empty when passed.

    measures: its `top_speed_mps` is the highest row near a fix, spikes included: not the top speed of the session.
    """

    passed: bool
    reasons: tuple[str, ...]
    measures: dict[str, float]


def assess(session: Session, estimate: Trajectory, limits: QualityLimits | None = None) -> Quality:
    """Check a trajectory by its own fixes, sigmas and residuals."""
    limits = QualityLimits() if limits is None else limits
    finite = bool(np.isfinite(estimate.position_n).all() and np.isfinite(estimate.velocity_n).all())
    release(estimate)
    near = are_near(estimate.t, session.gnss.t, limits.near_seconds)
    top_speed = float(np.nanmax(estimate.speed, initial=0.0, where=near))
    measures = {"top_speed_mps": top_speed, **_distances(session, estimate, limits)}
    if estimate.sigmas is not None:
        sigma = np.hypot(estimate.sigmas.position_n[:, 0], estimate.sigmas.position_n[:, 1])
        measures["median_sigma_horizontal_m"] = median(sigma[near] if near.any() else sigma)
    release(estimate)
    reasons = [] if finite else ["some rows have no position or velocity"]
    if len(session.gnss) < limits.fewest_fixes:
        reasons.append(f"only {counted(len(session.gnss), 'fix')}: too few for a path")
    measures |= _attitude_measures(session, estimate, limits) | _standing(session, estimate, limits)
    reasons += _motion_reasons(measures, limits) + _attitude_reasons(measures, limits)
    reasons += _residual_reasons(estimate, limits) + _named_reasons(session, estimate)
    return Quality(not reasons, tuple(reasons), measures)


def _named_reasons(session: Session, estimate: Trajectory) -> list[str]:
    """Reasons of axes that no mounting explains or that never change."""
    if estimate.report.mode != "full":
        return []
    wrong = [p.text.partition(":")[0] for p in estimate.report.problems if p.code in (MIRRORED_AXES, UNLIKE_AXES)]
    dead = [p.text.partition(": ")[2].partition(";")[0] for p in session.problems if p.code == DEAD_AXES]
    return wrong + dead


def _distances(session: Session, estimate: Trajectory, limits: QualityLimits) -> dict[str, float]:
    """Share and longest stretch of fixes that the trajectory passes at a distance, each at the time it was true."""
    latency = estimate.report.identified.get("gps_position_latency")
    t = session.gnss.t - (latency.value if latency is not None and isinstance(latency.value, float) else 0.0)
    inside = (t >= estimate.t[0]) & (t <= estimate.t[-1])
    if estimate.report.left_out is not None:
        inside &= ~estimate.report.left_out  # they are reported
    inside &= ~_stray_at_rest(session, estimate, t, limits)
    if not inside.any():
        return {}
    place = bracket(estimate.t, t[inside])
    gap = position_at(estimate, t[inside])[:, :2] - session.fix_position_n[inside, :2]
    distance = np.hypot(gap[:, 0], gap[:, 1])
    sigma = np.fmax(_accuracy(session)[inside], min(_found_in_fixes(estimate), limits.fix_sigma))
    if estimate.sigmas is not None:
        sigma = np.fmax(sigma, np.max(between_rows(estimate.sigmas.position_n, place)[:, :2], axis=1))
    far = ~(distance <= np.maximum(limits.near_fix, limits.near_fix_sigmas * sigma))
    forgiven = min(limits.far_seconds / max(float(np.ptp(t[inside])), ROW), limits.short_far_share)
    return {
        "median_fix_distance_m": median(distance),
        "far_fix_share": float(np.mean(far)),
        "far_fix_limit": max(limits.far_share, forgiven),
        "longest_far_s": _longest_stretch(t[inside], far),
    }


def _stray_at_rest(session: Session, estimate: Trajectory, t: Array, limits: QualityLimits) -> BoolArray:
    """Mask (N,) of slow fixes while the kart stands: under a roof they wander."""
    stands = np.interp(t, estimate.t, estimate.speed) < limits.stands
    velocity_n = session.gnss.velocity_n[:, :2]
    return np.asarray(stands & (np.hypot(velocity_n[:, 0], velocity_n[:, 1]) < limits.strolls))


def _found_in_fixes(estimate: Trajectory) -> float:
    """Sigma (m, horizontal per axis) of the fixes by slow error and noise that were identified, or beyond the usual."""
    square = 0.0
    for name, least in (("gps_offset_sigma", USUAL_WANDER), ("gps_position_noise", math.inf)):
        if (one := estimate.report.identified.get(name)) is not None:
            level = float(np.ravel(one.value)[0])
            square += level**2 if one.source == "identified" or level > least else 0.0
    return math.sqrt(square)


def _accuracy(session: Session) -> Array:
    """Reported accuracy of each fix, zero where there is none, (N,) m."""
    reported = session.gnss.sigma_horizontal
    return np.zeros(len(session.gnss)) if reported is None else np.nan_to_num(reported, nan=0.0)


def _longest_stretch(t: Array, chosen: BoolArray) -> float:
    """Duration (s) of the longest run of chosen rows, zero for a single row."""
    first, behind = runs_of(chosen)
    return float(np.max(t[behind - 1] - t[first], initial=0.0))


def _motion_reasons(measures: dict[str, float], limits: QualityLimits) -> list[str]:
    reasons = []
    if measures["top_speed_mps"] > limits.top_speed:
        reasons.append(f"a speed of {measures['top_speed_mps'] * 3.6:.0f} km/h is not a kart's")
    share, most = measures.get("far_fix_share", 0.0), measures.get("far_fix_limit", limits.far_share)
    if share > most:
        reasons.append(
            f"{100.0 * share:.0f} % of the fixes lie far from the trajectory (limit {math.floor(100.0 * most)} %)"
        )
    if measures.get("longest_far_s", 0.0) > limits.far_seconds:
        reasons.append(f"the trajectory leaves the fixes for {measures['longest_far_s']:.0f} s")
    radius = measures.get("stood_radius_m", np.inf)
    if radius < limits.stood_radius:
        reasons.append(f"the kart did not drive: it stays within {radius:.0f} m, at no clear speed")
    sigma = measures.get("median_sigma_horizontal_m", 0.0)
    if not sigma <= limits.sigma_horizontal:
        reasons.append(f"the horizontal sigma is {sigma:.0f} m (limit {limits.sigma_horizontal:.0f} m)")
    return reasons


def _standing(session: Session, estimate: Trajectory, limits: QualityLimits) -> dict[str, float]:
    """Radius of a trajectory from fixes alone that does not move."""
    if estimate.report.mode == "full" or estimate.t[-1] - estimate.t[0] < limits.parked_seconds:
        return {}
    estimate = _thinned(estimate)
    near = are_near(estimate.t, session.gnss.t, limits.near_seconds)
    if not near.any():
        return {}
    sigma = 0.0 if estimate.sigmas is None else limits.clearly * np.nan_to_num(estimate.sigmas.speed[near])
    if np.mean(estimate.speed[near] > np.maximum(limits.stood_speed, sigma)) >= limits.least_driving:
        return {}
    place = estimate.position_n[near, :2]
    distance = np.linalg.norm(place - np.median(place, axis=0), axis=1)
    return {"stood_radius_m": float(np.percentile(distance, 95.0))}


def _attitude_measures(session: Session, estimate: Trajectory, limits: QualityLimits) -> dict[str, float]:
    """Sigma of the heading, changes of the mounting over the session, share of driving sideways."""
    estimate = _thinned(estimate)
    known = np.isfinite(estimate.R_nb).all(axis=(1, 2))
    if estimate.report.mode != "full" or estimate.sigmas is None or not known.any():
        return {}
    near = are_near(estimate.t, session.gnss.t, limits.near_seconds)
    driving = known & near & (estimate.speed > limits.driving_speed)
    t = estimate.t[driving]
    if estimate.t[-1] - estimate.t[0] < limits.parked_seconds:
        return {}
    if np.count_nonzero(driving) < limits.least_driving * np.count_nonzero(near):
        return {"parked_sigma_yaw_rad": float(np.median(estimate.sigmas.attitude[known, 2]))}
    if t.size == 0 or t[-1] - t[0] < limits.lean_seconds:
        return {}
    velocity_b = np.einsum("nji,nj->ni", estimate.R_nb[driving], estimate.velocity_n[driving])
    beta = np.arctan2(velocity_b[:, 1], velocity_b[:, 0])
    # pitch relative to the path: an uphill road tilts both alike
    floor = np.arctan2(velocity_b[:, 2], np.hypot(velocity_b[:, 0], velocity_b[:, 1]))
    angles = np.stack([estimate.euler[driving, 0], floor, beta], axis=1)
    sigma = np.max(estimate.sigmas.attitude[driving, :2], axis=1)
    sure = sigma < limits.unsure  # not in a gap of the IMU
    usual = sigma < max(limits.unsure, 1.5 * float(np.median(sigma)))  # a logger that creeps widens all sigmas
    step = float(np.median(np.diff(t)))
    steps = [_largest_step(angles[sure, i], step, limits) for i in range(3)]
    short = replace(limits, lean_seconds=limits.far_lean_seconds)
    far = max(_largest_step(angles[sure, i], step, short) for i in range(3))
    steps += [far] if far > limits.far_lean_step else []
    if not sure.any():  # a logger that moved far
        far = max(_largest_step(angles[usual, i], step, short) for i in range(3))
        steps += [far] if far > max(limits.far_lean_step, limits.clearly * float(np.median(sigma))) else []
    return {
        "sideways_share": float(np.mean(np.abs(beta) > limits.sideways)),
        "overturned_rad": _off_level(angles[:, :2]),
        "overturned_stretch_rad": max(
            _off_level(part) for part in np.array_split(angles[:, :2], max(1, int(t.size * step / limits.lean_seconds)))
        ),
        "largest_lean_step_rad": max(steps),
        "lean_creep_rad": max(_creep(angles[usual, i], step, limits) for i in range(3)),
        "rattling_s": max(_rattling(angles[sure, i], step, limits) for i in range(2)),
    }


def _off_level(angles: Array) -> float:
    """The larger median, rad, of roll and floor (N, 2) rad."""
    return float(np.max(np.abs(np.median(angles, axis=0))))


def _thinned(estimate: Trajectory) -> Trajectory:
    """One row in ROW s."""
    if len(estimate) < 2:
        return estimate
    return estimate.every(max(1, round(ROW / median(np.diff(estimate.t)))))


def _largest_step(values: Array, step: float, limits: QualityLimits) -> float:
    """Largest significant change of the mean of values (N,) rad, `step` s apart, at any row, or 0."""
    fewest, block = round(limits.lean_seconds / step), max(1, round(limits.block_seconds / step))
    if values.size < 2 * fewest:
        return 0.0
    before = np.cumsum(values)[fewest - 1 : values.size - fewest]
    count = np.arange(fewest, values.size - fewest + 1)
    change = (values.sum() - before) / (values.size - count) - before / count
    at = int(np.argmax(np.abs(change)))
    n, largest = int(count[at]), float(np.abs(change[at]))
    rest = values - np.where(np.arange(values.size) < n, before[at] / n, before[at] / n + change[at])
    means = rest[: values.size // block * block].reshape(-1, block).mean(axis=1)
    sigma = np.std(means, ddof=2) * np.sqrt(block / n + block / (values.size - n))
    return largest if largest > limits.lean_significance * sigma else 0.0


def _creep(values: Array, step: float, limits: QualityLimits) -> float:
    """Significant change of values (N,) rad, `step` s apart, along a line through their means over blocks, or 0."""
    block = max(1, round(limits.block_seconds / step))
    if values.size < max(2 * round(limits.lean_seconds / step), 5 * block):
        return 0.0
    means = values[: values.size // block * block].reshape(-1, block).mean(axis=1)
    place = np.arange(len(means)) - 0.5 * (len(means) - 1)
    slope = float(place @ means / (place @ place))
    rest = means - np.mean(means) - slope * place
    sigma = float(np.sqrt(rest @ rest / (len(means) - 2) / (place @ place)))
    return abs(slope) * (len(means) - 1) if abs(slope) > limits.lean_significance * sigma else 0.0


def _rattling(values: Array, step: float, limits: QualityLimits) -> float:
    """Time, s, for which values (N,) rad, `step` s apart, swing beyond `rattle` and beyond the usual."""
    width = limits.rattle_span / step
    if values.size < 4.0 * width:
        return 0.0
    swing = np.sqrt(gaussian_mean((values - gaussian_mean(values, 0.5 * width)) ** 2, width))
    return step * float(np.count_nonzero(swing > max(limits.rattle, limits.rattle_ratio * float(np.median(swing)))))


def _attitude_reasons(measures: dict[str, float], limits: QualityLimits) -> list[str]:
    reasons = []
    sigma = measures.get("parked_sigma_yaw_rad", 0.0)
    if sigma > limits.sigma_yaw:
        reasons.append(f"the heading is not known (sigma {sigma / DEG:.0f} deg): the kart hardly drove")
    step = measures.get("largest_lean_step_rad", 0.0)
    if step > limits.lean_step:
        reasons.append(f"the kart seems to stand {step / DEG:.0f} deg askew from some time on: did the logger move?")
    creep = measures.get("lean_creep_rad", 0.0)
    if creep > limits.lean_creep and not step > limits.lean_step:
        reasons.append(
            f"the kart seems to stand more and more askew, {creep / DEG:.0f} deg in all: did the logger slip?"
        )
    rattling = measures.get("rattling_s", 0.0)
    if rattling > limits.rattle_seconds:
        reasons.append(f"the kart seems to rock from side to side for {rattling:.0f} s: was the logger loose?")
    overturned = measures.get("overturned_rad", 0.0)
    if overturned > limits.overturned:
        reasons.append(
            f"the kart seems to drive {overturned / DEG:.0f} deg off level: are the axes of the samples, and the "
            "stated mounting, right?"
        )
    elif (overturned := measures.get("overturned_stretch_rad", 0.0)) > limits.overturned:
        reasons.append(
            f"the kart seems to drive {overturned / DEG:.0f} deg off level for {limits.lean_seconds:.0f} s and more: "
            "did the logger move?"
        )
    share = measures.get("sideways_share", 0.0)
    if share > limits.sideways_share:
        reasons.append(f"the kart seems to drive sideways for {100.0 * share:.0f} % of the way: did the logger move?")
    return reasons


def _residual_reasons(estimate: Trajectory, limits: QualityLimits) -> list[str]:
    reasons = []
    for name, residual in estimate.report.residuals.items():
        if residual.count < limits.fewest_residuals or name in NOT_JUDGED:
            continue
        words = name.replace("_", " ")
        if residual.normalised_rms > limits.normalised_rms:
            reasons.append(f"residuals of {words} are {residual.normalised_rms:.1f} times their sigma")
        if residual.rejected > limits.rejected_share * residual.count:
            share = 100.0 * residual.rejected / residual.count
            reasons.append(f"{share:.0f} % of {words} was rejected (limit {100 * limits.rejected_share:.0f} %)")
    return reasons
