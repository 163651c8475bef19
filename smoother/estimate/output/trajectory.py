"""From a solved graph to the trajectory people use: dense rows, antenna, body axes, sigmas, and the report."""

from dataclasses import replace

import numpy as np

from smoother.arrays import Array, median
from smoother.disc import release
from smoother.estimate.factors.rows import Rows
from smoother.estimate.fixes.claims import claims_of
from smoother.estimate.fixes.offset import OffsetModel, unseen_variance
from smoother.estimate.fixes.path import UNKNOWN_HEIGHT
from smoother.estimate.fixes.reported_noise import wander_from_laps
from smoother.estimate.fixes.slow_errors import SlowErrors, slow_errors
from smoother.estimate.model.imu import BinnedImu
from smoother.estimate.output.dense_rows import DenseRows, DenseSource, parts_of
from smoother.estimate.output.estimated import Estimated
from smoother.estimate.output.identified import doubt_by_rates, identified_values, sample_time_sigma
from smoother.estimate.output.joint import WithUnseen, usual_change
from smoother.estimate.output.kart_keyframes import keyframes_of_kart, widen
from smoother.estimate.output.mounting import FittedMounting, swing_on_the_wheel
from smoother.estimate.output.residual_statistics import row_statistics
from smoother.estimate.output.wander import offset_at_fixes, share_wander, unaided
from smoother.estimate.preprocess.pauses import NO_PAUSES, Pauses
from smoother.fit.lap_registration import LapRegistration, register_laps
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
    unsteady = doubt_by_rates(noise.inertial.gyro) if session.config.gps.position_latency is None else 0.0
    moment = sample_time_sigma(sampling, session.config.imu_delay, unsteady)
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
    """What was found, with the part of the fixes' wander in the path that is the wander of its Doppler velocities; and
    the slow errors of both, where laps show them.

    Not where corrections come and go: what such fixes are off by is not one process, and hardly Doppler's.
    """
    fixes, state = session.gnss, found.state
    if not np.isfinite(fixes.velocity_n[:, 0]).any() or len(claims_of(fixes).renewed):
        return found, None
    seen = offset_at_fixes(state, found.rows["gps_position"])
    if seen is None:
        return found, None
    noise = found.known.noise
    # over an outage the path goes with the samples, and what fixes do beside it then is not Doppler's
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
