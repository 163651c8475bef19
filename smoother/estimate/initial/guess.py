"""What is known before the first solve: a path through the fixes, attitudes, keyframes, bins, noise and priors; and
parts of it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.config import ImuNoise
from smoother.estimate.factors.constraints import far_from_heights
from smoother.estimate.factors.graph import (
    MAX_LATENCY,
    Factor,
    GraphOptions,
    Measurements,
    Priors,
    readings_inside,
    table_without,
)
from smoother.estimate.factors.motion_prior import Unsampled
from smoother.estimate.factors.wheels import readings_of
from smoother.estimate.fixes.offset import reported_share
from smoother.estimate.fixes.path import GnssPath
from smoother.estimate.fixes.pieces import fit_path
from smoother.estimate.fixes.screen import most_have_velocity
from smoother.estimate.initial.align import Alignment, align, initial_attitude
from smoother.estimate.initial.first_noise import first_noise, scale_at_rest, scatter_of
from smoother.estimate.model.imu import BinnedImu, are_sampled, bin_imu, has_hole, sampled_spans
from smoother.estimate.model.noise import Noise
from smoother.estimate.model.state import CONSTANTS, Geometry, State
from smoother.estimate.preprocess.gains import is_on_wheel, without_the_wheels
from smoother.estimate.preprocess.pauses import NO_PAUSES, Pauses
from smoother.estimate.preprocess.streams import MIN_SPEED, PathMotion, near_reported
from smoother.estimate.solvers.identify import Problem
from smoother.estimate.solvers.variance_components import SENSOR_SCALE
from smoother.fit.standstill import confirmed_at_rest, session_standstill
from smoother.samples import Session

DENSITIES = ("accel_noise", "gyro_noise")
ARM_ON_WHEEL = 0.02  # m


@dataclass(frozen=True, eq=False)
class Start:
    """All that is known before the first solve. The graph is solved with the bins `binned`; `fine` make the output.

    receiver: reported accuracy over the population's, at most 1. stated: densities of the settings. spans (S, 2) s: of
    samples. wheels: whether the factor of the wheels joins. pauses: where time is cut out of the session.
    """

    path: GnssPath
    driven: PathMotion
    alignment: Alignment
    state: State
    fine: BinnedImu
    binned: BinnedImu
    noise: Noise
    data: Measurements
    priors: Priors
    receiver: float
    stated: ImuNoise
    spans: Array
    wheels: bool
    table: tuple[Factor, ...]
    pauses: Pauses = NO_PAUSES


def make_start(session: Session, options: GraphOptions, span: float = math.inf, pauses: Pauses = NO_PAUSES) -> Start:
    """Return the start by the fixes alone and the alignment with the inertial samples.

    Of a session that is much longer than `span` s, keyframes, bins and data are those of its busiest stretch as long.
    pauses: where time was cut out of the session.
    """
    assert session.imu is not None
    path = fit_path(session)
    is_measured = most_have_velocity(session.gnss.velocity_n)
    moving = session.gnss.velocity_n if is_measured else session.fix_position_n
    reported = np.asarray(np.isfinite(moving[:, :2]).all(axis=1))
    is_reported = None if reported.all() else near_reported(session.gnss.t, reported)
    driven = PathMotion(session.gnss.t, path.at(session.gnss.t).velocity_n, is_measured, is_reported)
    alignment = align(session.imu, driven)
    is_steered = not alignment.is_misnamed and is_on_wheel(session.imu, session.gnss)
    if is_steered:
        alignment = replace(alignment, problems=without_the_wheels(alignment.problems))
    priors = _priors(session, alignment, path, options)
    priors = with_short_arm(priors) if is_steered else priors
    spans = sampled_spans(session.imu.t)
    begin, end = busiest_span(driven, spans, span)
    state = _first_guess(
        session,
        path,
        driven,
        alignment,
        keyframe_times(begin, end, options.keyframe_interval),
        {name: mean for name, (mean, _) in priors.constants.items()},
        (np.zeros(3), alignment.gyro_bias_s),
        Geometry(alignment.R_bs, is_steered),
    )
    fine, binned = _bins(session, state, alignment, options)
    noise, usual = first_noise(session, path, alignment, binned, options), options.offset_sigma[0]
    return Start(
        path,
        driven,
        alignment,
        state,
        fine,
        binned,
        noise,
        _measurements(session, path, state, binned, alignment.gyro_bias_s, alignment).of(
            (driven.t >= begin) & (driven.t <= end)
        ),
        priors,
        reported_share(session.gnss, usual),
        session.config.imu,
        spans,
        options.wheels and priors.drives,
        table_without(options.without),
        pauses,
    )


def problem_of(start: Start) -> Problem:
    """The graph's problem that a start is."""
    stated = frozenset(name for name in DENSITIES if getattr(start.stated, name))
    return Problem(
        start.binned, start.data, start.priors, start.state, start.noise, scatter_of(start.binned), stated, start.table
    )


