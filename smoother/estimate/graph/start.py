"""What is known before the first solve: a path through the fixes, attitudes, keyframes, bins, noise and priors."""

import math
from dataclasses import dataclass, replace

import numpy as np

from smoother.arrays import MAD_TO_SIGMA, Array, BoolArray, median
from smoother.config import ImuNoise
from smoother.estimate.align import MIN_SPEED, Alignment, PathMotion, align, initial_attitude
from smoother.estimate.force_size import UNSEEN, SizeDelay, size_delay
from smoother.estimate.gnss_offset import UNFILTERED, OffsetModel, follows_positions, has_doppler, offset_model
from smoother.estimate.gnss_path import GnssPath
from smoother.estimate.gnss_pieces import fit_path
from smoother.estimate.graph.at_rest import scale_at_rest
from smoother.estimate.graph.batch import Data, Noise, Priors
from smoother.estimate.graph.components import OWN_SCATTER, USUAL_VELOCITY, Scatter
from smoother.estimate.graph.imu import BinnedImu, bin_imu, halved, tell_of_samples
from smoother.estimate.graph.inertial_noise import InertialNoise, hole_lengths
from smoother.estimate.graph.keyframes import keyframe_times
from smoother.estimate.graph.lasting import lasting_at_rest
from smoother.estimate.graph.made_up import MadeUpSamples
from smoother.estimate.graph.sampled import are_sampled, has_hole, sampled_spans
from smoother.estimate.graph.slip import PRIOR as SLIP_PRIOR
from smoother.estimate.graph.state import (
    CONSTANTS_SIZE,
    DOPPLER_BIAS,
    EVENNESS,
    SLIP,
    VELOCITY_RESPONSE,
    ChainState,
    Constants,
)
from smoother.estimate.left_out import without_positions
from smoother.estimate.on_wheel import is_on_wheel, turns_with_bends, without_the_wheels
from smoother.estimate.pauses import NO_PAUSES, Pauses
from smoother.fit.standstill import session_standstill
from smoother.samples import Session
from smoother.units import DEG

DATA_SHEET_ACCEL = 300e-6 * 9.80665  # m/s^2/sqrt(Hz), MPU9250 product specification, noise of the accelerometer
DATA_SHEET_GYRO = 0.01 * DEG  # rad/s/sqrt(Hz), likewise
START_SHARE = 0.5  # of what alignment left unexplained, half of which is typically not the samples' noise
LOUDER = 3.0  # times the force's density, from which a second look begins; see :func:`with_louder_force`
ENOUGH_BINS = 40_000  # intervals whose bins tell their noise; more than two hours
# m: an accuracy that only fixed carrier phases have, and their scatter and wander beside Doppler at most; of all other
# receivers these are 0.06 and 0.35 or more, of those 0.02 and 0.13 or less. The least error that is left to them.
RTK, RTK_SCATTER, RTK_WALK, RTK_LEAST = 0.1, 0.03, 0.25, 0.01
MAX_LATENCY = 0.6  # s; the slowest receiver seen lags 0.58 s
FIXES_BETWEEN = 2  # from keyframe to keyframe, if there are so many in the longest interval
# m, north, west, up: what a fix scatters against the next at the most, to come down from. Without Doppler the positions
# alone say how fast one goes: what is taken from them is given to the samples, and does not all come back.
MOST_SCATTER, SOME_SCATTER = np.array([3.0, 3.0, 5.0]), np.array([0.3, 0.3, 0.5])
LEAST_INTERVAL = 0.08  # s between keyframes; of less, too few bins would remain
# s^2; a low-pass of 0.8 s has 0.32. And sigmas of the usual prior beyond which a receiver is one of those: recordings
# have up to 2.6
SLOW_RESPONSE, SLOW_SIGMAS = 0.1, 3.0
# rad/s/sqrt(Hz) that the path leaves of the rates, from which on they may be a wheel's, or folded vibration: simulated
# karts with boxes on frames have 1.2 deg/s, harsh ones 3.5, those on shaken wheels 2.4 to 9
DOUBTED_RATES = 2.0 * DEG
HELD_BY_SIZE = 0.05  # s, sigma of latencies that are held: the size's own, and an arm of half a metre


