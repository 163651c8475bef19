"""What is known before the first solve: a path through the fixes, attitudes, keyframes, bins, noise and priors."""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import Array, BoolArray
from smoother.config import ImuNoise
from smoother.estimate.align import Alignment, align, initial_attitude
from smoother.estimate.force_size import UNSEEN, SizeDelay, size_delay
from smoother.estimate.gnss_path import GnssPath
from smoother.estimate.gnss_pieces import fit_path
from smoother.estimate.gnss_screen import most_say_velocity
from smoother.estimate.graph.at_rest import scale_at_rest
from smoother.estimate.graph.claims import claims_of
from smoother.estimate.graph.first_noise import first_noise, receiver_share
from smoother.estimate.graph.imu import BinnedImu, bin_imu, halved
from smoother.estimate.graph.inertial_noise import hole_lengths
from smoother.estimate.graph.inputs import Data, Noise, Priors
from smoother.estimate.graph.keyframes import keyframe_times
from smoother.estimate.graph.lasting import lasting_at_rest
from smoother.estimate.graph.made_up import MadeUpSamples
from smoother.estimate.graph.options import GraphOptions
from smoother.estimate.graph.sampled import are_sampled, has_hole, sampled_spans
from smoother.estimate.graph.slip import PRIOR as SLIP_PRIOR
from smoother.estimate.graph.state import (
    CONSTANTS_SIZE,
    COURSE_DELAY,
    DOPPLER_BIAS,
    EVENNESS,
    SLIP,
    VELOCITY_RESPONSE,
    ChainState,
    Constants,
)
from smoother.estimate.left_out import tell_motion, without_positions
from smoother.estimate.on_wheel import is_on_wheel, turns_with_bends, without_the_wheels
from smoother.estimate.path_motion import MIN_SPEED, PathMotion, near_told
from smoother.estimate.pauses import NO_PAUSES, Pauses
from smoother.fit.standstill import believed_at_rest, session_standstill
from smoother.samples import Session
from smoother.units import DEG

LOUDER = 3.0  # times the force's density, from which a second look begins; see :func:`with_louder_force`
MAX_LATENCY = 0.6  # s; the slowest receiver seen lags 0.58 s
# s^2; a low-pass of 0.8 s has 0.32. And sigmas of the usual prior beyond which a receiver is one of those: recordings
# have up to 2.6
SLOW_RESPONSE, SLOW_SIGMAS = 0.1, 3.0
LATE_COURSE, COURSE_SIGMAS = 0.3, 0.6  # s; loggers smooth speed or course, not both, by some tenths
LEAST_COURSE_DELAY, SURE_COURSE = 0.025, 4.5  # s between course and speed, and sigmas of it, that are one
MOST_COURSE_DELAY = (-0.15, 0.25)  # s
# rad/s/sqrt(Hz) that the path leaves of the rates, from which on they may be a wheel's, or folded vibration: simulated
# karts with boxes on frames have 1.2 deg/s, harsh ones 3.5, those on shaken wheels 2.4 to 9
DOUBTED_RATES = 2.0 * DEG
HELD_BY_SIZE = 0.05  # s, sigma of latencies that are held: the size's own, and an arm of half a metre


@dataclass(frozen=True, eq=False)
class Start:
    """Everything known before the first solve. The graph is solved with the bins `binned`; `fine` make the output.

    spans (S, 2) s: from when to when there are samples, see :mod:`smoother.estimate.graph.sampled`. wheels: whether
    slip is asked for where it shows. pauses: where time is cut out of the session. by_size: delay of the positions by
    the size of the force, looked for where rates are doubted.
    """

    path: GnssPath
    driven: PathMotion
    alignment: Alignment
    state: ChainState
    fine: BinnedImu
    binned: BinnedImu
    noise: Noise
    data: Data
    priors: Priors
    receiver: float  # how the reported accuracy compares with the population's, at most 1
    stated: ImuNoise  # densities from the settings; they are not estimated
    spans: Array
    wheels: bool
    pauses: Pauses = NO_PAUSES
    by_size: SizeDelay = UNSEEN