def informed(session: Session, start: Start, options: GraphOptions, found: State) -> Start:
    """Return the start of the whole session with the constants and the mean biases that were found of a part."""
    gnss = session.gnss
    biases = found.accel_bias_s.mean(axis=0), found.gyro_bias_s.mean(axis=0)
    t = keyframe_times(gnss.t[0], gnss.t[-1], options.keyframe_interval)
    known = start.path, start.driven, start.alignment
    state = _first_guess(session, *known, t, found.constants, biases, found.geometry)
    fine, binned = _bins(session, state, start.alignment, options)
    data = _measurements(session, start.path, state, binned, biases[1], start.alignment)
    return replace(
        start,
        state=state,
        fine=fine,
        binned=binned,
        data=data,
    )


def with_short_arm(priors: Priors) -> Priors:
    """Priors for a logger on the steering wheel: its antenna is in it."""
    mean, sigma = priors.constants["lever_arm"]
    return replace(priors, constants=priors.constants | {"lever_arm": (mean, np.minimum(sigma, ARM_ON_WHEEL))})


def keyframe_times(begin: float, end: float, interval: float) -> Array:
    """Times (K,) s, evenly spaced, of all that fixes stamped from begin to end may be read at."""
    first, last = begin - MAX_LATENCY, end + interval
    return np.asarray(first + interval * np.arange(max(1, math.ceil((last - first) / interval - 1e-9)) + 1))


def _first_guess(
    session: Session,
    path: GnssPath,
    driven: PathMotion,
    alignment: Alignment,
    t: Array,
    constants: Mapping[str, Array],
    biases: tuple[Array, Array],
    geometry: Geometry,
) -> State:
    """Keyframes at t (K,) s: motion of the path, attitude of the alignment; biases (3,) of force and rate."""
    assert session.imu is not None
    R_ns = initial_attitude(t, session.imu, driven, alignment)
    at = path.at(t + _late(path, constants))
    accel_bias, gyro_bias = (np.tile(bias, (len(t), 1)) for bias in biases)
    return State(t, R_ns, at.position_n, at.velocity_n, accel_bias, gyro_bias, at.offset_n, constants, geometry)


def _late(path: GnssPath, constants: Mapping[str, Array]) -> float:
    """Time, s, by which the path is behind the IMU at the same position; a stated latency is subtracted from it."""
    return float(constants["position_latency"][0]) - path.position_latency