@dataclass(frozen=True)
class GraphOptions:
    """Options of the graph. rate Hz of the output; intervals s; everything else in SI.

    keyframe_interval: 0.2 s is one keyframe to a fix of a 5 Hz receiver; less beyond 10 Hz (:meth:`for_fixes`).
    bin_interval: of the averaged inertial samples. Bias priors: MPU9250 zero-g tolerance 0.6-0.8 m/s^2; what alignment
    leaves of the gyro's bias. doppler_bias: 0.01-0.05 m/s on real kart logs. velocity_response, s^2: a low-pass
    of 0.1 s has 5e-3, an antenna half a metre up that leans by 1.5 mrad to a m/s^2 -0.8e-3, recordings -6e-3 to 13e-3.
    evenness: receivers filter as a low-pass of first order, or their velocity is the mean of some, or between.
    sensor_error: scale and misalignment; the data sheet's 3 % is the limit, not the spread. rectification: of
    vibration, m/s^2, to begin with. Walks: temperature drift of the same part while it warms up. Lever arm and latency
    priors: what fits on a kart, and what receivers do. in_step: a force that is late behind the rate is taken to its
    time. wheels: the kart is asked to point nearly along its path. rounds: of solving and identifying.
    """

    rate: float = 50.0
    solver: str = "batch"
    in_step: bool = True
    wheels: bool = True
    keyframe_interval: float = 0.2
    bin_interval: float = 0.02
    accel_bias_sigma: float = 0.5
    gyro_bias_sigma: float = 2.0 * DEG
    accel_bias_walk: float = 0.003
    gyro_bias_walk: float = 0.006 * DEG
    lever_arm_sigma: float = 0.5
    doppler_bias_sigma: float = 0.03
    velocity_response_sigma: float = 5e-3
    evenness_sigma: float = 0.5
    sensor_error_sigma: float = 0.01
    rectification_sigma: float = 0.1
    latency_sigma: float = 0.25
    offset_sigma: tuple[float, float, float] = (2.0, 2.0, 3.4)
    offset_tau: float = 60.0
    identification_span: float = 120.0
    rounds: int = 8
    iterations: int = 3
    approaches: int = 4
    final_rounds: int = 10

    def for_fixes(self, t: Array) -> "GraphOptions":
        """Return the options for fixes at t (N,) s: no more than FIXES_BETWEEN of them from one keyframe to the next.

        A cubic of 0.2 s is stiffer than five good velocities in it: what it misses of the motion would pass for noise.
        """
        spacing = float(median(np.diff(t))) if len(t) > 1 else math.inf
        interval = max(FIXES_BETWEEN * spacing, LEAST_INTERVAL)
        return replace(self, keyframe_interval=interval) if interval < 0.99 * self.keyframe_interval else self


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
    driven = PathMotion(session.gnss.t, path.at(session.gnss.t).velocity_n)
    alignment = align(session.imu, driven)
    is_steered, by_size = _on_wheel_and_delay(session, driven, alignment)
    priors = _priors(session, alignment, path, options, by_size)
    spans = sampled_spans(session.imu.t)
    begin, end = _busiest_span(driven, spans, span)
    t = keyframe_times(begin - MAX_LATENCY, end + options.keyframe_interval, options.keyframe_interval)
    if is_steered:
        alignment = replace(alignment, problems=without_the_wheels(alignment.problems))
    constants = Constants.from_vector(priors.constants, alignment.R_bs, is_steered=is_steered)
    fine, binned = _bins(session, t, path, alignment, constants, options)
    R_ns = initial_attitude(t, session.imu, driven, alignment)
    noise = _first_noise(session, path, alignment, binned, options)
    return Start(
        path,
        driven,
        alignment,
        _first_guess(path, t, R_ns, constants, (np.zeros(3), alignment.gyro_bias_s)),
        fine,
        binned,
        noise,
        _data(session, path, t, (driven.t >= begin) & (driven.t <= end), doubted),
        priors,
        min(_receiver(session, options), float(noise.offset_most[0]) / options.offset_sigma[0]),
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
    return replace(
        start, state=state, fine=fine, binned=binned, data=_data(session, start.path, t, everything, doubted)
    )


def on_path_without(session: Session, start: Start, doubted: BoolArray) -> Start:
    """Return the start with the path through all fixes but the positions `doubted` (N,)."""
    path = fit_path(without_positions(session, doubted))
    return replace(start, path=path, driven=PathMotion(session.gnss.t, path.at(session.gnss.t).velocity_n))


def for_slow_receiver(start: Start, constants: Constants) -> Start | None:
    """Return `start` with a wide prior for how the receiver smooths its velocities; None where the usual one holds.

    constants: what was found with the usual one, which holds a receiver that smooths for long far from what it does.
    """
    usual = start.priors.constants_sigma[VELOCITY_RESPONSE]
    if abs(constants.velocity_response) < SLOW_SIGMAS * usual or usual >= SLOW_RESPONSE:
        return None
    sigma = start.priors.constants_sigma.copy()
    sigma[VELOCITY_RESPONSE] = SLOW_RESPONSE
    return replace(start, priors=replace(start.priors, constants_sigma=sigma))


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


def _data(session: Session, path: GnssPath, t: Array, use: BoolArray, doubted: BoolArray | None) -> Data:
    """Measurements for the keyframes t (K,), of the fixes `use` (N,)."""
    gnss = session.gnss
    assert session.imu is not None
    assert gnss.sigma_velocity is not None
    at_rest = session_standstill(session)
    still = np.flatnonzero(_all_between(session.imu.t, at_rest, t[:-1], t[1:]))
    scale = _relative(gnss.sigma_velocity)
    standing = _all_between(session.imu.t, at_rest, gnss.t - MAX_LATENCY, gnss.t)
    scale = np.where(standing, scale * scale_at_rest(gnss.t, gnss.velocity_n, standing), scale)
    return Data(
        gnss.t[use],
        session.fix_position_n[use],
        gnss.velocity_n[use],
        path.position_scale[use],
        scale[use],
        still,
        doubted=None if doubted is None else doubted[use],
        heights=_heights(session),
        lasting=lasting_at_rest(gnss.t, gnss.velocity_n, standing),
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


def _receiver(session: Session, options: GraphOptions) -> float:
    """Reported horizontal accuracy over the population's offset: a receiver that claims to be better may be so."""
    reported = session.gnss.sigma_horizontal
    if reported is None or not np.any(np.isfinite(reported)):
        return 1.0
    return float(np.clip(np.nanmedian(reported) / options.offset_sigma[0], 0.1, 1.0))


def _centimetres(session: Session, path: GnssPath, offset: OffsetModel) -> float | None:
    """Reported horizontal accuracy, m, of a receiver that fixes carrier phases (RTK), None of others.

    It is believed where the fixes say the same: they scatter by hardly more than a digit and stay beside the Doppler,
    which wanders by more than they do; taken for white, it would outvote them.
    """
    reported = session.gnss.sigma_horizontal
    if reported is None or not np.any(np.isfinite(reported)):
        return None
    claimed = float(np.nanmedian(reported))
    is_one = claimed < RTK and path.position_sigma[0] < RTK_SCATTER and offset.sigma[0] < RTK_WALK
    return max(claimed, RTK_LEAST) if is_one else None


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
    sigma[VELOCITY_RESPONSE] = options.velocity_response_sigma
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


def _first_noise(
    session: Session, path: GnssPath, alignment: Alignment, binned: BinnedImu, options: GraphOptions
) -> Noise:
    """Noise to start from: of the fixes from their own smoothing, of the IMU from what alignment left unexplained.

    That is too much, and the identification comes down from it. From too little, with few fixes, it would find that the
    samples are perfect and the fixes are bad. Nor do fixes far apart tell their own noise: from too little of it, all
    of it would pass for a wandering offset. Velocities that a receiver has filtered hardly scatter: from as little as
    that the path would follow them, and show no filter.
    """
    stated = session.config.imu
    inertial = InertialNoise(
        stated.accel_noise
        or max(START_SHARE * alignment.accel_noise, _density(binned, binned.specific_force_s, DATA_SHEET_ACCEL)),
        stated.gyro_noise
        or max(START_SHARE * alignment.gyro_noise, _density(binned, binned.angular_rate_s, DATA_SHEET_GYRO)),
        stated.accel_bias_walk or options.accel_bias_walk,
        stated.gyro_bias_walk or options.gyro_bias_walk,
    )
    usual = OffsetModel(np.array(options.offset_sigma), options.offset_tau)
    offset = offset_model(session.gnss.t, path, usual, path.position_sigma[0] < UNFILTERED)
    most = np.full(3, np.inf)
    if (claimed := _centimetres(session, path, offset)) is not None:
        most = usual.sigma * (claimed / usual.sigma[0])
        offset = OffsetModel(most, usual.tau)
    position = path.position_sigma
    if follows_positions(session.gnss.t, path):
        position = np.maximum(position, MOST_SCATTER if has_doppler(path) else SOME_SCATTER)
    return Noise(
        inertial,
        position,
        np.maximum(path.velocity_sigma, USUAL_VELOCITY),
        offset.sigma,
        offset.tau,
        np.array([options.sensor_error_sigma, options.sensor_error_sigma, options.rectification_sigma]),
        offset.tau_spread,
        offset_most=most,
    )


def _density(binned: BinnedImu, bins: Array, floor: float) -> float:
    """Noise density of bins (K, n, 3) of `binned`: second differences of white noise have six times its variance."""
    bins = bins if np.all(telling := tell_of_samples(binned.missing)) else bins[telling]
    if len(bins) > ENOUGH_BINS:  # a day: those within intervals, evenly taken, are as good
        some = bins[:: len(bins) // ENOUGH_BINS]
        second = some[:, 2:] - 2.0 * some[:, 1:-1] + some[:, :-2]
    else:
        flat = bins.reshape(-1, 3)
        second = flat[2:] - 2.0 * flat[1:-1] + flat[:-2]
    sigma = MAD_TO_SIGMA * median(np.abs(second).ravel())
    return max(floor, sigma * math.sqrt(binned.dt / 6.0))


def scatter_of(start: Start) -> Scatter:
    """Return the densities that neighbouring bins show."""
    binned = start.binned
    accel = _density(binned, binned.specific_force_s, 2.0 * DATA_SHEET_ACCEL / OWN_SCATTER)
    gyro = _density(binned, binned.angular_rate_s, 2.0 * DATA_SHEET_GYRO / OWN_SCATTER)
    return Scatter(accel, gyro)


def _busiest_span(driven: PathMotion, spans: Array, span: float) -> tuple[float, float]:
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


def busiest_part(start: Start, span: float) -> Start:
    """Return the stretch of `span` seconds with most fixes at speed, or all of it when it is not much longer."""
    begin, end = _busiest_span(start.driven, start.spans, span)
    t = start.state.t
    if end == start.driven.t[-1]:
        return start
    first, last = np.searchsorted(t, [begin - MAX_LATENCY, end])
    return stretch(start, int(first), min(int(last), len(t) - 1))


def have_samples(spans: Array, t: Array) -> BoolArray:
    """Mask (N,) of the fixes at t (N,) s that samples of the spans (S, 2) s go with, whatever their latency."""
    return are_sampled(spans, t - MAX_LATENCY, t)


def is_partly_sampled(start: Start) -> bool:
    """Whether some of the fixes have no samples, and must not tell the constants."""
    return has_hole(start.spans, start.data.t[0], start.data.t[-1])


def where_sampled(start: Start) -> Start:
    """Return the start that the constants are found from: the fixes that have samples, holes between them not bridged.

    The start itself where all of it is sampled.
    """
    if not is_partly_sampled(start):
        return start
    t = start.state.t
    spans = start.spans[(start.spans[:, 1] > t[0]) & (start.spans[:, 0] < t[-1])]
    first, last = np.searchsorted(t, [spans[0, 0], spans[-1, 1]])
    part = stretch(start, max(int(first) - 1, 0), min(int(last), len(t) - 1))
    data = _of_fixes(part.data, have_samples(spans, part.data.t))
    return replace(part, data=replace(data, sampled=spans, pauses=start.pauses))


def fixes_between(start: Start, first: int, last: int) -> BoolArray:
    """Mask (N,) of the fixes that are read between the keyframes first and last, whatever their latency."""
    t, keyframes = start.data.t, start.state.t
    return np.asarray((t > keyframes[first] + MAX_LATENCY) & (t < keyframes[last]))


def stretch(start: Start, first: int, last: int) -> Start:
    """Return the start of the keyframes first .. last alone."""
    data = start.data
    still = data.still[(data.still >= first) & (data.still < last)] - first
    part = replace(_of_fixes(data, fixes_between(start, first, last)), still=still, heading=None)
    state, binned = start.state.between(first, last + 1), start.binned.between(first, last + 1)
    return replace(start, state=state, data=part, binned=binned)


def _of_fixes(data: Data, use: BoolArray) -> Data:
    """Return the measurements with the fixes `use` (N,) alone."""
    names = ("t", "position_n", "velocity_n", "position_scale", "velocity_scale")
    doubted = None if data.doubted is None else data.doubted[use]
    return replace(data, doubted=doubted, **{name: getattr(data, name)[use] for name in names})
