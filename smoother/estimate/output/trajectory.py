"""From a solved graph to the trajectory: keyframes of the kart, dense rows, sigmas, and the report."""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, BoolArray, median
from smoother.disc import pieces, release, roomy
from smoother.estimate.factors.gnss import arm_axes
from smoother.estimate.factors.rows import Between, Rows
from smoother.estimate.fixes.offset import OffsetModel, unseen_variance
from smoother.estimate.fixes.path import UNKNOWN_HEIGHT
from smoother.estimate.fixes.reported_noise import wander_from_laps
from smoother.estimate.fixes.slow_errors import SlowErrors, slow_errors
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.output.dense_rows import TOGETHER, DenseRows, DenseSource, parts_of
from smoother.estimate.output.estimated import Estimated, attitude_variance, without_samples
from smoother.estimate.output.identified import identified_values, sample_time_sigma
from smoother.estimate.output.joint import WithUnseen, usual_change
from smoother.estimate.output.mounting import FittedMounting, swing_on_the_wheel
from smoother.estimate.output.residuals import row_statistics
from smoother.estimate.output.wander import offset_at_fixes, share_wander, unaided
from smoother.estimate.preprocess.pauses import NO_PAUSES, Pauses
from smoother.fit.lap_registration import LapRegistration, register_laps
from smoother.frames import UP_N
from smoother.samples import Problem, Sampling, Session
from smoother.trajectory import (
    BOX_ON_WHEEL,
    EstimateReport,
    FixResiduals,
    Identified,
    Keyframes,
    Trajectory,
)

OUTAGE = 10.0  # s without a fix
ON_WHEEL = (
    "the logger turns with the steering wheel: roll, yaw and accelerations along its axes are those of the wheel; "
    "position, speed, lap times and accelerations along the path are not affected"
)


def build_trajectory(
    session: Session,
    found: Estimated,
    mounting: FittedMounting,
    binned: BinnedImu,
    rate: float,
    population: Array,
    pauses: Pauses = NO_PAUSES,
    hidden: float = 0.0,
) -> Trajectory:
    """Return rows at `rate` Hz from the first to the last fix: antenna in n, attitude and accelerations of the kart.

    population (3,) m: sigma of the GPS offset of receivers like this one, the least that absolute positions are unsure.
    pauses: where time is cut out of the session; the rows that fall into them are left out. hidden m: wander that these
    fixes may have unseen, see :func:`unseen_variance`.
    """
    known, noise, is_steered = found.known, found.known.noise, found.state.geometry.is_steered
    offset = OffsetModel(noise.offset_sigma, noise.offset_tau, known.offset_tau_spread)
    unseen = unseen_variance(offset, float(noise.position[0]), population, len(session.gnss), hidden)
    unsure = unseen if known.has_height else np.add(unseen, [0.0, 0.0, UNKNOWN_HEIGHT**2])
    laps = register_laps(found.state.t, (found.state.position_n + found.state.offset_n)[:, :2])  # as fixes have them
    found, errors = _with_wander_shared(session, found, laps)
    source = DenseSource(found.state, binned, noise.inertial, pauses)
    keyframes = keyframes_of_kart(session, found, source, mounting, unsure)
    swing = swing_on_the_wheel(keyframes, is_steered=is_steered)
    if swing is not None:
        widen(keyframes, swing)
    sampling = session.imu.sampling if session.imu is not None else Sampling(0.0)
    identified = identified_values(found, mounting, session.config, unseen, sampling)
    if laps is not None:
        identified |= wander_from_laps(laps, identified)
    report = _report(found, identified, keyframes, is_on_wheel=swing is not None)
    t = _times(session, pauses, rate)
    rows = DenseRows.empty(len(t))
    moment = sample_time_sigma(sampling, session.config.imu_delay)
    for part in parts_of(t, pauses):
        rows.fill(part, t[part], found, mounting, source, keyframes)
        rows.add_time_uncertainty(part, moment, sampling.stamp_sigma)
        release(rows, keyframes, binned)
    has_doppler = bool(np.isfinite(session.gnss.velocity_n[:, 0]).any())
    usual = median(np.einsum("kii->ki", keyframes.covariance)[:, 6:8].ravel()) if has_doppler else None
    return rows.trajectory(t, report, WithUnseen(found.joint, unsure, usual, errors))


def _with_wander_shared(
    session: Session, found: Estimated, laps: LapRegistration | None
) -> tuple[Estimated, SlowErrors | None]:
    """The estimate with Doppler's part of the offset moved into the path, and the slow errors, where laps show them."""
    fixes, state = session.gnss, found.state
    if not np.isfinite(fixes.velocity_n[:, 0]).any():
        return found, None
    seen = offset_at_fixes(state, found.rows["gps_position"])
    if seen is None:
        return found, None
    noise = found.known.noise
    # over an outage the path follows the samples, not Doppler
    if laps is None or float(np.max(np.diff(seen.t))) > OUTAGE:
        return replace(found, state=share_wander(state, seen, unaided(seen, noise.offset_tau))), None
    known = usual_change(found.joint, float(seen.t[0]), float(seen.t[-1]), laps.time_of_lap)
    errors = slow_errors(laps, seen.t, seen.drift, known)
    left = replace(errors, sigma=errors.beyond(float(noise.offset_sigma[0])))
    seen = replace(seen, walk=np.diff(seen.t, prepend=seen.t[0]) * known / laps.time_of_lap)
    return replace(found, state=share_wander(state, seen, left)), errors