def _bins(session: Session, state: State, alignment: Alignment, options: GraphOptions) -> tuple[BinnedImu, BinnedImu]:
    """Inertial samples between the keyframes of `state`, in fine bins and in bins twice as long to solve with."""
    assert session.imu is not None
    t, n_bins = state.t, max(1, round(options.keyframe_interval / options.bin_interval))
    fine = bin_imu(session.imu, t, n_bins, np.zeros(3), alignment.gyro_bias_s)
    if n_bins % 2:
        return fine, fine
    binned = bin_imu(session.imu, t, n_bins // 2, np.zeros(3), alignment.gyro_bias_s)
    return fine, replace(binned, rough=fine.rough)


def _measurements(
    session: Session, path: GnssPath, state: State, binned: BinnedImu, gyro_bias_s: Array, alignment: Alignment
) -> Measurements:
    """Measurements for the keyframes of `state`; gyro_bias_s (3,) rad/s, to know rest by."""
    gnss, t = session.gnss, state.t
    assert session.imu is not None
    assert gnss.sigma_velocity is not None
    at_rest = session_standstill(session, gyro_bias=gyro_bias_s)
    standing = _all_between(session.imu.t, at_rest, gnss.t - MAX_LATENCY, gnss.t)
    confirmed = confirmed_at_rest(gnss, session.origin, standing)
    scale = _relative(gnss.sigma_velocity)
    scale = np.where(standing, scale * scale_at_rest(gnss.t, gnss.velocity_n, confirmed), scale)
    ground = far_from_heights(_heights(session), t)
    follows = not (alignment.is_level_only or state.geometry.is_steered)
    with_velocity = gnss.t[np.isfinite(gnss.velocity_n[:, 0])]
    fixes = with_velocity if len(with_velocity) > 1 else gnss.t
    wheel = session.wheel_speed
    return Measurements(
        gnss.t,
        session.fix_position_n,
        np.where((standing & ~confirmed)[:, None], np.nan, gnss.velocity_n),
        path.position_scale,
        scale,
        np.flatnonzero(_all_between(session.imu.t, at_rest, t[:-1], t[1:])),
        speed=gnss.speed,
        ground=ground if len(ground[0]) else None,
        unsampled=Unsampled.of(binned.missing, state, fixes, follows=follows),
        wheel_speed=None if wheel is None else readings_inside(readings_of(wheel), t),
    )


def _all_between(t: Array, mask: BoolArray, begin: Array, end: Array) -> BoolArray:
    """Whether there are samples, of t (S,) s, from begin to end (N,) s, and mask (S,) holds for all of them."""
    first, last = np.searchsorted(t, [begin, end])
    holding = np.concatenate([[0], np.cumsum(mask)])
    return np.asarray((last > first) & (holding[last] - holding[first] == last - first))


def _heights(session: Session) -> Array:
    """Time s and up in n, m, (H, 2) of the fixes that have a height."""
    up = session.fix_position_n[:, 2]
    known = np.isfinite(up)
    return np.column_stack([session.gnss.t[known], up[known]])


def _relative(reported: Array) -> Array:
    """Factor (N,) of a reported sigma over the session's usual one, never below 1; 1 where nothing is reported."""
    if not np.any(np.isfinite(reported)):
        return np.ones(len(reported))
    return np.fmax(1.0, np.where(np.isfinite(reported), reported / np.nanmedian(reported), 1.0))


def _priors(session: Session, alignment: Alignment, path: GnssPath, options: GraphOptions) -> Priors:
    timing, mounting = session.config.gps, session.config.mounting
    has_velocity = bool(np.any(np.isfinite(session.gnss.velocity_n[:, :2])))
    between = path.velocity_lag.value if has_velocity else 0.0
    lag = float(np.clip(alignment.lag + path.position_latency, 0.0, MAX_LATENCY))
    late = max(lag - between, 0.0), lag
    found = dict.fromkeys(SENSOR_SCALE, 1.0)  # with the noise
    constants = {c.name: (np.zeros(c.size), np.full(c.size, (options.sigmas | found)[c.name])) for c in CONSTANTS}
    for name, value, stated in zip(
        ("position_latency", "velocity_latency"), late, (timing.position_latency, timing.velocity_latency), strict=True
    ):
        mean = np.array([np.clip(value, -MAX_LATENCY, MAX_LATENCY)])
        constants[name] = (mean, constants[name][1]) if stated is None else (np.array([stated]), np.array([1e-6]))
    if mounting.lever_arm_b is not None:
        R_bs = alignment.R_bs if mounting.R_bs is None else mounting.R_bs
        constants["lever_arm"] = R_bs.T @ mounting.lever_arm_b, np.full(3, 1e-4)
    return Priors(
        options.accel_bias_sigma,
        options.gyro_bias_sigma,
        alignment.gyro_bias_s,
        constants,
        # a kart leans too little to identify the height of the antenna
        held_s=alignment.R_bs[2] if mounting.lever_arm_b is None else None,
        has_height=bool(np.any(np.isfinite(session.fix_position_n[:, 2]))),
        drives=not alignment.is_level_only,
    )


def busiest_span(driven: PathMotion, spans: Array, span: float) -> tuple[float, float]:
    """First and last time of the stretch of `span` seconds with most fixes at speed, or of all if not much longer.

    Of those that there are samples for, by spans (S, 2) s.
    """
    t = driven.t
    if t[-1] - t[0] < 1.5 * span:
        return float(t[0]), float(t[-1])
    counted = driven.speed > MIN_SPEED
    if has_hole(spans, t[0], t[-1]):
        sampled = have_samples(spans, t)
        counted = counted & sampled if np.any(counted & sampled) else sampled
    fast = np.concatenate([[0], np.cumsum(counted)])
    whole = t <= t[-1] - span
    first = int(np.argmax(fast[np.searchsorted(t, t[whole] + span)] - fast[:-1][whole]))
    return float(t[first]), float(t[first] + span)


def have_samples(spans: Array, t: Array) -> BoolArray:
    """Mask (N,) of the fixes at t (N,) s that samples of the spans (S, 2) s go with, whatever their latency."""
    return are_sampled(spans, t - MAX_LATENCY, t)


def busiest_part(start: Start, span: float) -> Start:
    """Return the stretch of `span` seconds with most fixes at speed, or all of it when it is not much longer.

    What was driven is known of the whole session, of which a start may be a stretch already.
    """
    t, driven = start.state.t, start.driven
    inside = (driven.t >= t[0]) & (driven.t <= t[-1])
    if not np.any(inside):
        return start
    is_reported = None if driven.is_reported is None else driven.is_reported[inside]
    driven = replace(driven, t=driven.t[inside], velocity_n=driven.velocity_n[inside], is_reported=is_reported)
    begin, end = busiest_span(driven, start.spans, span)
    if end == driven.t[-1]:
        return start
    first, last = np.searchsorted(t, [begin - MAX_LATENCY, end])
    return stretch(start, int(first), min(int(last), len(t) - 1))


def is_partly_sampled(start: Start) -> bool:
    """Whether some of the fixes have no samples, and must not determine the constants."""
    return has_hole(start.spans, start.data.t[0], start.data.t[-1])


def longest_sampled(start: Start) -> Start:
    """Return the longest stretch of the start that has samples throughout; the start itself where all of it has."""
    if not is_partly_sampled(start):
        return start
    t = start.state.t
    inside = np.clip(start.spans, t[0], t[-1])
    begin, end = inside[np.argmax(np.diff(inside, axis=1)[:, 0])]
    first, last = np.searchsorted(t, [begin, end])
    part = stretch(start, max(int(first) - 1, 0), min(int(last), len(t) - 1))
    return replace(part, data=part.data.of(have_samples(start.spans, part.data.t)))


def fixes_between(start: Start, first: int, last: int) -> BoolArray:
    """Mask (N,) of the fixes that are read between the keyframes first and last, whatever their latency."""
    return start.data.are_between(start.state.t, first, last + 1)


def stretch(start: Start, first: int, last: int) -> Start:
    """Return the start of the keyframes first .. last alone."""
    data = start.data.between(start.state.t, first, last + 1)
    state, binned = start.state.part(slice(first, last + 1)), start.binned.between(first, last + 1)
    return replace(start, state=state, data=data, binned=binned)