def make_start(
    session: Session,
    options: GraphOptions,
    span: float = math.inf,
    doubted: BoolArray | None = None,
    pauses: Pauses = NO_PAUSES,
) -> Start:
    """Return what the fixes alone and the alignment with the inertial samples tell.

    Of a session that is much longer than `span` s, keyframes, bins and data are those of its busiest stretch as long.
    doubted (N,): fixes whose positions are left out. pauses: where time was cut out of the session.
    """
    assert session.imu is not None
    path = fit_path(session if doubted is None else without_positions(session, doubted))
    is_measured = most_say_velocity(session.gnss.velocity_n)
    told = tell_motion(session, by_velocity=is_measured)
    is_told = None if told.all() else near_told(session.gnss.t, told)
    driven = PathMotion(session.gnss.t, path.at(session.gnss.t).velocity_n, is_measured, is_told)
    alignment = align(session.imu, driven)
    is_steered, by_size = _on_wheel_and_delay(session, driven, alignment)
    priors = _priors(session, alignment, path, options, by_size)
    spans = sampled_spans(session.imu.t)
    begin, end = busiest_span(driven, spans, span)
    t = keyframe_times(begin - MAX_LATENCY, end + options.keyframe_interval, options.keyframe_interval)
    if is_steered:
        alignment = replace(alignment, problems=without_the_wheels(alignment.problems))
    constants = Constants.from_vector(priors.constants, alignment.R_bs, is_steered=is_steered)
    fine, binned = _bins(session, t, path, alignment, constants, options)
    R_ns = initial_attitude(t, session.imu, driven, alignment)
    noise = first_noise(session, path, alignment, binned, options)
    return Start(
        path,
        driven,
        alignment,
        _first_guess(path, t, R_ns, constants, (np.zeros(3), alignment.gyro_bias_s)),
        fine,
        binned,
        noise,
        _data(session, path, t, (driven.t >= begin) & (driven.t <= end), doubted, alignment.gyro_bias_s),
        priors,
        min(receiver_share(session, options), float(noise.offset_most[0]) / options.offset_sigma[0]),
        session.config.imu,
        spans,
        options.wheels and priors.drives,
        pauses,
        by_size,
    )


def _on_wheel_and_delay(session: Session, driven: PathMotion, alignment: Alignment) -> tuple[bool, SizeDelay]:
    """Whether the box is on the steering wheel; the delay of `driven` by the size of the force where that matters."""
    assert session.imu is not None
    if alignment.is_misnamed:
        return False, UNSEEN
    is_steered = is_on_wheel(session.imu, session.gnss)
    if alignment.is_level_only or not (is_steered or alignment.gyro_noise > DOUBTED_RATES):
        return is_steered, UNSEEN
    by_size = size_delay(session.imu, driven)
    if not is_steered and by_size.is_seen:
        is_steered = turns_with_bends(session.imu, driven, alignment.R_bs, by_size.delay)
    return is_steered, by_size


def informed(
    session: Session,
    start: Start,
    options: GraphOptions,
    constants: Constants,
    biases: tuple[Array, Array],
    doubted: BoolArray | None = None,
) -> Start:
    """Return the start of the whole session with better known constants, and biases (3,) of force and rate.

    Keyframes are where the receiver felt its velocities. doubted (N,): fixes whose positions are left out.
    """
    assert session.imu is not None
    gnss, T = session.gnss, options.keyframe_interval
    felt_at = gnss.t[np.isfinite(gnss.velocity_n[:, 0])] - constants.velocity_latency
    t = keyframe_times(gnss.t[0] - MAX_LATENCY, gnss.t[-1] + T, T, felt_at)
    fine, binned = _bins(session, t, start.path, start.alignment, constants, options)
    R_ns = initial_attitude(t, session.imu, start.driven, start.alignment)
    state = _first_guess(start.path, t, R_ns, constants, biases)
    everything = np.ones(len(gnss), dtype=np.bool_)
    data = _data(session, start.path, t, everything, doubted, biases[1])
    return replace(start, state=state, fine=fine, binned=binned, data=data)


def on_path_without(session: Session, start: Start, doubted: BoolArray) -> Start:
    """Return the start with the path through all fixes but the positions `doubted` (N,)."""
    path = fit_path(without_positions(session, doubted))
    return replace(start, path=path, driven=replace(start.driven, velocity_n=path.at(session.gnss.t).velocity_n))