def _report(
    found: Estimated, identified: dict[str, Identified], keyframes: Keyframes, *, is_on_wheel: bool
) -> EstimateReport:
    return EstimateReport(
        identified=identified,
        residuals={**row_statistics(found.rows), **found.inertial},
        fixes=_fix_residuals(found.rows["gps_position"]),
        keyframes=keyframes,
        problems=(Problem(BOX_ON_WHEEL, ON_WHEEL),) if is_on_wheel else (),
        mode="full",
    )


def _times(session: Session, pauses: Pauses, rate: float) -> Array:
    """Times (N,) s of the rows, pauses closed."""
    first, last = pauses.opened(session.gnss.t[[0, -1]])
    t = row_times(first, last, rate)
    return pauses.closed(t[~pauses.are_cut_out(t)]) if len(pauses) else t


def row_times(start: float, end: float, rate: float) -> Array:
    """Times (N,) s from start to end at `rate` Hz, without a hole."""
    return np.asarray(start + np.arange(int(np.floor((end - start) * rate + 1e-6)) + 1) / rate)


def _fix_residuals(rows: Rows) -> FixResiduals:
    residual = np.where(np.isfinite(rows.sigma), rows.residual, np.nan)
    return FixResiduals(np.arange(len(rows.interval)), residual, rows.weight)


SLOPE = 0.03  # rms of the ground on a hilly road; karting tracks have less
# m/s, forgotten in half a minute or later: two modules in one car have 0.020 each beside what their sigmas hold, one
# beside the heights of RTK 0.018; of the level velocities of both it is 0.003 to 0.013
SLOW_UPWARDS = 0.02


def _left_of_attitude(found: Estimated, mounting: FittedMounting, unsampled: BoolArray | None) -> Array:
    """Share (3,), by axis of b, of the errors of attitude that remain in the attitude of the kart.

    An error that all keyframes have in common becomes a part of the fitted mounting.
    unsampled (K,): keyframes without samples.
    """
    if not mounting.is_fitted:
        return np.ones(3)
    mean, common = attitude_variance(found, mounting.R_bs, unsampled)
    left = np.sqrt(np.clip(1.0 - common / mean, 0.0, 1.0))
    return np.array([*left[:2], 1.0]) if mounting.by_wheels else np.asarray(left)


def keyframes_of_kart(
    session: Session, found: Estimated, source: DenseSource, mounting: FittedMounting, unseen: Array
) -> Keyframes:
    """Antenna and kart at the keyframes, with the covariance of attitude (in n), velocity and position.

    unseen (3,) m^2: variance of the slow error of the fixes that no session shows. Errors of upward velocity include
    the slope of the ground where no fix has a height, or the slow error of the receiver's own.
    """
    state, antenna, known = found.state, found.uncertainty.antenna, found.known
    R, arms_n = state.R_ns, arm_axes(Between.at(state, state.t)) @ state.constants["lever_arm"]
    R_nb, covariance, velocity_n = R @ mounting.R_bs.T, roomy(antenna.shape), state.velocity_n.copy()
    left = _left_of_attitude(found, mounting, without_samples(source.binned))
    of_mounting = np.array([*mounting.sigma[:2], 0.0]) if mounting.by_wheels else mounting.sigma
    is_held = known.priors.held_s is not None and known.drives  # the height of the antenna, which tilting swings it by
    height_sigma = float(known.priors.constants["lever_arm"][1][2]) if is_held else 0.0
    has_upwards = bool(np.any(np.isfinite(session.gnss.velocity_n[:, 2])))
    slope = 0.0 if known.has_height or has_upwards else SLOPE
    for part in parts_of(state.t, source.pauses):
        covariance[part] = antenna[part]
        covariance[part, 6:9, 6:9] += np.diag(unseen)
        left_n = (R_nb[part] * left) @ R_nb[part].transpose(0, 2, 1)
        covariance[part, 0:3] = left_n @ covariance[part, 0:3]
        covariance[part, :, 0:3] = covariance[part, :, 0:3] @ left_n
        covariance[part, 0:3, 0:3] += (R_nb[part] * of_mounting**2) @ R_nb[part].transpose(0, 2, 1)
        near, arm_n = source.around(state.t[part]), arms_n[part]
        swing_n = near.swing_at(state.t[part])
        velocity_n[part] += np.cross(swing_n, arm_n)
        by_height = height_sigma * np.cross(swing_n, UP_N)
        covariance[part, 3:6, 3:6] += near.swing_covariance(arm_n) + by_height[:, :, None] * by_height[:, None, :]
        covariance[part, 5, 5] += slope**2 * np.sum(velocity_n[part, :2] ** 2, axis=1)
        covariance[part, 5, 5] += SLOW_UPWARDS**2 if has_upwards else 0.0
        release(covariance, antenna, source.binned)
    return Keyframes(
        t=state.t,
        position_n=state.position_n + arms_n,
        velocity_n=velocity_n,
        R_nb=R_nb,
        covariance=covariance,
        accel_bias_s=state.accel_bias_s,
        gyro_bias_s=state.gyro_bias_s,
        sigma_accel_bias=found.uncertainty.biases[:, :3],
        sigma_gyro_bias=found.uncertainty.biases[:, 3:],
        gps_offset_n=state.offset_n,
        unseen_offset=unseen,
    )


def widen(keyframes: Keyframes, swing: Array) -> None:
    """Add the rms angles (3,) rad about the axes of b between logger and kart to the errors of the kart's attitude."""
    for part in pieces(len(keyframes.t), TOGETHER):
        R_nb = keyframes.R_nb[part]
        keyframes.covariance[part, 0:3, 0:3] += (R_nb * swing**2) @ R_nb.transpose(0, 2, 1)
        release(keyframes)