def for_slow_receiver(start: Start, constants: Constants) -> Start | None:
    """Return `start` with a wide prior for how the receiver smooths its velocities; None where the usual one holds.

    constants: what was found with the usual one, which holds a receiver that smooths for long far from what it does.
    """
    usual = start.priors.constants_sigma[VELOCITY_RESPONSE]
    if abs(constants.velocity_response) < SLOW_SIGMAS * usual or usual >= SLOW_RESPONSE:
        return None
    return _with_prior(start, VELOCITY_RESPONSE, SLOW_RESPONSE)


def for_late_course(start: Start, constants: Constants) -> Start | None:
    """Return `start` with a wide prior for how much later a velocity's direction is than its size; None where the usual
    one holds.

    constants: what was found with the usual one. Such a course is to the velocities an antenna as far ahead as the kart
    drives in that time, and the usual prior is narrow because of that: it shows all the same, as speeds differ.
    """
    usual = start.priors.constants_sigma[COURSE_DELAY]
    if abs(constants.course_delay) < COURSE_SIGMAS * usual or usual >= LATE_COURSE:
        return None
    return _with_prior(start, COURSE_DELAY, LATE_COURSE)


def _with_prior(start: Start, part: slice, sigma: float) -> Start:
    """Return `start` with another prior sigma of a part of the constants, in their units."""
    sigmas = start.priors.constants_sigma.copy()
    sigmas[part] = sigma
    return replace(start, priors=replace(start.priors, constants_sigma=sigmas))


def is_late_course(held: float, free: float, prior: float) -> bool:
    """Whether the delay of the course that was found `free`, s, is one; `held`, s: with the sigma `prior` beforehand.

    What is left of it where it is held says what it is unsure by: prior^2 / (prior^2 + sigma^2) of it. A speed that is
    later than MOST_COURSE_DELAY allows is an average, which no delay makes right.
    """
    share = np.clip(held / free, 1e-6, 1.0) if free != 0.0 else 1.0
    sigma = prior * np.sqrt(1.0 / share - 1.0)
    is_sure = abs(free) > max(LEAST_COURSE_DELAY, SURE_COURSE * sigma)
    return bool(is_sure and MOST_COURSE_DELAY[0] < free < MOST_COURSE_DELAY[1])


def on_the_wheel(start: Start) -> Start:
    """Return `start` of a box that turns with the steering wheel."""
    constants = replace(start.state.constants, is_steered=True)
    alignment = replace(start.alignment, problems=without_the_wheels(start.alignment.problems))
    return replace(start, state=replace(start.state, constants=constants), alignment=alignment)


def held_by_size(start: Start) -> Start:
    """Return `start` with latencies held near the delay that the size of the force tells, from a louder force."""
    sigma = start.priors.constants_sigma.copy()
    sigma[:2] = np.minimum(sigma[:2], HELD_BY_SIZE)
    return with_louder_force(replace(start, priors=replace(start.priors, constants_sigma=sigma)))


def with_louder_force(start: Start) -> Start:
    """Return `start` with the density of the force LOUDER times as high.

    Means over half a second, which the alignment is made of, hide vibration that the sampling folds. From too quiet a
    force attitudes follow it, rates seem to be many times as noisy as they are, and delay and arm run away together.
    """
    if start.stated.accel_noise:
        return start
    inertial = replace(start.noise.inertial, accel=LOUDER * start.noise.inertial.accel)
    return replace(start, noise=replace(start.noise, inertial=inertial))


def _first_guess(
    path: GnssPath, t: Array, R_ns: Array, constants: Constants, biases: tuple[Array, Array]
) -> ChainState:
    at = path.at(t + _late(path, constants))
    accel_bias, gyro_bias = (np.tile(bias, (len(t), 1)) for bias in biases)
    return ChainState(t, R_ns, at.position_n, at.velocity_n, accel_bias, gyro_bias, at.offset_n, constants)


def _late(path: GnssPath, constants: Constants) -> float:
    """How much later than the sensor, s, the path is where a place is the same: a stated latency is taken out of it."""
    return constants.position_latency - path.position_latency


def _bins(
    session: Session, t: Array, path: GnssPath, alignment: Alignment, constants: Constants, options: GraphOptions
) -> tuple[BinnedImu, BinnedImu]:
    """Inertial samples between the keyframes t (K,), in fine bins and in those to solve with."""
    assert session.imu is not None
    n_bins = max(1, round(options.keyframe_interval / options.bin_interval))
    made_up = MadeUpSamples(session.imu, path, alignment, _late(path, constants), session.gnss)
    fine = bin_imu(session.imu, t, n_bins, np.zeros(3), alignment.gyro_bias_s, made_up.at)
    if np.any(fine.missing):
        fine = replace(fine, blind=made_up.blind(t, hole_lengths(fine.missing, np.diff(t))))
    return fine, halved(fine, alignment.gyro_bias_s) if n_bins % 2 == 0 else fine


def _data(
    session: Session, path: GnssPath, t: Array, use: BoolArray, doubted: BoolArray | None, gyro_bias_s: Array
) -> Data:
    """Measurements for the keyframes t (K,), of the fixes `use` (N,); gyro_bias_s (3,) as the alignment has it."""
    gnss = session.gnss
    assert session.imu is not None
    assert gnss.sigma_velocity is not None
    at_rest = session_standstill(session, gyro_bias=gyro_bias_s)
    still = np.flatnonzero(_all_between(session.imu.t, at_rest, t[:-1], t[1:]))
    scale = _relative(gnss.sigma_velocity)
    standing = _all_between(session.imu.t, at_rest, gnss.t - MAX_LATENCY, gnss.t)
    believed = believed_at_rest(gnss, session.origin, standing)
    scale = np.where(standing, scale * scale_at_rest(gnss.t, gnss.velocity_n, believed), scale)
    velocity_n = np.where((standing & ~believed)[:, None], np.nan, gnss.velocity_n)
    return Data(
        gnss.t[use],
        session.fix_position_n[use],
        velocity_n[use],
        path.position_scale[use],
        scale[use],
        still,
        doubted=None if doubted is None else doubted[use],
        heights=_heights(session),
        lasting=lasting_at_rest(gnss.t, gnss.velocity_n, believed),
        claims=claims_of(gnss),
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


def _priors(
    session: Session, alignment: Alignment, path: GnssPath, options: GraphOptions, by_size: SizeDelay
) -> Priors:
    timing, mounting = session.config.gps, session.config.mounting
    has_velocity = bool(np.any(np.isfinite(session.gnss.velocity_n[:, :2])))
    lag = float(np.clip(alignment.lag + path.position_latency, 0.0, MAX_LATENCY))
    position = lag - (path.velocity_lag.value if has_velocity else 0.0)
    mean, sigma = np.zeros(CONSTANTS_SIZE), np.ones(CONSTANTS_SIZE)
    mean[:2] = max(position, 0.0), lag
    if by_size.is_seen:  # the wheel turns before the kart: the alignment's lag is late by as much
        position = by_size.delay + path.position_latency
        both = np.array([position, position + (path.velocity_lag.value if has_velocity else 0.0)])
        mean[:2] = np.clip(both, -MAX_LATENCY, MAX_LATENCY)
    sigma[:6] = [options.latency_sigma] * 2 + [options.lever_arm_sigma] * 3 + [np.pi / 4.0]
    sigma[SLIP] = SLIP_PRIOR
    sigma[DOPPLER_BIAS], sigma[EVENNESS] = options.doppler_bias_sigma, options.evenness_sigma
    sigma[VELOCITY_RESPONSE], sigma[COURSE_DELAY] = options.velocity_response_sigma, options.course_delay_sigma
    for i, stated in enumerate((timing.position_latency, timing.velocity_latency)):
        if stated is not None:
            mean[i], sigma[i] = stated, 1e-6
    if mounting.lever_arm_b is not None:
        R_bs = alignment.R_bs if mounting.R_bs is None else mounting.R_bs
        mean[2:5], sigma[2:5] = R_bs.T @ mounting.lever_arm_b, 1e-4
    return Priors(
        options.accel_bias_sigma,
        options.gyro_bias_sigma,
        alignment.gyro_bias_s,
        mean,
        sigma,
        holds_height=mounting.lever_arm_b is None,
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
